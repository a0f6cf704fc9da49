"""A patch of an organ's cells, held where it was cut out: its compliance as it is, of second order, and finer.

The cells keep their shape, material and clamps, so layers, edges, thin and curved walls are what they are in the organ.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_matrix, csr_matrix
from skfem import Basis, ElementTetP2, ElementVector, MeshTet

from tissue.arrays import Array, Indices
from tissue.elasticity import NO_POINTS, Elasticity, cellwise_lambda, reference_slopes
from tissue.material import Material, PerCell
from tissue.sites.bisection import Bisected, bisect
from tissue.sites.surface import Surface, outer_surface
from tissue.solvers.direct import LIBRARIES, is_installed
from tissue.solvers.factor import factorize

Mask = NDArray[np.bool_]

FAR, CLOSE = 0.1381966011250105, 0.5854101966249685  # (5 − √5)/20 and (5 + 3√5)/20: four points, exact to degree two
AXES, LOCAL = 3, 10  # of space; shape functions of a quadratic tetrahedron
CHUNK = 256  # cells whose matrices are made at once: they fit into the cache


@dataclass(frozen=True)
class Patch:
    """Some `cells` `(c,)` of an organ, of all others cut off."""

    body: Elasticity
    cells: Indices

    def compliance(self, rows: csr_matrix) -> Array:
        """Return the compliance to the variables that are `rows` `(k, N)` of the organ, by its own mesh, `(k, k)`."""
        body = self.body
        others = np.delete(np.arange(body.mesh.nelements), self.cells)
        nodes = np.setdiff1d(body.cells[self.cells], body.cells[others])
        return _compliance(body, np.setdiff1d(body.nodes[nodes], body.clamped), rows)

    def refined_compliance(
        self, size: Callable[[Array], Array], rows: Callable[[Elasticity, Surface], csr_matrix]
    ) -> Array:
        """Return the compliance by quadratic cells no larger than `size` [m] of their corners `(c, 4, 3)`.

        `rows` makes the variables' rows `(k, N)` on another mesh of the same body; the compliance is `(k, k)`.
        """
        fine, surface = self.refined(size)
        return _compliance(fine, fine.free, rows(fine, surface))

    def refined(self, size: Callable[[Array], Array]) -> tuple[Elasticity, Surface]:
        """Return the patch as a body of its own, at rest and so without mass, and its surface without the cut."""
        parts = self.bisected(size)
        mesh = MeshTet(np.ascontiguousarray(parts.points.T), np.ascontiguousarray(parts.cells.T))
        basis = Basis(mesh, ElementVector(ElementTetP2()), quadrature=NO_POINTS)
        within, cut = self._facets(mesh, parts)
        K, material = self._stiffness(basis, self.cells[parts.parents])
        clamped = _unknowns(basis, mesh.boundary_facets(), within)
        free = np.setdiff1d(np.arange(basis.N), clamped)
        fine = Elasticity(mesh, "P2", material, basis, K, csr_matrix(K.shape), clamped, free)
        outer = outer_surface(mesh)
        own = np.flatnonzero(~cut)
        return fine, Surface(mesh, outer.triangles[own], outer.normals[own], outer.behind[own], outer.vertices[own])

    def bisected(self, size: Callable[[Array], Array]) -> Bisected:
        """Return the cells bisected to `size`; parents are counted within the patch."""
        vertices, corners = np.unique(self.body.mesh.t[:, self.cells].T, return_inverse=True)
        return bisect(self.body.mesh.p.T[vertices], corners.reshape(-1, AXES + 1), size)

    def _facets(self, mesh: MeshTet, parts: Bisected) -> tuple[Mask, Mask]:
        """Return of each facet on the boundary of the bisected `mesh` which components are held `(f, 3)`, and whether
        it lies in the cut `(f,)`."""
        coarse, facets = self.body.mesh, mesh.boundary_facets()
        parents = self.cells[parts.parents[mesh.f2t[0, facets]]]
        corners = coarse.p.T[coarse.t[:, parents].T]
        offset = mesh.p[:, mesh.facets[:, facets]].mean(axis=1).T - corners[:, 0]
        inner = np.linalg.solve(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2), offset[..., None])[..., 0]
        opposite = np.column_stack([1.0 - inner.sum(axis=1), inner]).argmin(axis=1)
        beside = coarse.t2f[:, parents]  # of its four facets the one without the opposite corner
        without = ~(coarse.facets[:, beside] == coarse.t[opposite, parents]).any(axis=0)
        on = beside[without.argmax(axis=0), np.arange(parents.size)]
        cut = coarse.f2t[1, on] >= 0
        held = np.isin(self.body.nodes[coarse.facets[:, on]], self.body.clamped).all(axis=0)
        return held | cut[:, None], cut

    def _stiffness(self, basis: Basis, cells: Indices) -> tuple[csr_matrix, Material]:
        """Return the stiffness of the parts of `cells`, and their material."""
        given, count = self.body.material, self.body.mesh.nelements
        E, nu, rho = (
            np.broadcast_to(value, count)[cells] for value in (given.youngs_modulus, given.poisson_ratio, given.density)
        )
        material = Material(E, nu, rho)
        # Where the organ averages the dilatation at its vertices, a quadratic cell averages it over itself.
        cellwise = material.lame_lambda if self.body.pressure is None else cellwise_lambda(material)
        return quadratic_stiffness(basis, cellwise, material.lame_mu, material.lame_lambda - cellwise), material


def _compliance(body: Elasticity, inner: Indices, rows: csr_matrix) -> Array:
    """Return the compliance of `rows` `(k, N)` with all but the `inner` unknowns held, `(k, k)`."""
    method = next(name for name in LIBRARIES if is_installed(name))
    factor = factorize(csr_matrix(body.K[inner][:, inner]), body.basis.doflocs[:, inner].T, method)
    inward = csr_matrix(rows[:, inner])
    return np.asarray(inward @ factor.solve(inward.T.toarray()))


def _unknowns(basis: Basis, facets: Indices, held: Mask) -> Indices:
    """Return the unknowns on `facets` `(f,)` in the components that are `held` `(f, 3)`."""
    mesh = basis.mesh
    corners, ends = (np.sort(part, axis=0).astype(np.int64) for part in (mesh.facets[:, facets], mesh.edges))
    keys = ends[0] * mesh.nvertices + ends[1]
    order = np.argsort(keys)
    sides = corners[[0, 0, 1]] * mesh.nvertices + corners[[1, 2, 2]]
    edges = order[np.searchsorted(keys[order], sides)]
    unknowns = np.concatenate([basis.nodal_dofs[:, corners], basis.edge_dofs[:, edges]], axis=1)
    return np.unique(unknowns[np.broadcast_to(held.T[:, None], unknowns.shape)])


@lru_cache(maxsize=1)
def _slopes() -> Array:
    """Return the slopes of the ten shape functions at the four points of the reference cell, `(10, 3, 4)`."""
    return reference_slopes("P2", (np.full((AXES, 4), FAR) + (CLOSE - FAR) * np.eye(AXES, 4, 1)).T)


def quadratic_stiffness(basis: Basis, lam: PerCell, mu: PerCell, mean: PerCell) -> csr_matrix:
    """Assemble ∫ λ div φ_i div φ_j + 2μ ε(φ_i) : ε(φ_j) dx of quadratic cells with straight edges, `(N, N)` [N/m].

    λ, μ and `mean`, a further λ that acts on a cell's mean dilatation, are one number or one per cell `(c,)` [Pa].
    Straight cells differ by nine slopes alone, so many are made at once, thirty times as fast as form by form.
    """
    count = basis.mesh.nelements
    moduli = np.stack([np.broadcast_to(modulus, count) for modulus in (lam, mu, mean)])
    corners, blocks = basis.mesh.p.T[basis.mesh.t.T], np.empty((count, LOCAL, LOCAL, AXES, AXES))
    for begin in range(0, count, CHUNK):
        part = slice(begin, begin + CHUNK)
        blocks[part] = _local_stiffness(corners[part], moduli[:, part])
    return _assemble(basis, blocks)


def _local_stiffness(corners: Array, moduli: Array) -> Array:
    """Return the blocks `(c, 10, 10, 3, 3)` of cells with `corners` `(c, 4, 3)` and three `moduli` `(3, c)`."""
    edges = corners[:, 1:] - corners[:, :1]
    volume = np.abs(np.linalg.det(edges)) / 6.0
    slopes = np.einsum("nkq,cjk->cqnj", _slopes(), np.linalg.inv(edges), optimize=True).reshape(len(edges), 4, -1)
    pairs = (np.swapaxes(slopes, 1, 2) @ slopes * (volume / 4.0)[:, None, None]).reshape(-1, LOCAL, AXES, LOCAL, AXES)
    lam, mu, mean = moduli[..., None, None, None, None]
    dilatation = slopes.mean(axis=1).reshape(-1, LOCAL, AXES)
    local = lam * pairs + mu * np.swapaxes(pairs, 2, 4)
    local += mean * volume[:, None, None, None, None] * dilatation[:, :, :, None, None] * dilatation[:, None, None]
    local += mu * np.einsum("cnkmk,ij->cnimj", pairs, np.eye(AXES))
    return local.transpose(0, 1, 3, 2, 4)


def _assemble(basis: Basis, blocks: Array) -> csr_matrix:
    """Sum blocks `(c, 10, 10, 3, 3)` between the nodes of each cell into a matrix of all unknowns, node by node."""
    nodes, count = (basis.element_dofs[::AXES] // AXES).T.astype(np.int64), basis.N // AXES
    keys = (nodes[:, :, None] * count + nodes[:, None]).ravel()
    order = np.argsort(keys, kind="stable")
    keys, first = np.unique(keys[order], return_index=True)
    data = np.add.reduceat(blocks.reshape(-1, AXES * AXES)[order], first, axis=0).reshape(-1, AXES, AXES)
    starts = np.searchsorted(keys, np.arange(count + 1) * count)
    return csr_matrix(bsr_matrix((data, keys % count, starts), shape=(basis.N, basis.N)))
