"""Estimates of the size of a graded mesh, and of the memory of the mesh and its organ.

The estimates are made before the mesh is made.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from meshes.grading import Grading, Gradings, far_size, grading_at

Array = NDArray[np.float64]

# Volume of a mean tetrahedron over the cube of the wanted size. The regular tetrahedron has
# 1/(6√2) = 0.118; gmsh's inner edges are a quarter longer than wanted. Measured: 0.19 to 0.24 on
# meshes of 5 000 to 40 000 tetrahedra.
TETRAHEDRON = 0.22
TETS_PER_NODE = {"P1": 4.7, "P2": 0.66}  # measured on the same meshes: 4.0 to 5.0, 0.61 to 0.68
# Memory of an organ with multigrid, measured as the peak of the process: 4.0 kB per unknown at 0.3
# million unknowns and 5.1 kB at 1.07 million (P1, with frames and picture), 7.3 kB at 0.19 million
# (P2). A factor that does not fit into memory is not computed (`tissue.solvers.choice`).
BYTES_PER_UNKNOWN = {"P1": 6.0e3, "P2": 9.0e3}
SHELLS, DIRECTIONS = 60, 200


@dataclass(frozen=True)
class Budget:
    """Expected size of a mesh and memory of its organ.

    It has the numbers of `tets` and of displacement `unknowns`, and the `memory` [byte] for the
    steps of an organ on the mesh.
    """

    tets: float
    unknowns: float
    memory: float


def budget(tets: float, element: str) -> Budget:
    """Return the estimated displacement unknowns and memory of a number of tetrahedra.

    The `element` is "P1" or "P2".
    """
    unknowns = 3.0 * tets / TETS_PER_NODE[element]
    return Budget(tets, unknowns, BYTES_PER_UNKNOWN[element] * unknowns)


def expected_tets(
    volume: float, grading: Gradings, sites: Array, inside: Callable[[Array], NDArray[np.bool_]]
) -> float:
    """Return the estimated number of tetrahedra, ∫ dV / (c h³) over a body of a volume [m³].

    Sites have shape `(p, 3)` [m], and `grading` is for all or for each. `inside` returns which points
    `(k, 3)` lie in the body. The sites increase 1/h³. This increase is summed on spheres about each
    site, over the points that have this site as the nearest one.
    """
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        cells = volume / np.float64(far_size(grading)) ** 3 + _added(grading_at(grading, len(sites)), sites, inside)
    return float(np.nan_to_num(cells, nan=np.inf, posinf=np.inf)) / TETRAHEDRON


def _added(gradings: Sequence[Grading], sites: Array, inside: Callable[[Array], NDArray[np.bool_]]) -> float:
    """Return ∫ (1/size³ − 1/h³) dV about the sites."""
    if all(each.h_site == each.h for each in gradings):
        return 0.0
    # Shells with equal numbers of elements resolve the fine zone as well as the coarse one.
    edges = np.stack([each.distance(np.linspace(0.0, float(each.cells(each.reach)), SHELLS + 1)) for each in gradings])
    middle, content = (edges[:, 1:] + edges[:, :-1]) / 2, 4 * np.pi / 3 * np.diff(edges**3)
    density = [each.size(m) ** -3 - np.float64(each.h) ** -3 for each, m in zip(gradings, middle, strict=True)]
    points = sites[:, None, None] + middle[..., None, None] * _directions()
    nearest = cKDTree(sites).query(points.reshape(-1, 3))[1].reshape(points.shape[:3])
    own = (nearest == np.arange(len(sites))[:, None, None]) & inside(points.reshape(-1, 3)).reshape(points.shape[:3])
    return float(np.sum(own.mean(axis=2) * content * density))


def _directions() -> Array:
    """Return uniformly distributed points of the unit sphere, `(DIRECTIONS, 3)`.

    The points lie on a spiral of the golden angle.
    """
    z = (2 * np.arange(DIRECTIONS) + 1) / DIRECTIONS - 1
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(DIRECTIONS)
    across = np.sqrt(1 - z * z)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])
