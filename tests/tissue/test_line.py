"""A line of balls inside the tissue: their compliance in the unbounded body."""

import numpy as np
import pytest

from tissue.sites.line import MOMENTS, apart, ball_pairs, overlapping
from tissue.sites.unbounded import ball_compliance, kelvin

NU = 0.45
ENDLESS = 1e-5  # of a ball's compliance: what the integral over wave numbers leaves out of a uniform ball


@pytest.mark.parametrize("weight", ["parabolic", "uniform"])
def test_balls_move_one_another_as_kelvin_says(weight: str) -> None:
    """Independent check: a ball by its own force as in closed form; two far apart as points, but for the square of
    their radius over the distance; two that overlap by the least as two that touch, of unlike radii too."""
    offset = np.array([[3.0, 2.0, 1.0]])
    own = ball_compliance(weight, NU)[0, 0]
    near, far = (ball_pairs(np.vstack([[0, 0, 0], k * offset]), np.ones(2), weight, NU) for k in (1.0, 10.0))
    assert np.abs(near[:3, :3] - own * np.eye(3)).max() <= ENDLESS * own
    assert np.array_equal(near, near.T)
    errors = [np.abs(C[:3, 3:] - kelvin(k * offset[0], NU)).max() for C, k in ((near, 1.0), (far, 10.0))]
    assert errors[1] == pytest.approx(errors[0] * 1e-3, rel=1e-6)  # 1/r times (a/r)²
    for other in (1.0, 0.5):
        touching = offset / np.linalg.norm(offset) * (1.0 + other)
        pair = overlapping(touching, np.ones(1), np.array([other]), weight, NU)
        assert np.abs(pair - apart(touching, np.array([MOMENTS[weight] * (1.0 + other**2)]), NU)).max() <= ENDLESS * own
