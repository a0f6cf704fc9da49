"""Pairing of points with a surface of triangles.

Each point faces a point of the surface, and gets the normal there. At an end of the surface, a
point faces the edge up to a distance of half a triangle. Within this distance, part of the area
around the point is still over the surface. A point farther away faces no triangle.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tissue.arrays import Array, Indices

Mask = NDArray[np.bool_]

NEAREST = 24  # triangles with the nearest centres: the triangle that a point faces is one of them
EDGE = 0.5  # of a triangle's size: a point farther past the edge of the surface faces no triangle
UPRIGHT = 0.2  # least cosine between normal and `along`; on a steeper slope `along` is the normal
OPPOSITE = np.array([[1, 2], [0, 2], [0, 1]])  # sides of a triangle, opposite to its corners


def face(at: Array, points: Array, triangles: Indices, ends: Mask, along: Array | None) -> Array:
    """Return the facing of points `at` `(k, 3)`, shape `(k, 7)`.

    The columns are the triangle, the barycentric coordinates and the gap vector. The triangle is −1
    if a point faces no triangle.

    `triangles` `(m, 3)` of `points` `(n, 3)` [m] have normals that point away from `at`; `ends` are
    their open sides. A point faces the nearest point of the surface. With `along`, a unit vector
    (3,), it faces the point in front of it or behind it in this direction. The gap is the distance
    along the averaged normal n. With `along`, it is this distance divided by n·along, which is the
    distance in this direction.
    """
    corners, normals = points[triangles], averaged_normals(points, triangles)
    flat = np.eye(3) if along is None else across(along)
    seen, seen_corners, sizes = at @ flat.T, corners @ flat.T, triangle_sizes(corners)
    triangle, inside, away = nearest(seen, seen_corners)
    n = np.einsum("kc,kcx->kx", inside, normals[triangle])
    n /= np.linalg.norm(n, axis=1)[:, None]
    past = seen - np.einsum("kc,kcx->kx", inside, seen_corners[triangle])
    if along is None:
        away = np.linalg.norm(past - np.vecdot(past, n)[:, None] * n, axis=1)
        away *= ((inside <= 0.0) & ends[triangle]).any(axis=1)
    else:
        slope = n @ along
        n = np.where(slope[:, None] > UPRIGHT, n / np.maximum(slope, UPRIGHT)[:, None], along)
    return np.column_stack([np.where(away > EDGE * sizes[triangle], -1.0, triangle), inside, n])


def across(normal: Array) -> Array:
    """Return two perpendicular unit vectors normal to `normal`, shape `(2, 3)`."""
    return np.linalg.svd(normal[None])[2][1:]


def triangle_sizes(corners: Array) -> Array:
    """Return the sizes √(2A) of triangles `(m, 3, 3)`, shape `(m,)` [m]."""
    return np.asarray(np.sqrt(np.linalg.norm(area_normals(corners), axis=1)))


def averaged_normals(points: Array, triangles: Indices) -> Array:
    """Return averaged unit normals at the corners of `triangles` `(m, 3)`, shape `(m, 3, 3)`.

    The normal at a corner is the mean of the normals of its triangles, weighted by area. `points`
    `(n, 3)` [m] are the nodes.
    """
    each, mean = area_normals(points[triangles]), np.zeros((len(points), 3))
    for corner in range(3):
        np.add.at(mean, triangles[:, corner], each)
    normals = mean[triangles]
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    own = (each / np.linalg.norm(each, axis=1, keepdims=True))[:, None]
    return np.where(length > 0.0, normals / np.where(length > 0.0, length, 1.0), own)


def facet_normals(corners: Array) -> Array:
    """Return the unit normals of triangles `(m, 3, 3)`, shape `(m, 3)`."""
    normals = area_normals(corners)
    return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])


def area_normals(corners: Array) -> Array:
    """Return the cross products of two sides of triangles `(m, 3, 3)`, shape `(m, 3)` [m²].

    Their lengths are twice the areas.
    """
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def open_sides(triangles: Indices) -> Mask:
    """Return which sides 12, 02, 01 of `triangles` `(m, 3)` belong to no other, shape `(m, 3)`."""
    sides = np.sort(triangles[:, OPPOSITE].reshape(-1, 2), axis=1)
    _, side, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    return np.asarray(count[side.ravel()].reshape(-1, 3) == 1)


def nearest(at: Array, corners: Array) -> tuple[Indices, Array, Array]:
    """Return the triangle nearest to each point `at` `(k, d)`, its nearest point and the distance.

    They have shapes `(k,)`, `(k, 3)` and `(k,)`. Triangles have `corners` `(m, 3, d)`; the nearest
    points are in barycentric coordinates.
    """
    near = cKDTree(corners.mean(axis=1)).query(at, min(NEAREST, len(corners)))[1].reshape(len(at), -1)
    inside, each = _barycentric(at[:, None], corners[near]), corners[near].reshape(-1, *corners.shape[1:])
    held = _held_inside(at.repeat(near.shape[1], axis=0), each, inside.reshape(-1, 3)).reshape(inside.shape)
    away = np.linalg.norm(np.einsum("kjc,kjcx->kjx", held, corners[near]) - at[:, None], axis=2)
    best, rows = np.argmin(away, axis=1), np.arange(len(at))
    return near[rows, best], held[rows, best], away[rows, best]


def _barycentric(at: Array, corners: Array) -> Array:
    """Return the barycentric coordinates of points `at` `(…, d)` in triangles `(…, 3, d)`.

    For a point outside the plane of its triangle, they are those of the foot of the perpendicular.
    """
    u, v, w = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :], at - corners[..., 0, :]
    uu, uv, vv, uw, vw = (np.sum(a * b, axis=-1) for a, b in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    area = uu * vv - uv * uv
    second, third = (vv * uw - uv * vw) / area, (uu * vw - uv * uw) / area
    return np.stack([1.0 - second - third, second, third], axis=-1)


def _held_inside(at: Array, corners: Array, inside: Array) -> Array:
    """Return the barycentric coordinates of the points in triangles that are nearest to `at`.

    The triangles have `corners` `(k, 3, d)`. The points `at` `(k, d)` have the barycentric
    coordinates `inside` `(k, 3)`.
    """
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
