"""Gaps between the two lips of a wound: pairs of nodes that face one another, g = g0 + G U ≥ 0.

g is the distance of the right lip from a left node along the normal n of the wound's plane, g = n·(Σ w_a x_a − x_left)
over the nodes a of the right facet that the left node faces. The lips match: at first it faces a node of its own, its
pair, with P2 the middles of the edges too, so that no node of one lip enters the other. A node that both lips share has
no pair, nor one that is held on both sides.

Lips that slide past one another are paired anew where a step begins (`Gaps.facing`): every left node with the point of
the displaced right lip that lies in front of it, along n. A node past the edge of the right lip faces its edge as far
as half a facet, within which its share of the area is still over the lip, and nothing beyond. During the step the pairs
stay. While no pair has slid by more than SLID of a facet, the pairs are those of the reference, to the last bit.
The forces stay along n: where lips that are not plane ride over one another, they do no work along the slope, and the
energy that lifts the lips is the integrator's (negative numerical dissipation).

The forces p on the pairs are those of a pressure against the P1 functions ψ of the lip's vertices: P_a = Σ ψ_a(x_k) p_k
/ ∫ψ_a dA. With P1 that is force over area; with P2, whose vertices carry no force under a uniform pressure, it gathers
those of the edges. The areas are those of the facets as seen along n.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, csr_matrix
from scipy.spatial import cKDTree

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.errors import TissueError

SLID = 0.01  # of the smallest facet of the right lip: nearer, what lies in front of a node is its pair
NEAREST = 24  # facets of the right lip, by their centres, among which that in front of a node is sought
CLOSED = 1e-12  # over the lips' extent: a gap this far below zero is that of a closed slit


@dataclass(frozen=True)
class Gaps:
    """The `k` pairs: g = `g0` + `G` U over the free unknowns of the mesh, shapes `(k,)` [m] and `(k, N)`.

    `nodes` `(k, 2)` number the left and the right node of each among the body's. `hats` `(v, k)` are the P1 functions
    of the lip's vertices at the pairs, `areas` `(v,)` [m²] their integrals. `normal` (3,) points from the left lip to
    the right one, whose `facets` `(m, 3)`, with P2 `(m, 6)`, number their nodes among the body's, corners first.
    Made by `build_gaps`.
    """

    G: csr_matrix
    g0: Array
    nodes: Indices
    hats: csr_array
    areas: Array
    normal: Array
    facets: Indices

    def pressure(self, p: Array) -> Array:
        """Return the pressure at the pairs under the forces `p` `(k,)` [N], shape `(k,)` [Pa]."""
        return np.asarray(self.hats.T @ ((self.hats @ p) / self.areas))

    def slides(self, displacement: Array) -> Array:
        """Return how far each pair has slid, the way of its right node past its left one along the lips, shape `(k,)`
        [m], from the `displacement` of all nodes `(n, 3)` [m]."""
        past = displacement[self.nodes[:, 1]] - displacement[self.nodes[:, 0]]
        return np.asarray(np.linalg.norm(past - np.outer(past @ self.normal, self.normal), axis=1))

    def facing(self, points: Array, displacement: Array) -> Array | None:
        """Return the facet of the right lip and the barycentric coordinates in it that each left node faces, shape
        `(k, 4)`: facet −1 where it faces none. None where no pair has slid: each left node faces its right one.

        `points` `(n, 3)` [m] are all nodes of the reference, `displacement` as for `slides`.
        """
        corners, along = self.facets[:, :3], _across(self.normal)
        sizes = np.sqrt(np.linalg.norm(_normals(points[corners]), axis=1))
        if self.slides(displacement).max(initial=0.0) <= SLID * sizes.min():
            return None
        now = (points + displacement) @ along.T
        return _facets_in_front(now[self.nodes[:, 0]], now[corners], sizes)

    def weights(self, facing: Array) -> tuple[Indices, Array]:
        """Return the nodes that make the point each left node faces, and their weights, shape `(k, 3)`, with P2
        `(k, 6)`; weights of zero where it faces none."""
        nodes = self.facets[np.maximum(facing[:, 0], 0.0).astype(np.intp)]
        w = facing[:, 1:]
        if self.facets.shape[1] > 3:
            w = np.hstack([w * (2.0 * w - 1.0), 4.0 * w[:, [0, 1, 0]] * w[:, [1, 2, 2]]])
        return nodes, w * (facing[:, :1] >= 0.0)


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
    return Gaps(G[moving], g0, nodes[moving], hats, areas, n, body.facet_nodes(partner[triangles]))


def _across(normal: Array) -> Array:
    """Return two unit vectors across the normal, shape `(2, 3)`."""
    return np.linalg.svd(normal[None])[2][1:]


def _normals(corners: Array) -> Array:
    """Return the cross products of two sides of triangles `(m, 3, 3)`, twice their areas long."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _facets_in_front(at: Array, corners: Array, sizes: Array) -> Array:
    """Return for points `at` `(k, 2)` in the plane the triangle of `corners` `(m, 3, 2)` that each lies in and its
    barycentric coordinates there, `(k, 4)`; of a point outside all those of the nearest point, and triangle −1 where
    that is farther than half the size `(m,)` of its triangle."""
    near = cKDTree(corners.mean(axis=1)).query(at, min(NEAREST, len(corners)))[1].reshape(len(at), -1)
    inside = _barycentric(at[:, None], corners[near])
    held = np.stack([_nearest_in_triangle(at, corners[near[:, j]], inside[:, j]) for j in range(near.shape[1])], axis=1)
    away = np.linalg.norm(np.einsum("kjc,kjcx->kjx", held, corners[near]) - at[:, None], axis=2)
    best, rows = np.argmin(away, axis=1), np.arange(len(at))
    facet = near[rows, best]
    lost = away[rows, best] > 0.5 * sizes[facet]
    return np.column_stack([np.where(lost, -1.0, facet), held[rows, best]])


def _barycentric(at: Array, corners: Array) -> Array:
    """Return the barycentric coordinates of points `(…, 2)` in triangles `(…, 3, 2)`."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    u, v, w = b - a, c - a, at - a
    area = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    second = (w[..., 0] * v[..., 1] - w[..., 1] * v[..., 0]) / area
    third = (u[..., 0] * w[..., 1] - u[..., 1] * w[..., 0]) / area
    return np.stack([1.0 - second - third, second, third], axis=-1)


def _nearest_in_triangle(at: Array, corners: Array, inside: Array) -> Array:
    """Return the barycentric coordinates of the points of triangles `(k, 3, 2)` nearest to `at` `(k, 2)`, which has
    those of `inside` `(k, 3)`."""
    best, least = inside, np.where(inside.min(axis=1) >= 0.0, 0.0, np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        side = corners[:, j] - corners[:, i]
        share = np.clip(np.sum((at - corners[:, i]) * side, axis=1) / np.sum(side * side, axis=1), 0.0, 1.0)
        away = np.linalg.norm(corners[:, i] + share[:, None] * side - at, axis=1)
        on_side = np.zeros_like(inside)
        on_side[:, i], on_side[:, j] = 1.0 - share, share
        nearer = away < least
        best, least = np.where(nearer[:, None], on_side, best), np.where(nearer, away, least)
    return best


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
    middles = body.mesh.nvertices + np.column_stack([body.edge_numbers(edges), body.edge_numbers(partner[edges])])
    return np.vstack([nodes, middles]), np.vstack([ends, edges])


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
