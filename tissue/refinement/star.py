"""A stress in equilibrium with a load, constructed star by star.

The stress is constructed from the stress σ_h of quadratic displacements. A star is the set of cells
around a vertex i. With its hat function ψ_i, the stress θ_i on the star solves

    minimise ‖θ_i − ψ_i σ_h‖  with  div θ_i = σ_h ∇ψ_i,
                                    θ_i n = ψ_i t on free facets,  θ_i n = 0 where the star ends.

Since Σ ψ_i = 1, Σ θ_i has no divergence and has the traction t (Ladevèze and Leguillon, SIAM J.
Numer. Anal. 20, 1983; Braess and Schöberl, Math. Comp. 77, 2008). A star that can move as a rigid
body is in balance: ψ_i times a rigid motion is a quadratic displacement, and σ_h is in equilibrium
for all quadratic displacements.

θ_i is symmetric and quadratic on four parts of a cell, which meet at the cell's centre. Its
tractions are continuous. With these parts, every quadratic traction on the facets of a cell is
possible (Johnson and Mercier, Numer. Math. 30, 1978, in the plane). The multipliers of equilibrium
are displacements, linear in each part. The multipliers of the tractions are quadratic on facets.
After elimination of the inner multipliers, a cell has a stiffness matrix over the 72 multipliers of
its facets, and a star is solved like a small organ.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from skfem import ElementTetP2, ElementTriP2, MeshTet
from skfem.quadrature import get_quadrature

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity, shape_gradients
from tissue.errors import TissueError
from tissue.material import Material
from tissue.refinement.refine import OPPOSITE

log = logging.getLogger(__name__)

AXES, CORNERS, NODES = 3, 4, 6  # NODES: of a facet
OF_FACET, OF_CELL = AXES * NODES, AXES * NODES * CORNERS  # multipliers of a facet, and of the facets of a cell
EDGES = list(combinations(range(CORNERS), 2))
SIDES = list(combinations(range(3), 2))
OTHERS = np.array([[k for k in range(CORNERS) if k != j] for j in range(CORNERS)])
WITHIN = AXES * (CORNERS * CORNERS + len(EDGES) * NODES)  # multipliers inside a cell: of parts, and between parts
TOGETHER = 64  # cells whose matrices are computed together: 60 MB
UNBALANCED = 1e-6  # of the loads of all stars: a larger sum is out of balance; the error of the columns is far smaller
FIXED = 1e-9  # of the largest singular value: a rigid motion with a smaller value is not held


@dataclass(frozen=True)
class Pull:
    """A unit force on a footprint, facet by facet.

    `cells` `(k,)` are behind the facets, and `opposite` `(k,)` is the corner opposite to each
    facet, with the vertices of a cell in ascending order. `moments` `(k, 3, 6)` [-] are the moments
    of the traction with products of a linear and a quadratic shape function of the facet. `missed`
    `(k,)` [m/N] bounds the energy of the part of the traction that is not quadratic.
    """

    cells: Indices
    opposite: Indices
    moments: Array
    missed: Array


def quadratic(at: Array, pairs: Sequence[tuple[int, int]]) -> Array:
    """Return the quadratic shape functions at barycentric coordinates `(n, k)`.

    The result has shape `(n + pairs, k)`. The functions of the corners come first, then the
    functions of the middles of `pairs` of corners.
    """
    return np.vstack([at * (2.0 * at - 1.0), *([4.0 * at[a] * at[b]] for a, b in pairs)])


def hat_gradients(points: Array) -> Array:
    """Return the gradients of the barycentric coordinates of cells, `(c, 4, 3)` [1/m].

    The cells have corners `points` `(c, 4, 3)` [m].
    """
    inner = np.linalg.inv(points[:, 1:] - points[:, :1]).swapaxes(1, 2)
    return np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)


class Means(NamedTuple):
    """Means of products of shape functions, which are the same in any cell.

    `facet` `(6, 6)` are the means for two quadratic functions on a facet. `thrice` `(3, 3, 6)` are
    for two linear functions and a quadratic one on a facet. `strains` `(28, 4, 28, 4)` give the
    energy of a part, from two of its multipliers and the gradients of two linear functions. The
    multipliers of the corners of the part come before the multipliers of its facets. `hats`
    `(16, 4)` are for a linear function of a part and a hat function of the cell, by part and
    corner.
    """

    facet: Array
    thrice: Array
    strains: Array
    hats: Array


def means() -> Means:
    """Return the means, by exact quadrature rules."""
    (x, w), (y, v) = (get_quadrature(element(), 6) for element in (ElementTetP2, ElementTriP2))
    cell, side = (np.vstack([1.0 - at.sum(axis=0), at]) for at in (x, y))
    w, v = w / w.sum(), v / v.sum()
    shapes, on_side = quadratic(cell, EDGES), quadratic(side, SIDES)
    facet = (on_side * v) @ on_side.T
    strain = np.zeros((CORNERS + CORNERS * NODES, len(shapes), CORNERS))
    strain[:CORNERS] = -np.einsum("cq,alq,q->cal", cell, slopes_of(cell), w)
    for j, others in enumerate(OTHERS.tolist()):
        nodes = [*others, *(CORNERS + EDGES.index((others[a], others[b])) for a, b in SIDES)]
        strain[CORNERS + NODES * j : CORNERS + NODES * (j + 1), nodes, j] = -3.0 * facet  # area n = −3 V ∇λ
    mass = np.linalg.inv((shapes * w) @ shapes.T)
    values = np.array([np.vstack([np.eye(CORNERS)[others], np.full(CORNERS, 0.25)]) for others in OTHERS])
    return Means(
        facet,
        np.einsum("fq,vq,bq,q->fvb", side, side, on_side, v),
        np.einsum("xal,ab,ybm->xlym", strain, mass, strain, optimize=True),
        np.einsum("cd,jdi->jci", (1.0 + np.eye(CORNERS)) / 20.0, values).reshape(-1, CORNERS),
    )


def slopes_of(cell: Array) -> Array:
    """Return the derivatives of the quadratic shape functions, shape `(10, 4, k)`.

    The derivatives are with respect to the barycentric coordinates. `cell` `(4, k)` are the
    barycentric coordinates of the points.
    """
    slopes = np.zeros((CORNERS + len(EDGES), CORNERS, cell.shape[1]))
    slopes[range(CORNERS), range(CORNERS)] = 4.0 * cell - 1.0
    for n, (a, b) in enumerate(EDGES, CORNERS):
        slopes[n, a], slopes[n, b] = 4.0 * cell[b], 4.0 * cell[a]
    return slopes


def part_numbers() -> Indices:
    """Return the multiplier numbers of each part of a cell, `(4, 84)`.

    Multipliers inside the cell come first.
    """
    rows = []
    for j, others in enumerate(OTHERS.tolist()):
        between = [EDGES.index((others[a], others[b])) for a, b in reversed(SIDES)]  # opposite to the other corners
        facets = [*(CORNERS**2 + NODES * edge for edge in between), WITHIN // AXES + NODES * j]
        rows.append(np.concatenate([CORNERS * j + np.arange(CORNERS), *(first + np.arange(NODES) for first in facets)]))
    return (AXES * np.array(rows)[..., None] + np.arange(AXES)).reshape(CORNERS, -1)


MEANS, PARTS = means(), part_numbers()


def isotropic(N: Array, lam: Array, mu: Array) -> Array:
    """Return the stiffness `(c, x, 3, y, 3)` of an isotropic material.

    `N` `(c, x, 3, y, 3)` are products of strains. `lam` and `mu` `(c,)` are λ and μ.
    """
    lam, mu = (modulus[:, None, None, None, None] for modulus in (lam, mu))
    K = mu * N.swapaxes(2, 4) + lam * N
    trace = mu[..., 0, 0] * np.einsum("cxiyi->cxy", N)
    for axis in range(AXES):
        K[:, :, axis, :, axis] += trace
    return np.asarray(K)


class Cells(NamedTuple):
    """Matrices of cells over the multipliers of their facets.

    `stiffness` has shape `(c, 72, 72)`. `drag` `(c, 72, 4, 3)` are the forces of a unit divergence
    of σ_h along x, y and z times the hat function of each corner. `inner` `(c, 3, 3)` is the inner
    energy of this divergence.
    """

    stiffness: Array
    drag: Array
    inner: Array


def condensed(points: Array, lam: Array, mu: Array) -> Cells:
    """Return the matrices of cells, with the inner multipliers eliminated.

    The cells have corners `points` `(c, 4, 3)` [m] and moduli `lam` and `mu` `(c,)` [Pa].
    """
    count, volume = len(points), np.abs(np.linalg.det(points[:, 1:] - points[:, :1])) / (6.0 * CORNERS)
    whole = np.zeros((count, WITHIN + OF_CELL, WITHIN + OF_CELL))
    for others, numbers in zip(OTHERS, PARTS, strict=True):
        slopes = hat_gradients(np.concatenate([points[:, others], points.mean(axis=1, keepdims=True)], axis=1))
        half = np.einsum("xlym,cmj->cxlyj", MEANS.strains, slopes, optimize=True)
        N = np.einsum("cli,cxlyj->cxiyj", slopes * volume[:, None, None], half, optimize=True)
        whole[:, numbers[:, None], numbers] += isotropic(N, lam, mu).reshape(count, numbers.size, numbers.size)
    sources = np.zeros((count, WITHIN, CORNERS, AXES))
    for axis in range(AXES):
        sources[:, axis : AXES * CORNERS**2 : AXES, :, axis] = volume[:, None, None] * MEANS.hats
    across = whole[:, :WITHIN, WITHIN:]
    given = np.concatenate([across, sources.reshape(count, WITHIN, -1)], axis=2)
    solved = np.linalg.solve(whole[:, :WITHIN, :WITHIN], given)
    both = across.swapaxes(1, 2) @ solved
    inside = solved[:, :, OF_CELL:].reshape(sources.shape).sum(axis=2)
    drag = both[:, :, OF_CELL:].reshape(count, OF_CELL, CORNERS, AXES)
    return Cells(whole[:, WITHIN:, WITHIN:] - both[:, :, :OF_CELL], drag, sources.sum(axis=2).swapaxes(1, 2) @ inside)


@dataclass(frozen=True)
class Field:
    """σ_h of n columns.

    `stress` `(c, 4, 3, 3, n)` is the stress at the corners of each cell, linear in between.
    `divergence` is its divergence `(c, 3, n)`. `pulls` has for each loaded facet the list of goals
    and their moments `(3, 6)`.
    """

    stress: Array
    divergence: Array
    pulls: dict[int, list[tuple[int, Array]]]


@dataclass(frozen=True)
class Star:
    """The cells around a vertex, and their facets.

    The vertex is the corner `place` `(k,)` of each of the `cells` `(k,)`. `facets` `(f,)` share the
    vertex, and `local` `(k, 3)` are the facets of each cell among them. `first` `(f,)` gives one
    cell and side for each facet: cell times three plus side.
    """

    cells: Indices
    place: Indices
    facets: Indices
    local: Indices
    first: Indices

    @property
    def sides(self) -> Indices:
        """The corners of the cells opposite to the facets that share the vertex, `(k, 3)`."""
        return np.asarray(OTHERS[self.place])

    @property
    def near(self) -> Indices:
        """Multipliers of the facets that share the vertex, by number in each cell, `(k, 54)`."""
        return (OF_FACET * self.sides[..., None] + np.arange(OF_FACET)).reshape(len(self.cells), -1)

    @property
    def far(self) -> Indices:
        """Multipliers of the facet opposite to the vertex, by number in each cell, `(k, 18)`."""
        return np.asarray(OF_FACET * self.place[:, None] + np.arange(OF_FACET))

    @property
    def numbers(self) -> Indices:
        """The numbers of the `near` multipliers in the star, `(k, 54)`."""
        return (OF_FACET * self.local[..., None] + np.arange(OF_FACET)).reshape(len(self.cells), -1)


@dataclass(frozen=True)
class Stars:
    """The stars of the vertices of a `mesh` of a linear `material`.

    `held` `(f, 3)` says which components of each facet are held.
    """

    mesh: MeshTet
    material: Material
    held: NDArray[np.bool_]

    @cached_property
    def order(self) -> Indices:
        """The corners of each cell in ascending order of the vertex, `(c, 4)`.

        Both cells of a facet then have the vertices of the facet in the same order.
        """
        return np.argsort(self.mesh.t.T, axis=1)

    @cached_property
    def corners(self) -> Indices:
        """Vertices of each cell in ascending order, `(c, 4)`."""
        return np.take_along_axis(self.mesh.t.T, self.order, axis=1)

    @cached_property
    def points(self) -> Array:
        """Positions of the `corners`, `(c, 4, 3)` [m]."""
        return self.mesh.p.T[self.corners]

    @cached_property
    def facets(self) -> Indices:
        """The facet opposite to each of the `corners`, `(c, 4)`."""
        return np.take_along_axis(self.mesh.t2f.T[:, OPPOSITE], self.order, axis=1)

    @cached_property
    def gradients(self) -> Array:
        """Gradients of the hat functions in each cell, `(c, 4, 3)` [1/m]."""
        return hat_gradients(self.points)

    @cached_property
    def areas(self) -> Array:
        """Outward normals of the facets of each cell times their areas, `(c, 4, 3)` [m²]."""
        six_volumes = np.abs(np.linalg.det(self.points[:, 1:] - self.points[:, :1]))
        return np.asarray(-0.5 * six_volumes[:, None, None] * self.gradients)

    @cached_property
    def moduli(self) -> tuple[Array, Array]:
        """λ and μ of each cell, `(c,)` each [Pa]."""
        material, count = self.material, self.mesh.nelements
        return np.broadcast_to(material.lame_lambda, count), np.broadcast_to(material.lame_mu, count)

    @cached_property
    def cells(self) -> Cells:
        """The matrices of all cells."""
        count, (lam, mu) = self.mesh.nelements, self.moduli
        log.info("bounds of the compliance: matrices of %d cells", count)
        some = [slice(first, first + TOGETHER) for first in range(0, count, TOGETHER)]
        parts = [condensed(self.points[part], lam[part], mu[part]) for part in some]
        return Cells(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def field(self, body: Elasticity, W: Array, pulls: Sequence[Pull]) -> Field:
        """Return σ_h of the columns W `(N, 3g)` [m/N] of a quadratic body.

        The columns belong to unit forces along x, y and z on g goals with their `pulls`.
        """
        slopes = shape_gradients(body, np.vstack([np.zeros(AXES), np.eye(AXES)]))
        H = np.einsum("cpnj,cnik->cpijk", slopes, W[body.nodes[body.cells]], optimize=True)
        lam, mu = (modulus[:, None, None, None, None] for modulus in self.moduli)
        stress = mu * (H + H.swapaxes(2, 3))
        stress += lam * np.eye(AXES)[..., None] * np.einsum("cpiik->cpk", H)[:, :, None, None]
        stress = np.take_along_axis(stress, self.order[..., None, None, None], axis=1)
        loaded: dict[int, list[tuple[int, Array]]] = {}
        for goal, pull in enumerate(pulls):
            facets = self.facets[pull.cells, pull.opposite].tolist()
            for facet, moments in zip(facets, pull.moments, strict=True):
                loaded.setdefault(facet, []).append((goal, moments))
        return Field(stress, np.einsum("cpijk,cpj->cik", stress, self.gradients), loaded)

    def excess(self, field: Field) -> Array:
        """Return ‖θ − σ_h‖² of each column, `(n,)` [m/N].

        Raises `TissueError` if the stars are not in balance.
        """
        divergence, cells = field.divergence, self.cells
        moved, balance = np.zeros((len(divergence), OF_CELL, divergence.shape[2])), np.zeros(2)
        for star in self._stars():
            balance += self._add(moved, star, field)
        if balance[0] > UNBALANCED**2 * balance[1]:
            raise TissueError(
                "bounds of the compliance: cells around a vertex are joined only at an edge or a point, so that their "
                "stress cannot be balanced; join them by facets, or leave tissue.mesh.bound out"
            )
        energy = np.einsum("cxk,cxy,cyk->k", moved, cells.stiffness, moved, optimize=True)
        return np.asarray(energy + np.einsum("cik,cij,cjk->k", divergence, cells.inner, divergence, optimize=True))

    def _stars(self) -> Iterator[Star]:
        """Yield the star of each vertex."""
        order = np.argsort(self.corners.ravel(), kind="stable")
        ends = np.cumsum(np.bincount(self.corners.ravel(), minlength=self.mesh.nvertices))
        for own in (part for part in np.split(order, ends[:-1]) if part.size):
            cells, place = own // CORNERS, own % CORNERS
            every = self.facets[cells[:, None], OTHERS[place]]
            facets, first, local = np.unique(every, return_index=True, return_inverse=True)
            yield Star(cells, place, facets, local.reshape(every.shape), first)

    def _add(self, moved: Array, star: Star, field: Field) -> Array:
        """Add the multipliers of a star to `moved`, and return two sums of squares.

        The first sum is of the star's unbalanced loads, and the second of all its loads. `moved`
        `(c, 72, n)` has the multipliers of all facets, cell by cell.
        """
        forces, S, rows = self._forces(star, field), self.cells.stiffness[star.cells], np.arange(len(star.cells))
        near, far, numbers, whole = star.near, star.far, star.numbers, rows[:, None, None]
        across = S[whole, far[:, :, None], near[:, None]]
        given = np.concatenate([across, forces[rows[:, None], far]], axis=2)
        solved = np.linalg.solve(S[whole, far[:, :, None], far[:, None]], given)
        turn, alone = solved[:, :, : near.shape[1]], solved[:, :, near.shape[1] :]
        stiff = S[whole, near[:, :, None], near[:, None]] - across.swapaxes(1, 2) @ turn
        A, b = np.zeros((OF_FACET * star.facets.size,) * 2), self._pulled(star, field)
        loads = forces[rows[:, None], near] - across.swapaxes(1, 2) @ alone
        for number, matrix, load in zip(numbers, stiff, loads, strict=True):
            A[number[:, None], number] += matrix
            b[number] += load
        free = ~np.repeat(self.held[star.facets], NODES, axis=0).ravel()
        motions = self._motions(star, free)
        x, unbalanced = np.zeros_like(b), motions.T @ b[free]
        x[free] = solved_with(A[free][:, free], b[free], motions)
        moved[star.cells[:, None], near] += x[numbers]
        moved[star.cells[:, None], far] += alone - turn @ x[numbers]
        return np.array([np.sum(unbalanced**2), np.sum(b[free] ** 2)])

    def _forces(self, star: Star, field: Field) -> Array:
        """Return the forces of σ_h times the vertex's hat function, `(k, 72, n)`.

        The forces act on the multipliers of each cell.
        """
        rows, cells = np.arange(len(star.cells)), star.cells
        dragged = np.einsum("cxi,cik->cxk", self.cells.drag[cells, :, star.place], field.divergence[cells])
        forces = -dragged.reshape(rows.size, CORNERS, NODES, AXES, -1)
        for side in star.sides.T:
            corners = OTHERS[side]
            thrice = MEANS.thrice[np.argmax(corners == star.place[:, None], axis=1)]
            traction = np.einsum("cvijk,cj->cvik", field.stress[cells[:, None], corners], self.areas[cells, side])
            forces[rows, side] -= np.einsum("cvb,cvik->cbik", thrice, traction)
        return np.asarray(forces.reshape(rows.size, OF_CELL, -1))

    def _pulled(self, star: Star, field: Field) -> Array:
        """Return the footprint loads times the hat function on the facets of a star, `(18f, n)`."""
        forces = np.zeros((star.facets.size, NODES, AXES, field.divergence.shape[2]))
        for row, facet in enumerate(star.facets.tolist()):
            cell, side = divmod(int(star.first[row]), 3)
            at = int(np.argmax(OTHERS[star.sides[cell, side]] == star.place[cell]))
            for goal, moments in field.pulls.get(facet, ()):
                for axis in range(AXES):
                    forces[row, :, axis, AXES * goal + axis] = moments[at]
        return forces.reshape(OF_FACET * star.facets.size, -1)

    def _motions(self, star: Star, free: NDArray[np.bool_]) -> Array:
        """Return the rigid motions that the supports of a star allow, as orthonormal columns.

        The columns have shape `(k, d)`. Their rows are the `free` multipliers of the star's facets.
        """
        cell, side = np.divmod(star.first, 3)
        corners = OTHERS[star.sides[cell, side]]
        at = self.points[star.cells[cell][:, None], corners] - self.points[star.cells[0], star.place[0]]
        at = np.concatenate([at, *(0.5 * (at[:, [a]] + at[:, [b]]) for a, b in SIDES)], axis=1).reshape(-1, AXES)
        turns = np.cross(np.eye(AXES), at[:, None] / np.abs(at).max()).swapaxes(1, 2)
        motions = np.concatenate([np.broadcast_to(np.eye(AXES), turns.shape), turns], axis=2).reshape(-1, 2 * AXES)
        if not free.all():
            motions = motions @ scipy.linalg.null_space(motions[~free], rcond=FIXED)
        return np.asarray(np.linalg.qr(motions[free])[0])


def solved_with(A: Array, b: Array, motions: Array) -> Array:
    """Return x `(k, n)` with A x = b for a singular matrix A `(k, k)`.

    A is singular for the orthonormal `motions` `(k, d)`.
    """
    A = A + np.trace(A) / len(A) * motions @ motions.T
    return np.asarray(scipy.linalg.cho_solve(scipy.linalg.cho_factor(A, overwrite_a=True, check_finite=False), b))
