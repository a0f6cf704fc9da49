"""Rounded paths: continuous unit tangent, arc length, exact corners, nearest points."""

import numpy as np
import pytest

from thread.errors import ThreadError
from thread.path import TRIM, TRIM_MAX, rounded_path

IDENTITY = 1e-12  # relative to the path's length
ZIGZAG = np.array([[-0.03, 0, 0.01], [-0.01, 0, 0], [0.01, 0.002, 0], [0.012, 0.01, -0.003], [0.03, 0, 0.01]])


@pytest.fixture(params=[None, 1e-3, 1.0], ids=["rule", "radius", "capped"])
def radius(request):
    return request.param


@pytest.fixture
def path(radius):
    return rounded_path(ZIGZAG, radius)


def test_it_starts_and_ends_at_the_ends(path):
    ends = path.position([0.0, path.length])
    assert np.abs(ends - ZIGZAG[[0, -1]]).max() <= IDENTITY * path.length


def test_tangent_is_unit_and_continuous(path):
    l = np.linspace(0, path.length, 2001)  # noqa: E741
    assert np.abs(np.linalg.norm(path.tangent(l), axis=-1) - 1).max() <= IDENTITY
    joints, step = path.starts[1:], 1e-12 * path.length
    jump = path.tangent(joints + step) - path.tangent(joints - step)
    assert np.abs(jump).max() <= 1e-9  # curvature × 2 steps, at most 5e-10 here
    gap = path.position(joints + step) - path.position(joints - step)
    assert np.abs(gap).max() <= 3 * step


def test_tangent_is_the_derivative_of_position(path):
    middle = path.starts + path.lengths / 2
    errors = []
    for step in (0.2 * path.lengths.min(), 0.02 * path.lengths.min()):
        slope = (path.position(middle + step) - path.position(middle - step)) / (2 * step)
        error = np.linalg.norm(slope - path.tangent(middle), axis=1)
        # On an arc the chord is short by 1 − sin(κ step)/(κ step); on a straight piece there is no error.
        assert error == pytest.approx(1 - np.sinc(path.curvatures * step / np.pi), abs=1e-10)
        errors.append(error.max())
    assert errors[0] / errors[1] == pytest.approx(100, rel=0.05)


def test_arc_length_parametrises(path):
    l = np.linspace(0, path.length, 20001)  # noqa: E741
    chords = np.linalg.norm(np.diff(path.position(l), axis=0), axis=1)
    # A chord of an arc is short by (κ step)²/24 of its step.
    bound = (path.curvatures.max() * path.length / 20000) ** 2 / 24
    assert chords.sum() == pytest.approx(path.length, rel=bound + IDENTITY)
    assert chords.sum() <= path.length * (1 + IDENTITY)


@pytest.mark.parametrize("turn", [0.01, 0.5, np.pi / 2, 2.0, 3.1])
def test_length_of_one_corner(turn):
    a, b, radius = 0.03, 0.02, 1e-4
    points = np.array([[-a, 0, 0], [0, 0, 0], [b * np.cos(turn), b * np.sin(turn), 0]])
    path = rounded_path(points, radius)
    trim = radius * np.tan(turn / 2)
    assert trim < TRIM_MAX * b
    assert path.length == pytest.approx(a + b - 2 * trim + radius * turn, rel=IDENTITY)
    # The arc's middle is on the bisector, R (1/cos(turn/2) − 1) from the corner.
    away = np.linalg.norm(path.position(a - trim + radius * turn / 2))
    assert away == pytest.approx(radius * (1 / np.cos(turn / 2) - 1), rel=1e-9)


def test_a_corner_takes_at_most_its_share_of_the_shorter_segment():
    points = np.array([[-0.03, 0, 0], [0, 0, 0], [0, 0.01, 0], [0.02, 0.01, 0]])
    wide, rule = rounded_path(points, 1.0), rounded_path(points)
    assert 1 / wide.curvatures[1] == pytest.approx(TRIM_MAX * 0.01, rel=IDENTITY)
    assert wide.lengths.min() == pytest.approx(0.02 * (0.5 - TRIM_MAX), rel=1e-9)
    assert 1 / rule.curvatures[1] == pytest.approx(TRIM * 0.01, rel=IDENTITY)


@pytest.mark.parametrize("turn", [0.5, 1.0, np.pi / 2, 2.0, 3.0])
def test_a_path_passes_every_corner_at_one_distance(turn):
    """Independent check: t tan(turn/4) from a corner, for tangents of length t; as at a right angle of a quarter."""
    points = np.array([[-0.03, 0, 0], [0, 0, 0], [0.01 * np.cos(turn), 0.01 * np.sin(turn), 0]])
    away = rounded_path(points).nearest([0, 0, 0])[1]
    assert away == pytest.approx(TRIM * 0.01 * np.tan(np.pi / 8), rel=1e-9)


def test_a_polygon_about_a_circle_gives_the_circle():
    """Independent check: the arcs of equal small turns fill the sides, so that the curvature is 1/R to 5 %."""
    turn, radius = np.pi / 8, 0.005
    at = (np.arange(9) - 0.5) * turn
    points = radius / np.cos(turn / 2) * np.column_stack([np.cos(at), np.sin(at), np.zeros(9)])
    path = rounded_path(points)
    assert path.curvatures[1::2] == pytest.approx(1 / radius, rel=0.05)
    assert path.lengths[2:-1:2].max() <= 0.05 * path.lengths[1::2].min()


