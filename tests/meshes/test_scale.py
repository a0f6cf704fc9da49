"""A shape in another unit of length has the same mesh."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
import skfem

from meshes.block import graded_block_gmsh
from meshes.cylinder import cylinder, stumps, tube
from meshes.grading import Grading
from meshes.laceration import Laceration, lacerated
from meshes.skin import Skin, fill
from meshes.wound import Wound, wounded_block_gmsh
from tests.bounds import IDENTITY
from tests.meshes.samples import NEEDS_GMSH

TORN = lacerated(Laceration(rings=12, around=12, layers=2))


def grading(metre: float) -> Grading:
    return Grading(6e-3 * metre, 2e-3 * metre, radius=1.5e-3 * metre)


def size(metre: float) -> list[float]:
    return [0.05 * metre, 0.04 * metre, 0.02 * metre]


def sites(metre: float, *places: Any) -> np.ndarray:
    return metre * np.array(places)


MAKERS: Mapping[str, Callable[[float], skfem.MeshTet]] = {
    "block": lambda m: graded_block_gmsh(size(m), grading(m), sites(m, [0.005, 0, 0]), ((), (), (-2e-3 * m,))),
    "slit": lambda m: wounded_block_gmsh(size(m), Wound(0.02 * m, 8e-3 * m), grading(m), sites(m, [0.005, 0, 0])),
    "ellipse": lambda m: wounded_block_gmsh(size(m), Wound(0.02 * m, 8e-3 * m, 3e-3 * m), grading(m)),
    "cylinder": lambda m: cylinder(0.01 * m, 0.03 * m, grading(m), sites(m, [0, 0, 0.01])),
    "tube": lambda m: tube(0.01 * m, 4e-3 * m, 0.03 * m, grading(m), sites(m, [0, 0, 0.01])),
    "stumps": lambda m: stumps(0.01 * m, 4e-3 * m, 0.04 * m, 2e-3 * m, grading(m), sites(m, [0.005, 0, 0.01])),
    "surface": lambda m: fill(Skin(m * TORN.points, TORN.triangles), grading(m), sites(m, [0.01, 0, 0.02])),
}


@NEEDS_GMSH
@pytest.mark.parametrize("name", MAKERS)
def test_a_shape_in_another_unit_has_the_same_mesh(name: str) -> None:
    """Independent check: centimetres, millimetres and units of two seeds: the same cells on the same nodes."""
    whole = MAKERS[name](1.0)
    for metre in (1e2, 1e3, *10.0 ** np.random.default_rng(36).uniform(-2.0, 4.0, 2)):
        other = MAKERS[name](metre)
        assert np.array_equal(other.t, whole.t)
        assert np.abs(other.p / metre - whole.p).max() <= IDENTITY * np.ptp(whole.p)
        assert other.boundaries.keys() == whole.boundaries.keys()
        assert all(np.array_equal(other.boundaries[key], facets) for key, facets in whole.boundaries.items())
