"""The surface that points outside bear on: a smooth one between its facets, and a distance whose gradient is d."""

import numpy as np
import pytest

import tissue
from meshes.block import block
from meshes.cylinder import cylinder
from meshes.grading import Grading
from tissue.arrays import Array
from tissue.organs.meshed import gap_compliance
from tissue.organs.skin import Skin

RADIUS, AWAY, SIZE = 8e-3, 1e-4, 1.2e-3  # m
SMOOTH = 0.01  # of h²/(8 radius), by which the middle of a flat facet lies inside the cylinder
TILT = 0.01  # rad: flat facets are tilted by up to 0.075
STEP = 1e-7  # m, of a central difference


def skin(mesh: object) -> Skin:
    """The surface of a body of a mesh."""
    return tissue.skin_of(tissue.elasticity(mesh, tissue.Material(1e5, 0.3, 1000.0)))  # type: ignore[arg-type]


def still(surface: Skin) -> Array:
    """No displacement."""
    return np.zeros_like(surface.body.points)


def distances(surface: Skin, displacement: Array, places: Array) -> tuple[Array, Array]:
    """Distances and d of points."""
    faced = surface.faced(displacement, places, np.zeros((len(places), 0)))
    return faced[:, 7], faced[:, 4:7]


def around(count: int) -> tuple[Array, Array]:
    """Points at one distance around the cylinder, and the unit vectors away from its axis there."""
    random = np.random.default_rng(7)
    angle, x = random.uniform(0.0, 2.0 * np.pi, count), random.uniform(-2e-3, 2e-3, count)
    radial = np.column_stack([0.0 * angle, np.cos(angle), np.sin(angle)])
    return radial * (RADIUS + AWAY) + x[:, None] * [1.0, 0.0, 0.0], radial


def test_facets_stand_for_the_cylinder_that_they_are_of() -> None:
    # Independent: the distance from a cylinder, and its normals.
    pytest.importorskip("gmsh")
    surface = skin(cylinder(RADIUS, 0.01, Grading(SIZE, SIZE, 1.3)))
    places, radial = around(400)
    away, d = distances(surface, still(surface), places)
    assert np.abs(away - AWAY).max() <= 0.1 * SIZE**2 / (8.0 * RADIUS)
    assert abs(np.mean(away) - AWAY) <= SMOOTH * SIZE**2 / (8.0 * RADIUS)
    assert np.linalg.norm(d + radial, axis=1).max() <= TILT


def test_d_is_the_gradient_of_the_distance_also_of_a_deformed_block() -> None:
    # Independent of d: central differences of the distance, from places over the faces, the edges and a dent.
    mesh = block((0.02, 0.02, 0.01), 2.5e-3)
    surface = skin(mesh)
    points = surface.body.points
    dent = np.exp(-(points[:, 0] ** 2 + points[:, 1] ** 2) / 4e-3**2) * np.isclose(points[:, 2], 0.0)
    displacement = np.outer(dent, [0.0, 0.0, -5e-4])
    random = np.random.default_rng(3)
    places = np.column_stack([*random.uniform(-0.011, 0.011, (2, 300)), random.uniform(1.5e-4, 4e-4, 300)])
    _, d = distances(surface, displacement, places)
    slopes = np.stack(
        [
            distances(surface, displacement, places + STEP * way)[0]
            - distances(surface, displacement, places - STEP * way)[0]
            for way in np.eye(3)
        ],
        axis=1,
    ) / (2.0 * STEP)
    off = np.linalg.norm(slopes + d, axis=1)  # d points from the place to the surface
    assert np.quantile(off, 0.97) <= 1e-3  # but for places half way between two facets, where the distance has a kink


def test_a_point_inside_is_below_the_surface() -> None:
    # Independent: the depth below the top of a block.
    surface = skin(block((0.02, 0.02, 0.01), 2.5e-3))
    away, d = distances(surface, still(surface), np.array([[1e-3, 2e-3, -4e-4], [1e-3, 2e-3, 4e-4]]))
    assert away == pytest.approx([-4e-4, 4e-4], abs=1e-12)
    assert np.abs(d - [0.0, 0.0, -1.0]).max() <= 1e-12


def test_columns_have_the_same_bits_whatever_is_asked_for_with_them() -> None:
    # Consistency: a resumed run asks for other columns together than the run that was not interrupted.
    surface = skin(block((0.02, 0.02, 0.01), 2.5e-3))
    body = tissue.elasticity(surface.body.mesh, surface.body.material, clamp=["bottom"])
    organ = tissue.QuasiStaticOrgan(body, tissue.build_sites(body, []), skin=tissue.skin_of(body))
    one, other = (gap_compliance(organ.operator(0.0, 0.0).factor, organ.lip_rows, together=1) for _ in range(2))
    some = np.arange(700, 712)
    whole = one.of(some)
    assert np.array_equal(whole, np.hstack([other.of(some[k : k + 1]) for k in range(len(some))]))
    assert np.count_nonzero(whole)
