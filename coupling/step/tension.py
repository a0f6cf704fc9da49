"""The tension of the strands next to the holes, and over what length the thread bends there
(`coupling.kernels.steps.tension`)."""

import numpy as np

from coupling.arrays import Array, Flags
from coupling.interfaces import Body
from coupling.kernels.steps import tension
from coupling.kernels.steps.tension import INSIDE, Along
from coupling.system import System
from thread.placed import Placed

REST = 1e-9  # of EA: a thread under less tension than this bends over all its length


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


def pull_at(system: System[Body], s: Array, N: Array, present: Flags) -> Array:
    """Return the tensions before and after the holds at `s` (m,) [m], shape `(m, 2)` [N], under the axial forces `N`
    [N]. The answer to the last question is remembered: the end of a step is the start of the next."""
    there = tuple(present.tolist())
    return system.recent_pulls.of((s, N), lambda: make_pull(system, s, N, present), there)


def make_pull(system: System[Body], s: Array, N: Array, present: Flags) -> Array:
    """Return what `pull_at` does."""
    along, pull = along_of(system), np.empty((len(s), 2))
    forces = np.ascontiguousarray(N.reshape(along.axial.shape))
    tension.tensions(along, np.ascontiguousarray(s), forces, np.ascontiguousarray(present), pull)
    return pull


def stretches_at(system: System[Body], s: Array, N: Array, present: Flags) -> Array:
    """Return 1 + T/EA + ε̄ of every hold, T the mean of the tensions before and after it and ε̄ the natural strain of a
    thread that relaxes, shape `(m,)` [-]; 1 of a thread whose knots stand still, which has |T| at its holes in the
    place of that."""
    if not system.thread.travels:
        return np.ones(len(s))
    elastic = pull_at(system, s, N, present).mean(axis=1) / system.thread.EA
    return np.asarray(1.0 + elastic + system.thread.natural_at(s))


def lengths_bent_over(system: System[Body], s: Array, N: Array, present: Flags) -> Array:
    """Return √(EI/T) of every hold, at most the thread's length, shape `(m,)` [m], T the larger of the tensions before
    and after it."""
    thread = system.thread
    pull = np.maximum(pull_at(system, s, N, present).max(axis=1), REST * thread.EA)
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
