"""Steps in time that end where a pressed thread does not stay: it goes aside, as the motion does."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from coupling.run.run import Run, begin
from coupling.step.stability import holds
from coupling.step.stepping import bdf2_step
from coupling.system import Piercing, State, System
from tests.bounds import FIRST_ORDER, ORACLE, TWO_SOLVERS
from tests.thread.threads import LENGTH, ORIGIN, PP, X, Y, laid, line, uniform, without_organ
from thread.ends import Driven, Fixed

SHORTER, STEP = 0.01, 5e-3  # a part of the length; [s]
EULER = np.pi**2 * PP.EI / LENGTH**2  # [N]


def elastica(shorter: float) -> tuple[float, float]:
    """Return the force over Euler's load and the sag over the length of a pinned column that is shortened by a part of
    its length: (2K/π)² and k/K, where 2 (1 − E/K) is that part (Love, Theory of Elasticity, 1927, §263)."""
    m = brentq(lambda m: 2.0 * (1.0 - ellipe(m) / ellipk(m)) - shorter, 1e-9, 0.9)
    return (2.0 * ellipk(m) / np.pi) ** 2, np.sqrt(m) / ellipk(m)


def pushed(
    bow: float = 0.0, holes: Any = (), piercings: Any = (), points: int = 32, **options: Any
) -> tuple[System, State]:
    """A straight thread, pinned at its start, whose other end comes nearer by a part of its length within 0.1 s; or one
    with a `bow` [m] towards −y."""
    waypoints = np.array([[0.0, LENGTH, 0.0, 0.0], [0.1, (1.0 - SHORTER) * LENGTH, 0.0, 0.0]])
    thread = uniform(LENGTH, points, damping=200.0)
    system = without_organ(thread, (Fixed(ORIGIN), Driven(waypoints)), piercings, holes, **options)
    state = laid(system, [point @ X for point, _ in holes], line(ORIGIN, X))
    state.q[:, 1] -= bow * np.sin(np.pi * state.q[:, 0] / LENGTH)
    return system, state


def at_rest(system: System, state: State, until: float = 0.6) -> Run:
    run = begin(system, state, bdf2_step)
    while run.state.time < until:
        run = run.step(STEP)
        assert all(holds(step.solution) for step in run.taken)
    return run


@pytest.mark.parametrize("compiled", [False, True])
def test_a_straight_thread_that_is_pushed_bows(compiled: bool) -> None:
    """Independent check: at rest force and sag are those of the elastica, at every step the thread resists each of its
    motions. Squeezed straight it would bear EA times what it is shortened by, 900 times as much."""
    run = at_rest(*pushed(compiled=compiled))
    force, sag = elastica(SHORTER)
    assert 900.0 * force * EULER < PP.EA * SHORTER
    assert abs(-run.state.reaction[-1, 0] / (force * EULER) - 1.0) <= ORACLE
    middle = run.system.thread.spline.curve(run.state.q, [0.5 * LENGTH])[0, 0]
    assert abs(np.linalg.norm(middle[1:]) / (sag * LENGTH) - 1.0) <= ORACLE


@pytest.mark.parametrize(("steps", "shorter"), [(2, 0.1), (5, 0.02)])
def test_a_thread_that_is_pushed_at_rest_is_the_elastica(steps: int, shorter: float) -> None:
    """Independent check: force and sag of the elastica, although a load step pushes the end past the next points."""
    waypoints = np.array([[0.0, LENGTH, 0.0, 0.0], [1.0, (1.0 - shorter) * LENGTH, 0.0, 0.0]])
    system = without_organ(uniform(LENGTH, 40), (Fixed(ORIGIN), Driven(waypoints)))
    run = begin(system, laid(system, [], line(ORIGIN, X)))
    told = []
    for k in range(steps):
        run = run.load((k + 1) / steps, 1.0)
        told += [event.kind for event in run.events]
    force, sag = elastica(shorter)
    middle = run.system.thread.spline.curve(run.state.q, [0.5 * LENGTH])[0, 0]
    assert abs(-run.state.reaction[-1, 0] / (force * EULER) - 1.0) <= ORACLE and "snaps" in told
    assert abs(np.linalg.norm(middle[1:]) / (sag * LENGTH) - 1.0) <= ORACLE


def test_loops_and_numpy_bow_to_the_same_side() -> None:
    """Consistency check: nothing tells the side, and both solve the same step: the same shape."""
    one, other = (at_rest(*pushed(compiled=compiled), 2 * STEP).state.q for compiled in (False, True))
    assert np.abs(one[:, 1:]).max() > 0.01 * LENGTH
    assert np.abs(one - other).max() <= TWO_SOLVERS * LENGTH


def test_a_bow_that_there_is_grows() -> None:
    """Independent check: a bow of a hundredth of a diameter in a plane stays in it and on its side."""
    run = at_rest(*pushed(bow=0.01 * PP.diameter), 2 * STEP)
    assert np.abs(run.state.q[:, 2]).max() <= TWO_SOLVERS * LENGTH
    assert (run.state.q[1:-1] @ Y < 0.0).all() and np.abs(run.state.q @ Y).max() > 0.01 * LENGTH


def test_a_strand_that_is_pushed_on_its_anchor_bows_alone() -> None:
    """Independent check: a column that is pinned where it is pushed and clamped by the direction of its hole bears
    20.19 EI/l² (Timoshenko and Gere, Theory of Elastic Stability, 1961, §2.2) and a little more as it bows; the
    strand beyond the hole stays straight."""
    system, state = pushed(holes=((0.5 * LENGTH * X, X),), piercings=(Piercing("anchor", slides=False),), points=300)
    run = at_rest(system, state)
    euler = 20.19 * PP.EI / (0.5 * LENGTH) ** 2
    assert euler < -run.state.reaction[-1, 0] < (1.0 + FIRST_ORDER) * euler
    aside = np.linalg.norm(run.system.thread.spline.curve(run.state.q, np.linspace(0.0, LENGTH, 41))[:, 0, 1:], axis=1)
    assert aside[:17].max() <= ORACLE * aside.max()
