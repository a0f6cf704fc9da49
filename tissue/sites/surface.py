"""Location of points on or in a tetrahedral mesh.

The module has the outer surface, its normals, projections on it, and the cells that contain points.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from skfem import MeshTet

from tissue.arrays import Array, Indices

INSIDE = 1e-9  # barycentric coordinates down to −INSIDE count as inside: round-off of a point on a face
ON_SURFACE = 1e-3  # of the bounding-box diagonal: a site nearer to the surface counts as a site on it
OVERLAP = 1e-6  # of a facet's size: boxes in projection are larger by this margin, far above round-off
EDGE_ON = 1e-9  # cosine between a line and a facet's normal: below it the line is parallel to the facet
TOGETHER = 64  # neighbouring points that are located together: most boxes are far from all of them


@dataclass(frozen=True)
class Surface:
    """The outer facets of a `mesh`.

    Each facet has a triangle `(f, 3, 3)` [m], an outward unit normal `(f, 3)`, the cell `behind` it
    `(f,)`, and its `vertices` `(f, 3)`.
    """

    mesh: MeshTet
    triangles: Array
    normals: Array
    behind: Indices
    vertices: Indices

    @cached_property
    def diagonal(self) -> float:
        """Diagonal of the bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.mesh.p, axis=1)))

    @cached_property
    def corners(self) -> Array:
        """Vertices of every cell, shape `(c, 4, 3)` [m]."""
        return np.ascontiguousarray(self.mesh.p.T[self.mesh.t.T])

    @cached_property
    def to_reference(self) -> Array:
        """Matrices from x − first vertex of a cell to reference coordinates, `(c, 3, 3)` [1/m]."""
        edges = self.corners[:, 1:] - self.corners[:, :1]
        return np.asarray(np.linalg.inv(np.swapaxes(edges, 1, 2)), dtype=np.float64)

    @cached_property
    def finder(self) -> "Finder":
        """The search among the triangles."""
        return Finder(self.triangles)

    def nearest(self, point: Array) -> tuple[float, Array, Indices]:
        """Return the distance to the surface [m], the nearest point (3,) and all facets there.

        Cells cut from the interior of a body have no outer facet. The distance is then infinite and
        the point is NaN.
        """
        if not len(self.triangles):
            return np.inf, np.full(3, np.nan), np.zeros(0, np.intp)
        near = closest_on_triangles(point, self.triangles[self.finder.nearest(point)])
        distances = np.linalg.norm(near - point, axis=1)
        best = near[np.argmin(distances)]
        return float(distances.min()), best, self.finder.within(best, INSIDE * self.diagonal)

    def met_by(self, point: Array, along: Array) -> Array | None:
        """Return the point (3,) [m] at which a line meets the surface, or None if there is none.

        The line goes through `point` along the unit vector `along`. If there are several such
        points, the one nearest to `point` is returned.
        """
        facing = np.flatnonzero(np.abs(self.normals @ along) > EDGE_ON)
        if facing.size == 0:
            return None
        hits, struck = self.project(point[None], along, facing, np.inf)
        return None if struck[0] < 0 else hits[0]

    def patch(self, centre: Array, seeds: Indices, normal: Array, radius: float) -> Indices:
        """Return the facets near `centre` that are joined to `seeds` by edges.

        They face `normal` and come within `radius` of `centre`. A disc near an open cut therefore
        averages over its own lip, and not over the other lip in the same plane.
        """
        near = self.finder.within(centre, radius)
        facets = near[self.normals[near] @ normal > 0.0]
        lookup = self.vertices[facets]
        incidence = csr_matrix((np.ones(lookup.size), (np.repeat(np.arange(facets.size), 3), lookup.ravel())))
        shared = csr_matrix(incidence @ incidence.T)
        shared.data[shared.data < 2.0] = 0.0
        shared.eliminate_zeros()
        _, label = connected_components(shared, directed=False)
        return facets[np.isin(label, label[np.isin(facets, seeds)])]

    def project(self, points: Array, normal: Array, facets: Indices, reach: float) -> tuple[Array, Indices]:
        """Return the nearest hit of each point's line along `normal` with `facets`.

        Hits are points `(k, 3)` and facets `(k,)`. If a line hits no facet, the point is NaN and
        the facet is −1.
        """
        point, facet = self._seen_along(points, normal, facets)
        across, (a, b, c) = self.normals[facet], np.moveaxis(self.triangles[facet], 1, 0)
        offset = points[point]
        height = np.einsum("ki,ki->k", a - offset, across) / (across @ normal)
        hit = offset + height[:, None] * normal
        bary = _triangle_coordinates(hit, a, b, c)
        struck = np.flatnonzero((bary.min(axis=-1) >= -INSIDE) & (np.abs(height) <= reach))
        best = struck[first_of_each(point[struck], np.abs(height[struck]), facet[struck])]
        hits, found = np.full(points.shape, np.nan), np.full(len(points), -1, np.intp)
        hits[point[best]], found[point[best]] = hit[best], facet[best]
        return hits, found

    def _seen_along(self, points: Array, normal: Array, facets: Indices) -> tuple[Indices, Indices]:
        """Return the pairs of points and facets that overlap in the projection along `normal`.

        Both have shape `(k,)`. The overlap is tested with the facet's bounding box.
        """
        across, triangles = np.linalg.svd(normal[None])[2][1:], self.triangles[facets]
        corners, slack = triangles @ across.T, OVERLAP * np.ptp(triangles, axis=1).max(axis=1)[:, None]
        point, facet = overlapping(points @ across.T, corners.min(axis=1) - slack, corners.max(axis=1) + slack)
        return point, facets[facet]

    def containing(self, points: Array) -> Indices:
        """Return a cell that contains each point, shape `(k,)`; −1 for points outside the body."""
        slack = INSIDE * self.diagonal
        point, cell = overlapping(points, self.corners.min(axis=1) - slack, self.corners.max(axis=1) + slack)
        depth = self._depth(points[point], cell)
        held = np.flatnonzero(depth >= -INSIDE)
        best = held[first_of_each(point[held], -depth[held], cell[held])]
        found = np.full(len(points), -1, np.intp)
        found[point[best]] = cell[best]
        return found

    def sharing(self, point: Array) -> Indices:
        """Return every cell that contains `point`, also on a face or at a corner."""
        every = np.arange(self.mesh.nelements)
        return np.flatnonzero(self._depth(np.broadcast_to(point, (every.size, 3)), every) >= -INSIDE)

    def reference(self, points: Array, cells: Indices) -> Array:
        """Return the reference coordinates of points in cells, shape `(k, 3)`."""
        return np.einsum("kij,kj->ki", self.to_reference[cells], points - self.corners[cells, 0])

    def _depth(self, points: Array, cells: Indices) -> Array:
        """Return the smallest barycentric coordinate of points in cells, shape `(k,)`."""
        xi = self.reference(points, cells)
        return np.minimum(xi.min(axis=1), 1.0 - xi.sum(axis=1))


