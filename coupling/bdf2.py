"""Steps of second order: BDF2 for thread, organ and abscissae, the constraints at position level (`coupling.scheme`).

The first step, one after a jump (`coupling.system.forgetful`), and one much longer than the one before it are steps of
backward Euler: the error of a single one is of second order, so the run's is too. For a constrained motion that holds
for positions and velocities; the multipliers, which stand at the place of accelerations, are of second order from the
third step on. Motion that is not smooth (a hand that turns a corner of its way, a hole that begins to stick) is
followed with first order there, as by any integrator that does not stop at the corner.
"""

from dataclasses import replace

from coupling.interfaces import Body
from coupling.scheme import BDF2, BackwardEuler, Scheme
from coupling.stepping import Step, try_step
from coupling.system import State, System, forgetful

GROWTH = 2.0  # largest ratio of a step to the one before; zero-stability ends at 1 + √2


def scheme_of(state: State[Body], dt: float) -> Scheme:
    """BDF2 where there is a step to look back at, else backward Euler."""
    if state.dt_before is None or dt > GROWTH * state.dt_before:
        return BackwardEuler(dt)
    return BDF2(dt, state.dt_before)


def take(system: System[Body], state: State[Body], dt: float) -> Step[Body]:
    """One step of `dt` [s]. Raises `StepError`, `InversionError`; the state is not touched."""
    step = try_step(system, state, dt, scheme_of(state, dt))
    return replace(step, new=remembering(step.new, state, dt))


def remembering(new: State[Body], old: State[Body], dt: float) -> State[Body]:
    """The state `new` with the step from `old` that led to it."""
    return replace(new, before=forgetful(old), dt_before=dt)
