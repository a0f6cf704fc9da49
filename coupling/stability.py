"""Whether a thread at rest would stay where it is.

An equilibrium is a stationary point of the potential, and the one that mechanics means a minimum. A thread that is
pressed, turned or loaded across passes points where it buckles or snaps, and Newton's method may go on along equilibria
that do not hold: their residuals are as small. The sign of the potential's second derivative tells them.

It is taken over the motions in which the thread stays in its holes and these where they are, abscissae and organ held:
where it is not positive among them, it is not among all. What falls by sliding or with the tissue alone is not seen.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg.lapack import dpbtrf

from coupling.interfaces import Body
from coupling.newton import add_constraint_stiffness, border_of, evaluate, thread_matrix
from coupling.stepping import Step
from thread.banded import diagonal_of

NEUTRAL = 1e-3  # of the stiffness against the softest bending: a motion against which there is less is a free one
FIRM = 30.0  # times the thread's own stiffness: what holes give way by then is 1e-4 of that stiffness


def would_stay(step: Step[Body]) -> bool:
    """Tell whether the thread resists every motion of its own from the equilibrium at the end of a load step.

    Its stiffness, with holes that hold it more firmly than itself, is then positive but for motions that cost nothing,
    such as the turn of a planar bow about its pinned ends: they are given a little, as a mass-like stiffness.
    """
    solution, thread = step.solution, step.solution.problem.system.thread
    softest = thread.EI * (np.pi / (thread.spline.end - thread.spline.start)) ** 4 / thread.section.rhoA  # pinned beam
    problem = replace(solution.problem, mass_factor=NEUTRAL * softest, q_ref=step.new.q, frame=step.new.frame)
    r = evaluate(problem, solution.iterate)
    band, border = thread_matrix(problem, solution.iterate, r), border_of(problem, solution.iterate, r.passage)
    firm = add_constraint_stiffness(problem, FIRM * band, border, r)[0] - (FIRM - 1.0) * band
    _, info = dpbtrf(problem.system.hold_still(firm)[diagonal_of(firm) :], lower=1)
    return bool(info == 0)
