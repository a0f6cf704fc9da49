"""The rim of a wound's side: the edge of a contact surface on the outer surface of the organ.

A facet of the outer surface lies next to each edge of a rim. If this facet has turned by an angle
so that it rises towards the edge, the edge is everted by that angle. A rotation of the whole organ
everts one side of a wound and inverts the other by the same angle.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree
from skfem import MeshTet

from tissue.arrays import Array, Indices
from tissue.elasticity import with_normals_along
from tissue.organs.facing import OPPOSITE, Mask, facet_normals, open_sides

SMOOTH = 0.5  # cosine of 60°: the outer surface turns by less from edge to edge of one rim


@dataclass(frozen=True)
class Rim:
    """The edges of a surface on the outer surface of the organ.

    `edges` `(e, 2)` are their vertices. `facets` `(e, 3)` are the vertices of the outer facet next
    to each edge, in the order in which its normal points out of the organ. The other arrays
    describe the reference shape: `normal` `(e, 3)` of the facet, `rising` `(e, 3)` the unit vector
    in the facet across the edge and towards it, `middles` `(e, 3)` [m] and `lengths` `(e,)` [m] of
    the edges.
    """

    edges: Indices
    facets: Indices
    normal: Array
    rising: Array
    middles: Array
    lengths: Array

    def of(self, chosen: Mask) -> "Rim":
        """Return the rim of the `chosen` edges, `(e,)`."""
        own = self.normal[chosen], self.rising[chosen], self.middles[chosen], self.lengths[chosen]
        return Rim(self.edges[chosen], self.facets[chosen], *own)

    def near(self, points: Array) -> "Rim":
        """Return the part of the rim that is nearest to most of the `points` `(m, 3)` [m].

        A part is a chain of connected edges without a fold of the outer surface between them. If
        two parts have equally many points, the part of the first point is returned. Without points,
        it is the longest part.
        """
        if not len(self.edges):
            return self
        if not len(points):
            return self.of(self._parts == np.bincount(self._parts, self.lengths).argmax())
        votes = self._parts[self._tree.query(points)[1]].tolist()
        return self.of(self._parts == max(dict.fromkeys(votes), key=votes.count))

    def turn(self, points: Array) -> float:
        """Return the mean angle by which the outer facets rise towards their edges [rad].

        The mean is along the rim. All nodes are at `points` `(n, 3)` [m]; the angle is relative to
        the reference shape. It is 0 for an empty rim.
        """
        normal = facet_normals(points[self.facets])
        angles = np.arctan2(-np.vecdot(normal, self.rising), np.vecdot(normal, self.normal))
        return float(self.lengths @ angles / self.lengths.sum()) if len(angles) else 0.0

    @cached_property
    def way(self) -> tuple[Indices, Array]:
        """The vertices in order along the rim, and their distances from the first, `(v,)` [m].

        The distances are measured along the rim. A closed rim begins at its vertex with the lowest
        number.
        """
        vertices, ends = np.unique(self.edges, return_inverse=True)
        ends = ends.reshape(-1, 2)
        lone = np.bincount(ends.ravel(), minlength=len(vertices)) == 1
        kept = np.ones(len(ends), dtype=bool)
        if len(ends) and not lone.any():  # a closed rim is cut at its first vertex
            kept[np.flatnonzero((ends == 0).any(axis=1))[0]] = False
        graph = csr_matrix((self.lengths[kept], ends[kept].T), shape=(len(vertices),) * 2)
        far = dijkstra(graph, directed=False, indices=[int(lone.argmax())])[0] if len(ends) else np.zeros(0)
        order = np.argsort(far, kind="stable")
        return vertices[order], far[order]

    @cached_property
    def _tree(self) -> cKDTree:
        """A search tree of the middles of the edges."""
        return cKDTree(self.middles)

    @cached_property
    def _parts(self) -> Indices:
        """Number of the part to which each edge belongs, shape `(e,)`."""
        e = len(self.edges)
        at = coo_array((np.ones(2 * e), (np.repeat(np.arange(e), 2), self.edges.ravel())))
        touching = coo_array(at @ at.T)
        one, other = touching.coords
        on = np.vecdot(self.normal[one], self.normal[other]) > SMOOTH
        return np.asarray(connected_components(coo_array((np.ones(on.sum()), (one[on], other[on])), shape=(e, e)))[1])


def rim_of(mesh: MeshTet, triangles: Indices, other: Indices) -> Rim:
    """Return the rim of the surface of `triangles` `(t, 3)`.

    This surface faces the surface of the triangles `other` `(m, 3)`. Neither of them counts as
    outer surface.
    """
    outer, normals = _outer_facets(mesh, np.vstack([triangles, other]))
    open_edges = _numbered(mesh, triangles[:, OPPOSITE][open_sides(triangles)])
    sides = outer[:, OPPOSITE]
    facet, side = np.nonzero(np.isin(_numbered(mesh, sides.reshape(-1, 2)), open_edges).reshape(-1, 3))
    edges, points = sides[facet, side], mesh.p.T
    ends = points[edges]
    middles, along = ends.mean(axis=1), ends[:, 1] - ends[:, 0]
    lengths = np.linalg.norm(along, axis=1)
    rising = np.cross(normals[facet], along / lengths[:, None])
    away = np.vecdot(rising, middles - points[outer[facet, side]]) < 0.0
    return Rim(edges, outer[facet], normals[facet], np.where(away[:, None], -rising, rising), middles, lengths)


def _outer_facets(mesh: MeshTet, inner: Indices) -> tuple[Indices, Array]:
    """Return the facets of the organ's surface except `inner`, and their unit normals, `(f, 3)`.

    The vertices of a facet are in the order in which its normal points out of the organ.
    """
    found = mesh.boundary_facets()
    triangles = mesh.facets[:, found].T.astype(np.intp)
    outer = ~np.isin(_numbered(mesh, triangles), _numbered(mesh, inner))
    triangles, points = triangles[outer], mesh.p.T
    behind = points[mesh.t[:, mesh.f2t[0, found[outer]]]].mean(axis=0)
    turned = with_normals_along(points, triangles, points[triangles[:, 0]] - behind)
    return turned, facet_normals(points[turned])


def _numbered(mesh: MeshTet, corners: Indices) -> Indices:
    """Return a number for each edge `(m, 2)` or triangle `(m, 3)`, shape `(m,)`.

    It does not depend on the order of the vertices.
    """
    numbers = np.sort(corners, axis=1).T
    return np.asarray(np.ravel_multi_index(tuple(numbers), (mesh.nvertices,) * len(numbers)))
