"""Where a point lies on or in a tetrahedral mesh: the outer surface, its normals, projections and containing
cells.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from skfem import MeshTet

from tissue.arrays import Array, Indices

INSIDE = 1e-9  # barycentric coordinates down to −INSIDE count as inside: the round-off of a point on a face
ON_SURFACE = 1e-3  # of the bounding-box diagonal: a site this near the surface is meant to be on it
EDGE_ON = 1e-9  # cosine between a line and a facet's normal below which it runs along the facet
BLOCK = 4_000_000  # point–cell pairs tested at a time, to bound memory


@dataclass(frozen=True)
class Surface:
    """The outer facets of `mesh`: triangles `(f, 3, 3)` [m], outward unit normals `(f, 3)`, the cell behind
    each `(f,)`.
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
        """Per cell the matrix from x − first vertex to reference coordinates, shape `(c, 3, 3)` [1/m]."""
        edges = self.corners[:, 1:] - self.corners[:, :1]
        return np.asarray(np.linalg.inv(np.swapaxes(edges, 1, 2)), dtype=np.float64)

    def nearest(self, point: Array) -> tuple[float, Array, Indices]:
        """Return the distance to the surface [m], the nearest point (3,) and every facet that shares that point; of
        cells cut from inside a body, which have no facet of its surface, no distance is reached."""
        if not len(self.triangles):
            return np.inf, np.full(3, np.nan), np.zeros(0, np.intp)
        near = closest_on_triangles(point, self.triangles)
        distances = np.linalg.norm(near - point, axis=1)
        best = near[np.argmin(distances)]
        touching = np.linalg.norm(closest_on_triangles(best, self.triangles) - best, axis=1)
        return float(distances.min()), best, np.flatnonzero(touching <= INSIDE * self.diagonal)

    def met_by(self, point: Array, along: Array) -> Array | None:
        """Return where the line through `point` along the unit vector `along` meets the surface, of several places the
        one nearest to `point`, shape `(3,)` [m]; None where it does not.
        """
        facing = np.flatnonzero(np.abs(self.normals @ along) > EDGE_ON)
        if facing.size == 0:
            return None
        hits, struck = self.project(point[None], along, facing, np.inf)
        return None if struck[0] < 0 else hits[0]

    def patch(self, centre: Array, seeds: Indices, normal: Array, radius: float) -> Indices:
        """Return the facets that face `normal`, come within `radius` of `centre` and are joined to `seeds` by edges.

        So a disc near an open cut averages over its own lip and not over the other, though both lie in one
        plane.
        """
        reach = np.linalg.norm(closest_on_triangles(centre, self.triangles) - centre, axis=1) <= radius
        facets = np.flatnonzero(reach & (self.normals @ normal > 0.0))
        lookup = self.vertices[facets]
        incidence = csr_matrix((np.ones(lookup.size), (np.repeat(np.arange(facets.size), 3), lookup.ravel())))
        shared = csr_matrix(incidence @ incidence.T)
        shared.data[shared.data < 2.0] = 0.0
        shared.eliminate_zeros()
        _, label = connected_components(shared, directed=False)
        return facets[np.isin(label, label[np.isin(facets, seeds)])]

    def project(self, points: Array, normal: Array, facets: Indices, reach: float) -> tuple[Array, Indices]:
        """Return the nearest hit of each point's line along `normal` with `facets`.

        Hits are points `(k, 3)` and facets `(k,)`, −1 where a line hits none.
        """
        step = max(1, BLOCK // (3 * max(1, facets.size)))
        parts = [self._project(points[k : k + step], normal, facets, reach) for k in range(0, len(points), step)]
        return np.concatenate([hits for hits, _ in parts]), np.concatenate([struck for _, struck in parts])

    def _project(self, points: Array, normal: Array, facets: Indices, reach: float) -> tuple[Array, Indices]:
        a, b, c = np.moveaxis(self.triangles[facets], 1, 0)
        slope = self.normals[facets] @ normal
        height = (np.einsum("fi,fi->f", a, self.normals[facets]) - points @ self.normals[facets].T) / slope
        hit = points[:, None] + height[..., None] * normal
        bary = _triangle_coordinates(hit, a, b, c)
        height = np.where((bary.min(axis=-1) >= -INSIDE) & (np.abs(height) <= reach), np.abs(height), np.inf)
        best = np.argmin(height, axis=1)
        rows = np.arange(len(points))
        return hit[rows, best], np.where(np.isfinite(height[rows, best]), facets[best], -1)

    def containing(self, points: Array) -> Indices:
        """Return a cell that holds each point, shape `(k,)`; −1 for points outside the body."""
        low, high = points.min(axis=0), points.max(axis=0)
        slack = INSIDE * self.diagonal
        box = (self.corners.max(axis=1) >= low - slack) & (self.corners.min(axis=1) <= high + slack)
        near = np.flatnonzero(box.all(axis=1))
        if near.size == 0:
            return np.full(len(points), -1, np.intp)
        step = max(1, BLOCK // near.size)
        parts = [self._containing(points[k : k + step], near) for k in range(0, len(points), step)]
        return np.concatenate(parts)

    def depths(self, points: Array) -> Array:
        """Return how deep points `(k, 3)` lie below the nearest surface, shape `(k,)` [m]; negative outside."""
        inside = self.containing(points) >= 0
        return np.where(inside, 1.0, -1.0) * self.away(points)

    @cached_property
    def away(self) -> Callable[[Array], Array]:
        """What tells how far points `(k, 3)` are from the surface, shape `(k,)` [m]."""
        return distances_from(self.triangles)

    def sharing(self, point: Array) -> Indices:
        """Return every cell that holds `point`, faces and corners included."""
        return np.flatnonzero(self._depth(point[None], np.arange(self.mesh.nelements))[0] >= -INSIDE)

    def reference(self, points: Array, cells: Indices) -> Array:
        """Return the reference coordinates of points in cells, shape `(k, 3)`."""
        return np.einsum("kij,kj->ki", self.to_reference[cells], points - self.corners[cells, 0])

    def _containing(self, points: Array, near: Indices) -> Indices:
        depth = self._depth(points, near)
        best = np.argmax(depth, axis=1)
        return np.where(depth[np.arange(len(points)), best] >= -INSIDE, near[best], -1)

    def _depth(self, points: Array, cells: Indices) -> Array:
        """Return the smallest barycentric coordinate of every point in every cell, shape `(k, c)`."""
        B = self.to_reference[cells]
        origin = np.einsum("cij,cj->ci", B, self.corners[cells, 0])
        depth = 1.0
        total = np.zeros((len(points), len(cells)))
        for i in range(3):
            xi = points @ B[:, i].T - origin[:, i]
            total += xi
            depth = np.minimum(depth, xi)
        return np.minimum(depth, 1.0 - total)


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
    """Return what tells how deep points `(k, 3)` lie in a mesh below its nearest surface, shape `(k,)` [m], negative
    outside."""
    return outer_surface(mesh).depths


def distances(mesh: MeshTet, boundary: str) -> Callable[[Array], Array]:
    """Return what tells how far points `(k, 3)` are from a boundary of a mesh by its name, shape `(k,)` [m]."""
    return distances_from(mesh.p.T[mesh.facets[:, mesh.boundaries[boundary]].T])


def distances_from(triangles: Array) -> Callable[[Array], Array]:
    """Return what tells how far points `(k, 3)` are from the nearest of some triangles `(t, 3, 3)`, shape `(k,)` [m].

    That one is no further with its middle than the nearest middle and the largest radius of a triangle, with room for
    its rounding.
    """
    from scipy.spatial import cKDTree

    middles = triangles.mean(axis=1)
    tree = cKDTree(middles)
    largest = (1.0 + INSIDE) * float(np.linalg.norm(triangles - middles[:, None], axis=2).max())

    def away(points: Array) -> Array:
        near = tree.query_ball_point(points, tree.query(points)[0] + largest)
        each = zip(points, near, strict=True)
        return np.array(
            [np.linalg.norm(closest_on_triangles(p, triangles[those]) - p, axis=1).min() for p, those in each]
        )

    return away


def landing(mesh: MeshTet) -> Callable[[ArrayLike, ArrayLike | None], Array | None]:
    """Return what finds the place `(3,)` [m] nearest to a point at which a line through it, along a vector of any
    length, meets the surface of a mesh, None where it does not; without a vector the nearest of the whole surface."""
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
    """Return the barycentric coordinates of points `(…, f, 3)` in the planes of triangles `(f, 3)`, shape
    `(…, f, 3)`.
    """
    e, g = b - a, c - a
    normal = np.cross(e, g)
    area = np.einsum("fi,fi->f", normal, normal)
    along = points - a
    second = np.einsum("...fi,fi->...f", along, np.cross(g, normal)) / area
    third = np.einsum("...fi,fi->...f", along, np.cross(normal, e)) / area
    return np.stack([1.0 - second - third, second, third], axis=-1)
