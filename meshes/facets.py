"""Facets of tetrahedra as integer keys, so that triangles can be compared and looked up."""

import numpy as np
import skfem
from numpy.typing import NDArray

from meshes.errors import MeshError

Indices = NDArray[np.int64]

# The four facets of a tetrahedron (0, 1, 2, 3), by the vertex they leave out.
FACETS_OF_TET = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def triangle_keys(triangles: NDArray[np.integer], nodes: int) -> Indices:
    """One integer per triangle, the same for every order of its nodes; triangles of shape `(k, 3)`, keys
    `(k,)`.

    Exact up to two million nodes, where the cube of their number leaves 64 bits (`ValueError` from numpy).
    """
    ordered = np.sort(np.asarray(triangles, dtype=np.int64), axis=1)
    return np.asarray(np.ravel_multi_index(tuple(ordered.T), (nodes,) * 3), dtype=np.int64)


def tet_facet_keys(tets: NDArray[np.integer], nodes: int) -> Indices:
    """Keys of the four facets of each tetrahedron, tets of shape `(m, 4)`, keys `(m, 4)`."""
    return triangle_keys(tets[:, FACETS_OF_TET].reshape(-1, 3), nodes).reshape(-1, 4)


def facet_indices(mesh: skfem.MeshTet, triangles: NDArray[np.integer]) -> Indices:
    """Facet numbers in `mesh` of the triangles, shape `(k, 3)`, sorted and without repetition.

    Raises `MeshError` when a triangle is no facet of any tetrahedron.
    """
    keys = triangle_keys(mesh.facets.T, mesh.nvertices)
    order = np.argsort(keys)
    wanted = triangle_keys(triangles, mesh.nvertices)
    place = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
    found = order[place]
    missing = np.flatnonzero(keys[found] != wanted)
    if missing.size:
        raise MeshError(
            f"{missing.size} of its {len(wanted)} triangles (the first: number {missing[0]}) are no facet of "
            "any tetrahedron: mesh surface and volume together"
        )
    return np.unique(found)
