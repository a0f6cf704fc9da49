"""Checked `skfem.MeshTet` with named boundaries and subdomains from points and tetrahedra."""

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
    """Return a checked mesh with named surfaces and volumes.

    Points have shape `(n, 3)` [m], tets `(m, 4)`, surfaces name → triangles `(k, 3)`, volumes name
    → tet indices; `parts` as in `meshes.checks.check`. Raises the `MeshError` of
    `meshes.checks.check`, and `MeshError` if a named triangle is not a facet.
    """
    mesh = checked_mesh(points, tets, parts=parts)
    boundaries = {name: facet_indices(mesh, triangles) for name, triangles in surfaces.items()}
    return with_boundaries(mesh, boundaries).with_subdomains(dict(volumes))


def with_boundaries(mesh: skfem.MeshTet, boundaries: Named) -> skfem.MeshTet:
    """Return the mesh with additional named boundaries, given as facet numbers by name.

    scikit-fem's own function would number the facets again, which for a large mesh takes as long as
    the rest of its construction.
    """
    named = copy(mesh)
    named._boundaries = {**(mesh.boundaries or {}), **boundaries}
    return named


def checked_mesh(
    points: Array, tets: NDArray[np.integer], twins: NDArray[np.integer] = NO_TWINS, parts: int | None = 1
) -> skfem.MeshTet:
    """Return the `bare_mesh` of points and tets.

    Raises the `MeshError` of `meshes.checks.check`.
    """
    check(points, tets, twins, parts)
    return bare_mesh(points, tets)


def bare_mesh(points: Array, tets: NDArray[np.integer]) -> skfem.MeshTet:
    """Return a `skfem.MeshTet` without names from points `(n, 3)` [m] and tets `(m, 4)`."""
    return skfem.MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(tets.T, dtype=np.int64))
