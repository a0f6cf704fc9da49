"""What a mesh will cost, before it is made."""

import numpy as np
import pytest

from meshes.block import extent, graded_block_gmsh
from meshes.budget import TETRAHEDRON, budget, expected_tets
from meshes.cylinder import tube
from meshes.grading import Grading
from tests.meshes.samples import NEEDS_GMSH

SIZE = (0.05, 0.03, 0.02)
LOWER, UPPER = extent(SIZE)
SITES = np.array([[-0.005, 0.0, 0.0], [0.005, 0.0, 0.0]])


def in_block(points: np.ndarray) -> np.ndarray:
    return ((points >= LOWER) & (points <= UPPER)).all(axis=1)


def everywhere(points: np.ndarray) -> np.ndarray:
    return np.ones(len(points), dtype=bool)


def test_the_integral_is_that_of_one_ball():
    """Independent check: ∫ 4πr² (1/(a + b(r − f))³ − 1/h³) dr in closed form, on an inner ball and a cone of sizes."""
    grading = Grading(4e-3, 1e-3, growth=1.5)
    a, b, f, h, reach = 1e-3, np.log(1.5), 1e-3, 4e-3, grading.reach
    c = a - b * f  # size = c + b r beyond f

    def primitive(r: float) -> float:  # of r²/(c + b r)³
        u = c + b * r
        return (np.log(u) + 2 * c / u - c * c / (2 * u * u)) / b**3

    cone = primitive(reach) - primitive(f)
    added = 4 * np.pi * (f**3 / 3 / a**3 + cone - reach**3 / 3 / h**3)
    found = expected_tets(0.0, grading, np.zeros((1, 3)), everywhere) * TETRAHEDRON
    assert found == pytest.approx(added, rel=1e-3)  # midpoints of 60 shells


def test_a_site_on_a_face_counts_half_and_two_at_one_place_once():
    grading = Grading(4e-3, 1e-3)
    whole = expected_tets(0.0, grading, np.zeros((1, 3)), everywhere)
    half = expected_tets(0.0, grading, np.zeros((1, 3)), lambda points: points[:, 2] <= 0)
    apart = expected_tets(0.0, grading, np.array([[0.0, 0, 0], [1.0, 0, 0]]), everywhere)
    near = expected_tets(0.0, grading, np.array([[0.0, 0, 0], [1e-6, 0, 0]]), everywhere)
    assert half == pytest.approx(whole / 2, rel=1e-2) and apart == pytest.approx(2 * whole, rel=1e-9)
    assert near == pytest.approx(whole, rel=2e-2)


@NEEDS_GMSH
@pytest.mark.parametrize(
    "grading",
    [
        Grading(2e-3, 2e-3),
        Grading(4e-3, 0.5e-3, radius=1e-3),
        Grading(3e-3, 0.8e-3),
        (Grading(4e-3, 0.5e-3, radius=1e-3), Grading(4e-3, 2e-3, growth=2.0)),
    ],
    ids=str,
)
def test_the_estimate_is_within_a_third_of_the_mesh(grading):
    mesh = graded_block_gmsh(SIZE, grading, SITES)
    tets = expected_tets(float(np.prod(SIZE)), grading, SITES, in_block)
    assert tets == pytest.approx(mesh.nelements, rel=0.33)
    assert budget(mesh.nelements, "P1").unknowns == pytest.approx(3 * mesh.nvertices, rel=0.33)
    assert budget(mesh.nelements, "P2").unknowns == pytest.approx(3 * (mesh.nvertices + mesh.nedges), rel=0.33)


@NEEDS_GMSH
def test_the_estimate_of_a_tube():
    mesh = tube(0.01, 4e-3, 0.03, Grading(1.3e-3, 1.3e-3))
    volume = np.pi * (0.01**2 - 0.006**2) * 0.03
    tets = expected_tets(volume, Grading(1.3e-3, 1.3e-3), np.zeros((0, 3)), everywhere)
    assert tets == pytest.approx(mesh.nelements, rel=0.33)


def test_memory_of_quadratic_tetrahedra_is_more() -> None:
    """P2 has seven times as many unknowns on a mesh, and more entries in each row."""
    linear, quadratic = budget(1e6, "P1"), budget(1e6, "P2")
    assert 6.0 < quadratic.unknowns / linear.unknowns < 8.0
    assert quadratic.memory / linear.memory > quadratic.unknowns / linear.unknowns
    assert budget(2e6, "P1").memory == 2.0 * linear.memory
