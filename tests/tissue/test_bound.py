"""Bounds of the compliance enclose that of the exact body."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import MeshTet

import tissue
from meshes.cylinder import tube
from meshes.grading import Grading
from tests.bounds import RESIDUAL
from tests.tissue.layers import layer_compliance
from tests.tissue.test_refinement import HOLE, NU, E, R, block, compliance
from tissue.refinement.bound import Bounds, bounds
from tissue.refinement.refine import refine_to
from tissue.refinement.rim import ENLARGED, conical, trace_factor
from tissue.refinement.star import OTHERS, SIDES, condensed, quadratic

Array = NDArray[np.float64]
USEFUL = 3.5  # of the error below: the width of the bounds, by stars and by what the facets at a rim miss
ACCURACY = 0.2  # of the compliance, for cells at rims that are few
FACTOR = 2.0  # upper over lower bound on coarse cells: a stiff block under a soft skin costs the most
OVERKILL = 0.004  # estimated relative error of the reference, which is below the exact compliance, too
SHAKEN = 0.15  # of the shortest edge: how far a node inside is moved


def finer(mesh: MeshTet, site: tissue.Site, least: float) -> MeshTet:
    """A mesh with cells of `least` radii at a site, growing away from it."""
    point, radius = np.asarray(site.point, float), site.radius

    def size(corners: Array) -> Array:
        away = np.linalg.norm(corners.mean(axis=1) - point, axis=1)
        return np.asarray(least * radius + np.maximum(away - radius, 0.0))

    return refine_to(mesh, size).mesh


def shaken(mesh: MeshTet, seed: int) -> MeshTet:
    """The mesh with every node inside moved at random."""
    rng, points = np.random.default_rng(seed), mesh.p.copy()
    inner, ends = np.setdiff1d(np.arange(mesh.nvertices), mesh.boundary_nodes()), mesh.edges
    if mesh.subdomains:  # a border between materials stays plane
        inner = np.setdiff1d(inner, mesh.t[:, mesh.subdomains["skin"]])
    shortest, length = np.full(mesh.nvertices, np.inf), np.linalg.norm(np.diff(mesh.p[:, ends], axis=1)[:, 0], axis=0)
    for end in ends:
        np.minimum.at(shortest, end, length)
    points[:, inner] += SHAKEN * shortest[inner] * rng.uniform(-1.0, 1.0, (3, inner.size))
    moved = MeshTet(points, mesh.t)
    moved._boundaries, moved._subdomains = mesh.boundaries, mesh.subdomains
    return moved


@dataclass(frozen=True)
class Body:
    """A mesh with a hole, how it is held, Poisson's ratio, and Young's modulus of its skin over that below."""

    mesh: Callable[[], MeshTet]
    hole: tissue.Site = HOLE
    clamp: tuple[str, ...] = ("bottom",)
    roller: tuple[str, ...] = ()
    nu: float = NU
    contrast: float = 1.0

    def material(self, mesh: MeshTet) -> tissue.Material:
        """Its material on a mesh."""
        moduli = np.full(mesh.nelements, E)
        moduli[(mesh.subdomains or {}).get("skin", [])] *= self.contrast
        return tissue.Material(moduli, self.nu, 1000.0)

    def on(self, mesh: MeshTet) -> tissue.Elasticity:
        """Its elasticity by quadratic displacements."""
        return tissue.elasticity(mesh, self.material(mesh), "P2", self.clamp, "cell", self.roller)

    def bounds(self, mesh: MeshTet) -> Bounds:
        """Bounds of the compliance of its hole."""
        return bounds(mesh, self.material(mesh), [self.hole], self.clamp, self.roller, ACCURACY)


def cube() -> MeshTet:
    """A small block."""
    return block((0.02, 0.02, 0.008), 4e-3)


BODIES = {
    "compressible": Body(cube, nu=0.0),
    "nearly incompressible": Body(cube, nu=0.48),
    "small footprint": Body(cube, replace(HOLE, radius=0.5e-3)),
    "uniform weight": Body(cube, replace(HOLE, weight="uniform")),
    "edge": Body(cube, replace(HOLE, point=(0.01 - 1.3 * R, 0.0, 0.0))),
    "clamp beside": Body(cube, replace(HOLE, point=(0.01 - 1.5 * R, 0.0, 0.0)), clamp=("right",)),
    "rollers": Body(cube, replace(HOLE, point=(1e-3, 2e-3, 0.0)), clamp=("left",), roller=("bottom", "front")),
    "thin wall": Body(lambda: block((0.008, 0.006, 1e-3), 1e-3), clamp=("left", "right")),
    "stiff skin": Body(lambda: block((0.02, 0.02, 0.008), 4e-3, depth=1e-3), contrast=20.0),
    "soft skin": Body(lambda: block((0.02, 0.02, 0.008), 4e-3, depth=1e-3), contrast=0.1),
    "curved": Body(
        lambda: tube(6e-3, 2e-3, 0.02, Grading(2.5e-3, 2.5e-3)),
        replace(HOLE, point=(0.0, 0.0, 6e-3)),
        clamp=("left", "right"),
    ),
}


@pytest.mark.parametrize("nu", [0.3, 0.45, 0.48])
def test_bounds_enclose_a_layer(nu: float) -> None:
    """Independent check: a footprint on a bonded layer, by Hankel transform; the width is of the size of the error."""
    h = 4.0 * R
    normal, along = layer_compliance("parabolic", R, h, E, nu)
    exact = np.array([along, along, normal])
    found = Body(lambda: finer(block((40.0 * R, 40.0 * R, h), h), HOLE, 1.0), nu=nu)
    known = found.bounds(found.mesh())
    assert np.all(known.lower[0] < exact)
    assert np.all(exact < known.upper[0])
    assert np.all(known.upper[0] - known.lower[0] <= USEFUL * (exact - known.lower[0]))


@pytest.mark.parametrize(("seed", "name"), [*enumerate(BODIES)])
def test_bounds_enclose_a_fine_mesh(seed: int, name: str) -> None:
    """Independent check: cells with a tenth of the error, and a mesh whose nodes are moved at random."""
    body = BODIES[name]
    coarse = finer(body.mesh(), body.hole, 1.2)
    fine = compliance(tissue.fitted(coarse, "P2", body.on, [body.hole], OVERKILL).body, [body.hole])[0]
    known = body.bounds(shaken(coarse, seed))
    assert np.all(known.lower[0] <= fine)
    assert np.all(fine <= known.upper[0])
    assert np.all(known.upper[0] <= FACTOR * known.lower[0])


def test_bounds_of_two_meshes_enclose_the_same() -> None:
    """Consistency check: of a hole in coarse and in fine cells, whose bounds overlap and become narrower."""
    body = BODIES["edge"]
    coarse, fine = (body.bounds(finer(body.mesh(), body.hole, least)) for least in (1.5, 0.5))
    assert np.all(np.maximum(coarse.lower, fine.lower) <= np.minimum(coarse.upper, fine.upper))
    assert np.all(fine.upper - fine.lower < coarse.upper - coarse.lower)


def test_bounds_over_the_compliance_of_a_coarse_organ() -> None:
    """Independent check: linear cells with averaged pressure, whose compliance the fine one is so many times of, of
    two holes; bare points and sites of a line have none."""
    body, mesh = BODIES["nearly incompressible"], cube()
    organ = tissue.elasticity(mesh, body.material(mesh), "P1", body.clamp)
    bare, ball = replace(HOLE, radius=0.0), tissue.Site((0.0, 0.0, -4e-3), R, line="tract")
    holes = [HOLE, replace(HOLE, point=(5e-3, 0.0, 0.0))]
    found = tissue.relative_bounds(organ, [bare, holes[0], ball, holes[1]], body.clamp, (), ACCURACY)
    fine = compliance(tissue.fitted(mesh, "P2", body.on, holes, OVERKILL).body, holes)
    factors = fine / compliance(organ, holes)
    for pair, factor in zip(found[[1, 3]], factors, strict=True):
        assert pair[0] <= factor.min() <= factor.max() <= pair[1]
    assert np.isnan(found[[0, 2]]).all()


def test_the_matrix_of_a_cell() -> None:
    """Independent check: linear displacements of its facets have the energy of their strain, rigid motions have none,
    and no other ones have none."""
    rng, nu = np.random.default_rng(0), 0.4
    points = rng.random((20, 4, 3))
    lam, mu = nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), 1.0 / (2.0 * (1.0 + nu))
    S = condensed(points, np.full(20, lam), np.full(20, mu)).stiffness
    corners = points[:, OTHERS]
    nodes = np.concatenate([corners, *(0.5 * (corners[:, :, [a]] + corners[:, :, [b]]) for a, b in SIDES)], axis=2)
    G = rng.standard_normal((3, 3))
    strain, moved = 0.5 * (G + G.T), (nodes @ G.T).reshape(20, -1)
    energy = np.einsum("cx,cxy,cy->c", moved, S, moved)
    volume = np.abs(np.linalg.det(points[:, 1:] - points[:, :1])) / 6.0
    density = lam * np.trace(strain) ** 2 + 2.0 * mu * np.sum(strain**2)
    assert energy == pytest.approx(volume * density, rel=RESIDUAL)
    values = np.linalg.eigvalsh(S)
    assert np.all(np.abs(values[:, :6]) <= RESIDUAL * values[:, -1:])
    assert np.all(values[:, 6] > RESIDUAL * values[:, -1])


def test_what_a_facet_sees_of_a_displacement() -> None:
    """Independent check: waves of all directions and lengths, none of which leaves more on a facet than the factor."""
    rng, lam, mu = np.random.default_rng(0), 2.0, 0.5
    (x, w), (y, v) = conical(24), np.polynomial.legendre.leggauss(12)
    u, t = (part.ravel() for part in np.meshgrid(0.5 * (y + 1.0), 0.5 * (y + 1.0)))
    side = np.stack([1.0 - u, u * (1.0 - t), u * t])
    weights = np.outer(v, v * 0.5 * (y + 1.0)).T.ravel()
    weights /= weights.sum()
    shapes = quadratic(side, SIDES)
    for _ in range(20):
        points = rng.random((4, 3))
        inside, facet = np.vstack([1.0 - x.sum(axis=0), x]).T @ points, side.T @ points[1:]
        wave, amplitude, phase = rng.normal(0.0, 6.0, (30, 3)), rng.standard_normal((30, 3)), rng.random(30) * 6.0
        slopes = np.cos(inside @ wave.T + phase)[..., None, None] * np.einsum("ki,kj->kij", amplitude, wave)
        strain = 0.5 * (slopes + slopes.swapaxes(2, 3))
        trace = np.einsum("qkii->qk", strain)
        volume = abs(np.linalg.det(points[1:] - points[0])) / 6.0
        energy = volume * w @ (lam * trace**2 + 2.0 * mu * np.sum(strain**2, axis=(2, 3)))
        values = np.sin(facet @ wave.T + phase)[..., None] * amplitude
        moments = np.einsum("q,bq,qki->bki", weights, shapes, values)
        area = 0.5 * float(np.linalg.norm(np.cross(points[2] - points[1], points[3] - points[1])))
        whole = np.einsum("q,qki->k", weights, values**2)
        solved = np.linalg.solve((shapes * weights) @ shapes.T, moments.reshape(6, -1)).reshape(moments.shape)
        known = np.sum(moments * solved, axis=(0, 2))
        assert np.all(area * (whole - known) <= ENLARGED * trace_factor(points, lam, mu) * energy)


def test_what_has_no_bounds_is_refused() -> None:
    """Independent check: an organ that is free to move, and a footprint inside."""
    body, mesh = Body(cube), cube()
    with pytest.raises(tissue.TissueError, match="free to move"):
        replace(body, clamp=()).bounds(mesh)
    with pytest.raises(tissue.TissueError, match="inside the organ"):
        replace(body, hole=replace(HOLE, point=(0.0, 0.0, -4e-3), direction=None)).bounds(mesh)
