"""The quasi-static variant (§4.4, first half): thread and organ one after the other.

    1. thread   Φ(q⁺, s⁺, y) = 0 with the holes at their places at the start of the step, y held
    2. organ    its own step under the reaction f_y = Φ_yᵀλ, which moves the holes to y⁺

The result has P(s⁺) − x⁺ = −(x⁺ − x), the motion of the hole during the step. The next step removes
this drift, and its own motion creates a new one. The work of the drift, −λ·Δ(x⁺ − x) on thread and
organ together, is energy that the scheme creates or destroys; the audit has it in the numerical
dissipation.

The thread responds to the hole's motion with its stiffness, M/Δt² + ∂²E/∂q², and the organ to the
force with its compliance. If the product is above one, the exchange diverges; for a quasi-static
organ, a shorter step makes this more likely. The monolithic step is the default; this one is for
comparison.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from coupling.answer import all_holds, hold_still
from coupling.arrays import Array
from coupling.errors import RunAwayError
from coupling.integrators import BackwardEuler, Scheme
from coupling.interfaces import Answer, Body, Organ
from coupling.joins.contact import solve_contact
from coupling.kernels.constraints import site_force
from coupling.step.stepping import Step, Take, organ_answer, try_step, with_sense
from coupling.system import State, System
from tissue.organs.meshed import NO_LIPS, Lips, OrganEnergies, SiteAnswer, TimeScheme

FARTHEST = 0.1  # of the thread's length: a hole that moves further in one step has run away


@dataclass(frozen=True)
class HeldOrgan(Generic[Body]):
    """An organ that does not move under forces, as in the thread's own step."""

    organ: Organ[Body]

    @property
    def y0(self) -> Array:
        """Site variables of the organ at rest, shape `(9p,)`."""
        return self.organ.y0

    def start(self) -> Body:
        """Return the state of the organ at the start."""
        return self.organ.start()

    def answer(self, scheme: TimeScheme, past: Sequence[Body], time: float, share: float = 1.0) -> SiteAnswer[Body]:
        """Return the answer of the organ at its place."""
        return hold_still(self.organ, past[0])

    def site_variables(self, state: Body) -> Array:
        """Return y of the organ, shape `(9p,)`."""
        return self.organ.site_variables(state)

    def lips(self, state: Body) -> Lips:
        """Return no pairs: the lips are in contact only in the organ's own step."""
        return NO_LIPS

    def energies(self, old: Body, new: Body) -> OrganEnergies:
        """Return the energies of the organ, which does no work here."""
        return self.organ.energies(old, new)

    def impulse(self, state: Body) -> Answer[Body] | None:
        """Return the organ's answer to an impulse."""
        return self.organ.impulse(state)

    def displace(self, scheme: TimeScheme, state: Body, y: Array, f_y: Array) -> SiteAnswer[Body]:
        """Return the answer of the organ at its place."""
        return hold_still(self.organ, state)


SchemeOf = Callable[[State[Body], float], Scheme]


def backward_euler(state: State[Body], dt: float) -> Scheme:
    """Return the scheme of an organ without memory."""
    return BackwardEuler(dt)


def staggered_step(system: System[Body], state: State[Body], dt: float) -> Step[Body]:
    """Return one step of `dt` [s], with thread and organ by backward Euler.

    Raises `StepError`, `InversionError`, `RunAwayError`.
    """
    return stagger(try_step, backward_euler)(system, state, dt)


def stagger(thread_step: Take[Body], scheme_of: SchemeOf[Body]) -> Take[Body]:
    """Return the staggered step with the thread's step `thread_step` and the organ's scheme by `scheme_of`.

    `scheme_of` returns the scheme for a state and dt.
    """

    def take(system: System[Body], state: State[Body], dt: float) -> Step[Body]:
        step = thread_step(replace(system, organ=HeldOrgan(system.organ)), state, dt)
        return move_organ(system, step, scheme_of(step.old, dt))  # a step without memory: also for the organ

    return take


def move_organ(system: System[Body], step: Step[Body], scheme: Scheme) -> Step[Body]:
    """Make the organ's own step under the reaction of the thread, after the thread's step.

    Raises `RunAwayError`, `InversionError`.
    """
    state, new, at = step.old, step.new, step.solution.residual.passage
    f_y = site_force(at, new.lam, step.solution.iterate.y)[: len(system.piercings)].ravel()
    answer = organ_answer(system, scheme, state)
    organ = answer.accept(f_y, solve_contact(system, f_y, answer))
    y = all_holds(system, system.organ.site_variables(organ))
    refuse_runaway(system, state, y, step.dt)
    new = with_sense(system, state, replace(new, organ=organ, y=y), at)
    return replace(step, new=new)


def refuse_runaway(system: System[Body], state: State[Body], y: Array, dt: float) -> None:
    """Raise `RunAwayError` if a hole moves further than FARTHEST of the thread's length in one step, or to nan."""
    spline, p = system.thread.spline, len(system.piercings)
    way = np.nan_to_num(np.linalg.norm((y - state.y)[:p, :3], axis=1), nan=np.inf)
    if way.max(initial=0.0) > FARTHEST * (spline.end - spline.start):
        worst = int(np.argmax(way))
        raise RunAwayError(state.time, dt, system.piercings[worst].name, float(way[worst]))


def work_of_the_lag(system: System[Body], met: Array, step: Step[Body]) -> float:
    """Return the energy [J] that a step creates because the thread was solved with the old places of the holes.

    It is f_y·(Δy − Δŷ), the work on the organ minus the work by the thread; negative values are
    destroyed energy. ŷ (holds, 9) are the places of the holes in the thread's step, and `met` is ŷ
    of the step before (y at the start). The lag is zero for the monolithic step. In slow motion the
    organ moves with the force and the lag destroys energy; created energy feeds a growing exchange.
    """
    p = len(system.piercings)
    f_y = site_force(step.solution.residual.passage, step.new.lam, step.solution.iterate.y)
    lag = (step.new.y - step.old.y) - (step.solution.iterate.y - met)
    return float(np.sum((f_y * lag)[:p]))
