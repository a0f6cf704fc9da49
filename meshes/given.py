"""Meshes that are given as objects of scikit-fem, meshio or pyvista, all in metres."""

import hashlib
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray

from meshes.checks import volumes
from meshes.errors import MeshError
from meshes.named import checked_mesh

TETRA = 10  # VTK_TETRA
KINDS = "skfem.MeshTet, meshio.Mesh or pyvista.UnstructuredGrid of linear tetrahedra"


def given_mesh(mesh: Any) -> skfem.MeshTet:
    """Return a checked mesh from an object of another library.

    The mesh has the boundaries of the object and the boundary "surface". It may be several bodies.
    Tetrahedra can have either orientation. Names of boundaries and subdomains are only taken from
    meshes of scikit-fem. Raises `MeshError` for an invalid mesh.
    """
    points, tets = arrays_of(mesh)
    inverted = volumes(points, tets) < 0.0 if tets.size and tets.max() < len(points) else np.zeros(len(tets), bool)
    tets[inverted] = tets[inverted][:, [0, 2, 1, 3]]
    made = checked_mesh(points, tets, parts=None)
    facets = checked_names("boundary", getattr(mesh, "boundaries", None), made.nfacets)
    cells = checked_names("subdomain", getattr(mesh, "subdomains", None), made.nelements)
    named = {"surface": made.boundary_facets()} | facets
    empty = [name for name, facets in named.items() if not len(facets)]
    if empty:
        reason = "scikit-fem calls a function with the middles of facets, which lie off a curved surface"
        raise MeshError(f"the boundary {empty[0]!r} of the mesh has no facets; name facets of the mesh ({reason})")
    return made.with_boundaries(named).with_subdomains(cells)


def arrays_of(mesh: Any) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return copies of the points `(n, 3)` [m] and tetrahedra `(m, 4)` of an object.

    Raises `MeshError` for an object of an unknown type.
    """
    if isinstance(mesh, skfem.MeshTet):
        points, tets = mesh.p.T, mesh.t.T
    elif hasattr(mesh, "celltypes") and hasattr(mesh, "cells_dict"):
        points, tets = np.asarray(mesh.points), _only(dict(mesh.cells_dict), TETRA)
    elif hasattr(mesh, "cells_dict") and hasattr(mesh, "points"):
        points, tets = np.asarray(mesh.points), _only(dict(mesh.cells_dict), "tetra")
    else:
        raise MeshError(f"a {type(mesh).__name__} is not a known kind of mesh; give {KINDS}")
    return numbers_of("points", points, "f", 3), numbers_of("tetrahedra", tets, "iu", 4)


def numbers_of(what: str, values: Any, kinds: str, width: int) -> NDArray[Any]:
    """Return a copy of numbers of some kinds, shape `(n, width)`.

    Raises `MeshError` for other types and shapes.
    """
    array = np.array(values)
    if array.dtype.kind not in (kinds + "iu") or array.ndim != 2 or array.shape[1] != width:
        wanted = "whole numbers" if kinds == "iu" else "numbers"
        raise MeshError(f"the {what} of the mesh are {array.dtype} of shape {array.shape}; give {wanted}, (n, {width})")
    return array.astype(np.float64 if "f" in kinds else np.int64)


def checked_names(kind: str, named: Any, count: int) -> dict[str, Any]:
    """Return the facets or cells by name.

    Raises `MeshError` unless they are whole numbers from 0 to `count` − 1.
    """
    for name, part in dict(named or {}).items():
        array = np.asarray(part)
        if array.dtype.kind not in "iu" or array.ndim != 1 or not np.all((array >= 0) & (array < count)):
            raise MeshError(f"the {kind} {name!r} of the mesh is refused: give whole numbers from 0 to {count - 1}")
    return dict(named or {})


def _only(cells: dict[Any, Any], kind: Any) -> Any:
    """Return the cells of a kind.

    Points, lines and triangles are also allowed in the mesh. Raises `MeshError` for cells of other
    kinds.
    """
    beside = {kind, "vertex", "line", "triangle", 1, 3, 5}
    if kind not in cells or not set(cells) <= beside:
        raise MeshError(f"the mesh has cells of the kind {', '.join(map(str, cells)) or 'none'}; give {KINDS}")
    return cells[kind]


def mesh_digest(mesh: skfem.MeshTet) -> str:
    """Return the SHA-256 of a mesh, including its names."""
    text = hashlib.sha256()
    for array in (mesh.p, mesh.t):
        text.update(np.ascontiguousarray(array).tobytes())
    for names in (mesh.boundaries, mesh.subdomains):
        for name, part in sorted((names or {}).items()):
            text.update(name.encode() + np.ascontiguousarray(part, dtype=np.int64).tobytes())
    return text.hexdigest()
