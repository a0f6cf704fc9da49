"""Supports of the organ.

Clamps fix all components of a node. Rollers fix a plane boundary along its normal.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from skfem import Basis, MeshTet

from tissue.arrays import Array, Indices
from tissue.errors import TissueError

PLANE = 1e-9  # of the body's size: largest distance of the nodes of a plane boundary from the plane
ROUND = 1e-6  # of a unit vector: smaller components are round-off
FIRM = 1e-8  # a rigid motion with a smaller relative stiffness is not held


def held_facets(mesh: MeshTet, clamp: Sequence[str], roller: Sequence[str]) -> NDArray[np.bool_]:
    """Return which components of each facet `clamp` and `roller` hold, shape `(facets, 3)`.

    Raises `TissueError` for a boundary that the mesh does not name, and for a roller that is not a
    plane normal to an axis.
    """
    held = np.zeros((mesh.nfacets, 3), dtype=bool)
    for name in clamp:
        held[facets_of(mesh, "clamp", name)] = True
    for name in roller:
        held[facets_of(mesh, "roller", name), axis_of(mesh, name)] = True
    return held


def held_unknowns(basis: Basis, clamp: Sequence[str], roller: Sequence[str]) -> Indices:
    """Return the sorted unknowns that `clamp` and `roller` hold. Raises as `held_facets`."""
    facets = held_facets(basis.mesh, clamp, roller).T
    held = [unknowns_on(basis, np.flatnonzero(own))[axis] for axis, own in enumerate(facets) if own.any()]
    return np.unique(np.concatenate([np.empty(0, np.intp), *held])).astype(np.intp)


def unknowns_on(basis: Basis, facets: Indices) -> Indices:
    """Return the unknowns of the nodes on facets, a row for each component, shape `(3, k)`."""
    corners = basis.nodal_dofs[:, np.unique(basis.mesh.facets[:, facets])]
    if not basis.edge_dofs.size:  # skips a slow numbering of edges by scikit-fem
        return np.asarray(corners)
    edges = basis.edge_dofs[:, np.unique(basis.mesh.f2e[:, facets])]
    return np.hstack([corners, edges])


def held_components(mesh: MeshTet, clamp: Sequence[str], roller: Sequence[str]) -> NDArray[np.bool_]:
    """Return which components of each vertex `clamp` and `roller` hold, shape `(vertices, 3)`.

    Raises `TissueError` as `held_facets` does.
    """
    held = np.zeros((mesh.nvertices, 3), dtype=bool)
    for axis, own in enumerate(held_facets(mesh, clamp, roller).T):
        held[mesh.facets[:, own], axis] = True
    return held


def facets_of(mesh: MeshTet, key: str, name: str) -> Indices:
    """Return the facets of a boundary.

    Raises `TissueError` with the known names if the boundary does not exist.
    """
    boundaries = mesh.boundaries or {}
    if name not in boundaries:
        known = ", ".join(sorted(boundaries)) or "none"
        raise TissueError(f"{key}: no boundary is named {name!r}; the mesh names {known}")
    return np.asarray(boundaries[name], dtype=np.intp)


def outer_facets_of(mesh: MeshTet, key: str, name: str) -> Indices:
    """Return the facets of a boundary on the surface of the organ.

    Raises `TissueError` if the boundary does not exist or if some of its facets lie inside.
    """
    facets = facets_of(mesh, key, name)
    if (mesh.f2t[1, facets] >= 0).any():
        raise TissueError(f"{key}: the boundary {name!r} has facets inside the organ; name one on its surface")
    return facets


def axis_of(mesh: MeshTet, name: str) -> int:
    """Return the axis 0, 1, 2 normal to a plane boundary.

    Raises `TissueError` for any other boundary.
    """
    nodes = mesh.facets[:, facets_of(mesh, "roller", name)].ravel()
    thickness, size = np.ptp(mesh.p[:, nodes], axis=1), np.ptp(mesh.p, axis=1).max()
    axis = int(np.argmin(thickness))
    if thickness[axis] > PLANE * size:
        raise TissueError(
            f"roller: the boundary {name!r} is not a plane normal to the x, y or z axis ({thickness[axis]:.3g} m "
            "thick); clamp it, or name a plane boundary"
        )
    return axis


def holds_still(points: Array, held: NDArray[np.bool_]) -> bool:
    """Return whether a rigid body with `points` (k, 3) [m] held in the components `held` (k, 3)
    cannot move.
    """
    return not rigid_motions(points, held).size


def motions_in_words(motions: Array) -> str:
    """Return the axes along which and about which a body can move, in words.

    `motions` are its `rigid_motions`.
    """
    turns = motions[np.linalg.norm(motions[:, 3:], axis=1) > ROUND]
    slides = motions[np.linalg.norm(motions[:, 3:], axis=1) <= ROUND]
    ways = [(slides[:, :3], "move along"), (turns[:, 3:], "turn about an axis along")]
    return " and ".join(f"{verb} {_axes(axes)}" for axes, verb in ways if len(axes))


def _axes(axes: Array) -> str:
    """Return the names of the directions that the vectors `axes` span.

    The names are x, y, z if the directions are axes, else one vector each.
    """
    span = np.linalg.svd(axes)[2][: np.linalg.matrix_rank(axes, tol=ROUND)]
    known = [name for name, unit in zip("xyz", np.eye(3), strict=True) if np.linalg.norm(span @ unit) > 1.0 - ROUND]
    return ", ".join(known if len(known) == len(span) else [str(np.round(v, 3).tolist()) for v in span])


def rigid_motions(points: Array, held: NDArray[np.bool_]) -> Array:
    """Return a basis of the possible rigid motions of a partly held body, shape `(d, 6)`,
    translations first.

    The body has `points` (k, 3) [m], held in the components `held` (k, 3). A row has the motion of
    its centre and the rotation about the centre.
    """
    node, component = np.nonzero(held)
    if node.size == 0:
        return np.eye(6)
    x = points[node] - points[node].mean(axis=0)
    x /= max(float(np.abs(x).max()), np.finfo(float).tiny)
    rotations = np.cross(np.eye(3)[None], x[:, None])  # e_b × x
    rows = np.concatenate([np.eye(3)[component], rotations[np.arange(len(node)), :, component]], axis=1)
    values, vectors = np.linalg.eigh(rows.T @ rows)
    free = vectors[:, values <= FIRM * len(node)].T
    mixed, sizes, _ = np.linalg.svd(free[:, 3:])
    order = np.argsort(np.append(sizes, np.zeros(len(free) - len(sizes))) > ROUND, kind="stable")
    return np.asarray(mixed.T[order] @ free)
