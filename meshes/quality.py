"""Shape quality of the tetrahedra of a mesh."""

from dataclasses import dataclass

import numpy as np
import skfem
from numpy.typing import NDArray

from meshes.facets import FACETS_OF_TET, six_volumes

Array = NDArray[np.float64]

EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


@dataclass(frozen=True)
class Quality:
    """Extremes and a median over all tetrahedra; the regular tetrahedron has 70.5° and ratio 1."""

    dihedral_min: float  # smallest angle between two facets [degree]
    radius_ratio_min: float  # smallest 3 × inscribed / circumscribed radius [-]
    radius_ratio_median: float  # [-]
    edge_min: float  # shortest edge [m]
    edge_max: float  # longest edge [m]


def quality(mesh: skfem.MeshTet) -> Quality:
    """Return the quality of a tetrahedral mesh."""
    corners = mesh.p.T[mesh.t.T]
    edges = edge_lengths(corners)
    ratios = radius_ratios(corners)
    return Quality(
        dihedral_min=float(np.degrees(dihedral_angles(corners).min())),
        radius_ratio_min=float(ratios.min()),
        radius_ratio_median=float(np.median(ratios)),
        edge_min=float(edges.min()),
        edge_max=float(edges.max()),
    )


def size_at(mesh: skfem.MeshTet, point: NDArray[np.floating]) -> float:
    """Return the mean length of the edges at the node nearest to a point (3,) [m]."""
    node = np.linalg.norm(mesh.p.T - point, axis=1).argmin()
    others = np.setdiff1d(mesh.t[:, (mesh.t == node).any(axis=0)], node)
    return float(np.linalg.norm(mesh.p[:, others].T - mesh.p[:, node], axis=1).mean())


def dihedral_angles(corners: Array) -> Array:
    """Return the six angles between facets of each tetrahedron, `(m, 6)` [rad].

    The corners have shape `(m, 4, 3)` [m].
    """
    normals = _facet_normals(corners)
    unit = normals / np.linalg.norm(normals, axis=2, keepdims=True)
    cosines = np.stack([-np.sum(unit[:, i] * unit[:, j], axis=1) for i, j in EDGES], axis=1)
    return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)))


def radius_ratios(corners: Array) -> Array:
    """Return 3 r/R of each tetrahedron, shape `(m,)`.

    r = 3V/ΣA, R = √(s(s−aA)(s−bB)(s−cC))/6V with 2s = aA + bB + cC (Crelle).
    """
    lengths = edge_lengths(corners)
    products = lengths[:, [0, 1, 2]] * lengths[:, [5, 4, 3]]
    s = products.sum(axis=1) / 2
    crelle = np.sqrt(np.maximum(s * np.prod(s[:, None] - products, axis=1), 0.0))
    six = np.abs(six_volumes(*np.moveaxis(corners, 1, 0)))
    area = np.linalg.norm(_facet_normals(corners), axis=2).sum(axis=1) / 2
    return np.asarray(3 * (six / 2 / area) * six / crelle)


def edge_lengths(corners: Array) -> Array:
    """Return the lengths of the six edges of each tetrahedron, `(m, 6)` [m]; corners have shape `(m, 4, 3)` [m]."""
    return np.asarray(np.linalg.norm(np.stack([corners[:, j] - corners[:, i] for i, j in EDGES], axis=1), axis=2))


def _facet_normals(corners: Array) -> Array:
    """Return the outward normals of the four facets, shape `(m, 4, 3)`.

    Their length is twice the area of the facet.
    """
    facets = corners[:, FACETS_OF_TET]
    normals = np.cross(facets[:, :, 1] - facets[:, :, 0], facets[:, :, 2] - facets[:, :, 0])
    inward = np.sum(normals * (corners - facets[:, :, 0]), axis=2, keepdims=True)
    return np.asarray(-np.sign(inward) * normals)
