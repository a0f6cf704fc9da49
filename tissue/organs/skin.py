"""The outer surface of an organ, on which outside points bear, such as the points of a thread.

The facets of the reference shape approximate a smooth surface. The normals n of this surface are
interpolated between mean normals of the facets at each vertex. The surface bulges over a facet by
−½ Σ ξ_i ((x − x_i)·n_i) n_i (Phong tessellation: Boubekeur and Alexa, ACM Trans. Graph. 27, 2008),
so that n is normal to it. The tilt of n and the bulge turn with their facet as the organ deforms.
Facets that meet at a sharp edge are not part of one smooth surface.

A point P faces the nearest point x of the facets. Its gap is d·(x − P) minus the bulge, where d = n
points into the organ. At an edge that is sharp, or flat in the reference shape, d is the direction
from P to x, which turns from one facet to the next. d is thus the gradient of a gap that is
continuous as P and the organ move. The organ's part of the gap, d·x, follows the displacement of
the facet. The place of x in the facet, d and the bulge are constant during a step.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csr_array, csr_matrix

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.organs.facing import OPPOSITE, Mask, face, facet_normals, triangle_sizes
from tissue.organs.lips import sums_of, tangents, weights_on

# Columns of facing data: facet, barycentric coordinates, d, distance, bulge; the labels follow.
OWN = 9
# Cosine of the angle between the normals at an edge: an edge with a larger angle is a sharp one.
SHARP = np.cos(np.radians(30.0))
FLAT = 1.0 - 1e-8  # cosine of the angle at an edge: facets with a smaller angle are in a plane
ON_EDGE = 1e-9  # largest barycentric coordinate of a point on the edge of a facet
TOUCHING = 1e-3  # of a facet's size: a smaller distance gives no direction d
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
    def _around(self) -> coo_array:
        """The facets that meet at each corner of each facet, as a matrix of shape `(3m, m)`."""
        m, n = len(self.facets), len(self.body.points)
        at = csr_array((np.ones(3 * m), (np.arange(3 * m), self.facets.ravel())), (3 * m, n))
        of = csr_array((np.ones(3 * m), (self.facets.ravel(), np.repeat(np.arange(m), 3))), (n, m))
        return coo_array(at @ of)

    @cached_property
    def _beyond(self) -> Indices:
        """The facet beyond each side of each facet, shape `(m, 3)`.

        The sides are numbered by the opposite corners. At an open side, it is the facet itself.
        """
        sides = np.sort(self.facets[:, OPPOSITE].reshape(-1, 2), axis=1)
        order = np.lexsort(sides.T)
        same = np.flatnonzero((sides[order[1:]] == sides[order[:-1]]).all(axis=1))
        out = np.repeat(np.arange(len(self.facets)), 3)
        one, other = order[same], order[same + 1]
        out[one], out[other] = other // 3, one // 3
        return out.reshape(-1, 3)

    @cached_property
    def _smooth(self) -> tuple[Array, Mask]:
        """Unit normals at the corners of all facets, `(m, 3, 3)`, and the curved sides, `(m, 3)`.

        The normals are those of the smooth surface in the reference shape. Each is the mean,
        weighted by area, over the facets that meet at the corner without a sharp edge. A side is
        curved if its edge is part of a curved surface, so that it is neither sharp nor flat.
        """
        corners, (row, other) = self.body.points[self.facets], self._around.coords
        each, areas = facet_normals(corners), triangle_sizes(corners) ** 2
        smooth, mean = np.vecdot(each[row // 3], each[other]) > SHARP, np.zeros((3 * len(each), 3))
        np.add.at(mean, row[smooth], (areas[:, None] * each)[other[smooth]])
        angle = np.vecdot(each[:, None], each[self._beyond])
        normals = mean / np.linalg.norm(mean, axis=1, keepdims=True)
        return normals.reshape(-1, 3, 3), (angle > SHARP) & (angle < FLAT)

    def faced(self, displacement: Array, places: Array, labels: Array) -> Array:
        """Return the facing data of points at `places` `(k, 3)` [m], shape `(k, 9 + l)`.

        The columns are the facet, the barycentric coordinates, d, the distance from the surface,
        which is negative inside, the bulge [m], and the `labels` `(k, l)` of each point.
        `displacement` `(n, 3)` [m] is that of all nodes.
        """
        if not len(places):
            return np.zeros((0, OWN + labels.shape[1]))
        points, (normals, curved) = self.body.points + displacement, self._smooth
        facing = face(places, points, self.facets, np.zeros(self.facets.shape, dtype=bool), None)
        facet, inside = facing[:, 0].astype(np.intp), facing[:, 1:4]
        before, now, of_corners = self.body.points[self.facets[facet]], points[self.facets[facet]], normals[facet]
        turned = frames(now) @ frames(before).mT
        n = np.matvec(turned, np.vecmat(inside, of_corners))
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        way = np.vecmat(inside, now) - places
        away, outside = np.linalg.norm(way, axis=1), np.vecdot(way, facing[:, 4:]) > 0.0
        over = ((inside <= ON_EDGE) & ~curved[facet]).any(axis=1) & outside & (away > TOUCHING * triangle_sizes(now))
        d = np.where(over[:, None], way / np.maximum(away, np.finfo(float).tiny)[:, None], n)
        tilts = np.vecdot(np.vecmat(inside, before)[:, None] - before, of_corners)
        bulge = 0.5 * np.sum(inside * tilts * np.vecdot(np.matvec(turned[:, None], of_corners), d[:, None]), axis=1)
        return np.column_stack([facing[:, :4], d, np.vecdot(way, d) - bulge, bulge, labels])

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
        """Return d·x minus the bulge in the reference shape, and zero slips [m].

        `points` `(k, 9 + l)` are the facing data; the order is that of the rows of `sums`.
        """
        out = np.asarray(self.sums(points) @ self.body.points[self.nodes].ravel())
        out[: len(points)] -= points[:, 8]
        out[len(points) :] = 0.0
        return out


def frames(corners: Array) -> Array:
    """Return frames of triangles `(k, 3, 3)`, shape `(k, 3, 3)`.

    The columns are the unit vectors along the first side and across it, and the normal.
    """
    n, side = facet_normals(corners), corners[:, 1] - corners[:, 0]
    side = side / np.linalg.norm(side, axis=1, keepdims=True)
    return np.stack([side, np.cross(n, side), n], axis=2)


def skin_of(body: Elasticity, friction: float = 0.0) -> Skin:
    """Return the whole outer surface of a body.

    `friction` is the coefficient of friction of outside points on it [-].
    """
    nodes = body.surface_nodes(body.mesh.boundary_facets(), inwards=True)
    return Skin(body, nodes if nodes.shape[1] == 3 else nodes[:, QUARTERS].reshape(-1, 3), friction)
