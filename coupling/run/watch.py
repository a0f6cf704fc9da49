"""A check of accepted steps: no step goes uphill (`coupling.kernels.steps.watch`).

A step along a curved way also creates a little energy, of either sign: of second order in its size
by backward Euler, of third order by BDF2. A thread that passes a hole with its knots also creates
a little energy. A thread that slides over the organ does so at every change of the facing points: it
may create a share of the product of its pressing forces and its way, which is part of no other
turnover if it slides without friction.
For this reason a step that creates more than CREATED of the available energy, with BDF2 more than
CREATED_BDF2, is halved and not refused. Half a step creates a quarter of that or less, but a jump
to another branch does not decrease. Parts of the length dt/16 may create up to a share of the
energy turnover, or a trace of the available energy; steps that create more are refused.

New packets of knots leave the thread slightly out of balance (`coupling.step.packets`). Short steps
just after that turn this into motion, and later steps dissipate it. In the step after new packets a
part LOOSENED of the available energy is allowed.

A step that returns more than such a share or trace follows a shock: it is taken by backward Euler,
without memory of the shock. External forces that change, step sizes that change, and a curved way
are not in the bound of the energy that BDF2 returns. Such a step may be halved although its motion
is correct.

A thread at rest without tension only has the energy of its round-off, all of which can be created
and dissipated in a step. The round-off of forces does work on the way over which the thread would
store the available energy. This work is always allowed
(`coupling.kernels.steps.watch.rounded_work`), as is the round-off of the energy of tissue at finite
strain.
"""

from dataclasses import astuple, dataclass

import numpy as np

from coupling.errors import LentError, UphillError
from coupling.interfaces import Body, Snapping
from coupling.kernels.steps import watch
from coupling.kernels.steps.watch import Shares
from coupling.reports.audit import Energies, audit_step, is_of_bdf2
from coupling.step.newton import rounded_force
from coupling.step.packets import points_at_start
from coupling.step.stepping import Step, scheme_of
from coupling.system import System

SHARE = 0.02  # of the energy turnover of a step
FACED = 5e-3  # of the turnover of a sliding strand; at turns of 0.04 rad a step its new places created 0.0037
TRACE = 1e-5  # of the work so far and the stored energy
LOOSENED = 0.02  # of the work so far and the stored energy
CREATED = 1e-6  # of the work so far and the stored energy, as long as the step can be halved
CREATED_BDF2 = 5e-6  # as CREATED, with BDF2; a smooth motion of the main task creates about 4e-6 at the thread's knots


@dataclass
class Watch:
    """The audit of each step before it is accepted, with the `energies` before the first step and
    after each step.

    - `downhill`: a step that creates energy is refused. The paper's linear step, two-pass friction
      and the staggered variant create some by their nature.
    - `refitted`: packets were made anew just before the first step.
    - `least` [s]: steps of this length or shorter ones are not halved for a trace of energy.
    """

    energies: list[Energies]
    downhill: bool = True
    refitted: bool = False
    least: float = 0.0

    def __call__(self, system: System[Body], step: Step[Body]) -> None:
        """Audit a step. Raises `UphillError` if it creates energy, `LentError` if it returns too much."""
        old, new = self.energies[-1], audit_step(system, self.energies[-1], step)
        made, lent, bound, loose = self.weigh(step, old, new)
        if self.downhill and made - lent > bound:
            cause = (
                f"it would create energy, {made:.3g} J, with {new.at_stake:.3g} J available: the solution is on "
                "another branch than the motion"
            )
            raise UphillError(step.old.time, step.dt, cause)
        if self.downhill and made > loose:
            raise LentError(step.old.time, step.dt, f"it would return {made:.3g} J that the last step took")
        self.energies.append(new)

    def weigh(self, step: Step[Body], old: Energies, new: Energies) -> tuple[float, float, float, float]:
        """Return four energies of a step [J]: the created one, the part of the loan that it may
        return, and two bounds.

        The first bound is for the created energy minus the returned loan, and the second one for
        the whole created energy.
        """
        problem = step.solution.problem
        thread, there = problem.system.thread, LOOSENED if self.refitted else TRACE
        give = float((thread.spline.end - thread.spline.start) / thread.EA)
        shares = Shares(created(step), there, SHARE, give)
        energies = (np.array(astuple(each)) for each in (old, new))
        made, lent, bound, loose = watch.ask(shares, rounded_force(problem), memory_of(step), *energies)
        organ = problem.system.organ
        over = FACED * sliding_turnover(step) + (organ.rounded_energy if isinstance(organ, Snapping) else 0.0)
        bound, loose = max(bound, over), max(loose, over)
        return made, lent, loose if step.dt <= self.least or self.refitted else bound, loose


def sliding_turnover(step: Step[Body]) -> float:
    """Return the sum of the forces that press points of the thread on the organ, times their ways along
    its surface [J].
    """
    strands, touch = step.solution.problem.strands, step.solution.residual.touch
    if strands is None or touch is None:
        return 0.0
    start = points_at_start(step.solution.problem.system, step.old, step.new)
    way, d = strands.places(step.new.q) - strands.places(start), strands.along[: strands.count]
    way = way - np.vecdot(way, d)[:, None] * d
    return float(touch.P[: strands.count] @ np.linalg.norm(way, axis=1))


def created(step: Step[Body]) -> float:
    """Return the share of the available energy that a step may create without being halved [-]."""
    return CREATED_BDF2 if is_of_bdf2(step) else CREATED


def memory_of(step: Step[Body]) -> float:
    """Return the weight of the earlier position in the scheme of a step; zero for backward Euler."""
    return float(scheme_of(step.old, step.dt).weights[1]) if is_of_bdf2(step) else 0.0
