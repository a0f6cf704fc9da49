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
