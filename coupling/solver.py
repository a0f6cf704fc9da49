"""A step solved in numpy (`coupling.newton`), or by compiled loops (`coupling.compiled`) where the system asks for them
and they cover it."""

from functools import partial
from typing import Any

from coupling import newton
from coupling.calls import ask_before_correction
from coupling.configuration import evaluate_thread
from coupling.interfaces import Body
from coupling.newton import Iterate, Problem, Residual, Solution
from coupling.system import System


def solve(problem: Problem[Body], start: Iterate, spans: float = 0.0, patience: int = 1) -> Solution[Body]:
    """Iterate from `start` until every equation holds, and stick and slip, touch and open fit the answer: by compiled
    loops where the system asks for them and they cover the problem and come to its end, else by `coupling.newton`.
    Raises `StepError`.

    No abscissa goes uphill, nor further than so many `spans` in a correction, where they are given; there may be
    `patience` times the corrections of a plain solve."""
    if problem.system.compiled and is_covered(problem):
        ask_before_correction()
        solution = solve_compiled(problem, start, spans, patience)
        if solution is not None:
            for _ in range(solution.iterations - 1):  # the loops do not ask themselves, and each correction counts
                ask_before_correction()
            return solution
    correct = partial(newton.correct_downhill, spans=spans) if spans else newton.correct
    return newton.solve(problem, start, correct, patience)


def are_kept() -> bool:
    """Whether compiled loops are kept on disk, for the next process: there is a folder that one may write, and Numba is
    not switched off."""
    from coupling.tables import folder_of_loops

    return folder_of_loops() is not None


def covers(system: System[Body]) -> bool:
    """Whether the loops know the thread, in one piece with stretch and bending as integrals, and the holes' laws of
    friction, Coulomb's."""
    thread, own = system.thread, any(law is not None for law in system.own_friction)
    return not (thread.twist or thread.coil or thread.springs is not None or thread.spline.cuts.size or own)


def is_covered(problem: Problem[Body]) -> bool:
    """Whether the loops know all of a problem: besides the thread a linear organ none of whose surfaces may touch, and
    holes, but no ties."""
    linear = problem.answer.linear and problem.contact is None
    return linear and not problem.law.strands.size and covers(problem.system)


def solve_compiled(
    problem: Problem[Body], start: Iterate, spans: float = 0.0, patience: int = 1
) -> Solution[Body] | None:
    """Return the solution by the loops; None where they come to none, and numpy is to say why."""
    from coupling.tables import run, tables_of

    iterations, z, found, scale = run(tables_of(problem.system.thread), problem, start, spans, patience)
    if iterations < 0:
        return None
    return Solution(problem, z, residual_of(problem, z, found, scale), iterations)


def residual_of(problem: Problem[Body], z: Iterate, found: Any, scale: float) -> Residual:
    """Return the residual at a solved iterate from the arrays that the loops left. The thread itself is evaluated as a
    run that goes on from there evaluates it, to the same bits."""
    now = evaluate_thread(problem.system, z.q, z.s, problem.frame, problem.law.s_old, problem.layers)
    return Residual(now, found.f_y, found.push, found.balance, found.holds, found.site, scale)
