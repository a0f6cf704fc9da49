"""Whole steps in compiled loops (`coupling.kernels.steps`), many in one call: the covered cases and the others.

A step that continues the motion smoothly is predicted, solved, concluded, checked and audited in
the loops, and then the next one. Unusual steps are left to `coupling.step.stepping.advance`, which
gives the same numbers for the same step, except for round-off. These steps are unusual:

- a step that does not converge, or goes uphill;
- a thread under compression;
- a hole that is left, that is passed by another one, or whose frame flips;
- a hold that changes from stick to slip;
- a strand that becomes taut or slack.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coupling.arrays import Flags
from coupling.calls import ask_before_correction
from coupling.integrators import BackwardEuler, Scheme
from coupling.interfaces import Body
from coupling.reports.audit import Energies
from coupling.run.course import Course, body_of
from coupling.run.tautness import taut_strands
from coupling.step.newton import Iterate, Problem, Solution, evaluate
from coupling.step.solver import covers
from coupling.step.stepping import Step, Take, bdf2_step, dynamic_problem, organ_answer, scheme_of, try_step
from coupling.system import State, System
from thread.placed import Placed


def covered_scheme(system: System[Body], state: State[Body], dt: float, take: Take[Body]) -> Scheme | None:
    """Return the scheme of steps from a state that the loops cover; None if they do not.

    They cover the thread and the holes of `coupling.step.solver.covers`, without ties and without
    hands at holes, by backward Euler or BDF2. If knots do not travel, the thread must be in one
    piece.
    """
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
    """Return whether the states of a step are on the knots of the system, or on knots with the same travel.

    The states are the present one and the earlier one that the step uses.
    """
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
) -> Course | None:
    """Make smooth steps of `dt` [s] from a state, whose ends are at the `times` [s].

    None if the first step is not smooth, or if the loops do not cover it. `taut` (k + 1,) are the
    taut strands; None means the strands that are taut by their tension alone. The organ is linear,
    under constant loads, and without inertia or in modes.
    """
    scheme = covered_scheme(system, state, dt, take)
    if scheme is None:
        return None
    remembers = take is bdf2_step
    if remembers and state.dt_before != dt:
        times = times[:1]  # the next step uses an earlier step of another size
    body = body_of(system, scheme, state, times)
    if body is None:
        return None
    course = Course(system, scheme, state, body, taut_strands(system, state) if taut is None else taut, remembers)
    course.make_steps(list(vars(energies).values()), times, tabled_ends(system, state.time, times, dt))
    for _ in range(int(course.iterations.sum())):  # each correction counts, and the loops do not ask
        ask_before_correction()
    return course if course.made else None


def step_between(system: System[Body], old: State[Body], new: State[Body], dt: float, take: Take[Body]) -> Step[Body]:
    """Return the step of `dt` [s] that the loops made between two states, with its solution.

    The loops do not store solutions.
    """
    scheme = BackwardEuler(dt) if take is try_step else scheme_of(old, dt)
    problem = dynamic_problem(system, old, dt, organ_answer(system, scheme, old), scheme)
    law = problem.law if new.stretch is None else problem.law._replace(stretch=new.stretch)
    problem = replace(problem, law=law)
    solution = solved(problem, new)
    return Step(old, new, dt, solution, solution.residual.configuration)


def solution_at(system: System[Body], state: State[Body]) -> Solution[Body]:
    """Return a solution at a state reached by the loops, for the check of the thread's own motions.

    The loops do not store solutions. The solution is that of a step from this state, of any length,
    because neither its inertia nor its loads matter in the check.
    """
    scheme = BackwardEuler(1.0)
    problem = dynamic_problem(system, state, scheme.dt, organ_answer(system, scheme, state), scheme)
    return solved(problem, state)


def solved(problem: Problem[Body], state: State[Body]) -> Solution[Body]:
    """Return the solution of a problem at a state that solves it."""
    z = Iterate(state.q, state.N, state.s, state.lam, state.y, state.sigma)
    return Solution(problem, z, evaluate(problem, z), 0)


def tabled_ends(system: System[Body], start: float, times: Sequence[float], dt: float) -> tuple[np.ndarray, ...]:
    """Return the positions and loads of the ends in steps of `dt` [s] from `start` [s] on, `(steps,
    2, 3)` each.

    The ends of the steps are at the `times` [s]. The arrays are the places [m] and forces [N] at
    the ends of the steps, and the excess of the forces at their starts. Places of ends that are
    free are zero.
    """
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
