"""The surface that points outside bear on: a smooth one between its facets, and a gap whose gradient is −d."""

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
TILT = {"P1": 0.01, "P2": 0.0125}  # rad: flat facets are tilted by up to 0.075
STEP = 1e-7  # m, of a central difference
SLOPE = 1e-8  # of the gap, off d: round-off of a gap of 1e-18 m over STEP, and the curvature times STEP²
ON_KINK = 0.005  # of the places: within STEP of an edge, where facets meet at a slight angle
PLACES = (-2e-5, 0.0, AWAY, 5e-4)  # m, distances of points: inside, on the surface, a thin and a thick thread


def skin(mesh: object, element: str = "P1") -> Skin:
    """The surface of a body of a mesh."""
    return tissue.skin_of(tissue.elasticity(mesh, tissue.Material(1e5, 0.3, 1000.0), element))  # type: ignore[arg-type]


def still(surface: Skin) -> Array:
    """No displacement."""
    return np.zeros_like(surface.body.points)


def distances(surface: Skin, displacement: Array, places: Array) -> tuple[Array, Array]:
    """Distances and d of points."""
    faced = surface.faced(displacement, places, np.zeros((len(places), 0)))
    return faced[:, 7], faced[:, 4:7]


def around(count: int, away: float = AWAY) -> tuple[Array, Array]:
    """Points at one distance around the cylinder, and the unit vectors away from its axis there."""
    random = np.random.default_rng(7)
    angle, x = random.uniform(0.0, 2.0 * np.pi, count), random.uniform(-2e-3, 2e-3, count)
    radial = np.column_stack([0.0 * angle, np.cos(angle), np.sin(angle)])
    return radial * (RADIUS + away) + x[:, None] * [1.0, 0.0, 0.0], radial


def bar(size: float = SIZE, element: str = "P1") -> Skin:
    """The surface of a cylinder with facets of a `size` [m]."""
    pytest.importorskip("gmsh")
    return skin(cylinder(RADIUS, 0.01, Grading(size, size, 1.3)), element)


def bent(surface: Skin, amount: float) -> Array:
    """A smooth displacement with strains of 200 times the `amount` [m]."""
    x, y, z = surface.body.points.T
    return amount * np.column_stack([np.sin(200.0 * y), np.cos(150.0 * z) + 100.0 * x, np.sin(200.0 * x + 100.0 * y)])


def slopes(surface: Skin, displacement: Array, places: Array) -> Array:
    """Gradients of the gap at places by central differences."""
    ways = STEP * np.eye(3)
    sides = [[distances(surface, displacement, places + side * way)[0] for way in ways] for side in (1.0, -1.0)]
    return np.asarray(np.transpose(np.subtract(*sides)) / (2.0 * STEP))


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_facets_stand_for_the_cylinder_that_they_are_of(element: str) -> None:
    # Independent: the distance from a cylinder, and its normals. Nodes of P2 are in the middles of flat facets.
    surface = bar(element=element)
    places, radial = around(400)
    away, d = distances(surface, still(surface), places)
    assert np.abs(away - AWAY).max() <= 0.1 * SIZE**2 / (8.0 * RADIUS)
    assert abs(np.mean(away) - AWAY) <= SMOOTH * SIZE**2 / (8.0 * RADIUS)
    assert np.linalg.norm(d + radial, axis=1).max() <= TILT[element]


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
    off = np.linalg.norm(slopes(surface, displacement, places) + d, axis=1)  # d points from the place to the surface
    assert off.max() <= 10.0 * SLOPE  # beyond an edge the third derivative is 1/r², and STEP²/6r² = 7e-8


@pytest.mark.parametrize("amount", [0.0, 2e-4])
@pytest.mark.parametrize("away", PLACES)
def test_d_is_the_gradient_of_the_gap_of_a_curved_surface(away: float, amount: float) -> None:
    # Independent of d: central differences of the gap, also of a bent bar.
    surface = bar()
    displacement, places = bent(surface, amount), around(300, away)[0]
    _, d = distances(surface, displacement, places)
    off = np.linalg.norm(slopes(surface, displacement, places) + d, axis=1)
    assert np.quantile(off, 1.0 - ON_KINK) <= SLOPE


@pytest.mark.parametrize("amount", [0.0, 2e-4])
def test_d_is_the_gradient_of_the_gap_by_the_place_of_the_organ(amount: float) -> None:
    # Independent of d: the gaps before and after a displacement of the nodes.
    surface, more = bar(), 1e-6
    before, after, places = bent(surface, amount), bent(surface, amount + more), around(300)[0]
    faced = surface.faced(before, places, np.zeros((len(places), 0)))
    moved = np.vecmat(faced[:, 1:4], (after - before)[surface.facets[faced[:, 0].astype(int)]])
    change = distances(surface, after, places)[0] - faced[:, 7]
    off = np.abs(change - np.vecdot(moved, faced[:, 4:7]))
    assert np.quantile(off, 0.95) <= 5e-4 * np.abs(change).max()  # normals turn, and the strain is finite


def test_a_point_drawn_over_the_surface_passes_no_step() -> None:
    # Independent: a tangent leaves the cylinder by v²/(2 radius); facets that meet at an angle add a part of v.
    surface, v = bar(), 1e-5
    angle = np.arange(0.0, 2.0 * np.pi, v / RADIUS)
    places = np.column_stack(
        [0.1 * RADIUS * np.sin(angle), *((RADIUS + AWAY) * np.array([np.cos(angle), np.sin(angle)]))]
    )
    gaps, d = distances(surface, still(surface), places)
    way = np.diff(places, axis=0)
    left = np.diff(gaps) + np.vecdot(d[:-1], way)
    assert np.abs(left).max() <= TILT["P1"] * v
    assert np.quantile(np.abs(left), 0.95) <= 2.0 * v**2 / (2.0 * RADIUS)
    assert left.mean() == pytest.approx(v**2 / (2.0 * RADIUS), rel=0.3)


def test_the_gap_of_a_cylinder_is_of_second_order_in_the_size_of_facets() -> None:
    # Independent: the distance from a cylinder.
    off = []
    for size in (3.2e-3, 1.6e-3, 0.8e-3):
        surface = bar(size)
        off.append(np.std(distances(surface, still(surface), around(2000)[0])[0] - AWAY))
    assert np.log2(off[0] / off[1]) >= 2.0
    assert np.log2(off[1] / off[2]) >= 2.0


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
