"""The tensions of the strands next to the holes, and the bending lengths there
(`coupling.kernels.steps.tension`).
"""

import numpy as np

from coupling.arrays import Array, Flags
from coupling.interfaces import Body
from coupling.kernels.steps import tension
from coupling.kernels.steps.tension import INSIDE, Along
from coupling.system import System
from thread.placed import Placed

REST = 1e-9  # of EA: a thread under less tension bends over its whole length


def along_of(system: System[Body]) -> Along:
    """Return the abscissae of a thread as arrays for the kernels."""
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
    """Return the tensions before and after the holds at `s` (m,) [m], shape `(m, 2)` [N], under the
    axial forces `N` [N].

    The last results are cached: the end of a step is the start of the next one.
    """

    def make() -> Array:
        along, pull = along_of(system), np.empty((len(s), 2))
        forces = np.ascontiguousarray(N.reshape(along.axial.shape))
        tension.tensions(along, np.ascontiguousarray(s), forces, np.ascontiguousarray(present), pull)
        return pull

    return system.recent_pulls.of((s, N), make, tuple(present.tolist()))


def stretches_at(system: System[Body], s: Array, N: Array, present: Flags) -> Array:
    """Return 1 + T/EA + ε̄ of every hold, shape `(m,)` [-].

    T is the mean of the tensions before and after the hold, and ε̄ the natural strain of a thread
    that relaxes. If knots do not travel, it is 1, because the law then uses |T| at the holes.
    """
    if not system.thread.travels:
        return np.ones(len(s))
    elastic = pull_at(system, s, N, present).mean(axis=1) / system.thread.EA
    return np.asarray(1.0 + elastic + system.thread.natural_at(s))


def lengths_bent_over(system: System[Body], s: Array, N: Array, present: Flags) -> Array:
    """Return √(EI/T) of every hold, at most the thread's length, shape `(m,)` [m].

    T is the larger of the tensions before and after the hold.
    """
    thread = system.thread
    pull = np.maximum(pull_at(system, s, N, present).max(axis=1), REST * thread.EA)
    return np.asarray(np.minimum(np.sqrt(thread.EI / pull), thread.spline.end - thread.spline.start))


def within(system: System[Body], s: Array) -> Flags:
    """Return which abscissae `s` (m,) [m] divide the thread."""
    return np.asarray(tension.within(system.thread.spline.breaks, s))


def is_pressed(system: System[Body], s: Array, strain: Array, borne: float, here: Flags) -> bool:
    """Return whether a part of the thread is under compression at more than half of its points.

    A point counts if its strain is below −`borne` [-]. The holds at `s` (m,) [m] that are `here`
    divide the thread into parts.
    """
    along = along_of(system)
    strain = np.ascontiguousarray(strain.reshape(along.axial.shape))
    return bool(tension.pressed(along, strain, float(borne), np.ascontiguousarray(s), np.ascontiguousarray(here)))
