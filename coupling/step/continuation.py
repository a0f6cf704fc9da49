"""A step whose solution is not near: the thread snaps along itself through a hole.

With ε = 0 the abscissa has no inertia of its own. Where the driving force Φ_sᵀλ loses its zero nearby (a fold: a knot
of the spline, or a bend, passes the hole) the next equilibrium lies a finite way on, and Newton wanders. Then the
thread is held in its holes first, where Newton finds what the rest of the system does. Let go from there, it goes the
way that the driving force leads it, a part of a span at a time and never uphill
(`coupling.kernels.bordered.own_downhill`). Where knots follow the holes it goes as far as on spans that the thread
bends over: on finer ones the force changes over that length, √(EI/T), and steps of a part of a span would not arrive.
Where Newton fails with the thread held, too, it goes downhill from where the motion would have brought it.
"""

from dataclasses import replace

import numpy as np

from coupling.errors import StepError
from coupling.interfaces import Body
from coupling.step.newton import REACH, Iterate, Problem, Solution
from coupling.step.solver import solve
from coupling.step.tension import lengths_bent_over

PATIENCE = 2  # times the corrections of a plain solve: each goes a part of a span


def solve_downhill(problem: Problem[Body], guess: Iterate) -> Solution[Body]:
    """Solve a step by corrections that go downhill along the thread. Raises `StepError`."""
    reach = reach_in_spans(problem, guess)
    try:
        held = solve_held(problem, guess)
        solution = solve(problem, replace(held.iterate, sigma=guess.sigma), reach, PATIENCE)
    except StepError:
        return solve(problem, guess, reach, PATIENCE)
    return replace(solution, iterations=held.iterations + solution.iterations)


def reach_in_spans(problem: Problem[Body], guess: Iterate) -> float:
    """Return how far a correction downhill may move an abscissa, in spans at its hole: REACH of one, or, where those at
    all holes in which the thread may slide are shorter than √(EI/T), REACH of that, at most of the longest span."""
    thread, slides = problem.system.thread, problem.law.may_slide
    if thread.travels:
        return REACH
    spans = np.diff(thread.spline.breaks)
    layers = lengths_bent_over(problem.system, guess.s, guess.N, guess.lam, problem.rows[:, 0])
    ratios = np.minimum(layers, spans.max()) / spans[thread.spline.spans_of(guess.s)]
    return REACH * max(1.0, float(ratios[slides].min()))


def solve_held(problem: Problem[Body], guess: Iterate) -> Solution[Body]:
    """Solve a step with the thread held in its holes, by small turns: knots that came to a bent hole leave it to be
    bent anew, in which Newton turns short spans over. Raises `StepError`."""
    law = replace(problem.law, may_slide=np.zeros_like(problem.law.may_slide))
    return solve(replace(problem, law=law, by_turns=True), replace(guess, s=law.s_held))
