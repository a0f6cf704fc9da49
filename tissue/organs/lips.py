"""Gaps between the two lips of a wound: pairs of nodes that face one another, g = g0 + G U ≥ 0.

g is the distance of the right node from the left one along the normal n of the wound's plane (small sliding: the pairs
stay what they are). Every node of the lips has its pair, with P2 the middles of the edges too, so that no node of one
lip enters the other. A node that both lips share has none, nor one that is held on both sides.

The forces p on the pairs are those of a pressure against the P1 functions ψ of the lip's vertices: P_a = Σ ψ_a(x_k) p_k
/ ∫ψ_a dA. With P1 that is force over area; with P2, whose vertices carry no force under a uniform pressure, it gathers
those of the edges. The areas are those of the facets as seen along n.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, csr_matrix

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.errors import TissueError

CLOSED = 1e-12  # over the lips' extent: a gap this far below zero is that of a closed slit


@dataclass(frozen=True)
class Gaps:
    """The `k` pairs: g = `g0` + `G` U over the free unknowns of the mesh, shapes `(k,)` [m] and `(k, N)`.

    `nodes` `(k, 2)` number the left and the right node of each among the body's. `hats` `(v, k)` are the P1 functions
    of the lip's vertices at the pairs, `areas` `(v,)` [m²] their integrals. Made by `build_gaps`.
    """

    G: csr_matrix
    g0: Array
    nodes: Indices
    hats: csr_array
    areas: Array

    def pressure(self, p: Array) -> Array:
        """Return the pressure at the pairs under the forces `p` `(k,)` [N], shape `(k,)` [Pa]."""
        return np.asarray(self.hats.T @ ((self.hats @ p) / self.areas))


def build_gaps(body: Elasticity, vertices: ArrayLike, facets: ArrayLike, normal: ArrayLike) -> Gaps:
    """Return the gaps between the left lip, whose `facets` `(m,)` are numbered as in the mesh, and the right one.

    `vertices` `(v, 2)`: each vertex of the left lip and its partner, itself where the lips meet. `normal` (3,)
    points from the left lip to the right one. Raises `TissueError` where the lips cross, or no pair can move.
    """
    n, pairs = _unit(normal), np.asarray(vertices, dtype=np.intp)
    partner = np.arange(body.mesh.nvertices)
    partner[pairs[:, 0]] = pairs[:, 1]
    triangles = body.mesh.facets[:, np.asarray(facets)].T.astype(np.intp)
    nodes, corners = _paired(body, triangles, partner)
    g0 = (body.points[nodes[:, 1]] - body.points[nodes[:, 0]]) @ n
    G = _rows(body, nodes, n)
    moving = (nodes[:, 0] != nodes[:, 1]) & (np.diff(G.indptr) > 0)
    if not moving.any():
        raise TissueError("the lips have no pair of nodes that can move; take a finer mesh, or leave out contact")
    g0 = _not_crossed(g0[moving], float(np.ptp(body.points[nodes[:, 0]], axis=0).max()))
    hats, areas = _hats(body, triangles, corners[moving], n)
    return Gaps(G[moving], g0, nodes[moving], hats, areas)


def _unit(normal: ArrayLike) -> Array:
    n = np.asarray(normal, dtype=float)
    if n.shape != (3,) or not np.all(np.isfinite(n)) or not n.any():
        raise TissueError(f"normal = {normal!r} of the lips: allowed is a vector other than zero")
    return n / np.linalg.norm(n)


def _not_crossed(g0: Array, extent: float) -> Array:
    """Return the gaps of the reference shape, none below zero."""
    if g0.min() < -CLOSED * extent:
        raise TissueError(f"the lips overlap by {-g0.min():.3g} m before they are loaded; the normal may be reversed")
    return np.maximum(g0, 0.0)


def _paired(body: Elasticity, triangles: Indices, partner: Indices) -> tuple[Indices, Indices]:
    """Return the left and right node of every pair, `(k, 2)`, and the two vertices whose middle the left node is.

    A vertex is given as itself twice.
    """
    left = np.unique(triangles)
    ends = np.column_stack([left, left])
    nodes = np.column_stack([left, partner[left]])
    if body.element == "P1":
        return nodes, ends
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1), axis=0)
    middles = body.mesh.nvertices + np.column_stack([_edge_numbers(body, edges), _edge_numbers(body, partner[edges])])
    return np.vstack([nodes, middles]), np.vstack([ends, edges])


def _edge_numbers(body: Elasticity, edges: Indices) -> Indices:
    """Return the numbers in the mesh of edges given by their two vertices, `(k, 2)`."""
    known, asked = (np.sort(pairs, axis=1) @ [body.mesh.nvertices, 1] for pairs in (body.mesh.edges.T, edges))
    order = np.argsort(known)
    return np.asarray(order[np.searchsorted(known, asked, sorter=order)])


def _rows(body: Elasticity, nodes: Indices, n: Array) -> csr_matrix:
    """Return n · (U_right − U_left) over the free unknowns, shape `(k, N)`."""
    k = len(nodes)
    unknowns = body.nodes[nodes].reshape(k, 6)
    values = np.broadcast_to(np.concatenate([-n, n]), (k, 6))
    rows = csr_matrix((values.ravel(), (np.repeat(np.arange(k), 6), unknowns.ravel())), shape=(k, body.N))[:, body.free]
    rows.eliminate_zeros()
    return csr_matrix(rows)


def _hats(body: Elasticity, triangles: Indices, corners: Indices, n: Array) -> tuple[csr_array, Array]:
    """Return ψ_a of the left lip's vertices at the pairs, and ∫ψ_a dA as seen along n.

    Vertices of no pair are left out.
    """
    vertices = np.unique(corners)
    k, v = len(corners), len(vertices)
    place = np.searchsorted(vertices, corners)
    hats = csr_array((np.full(2 * k, 0.5), (place.ravel(), np.repeat(np.arange(k), 2))), shape=(v, k))
    a, b, c = (body.mesh.p.T[triangles[:, corner]] for corner in range(3))
    thirds = np.abs(np.cross(b - a, c - a) @ n) / 6.0
    areas = np.bincount(triangles.ravel(), np.repeat(thirds, 3), body.mesh.nvertices)[vertices]
    return hats, np.maximum(areas, np.finfo(float).tiny)
