"""Whole steps in compiled loops (`coupling.kernels.steps`), many in a call: what they cover and what they leave.

A step that goes on smoothly from the one before is predicted, solved, concluded, looked at and audited in the loops,
and the next one after it. What is out of the ordinary is left to `coupling.step.stepping.advance`, which gives the
same step the same numbers but for round-off: a step that does not converge, a thread that is pressed along itself, a
hole that is left or passed or whose frame turns through itself, stick that becomes slip, a strand that becomes taut
or slack, and a step uphill.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from coupling.arrays import Flags
from coupling.calls import ask_before_correction
from coupling.integrators import BackwardEuler, Scheme
from coupling.interfaces import Body
from coupling.reports.audit import Energies
from coupling.run.tautness import taut_strands
from coupling.step.newton import Iterate, Problem, Solution, evaluate
from coupling.step.solver import covers
from coupling.step.stepping import Step, Take, bdf2_step, dynamic_problem, organ_answer, scheme_of, try_step
from coupling.system import State, System
from thread.placed import Placed

if TYPE_CHECKING:
    from coupling.run.course import Course


def covered_scheme(system: System[Body], state: State[Body], dt: float, take: Take[Body]) -> Scheme | None:
    """Return the scheme of steps from a state that the loops cover, None where they do not: the thread and the holes
    that `coupling.step.solver.covers`, without ties and without hands on holes, in one piece where knots stand still,
    by backward Euler or BDF2."""
    if (
        not system.compiled
        or system.ties
        or system.by_hand.any()
        or (system.thread.spline.cuts.size and not system.thread.travels)
        or not covers(system)
        or not is_on_one_travel(system, state, take)
    ):
        return None
    if take is try_step:
        return BackwardEuler(dt)
    return scheme_of(state, dt) if take is bdf2_step else None


def is_on_one_travel(system: System[Body], state: State[Body], take: Take[Body]) -> bool:
    """Whether a state, and the one that a step looks back at, are on the knots of the system, or moved with them."""
    spline = system.thread.spline
    if not isinstance(spline, Placed):
        return True
    past = [state] if take is not bdf2_step or state.before is None else [state, state.before]
    own = [each.spline for each in past]
    return all(each.solved is None for each in past) and all(
        isinstance(each, Placed) and each.travel.is_like(spline.travel) for each in own
    )


def march(
    system: System[Body],
    state: State[Body],
    energies: Energies,
    dt: float,
    times: Sequence[float],
    take: Take[Body],
    taut: Flags | None = None,
) -> "Course | None":
    """Make steps of `dt` [s] from a state, whose ends bear the `times` [s], as long as each goes on smoothly; None
    where the first does not, or the loops do not cover it. `taut` (k + 1,) says which strands
    are, None that those are whose tension alone says so.

    The organ is linear, under loads that stay what they are, and without inertia or one that goes on by modes.
    """
    scheme = covered_scheme(system, state, dt, take)
    if scheme is None:
        return None
    from coupling.run.course import Course, body_of

    remembers = take is bdf2_step
    if remembers and state.dt_before != dt:
        times = times[:1]  # the next one looks back at another step
    body = body_of(system, scheme, state, times)
    if body is None:
        return None
    course = Course(system, scheme, state, body, taut_strands(system, state) if taut is None else taut, remembers)
    course.make_steps(list(vars(energies).values()), times, tabled_ends(system, state.time, times, dt))
    for _ in range(int(course.iterations.sum())):  # the loops do not ask themselves, and each correction counts
        ask_before_correction()
    return course if course.made else None


def step_between(system: System[Body], old: State[Body], new: State[Body], dt: float, take: Take[Body]) -> Step[Body]:
    """Return the step of `dt` [s] that the loops made from a state to another one, with its solution, which they do not
    keep."""
    scheme = BackwardEuler(dt) if take is try_step else scheme_of(old, dt)
    problem = dynamic_problem(system, old, dt, organ_answer(system, scheme, old), scheme)
    law = problem.law if new.stretch is None else replace(problem.law, stretch=new.stretch)
    problem = replace(problem, law=law)
    solution = solved(problem, new)
    return Step(old, new, dt, solution, solution.residual.configuration)


def solution_at(system: System[Body], state: State[Body]) -> Solution[Body]:
    """Return a solution at a state that the loops came to, which keep none, to ask the thread's own motions: of a step
    from there, of any length, since neither its inertia nor its loads count in these."""
    scheme = BackwardEuler(1.0)
    problem = dynamic_problem(system, state, scheme.dt, organ_answer(system, scheme, state), scheme)
    return solved(problem, state)


def solved(problem: Problem[Body], state: State[Body]) -> Solution[Body]:
    """Return the solution of a problem that a state is."""
    z = Iterate(state.q, state.N, state.s, state.lam, state.y, state.sigma)
    return Solution(problem, z, evaluate(problem, z), 0)


def tabled_ends(system: System[Body], start: float, times: Sequence[float], dt: float) -> tuple[np.ndarray, ...]:
    """Return what holds and pulls the ends in steps of `dt` [s] from `start` [s] on whose ends bear the `times` [s]:
    places [m] and forces [N] at their ends, and by how much more the forces are at their starts, `(steps, 2, 3)`
    each; places of ends that are free are zero."""
    begun = np.array([start, *times[:-1]])
    places, forces, more = np.zeros((3, len(times), 2, 3))
    for side, end in enumerate(system.ends):
        place = end.position(begun + dt)
        if place is not None:
            places[:, side] = place
        else:
            forces[:, side] = end.force(begun + dt)
            more[:, side] = end.force(begun) - forces[:, side]
    return places, forces, more
