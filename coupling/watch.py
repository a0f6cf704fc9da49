"""A watch on accepted steps: none of them goes uphill.

A step of backward Euler without friction is a stationary point of the incremental potential; the one that mechanics
means is the minimum reached downhill from where the thread was. A root of the same equations that lies higher is
another branch, on which Newton has landed: its residuals are as small and its balance closes, but it makes energy,
which the audit books as numerical dissipation below zero. Friction and damping only take more.

A step along a curved way makes a little too, of second order in its size, of either sign. So a step is refused where
what it makes is more than a share of all the energy it turns over, and more than a trace of what there is: half the
step halves the one, and a branch stays a branch. Knots that were exchanged leave the thread a little off its balance
(`coupling.adaptivity`), which short steps just after it turn into motion and later ones take back: in the step before
which they were, a LOOSENED part of what there is passes.

BDF2 falls in a norm of its own, over two steps: where a stiff motion begins at once it may take in one step and give
back in the next. Such a step is taken again by backward Euler before it is halved (`coupling.stepping.advance`).
"""

from dataclasses import dataclass

from coupling.audit import Energies, audit_step
from coupling.errors import UphillError
from coupling.interfaces import Body
from coupling.stepping import Step
from coupling.system import System

SHARE = 0.02  # of the energy that a step turns over
TRACE = 1e-5  # of the work done so far and the energy stored
LOOSENED = 0.02  # of the same


@dataclass
class Watch:
    """Audits each step before it is accepted, and keeps the `energies` after it, those before the first step first.

    `downhill`: a step that makes energy is refused. The paper's linear step, two-pass friction and the staggered
    variant make some by their nature. `refitted`: knots were exchanged just before the first step.
    """

    energies: list[Energies]
    downhill: bool = True
    refitted: bool = False

    def __call__(self, system: System[Body], step: Step[Body]) -> None:
        """Audit a step. Raises `UphillError` where it makes energy."""
        old, new = self.energies[-1], audit_step(system, self.energies[-1], step)
        made = old.numerical_dissipation - new.numerical_dissipation
        loose = LOOSENED * new.at_stake if self.refitted else 0.0
        if self.downhill and made > max(SHARE * turned_over(old, new), TRACE * new.at_stake, loose):
            cause = (
                f"it would make energy, {made:.3g} J of the {new.at_stake:.3g} J there are: the solution found is on "
                "another branch than the motion"
            )
            raise UphillError(step.old.time, step.dt, cause)
        self.energies.append(new)


def turned_over(old: Energies, new: Energies) -> float:
    """Return what a step moves between work, motion, thread and organ [J]."""
    names = ("external_work", "kinetic", "elastic_thread", "elastic_tissue")
    return sum(abs(getattr(new, name) - getattr(old, name)) for name in names)
