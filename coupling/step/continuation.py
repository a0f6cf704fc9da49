"""A step whose solution is not near: the thread snaps along itself through a hole.

With ε = 0 the abscissa has no inertia of its own. Where the driving force Φ_sᵀλ loses its zero nearby (a fold: a knot
of the spline, or a bend, passes the hole) the next equilibrium lies a finite way on, and Newton wanders. Then the
thread is held in its holes first, where Newton finds what the rest of the system does. Let go from there, it goes the
way that the driving force leads it, a part of a span at a time and never uphill
(`coupling.kernels.bordered.own_downhill`). Where Newton fails with the thread held, too, it goes downhill from where
the motion would have brought it.
"""

from dataclasses import replace

import numpy as np

from coupling.errors import StepError
from coupling.interfaces import Body
from coupling.step.newton import REACH, Iterate, Problem, Solution
from coupling.step.solver import solve

PATIENCE = 2  # times the corrections of a plain solve: each goes a part of a span


def solve_downhill(problem: Problem[Body], guess: Iterate) -> Solution[Body]:
    """Solve a step by corrections that go downhill along the thread. Raises `StepError`."""
    try:
        held = solve_held(problem, guess)
        solution = solve(problem, replace(held.iterate, sigma=guess.sigma), REACH, PATIENCE)
    except StepError:
        return solve(problem, guess, REACH, PATIENCE)
    return replace(solution, iterations=held.iterations + solution.iterations)


def solve_held(problem: Problem[Body], guess: Iterate) -> Solution[Body]:
    """Solve a step with the thread held in its holes, by small turns: where it bends at a hole anew, Newton
    turns short spans over. Raises `StepError`."""
    law = replace(problem.law, may_slide=np.zeros_like(problem.law.may_slide))
    return solve(replace(problem, law=law, by_turns=True), replace(guess, s=law.s_held))
