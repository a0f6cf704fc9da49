"""The outer surface of an organ, on which outside points bear, such as the points of a thread.

The facets approximate a smooth surface. Its unit normals n_i at the corners of a facet are the means
of the facets that meet there; facets that meet at a sharp edge are not part of one smooth surface.
In the reference shape the surface bulges over a facet by b = ½ Σ ξ_i (x − x_i)·n_i (Phong
tessellation: Boubekeur and Alexa, ACM Trans. Graph. 27, 2008). With P2 the facets are quarters of
flat facets, and the bulge of the whole facet is added. The bulge moves with its facet as the organ
deforms.

A point P faces the point x = Σ ξ_i x_i of a facet if P = x − t N with N = Σ ξ_i n_i, which points
into the organ. Its gap is g = t |N| − b. It is continuous as P and the organ move, because facets
share the normals on their common edge.

A point beyond a sharp edge faces the nearest point x along d = (x − P)/|x − P|, and its gap is
|x − P| − b d·N/|N|. This gap jumps by a part of b where the nearest point goes from one facet to the
other of the edge.

Elsewhere d = −∂g/∂P, so that a force along d does the work of the gap as P moves. Its length differs
from 1 by half the square of the angle between d and N. The organ's part of the gap, d·x, follows the
displacement of the facet; normals that turn with the organ are not part of it. The place of x in
the facet and d are constant during a step.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csr_array, csr_matrix
from scipy.sparse.csgraph import connected_components

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.organs.facing import OPPOSITE, area_normals, facet_normals, nearest, triangle_sizes
from tissue.organs.lips import sums_of, tangents, weights_on

# Columns of facing data: facet, barycentric coordinates, d, gap, d·(x − P) − gap; the labels follow.
OWN = 9
# Cosine of the angle between the normals at an edge: an edge with a larger angle is a sharp one.
SHARP = np.cos(np.radians(30.0))
ON_EDGE = 1e-9  # round-off of barycentric coordinates
TOUCHING = 1e-3  # of a facet's size: a smaller distance gives no direction d
FACETS = 6  # on which a point is sought, at most: half way round a vertex are three
CORRECTIONS = 4  # of Newton's method for the place on one facet: each squares a relative error of at most an angle
FOCAL = 0.5  # of a facet's area: with a smaller offset facet a point is near a centre of curvature
SIDES = np.array([[0, 1], [1, 2], [0, 2]])  # corners of a facet on both sides of the middle nodes 3, 4 and 5
# The quarters of a P2 facet, whose nodes are the corners and the middles of the sides.
QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])


@dataclass(frozen=True)
class Skin:
    """The outer surface of a `body`.

    `facets` `(m, 3)` are the nodes of its facets, with P2 of the quarters of its facets, in the
    order in which their normals point into the organ. `friction` is the coefficient of friction of
    outside points on the surface [-].
    """

    body: Elasticity
    facets: Indices
    friction: float = 0.0

    @cached_property
    def nodes(self) -> Indices:
        """Numbers of the nodes on the surface, shape `(r,)`."""
        return np.unique(self.facets)

    @cached_property
    def rows(self) -> csr_matrix:
        """Displacement of the surface's nodes over the free unknowns, shape `(3r, N)`."""
        return self.body.rows_of(self.nodes)

    @cached_property
    def finest(self) -> float:
        """Smallest height of a facet in the reference shape [m]."""
        corners = self.body.points[self.facets]
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        return float((triangle_sizes(corners) ** 2 / sides.max(axis=1)).min())

    @cached_property
    def _smooth(self) -> tuple[Indices, csr_array, Indices]:
        """The vertices of the smooth surfaces.

        They are the vertex at each corner of each facet, `(m, 3)`, the matrix of the facets that
        meet at each vertex, `(v, m)`, and the facet beyond each side of each facet, `(m, 3)`. Sides
        are numbered by the opposite corners. At an open or sharp side, it is the facet itself.
        """
        m, nodes, each = len(self.facets), self.facets.ravel(), facet_normals(self.body.points[self.facets])
        ends = (3 * np.arange(m)[:, None, None] + OPPOSITE).reshape(-1, 2)
        ends = np.take_along_axis(ends, nodes[ends].argsort(axis=1), axis=1)
        order = np.lexsort(nodes[ends].T)
        one, other = order[:-1], order[1:]
        joined = (nodes[ends[one]] == nodes[ends[other]]).all(axis=1)
        joined &= np.vecdot(each[one // 3], each[other // 3]) > SHARP
        one, other, beyond = one[joined], other[joined], np.repeat(np.arange(m), 3)
        beyond[one], beyond[other] = other // 3, one // 3
        pairs = coo_array((np.ones(2 * len(one)), (ends[one].ravel(), ends[other].ravel())), (3 * m, 3 * m))
        count, vertex = connected_components(pairs, directed=False)
        meeting = csr_array((np.ones(3 * m), (vertex, np.repeat(np.arange(m), 3))), (count, m))
        return np.asarray(vertex.reshape(m, 3), dtype=np.intp), meeting, beyond.reshape(m, 3)

    def _surface(self, points: Array) -> tuple[Array, Array]:
        """Return the corners of all facets, and the unit normals there, shape `(m, 3, 3)` each.

        A normal is the mean, weighted by area, over the facets that meet at a vertex. `points`
        `(n, 3)` [m] are all nodes.
        """
        corners, (vertex, meeting, _) = points[self.facets], self._smooth
        mean = meeting @ area_normals(corners)
        return corners, (mean / np.linalg.norm(mean, axis=1, keepdims=True))[vertex]

    @cached_property
    def _at_rest(self) -> tuple[Array, Array]:
        """The surface in the reference shape, as `_surface`."""
        return self._surface(self.body.points)

    @cached_property
    def _lifts(self) -> Array:
        """The bulge of the whole P2 facet at the corners of its quarters, `(m, 3)` [m]; zero with P1."""
        if len(self.body.cell.doflocs) == 4:
            return np.zeros(self.facets.shape)
        # Quarter k has corner k of the whole facet as its own corner k.
        x, n = (np.einsum("fkkx->fkx", each.reshape(-1, 4, 3, 3)[:, :3]) for each in self._at_rest)
        first, second = SIDES.T
        middles = np.vecdot(x[:, second] - x[:, first], n[:, first] - n[:, second]) / 8.0
        return np.asarray(np.pad(middles, ((0, 0), (3, 0)))[:, QUARTERS].reshape(-1, 3))

    def faced(self, displacement: Array, places: Array, labels: Array) -> Array:
        """Return the facing data of points at `places` `(k, 3)` [m], shape `(k, 9 + l)`.

        The columns are the facet, the barycentric coordinates, d, the gap, which is negative
        inside, d·(x − P) minus the gap [m], and the `labels` `(k, l)` of each point. `displacement`
        `(n, 3)` [m] is that of all nodes.
        """
        if not len(places):
            return np.zeros((0, OWN + labels.shape[1]))
        surface = self._surface(self.body.points + displacement)
        facet, inside, t, rates = self._feet(surface, places)
        corners, n = (each[facet] for each in surface)
        N, (bulge, by_place) = np.vecmat(inside, n), self._bulge(facet, inside)
        length = np.linalg.norm(N, axis=1)
        by_place = (t / length)[:, None] * np.matvec(n, N) - by_place
        d = -np.vecmat(np.column_stack([by_place[:, 1:] - by_place[:, :1], length]), rates)
        facing = np.clip(-np.vecdot(rates[:, 2], N), 0.0, 1.0)  # less than 1 beyond a sharp edge only
        gap, way = t * length - facing * bulge, np.vecmat(inside, corners) - places
        return np.column_stack([facet, inside, d, gap, np.vecdot(way, d) - gap, labels])

    def _feet(self, surface: tuple[Array, Array], places: Array) -> tuple[Indices, Array, Array, Array]:
        """Return facets, ξ and t with P = Σ ξ_i (x_i − t n_i), and the rates of ξ_1, ξ_2 and t by P.

        The search starts on the nearest facet and continues on the facet beyond a side that Newton's
        method has crossed. If there is no such place, as beyond a sharp edge, x is the nearest point
        and the direction of N is that to x, or N at x if P is inside or touches the facet.
        """
        corners, normals = surface
        start, place, away = nearest(places, corners)
        way, N = np.vecmat(place, corners[start]) - places, np.vecmat(place, normals[start])
        length = np.linalg.norm(N, axis=1)
        out = (np.vecdot(way, N) > 0.0) & (away > TOUCHING * triangle_sizes(corners[start]))
        d = np.where(out, way.T / np.maximum(away, np.finfo(float).tiny), N.T / length).T
        straight = np.vecdot(way, d) / length, np.pad(-d[:, None] / length[:, None, None], ((0, 0), (2, 0), (0, 0)))
        facet, inside, t = start, place, straight[0]
        for _ in range(FACETS):
            with np.errstate(over="ignore", invalid="ignore"):  # a search that diverges finds no place
                inside, t, rates, change = foot(places, corners[facet], normals[facet], inside, t)
            crossed = inside.min(axis=1) < -ON_EDGE
            after = np.where(crossed, self._smooth[2][facet, inside.argmin(axis=1)], facet)
            if np.array_equal(after, facet):
                break
            facet, inside = after, np.where((after == facet)[:, None], inside, 1.0 / 3.0)
        found = ~crossed & (change <= ON_EDGE)
        facet, t = np.where(found, facet, start), np.where(found, t, straight[0])
        return facet, np.where(found, inside.T, place.T).T, t, np.where(found, rates.T, straight[1].T).T

    def _bulge(self, facet: Indices, inside: Array) -> tuple[Array, Array]:
        """Return b [m] at barycentric coordinates `inside` `(k, 3)` of facets, `(k,)`, and ∂b/∂ξ, `(k, 3)`."""
        (corners, normals), lifts = (each[facet] for each in self._at_rest), self._lifts[facet]
        corners = corners - lifts[..., None] * normals
        from_corners = np.vecmat(inside, corners)[:, None] - corners
        tilts = np.vecdot(from_corners, normals)
        by_place = lifts + 0.5 * (tilts - np.matvec(from_corners, np.vecmat(inside, normals)))
        return np.vecdot(inside, lifts + 0.5 * tilts), by_place

    def sums(self, points: Array) -> csr_matrix:
        """Return the matrix from the displacement of the surface's nodes to d·x, shape `(k, 3r)`.

        `points` `(k, 9 + l)` are the facing data. With friction, the rows of d·x are followed by
        those of x along both `tissue.organs.lips.tangents` of each point, shape `(3k, 3r)`.
        """
        along, at = points[:, 4:7], points
        if self.friction:
            along = np.vstack([along, tangents(along).reshape(-1, 3)])
            at = np.vstack([points, np.repeat(points, 2, axis=0)])
        nodes, w = weights_on(self.facets, at)
        return sums_of(self.nodes, nodes, w, along)

    def rest(self, points: Array) -> Array:
        """Return the organ's part of the gaps in the reference shape, and zero slips [m].

        `points` `(k, 9 + l)` are the facing data; the order is that of the rows of `sums`.
        """
        out = np.asarray(self.sums(points) @ self.body.points[self.nodes].ravel())
        out[: len(points)] -= points[:, 8]
        out[len(points) :] = 0.0
        return out


def foot(places: Array, corners: Array, normals: Array, inside: Array, t: Array) -> tuple[Array, Array, Array, Array]:
    """Return ξ `(k, 3)` and t `(k,)` with P = Σ ξ_i (x_i − t n_i) for `places` P `(k, 3)` over a facet each.

    The rates of ξ_1, ξ_2 and t by P, `(k, 3, 3)`, and the last change of ξ, `(k,)`, follow.
    Newton's method starts at `inside` and `t`.
    """
    least = FOCAL * triangle_sizes(corners) ** 2
    for _ in range(CORRECTIONS):
        offset = corners - t[:, None, None] * normals
        by = np.concatenate([offset[:, 1:] - offset[:, :1], -np.vecmat(inside, normals)[:, None]], axis=1)
        rates = np.cross(by[:, [1, 2, 0]], by[:, [2, 0, 1]])
        rates /= np.minimum(np.vecdot(by[:, 2], rates[:, 2]), -least)[:, None, None]
        change = np.matvec(rates, places - np.vecmat(inside, offset))
        inside = inside + np.column_stack([-change[:, 0] - change[:, 1], change[:, :2]])
        t = t + change[:, 2]
    return inside, t, rates, np.abs(change[:, :2]).max(axis=1)


def skin_of(body: Elasticity, friction: float = 0.0) -> Skin:
    """Return the whole outer surface of a body.

    `friction` is the coefficient of friction of outside points on it [-].
    """
    nodes = body.surface_nodes(body.mesh.boundary_facets(), inwards=True)
    return Skin(body, nodes if nodes.shape[1] == 3 else nodes[:, QUARTERS].reshape(-1, 3), friction)
