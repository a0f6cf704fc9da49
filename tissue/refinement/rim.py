"""The part of a footprint's traction that is not quadratic on facets.

This part exists because a footprint ends inside facets. The rest g of the traction on a facet is
orthogonal to quadratics, and moves the body only a little:

    |∫ g·v|² ≤ ‖g‖² ‖v − Πv‖² ≤ ‖g‖² Λ_K ∫_K σ(v) : ε(v) dx ,

with the projection Π on quadratics on the facet of cell K. Λ_K is the largest value of a small
eigenvalue problem.
"""

from collections.abc import Sequence
from functools import cache
from itertools import product

import numpy as np
import scipy.linalg
from scipy.special import roots_jacobi
from skfem import ElementTriP2, MeshTet
from skfem.quadrature import get_quadrature

from tissue.arrays import Array, Indices
from tissue.material import Material
from tissue.refinement.refine import refine
from tissue.refinement.star import AXES, MEANS, NODES, OTHERS, SIDES, Pull, Stars, hat_gradients, isotropic, quadratic
from tissue.sites.site import Load, Site, load_of
from tissue.sites.surface import outer_surface

DEGREE = 6  # degree of the displacements in `trace_factor`
ENLARGED = 2.0  # factor on `trace_factor` for higher degrees: degree 8 adds up to 40 % in cells of a bisected block
ROUND = 1e-12  # of the square of a traction: a smaller rest is round-off
SHARE = 0.15  # of the accepted error of displacements: share of the rests, which are added before squaring
SOFT = 0.5  # of 1/(E a): the smallest compliance of a half-space, along its normal at ν = 0.45
MOST_ROUNDS = 12  # of bisection; if they are too few, the bounds are wider


def pull_of(stars: Stars, load: Load) -> Pull:
    """Return the load of a footprint, facet by facet."""
    facets = np.unique(load.facets)
    cells, vertices = load.surface.behind[facets], load.surface.vertices[facets]
    opposite = np.argmin((stars.corners[cells][:, :, None] == vertices[:, None]).any(axis=2), axis=1)
    moments, missed = np.zeros((facets.size, 3, NODES)), np.zeros(facets.size)
    for row, (facet, cell, side) in enumerate(zip(facets, cells, opposite, strict=True)):
        own = load.facets == facet
        at, weights = on_facet(stars, cell, side, load.points[own]), load.weights[own]
        moments[row] = (at * weights) @ quadratic(at, SIDES).T
        missed[row] = rest(stars, cell, side, moments[row].sum(axis=0), float(weights @ load.densities[own]))
    shared = np.sum(cells[:, None] == cells, axis=1)  # rests on facets of one cell add up like forces
    return Pull(cells, opposite, moments, missed * shared)


def on_facet(stars: Stars, cell: int, side: int, points: Array) -> Array:
    """Return the barycentric coordinates `(3, k)` of points `(k, 3)` [m] on a facet.

    The facet is opposite to the corner `side` of a `cell`. Each coordinate is zero at the other two
    corners of the facet.
    """
    corners = OTHERS[side]
    zero = stars.points[cell, np.roll(corners, 1)]
    return np.einsum("kij,ij->ik", points[:, None] - zero, stars.gradients[cell, corners])


def rest(stars: Stars, cell: int, side: int, moments: Array, square: float) -> float:
    """Return Λ_K ‖g‖² [m/N] of a traction on a facet.

    `moments` `(6,)` [-] are its moments with quadratics, and `square` [1/m²] is the integral of its
    square.
    """
    area = float(np.linalg.norm(stars.areas[cell, side]))
    left = square - float(moments @ np.linalg.solve(area * MEANS.facet, moments))
    if left <= ROUND * square:
        return 0.0
    points, (lam, mu) = stars.points[cell, [side, *OTHERS[side]]], stars.moduli
    return ENLARGED * left * trace_factor(points, float(lam[cell]), float(mu[cell]))


def cut_at_rims(mesh: MeshTet, material: Material, sites: Sequence[Site], accuracy: float) -> tuple[MeshTet, Material]:
    """Return a mesh and its material, bisected at the rims of footprints.

    The bisection ends when quadratic tractions are accurate enough. The remaining error is then
    small compared with the accepted relative error `accuracy` of the compliance [-].
    """
    for _ in range(MOST_ROUNDS):
        stars, surface = Stars(mesh, material, np.zeros((0, AXES), dtype=bool)), outer_surface(mesh)
        marks = [coarse(stars, load_of(surface, site), SHARE**2 * accuracy * SOFT / site.radius) for site in sites]
        if not any(cells.size for cells in marks):
            break
        fine = refine(mesh, np.unique(np.concatenate(marks)))
        mesh, material = fine.mesh, part_of(material, fine.parents)
    return mesh, material


