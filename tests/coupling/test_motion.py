"""A thread that runs round its bends at the holes faster than a step: where it goes on to, and knots for its way."""

from dataclasses import replace

import numpy as np
import pytest

from coupling.run.adaptivity import AHEAD, Resolution, adapt, adapt_when_due, bending_layers, coarse_tree
from coupling.step.motion import BEND, BENDS, CROSSED, LOCAL, carried_on, is_too_long
from coupling.system import State, System
from tests.thread.threads import (
    ABSCISSAE,
    LENGTH,
    PP,
    RADIUS,
    X,
    greville,
    hairpin,
    hairpin_sites,
    hairpin_system,
    laid,
)
from thread.ends import Free
from thread.knots import clamped_knots
from thread.spline import Spline
from thread.thread import Thread

PULL, DT, N = 1.0, 1e-3, 20
FINE = Resolution(coarse_tree(0.0, LENGTH, N), 0.02)


def taut(pull: float = PULL) -> tuple[System, State]:
    """A hairpin under a `pull` [N] on coarse spans."""
    system = hairpin_system(hairpin_sites(), (Free(), Free()), N)
    system = replace(system, thread=Thread(Spline(clamped_knots(FINE.tree.coarse)), PP, damping=20.0))
    state = laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH))
    return system, replace(state, N=np.full_like(state.N, pull))


def running(layers: float, drift: float = 0.0, pull: float = PULL) -> tuple[System, State]:
    """A thread that runs along itself, so many √(EI/T) in DT, on spans that resolve them, and drifts along x as it
    runs with the part `drift` of its speed."""
    system, state = taut(pull)
    system, state, _ = adapt(FINE, system, state, 0.0)
    rate = layers * bending_layers(system, state)[0] / DT
    spline = system.thread.spline
    slope = spline.curve(state.q, greville(spline))[:, 1]
    v = spline.through(rate * (drift * X - slope))
    return system, replace(state, v=v, s_dot=np.full(2, rate))


@pytest.mark.parametrize("layers", [0.5, 4.0, 12.0])
def test_a_thread_that_runs_along_itself_keeps_its_shape(layers: float) -> None:
    """Independent check: it is where the shape was, P(s, t) = P(s − ct, 0), all along, to a twentieth of what
    points that go straight are off by."""
    system, state = running(layers)
    spline, carried = system.thread.spline, carried_on(system, state, DT)
    assert carried is not None
    s = np.linspace(0.2 * LENGTH, 0.8 * LENGTH, 500)
    way = DT * state.s_dot[0]
    there = spline.curve(state.q, s - way)[:, 0]
    off, straight = (np.abs(spline.curve(q, s)[:, 0] - there).max() for q in (carried[0], state.q + DT * state.v))
    assert off <= 0.05 * straight
    assert np.all(carried[1] == PULL)


def test_a_thread_that_drifts_as_it_runs_goes_on_but_at_its_bends() -> None:
    """Independent check: two lengths of the bend and what has run through it away from the holes, the shape goes on
    with its own velocity, beyond the ends too; within them, where a step knows none, it stays."""
    drift = 0.1
    system, state = running(1.0, drift)
    spline, way = system.thread.spline, DT * state.s_dot[0]
    carried = carried_on(system, state, DT)
    assert carried is not None
    s = np.array([0.0, 0.1 * LENGTH, 0.9 * LENGTH, LENGTH])
    expected = spline.curve(state.q + DT * state.v, s)[:, 0]
    assert np.abs(spline.curve(carried[0], s)[:, 0] - expected).max() <= 0.1 * drift * way
    assert 2.0 * (BEND + 1.0) * way < ABSCISSAE[0] - 0.1 * LENGTH
    at_holes = spline.curve(carried[0], state.s + way)[:, 0] - spline.curve(state.q, state.s)[:, 0]
    assert np.abs(at_holes).max() <= 1e-3 * way


def test_points_go_straight_where_none_runs_round_a_bend() -> None:
    """Independent check: a way of less than two spans, spans of which none resolves √(EI/T), a limp thread that bends
    over much of its length, or holes that would pass one another leave each point to itself."""
    fine, now = running(1.0)
    spans = np.diff(fine.thread.spline.breaks)[fine.thread.spline.spans_of(now.s)]
    for share, goes_round in ((0.99, False), (1.01, True)):
        rates = np.array([share * CROSSED * spans[0] / DT, 0.0])
        assert (carried_on(fine, replace(now, s_dot=rates), DT) is not None) == goes_round
    for share, goes_round in ((0.99, True), (1.01, False)):
        limp = PULL * (BEND * bending_layers(*taut())[0] / (share * LOCAL * LENGTH)) ** 2
        assert (carried_on(*running(1.0, pull=limp), DT) is not None) == goes_round
    meeting = np.array([1.01, -1.01]) * 0.5 * np.diff(now.s) / DT
    assert carried_on(fine, replace(now, s_dot=0.98 * meeting), DT) is not None
    assert carried_on(fine, replace(now, s_dot=meeting), DT) is None
    system, state = taut()
    layer = bending_layers(system, state)[0]
    assert np.diff(system.thread.spline.breaks).min() > layer
    assert carried_on(system, replace(state, s_dot=np.full(2, layer / DT)), DT) is None


def test_a_step_is_as_long_as_a_bend_is_carried() -> None:
    """Independent check: 2 √(EI/T) run through a hole on spans that resolve it, many of them, at either side of that;
    on spans that are all alike no more than two of them."""
    for share, too_long in ((0.99, False), (1.01, True)):
        system, state = running(share * BENDS)
        spans = np.diff(system.thread.spline.breaks)
        crossed = DT * state.s_dot / spans[system.thread.spline.spans_of(state.s)]
        assert crossed.min() > 8 * CROSSED
        assert is_too_long(system, state, DT) == too_long
    system, state = taut()
    layer = bending_layers(system, state)[0]
    alike = coarse_tree(0.0, LENGTH, round(LENGTH / (0.4 * layer))).coarse
    system = replace(system, thread=Thread(Spline(clamped_knots(alike)), PP, damping=20.0))
    state = laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH))
    state = replace(state, N=np.full_like(state.N, PULL))
    assert CROSSED * np.diff(alike).max() < BENDS * layer
    for share, too_long in ((0.99, False), (1.01, True)):
        fast = replace(state, s_dot=np.full(2, share * CROSSED * np.diff(alike)[0] / DT))
        assert is_too_long(system, fast, DT) == too_long


def test_knots_come_before_a_thread_runs_off_those_that_it_has() -> None:
    """Independent check: between two looks at the knots a thread that is to run on to coarse spans in its next step
    gets finer ones on its way; one that comes to rest does not."""
    system, state = running(0.25 * AHEAD)
    system, state, told = adapt(FINE, system, state, DT)
    assert told
    at_end = replace(state, s=state.s + 0.9 * DT * state.s_dot)
    assert not adapt_when_due(FINE, system, replace(at_end, s_dot=np.zeros(2)), DT, due=False)[2]
    other, now, told = adapt_when_due(FINE, system, at_end, DT, due=False)
    assert told
    spline, way = other.thread.spline, np.linspace(0.0, DT, 50)[:, None] * now.s_dot + now.s
    finest = FINE.ratio_at_hole * bending_layers(other, now).max()
    assert np.diff(spline.breaks)[spline.spans_of(way.ravel())].max() <= finest * (1.0 + 1e-2)
