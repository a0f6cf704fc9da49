"""Cells where the holes are: bisection that carries names, and an error of the compliance that is known."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import MeshTet

import tissue
from meshes.block import graded_block_structured
from meshes.checks import check, volumes
from meshes.cylinder import tube
from meshes.grading import Grading
from meshes.quality import quality
from meshes.wound import Wound, lips, wounded_block_gmsh, wounded_block_structured
from studies.theory import TwoHoles
from tests.bounds import IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.meshes.samples import NEEDS_GMSH
from tests.tissue.layers import layer_compliance, stack_compliance
from tissue.refinement.estimate import Estimate, Recovery, estimate
from tissue.refinement.mark import marked, share_to_mark, wanted
from tissue.refinement.refine import refine, refine_to

Array = NDArray[np.float64]
E, NU, R = 1.0e5, 0.45, 1.0e-3
ASKED = 0.03  # the accuracy that cells are refined to
EFFECTIVITY = 0.7, 1.5  # of an estimate over the true error: recovered stress is of a higher order, and no bound
SOFT = tissue.Material(E, NU, 1000.0)
HOLE = tissue.Site((0.0, 0.0, 0.0), R, "parabolic", "normal")


def block(size: tuple[float, float, float], h: float, depth: float = 0.0) -> MeshTet:
    """A structured block, with a region "skin" down to a depth where that is given."""
    planes = ((), (), (-depth,) if depth else ())
    mesh = graded_block_structured(size, Grading(h, h), np.zeros((0, 3)), planes)
    return mesh.with_subdomains({"skin": lambda x: x[2] > -depth}) if depth else mesh


def body_of(element: str, skin: float = E, nu: float = NU) -> Callable[[MeshTet], tissue.Elasticity]:
    """What makes a body held below on a mesh, its region "skin" of another modulus."""

    def on(mesh: MeshTet) -> tissue.Elasticity:
        moduli = np.full(mesh.nelements, E)
        moduli[(mesh.subdomains or {}).get("skin", [])] = skin
        return tissue.elasticity(mesh, tissue.Material(moduli, nu, 1000.0), element, ["bottom"])

    return on


def compliance(body: tissue.Elasticity, holes: list[tissue.Site]) -> Array:
    """Compliance of each hole to forces along x, y and z, `(p, 3)` [m/N]."""
    C = tissue.QuasiStaticOrgan(body, tissue.build_sites(body, holes)).operator(0.0, 0.0).C
    return np.diag(C).reshape(-1, 9)[:, :3]


def areas(mesh: MeshTet) -> dict[str, float]:
    """Areas of the boundaries by name [m²]."""
    corners = {name: mesh.p.T[mesh.facets[:, facets].T] for name, facets in (mesh.boundaries or {}).items()}
    return {
        name: float(0.5 * np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1).sum())
        for name, c in corners.items()
    }


def contents(mesh: MeshTet) -> dict[str, float]:
    """Volumes of the regions by name [m³]."""
    each = volumes(mesh.p.T, mesh.t.T)
    return {name: float(each[cells].sum()) for name, cells in (mesh.subdomains or {}).items()}


def test_bisection_carries_names_and_keeps_the_body() -> None:
    """Independent check: a sound mesh of the same body, boundaries and regions, whose angles stop getting worse."""
    mesh, worst = block((0.02, 0.01, 0.01), 5e-3, depth=2e-3), []
    before, regions = areas(mesh), contents(mesh)
    for _ in range(8):
        near = np.linalg.norm(mesh.p[:, mesh.t].mean(axis=1), axis=0)
        fine = refine(mesh, np.flatnonzero(near < 2.0 * near.min()))
        mesh = fine.mesh
        check(mesh.p.T, mesh.t.T)
        worst.append(quality(mesh).dihedral_min)
    assert areas(mesh) == pytest.approx(before, rel=IDENTITY)
    assert contents(mesh) == pytest.approx(regions, rel=IDENTITY)
    assert worst[-1] == pytest.approx(worst[3], rel=TWO_SOLVERS)


def test_bisection_of_nothing_is_the_same_mesh() -> None:
    """Independent check: where no cell is too large, none is made anew."""
    mesh = block((0.02, 0.01, 0.01), 5e-3)
    assert refine_to(mesh, lambda corners: np.full(len(corners), 1.0)).mesh is mesh


def test_lips_of_a_slit_match_after_refinement() -> None:
    """Independent check: marks on one side alone; pairs of nodes and facets are found by their places."""
    wound = Wound(0.012, 5e-3)
    mesh = wounded_block_structured((0.03, 0.02, 0.01), wound, Grading(2.5e-3, 2.5e-3), [[4e-3, 3e-3, 0.0]])
    rng = np.random.default_rng(0)
    for _ in range(4):
        mesh = refine(mesh, marked(mesh, rng.random(mesh.nelements) ** 20)).mesh
    pairs = lips(mesh, wound)
    assert np.abs(np.diff(mesh.p[:, pairs.nodes], axis=2)).max() <= IDENTITY
    assert len(pairs.facets) == len(mesh.boundaries["lip_left"]) == len(mesh.boundaries["lip_right"])
    check(mesh.p.T, mesh.t.T, pairs.nodes[pairs.nodes[:, 0] != pairs.nodes[:, 1]])


def test_a_mesh_that_is_its_own_image_stays_so() -> None:
    """Independent check: marks on one side alone; every cell has its image, to a nanometre of its corners."""
    mesh = block((0.02, 0.02, 0.01), 5e-3)
    rng = np.random.default_rng(0)
    for _ in range(4):
        mesh = refine(mesh, marked(mesh, rng.random(mesh.nelements) ** 20, mirror=0)).mesh
    mirrored = mesh.p * np.array([[-1.0], [1.0], [1.0]])
    own, image = (
        {frozenset(map(tuple, cell)) for cell in (np.round(p.T, 9) + 0.0)[mesh.t.T].tolist()}
        for p in (mesh.p, mirrored)
    )
    assert own == image


def test_images_are_marked_together() -> None:
    """Independent check: cells whose indicators differ by round-off alone are marked or left together."""
    mesh = block((0.02, 0.02, 0.01), 5e-3)
    middles = mesh.p[:, mesh.t].mean(axis=1)
    indicators = 1.0 / np.round(np.linalg.norm(middles, axis=0), 9) ** 4
    noise = 1.0 + 1e-12 * np.random.default_rng(0).standard_normal(indicators.size)
    cells = marked(mesh, indicators * noise)
    assert set(cells) == set(np.flatnonzero(indicators >= indicators[cells].min() * (1.0 - 1e-9)))


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_field_of_the_discrete_space_has_no_error(element: str) -> None:
    """Independent check: uniaxial tension along x under its own traction, of which σ* is the exact stress."""
    mesh = block((0.02, 0.01, 0.01), 5e-3)
    body = replace(body_of(element)(mesh), clamped=np.zeros(0, np.intp))
    W = np.zeros((body.N, 3))
    for k in range(3):  # along x, y and z, so that the traction on the sides is that of each alone
        strain = np.full(3, -NU)
        strain[k] = 1.0
        W[body.nodes, k] = body.points * strain / E
    recovery = Recovery(body)
    ends = np.abs(recovery.normals)
    for k in range(3):
        inner = ends[:, k] < 0.5  # the free sides of column k
        own = Recovery(body)
        object.__setattr__(own, "_surface", (recovery.rim[inner], recovery.normals[inner]))
        missed = own.missed(W, np.zeros(int(inner.sum())), np.arange(mesh.nelements))[k]
        assert missed.sum() <= RESIDUAL * np.prod((0.02, 0.01, 0.01)) / E


@pytest.mark.parametrize(("element", "finest"), [("P1", 0.35), ("P1", 0.2), ("P2", 0.7), ("P2", 0.5)])
def test_the_estimate_is_the_error(element: str, finest: float) -> None:
    """Independent check: a footprint on a bonded layer, by Hankel transform, on cells below the footprint."""
    h = 4.0 * R
    normal, along = layer_compliance("parabolic", R, h, E, NU)
    mesh = block((40.0 * R, 40.0 * R, h), 4.0 * R)  # five layers to the sides, which the closed form has far away
    fine = refine_to(
        mesh, lambda c: finest * R + 0.5 * np.maximum(np.linalg.norm(c.mean(axis=1), axis=1) - 2.0 * R, 0.0)
    )
    body = body_of(element)(fine.mesh)
    found = estimate(body, [HOLE], tissue.build_sites(body, [HOLE]))
    true = np.array([along, along, normal]) - found.compliance[0]
    ratios = found.missed[0] / true
    assert np.all(true > 0.0)
    assert EFFECTIVITY[0] <= ratios.min() <= ratios.max() <= EFFECTIVITY[1]
    assert found.compliance[0] == pytest.approx(compliance(body, [HOLE])[0], rel=TWO_SOLVERS)


@pytest.mark.parametrize("radius", [0.25e-3, 1e-3, 3e-3])
def test_footprints_of_any_size_are_as_accurate_as_asked(radius: float) -> None:
    """Independent check: footprints on a bonded layer, by Hankel transform, on one coarse mesh."""
    normal, along = layer_compliance("parabolic", radius, 0.012, E, NU)
    hole = replace(HOLE, radius=radius)
    fit = tissue.fitted(block((0.06, 0.06, 0.012), 6e-3), "P2", body_of("P2"), [hole], ASKED)
    assert fit.errors[0] <= ASKED
    assert compliance(fit.body, [hole])[0] == pytest.approx([along, along, normal], rel=ASKED)


@pytest.mark.parametrize("contrast", [0.1, 20.0])
def test_a_skin_thinner_than_the_footprint(contrast: float) -> None:
    """Independent check: a skin of half a footprint on a softer or stiffer layer, by Hankel transform."""
    exact = stack_compliance(R, [0.5 * R, 8.0 * R], [contrast * E, E], NU)[:3]
    mesh = block((0.05, 0.05, 8.5 * R), 5e-3, depth=0.5 * R)
    fit = tissue.fitted(mesh, "P2", body_of("P2", contrast * E), [HOLE], ASKED)
    assert fit.errors[0] <= ASKED
    assert compliance(fit.body, [HOLE])[0] == pytest.approx(exact, rel=ASKED)


def test_balls_inside_move_one_another() -> None:
    """Independent check: two balls three radii below the surface and from one another, by Mindlin's solution; what they
    move apart by, since the block's bed takes as much of both."""
    exact = TwoHoles(3.0 * R, 3.0 * R, R, E, NU)
    balls = [tissue.Site(tuple(place), R) for place in exact.places]
    fit = tissue.fitted(block((40.0 * R, 40.0 * R, 30.0 * R), 10.0 * R), "P2", body_of("P2"), balls, ASKED)
    C = tissue.QuasiStaticOrgan(fit.body, tissue.build_sites(fit.body, balls)).operator(0.0, 0.0).C
    for axis, row in ((0, 0), (2, 1)):
        apart = C[axis, axis] - C[axis, 9 + axis]
        assert apart == pytest.approx(exact.compliance[row, row] - exact.compliance[row, 2 + row], rel=2.0 * ASKED)