def test_a_straight_path_is_exact():
    path = rounded_path([[1.0, 2.0, 3.0], [1.0, 2.0, 4.0], [1.0, 2.0, 7.0]])
    assert path.length == 4.0
    assert path.position(2.5).tolist() == [1.0, 2.0, 5.5]
    assert path.position([[0.0], [4.0]]).shape == (2, 1, 3)
    assert path.tangent([0.0, 1.0, 4.0]).tolist() == [[0.0, 0.0, 1.0]] * 3
    assert path.nearest([4.0, 6.0, 5.0]) == (2.0, 5.0)


def test_nearest_agrees_with_a_fine_search(path):
    rng = np.random.default_rng(7)
    l = np.linspace(0, path.length, 20001)  # noqa: E741
    curve = path.position(l)
    for point in rng.uniform(-0.03, 0.03, (200, 3)):
        at, distance = path.nearest(point)
        brute = np.linalg.norm(curve - point, axis=1).min()
        assert np.linalg.norm(path.position(at) - point) == pytest.approx(distance, rel=IDENTITY)
        assert distance <= brute * (1 + IDENTITY)
        assert distance >= brute - path.length / 20000


def test_a_point_of_the_path_is_nearest_to_itself(path):
    l = np.linspace(0, path.length, 301)  # noqa: E741
    found = np.array([path.nearest(point) for point in path.position(l)])
    # The distance is quadratic about its minimum, but the projection is not: round-off only.
    assert np.abs(found[:, 0] - l).max() <= 1e-9 * path.length
    assert found[:, 1].max() <= 1e-9 * path.length


def test_passes_agree_with_a_fine_search(path):
    rng = np.random.default_rng(3)
    l = np.linspace(0, path.length, 20001)  # noqa: E741
    curve = path.position(l)
    for point in rng.uniform(-0.03, 0.03, (100, 3)):
        d = np.linalg.norm(curve - point, axis=1)
        padded = np.r_[np.inf, d, np.inf]
        brute = l[(d < padded[:-2]) & (d <= padded[2:])]
        at, distances = path.passes(point)
        assert np.all(np.diff(at) > 0)
        assert at == pytest.approx(brute, abs=path.length / 20000)
        assert distances == pytest.approx(np.linalg.norm(path.position(at) - point, axis=1), rel=IDENTITY)


def test_a_thread_that_passes_twice_has_two_passes_and_the_first_wins_a_tie():
    path = rounded_path([[0, 0.01, 0], [0.1, 0.01, 0], [0.1, -0.01, 0], [0, -0.01, 0]], 1e-3)
    at, distances = path.passes([0.04, 0.0, 0.0])
    # The turn at the far end has a foot of its own, 60 mm away.
    assert at == pytest.approx([0.04, path.length / 2, path.length - 0.04], rel=IDENTITY)
    assert distances == pytest.approx([0.01, 0.06, 0.01], rel=IDENTITY)
    assert path.nearest([0.04, 0.0, 0.0])[0] == at[0]


def test_from_the_centre_of_an_arc_the_first_of_its_points_is_nearest():
    path = rounded_path(np.array([[-0.02, 0, 0], [0, 0, 0], [0, 0.02, 0]]), 5e-3)
    at, distance = path.nearest([-5e-3, 5e-3, 0])
    assert (at, distance) == pytest.approx((0.015, 5e-3), rel=1e-9)


def test_moving_the_path_moves_everything_with_it(path, radius):
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    moved = rounded_path(ZIGZAG @ turn.T + 0.5, radius)
    l = np.linspace(0, 1, 101)  # noqa: E741
    expected = path.position(l * path.length) @ turn.T + 0.5
    assert moved.length == pytest.approx(path.length, rel=1e-10)
    assert np.abs(moved.position(l * moved.length) - expected).max() <= 1e-10 * path.length


@pytest.mark.parametrize(
    ("says", "points", "radius"),
    [
        ("two points or more", [[0, 0, 0]], None),
        ("two points or more", [[0, 0], [1, 1]], None),
        ("path point 1 = .* must be finite", [[0, 0, 0], [0, float("nan"), 0]], None),
        ("points 1 and 2 are equal", [[0, 0, 0], [1, 0, 0], [1, 0, 0]], None),
        ("turns back on itself at point 1", [[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], None),
        ("radius = 0", [[0, 0, 0], [1, 0, 0], [1, 1, 0]], 0.0),
        ("radius = nan", [[0, 0, 0], [1, 0, 0], [1, 1, 0]], float("nan")),
    ],
)
def test_impossible_paths_are_refused(says, points, radius):
    with pytest.raises(ThreadError, match=says):
        rounded_path(points, radius)


@pytest.mark.parametrize("at", [-1e-3, 1.1, float("nan")])
def test_an_abscissa_off_the_path_is_refused(at):
    with pytest.raises(ThreadError, match="outside the path"):
        rounded_path([[0, 0, 0], [1, 0, 0]]).position(at)


def test_a_point_must_be_three_finite_numbers():
    with pytest.raises(ThreadError, match="three finite"):
        rounded_path([[0, 0, 0], [1, 0, 0]]).nearest([0, 0, float("inf")])
