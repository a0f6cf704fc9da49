"""A patch of an organ's cells, held where it was cut out: its compliance as it is, of second order, and finer.

The cells keep their shape, material and clamps, so layers, edges, thin and curved walls are what they are in the organ.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from skfem import Basis, MeshTet

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity, cellwise_lambda, numbering
from tissue.material import Material, PerCell
from tissue.refinement.refine import Refined, refine_to
from tissue.sites.surface import Surface, outer_surface
from tissue.solvers.direct import LIBRARIES, is_installed
from tissue.solvers.factor import factorize

Mask = NDArray[np.bool_]

AXES = 3  # of space


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
        mesh = parts.mesh
        basis = numbering(mesh, "P2")
        within, cut = self._facets(parts)
        K, material = self._stiffness(basis, self.cells[parts.parents])
        clamped = _unknowns(basis, mesh.boundary_facets(), within)
        free = np.setdiff1d(np.arange(basis.N), clamped)
        fine = Elasticity(mesh, "P2", material, basis, K, csr_matrix(K.shape), clamped, free)
        outer = outer_surface(mesh)
        own = np.flatnonzero(~cut)
        return fine, Surface(mesh, outer.triangles[own], outer.normals[own], outer.behind[own], outer.vertices[own])

    def bisected(self, size: Callable[[Array], Array]) -> Refined:
        """Return the cells bisected to `size`; parents are counted within the patch, facets in the organ."""
        coarse = self.body.mesh
        vertices, corners = np.unique(coarse.t[:, self.cells], return_inverse=True)
        own = MeshTet(np.ascontiguousarray(coarse.p[:, vertices]), corners.reshape(AXES + 1, -1))
        of = np.empty(own.nfacets, np.intp)
        of[own.t2f] = coarse.t2f[:, self.cells]
        parts = refine_to(own, size)
        return Refined(parts.mesh, parts.parents, np.where(parts.sides < 0, parts.sides, of[parts.sides]))

    def _facets(self, parts: Refined) -> tuple[Mask, Mask]:
        """Return of each facet on the boundary of the bisected cells which components are held `(f, 3)`, and whether it
        lies in the cut `(f,)`."""
        coarse, on = self.body.mesh, parts.sides[parts.mesh.boundary_facets()]
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
    # Minimum degree left CHOLMOD as much to do as a dissection, of 114 000 unknowns too, and is found in less time.
    places = None if method == "cholmod" else body.basis.doflocs[:, inner].T
    factor = factorize(csr_matrix(body.K[inner][:, inner]), places, method, one_of_many=True)
    return factor.compliance(csr_matrix(rows[:, inner]))


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


def quadratic_stiffness(basis: Basis, lam: PerCell, mu: PerCell, mean: PerCell) -> csr_matrix:
    """Assemble ∫ λ div φ_i div φ_j + 2μ ε(φ_i) : ε(φ_j) dx of quadratic cells with straight edges, `(N, N)` [N/m].

    λ, μ and `mean`, a further λ that acts on a cell's mean dilatation, are one number or one per cell `(c,)` [Pa].
    """
    from tissue import assembly  # loads Numba

    graph = assembly.cell_graph(basis.element_dofs[::AXES].T // AXES, basis.N // AXES)
    gradients, volumes = assembly.barycentric_gradients(basis.mesh.p.T, graph)
    means, none = assembly.reference_means(basis.elem.elem), np.zeros_like(volumes)
    K, _ = assembly.stiffness_and_mass(graph, means, gradients, volumes * lam, volumes * mu, none)
    if not np.any(mean):
        return K
    averaged, _ = assembly.stiffness_and_mass(graph, means.apart, gradients, volumes * mean, none, none)
    return csr_matrix((K.data + averaged.data, K.indices, K.indptr), shape=K.shape)