def test_linear_cells_take_rounds() -> None:
    """Independent check: P1 comes to what is asked in rounds, each nearer, and to that of the closed form."""
    asked = 2.0 * ASKED
    normal, along = layer_compliance("parabolic", R, 4.0 * R, E, NU)
    fit = tissue.fitted(block((0.03, 0.03, 4.0 * R), 4.0 * R), "P1", body_of("P1"), [HOLE], asked)
    errors = [one.error for one in fit.rounds]
    assert len(errors) > 1
    assert np.all(np.diff(errors) < 0.0)
    assert errors[-1] <= asked
    assert compliance(fit.body, [HOLE])[0] == pytest.approx([along, along, normal], rel=asked / EFFECTIVITY[0])


def test_memory_ends_the_rounds() -> None:
    """Independent check: no round is begun that might have more unknowns than there is room for; the error says so."""
    fit = tissue.fitted(block((0.02, 0.02, 0.005), 2.5e-3), "P1", body_of("P1"), [HOLE], ASKED, most=100.0)
    assert len(fit.rounds) == 1
    assert fit.errors[0] > ASKED


def test_a_bare_point_is_no_goal() -> None:
    """Independent check: it has no limit under refinement, and asks for no cells."""
    mesh = block((0.02, 0.02, 0.005), 2.5e-3)
    bare = replace(HOLE, radius=0.0)
    fit = tissue.fitted(mesh, "P2", body_of("P2"), [bare], ASKED)
    assert fit.body.mesh is mesh
    assert np.isnan(fit.errors).all()


