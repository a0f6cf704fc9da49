"""The tension of the strands next to the holes, and what follows from it (`coupling.kernels.steps.tension`)."""

import numpy as np

from coupling.arrays import Array, Flags
from coupling.interfaces import Body
from coupling.kernels.steps import tension
from coupling.kernels.steps.tension import INSIDE, Along, Limits, Pull
from coupling.system import State, System
from thread.compliance import SLACK
from thread.placed import Placed
from thread.thread import STAGES

REST = 1e-9  # of EA: a thread under less tension than this bends over all its length
FINE = 0.5  # spans over √(EI/T) up to which a beam without tension stands for the thread
SETTLED = 1.15  # ratio of √(EI/T) at the end of a step to that which it was solved with
PASSES = 3  # of a step with another tension at its holes


def along_of(system: System[Body]) -> Along:
    """Return the abscissae of a thread as the kernels want them."""
    spline, axial = system.thread.spline, np.ascontiguousarray(system.thread.axial.s)
    axial = axial.reshape(len(axial), -1)
    greville = spline.greville
    if isinstance(spline, Placed):
        middles = 0.5 * (spline.breaks[:-1] + spline.breaks[1:])[:, None]
        axial, greville = axial + INSIDE * (middles - axial), spline.places
    share = system.thread.axial_rule.w if system.thread.travels else np.ones(axial.shape)
    places = spline.breaks, spline.cuts, axial, greville, share
    return Along(*map(np.ascontiguousarray, places))


def limits_of(system: System[Body]) -> Limits:
    """Return the constants of the tension of a thread at its holes."""
    EI, EA = float(system.thread.EI), float(system.thread.EA)
    return Limits(
        REST * EA, FINE, SLACK, float(STAGES), EI, EA, SETTLED, PASSES, bends_at_holes(system), system.thread.travels
    )


def bends_at_holes(system: System[Body]) -> bool:
    """Whether the spline lacks compliance at holes."""
    thread = system.thread
    return bool(thread.EI != 0.0 and thread.hole_compliance and system.holds)


def pull_at(system: System[Body], s: Array, N: Array, lam: Array, present: Flags) -> Pull:
    """Return the tension next to the holds at `s` (m,) [m], and what follows from it, under the axial forces `N` [N]
    and the forces `lam` (m, 5) of the holds. The answer to the last question is remembered: the end of a step is the
    start of the next."""
    there = tuple(present.tolist())
    return system.recent_pulls.of((s, N, lam), lambda: make_pull(system, s, N, lam, present), there)


def make_pull(system: System[Body], s: Array, N: Array, lam: Array, present: Flags) -> Pull:
    """Return what `pull_at` does."""
    along, m = along_of(system), len(s)
    pull = Pull(np.empty((m, 2)), np.empty(m), np.empty(m))
    directed, present = np.ascontiguousarray(system.rows[:, 3]), np.ascontiguousarray(present)
    forces = np.ascontiguousarray(N.reshape(along.axial.shape)), np.ascontiguousarray(lam)
    tension.ask(limits_of(system), along, directed, np.ascontiguousarray(s), *forces, present, pull)
    return pull


def stretches_at(system: System[Body], s: Array, N: Array, lam: Array, present: Flags) -> Array:
    """Return 1 + T/EA of every hold, T the mean of the tensions before and after it, shape `(m,)` [-]; 1 of a thread
    whose spline lacks nothing at holes."""
    return pull_at(system, s, N, lam, present).stretch


def layers_at(system: System[Body], s: Array, N: Array, lam: Array, present: Flags) -> Array | None:
    """Return √(EI/T) of every hold, shape `(m,)` [m], None of a thread that does not bend."""
    return pull_at(system, s, N, lam, present).layers if bends_at_holes(system) else None


def lengths_bent_over(system: System[Body], s: Array, N: Array, lam: Array, present: Flags) -> Array:
    """Return √(EI/T) of every hold, at most the thread's length, shape `(m,)` [m], T the larger of the tensions before
    and after it."""
    thread = system.thread
    pull = np.maximum(pull_at(system, s, N, lam, present).T.max(axis=1), REST * thread.EA)
    return np.asarray(np.minimum(np.sqrt(thread.EI / pull), thread.spline.end - thread.spline.start))


def within(system: System[Body], s: Array) -> Flags:
    """Return which abscissae `s` (m,) [m] part the thread."""
    return np.asarray(tension.within(system.thread.spline.breaks, s))


def is_pressed(system: System[Body], s: Array, strain: Array, borne: float, here: Flags) -> bool:
    """Whether half of the points of a part of the thread are pressed along themselves to a `strain` beyond the one
    `borne` [-], with holds at `s` (m,) [m] of which those that are `here` part it."""
    along = along_of(system)
    strain = np.ascontiguousarray(strain.reshape(along.axial.shape))
    return bool(tension.pressed(along, strain, float(borne), np.ascontiguousarray(s), np.ascontiguousarray(here)))


def change_of(system: System[Body], s: Array, here: Flags, layers: tuple[Array | None, Array | None]) -> float:
    """Return the largest ratio, of 1 or more, between the `layers` that were solved with and those at the end, of holes
    that are `here` on spans that are long enough for the tension to matter; infinite where only one of them bends."""
    one, other = layers
    if one is None or other is None:
        return 1.0 if one is other else np.inf
    s, here = np.ascontiguousarray(s), np.ascontiguousarray(here)
    return float(tension.change(limits_of(system), along_of(system), s, here, one, other))


def unsettled_layers(system: System[Body], state: State[Body]) -> float:
    """Return the part by which √(EI/T) of a state differs from that which it was solved with, at the hole where it does
    most [-]; 0 of a thread that was not solved with any."""
    if state.layers is None:
        return 0.0
    present = system.rows[:, 0] & state.present
    ended = layers_at(system, state.s, state.N, state.lam, state.present)
    return change_of(system, state.s, present, (state.layers, ended)) - 1.0
