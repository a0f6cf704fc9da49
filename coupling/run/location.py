"""The times of events within a step: the zero of the quantity that decides on each event.

A step only has the states at its ends. Between them the quantity is interpolated, with an error of
second order in the step:

    slips      σ f − (F₀ + μ_s N), from the start of the step to the end of a step in which the hole still holds
    sticks     ds/dt, from the start to the end of a step in which the hole continues to slide
    leaves     s minus the end of the thread, a cubic by s and ds/dt at both ends of the step that passes it
    tears      bearing pressure minus strength

The hypothetical end is found by a solution of the step without a switch: with the hole held, or
under the friction of the old sense. A hold that reverses its motion in a step stops in between and
slips from then on, while its force rises from one bound to the other. The motion itself is not
divided at this time: a switch acts over its whole step. An integrator is of first order there
anyway (`coupling.integrators`).

Events at rest have no time within a load step or its part. An event without a solution has the time of the end
of the step.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from coupling.arrays import Array, Flags
from coupling.errors import StepError
from coupling.integrators import BackwardEuler
from coupling.interfaces import Body
from coupling.kernels.constraints import Passage
from coupling.kernels.friction import Law
from coupling.step.newton import Iterate, Solution, ruled_at
from coupling.step.solver import solve
from coupling.step.stepping import Step, abscissa_rates, scheme_of
from coupling.system import State, System


@dataclass(frozen=True)
class Times:
    """The times at which the holds of a step began to slip, to stick, and were left, shape `(m,)` each [s].

    The time is that of the end of the step if this did not happen or is unknown. `start` and `end`
    [s] are those of the step.
    """

    start: float
    end: float
    slips: Array
    sticks: Array
    leaves: Array

    def between(self, before: Array, after: Array) -> Array:
        """Return the times at which quantities rise through zero, linearly from `before` the step
        to `after` it [s].
        """
        return np.asarray(self.start + (self.end - self.start) * share_until_zero(before, after))


def times_at_end(old: State[Body], new: State[Body]) -> Times:
    """Return the times of a step if only its ends are known: its end."""
    end = np.full(len(new.s), new.time)
    return Times(old.time, new.time, end, end, end)


def locate(old: State[Body], step: Step[Body]) -> Times:
    """Return the times at which the holds of a step in time switched.

    `old` is the state at its start, in which the holes that were left in it are still active.
    """
    times = times_at_end(old, step.new)
    problem = step.solution.problem
    if problem.stiffen:
        return times
    times = replace(times, leaves=leaving_times(old, step))
    rubs = problem.law.rough & ~problem.law.by_hand & problem.law.may_slide & (old.sigma != step.new.sigma)
    if not rubs.any():
        return times
    stopped = rubs & (old.sigma != 0.0)
    sticks = sticking_times(old, step, stopped) if stopped.any() else times.sticks
    started = rubs & (step.new.sigma != 0.0)
    if not started.any():
        return replace(times, sticks=sticks)
    return replace(times, sticks=sticks, slips=slipping_times(old, step, started, np.where(stopped, sticks, old.time)))


def slipping_times(old: State[Body], step: Step[Body], started: Flags, since: Array) -> Array:
    """Return the times at which the holds that `started` to slip in a step did so, shape `(m,)` [s].

    They stuck from the times `since` (m,) [s] on. A hold that slid before rises from the bound on
    the other side.
    """
    law, end = step.solution.problem.law, np.full(len(started), step.new.time)
    held = tried(step, law._replace(may_slide=law.may_slide & ~started))
    if held is None:
        return end
    system, sigma, z = held.problem.system, step.new.sigma, held.iterate

    def excess(at: Passage, state: State[Body] | Iterate) -> Array:
        f, bound, barb = ruled_at(step.solution.problem, state, at).judged.T
        return np.asarray(sigma * (f - barb) - bound)

    before, after = excess(system.passage_of(old), old), excess(held.residual.passage, z)
    return np.where(started, since + (end - since) * share_until_zero(before, after), end)


def sticking_times(old: State[Body], step: Step[Body], stopped: Flags) -> Array:
    """Return the times at which the holds that `stopped` sliding in a step did so, shape `(m,)` [s].

    If the hold already moved back at the end of the step before, but not over the whole of that
    step, the time lies in that step.
    """
    end, before = np.full(len(stopped), step.new.time), old.before
    slid = tried(step, rubbed_on(step, stopped, old.sigma))
    if slid is None:
        return end
    scheme = BackwardEuler(step.dt) if step.new.before is None else scheme_of(step.old, step.dt)
    rate, rate_after = old.sigma * old.s_dot, old.sigma * abscissa_rates(scheme, step.old, slid.iterate)
    out = old.time + (end - old.time) * share_until_zero(-rate, -rate_after)
    if before is not None:
        slides_on = before.sigma == old.sigma
        lately = 1.0 - np.where(slides_on, share_until_zero(-old.sigma * before.s_dot, -rate), 1.0)
        out = out - (old.time - before.time) * lately
    return np.where(stopped, out, end)


def rubbed_on(step: Step[Body], stopped: Flags, sigma: Array) -> Law:
    """Return the law of a step in which the holds that `stopped` continue to slide.

    Their friction has the sense `sigma` (m,) that they had, and the size by the normal force at the
    end of the step.
    """
    law, solution = step.solution.problem.law, step.solution
    friction = sigma * ruled_at(solution.problem, solution.iterate, solution.residual.passage).kinetic
    return law._replace(rough=law.rough & ~stopped, injected=law.injected + np.where(stopped, friction, 0.0))


def tried(step: Step[Body], law: Law) -> Solution[Body] | None:
    """Return the solution of a step under another law of sliding; None if there is none."""
    try:
        return solve(replace(step.solution.problem, law=law), step.solution.iterate)
    except StepError:
        return None


def leaving_times(old: State[Body], step: Step[Body]) -> Array:
    """Return the times at which the holes that the thread left in a step were left, shape `(m,)` [s]."""
    out = np.full(len(old.s), step.new.time)
    for beyond in step.beyond:
        for k in np.flatnonzero(beyond.present & old.present & ~step.new.present):
            out[k] = end_passed(old, beyond, int(k), nearer_end(step.solution.problem.system, float(beyond.s[k])))
    return out


def end_passed(old: State[Body], beyond: State[Body], k: int, end: float) -> float:
    """Return the time at which the abscissa of hold `k` passed the `end` [m] of the thread.

    The abscissa is interpolated between the states `old` and `beyond`. The time is that of `beyond`
    if the cubic does not reach the end.
    """
    course = CubicHermiteSpline([old.time, beyond.time], [old.s[k], beyond.s[k]], [old.s_dot[k], beyond.s_dot[k]])
    passed = course.solve(end, extrapolate=False)
    return float(passed.min(initial=beyond.time))


def nearer_end(system: System[Body], s: float) -> float:
    """Return the end of its piece of thread over which a hole at `s` was left [m]."""
    spline = system.thread.spline
    start, end = spline.piece_ends[spline.piece_of(s) + np.arange(2)]
    return float(start if s - start < end - s else end)


def share_until_zero(before: Array, after: Array) -> Array:
    """Return the part of a way at which quantities rise through zero, linearly from `before` to
    `after` it, `(m,)` each.

    It is 0 if a quantity starts at or above zero. It is 1 if it does not rise to zero, or rises
    from −∞.
    """
    rise = np.subtract(after, before, out=np.full(np.shape(before), np.inf), where=np.isfinite(before))
    whole, rises = np.where(before < 0.0, 1.0, 0.0), (rise > 0.0) & np.isfinite(rise)
    return np.clip(np.divide(-before, rise, out=whole, where=rises), 0.0, 1.0)
