"""What the tests of meshes share."""

import numpy as np
import pytest
import skfem

from meshes.errors import MeshError
from meshes.gmsh_session import load_gmsh


def _gmsh_fault() -> str:
    try:
        load_gmsh()
    except MeshError as error:
        return str(error)
    return ""


NEEDS_GMSH = pytest.mark.skipif(bool(_gmsh_fault()), reason=_gmsh_fault())


def facet_areas(mesh: skfem.MeshTet, facets: np.ndarray) -> np.ndarray:
    """Areas of facets by their numbers [m²]."""
    a, b, c = (mesh.p[:, mesh.facets[k, facets]].T for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def euler_characteristic(mesh: skfem.MeshTet) -> int:
    """V − E + F of the surface: 2 for a ball, 0 for a ring, 4 for two balls."""
    facets = mesh.boundary_facets()
    edges = {tuple(sorted(pair)) for a, b, c in mesh.facets[:, facets].T for pair in ((a, b), (b, c), (c, a))}
    return len(np.unique(mesh.facets[:, facets])) - len(edges) + len(facets)


def node_sizes(mesh: skfem.MeshTet) -> np.ndarray:
    """Mean length of the edges at each node [m]."""
    ends = mesh.p[:, mesh.edges]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=0)
    nodes = mesh.edges.ravel()
    return np.bincount(nodes, np.tile(length, 2)) / np.bincount(nodes)
