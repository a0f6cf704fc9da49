"""Facets of tetrahedra as integer keys, so that triangles can be compared and looked up."""

import numpy as np
import skfem
from numpy.typing import NDArray

from meshes.errors import MeshError

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# The four facets of a tetrahedron (0, 1, 2, 3), in the order of the opposite vertex.
FACETS_OF_TET = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def six_volumes(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return six times the signed volumes of tetrahedra, shape `(m,)`; corners have shape `(m, 3)` each.

    A volume is positive if the nodes a, b and c turn anticlockwise as seen from d.
    """
    return np.asarray(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)))


def triangle_keys(triangles: NDArray[np.integer], nodes: int) -> Indices:
    """Return one integer per triangle, `(k,)`, the same for every order of its nodes.

    Triangles have shape `(k, 3)`. At most two million nodes are possible, because the cube of a
    larger number exceeds 64 bits (`ValueError` from numpy).
    """
    ordered = np.sort(np.asarray(triangles, dtype=np.int64), axis=1)
    return np.asarray(np.ravel_multi_index(tuple(ordered.T), (nodes,) * 3), dtype=np.int64)


def tet_facet_keys(tets: NDArray[np.integer], nodes: int) -> Indices:
    """Return the keys of the four facets of each of the tetrahedra `(m, 4)`, shape `(m, 4)`."""
    return triangle_keys(tets[:, FACETS_OF_TET].reshape(-1, 3), nodes).reshape(-1, 4)


def facet_indices(mesh: skfem.MeshTet, triangles: NDArray[np.integer]) -> Indices:
    """Return the sorted facet numbers in `mesh` of the triangles, without repetition.

    Triangles have shape `(k, 3)`. Raises `MeshError` if a triangle is not a facet of a tetrahedron.
    """
    keys = triangle_keys(mesh.facets.T, mesh.nvertices)
    order = np.argsort(keys)
    wanted = triangle_keys(triangles, mesh.nvertices)
    place = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
    found = order[place]
    missing = np.flatnonzero(keys[found] != wanted)
    if missing.size:
        raise MeshError(
            f"{missing.size} of its {len(wanted)} triangles (the first: number {missing[0]}) are not facets of "
            "tetrahedra: mesh surface and volume together"
        )
    return np.unique(found)


def sharp_edges(mesh: skfem.MeshTet, degrees: float) -> Array:
    """Return the edges at which the surface turns by more than an angle, `(k, 2, 3)` [m].

    The angle is between outward normals. Edges are given by their two ends.
    """
    facets = mesh.boundary_facets()
    corners = mesh.facets[:, facets].T
    normals = outward_normals(mesh, facets)
    edges = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    same = (edges[order[:-1]] == edges[order[1:]]).all(axis=1)
    one, other = order[:-1][same] // 3, order[1:][same] // 3
    turned = np.sum(normals[one] * normals[other], axis=1) < np.cos(np.radians(degrees))
    return np.asarray(mesh.p.T[edges[order[:-1][same][turned]]])


def outward_normals(mesh: skfem.MeshTet, facets: NDArray[np.integer]) -> Array:
    """Return the outward unit normals of surface facets, shape `(k, 3)`."""
    a, b, c = np.moveaxis(mesh.p.T[mesh.facets[:, facets].T], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    inward = mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1).T - a
    return np.asarray(-np.sign(np.sum(normals * inward, axis=1, keepdims=True)) * normals)