def test_a_body_that_nothing_holds() -> None:
    """Independent check: what the tissue around a hole gives way by is known as well as in one that is held: of a
    large body that is free the estimate is that of the same body held far away."""
    mesh = block((0.04, 0.04, 0.02), 5e-3)

    def free(mesh: MeshTet) -> tissue.Elasticity:
        return tissue.elasticity(mesh, tissue.Material(E, NU, 1000.0), "P2")

    held, loose = (tissue.fitted(mesh, "P2", on, [HOLE], ASKED) for on in (body_of("P2"), free))
    assert loose.errors[0] <= ASKED
    cells = held.body.mesh.p[2][held.body.mesh.t]
    away = (cells > cells.min() + 1e-9).all(axis=0)  # from the clamp, whose cells have an error of their own
    # of a far boundary: R over its depth
    assert loose.indicators.sum() == pytest.approx(held.indicators[away].sum(), rel=0.2)


def test_equal_holes_of_a_tube() -> None:
    """Independent check: four holes by quarter turns of a tube, of a mesh that has no such symmetry; the compliance to
    a force along the normal, and its sum over the axes."""
    mesh = tube(8e-3, 2e-3, 0.03, Grading(2e-3, 2e-3), np.zeros((0, 3)))
    find, axes = tissue.landing(mesh), [(0.0, np.cos(t), np.sin(t)) for t in 0.3 + 0.5 * np.pi * np.arange(4)]
    holes = [replace(HOLE, point=find(np.array([5e-3, 7.5e-3 * y, 7.5e-3 * z]), [x, y, z])) for x, y, z in axes]
    on = partial(tissue.elasticity, material=SOFT, element="P2", clamp=["left", "right"])
    body = tissue.fitted(mesh, "P2", on, [replace(hole, radius=0.8e-3) for hole in holes], ASKED).body
    placed = tissue.build_sites(body, [replace(hole, radius=0.8e-3) for hole in holes])
    C = tissue.QuasiStaticOrgan(body, placed).operator(0.0, 0.0).C
    own = np.array([C[9 * k : 9 * k + 3, 9 * k : 9 * k + 3] for k in range(4)])
    normal = np.einsum("ki,kij,kj->k", placed.normals, own, placed.normals)
    for found in (normal, np.trace(own, axis1=1, axis2=2)):
        assert np.ptp(found) <= 0.02 * found.mean()


