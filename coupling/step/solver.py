"""The solution of a step, by compiled loops or by the same kernels called from Python.

The compiled iteration (`coupling.kernels.iteration`) is used if the system asks for it and it
covers the problem; otherwise `coupling.step.newton` is used.
"""

import logging
from dataclasses import replace

import numpy as np

from coupling.calls import ask_before_correction
from coupling.errors import StepError
from coupling.interfaces import Body, Certified
from coupling.kernels import iteration
from coupling.kernels.bordered import SINGULAR_HOLDS, SINGULAR_THREAD
from coupling.step import newton, tables
from coupling.step.descent import PATIENCE, descend
from coupling.step.newton import Iterate, Problem, Solution
from coupling.system import System
from thread.errors import ThreadError

log = logging.getLogger(__name__)


def find(
    problem: Problem[Body],
    guess: Iterate,
    begin: Iterate | None = None,
    patience: int = 0,
    far: bool = False,
) -> Solution[Body]:
    """Solve a problem close to a guess, or downhill if Newton's method does not converge from there.

    The way downhill starts at `begin`; None means the guess (`coupling.step.descent`). `patience`
    is the allowed number of its corrections, in those of a plain solve; 0 means PATIENCE. Raises
    `StepError`.

    In loops Newton's method is also tried from `begin`. If it fails there too, and the motion of the
    step is `far`, there is no way downhill: where a thread is thrown, half steps by the loops took
    down to a fifth of the time of ways downhill.
    """
    try:
        return solve(problem, guess)
    except StepError as error:
        log.debug("no solution close to the guess: %s", error)
    if begin is not None and is_compiled(problem):
        try:
            return solve(problem, begin)
        except StepError:
            if far:
                raise
    return solve(problem, guess if begin is None else begin, patience or PATIENCE)


def solve(problem: Problem[Body], start: Iterate, downhill: int = 0) -> Solution[Body]:
    """Iterate from `start` until every equation holds, and stick and slip, contact and opening fit
    the solution.

    If `downhill` is not zero, the step is solved by `coupling.step.descent`, with `downhill` times
    the corrections. Raises `StepError`.

    The answer of an organ in a smaller space may not be accurate under the forces found. The step
    is then solved again with an accurate answer, from the same start: a step can have several
    solutions, and the solution with the first answer may be close to another one. If no solution is
    found, the step is solved again with the answer that is accurate under all forces.
    """
    try:
        solution = solve_once(problem, start, downhill)
    except StepError:
        faithful = problem.answer.faithful() if isinstance(problem.answer, Certified) else problem.answer
        if faithful is problem.answer:
            raise
        return solve(replace(problem, answer=faithful), start, downhill)
    answer = solution.problem.answer
    if not isinstance(answer, Certified):
        return solution
    sites = len(problem.system.piercings)
    certified = answer.certified(solution.residual.f_y[:sites].ravel())
    if certified is answer:
        return solution
    again = solve(replace(problem, answer=certified), start, downhill)
    return replace(again, iterations=solution.iterations + again.iterations)


def solve_once(problem: Problem[Body], start: Iterate, downhill: int) -> Solution[Body]:
    """Solve with the organ's answer as given, as described in `solve`. Raises `StepError`."""
    if downhill:
        return descend(problem, start, downhill)
    if not is_compiled(problem):
        return newton.solve(problem, start)
    try:
        return solve_compiled(problem, start)
    except ThreadError as error:
        raise StepError(problem.time - problem.dt, problem.dt, str(error)) from error


def is_compiled(problem: Problem[Body]) -> bool:
    """Return whether the compiled loops solve a problem."""
    system = problem.system
    return (system.compiled or system.thread.travels) and is_covered(problem)


def covers(system: System[Body]) -> bool:
    """Return whether the kernels cover the thread and the friction of the holes.

    The thread has stretch and bending as integrals, and the friction is Coulomb's.
    """
    thread = system.thread
    plain = not (thread.twist or thread.coil or thread.springs is not None or thread.relaxation is not None)
    return plain and not (system.own_friction or system.bears)


def is_covered(problem: Problem[Body]) -> bool:
    """Return whether the kernels cover the whole problem: the system, and a linear organ without contact."""
    return problem.answer.linear and problem.contact is None and covers(problem.system)


def solve_compiled(problem: Problem[Body], start: Iterate) -> Solution[Body]:
    """Solve by the loops, as described in `solve`. Raises the `StepError` of `coupling.step.newton`."""
    ask_before_correction()
    ended = tables.run(problem, start)
    for _ in range(ended.corrections - 1):  # each correction counts, and the loops do not ask
        ask_before_correction()
    if ended.how == iteration.SOLVED:
        return Solution(problem, ended.z, newton.evaluate(problem, ended.z), ended.corrections)
    raise newton.failure(problem, ended.found.holds, cause_of(ended))


def cause_of(ended: tables.Ended) -> str:
    """Return why the loops found no solution, in the words of `coupling.step.newton`."""
    causes = {
        iteration.SINGULAR_THREAD: SINGULAR_THREAD,
        iteration.SINGULAR_HOLDS: SINGULAR_HOLDS,
        iteration.NOT_CONVERGED: newton.too_many(newton.MAX_ITERATIONS),
        iteration.ALTERNATES: newton.STICK_OR_SLIP,
    }
    if not np.isfinite(ended.found.balance).all():  # a matrix with nan may look singular
        return newton.RAN_AWAY
    return causes.get(ended.how, newton.RAN_AWAY)
