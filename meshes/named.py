"""From points and tetrahedra to a checked `skfem.MeshTet` with named boundaries and subdomains."""

from collections.abc import Mapping
from copy import copy

import numpy as np
import skfem
from numpy.typing import NDArray

from meshes.checks import NO_TWINS, check
from meshes.facets import facet_indices

Array = NDArray[np.float64]
Named = Mapping[str, NDArray[np.integer]]


def named_mesh(
    points: Array, tets: NDArray[np.integer], surfaces: Named, volumes: Named, parts: int | None = 1
) -> skfem.MeshTet:
    """Return a checked mesh with its surfaces and volumes named.

    Points have shape `(n, 3)` [m], tets `(m, 4)`, surfaces name → triangles `(k, 3)`, volumes name → tet
    indices; `parts` as in `meshes.checks.check`. Raises `MeshError` from there, and when a named triangle is no
    facet.
    """
    mesh = checked_mesh(points, tets, parts=parts)
    boundaries = {name: facet_indices(mesh, triangles) for name, triangles in surfaces.items()}
    return with_boundaries(mesh, boundaries).with_subdomains(dict(volumes))


def with_boundaries(mesh: skfem.MeshTet, boundaries: Named) -> skfem.MeshTet:
    """Return the mesh with boundaries named, facet numbers by name, beside those that it has.

    As scikit-fem's own, but that the facets stay numbered: to number those of a large mesh again takes as long as all
    the rest of making it.
    """
    named = copy(mesh)
    named._boundaries = {**(mesh.boundaries or {}), **boundaries}
    return named


def checked_mesh(
    points: Array, tets: NDArray[np.integer], twins: NDArray[np.integer] = NO_TWINS, parts: int | None = 1
) -> skfem.MeshTet:
    """Return the `bare_mesh` of points and tets that pass `meshes.checks.check`, whose errors are raised."""
    check(points, tets, twins, parts)
    return bare_mesh(points, tets)


def bare_mesh(points: Array, tets: NDArray[np.integer]) -> skfem.MeshTet:
    """Return `skfem.MeshTet` in the column layout it keeps, nothing named; points `(n, 3)` [m], tets `(m, 4)`."""
    return skfem.MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(tets.T, dtype=np.int64))
