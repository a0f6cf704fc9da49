"""How fast the thread runs through its holes, where it is when it goes on so, and what it does, in words.

A step sees the thread at its end alone. Where spans run through a hole in it, what lies in between is passed over, and
Newton starts far from where it has to go. The rate is known before the step. A milligram suture under a fraction of a
newton takes up its slack at several metres a second, a few spans in a millisecond; in an ordinary pull it moves by
hundredths of a span.

On spans that resolve √(EI/T) the thread's bend at a hole is one of its control points, which go round it one after the
other. In steps in which they go further than it is long none of them goes on as it went; but the bend stays in its
hole, and the thread is found where it runs through it: a step may be many times as long as on points that go straight.
"""

import numpy as np

from coupling.arrays import Array
from coupling.interfaces import Body
from coupling.step.tension import lengths_bent_over
from coupling.system import State, System
from thread.refit import evaluation

CROSSED = 2.0  # spans that may run through a hole in a step
RESOLVED = 0.5  # of √(EI/T): spans at a hole on which its bend is one of the control points
BEND = 4.0  # √(EI/T) from a hole: there exp(−4) of its turn is left
LOCAL = 0.1  # of the thread: as long as BEND √(EI/T) may be for the bend to be one at its hole, not of a limp thread
BENDS = 2.0  # √(EI/T) that may run through a hole in a step on such spans: by six a snap came to a curl in its hole
SLACK = 1e-6  # of EA: a part of the thread under less tension is slack
TURNED_BACK = 0.3  # cosine of the angle between thread and directed hole (73°) below which a thread is turned back


def crossing_rates(system: System[Body], state: State[Body]) -> Array:
    """Return the spans that run through each hole in a second, shape `(holds,)` [1/s]."""
    spline = system.thread.spline
    span = np.diff(spline.breaks)[spline.spans_of(state.s)]
    return np.asarray(np.abs(state.s_dot) / span * (state.present & system.may_slide))


def resolved_bends(system: System[Body], state: State[Body]) -> Array:
    """Return √(EI/T) at each hole at which the thread has a bend of its own, on spans that resolve it, zero at the
    others, shape `(holds,)` [m]."""
    spline = system.thread.spline
    layers = lengths_bent_over(system, state.s, state.N, state.lam, state.present)
    span = np.diff(spline.breaks)[spline.spans_of(state.s)]
    local = BEND * layers <= LOCAL * (spline.end - spline.start)
    return np.where(local & (span <= RESOLVED * layers) & state.present & system.may_slide, layers, 0.0)


def is_too_long(system: System[Body], state: State[Body], dt: float) -> bool:
    """Whether the thread runs further through a hole in `dt` [s], at the rate it has, than one step sees: CROSSED of
    the spans at the hole, or, where these resolve √(EI/T), BENDS of it, at most CROSSED of the longest spans."""
    if system.thread.travels:
        return False
    crossed = crossing_rates(system, state) * dt
    if not (crossed > CROSSED).any():
        return False
    longest = CROSSED * float(np.diff(system.thread.spline.breaks).max())
    far = np.abs(state.s_dot) * dt > np.minimum(BENDS * resolved_bends(system, state), longest)
    return bool(((crossed > CROSSED) & far).any())


def carried_on(system: System[Body], state: State[Body], dt: float) -> tuple[Array, Array] | None:
    """Return control values (n, c) and axial forces (spans, g) [N] of a thread in one piece that goes on for `dt` [s]
    with its bends left in their holes; None where it runs round none, by CROSSED spans or less, and each point goes on
    by itself, as in the compiled loops, and where it would run one hole past another.

    It runs through the shape that it has: P(s) comes from P(s − w), w being the way on which s runs, linear from hole
    to hole, and goes on by dt v + w P', the way of the shape itself. Within a bend, and on what has run through it,
    none of that is known, and the shape stays.
    """
    thread, spline = system.thread, system.thread.spline
    if thread.travels:
        return None
    layers, ways = resolved_bends(system, state), dt * state.s_dot
    runs = (dt * crossing_rates(system, state) > CROSSED) & (layers > 0.0)
    if not runs.any() or spline.cuts.size:
        return None
    holes = np.flatnonzero(state.present)[np.argsort(state.s[state.present])]
    ends = (state.s + ways)[holes]
    if (np.diff(ends) <= 0.0).any():  # holes that would pass one another
        return None
    w = np.interp(spline.greville, ends, ways[holes])
    came_from = spline.greville - w
    place, own_way = shape_of(system, state, came_from, w, dt)
    away = np.abs(came_from[:, None] - state.s[runs]) / (np.abs(ways) + BEND * layers)[runs]
    known = np.clip(away.min(axis=1) - 1.0, 0.0, 1.0)
    q = spline.through(place + known[:, None] * own_way)
    at = thread.axial.s
    N_from = at - np.interp(at, ends, ways[holes])
    return q, np.interp(N_from, at.ravel(), state.N.ravel())


def shape_of(system: System[Body], state: State[Body], s: Array, w: Array, dt: float) -> tuple[Array, Array]:
    """Return the places of the thread at abscissae `s` (k,) [m], and the ways dt v + w P' of its shape there in `dt`
    [s], shape `(k, c)` each; beyond its ends it goes on straight."""
    spline = system.thread.spline
    inside = np.clip(s, spline.start, spline.end)
    place, slope = (evaluation(spline, inside, order) @ state.q for order in (0, 1))
    v = evaluation(spline, inside, 0) @ state.v
    return place + (s - inside)[:, None] * slope, dt * v + w[:, None] * slope


def what_it_does(system: System[Body], state: State[Body]) -> tuple[str, str]:
    """Say what the thread does in a state, and at which piercing: what is worth saying most."""
    names, p = [piercing.name for piercing in system.piercings], len(system.piercings)
    if not p:
        return "the thread moves freely", ""
    fastest = int(np.argmax(crossing_rates(system, state)[:p]))
    if np.abs(state.s_dot[fastest]) > 1.0:
        return f"the thread snaps through it at {abs(state.s_dot[fastest]):.3g} m/s", names[fastest]
    turned = alignment(system, state)[:p]
    steepest = int(np.argmin(turned))
    if turned[steepest] < TURNED_BACK:
        angle = np.degrees(np.arccos(np.clip(turned[steepest], -1.0, 1.0)))
        return f"the couple of its direction turns the thread back ({angle:.0f}° off)", names[steepest]
    if float(np.median(state.N)) < SLACK * system.thread.EA:
        return "the thread is slack", names[fastest]
    loaded = int(np.argmax(np.linalg.norm(state.lam[:p, :3], axis=1)))
    return "it slides and bends", names[loaded]


def alignment(system: System[Body], state: State[Body]) -> Array:
    """Return the cosine between thread and hole on the side where the piercing began, 1 where no direction is imposed,
    shape `(holds,)`."""
    T = system.passage_of(state).T
    normal = np.cross(state.y[:, 3:6], state.y[:, 6:])
    size = np.linalg.norm(T, axis=1) * np.linalg.norm(normal, axis=1)
    cosine = state.sense * np.sum(T * normal, axis=1) / np.maximum(size, np.finfo(float).tiny)
    return np.where(system.rows[:, 3] & state.present, cosine, 1.0)
