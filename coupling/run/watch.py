"""A watch on accepted steps: none of them goes uphill (`coupling.kernels.steps.watch`).

A step along a curved way makes a little too, of second order in its size by backward Euler and of third by BDF2, of
either sign. So one that makes more than CREATED of what there is, by BDF2 more than CREATED_BDF2, as a thread does that
passes a hole by its knots, is halved: half the step makes a quarter of that or less, and a branch stays a branch. What
parts of dt/16 make is let pass up to a share of all the energy that they turn over, or a trace of what there is: beyond
that they are refused. Packets of knots that were made anew leave the thread a little off its balance
(`coupling.step.packets`), which short steps just after it turn into motion and later ones take back: in the step before
which they were, a LOOSENED part of what there is passes.

What gives back more than such a share or trace follows a shock: it is taken by backward Euler, without memory of it.
Forces from outside that change, steps that do, and a curved way are not in the bound of what BDF2 gives back: such a
step may be halved although its motion is the right one.

A thread that rests without tension has the energy of its round-off alone, and makes and takes all of it in any step:
what the round-off of forces does on the way that stores what there is passes always
(`coupling.kernels.steps.watch.rounded_work`).
"""

from dataclasses import astuple, dataclass

import numpy as np

from coupling.errors import LentError, UphillError
from coupling.interfaces import Body
from coupling.kernels.steps import watch
from coupling.kernels.steps.watch import Shares
from coupling.reports.audit import Energies, audit_step, is_of_bdf2
from coupling.step.newton import rounded_force
from coupling.step.stepping import Step, scheme_of
from coupling.system import System

SHARE = 0.02  # of the energy that a step turns over
TRACE = 1e-5  # of the work done so far and the energy stored
LOOSENED = 0.02  # of the same
CREATED = 1e-6  # of the same, as long as the step is halved for it
CREATED_BDF2 = 5e-6  # of the same, likewise; on a smooth course of the main job's kind some 4e-6 at the thread's knots


@dataclass
class Watch:
    """Audits each step before it is accepted, and keeps the `energies` after it, those before the first step first.

    `downhill`: a step that makes energy is refused. The paper's linear step, two-pass friction and the staggered
    variant make some by their nature. `refitted`: packets were made anew just before the first step. Parts of a step
    that are `least` [s] long, and shorter ones, are not halved for a trace of energy.
    """

    energies: list[Energies]
    downhill: bool = True
    refitted: bool = False
    least: float = 0.0

    def __call__(self, system: System[Body], step: Step[Body]) -> None:
        """Audit a step. Raises `UphillError` where it makes energy, `LentError` where it gives back too much."""
        old, new = self.energies[-1], audit_step(system, self.energies[-1], step)
        made, lent, bound, loose = self.weigh(step, old, new)
        if self.downhill and made - lent > bound:
            cause = (
                f"it would make energy, {made:.3g} J of the {new.at_stake:.3g} J there are: the solution found is on "
                "another branch than the motion"
            )
            raise UphillError(step.old.time, step.dt, cause)
        if self.downhill and made > loose:
            raise LentError(step.old.time, step.dt, f"it would give back {made:.3g} J that the step before took")
        self.energies.append(new)

    def weigh(self, step: Step[Body], old: Energies, new: Energies) -> tuple[float, float, float, float]:
        """Return what a step makes, what of that it may give back, what it may make besides that, and what it may make
        in all [J]."""
        problem = step.solution.problem
        thread, there = problem.system.thread, LOOSENED if self.refitted else TRACE
        give = float((thread.spline.end - thread.spline.start) / thread.EA)
        shares = Shares(created(step), there, SHARE, give)
        energies = (np.array(astuple(each)) for each in (old, new))
        made, lent, bound, loose = watch.ask(shares, rounded_force(problem), memory_of(step), *energies)
        return made, lent, loose if step.dt <= self.least or self.refitted else bound, loose


def created(step: Step[Body]) -> float:
    """Return the share of what there is that a step may make without being halved for it [-]."""
    return CREATED_BDF2 if is_of_bdf2(step) else CREATED


def memory_of(step: Step[Body]) -> float:
    """Return the weight of the position before the last in the scheme of a step; zero of backward Euler."""
    return float(scheme_of(step.old, step.dt).weights[1]) if is_of_bdf2(step) else 0.0


def given_back(step: Step[Body], old: Energies) -> float:
    """Return the loan that a step of BDF2 may give back [J]; zero of backward Euler, which has none."""
    return watch.given_back(memory_of(step), old.loan)
