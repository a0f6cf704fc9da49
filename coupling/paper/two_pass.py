"""Friction by the algorithm of §4.3 as written: solve, judge every hole, inject the friction, solve again.

In the first pass, a hole at which the thread's velocity V_t is zero is static and becomes a fixed
point. Other holes are kinetic and slide without friction. Each hole is then judged by the
multipliers of this pass:

    static          |f| < F₀ + μ_s N: it holds, and is a fixed point to the end
    pseudo-static   otherwise: a sliding point with the friction F₀ + μ_s N against the motion that f prevented
    kinetic         a sliding point with the friction F₀ + μ_k N against V_t

The injected friction acts on thread and organ in the second pass. V_t is the velocity of the
material point relative to the hole, −|T| ds/dt at the start of the step (the paper's dP/dt is zero
at a hole at rest). f, N, F₀ are those of the law of sliding; the paper has neither grip nor
channel. The paper's −λ_t/|λ_t| is the pull of the thread on the hole. Here λ is the force of the
hole on the thread, and friction has the sign of the force that held the point.

The friction has a lag: it is that of N of the pass before, and of V_t of the step before. The cone
is therefore violated by O(μ²). A thread that comes to rest overshoots and oscillates until V_t
counts as zero. With more `passes` the holes are judged again after each pass, a friction that would
drive the motion is replaced by a fixed point, and the passes tend to the implicit solution. This
holds for μ_s = μ_k: in the paper a point slides under μ_s for a whole step.
"""

from dataclasses import dataclass, replace

import numpy as np

from coupling.arrays import Array
from coupling.errors import CouplingError
from coupling.integrators import BackwardEuler
from coupling.interfaces import Body
from coupling.kernels.constraints import passage
from coupling.kernels.friction import Law
from coupling.kernels.iteration import FORCE_TOLERANCE
from coupling.step.newton import Iterate, Problem, Solution
from coupling.step.sliding import prescribed, ruled
from coupling.step.solver import find
from coupling.step.stepping import Step, conclude, dynamic_problem, organ_answer, predict
from coupling.system import State, System

PASSES = 2  # those of the paper
STILL = 1e-6  # of the thread's diameter: V_t counts as zero if the thread moves less far in a step


@dataclass(frozen=True)
class Verdict:
    """The judgement of each hole, `(m,)` each.

    `sense` is that of ds/dt which the friction opposes, 0 if the point is held. `mu` [-] is the
    coefficient and `friction` [N] the injected force along t.
    """

    sense: Array
    mu: Array
    friction: Array


def two_pass(system: System[Body], state: State[Body], dt: float, passes: int = PASSES) -> Step[Body]:
    """Return one step of `dt` [s] of backward Euler with friction in at most `passes` passes.

    Raises `StepError`, `InversionError`.
    """
    scheme = BackwardEuler(dt)
    problem = dynamic_problem(system, state, dt, organ_answer(system, scheme, state), scheme)
    solution = solve_passes(problem, predict(problem, state), first_verdict(system, problem.law, state, dt), passes)
    return conclude(state, scheme, solution)


def solve_passes(problem: Problem[Body], guess: Iterate, verdict: Verdict, passes: int) -> Solution[Body]:
    """Solve the passes, which end early if the verdict does not change, and return the last solution.

    Its problem is that of the true law.
    """
    solution = find(with_verdict(problem, verdict), guess)
    iterations = solution.iterations
    for number in range(1, passes):
        new = judge(problem.law, verdict, solution, frictionless=number == 1)
        if is_settled(verdict, new, solution):
            break
        verdict = new
        solution = find(with_verdict(problem, verdict), guess)  # not from the last pass, which may have snapped
        iterations += solution.iterations
    z = replace(solution.iterate, sigma=motion(problem.law, verdict, solution.iterate))
    answered = replace(problem, answer=solution.problem.answer)
    return replace(solution, problem=answered, iterate=z, iterations=iterations)


def with_verdict(problem: Problem[Body], verdict: Verdict) -> Problem[Body]:
    """Return the problem of a pass."""
    law = problem.law
    return replace(problem, law=prescribed(law, law.rough & (verdict.sense == 0.0), verdict.friction))


def first_verdict(system: System[Body], law: Law, state: State[Body], dt: float) -> Verdict:
    """Judge the holes as static or kinetic by the velocity at the start of the step, without an injected force.

    Raises `CouplingError` for a user's law of friction.
    """
    if system.own_friction:
        raise CouplingError("friction: the two passes of §4.3 only have Coulomb's law; solve it in one system")
    T = passage(system.thread.spline, state.q, state.s).T
    V_t = -np.linalg.norm(T, axis=1) * state.s_dot
    moves = law.rough & law.may_slide & (np.abs(V_t) * dt > STILL * system.thread.section.diameter)
    return Verdict(np.where(moves, -np.sign(V_t), 0.0), law.kinetic, np.zeros_like(V_t))


def judge(law: Law, verdict: Verdict, solution: Solution[Body], frictionless: bool) -> Verdict:
    """Judge the holes by the multipliers of a pass.

    After a `frictionless` pass, a motion against V_t is ignored.
    """
    z, at = solution.iterate, solution.residual.passage
    now = ruled(law, z.sigma, at, z.s, z.lam, z.y)
    f, N = now.f, now.N
    held = verdict.sense == 0.0
    loose = held & law.rough & law.may_slide & (np.abs(f - law.barb) >= law.grip + law.static * N)
    driven = (not frictionless) & (verdict.sense * (z.s - law.s_old) < 0.0)
    sense = np.where(loose, np.sign(f), np.where(driven, 0.0, verdict.sense))
    mu = np.where(loose, law.static, verdict.mu)
    return Verdict(sense, mu, sense * (law.grip + mu * N) + np.abs(sense) * law.barb)


def is_settled(old: Verdict, new: Verdict, solution: Solution[Body]) -> bool:
    """Return whether another pass would be the same."""
    change = np.abs(new.friction - old.friction).max(initial=0.0)
    return np.array_equal(old.sense, new.sense) and bool(change <= FORCE_TOLERANCE * solution.residual.force_scale)


def motion(law: Law, verdict: Verdict, z: Iterate) -> Array:
    """Return the sign of ds/dt of the holes with friction, 0 if held; a hole without friction slides."""
    return np.where(law.rough & law.may_slide, np.abs(verdict.sense) * np.sign(z.s - law.s_old), z.sigma)