@pytest.mark.parametrize(
    ("make", "width"), [(wounded_block_structured, 0.0), pytest.param(wounded_block_gmsh, 4e-3, marks=NEEDS_GMSH)]
)
def test_equal_holes_of_a_layered_wound_under_a_half_turn(make: Callable[..., MeshTet], width: float) -> None:
    """Independent check: holes that are one another's images by a half turn about z are equally compliant."""
    wound, places = Wound(0.02, 8e-3, width), [(-5e-3, -3e-3), (5e-3, 3e-3)]
    mesh = make((0.04, 0.04, 0.02), wound, Grading(5e-3, 5e-3), planes=((), (), (-2e-3,)))
    mesh = mesh.with_subdomains({"skin": lambda x: x[2] > -2e-3})
    holes = [replace(HOLE, point=(x, y, 0.0)) for x, y in places]
    fit = tissue.fitted(mesh, "P2", body_of("P2", skin=3.0 * E), holes, ASKED, mirror=wound.normal_axis)
    lips(fit.body.mesh, wound)
    one, other = compliance(fit.body, holes)
    assert one == pytest.approx(other, rel=TWO_SOLVERS)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_small_excess_of_the_error_takes_few_cells(element: str) -> None:
    """Independent check: a round that marks as much as the excess of the error asks brings it down by that, and takes
    fewer cells than one that marks the largest share."""
    mesh, sites, on = block((0.04, 0.04, 0.02), 5e-3), [HOLE], body_of(element)
    mesh = refine_to(mesh, wanted(mesh, element, 2.0 * ASKED, sites)).mesh

    def found(mesh: MeshTet) -> Estimate:
        return estimate(on(mesh), sites, tissue.build_sites(on(mesh), sites))

    before, cells = found(mesh), []
    for excess in (1.05, 1.2, np.inf):
        finer = refine(mesh, marked(mesh, before.indicators, share_to_mark(element, excess))).mesh
        cells.append(finer.nelements - mesh.nelements)
        assert found(finer).errors[0] <= before.errors[0] / min(excess, 1.2)
    assert cells[0] < cells[1] < 0.7 * cells[2]


@pytest.mark.parametrize(("thick", "nu"), [(4e-3, 0.45), (4e-3, 0.3), (2e-3, 0.45)])
def test_a_sheet_bent_at_its_clamp(thick: float, nu: float) -> None:
    """Independent check: on cells half as high as the sheet and finer at its clamp. Nearly all of the error is at the
    edges of the clamp, where the stress is singular."""

    def on(mesh: MeshTet) -> tissue.Elasticity:
        return tissue.elasticity(mesh, tissue.Material(E, nu, 1000.0), "P2", ["left"])

    hole, size = replace(HOLE, point=(0.01, 0.0, 0.0)), (0.04, 0.01, thick)
    fit = tissue.fitted(block(size, 0.01), "P2", on, [hole], ASKED)
    fine = tissue.fitted(block(size, 0.5 * thick), "P2", on, [hole], 0.1 * ASKED)
    exact = compliance(fine.body, [hole])[0] * (1.0 + fine.errors[0])
    off = 1.0 - compliance(fit.body, [hole])[0, 2] / exact[2]
    assert fit.errors[0] <= ASKED
    assert EFFECTIVITY[0] <= fit.errors[0] / off <= EFFECTIVITY[1]
