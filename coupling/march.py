"""Whole steps in compiled loops (`coupling.compiled.steps`), many in a call: what they cover and what they leave.

A step that goes on smoothly from the one before is predicted, solved, concluded, looked at and audited in the loops,
and the next one after it. What is out of the ordinary is left to `coupling.stepping.advance`, which gives the same step
the same numbers but for round-off: a step that does not converge, a thread that is pressed along itself, a hole that is
left or passed or whose frame turns through itself, stick that becomes slip, and a step uphill.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from typing import Generic

import numpy as np

from coupling.audit import Energies
from coupling.calls import ask_before_correction
from coupling.integrators import BackwardEuler, Scheme
from coupling.interfaces import Body, Modal, Steady
from coupling.newton import Iterate, Solution, evaluate
from coupling.solver import covers
from coupling.stepping import Take, bdf2_step, dynamic_problem, organ_answer, scheme_of, try_step
from coupling.system import State, System, forgetful


@dataclass(frozen=True)
class Marched(Generic[Body]):
    """Where the loops come to: the `state` after so many steps `made`, its `energies`, and the Newton `iterations` of
    all of them."""

    made: int
    state: State[Body]
    energies: Energies
    iterations: int


def covered_scheme(system: System[Body], state: State[Body], dt: float, take: Take[Body]) -> Scheme | None:
    """Return the scheme of steps from a state that the loops cover, None where they do not: the thread and the holes
    that `coupling.solver.covers`, without ties and without hands on holes, by backward Euler, or by BDF2 where it goes
    on with steps of the same length."""
    if not system.compiled or system.ties or system.by_hand.any() or not covers(system):
        return None
    if take is try_step and state.before is None:
        return BackwardEuler(dt)
    return scheme_of(state, dt) if take is bdf2_step and state.dt_before == dt else None


def march(
    system: System[Body],
    state: State[Body],
    energies: Energies,
    dt: float,
    times: Sequence[float],
    take: Take[Body],
    follow: bool = True,
) -> Marched[Body] | None:
    """Make steps of `dt` [s] from a state, whose ends bear the `times` [s], as long as each goes on smoothly; None
    where the first does not, or the loops do not cover it. `follow` is as for `coupling.stepping.advance`.

    The organ is linear, under loads that stay what they are, and without inertia or one that goes on by modes.
    """
    scheme = covered_scheme(system, state, dt, take)
    if scheme is None or not isinstance(system.organ, Steady | Modal):
        return None
    from coupling.course import Course, body_of

    answer = organ_answer(system, scheme, state)
    body = body_of(system, scheme, state, times, answer)
    if body is None:
        return None
    course = Course(system, scheme, state, answer, body)
    course.make_steps(astuple(energies), tabled_ends(system, state.time, times, dt), follow)
    made, iterations = course.made, int(course.iterations.sum())
    if not made:
        return None
    for _ in range(iterations):  # the loops do not ask themselves, and each correction counts
        ask_before_correction()
    new = course.now(times[made - 1])
    if take is bdf2_step:
        before = course.earlier(times[made - 2]) if made > 1 else forgetful(state)
        new = replace(new, before=before, dt_before=dt)
    return Marched(made, new, Energies(*course.energies.tolist()), iterations)


def solution_at(system: System[Body], state: State[Body]) -> Solution[Body]:
    """Return a solution at a state that the loops came to, which keep none, to ask the thread's own motions: of a step
    from there, of any length, since neither its inertia nor its loads count in these."""
    scheme = BackwardEuler(1.0)
    problem = dynamic_problem(system, state, scheme.dt, organ_answer(system, scheme, state), scheme)
    z = Iterate(state.q, state.N, state.s, state.lam, state.y, state.sigma)
    problem = replace(problem, layers=state.layers)
    return Solution(problem, z, evaluate(problem, z), 0)


def tabled_ends(system: System[Body], start: float, times: Sequence[float], dt: float) -> tuple[np.ndarray, ...]:
    """Return what holds and pulls the ends in steps of `dt` [s] from `start` [s] on whose ends bear the `times` [s]:
    places [m] and forces [N] at their ends, and by how much more the forces are at their starts, `(steps, 2, 3)`
    each; places of ends that are free are zero."""
    starts = [start, *times[:-1]]
    places, forces, more = np.zeros((3, len(times), 2, 3))
    for side, end in enumerate(system.ends):
        for step, begun in enumerate(starts):
            place = end.position(begun + dt)
            if place is not None:
                places[step, side] = place
            else:
                forces[step, side] = end.force(begun + dt)
                more[step, side] = end.force(begun) - forces[step, side]
    return places, forces, more