def overlapping(points: Array, low: Array, high: Array) -> tuple[Indices, Indices]:
    """Return the pairs of points `(k, d)` and boxes that contain them, `(n,)` each.

    The boxes go from `low` to `high`, `(b, d)` each.
    """
    order, pairs, every = np.argsort(points[:, 0]), [np.zeros((2, 0), np.intp)], _met(points, low, high)
    for own in (order[k : k + TOGETHER] for k in range(0, len(order), TOGETHER)):
        near = every[_met(points[own], low[every], high[every])]
        sides = zip(points[own].T[..., None], low[near].T, high[near].T, strict=True)
        point, box = np.nonzero(np.logical_and.reduce([(x >= least) & (x <= most) for x, least, most in sides]))
        pairs.append(np.stack([own[point], near[box]]))
    point, box = np.hstack(pairs)
    return point, box


def _met(points: Array, low: Array, high: Array) -> Indices:
    """Return the boxes that overlap the bounding box of all points."""
    least, most = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    return np.flatnonzero(((low <= most) & (high >= least)).all(axis=1))


def first_of_each(points: Indices, measure: Array, other: Indices) -> Indices:
    """Return the index of one pair per point: the pair with the smallest `measure` `(n,)`.

    The n pairs combine `points` `(n,)` with `other` items `(n,)`. Of equal measures, the pair with
    the first other item is returned.
    """
    order = np.lexsort((other, measure, points))
    return np.asarray(order[np.unique(points[order], return_index=True)[1]])


