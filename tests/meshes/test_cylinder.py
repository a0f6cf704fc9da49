"""Cylinder: faces, volume and area against π, refusals."""

import numpy as np
import pytest

from meshes.checks import check, parts, volumes
from meshes.cylinder import cylinder, stumps, tube
from meshes.errors import MeshError
from meshes.grading import Grading
from meshes.quality import size_at
from tests.meshes.samples import NEEDS_GMSH, euler_characteristic, facet_areas

RADIUS, LENGTH = 0.01, 0.04


@NEEDS_GMSH
def test_faces_partition_the_surface_and_lie_where_they_should():
    mesh = cylinder(RADIUS, LENGTH, Grading(4e-3, 4e-3))
    check(mesh.p.T, mesh.t.T)
    named = np.concatenate([mesh.boundaries[name] for name in ("left", "right", "side")])
    assert np.array_equal(np.sort(named), np.sort(mesh.boundary_facets()))

    def corners(name: str) -> np.ndarray:
        return mesh.p[:, mesh.facets[:, mesh.boundaries[name]]]

    # OpenCASCADE places points to 1e-7 of a model unit [m] at worst; measured 1e-17.
    assert np.abs(corners("left")[0] + LENGTH / 2).max() < 1e-12
    assert np.abs(corners("right")[0] - LENGTH / 2).max() < 1e-12
    assert np.abs(np.hypot(*corners("side")[1:]) - RADIUS).max() < 1e-9


@NEEDS_GMSH
def test_volume_comes_from_below_with_the_square_of_h():
    exact = np.pi * RADIUS**2 * LENGTH
    errors = []
    for h in (4e-3, 2e-3):
        mesh = cylinder(RADIUS, LENGTH, Grading(h, h))
        errors.append(1 - volumes(mesh.p.T, mesh.t.T).sum() / exact)
    # Inscribed polygon of n = 2π radius/h sides: area short by (2π/n)²/6 = (h/radius)²/6.
    assert errors[0] == pytest.approx((4e-3 / RADIUS) ** 2 / 6, rel=0.3)
    assert errors[1] == pytest.approx((2e-3 / RADIUS) ** 2 / 6, rel=0.3)


@NEEDS_GMSH
def test_elements_are_small_at_a_site_only():
    site = np.array([0.0, 0.0, RADIUS])
    mesh = cylinder(RADIUS, LENGTH, Grading(4e-3, 0.8e-3, radius=2e-3), [site])
    ends = mesh.p[:, mesh.edges]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=0)
    away = np.linalg.norm(ends.mean(axis=1).T - site, axis=1)
    assert 0.85 < length[away < 2e-3].mean() / 0.8e-3 < 1.5
    assert length[away > 0.018].mean() > 2.5e-3


@NEEDS_GMSH
def test_a_tube_has_its_walls_ends_and_volume():
    """Independent check: π (R² − r²) L and 2π r L, less what chords of the mesh size cut off, of order (h/r)²/6."""
    wall, inner, h = 3e-3, RADIUS - 3e-3, 2e-3
    mesh = tube(RADIUS, wall, LENGTH, Grading(h, h))
    check(mesh.p.T, mesh.t.T)
    assert set(mesh.boundaries) == {"left", "right", "inner", "outer"}
    named = np.concatenate(list(mesh.boundaries.values()))
    assert np.array_equal(np.sort(named), np.sort(mesh.boundary_facets()))
    for name, radius in (("inner", inner), ("outer", RADIUS)):
        corners = mesh.p[:, mesh.facets[:, mesh.boundaries[name]]]
        assert np.abs(np.hypot(*corners[1:]) - radius).max() < 1e-9
        short = 1 - facet_areas(mesh, mesh.boundaries[name]).sum() / (2 * np.pi * radius * LENGTH)
        assert abs(short) < (h / radius) ** 2 / 6
    volume = np.pi * (RADIUS**2 - inner**2) * LENGTH
    # Outer chords lose, inner chords gain: h²/6 of π L each, if the chords are h long.
    assert volumes(mesh.p.T, mesh.t.T).sum() == pytest.approx(volume, rel=(h / RADIUS) ** 2 / 6)
    assert euler_characteristic(mesh) == 0


@NEEDS_GMSH
def test_a_tube_is_small_at_a_site_on_its_inner_wall():
    site = np.array([0.0, 0.0, RADIUS - 3e-3])
    mesh = tube(RADIUS, 3e-3, LENGTH, Grading(3e-3, 0.8e-3, radius=1.5e-3), [site])
    assert 0.8 < size_at(mesh, site) / 0.8e-3 < 1.5
    assert size_at(mesh, -site) > 1.8e-3


@NEEDS_GMSH
@pytest.mark.parametrize("gap", [0.0, 1e-3])
def test_the_faces_of_two_stumps_match(gap):
    """Independent check: two bodies of the tube's volume less the gap's, whose faces of the cut have the same nodes, a
    gap apart, and whose named surfaces leave nothing out; finer at a site of one, and so of the other."""
    wall, h, site = 3e-3, 3e-3, np.array([0.006, 0.0, RADIUS])
    mesh = stumps(RADIUS, wall, LENGTH, gap, Grading(h, 1e-3), [site])
    assert parts(mesh.p.T, mesh.t.T).max() == 1
    assert np.array_equal(np.sort(np.concatenate(list(mesh.boundaries.values()))), np.sort(mesh.boundary_facets()))
    left, right = (mesh.p[:, np.unique(mesh.facets[:, mesh.boundaries[f"stump_{side}"]])] for side in ("left", "right"))
    assert np.array_equal(left[1:], right[1:]) and np.abs(right[0] - left[0] - gap).max() < 1e-15
    area = np.pi * (RADIUS**2 - (RADIUS - wall) ** 2)
    assert facet_areas(mesh, mesh.boundaries["stump_left"]).sum() == pytest.approx(area, rel=(h / RADIUS) ** 2)
    assert volumes(mesh.p.T, mesh.t.T).sum() == pytest.approx(area * (LENGTH - gap), rel=(h / RADIUS) ** 2)
    assert size_at(mesh, site) == pytest.approx(size_at(mesh, site * [-1, 1, 1])) and size_at(mesh, site) < 1.6e-3


@pytest.mark.parametrize(
    ("fault", "call"),
    [
        ("gap = 0.04 must be at least 0 and less", lambda: stumps(0.01, 0.002, 0.04, 0.04, Grading(1, 1))),
        ("wall = 0.01 must be thinner", lambda: tube(0.01, 0.01, 0.04, Grading(1, 1))),
        ("wall = 0", lambda: tube(0.01, 0, 0.04, Grading(1, 1))),
        ("outside the tube", lambda: tube(0.01, 0.002, 0.04, Grading(1, 1), [[0, 0, 0.007]])),
    ],
)
def test_impossible_tubes_are_refused_in_words(fault, call):
    with pytest.raises(MeshError, match=fault):
        call()


@pytest.mark.parametrize(
    ("fault", "arguments"),
    [
        ("radius = 0", (0, 1)),
        ("length = nan", (1, float("nan"))),
        ("outside the cylinder", (1, 1, [[0, 0.8, 0.8]])),
        ("outside the cylinder", (1, 1, [[0.51, 0, 0]])),
    ],
)
def test_impossible_input_is_refused_in_words(fault, arguments):
    with pytest.raises(MeshError, match=fault):
        cylinder(*arguments[:2], Grading(0.1, 0.05), *arguments[2:])
