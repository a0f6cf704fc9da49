"""When within a step its events happened: where what decides on each passes zero.

A step sees its ends alone. Between them what decides is interpolated, with an error of second order in the step:

    slips      σ f − (F₀ + μ_s N), from the start of the step to what would be its end if the hole still held
    sticks     ds/dt, from the start to what would be the end if the hole went on sliding as it did
    leaves     s less the end of the thread, a cubic by s and ds/dt at both ends of the step in which it passes that
    tears      the bearing pressure less the strength

What would be the end is the step solved again as if nothing switched: with the hole held, or under the friction of the
old sense. One that turns back in a step stops in between and slips from there, its force rising from one bound to the
other. The motion itself is not cut there: a switch acts over the whole of its step, and of what is not smooth an
integrator is of first order (`coupling.integrators`).

What happens at rest has no time within a load step, and what comes to no solution bears the time of the step's end.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from coupling.arrays import Array, Flags
from coupling.errors import StepError
from coupling.integrators import BackwardEuler
from coupling.interfaces import Body
from coupling.kernels.constraints import Passage
from coupling.step.newton import Iterate, Solution
from coupling.step.sliding import Law, ruled
from coupling.step.solver import solve
from coupling.step.stepping import Step, abscissa_rates, scheme_of
from coupling.system import State, System


@dataclass(frozen=True)
class Times:
    """When the holds of a step began to slip, to stick, and were left, shape `(m,)` each [s]; the end of the step where
    they did not or where that is not known. `start` and `end` [s] are those of the step."""

    start: float
    end: float
    slips: Array
    sticks: Array
    leaves: Array

    def between(self, before: Array, after: Array) -> Array:
        """Return when what goes evenly from values `before` the step to those `after` it rises through zero [s]."""
        return np.asarray(self.start + (self.end - self.start) * share_until_zero(before, after))


def times_at_end(old: State[Body], new: State[Body]) -> Times:
    """Return the times of what is told by the ends of a step alone: its end."""
    end = np.full(len(new.s), new.time)
    return Times(old.time, new.time, end, end, end)


def locate(old: State[Body], step: Step[Body]) -> Times:
    """Return the times at which the holds of a step in time switched; `old` is the state that it began with, with the
    holes still in force that were left in it."""
    times = times_at_end(old, step.new)
    problem = step.solution.problem
    if problem.stiffen:
        return times
    times = replace(times, leaves=leaving_times(old, step))
    rubs = problem.law.rough & problem.law.may_slide & (old.sigma != step.new.sigma)
    if not rubs.any():
        return times
    stopped = rubs & (old.sigma != 0.0)
    sticks = sticking_times(old, step, stopped) if stopped.any() else times.sticks
    started = rubs & (step.new.sigma != 0.0)
    if not started.any():
        return replace(times, sticks=sticks)
    return replace(times, sticks=sticks, slips=slipping_times(old, step, started, np.where(stopped, sticks, old.time)))


def slipping_times(old: State[Body], step: Step[Body], started: Flags, since: Array) -> Array:
    """Return when the holds that `started` to slip in a step did, shape `(m,)` [s], which stuck `since` then (m,) [s]:
    those that slid before under the bound on the other side."""
    law, end = step.solution.problem.law, np.full(len(started), step.new.time)
    held = tried(step, replace(law, may_slide=law.may_slide & ~started))
    if held is None:
        return end
    system, sigma, z = held.problem.system, step.new.sigma, held.iterate

    def excess(at: Passage, state: State[Body] | Iterate) -> Array:
        f, bound, barb = ruled(law, state.sigma, at, state.s, state.lam, state.y).judged.T
        return np.asarray(sigma * (f - barb) - bound)

    before, after = excess(system.passage_of(old), old), excess(held.residual.passage, z)
    return np.where(started, since + (end - since) * share_until_zero(before, after), end)


def sticking_times(old: State[Body], step: Step[Body], stopped: Flags) -> Array:
    """Return when the holds that `stopped` sliding as they did in a step did, shape `(m,)` [s]: in the step before
    where they slid back at its end already, but not over the whole of it."""
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
    """Return the law of a step in which the holds that `stopped` slide on under the friction of the sense `sigma` (m,)
    that they had, as large as what presses at its end makes it."""
    law, z = step.solution.problem.law, step.solution.iterate
    friction = sigma * ruled(law, z.sigma, step.solution.residual.passage, z.s, z.lam, z.y).kinetic
    return replace(law, rough=law.rough & ~stopped, injected=law.injected + np.where(stopped, friction, 0.0))


def tried(step: Step[Body], law: Law) -> Solution[Body] | None:
    """Return the solution of a step under another law of sliding, None where there is none."""
    try:
        return solve(replace(step.solution.problem, law=law), step.solution.iterate)
    except StepError:
        return None


def leaving_times(old: State[Body], step: Step[Body]) -> Array:
    """Return when the holes that the thread left in a step were left, shape `(m,)` [s]."""
    out = np.full(len(old.s), step.new.time)
    for beyond in step.beyond:
        for k in np.flatnonzero(beyond.present & old.present & ~step.new.present):
            out[k] = end_passed(old, beyond, int(k), nearer_end(step.solution.problem.system, float(beyond.s[k])))
    return out


def end_passed(old: State[Body], beyond: State[Body], k: int, end: float) -> float:
    """Return when the abscissa of hold `k` passed the `end` [m] of the thread, between a state and one `beyond` it; the
    end of the step where it comes back before that."""
    course = CubicHermiteSpline([old.time, beyond.time], [old.s[k], beyond.s[k]], [old.s_dot[k], beyond.s_dot[k]])
    passed = course.solve(end, extrapolate=False)
    return float(passed.min(initial=beyond.time))


def nearer_end(system: System[Body], s: float) -> float:
    """Return the end of its piece of thread by which a hole at `s` was left [m]."""
    spline = system.thread.spline
    start, end = spline.piece_ends[spline.piece_of(s) + np.arange(2)]
    return float(start if s - start < end - s else end)


def share_until_zero(before: Array, after: Array) -> Array:
    """Return the part of a way at which what goes evenly from values `before` it to those `after` it, `(m,)` each,
    rises through zero: 0 where it has already, 1 where it does not, or from −∞."""
    rise = np.subtract(after, before, out=np.full(np.shape(before), np.inf), where=np.isfinite(before))
    whole, rises = np.where(before < 0.0, 1.0, 0.0), (rise > 0.0) & np.isfinite(rise)
    return np.clip(np.divide(-before, rise, out=whole, where=rises), 0.0, 1.0)
