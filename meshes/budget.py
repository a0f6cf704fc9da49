"""Estimates, before a graded mesh is made, of its size and of the memory that the mesh and its organ take."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from meshes.grading import Grading

Array = NDArray[np.float64]

# Volume of a mean tetrahedron over the cube of the wanted size. The regular one has 1/(6√2) = 0.118; gmsh's inner
# edges are a quarter longer than wanted. Measured: 0.19 to 0.24 on meshes of 5 000 to 40 000 tetrahedra.
TETRAHEDRON = 0.22
TETS_PER_NODE = {"P1": 4.7, "P2": 0.66}  # measured on the same meshes: 4.0 to 5.0, 0.61 to 0.68
# Memory of an organ by multigrid, measured as the peak of the process: 4.0 kB an unknown at 0.3 million and 5.1 at 1.07
# (P1, with frames and picture), 7.3 at 0.19 (P2). A factor that has no room is not made (`tissue.solvers.choice`).
BYTES_PER_UNKNOWN = {"P1": 6.0e3, "P2": 9.0e3}
SHELLS, DIRECTIONS = 60, 200


@dataclass(frozen=True)
class Budget:
    """Expected size of a mesh: tetrahedra, displacement unknowns, and memory [byte] to step an organ on it."""

    tets: float
    unknowns: float
    memory: float


def budget(tets: float, element: str) -> Budget:
    """Estimate the displacement unknowns of so many tetrahedra, "P1" or "P2", and the memory they take."""
    unknowns = 3.0 * tets / TETS_PER_NODE[element]
    return Budget(tets, unknowns, BYTES_PER_UNKNOWN[element] * unknowns)


def expected_tets(volume: float, grading: Grading, sites: Array, inside: Callable[[Array], NDArray[np.bool_]]) -> float:
    """Estimate the number of tetrahedra, ∫ dV / (c h³) over a body of a volume [m³].

    Sites have shape `(p, 3)` [m]; `inside` tells which of points `(k, 3)` lie in the body. The part that the
    sites add to 1/h³ is summed on spheres about each site, over the points nearest to it.
    """
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        cells = volume / np.float64(grading.h) ** 3 + _added(grading, sites, inside)
    return float(np.nan_to_num(cells, nan=np.inf, posinf=np.inf)) / TETRAHEDRON


def _added(grading: Grading, sites: Array, inside: Callable[[Array], NDArray[np.bool_]]) -> float:
    """Return ∫ (1/size³ − 1/h³) dV about the sites."""
    if not len(sites) or grading.h_site == grading.h:
        return 0.0
    # Shells of equal numbers of elements resolve the fine zone as well as the coarse.
    edges = np.asarray(grading.distance(np.linspace(0.0, float(grading.cells(grading.reach)), SHELLS + 1)))
    middle, content = (edges[1:] + edges[:-1]) / 2, 4 * np.pi / 3 * np.diff(edges**3)
    density = (grading.size(middle) ** -3 - np.float64(grading.h) ** -3) * content
    points = sites[:, None, None] + middle[:, None, None] * _directions()
    nearest = cKDTree(sites).query(points.reshape(-1, 3))[1].reshape(points.shape[:3])
    own = (nearest == np.arange(len(sites))[:, None, None]) & inside(points.reshape(-1, 3)).reshape(points.shape[:3])
    return float(np.sum(own.mean(axis=2) * density))


def _directions() -> Array:
    """Return the points spread evenly over the unit sphere, on a spiral of the golden angle, shape
    `(DIRECTIONS, 3)`.
    """
    z = (2 * np.arange(DIRECTIONS) + 1) / DIRECTIONS - 1
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(DIRECTIONS)
    across = np.sqrt(1 - z * z)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])
