"""A step whose solution is not near: the thread snaps along itself through a hole.

With ε = 0 the abscissa has no inertia of its own. Where the driving force Φ_sᵀλ loses its zero nearby (a fold: a knot
of the spline, or a bend, passes the hole) the next equilibrium lies a finite way on, and Newton wanders. Then the
abscissae are held back by springs, k (s − s_k), whose far ends follow them and which are weakened until they can be
dropped: the driving force leads the thread to its next equilibrium. The accepted answer has no springs.
"""

from dataclasses import replace

import numpy as np

from coupling.errors import StepError
from coupling.interfaces import Body
from coupling.newton import MAX_ITERATIONS, Iterate, Problem, Solution, solve

ATTEMPTS = 40
CORRECTIONS = 250  # of Newton in solves that failed, when one with springs fails: halves of the step are cheaper then
WEAKER, STRONGER = 0.3, 5.0
STIFFEST = 1e2  # of the first spring: the abscissae all but stay, so sliding is not what Newton fails by


def solve_with_springs(problem: Problem[Body], start: Iterate) -> Solution[Body]:
    """Solve a step by springs on the abscissae that are weakened until they can be dropped. Raises `StepError`."""
    thread, law = problem.system.thread, problem.law
    k = first = thread.EA / (thread.spline.end - thread.spline.start)
    z, iterations, spent = replace(start, s=law.s_old), 0, 0
    failed = StepError(problem.time - problem.dt, problem.dt, "the sliding thread found no rest")
    for _ in range(ATTEMPTS):
        held_back = replace(problem, law=replace(law, inertia=law.inertia + k, s_free=spring_ends(problem, z.s, k)))
        try:
            solution = solve(held_back, z)
        except StepError as error:
            failed, k, spent = error, k * STRONGER, spent + MAX_ITERATIONS
            if k > STIFFEST * first or spent > CORRECTIONS:
                break
            continue
        iterations += solution.iterations
        z, k = solution.iterate, k * WEAKER
        if k < 1e-2 * first:
            try:
                free = solve(problem, z)
            except StepError as error:
                failed, spent = error, spent + MAX_ITERATIONS
                continue
            return replace(free, iterations=iterations + free.iterations)
    raise failed


def spring_ends(problem: Problem[Body], s: np.ndarray, k: float) -> np.ndarray:
    """Return where the springs are tied, (m,) [m], so that inertia and spring together pull towards s_free and s in
    their shares."""
    law = problem.law
    return (law.inertia * law.s_free + k * s) / (law.inertia + k)
