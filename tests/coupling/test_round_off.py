"""What round-off leaves of forces that cancel."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from coupling.step.newton import rounded_force
from thread import catalogue, knots, spline, thread

LENGTH = 0.1  # m


@pytest.mark.parametrize("points", [20, 60, 150, 300])
@pytest.mark.parametrize("away", [0.0, 0.02, 1.0])
def test_a_straight_thread_is_pulled_by_no_more_than_round_off(points: int, away: float) -> None:
    """Independent check: the exact force is zero, whatever the number of spans and the distance from the origin [m];
    what is allowed for round-off is within a hundred times what is seen."""
    cord = thread.Thread(spline.Spline(knots.uniform_knots(LENGTH, points)), catalogue.suture("2-0 polypropylene"))
    seen, allowed = [], []
    for seed in range(6):
        along, origin = np.random.default_rng(seed).normal(size=(2, 3))
        straight = cord.spline.greville[:, None] * along / np.linalg.norm(along)
        q = away * origin / np.abs(origin).max() + straight
        problem: Any = SimpleNamespace(system=SimpleNamespace(thread=cord), q_ref=q, mass_factor=0.0)
        seen.append(np.abs(cord.gradient(cord.points(q))).max())
        allowed.append(rounded_force(problem))
    assert all(np.array(seen) <= allowed)
    assert max(seen) >= 0.01 * max(allowed)
