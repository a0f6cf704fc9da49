"""The stability of the thread in a solution of Newton's method, and a way off an unstable solution.

An equilibrium, and likewise an implicit step, is a stationary point of a potential, and the correct
one is a minimum. A thread under compression, torsion or a transverse load passes points at which it
buckles or snaps, and Newton's method may then follow unstable stationary points, with residuals
that are as small. The sign of the second derivative of the potential distinguishes them.

The second derivative is taken over the motions in which the thread stays in its holes, with
constant abscissae and a fixed organ. If it is not positive in these motions, it is not positive in
all. Instabilities by sliding, or of the tissue alone, are not detected.

A step in time ends at such a point if the motion away from it is faster than the step can resolve:
backward Euler damps a motion that grows by more than e² in a step. A straight strand that is pushed
from one end would remain straight and be compressed. It is moved aside at this point, and goes
downhill to the next minimum (`coupling.step.descent`).
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

NEUTRAL = 1e-3  # of the softest bending stiffness, or of the inertia: stiffness added for motions without energy change
FIRM = 30.0  # times the thread's own stiffness: the compliance of the holes then changes that stiffness by 1e-4
ASIDE = (0.36, 0.48, 0.8)  # direction of a thread that can go in any direction; it is along no axis
BENT = 1e-6  # of the distance of control points: an existing bow with a larger deflection grows
MANY = 1500  # coordinates of control points: dense second derivatives of more coordinates take minutes


def would_stay(solution: Solution[Body], new: State[Body]) -> bool:
    """Return whether the thread is stable against its own motions in an equilibrium, with its state
    `new` there.
    """
    # The small stiffness stabilises motions without a change of energy, such as a planar bow about its pinned ends.
    thread, z = solution.problem.system.thread, solution.iterate
    problem = replace(solution.problem, mass_factor=NEUTRAL * softest(thread), q_ref=z.q, frame=new.frame)
    return resists(problem, z, evaluate(problem, z))


def softest(thread: Thread) -> float:
    """Return the stiffness against the softest bending, that of a pinned beam, as a mass factor [1/s²]."""
    return float(thread.EI * (np.pi / (thread.spline.end - thread.spline.start)) ** 4 / thread.section.rhoA)


def costs_nothing(problem: Problem[Body], force: float, way: Array) -> bool:
    """Return whether a thread in one piece without sliding moved along motions without a change of energy.

    It has gone a `way` (n, c) under a `force` [N]. Against its softest bending, the force would
    have been larger.
    """
    system = problem.system
    if (problem.law.may_slide & problem.rows[:, 0]).any() or system.thread.spline.cuts.size:
        return False
    return bool(force < NEUTRAL * softest(system.thread) * np.abs(system.thread.momentum(way)[:, :3]).max())


def resists(problem: Problem[Body], z: Iterate, r: Residual) -> bool:
    """Return whether the potential of a problem has a minimum in the thread's own motions at a solution.

    The holes are given a higher stiffness than the thread itself.
    """
    band, border = thread_matrix(problem, z, r), border_of(problem, z, r.passage)
    firm = add_constraint_stiffness(problem, FIRM * band, border, r)[0] - (FIRM - 1.0) * band
    _, info = dpbtrf(problem.system.hold_still(firm)[diagonal_of(firm) :], lower=1)
    return bool(info == 0)


def holds(solution: Solution[Body]) -> bool:
    """Return whether the thread is stable against its own motions in the solution of a step in time.

    A bow of a straight thread can rotate about its ends with its inertia as the only resistance; a
    small mass is added for it.
    """
    problem = replace(solution.problem, mass_factor=(1.0 + NEUTRAL) * solution.problem.mass_factor)
    return resists(problem, solution.iterate, solution.residual)


def is_squeezed(solution: Solution[Body], mass_factor: float = 0.0) -> bool:
    """Return whether a solution may be unstable: the thread is twisted, or a strand is under compression.

    The compression is above `borne_pressure`, with the `mass_factor` of the time scheme [1/s²],
    zero at rest.
    """
    problem, z = solution.problem, solution.iterate
    thread = problem.system.thread
    if not thread.EI:
        return False
    strain, borne = solution.residual.configuration.points.strain, borne_pressure(thread, mass_factor) / thread.EA
    if thread.twist or strain.min() >= -borne:
        return thread.twist
    return is_pressed(problem.system, z.s, strain, borne, problem.rows[:, 0])


def borne_pressure(thread: Thread, mass_factor: float) -> float:
    """Return the compression [N] that a thread of any length bears by its bending and its inertia;
    inf without bending.

    A wave of number k is resisted by EI k⁴ + ϱA a and driven by F k², with the `mass_factor` a of
    the time scheme [1/s²]. For F below 2 √(EI ϱA a) every wave is stable (a column on an elastic
    foundation; Timoshenko and Gere, Theory of Elastic Stability, 1961, §2.10). At rest this holds
    below π² EI/4L².
    """
    if not thread.EI:
        return np.inf
    by_inertia = 2.0 * np.sqrt(thread.EI * thread.section.rhoA * mass_factor)
    return float(max(by_inertia, 0.25 * np.pi**2 * thread.force_unit))


def go_aside(solution: Solution[Body]) -> Solution[Body]:
    """Return a stable solution of a step: the same one, or one downhill of it if the thread would buckle.

    Raises `StepError` if none is found.
    """
    problem, z = solution.problem, solution.iterate
    if not is_squeezed(solution, problem.mass_factor) or holds(solution):
        return solution
    found = solve(problem, aside(problem, z), BOWING)
    if not holds(found):
        cause = "the thread is under compression and would buckle, and no stable solution was found"
        raise nowhere(problem, cause)
    return replace(found, iterations=solution.iterations + found.iterations)


def nowhere(problem: Problem[Body], cause: str) -> StepError:
    """Return the error of a step without a way off its solution."""
    return StepError(problem.time - problem.dt, problem.dt, cause)


def aside(problem: Problem[Body], z: Iterate) -> Iterate:
    """Return an unstable solution moved off the saddle by at most a diameter: the start of the way downhill.

    Raises `StepError` for a thread of more than MANY coordinates.
    """
    if z.q.size > MANY:
        cause = f"the thread buckles; a way off is sought only with at most {MANY} coordinates of control points"
        raise nowhere(problem, cause)
    return replace(z, q=z.q + outset(problem, z))


def own_motions(problem: Problem[Body], z: Iterate) -> Array:
    """Return an orthonormal basis of the motions with constant holders, abscissae and organ, shape `(c n, k)`."""
    system, (n, c) = problem.system, z.q.shape
    at = system.passage(z.q, z.s)
    Phi_q = border_of(problem, z, at).Phi_q[:, :, :, None]
    V = columns(at, n, c).T.reshape(len(at.first), 1, NINE, c * n)
    rows = np.concatenate([np.eye(c * n)[system.held], (Phi_q * V).sum(axis=2)[problem.rows]])
    return np.asarray(qr(rows.T)[0][:, len(rows) :])


def outset(problem: Problem[Body], z: Iterate) -> Array:
    """Return the motion of the thread off a saddle, shape `(n, c)`.

    It is a combination of the unstable motions: that of the existing bow, or one aside for a
    straight thread. Its largest displacement is one diameter. Raises `StepError` if there is no
    unstable motion.
    """
    thread, q, free = problem.system.thread.placed(z.s), z.q, own_motions(problem, z)
    points = thread.points(q, problem.frame)
    band = thread.tangent(points, thread.EA * points.strain) + problem.mass_factor * thread.mass_band
    h, size = half_band_of(band), band.shape[1]
    matrix = dia_array((band[h:], np.arange(h, -h - 1, -1)), shape=(size, size)).tocsr()
    sizes, axes = np.linalg.eigh(free.T @ (matrix @ free))
    yielding = free @ axes[:, sizes < 0.0]
    if not yielding.size:
        cause = "the thread is at the limit of stability, and no unstable motion was found"
        raise nowhere(problem, cause)
    bow, any_way = np.zeros_like(q), np.zeros_like(q)
    bow[1:-1, :3] = np.diff(q[:, :3], 2, axis=0)
    any_way[:, :3] = np.linspace(1.0, 2.0, len(q))[:, None] * ASIDE
    grown, other = ((yielding @ (yielding.T @ one.ravel())).reshape(q.shape) for one in (bow, any_way))
    spacing = np.linalg.norm(np.diff(q[:, :3], axis=0), axis=1).mean()
    way = grown if np.abs(grown).max() > BENT * spacing else other
    return np.asarray(thread.section.diameter / np.abs(way[:, :3]).max() * way)
