"""Small-strain isotropic linear elasticity on tetrahedra, with scikit-fem's elements and bases.

Nearly incompressible tissue locks if every cell must keep its own volume at every point, because a
tetrahedral mesh has five to six cells per vertex. For such tissue only a part of λ acts at each
point, and the excess acts on averages of the dilatation:

- "nodal": the excess over λ at ν = 0.3 acts on averages at the vertices, which is one constraint per
  vertex (Bonet & Burton, Commun. Numer. Meth. Engng 14, 1998). With P2 it is the pressure of the
  Taylor–Hood element with a lumped mass. Nodes two cells apart are joined, so that a factor takes up
  to 13 (P1) or 28 times (P2) as long.
- "mean": the excess over λ at ν = 0.45 acts on the mean over each P2 cell (the P2–P0 element). No
  further nodes are joined. At ν = 0.4999 errors are at most 1.5 times those at 0.45 on the same mesh,
  and up to 2.5 times those of "nodal" (a bonded layer, Lamé modes).

The rest of λ resists modes that the averages do not see (Puso & Solberg, Int. J. Numer. Meth. Engng
67, 2006), and cells that would invert. Up to the ν of that rest all formulations are equal, unless
the tissue relaxes (`cellwise_lambda`).

The matrices are summed by compiled loops (`tissue.assembly`), in a twentieth to a fortieth of the
time of scikit-fem's forms (24,000 to 220,000 unknowns).
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags_array
from skfem import Basis, Element, ElementTetP0, ElementTetP1, ElementTetP2, ElementVector, MeshTet
from skfem.quadrature import get_quadrature

from tissue import assembly
from tissue.arrays import Array, Indices
from tissue.errors import TissueError
from tissue.material import Material, PerCell
from tissue.shapes import shapes
from tissue.supports import held_unknowns

log = logging.getLogger(__name__)

ELEMENTS = {"P1": ElementTetP1, "P2": ElementTetP2}
DILATATIONS = ("auto", "cell", "mean", "nodal")
# ν above which "auto" averages: the error of a P1 layer is 1.7 times that at ν = 0.3, and 3.6 times at 0.49
NU_LOCKING = 0.45
NU_CELLWISE = {"nodal": 0.3, "mean": NU_LOCKING}  # ν of the λ that acts at each point
ROUND_OFF = 1e-12  # of λ: a smaller excess would soften the averages that its cell shares
VERTICES = 4  # of a tetrahedron: a gradient that is linear in a cell is largest at a vertex
NO_POINTS = (np.zeros((3, 0)), np.zeros(0))  # the basis only numbers unknowns; shape functions are computed elsewhere


@dataclass(frozen=True)
class Elasticity:
    """The discrete organ: M Ü + K U = f over `N` displacement unknowns, some of them clamped.

    Made by `elasticity`. `K` [N/m] and `M` [kg] are over all unknowns, shape `(N, N)`. Every
    unknown is either in `clamped` or in `free`. `dilatation` is "cell", "mean" or "nodal".
    `pressure` [Pa/m], shape `(averages, N)`, gives the averaged part of λ div U; None with "cell".
    """

    mesh: MeshTet
    element: str
    material: Material
    basis: Basis
    K: csr_matrix
    M: csr_matrix
    clamped: Indices
    free: Indices
    dilatation: str = "cell"
    pressure: csr_matrix | None = None

    @property
    def N(self) -> int:
        """Number of displacement unknowns, clamped ones included."""
        return int(self.K.shape[0])

    @cached_property
    def cell(self) -> Element:
        """The element of one component of the displacement."""
        return ELEMENTS[self.element]()

    @property
    def averages(self) -> tuple[Indices, Element]:
        """The averages of a "mean" or "nodal" dilatation in which a cell takes part, `(j, c)`, and the
        element of their weights ψ.
        """
        return averages_of(self.mesh, self.dilatation)

    @cached_property
    def rule(self) -> tuple[Array, Array]:
        """Quadrature points `(a, 3)` and weights `(a,)` in the reference cell, exact for the square of
        a strain.
        """
        places, weights = get_quadrature(self.cell, max(1, 2 * self.cell.maxdeg - 2))
        return np.ascontiguousarray(places.T), weights

    @cached_property
    def nodes(self) -> Indices:
        """Unknowns of each node, shape `(m, 3)`: vertices first, then (P2) the middles of the
        edges.
        """
        blocks = [self.basis.nodal_dofs.T]
        if self.element == "P2":
            blocks.append(self.basis.edge_dofs.T)
        return np.vstack(blocks).astype(np.intp)

    @cached_property
    def held(self) -> NDArray[np.bool_]:
        """Which components of each node are clamped, shape `(m, 3)`."""
        return np.isin(self.nodes, self.clamped)

    @cached_property
    def points(self) -> Array:
        """Places of the nodes in the reference shape, shape `(m, 3)` [m]."""
        return np.ascontiguousarray(self.basis.doflocs[:, self.nodes[:, 0]].T)

    @cached_property
    def free_stiffness(self) -> csr_matrix:
        """Stiffness over the free unknowns without stored zeros, a fifth of the entries of a block, `(N, N)` [N/m]."""
        K = csr_matrix(self.K[self.free][:, self.free])
        K.eliminate_zeros()
        return K

    @cached_property
    def places(self) -> Array:
        """Places of the free unknowns in the reference shape, shape `(N, 3)` [m]."""
        return np.asarray(self.basis.doflocs[:, self.free].T)

    @cached_property
    def cells(self) -> Indices:
        """Nodes of each cell, shape `(c, 4)`, or `(c, 10)` for P2 in VTK's order of the quadratic
        tetrahedron.
        """
        # scikit-fem and VTK number the edges alike: 01, 12, 02, 03, 13, 23.
        blocks = [self.mesh.t]
        if self.element == "P2":
            blocks.append(self.mesh.t2e + self.mesh.nvertices)
        return np.ascontiguousarray(np.vstack(blocks).T.astype(np.intp))

    @cached_property
    def cell_edges(self) -> Array:
        """∂x/∂ξ in each cell, shape `(c, 3, 3)` [m]."""
        corners = self.mesh.p.T[self.mesh.t.T]
        return np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)

    @cached_property
    def inverse_edges(self) -> Array:
        """∂ξ/∂x in each cell, shape `(c, 3, 3)` [1/m]."""
        return np.asarray(np.linalg.inv(self.cell_edges))

    @cached_property
    def corner_slopes(self) -> csr_matrix:
        """Matrix from a nodal field `(m,)` to its ∂/∂x_j at the corners of each cell, `(3 a c, m)`
        [1/m].

        The derivatives are largest at the corners. There is a row for each j, corner and cell. With
        P1 there is only one corner, because the gradient is constant. Every frame of the output
        uses this matrix.
        """
        corners = np.asarray(self.cell.doflocs)[:VERTICES]
        return slope_matrix(self, corners if self.element == "P2" else corners[:1])

    @cached_property
    def mean_slopes(self) -> tuple[csr_matrix, Array, Array]:
        """Matrix as `corner_slopes` for the quadrature points of `rule`, these points `(a, 3)` and their
        weights `(a,)`, which sum to 1.
        """
        places, weights = self.rule
        slopes = self.corner_slopes if self.element == "P1" else slope_matrix(self, places)
        return slopes, places, weights / weights.sum()

    @cached_property
    def signed_six_volumes(self) -> Array:
        """Determinant of ∂x/∂ξ in each cell, shape `(c,)` [m³]."""
        return np.asarray(np.linalg.det(self.cell_edges))

    @cached_property
    def six_volumes(self) -> Array:
        """Absolute value of the determinant of ∂x/∂ξ in each cell, shape `(c,)` [m³]."""
        return np.abs(self.signed_six_volumes)

    def edge_numbers(self, edges: Indices) -> Indices:
        """Return the numbers of edges in the mesh, `(k,)`, from their two vertices `(k, 2)`."""
        known, asked = (np.sort(pairs, axis=1) @ [self.mesh.nvertices, 1] for pairs in (self.mesh.edges.T, edges))
        order = np.argsort(known)
        return np.asarray(order[np.searchsorted(known, asked, sorter=order)])

    def facet_nodes(self, triangles: Indices) -> Indices:
        """Return the nodes of facets from their vertices `(f, 3)`.

        The nodes are the vertices; with P2, the middles of the edges follow.

        The edges are in the order 01, 12, 02.
        """
        if self.element == "P1":
            return triangles
        edges = triangles[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2)
        return np.hstack([triangles, self.mesh.nvertices + self.edge_numbers(edges).reshape(-1, 3)])

    def surface_nodes(self, facets: Indices, inwards: bool) -> Indices:
        """Return the nodes of `facets` `(f,)` of the surface, as `facet_nodes` does.

        In their order the normals of the facets point into the body if `inwards`, else out of it.
        """
        mesh = self.mesh
        triangles = mesh.facets[:, facets].T.astype(np.intp)
        inside = self.points[mesh.t[:, mesh.f2t[0, facets]].T].mean(axis=1) - self.points[triangles].mean(axis=1)
        return self.facet_nodes(with_normals_along(self.points, triangles, inside if inwards else -inside))

    def nodal(self, field: Array) -> Array:
        """Return a field over all unknowns `(N,)` as one vector per node, shape `(m, 3)`."""
        return field[self.nodes]

    def rows_of(self, nodes: Indices) -> csr_matrix:
        """Return the matrix from the free unknowns to the displacement of `nodes` `(r,)`, shape
        `(3r, N)`.

        Its entries are ones.
        """
        unknowns = self.nodes[nodes].ravel()
        at = np.arange(unknowns.size), unknowns
        return csr_matrix((np.ones(unknowns.size), at), (unknowns.size, self.N))[:, self.free]

    def flat(self, nodal: Array) -> Array:
        """Return one vector per node `(m, 3)` as a field over all unknowns `(N,)`.

        This is the inverse of `nodal`.
        """
        field = np.empty(self.N)
        field[self.nodes] = nodal
        return field

    def extended(self, field: Array) -> Array:
        """Return a field over the free unknowns with zeros at the clamped ones, shape `(N,)`."""
        full = np.zeros(self.N)
        full[self.free] = field
        return full

    def body_force(self, acceleration: Array) -> Array:
        """Return the load of a uniform acceleration (3,) [m/s²] on the organ's mass, shape `(N,)`
        [N].
        """
        return np.asarray(self.M @ self.flat(np.broadcast_to(np.asarray(acceleration, float), self.nodes.shape)))


def formulation(dilatation: str, element: str, poisson_ratio: PerCell, finite: bool = False) -> str:
    """Return the `dilatation` of `elasticity`, with "auto" resolved.

    P2 cells at `finite` strain, with a factor for every tangent, get "mean" in place of "nodal".
    """
    if dilatation != "auto":
        return dilatation
    averaged = "mean" if finite and element == "P2" else "nodal"
    return averaged if np.max(poisson_ratio) > NU_LOCKING else "cell"


def elasticity(
    mesh: MeshTet,
    material: Material,
    element: str = "P1",
    clamp: Sequence[str] = (),
    dilatation: str = "auto",
    roller: Sequence[str] = (),
) -> Elasticity:
    """Assemble stiffness and consistent mass on `mesh`, clamped at the boundaries named in `clamp`.

    The boundaries named in `roller`, each a plane normal to an axis, are held only along this axis.
    `dilatation` is "cell" (not averaged), "mean" (over each cell), "nodal" (at the vertices), or
    "auto": nodal if ν > 0.45. Raises `TissueError` for an unknown element, dilatation or boundary,
    and for a material whose arrays do not have one value per cell.
    """
    if element not in ELEMENTS:
        raise TissueError(f"element = {element!r}: allowed are 'P1' and 'P2'; take 'P1' for speed")
    if dilatation not in DILATATIONS:
        raise TissueError(f"dilatation = {dilatation!r}: allowed are 'auto', 'cell', 'mean' and 'nodal'; take 'auto'")
    if (element, dilatation) == ("P1", "mean"):
        raise TissueError("dilatation = 'mean': that of a P1 cell is the same at each point; take 'nodal'")
    for name in ("youngs_modulus", "poisson_ratio", "density", "lasting"):
        _check_cells(name, getattr(material, name), mesh)
    log.info("assembling the organ: %d cells", mesh.nelements)
    basis = numbering(mesh, element)
    held = np.zeros(basis.N, dtype=bool)
    held[held_unknowns(basis, clamp, roller)] = True
    kind = formulation(dilatation, element, material.poisson_ratio)
    lam = cellwise_lambda(material, kind)
    K, M = stiffness_and_mass(basis, lam, material.lame_mu, material.density)
    body = Elasticity(mesh, element, material, basis, K, M, np.flatnonzero(held), np.flatnonzero(~held), kind)
    if kind == "cell":
        return body
    flux, pressure = averaged_dilatation(body, kind)
    return replace(body, K=csr_matrix(K + flux.T @ pressure), pressure=pressure)


def distortion(body: Elasticity, share: PerCell) -> csr_matrix:
    """Return the stiffness of a `share` of a body's distortion, 2μ dev ε, over all unknowns, shape
    `(N, N)` [N/m].
    """
    mu = share * np.asarray(body.material.lame_mu)
    return stiffness_and_mass(body.basis, -2.0 / 3.0 * mu, mu, body.material.density)[0]


def with_normals_along(points: Array, triangles: Indices, towards: Array) -> Indices:
    """Return triangles `(m, 3)` in the vertex order in which their normals point `towards`.

    `towards` `(m, 3)` is a direction for each triangle.
    """
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    away = np.vecdot(np.cross(b - a, c - a), towards) < 0.0
    return np.where(away[:, None], triangles[:, [0, 2, 1]], triangles)


def numbering(mesh: MeshTet, element: str) -> Basis:
    """Return the basis that numbers the unknowns, three at each node, and has their coordinates."""
    basis = Basis(mesh, ElementVector(ELEMENTS[element]()), quadrature=NO_POINTS, disable_doflocs=True)
    middles = [0.5 * mesh.p[:, mesh.edges].sum(axis=1)] if element == "P2" else []
    basis.doflocs = np.repeat(np.hstack([mesh.p, *middles]), 3, axis=1)  # scikit-fem maps cell by cell, slower
    return basis


def stiffness_and_mass(basis: Basis, lam: PerCell, mu: PerCell, rho: PerCell) -> tuple[csr_matrix, csr_matrix]:
    """Assemble K_ij = ∫ λ div φ_i div φ_j + 2μ ε(φ_i) : ε(φ_j) dx [N/m] and M_ij = ∫ ρ φ_i · φ_j dx
    [kg], shape `(N, N)` each, without averaged terms.
    """
    mesh = basis.mesh
    graph = assembly.cell_graph(basis.element_dofs[::3].T // 3, basis.N // 3)
    means = assembly.reference_means(basis.elem.elem)
    gradients, volumes = assembly.barycentric_gradients(mesh.p.T, graph)
    K, M = assembly.stiffness_and_mass(graph, means, gradients, volumes * lam, volumes * mu, volumes * rho)
    K.eliminate_zeros()
    return K, M


def slope_matrix(elasticity: Elasticity, places: Array) -> csr_matrix:
    """Return the matrix `(3 a c, m)` [1/m] from a nodal field to ∂/∂x_j at `places` `(a, 3)` of the
    reference cell.

    It has a row for each j, place and cell.
    """
    slopes = shape_gradients(elasticity, places).transpose(3, 1, 0, 2)
    cells = elasticity.cells
    columns = np.broadcast_to(cells.astype(np.int32), slopes.shape).ravel()
    starts = np.arange(0, columns.size + 1, cells.shape[1])
    return csr_matrix((slopes.ravel(), columns, starts), shape=(len(starts) - 1, len(elasticity.nodes)))


def shape_gradients(elasticity: Elasticity, places: Array) -> Array:
    """Return ∂φ_n/∂x_j at places of the reference cell `(a, 3)`, in each cell, shape `(c, a, n, 3)`
    [1/m].
    """
    _, slopes = shapes(elasticity.cell, places)
    return np.einsum("nka,ckj->canj", slopes, elasticity.inverse_edges, optimize=True)


def cellwise_lambda(material: Material, dilatation: str) -> PerCell:
    """Return the part of λ that acts at each point with a `dilatation` of `formulation` [Pa].

    With averages it is at most 2μν/(1 − 2ν) at the ν of NU_CELLWISE. If tissue relaxes, the bulk
    modulus of this part is that for the lasting part of μ; with a larger one, relaxed tissue would
    lock.
    """
    if dilatation == "cell":
        return material.lame_lambda
    nu = NU_CELLWISE[dilatation]
    most = 2.0 * nu / (1.0 - 2.0 * nu)
    part = material.lame_mu * (most - (1.0 - material.lasting) * (most + 2.0 / 3.0))
    return np.where(material.lame_lambda <= part * (1.0 + ROUND_OFF), material.lame_lambda, part)


def excess_lambda(body: Elasticity, dilatation: str) -> Array:
    """Return λ̄, the part of λ beyond `cellwise_lambda`, shape `(c,)` [Pa]."""
    excess = body.material.lame_lambda - cellwise_lambda(body.material, dilatation)
    return np.broadcast_to(np.asarray(excess, dtype=float), body.mesh.nelements)


def averages_of(mesh: MeshTet, dilatation: str) -> tuple[Indices, Element]:
    """Return `Elasticity.averages` of a dilatation "mean" or "nodal"."""
    if dilatation == "mean":
        return np.arange(mesh.nelements)[None], ElementTetP0()
    return mesh.t.astype(np.intp), ElementTetP1()


def averaged_dilatation(body: Elasticity, kind: str) -> tuple[csr_matrix, csr_matrix]:
    """Return D_aj = ∫ ψ_a div φ_j dx [m²] and p = diag(1/∫ ψ_a/λ̄ dx) D [Pa/m], both `(averages,
    N)`.

    `kind` is "mean" or "nodal". λ̄ is the excess of λ over the part that acts at each point. Cells
    without excess do not contribute, and p is zero at an average of such cells. The energy is ½
    UᵀDᵀpU.
    """
    excess = excess_lambda(body, kind)
    volumes = np.where(excess > 0.0, body.six_volumes / 6.0, 0.0)
    numbers, element = averages_of(body.mesh, kind)
    places, weights = get_quadrature(body.cell, max(1, element.maxdeg + body.cell.maxdeg - 1))
    means = np.einsum("aq,q,cqnj->acnj", shapes(element, places.T)[0], 6.0 * weights, shape_gradients(body, places.T))
    values = means * volumes[:, None, None]
    unknowns = np.broadcast_to(body.nodes[body.cells], values.shape)
    rows = np.broadcast_to(numbers[..., None, None], values.shape)
    D = csr_matrix((values.ravel(), (rows.ravel(), unknowns.ravel())), (int(numbers.max()) + 1, body.N))
    D.eliminate_zeros()
    softness = np.divide(volumes, excess, out=np.zeros(excess.size), where=excess > 0.0) / len(numbers)
    S = np.bincount(numbers.ravel(), np.tile(softness, len(numbers)), D.shape[0])
    return D, csr_matrix(diags_array(np.divide(1.0, S, out=np.zeros(S.size), where=S > 0.0)) @ D)


def _check_cells(name: str, value: PerCell, mesh: MeshTet) -> None:
    shape = np.shape(value)
    if shape not in {(), (mesh.nelements,)}:
        raise TissueError(f"{name}: shape {shape}; allowed is one number or one per cell, ({mesh.nelements},)")