def outer_surface(mesh: MeshTet) -> Surface:
    """Return the outer surface of a mesh."""
    facets = mesh.boundary_facets()
    vertices = mesh.facets[:, facets].T
    behind = mesh.f2t[0, facets]
    a, b, c = np.moveaxis(mesh.p.T[vertices], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    inward = mesh.p.T[mesh.t[:, behind]].mean(axis=0) - a
    normals *= np.where(np.einsum("fi,fi->f", normals, inward) > 0.0, -1.0, 1.0)[:, None]
    return Surface(mesh, np.stack([a, b, c], axis=1), normals, behind.astype(np.intp), vertices.astype(np.intp))


def depths(mesh: MeshTet) -> Callable[[Array], Array]:
    """Return a function that returns the depth of points below a mesh's surface.

    For points `(k, 3)`, the depth has shape `(k,)` [m]. It is negative outside.
    """
    surface = outer_surface(mesh)
    away = distances_from(surface.triangles)
    return lambda points: np.where(surface.containing(points) >= 0, 1.0, -1.0) * away(points)


def distances(mesh: MeshTet, boundary: str) -> Callable[[Array], Array]:
    """Return a function that returns the distance of points from a named boundary of a mesh.

    For points `(k, 3)`, the distance has shape `(k,)` [m].
    """
    return distances_from(mesh.p.T[mesh.facets[:, mesh.boundaries[boundary]].T])


def distances_from(triangles: Array) -> Callable[[Array], Array]:
    """Return a function that returns the distance of points from triangles `(t, 3, 3)`.

    For points `(k, 3)`, the distance has shape `(k,)` [m].
    """
    finder = Finder(triangles)

    def away(points: Array) -> Array:
        each = zip(points, finder.nearest(points), strict=True)
        return np.array(
            [np.linalg.norm(closest_on_triangles(p, triangles[near]) - p, axis=1).min() for p, near in each]
        )

    return away


@dataclass(frozen=True, eq=False)
class Finder:
    """A search among `triangles` `(t, 3, 3)` [m] that measures only those near a point.

    A triangle is at most as far as its middle, and at least as far as its middle minus the largest
    radius of a triangle, with a margin for round-off.
    """

    triangles: Array

    @cached_property
    def _middles(self) -> tuple[cKDTree, float]:
        """The middles, and the largest radius [m]."""
        middles = self.triangles.mean(axis=1)
        radius = np.linalg.norm(self.triangles - middles[:, None], axis=2).max(initial=0.0)
        return cKDTree(middles), (1.0 + INSIDE) * float(radius)

    def nearest(self, points: Array) -> Any:
        """Return a list of triangles with the nearest one among them, in ascending order.

        `points` is one point `(3,)`, or several `(k, 3)`, each of which gets its own list.
        """
        tree, _ = self._middles
        return self._around(points, tree.query(points)[0])

    def within(self, point: Array, distance: float) -> Indices:
        """Return the triangles at most `distance` [m] from a point, in ascending order, shape `(k,)`."""
        near = np.array(self._around(point, distance), dtype=np.intp)
        away = np.linalg.norm(closest_on_triangles(point, self.triangles[near]) - point, axis=1)
        return near[away <= distance]

    def _around(self, points: Array, distance: Any) -> Any:
        tree, largest = self._middles
        return tree.query_ball_point(points, distance + largest, return_sorted=True)


def landing(mesh: MeshTet) -> Callable[[ArrayLike, ArrayLike | None], Array | None]:
    """Return a function that returns a point `(3,)` [m] on the surface of a mesh, or None.

    The function takes a point and a vector of any length. It returns the point at which the line
    along the vector meets the surface, or None if the line misses the surface. If there are several
    such points, the one nearest to the given point is returned. If the vector is None, the nearest
    point of the surface is returned.
    """
    surface = outer_surface(mesh)

    def find(point: ArrayLike, along: ArrayLike | None) -> Array | None:
        start = np.asarray(point, float)
        if along is None:
            return surface.nearest(start)[1]
        direction = np.asarray(along, float)
        return surface.met_by(start, direction / np.linalg.norm(direction))

    return find


def closest_on_triangles(point: Array, triangles: Array) -> Array:
    """Return the point of each triangle `(f, 3, 3)` nearest to `point` (3,), shape `(f, 3)`."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    foot = point - np.einsum("fi,fi->f", point - a, normal)[:, None] * normal
    inside = _triangle_coordinates(foot, a, b, c).min(axis=-1) >= 0.0
    candidates = np.stack([foot, *(_closest_on_segments(point, p, q) for p, q in ((a, b), (b, c), (c, a)))])
    distance = np.linalg.norm(candidates - point, axis=2)
    distance[0, ~inside] = np.inf
    return candidates[np.argmin(distance, axis=0), np.arange(len(a))]


def _closest_on_segments(point: Array, p: Array, q: Array) -> Array:
    edge = q - p
    t = np.einsum("fi,fi->f", point - p, edge) / np.einsum("fi,fi->f", edge, edge)
    return p + np.clip(t, 0.0, 1.0)[:, None] * edge


def _triangle_coordinates(points: Array, a: Array, b: Array, c: Array) -> Array:
    """Return the barycentric coordinates of points in the planes of triangles.

    Points `(…, f, 3)` and triangles `(f, 3)` give coordinates of shape `(…, f, 3)`.
    """
    e, g = b - a, c - a
    normal = np.cross(e, g)
    area = np.einsum("fi,fi->f", normal, normal)
    along = points - a
    second = np.einsum("...fi,fi->...f", along, np.cross(g, normal)) / area
    third = np.einsum("...fi,fi->...f", along, np.cross(normal, e)) / area
    return np.stack([1.0 - second - third, second, third], axis=-1)