def coarse(stars: Stars, load: Load, most: float) -> Indices:
    """Return the cells behind a footprint whose tractions must be refined.

    In these cells the rest of the traction exceeds its share of `most`, an energy times Young's
    modulus [1/m].
    """
    pull = pull_of(stars, load)
    missed = pull.missed * np.max(np.broadcast_to(stars.material.youngs_modulus, stars.mesh.nelements)[pull.cells])
    if missed.sum() <= most:
        return pull.cells[:0]
    return np.asarray(pull.cells[missed > most / np.count_nonzero(missed)])


def part_of(material: Material, cells: Indices) -> Material:
    """Return the material of `cells` `(c,)`."""
    each = (material.youngs_modulus, material.poisson_ratio, material.density, material.lasting)
    return Material(*(value if np.ndim(value) == 0 else np.asarray(value)[cells] for value in each))


def trace_factor(points: Array, lam: float, mu: float, degree: int = DEGREE) -> float:
    """Return the largest ratio of ∫ |v − Πv|² on a facet to the energy of its cell [m³/N].

    The energy is ∫ σ(v) : ε(v). The cell has the corners `points` `(4, 3)` [m], and the facet has
    the last three of them. The v are polynomials of the `degree`.
    """
    strains, coordinates, sides = polynomials(degree)
    slopes, volume = hat_gradients(points[None])[0, 1:], abs(np.linalg.det(points[1:] - points[0])) / 6.0
    N = volume * np.einsum("akbl,ki,lj->aibj", strains, slopes, slopes, optimize=True)
    K = isotropic(N[None], np.array([lam]), np.array([mu])).reshape(AXES * len(coordinates), -1)
    offset = points - points.mean(axis=0)
    turns = np.cross(np.eye(AXES), (coordinates @ offset / np.abs(offset).max())[:, None]).swapaxes(1, 2)
    slides = np.eye(AXES) * coordinates.sum(axis=1)[:, None, None]
    Q = np.linalg.qr(np.concatenate([slides, turns], axis=2).reshape(len(K), -1))[0]  # with v − Πv = 0 on facets
    K += np.trace(K) / len(K) * Q @ Q.T
    half = scipy.linalg.solve_triangular(np.linalg.cholesky(K), np.kron(sides, np.eye(AXES)).T, lower=True)
    area = 0.5 * float(np.linalg.norm(np.cross(points[2] - points[1], points[3] - points[1])))
    return area * float(np.linalg.norm(half, 2)) ** 2


@cache
def polynomials(degree: int) -> tuple[Array, Array, Array]:
    """Return three matrices of the polynomials of a degree, orthonormal in a cell.

    The number of polynomials is a. The matrices are:

    - The means of products of their slopes by the last three barycentric coordinates,
      `(a, 3, a, 3)`.
    - The means of their products with all four coordinates, `(a, 4)`.
    - Their non-quadratic parts on the facet of the last three corners, in b orthonormal
      functions, `(b, a)`.
    """
    powers = np.array([each for each in product(range(degree + 1), repeat=AXES) if sum(each) <= degree])
    x, w = conical(2 * degree)
    y, v = get_quadrature(ElementTriP2(), 2 * degree)
    side, v = np.vstack([1.0 - y.sum(axis=0), y]), v / v.sum()
    basis = np.linalg.inv(np.linalg.qr((monomials(powers, x) * np.sqrt(w)).T)[1]).T
    lower = [np.maximum(powers - unit, 0) for unit in np.eye(AXES, dtype=int)]
    slopes = [basis @ (powers[:, [axis]] * monomials(less, x)) for axis, less in enumerate(lower)]
    on_side = (basis @ monomials(powers, side)) * np.sqrt(v)
    Q = np.linalg.qr((quadratic(side, SIDES) * np.sqrt(v)).T)[0]
    parts, sizes, _ = np.linalg.svd(on_side - (on_side @ Q) @ Q.T, full_matrices=False)
    rank = (degree + 1) * (degree + 2) // 2 - NODES
    coordinates = (basis @ monomials(powers, x) * w) @ np.vstack([1.0 - x.sum(axis=0), x]).T
    return np.einsum("iaq,jbq,q->aibj", slopes, slopes, w, optimize=True), coordinates, (parts * sizes)[:, :rank].T


def monomials(powers: Array, at: Array) -> Array:
    """Return monomials of `powers` `(a, 3)` at points `(3, k)`, shape `(a, k)`."""
    return np.asarray(np.prod(at[None] ** powers[..., None], axis=1))


def conical(order: int) -> tuple[Array, Array]:
    """Return points `(3, k)` and weights `(k,)` of a quadrature rule of a cell.

    The rule is exact for polynomials up to the degree `order`. The weights sum to 1.
    """
    rules = [roots_jacobi(order // 2 + 1, power, 0.0) for power in (2.0, 1.0, 0.0)]
    u, v, w = np.meshgrid(*(0.5 * (x + 1.0) for x, _ in rules), indexing="ij")
    weights = np.einsum("i,j,k->ijk", *(each for _, each in rules)).ravel()
    return np.stack([u, v * (1.0 - u), w * (1.0 - u) * (1.0 - v)]).reshape(AXES, -1), weights / weights.sum()
