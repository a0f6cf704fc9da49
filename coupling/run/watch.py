"""A watch on accepted steps: none of them goes uphill.

A step of backward Euler without friction is a stationary point of the incremental potential; the one that mechanics
means is the minimum reached downhill from where the thread was. A root of the same equations that lies higher is
another branch, on which Newton has landed: its residuals are as small and its balance closes, but it makes energy,
which the audit books as numerical dissipation below zero. Friction and damping only take more.

A step along a curved way makes a little too, of second order in its size by backward Euler and of third by BDF2, of
either sign. So one that makes more than CREATED of what there is, by BDF2 more than CREATED_BDF2, as a thread does that
passes a hole by its knots, is halved: half the step makes a quarter of that or less, and a branch stays a branch. What
parts of dt/16 make is let pass up to a share of all the energy that they turn over, or a trace of what there is: beyond
that they are refused. Knots that were exchanged leave the thread a little off its balance (`coupling.run.adaptivity`),
which short steps just after it turn into motion and later ones take back: in the step before which they were, a
LOOSENED part of what there is passes.

BDF2 falls in a norm of its own, over two steps: where a stiff motion begins at once it takes in one step what it gives
back in the next. For linear motion with losses, in the norm of its energy E, the formula
A δ − B δ⁻ of the last two ways, A = (1+2ω)/(1+ω), B = ω²/(1+ω) (`coupling.integrators.BDF2`), dotted with x⁺ is

    A (ΔE + β) − B (ΔE⁻ + β⁻ + δ·δ⁻) = A W − B W⁻ − losses,

W being the work from outside and β = ½δ² what backward Euler takes on the same way. With 2 δ·δ⁻ ≤ δ² + δ⁻², and
D = W − ΔE what a step takes,

    −D ≤ r (2β⁻ − D⁻) − (1 − r) β,     r = B/A = ω²/(1+2ω),

and r < 1 where the formula is zero-stable, a third at equal steps (Dahlquist's G-stability, BIT 18, 1978). 2β⁻ − D⁻ is
the loan of the step before, of which the next one may give back the part r. An organ's β is taken to be its D.
Forces from outside that change, steps that do, and a curved way add terms of either sign that the bound leaves out:
such a step may be halved although its motion is the right one. What gives back more than such a share or trace follows
a shock: it is taken by backward Euler, without memory of it.

A thread that rests without tension has the energy of its round-off alone, and makes and takes all of it in any step:
what the round-off of forces does on the way that stores what there is, `rounded_work`, passes always.
"""

from dataclasses import dataclass

import numpy as np

from coupling.errors import LentError, UphillError
from coupling.interfaces import Body
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
    variant make some by their nature. `refitted`: knots were exchanged just before the first step. Parts of a step that
    are `least` [s] long, and shorter ones, are not halved for a trace of energy.
    """

    energies: list[Energies]
    downhill: bool = True
    refitted: bool = False
    least: float = 0.0

    def __call__(self, system: System[Body], step: Step[Body]) -> None:
        """Audit a step. Raises `UphillError` where it makes energy, `LentError` where it gives back too much."""
        old, new = self.energies[-1], audit_step(system, self.energies[-1], step)
        made = old.numerical_dissipation - new.numerical_dissipation
        if self.downhill and made - given_back(step, old) > self.bound(step, old, new):
            cause = (
                f"it would make energy, {made:.3g} J of the {new.at_stake:.3g} J there are: the solution found is on "
                "another branch than the motion"
            )
            raise UphillError(step.old.time, step.dt, cause)
        if self.downhill and made > self.loose_bound(step, old, new):
            raise LentError(step.old.time, step.dt, f"it would give back {made:.3g} J that the step before took")
        self.energies.append(new)

    def bound(self, step: Step[Body], old: Energies, new: Energies) -> float:
        """Return what a step may make, besides what it gives back [J]."""
        if step.dt > self.least and not self.refitted:
            create = CREATED_BDF2 if is_of_bdf2(step) else CREATED
            return max(create * new.at_stake, rounded_work(step, new.at_stake))
        return self.loose_bound(step, old, new)

    def loose_bound(self, step: Step[Body], old: Energies, new: Energies) -> float:
        """Return what no step may make, whether it gives it back or not [J]."""
        loose = LOOSENED if self.refitted else TRACE
        return max(SHARE * turned_over(old, new), loose * new.at_stake, rounded_work(step, new.at_stake))


def rounded_work(step: Step[Body], at_stake: float) -> float:
    """Return the work of the round-off F of forces where so much is `at_stake` [J]: on the way √(2 E L/EA) on which a
    thread that is drawn out stores that energy E, and on the way F L/EA on which F itself draws it out."""
    thread, force = step.solution.problem.system.thread, rounded_force(step.solution.problem)
    give = (thread.spline.end - thread.spline.start) / thread.EA
    return float(force * (np.sqrt(2.0 * give * max(at_stake, 0.0)) + give * force))


def given_back(step: Step[Body], old: Energies) -> float:
    """Return the loan that a step of BDF2 may give back [J]; zero of backward Euler, which has none."""
    return -scheme_of(step.old, step.dt).weights[1] * max(old.loan, 0.0) if is_of_bdf2(step) else 0.0


def turned_over(old: Energies, new: Energies) -> float:
    """Return what a step moves between work, motion, thread and organ [J]."""
    names = ("external_work", "kinetic", "elastic_thread", "elastic_tissue")
    return sum(abs(getattr(new, name) - getattr(old, name)) for name in names)
