"""Whether a thread resists every motion from a solution that Newton's method found, and where it goes if not.

An equilibrium, and an implicit step likewise, is a stationary point of a potential, and the one that mechanics means a
minimum. A thread that is pressed, turned or loaded across passes points where it buckles or snaps, and Newton's method
may go on along stationary points that do not hold: their residuals are as small. The sign of the potential's second
derivative tells them.

It is taken over the motions in which the thread stays in its holes and these where they are, abscissae and organ held:
where it is not positive among them, it is not among all. What falls by sliding or with the tissue alone is not seen.

A step in time ends at such a point where the motion away from it is faster than the step sees: one that grows by more
than e² in a step is damped by backward Euler. A straight strand that is pushed from one end would stay straight and be
squeezed. It is moved aside there, and goes downhill to the next minimum (`coupling.step.descent`).
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import qr
from scipy.linalg.lapack import dpbtrf
from scipy.sparse import dia_array

from coupling.arrays import Array
from coupling.errors import StepError
from coupling.interfaces import Body
from coupling.kernels.border import NINE
from coupling.kernels.bordered import columns
from coupling.step.descent import BOWING
from coupling.step.newton import (
    Iterate,
    Problem,
    Residual,
    Solution,
    add_constraint_stiffness,
    border_of,
    evaluate,
    thread_matrix,
)
from coupling.step.solver import solve
from coupling.step.tension import is_pressed
from coupling.system import State
from thread.banded import diagonal_of, half_band_of
from thread.thread import Thread

NEUTRAL = 1e-3  # of the stiffness against the softest bending, or of inertia: what a motion that costs nothing is given
FIRM = 30.0  # times the thread's own stiffness: what holes give way by then is 1e-4 of that stiffness
ASIDE = (0.36, 0.48, 0.8)  # where a thread goes that might go any way: along no axis
BENT = 1e-6  # of the distance of control points, by which they lie aside of one another: a bow that there is grows
MANY = 1500  # coordinates of control points: the second derivatives of more, in full, take minutes


def would_stay(solution: Solution[Body], new: State[Body]) -> bool:
    """Tell whether the thread resists every motion of its own from an equilibrium, with its state there."""
    problem = replace(given_a_little(solution), frame=new.frame)
    return resists(problem, solution.iterate, evaluate(problem, solution.iterate))


def given_a_little(solution: Solution[Body]) -> Problem[Body]:
    """Return the problem of an equilibrium in which motions that cost nothing, such as the turn of a planar bow about
    its pinned ends, are given a little stiffness, as a mass."""
    return replace(
        solution.problem, mass_factor=NEUTRAL * softest(solution.problem.system.thread), q_ref=solution.iterate.q
    )


def softest(thread: Thread) -> float:
    """Return the stiffness against the softest bending, that of a pinned beam, as a mass factor [1/s²]."""
    return float(thread.EI * (np.pi / (thread.spline.end - thread.spline.start)) ** 4 / thread.section.rhoA)


def costs_nothing(problem: Problem[Body], force: float, way: Array) -> bool:
    """Tell whether a thread in one piece that does not slide has gone a `way` (n, c) under a `force` [N] along motions
    that cost nothing: against its softest bending it would have taken more."""
    system = problem.system
    if (problem.law.may_slide & problem.rows[:, 0]).any() or system.thread.spline.cuts.size:
        return False
    return bool(force < NEUTRAL * softest(system.thread) * np.abs(system.thread.momentum(way)[:, :3]).max())


def resists(problem: Problem[Body], z: Iterate, r: Residual) -> bool:
    """Tell whether the potential of a problem has a minimum in the thread's own motions at a solution.

    The holes hold the thread more firmly there than it holds itself.
    """
    band, border = thread_matrix(problem, z, r), border_of(problem, z, r.passage)
    firm = add_constraint_stiffness(problem, FIRM * band, border, r)[0] - (FIRM - 1.0) * band
    _, info = dpbtrf(problem.system.hold_still(firm)[diagonal_of(firm) :], lower=1)
    return bool(info == 0)


def holds(solution: Solution[Body]) -> bool:
    """Tell whether the thread resists every motion of its own from the solution of a step in time. A bow of a straight
    thread may turn about its ends by inertia alone, which is given a little more."""
    problem = replace(solution.problem, mass_factor=(1.0 + NEUTRAL) * solution.problem.mass_factor)
    return resists(problem, solution.iterate, solution.residual)


def is_squeezed(solution: Solution[Body], mass_factor: float = 0.0) -> bool:
    """Tell whether a solution may be one that the thread does not resist: it is twisted, or a strand of it is pressed
    along itself by more than `borne_pressure`, with the `mass_factor` of the time scheme [1/s²], none at rest."""
    problem, z = solution.problem, solution.iterate
    thread = problem.system.thread
    if not thread.EI:
        return False
    strain, borne = solution.residual.configuration.points.strain, borne_pressure(thread, mass_factor) / thread.EA
    if thread.twist or strain.min() >= -borne:
        return thread.twist
    return is_pressed(problem.system, z.s, strain, borne, problem.rows[:, 0])


def borne_pressure(thread: Thread, mass_factor: float) -> float:
    """Return the force along itself that the longest thread bears by its bending and its inertia [N], any where it does
    not bend.

    A wave of number k is held by EI k⁴ + ϱA a and driven by F k², with a the `mass_factor` of the time scheme [1/s²]:
    for F below 2 √(EI ϱA a) there is none that is not held (a column on an elastic foundation; Timoshenko and Gere,
    Theory of Elastic Stability, 1961, §2.10), nor at rest below π² EI/4L².
    """
    if not thread.EI:
        return np.inf
    by_inertia = 2.0 * np.sqrt(thread.EI * thread.section.rhoA * mass_factor)
    return float(max(by_inertia, 0.25 * np.pi**2 * thread.force_unit))


def go_aside(solution: Solution[Body]) -> Solution[Body]:
    """Return the solution of a step that the thread resists: the same, or one downhill of it where the thread would
    buckle. Raises `StepError` where none is found."""
    problem, z = solution.problem, solution.iterate
    if not is_squeezed(solution, problem.mass_factor) or holds(solution):
        return solution
    found = solve(problem, aside(problem, z), BOWING)
    if not holds(found):
        cause = "the thread is pressed along itself where it would buckle, and no way aside was found"
        raise nowhere(problem, cause)
    return replace(found, iterations=solution.iterations + found.iterations)


def nowhere(problem: Problem[Body], cause: str) -> StepError:
    """Return the error of a step from whose solution no way aside was found."""
    return StepError(problem.time - problem.dt, problem.dt, cause)


def aside(problem: Problem[Body], z: Iterate) -> Iterate:
    """Return a solution that the thread does not resist, moved off the saddle by a diameter at most: the way downhill
    begins there. Raises `StepError` for a thread of more than MANY coordinates."""
    if z.q.size > MANY:
        cause = f"the thread buckles, and has more than {MANY} coordinates of control points to seek the way aside in"
        raise nowhere(problem, cause)
    return replace(z, q=z.q + outset(problem, z))


def own_motions(problem: Problem[Body], z: Iterate) -> Array:
    """Return an orthonormal basis of the motions in which what holds the thread, its abscissae and the organ rest,
    shape `(c n, k)`."""
    system, (n, c) = problem.system, z.q.shape
    at = system.passage(z.q, z.s)
    Phi_q = border_of(problem, z, at).Phi_q[:, :, :, None]
    V = columns(at, n, c).T.reshape(len(at.first), 1, NINE, c * n)
    rows = np.concatenate([np.eye(c * n)[system.held], (Phi_q * V).sum(axis=2)[problem.rows]])
    return np.asarray(qr(rows.T)[0][:, len(rows) :])


def outset(problem: Problem[Body], z: Iterate) -> Array:
    """Return the motion with which the thread goes off a saddle, shape `(n, c)`: of those that it does not resist the
    one of the bow that there is, of a straight thread one aside, the furthest point by a diameter. Raises `StepError`
    where it resists all."""
    thread, q, free = problem.system.thread.placed(z.s), z.q, own_motions(problem, z)
    points = thread.points(q, problem.frame)
    band = thread.tangent(points, thread.EA * points.strain) + problem.mass_factor * thread.mass_band
    h, size = half_band_of(band), band.shape[1]
    matrix = dia_array((band[h:], np.arange(h, -h - 1, -1)), shape=(size, size)).tocsr()
    sizes, axes = np.linalg.eigh(free.T @ (matrix @ free))
    yielding = free @ axes[:, sizes < 0.0]
    if not yielding.size:
        cause = "the thread hardly resists what moves it, and no way is found in which it gives way"
        raise nowhere(problem, cause)
    bow, any_way = np.zeros_like(q), np.zeros_like(q)
    bow[1:-1, :3] = np.diff(q[:, :3], 2, axis=0)
    any_way[:, :3] = np.linspace(1.0, 2.0, len(q))[:, None] * ASIDE
    grown, other = ((yielding @ (yielding.T @ one.ravel())).reshape(q.shape) for one in (bow, any_way))
    spacing = np.linalg.norm(np.diff(q[:, :3], axis=0), axis=1).mean()
    way = grown if np.abs(grown).max() > BENT * spacing else other
    return np.asarray(thread.section.diameter / np.abs(way[:, :3]).max() * way)
