"""The quasi-static variant (§4.4, first half): thread and organ one after the other.

    1. thread   Φ(q⁺, s⁺, y) = 0 with the holes where the organ had them at the start of the step, y held
    2. organ    its own step under the reaction f_y = Φ_yᵀλ, which moves the holes to y⁺

so P(s⁺) − x⁺ = −(x⁺ − x), the way the hole went during the step: the drift that the next step makes up for, and its own
motion makes anew. Its work, −λ·Δ(x⁺ − x) on thread and organ together, is energy the scheme creates or destroys; the
audit finds it in the numerical dissipation. The thread answers the hole's motion with its stiffness, M/Δt² + ∂²E/∂q²,
and the organ the force with its compliance: where the product is above one the exchange diverges, for a quasi-static
organ the sooner the shorter the step. The monolithic step is the one to use; this one is what it is compared with.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from coupling.constraints import Array, site_force
from coupling.contact import NO_FORCES, contact_under
from coupling.errors import RunAwayError
from coupling.interfaces import Organ
from coupling.scheme import BackwardEuler, Scheme
from coupling.stepping import Step, Take, all_holds, organ_history, refuse_inversion, try_step
from coupling.system import State, System

FARTHEST = 0.1  # of the thread's length: a hole that moved further in one step has run away


@dataclass(frozen=True)
class HeldPrediction:
    """The organ does not move: `y_free` (9p,) are the site variables of its `state`."""

    y_free: Array
    state: Any


@dataclass(frozen=True)
class HeldOrgan:
    """An organ as the thread meets it during its own step: where it is, whatever the force."""

    organ: Organ

    @property
    def y0(self) -> Array:
        """Site variables of the organ at rest, shape `(9p,)`."""
        return self.organ.y0

    @property
    def Y(self) -> csr_matrix:
        """No unknowns, shape `(9p, 0)`."""
        return csr_matrix((self.y0.size, 0))

    @property
    def size(self) -> int:
        """Zero."""
        return 0

    @property
    def pairs(self) -> int:
        """Zero: its lips meet one another in its own step."""
        return 0

    def gap(self, state: Any) -> Array:
        """None, shape `(0,)`."""
        return NO_FORCES

    def contact_forces(self, state: Any) -> Array:
        """None, shape `(0,)`."""
        return NO_FORCES

    @property
    def A(self) -> csr_matrix:
        """Shape `(0, 0)`."""
        return csr_matrix((0, 0))

    @property
    def C(self) -> Array:
        """It does not give, shape `(9p, 9p)`."""
        return np.zeros((self.y0.size, self.y0.size))

    def displacement(self, state: Any) -> Array:
        """Of the organ [m]."""
        return self.organ.displacement(state)

    def start(self) -> Any:
        """The organ's."""
        return self.organ.start()

    def operator(self, a: float, d: float) -> "HeldOrgan":
        """The same for all."""
        return self

    def history(self, coefficients: Any, states: Any) -> None:
        """It has none."""

    def energies(self, old: Any, new: Any) -> Any:
        """Of the organ, which does no work here."""
        return self.organ.energies(old, new)

    def site_variables(self, state: Any) -> Array:
        """y, shape `(9p,)`."""
        return self.organ.site_variables(state)

    def right_hand_side(self, state: Any, history: Any) -> Array:
        """Shape `(0,)`."""
        return np.zeros(0)

    def predict(self, state: Any, history: Any) -> HeldPrediction:
        """Where it is."""
        return HeldPrediction(self.organ.site_variables(state), state)

    def complete(self, prediction: HeldPrediction, f_y: Array, p: Array = NO_FORCES) -> Any:
        """As it was."""
        return prediction.state


SchemeOf = Callable[[State, float], Scheme]


def backward_euler(state: State, dt: float) -> Scheme:
    """The scheme of an organ that looks back at nothing."""
    return BackwardEuler(dt)


def take(system: System, state: State, dt: float) -> Step:
    """One step of `dt` [s], thread and organ by backward Euler. Raises `StepError`, `InversionError`,
    `RunAwayError`; the state is not touched."""
    return staggered(try_step, backward_euler)(system, state, dt)


def staggered(thread_step: Take, scheme_of: SchemeOf) -> Take:
    """The staggered step whose thread takes `thread_step` and whose organ steps by the scheme that `scheme_of` names
    for a state and dt."""

    def take(system: System, state: State, dt: float) -> Step:
        step = thread_step(replace(system, organ=HeldOrgan(system.organ)), state, dt)
        return organ_moved(system, step, scheme_of(state, dt))

    return take


def organ_moved(system: System, step: Step, scheme: Scheme) -> Step:
    """The step after the organ has taken its own under the reaction of the thread. Raises `RunAwayError`,
    `InversionError`."""
    state, new, at = step.old, step.new, step.solution.residual.passage
    f_y = site_force(at, new.lam, step.solution.iterate.y)[: len(system.piercings)].ravel()
    operator = system.organ.operator(scheme.a, scheme.d)
    prediction = operator.predict(state.organ, organ_history(system, scheme, state))
    organ = operator.complete(prediction, f_y, contact_under(system, f_y, operator, prediction))
    y = all_holds(system, system.organ.site_variables(organ))
    refuse_runaway(system, state, y, step.dt)
    new = replace(new, organ=organ, y=y)
    refuse_inversion(system, state, new, at)
    return replace(step, new=new)


def refuse_runaway(system: System, state: State, y: Array, dt: float) -> None:
    """Raise `RunAwayError` where a hole goes further than FARTHEST of the thread's length in one step, or nowhere."""
    spline, p = system.thread.spline, len(system.piercings)
    way = np.nan_to_num(np.linalg.norm((y - state.y)[:p, :3], axis=1), nan=np.inf)
    if way.max(initial=0.0) > FARTHEST * (spline.end - spline.start):
        worst = int(np.argmax(way))
        raise RunAwayError(state.time, dt, system.piercings[worst].name, float(way[worst]))


def work_of_the_lag(system: System, met: Array, step: Step) -> float:
    """Energy that a step creates because the thread met the holes where they had been, [J]; negative: destroyed.

    f_y·(Δy − Δŷ), what the organ is given less what the thread gives, where ŷ (holds, 9) is where the thread met the
    holes and `met` is ŷ of the step before (y at the start). Zero for the monolithic step. Followed slowly, the organ
    moves with the force and the lag destroys energy; what it creates feeds a growing exchange.
    """
    p = len(system.piercings)
    f_y = site_force(step.solution.residual.passage, step.new.lam, step.solution.iterate.y)
    lag = (step.new.y - step.old.y) - (step.solution.iterate.y - met)
    return float(np.sum((f_y * lag)[:p]))
