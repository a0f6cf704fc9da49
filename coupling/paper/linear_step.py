"""The paper's own step (§4.1): accelerations, one linear solve, and the constraints as differential equations.

The unknowns are the accelerations a of the control points, s̈ of the abscissae, and the
multipliers. The organ is condensed exactly to its nine numbers, y⁺ = y_free + C Φ_yᵀλ with ÿ = (y⁺
− y − Δt ẏ)/Δt². Implicit Euler: v⁺ = v + Δt a and q⁺ = q + Δt v⁺; the same for s.

    | A    0    −Φ_qᵀ          |  a      A = (1 + Δt d) M + Δt² ∂²E/∂q², d the thread's damping
    | 0    ε    −Φ_sᵀ          |  s̈      eq. 7; eq. 6 at ε = 0
    | Φ_q  Φ_s  Φ_y C Φ_yᵀ/Δt² |  λ      Φ̈ + (2/τ) Φ̇ + (1/τ²) Φ = 0 (eq. 5), τ = Δt

All terms are linearised at the start of the step. The elastic force is E'(q⁺) ≈ E'(q) + E''(q)(q⁺ −
q) with the exact tangent (stretch EA ε, geometric and bending part). Without it the speed of sound
in a real suture, 2 km/s, would limit the step to 10⁻⁶ s. The directions Φ_q, Φ_s, Φ_y of the
constraint forces are those of the start, as in the paper (no derivative of λ·Φ). Φ̈ = Φ_q a + Φ_s
s̈ + Φ_y ÿ + w contains all velocity terms w, at the start.

A step is refused, and thus halved, if the thread at its end is further than its diameter from its
linearised place in a hole. The paper has no such test; a light thread that snaps needs it. The
paper has no test of energy either. A scenario uses the step `checked`, which ends the run if the
step creates a tenth of the available energy.

The time at which Φ and Φ̇ of eq. 5 are taken decides on stability. At the end of the step, with Φ̇⁺
= Φ̇ + ΔtΦ̈ and Φ⁺ = Φ + ΔtΦ̇⁺, the map of (Φ, ΔtΦ̇) has the double root 1/(1 + Δt/τ) = ½: a
violation decays for every Δt. At the start, as eq. 5 is written, the roots with implicit Euler are
(−1 ± √5)/2: the violation grows by 1.618 per step. The second variant is here for studies.

Friction is not part of the linear system. The paper's algorithm is two passes of it (§4.3),
`linear_two_pass`.

Motion leaves a violation of order Δt² w, as in every step with the constraint at acceleration
level.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Generic, Literal

import numpy as np
from scipy.linalg.blas import dgbmv

from coupling.arrays import Array, Flags
from coupling.errors import CouplingError, CreatedEnergyError, StepError
from coupling.integrators import BackwardEuler
from coupling.interfaces import Body
from coupling.joins.contact import NO_FORCES
from coupling.kernels.border import NINE, Border
from coupling.kernels.bordered import PHI, S, SingularError, newton_directions, values_at_holds
from coupling.kernels.constraints import Passage, passage, phi, site_force, spread, thread_force
from coupling.kernels.friction import Law
from coupling.kernels.iteration import ROUND_OFF
from coupling.paper.two_pass import PASSES, Verdict, first_verdict, is_settled, judge, motion
from coupling.reports.audit import audit_step, initial_energies
from coupling.step.configuration import Configuration
from coupling.step.newton import Iterate, Problem, Residual, Solution, border_of, failure
from coupling.step.sliding import law_of, prescribed
from coupling.step.stepping import Step, Take, dynamic_problem, organ_answer, reactions, with_ends, with_sense
from coupling.system import State, System, forgetful
from thread.banded import half_band_of
from thread.thread import Points
from thread.vectors import dot

Evaluation = Literal["end", "start"]
TRUST = 1.0  # diameters: largest error of the linearised P(s) − x at the end of a step
CREATED = 0.1  # of the available energy and the work of a step: below 0.006 in good runs, above 0.8 in bad ones
ACCURACY = 1e-8  # residual of the linear system over its largest term; a less accurate solution is refused


# -- the constraints as functions of time ------------------------------------------------------------------------------


def phi_rate(at: Passage, rate: Passage, y: Array, s_dot: Array, y_dot: Array) -> Array:
    """Return Φ̇ = Φ_q q̇ + Φ_s ṡ + Φ_y ẏ, shape `(m, 5)` [m/s, 1/s]; `rate` is the passage of q̇."""
    out = np.empty((len(y), 5))
    T_dot = rate.T + s_dot[:, None] * at.K
    out[:, :3] = rate.P + s_dot[:, None] * at.T - y_dot[:, :3]
    for k, (w, w_dot) in enumerate(frames(y, y_dot)):
        out[:, 3 + k] = dot(T_dot, w) + dot(at.T, w_dot)
    return out


def velocity_terms(at: Passage, rate: Passage, y: Array, s_dot: Array, y_dot: Array) -> Array:
    """Return w = Φ̈ without accelerations, shape `(m, 5)` [m/s², 1/s²].

    g: 2 b'q̇ ṡ + T' ṡ²;   c₁: 2 (b'q̇)·u̇ + 2ṡ (b''q̇)·u + 2ṡ T'·u̇ + ṡ² T''·u;   c₂ with v for u.
    """
    out, ds = np.empty((len(y), 5)), s_dot[:, None]
    out[:, :3] = 2.0 * ds * rate.T + ds**2 * at.K
    for k, (w, w_dot) in enumerate(frames(y, y_dot)):
        out[:, 3 + k] = dot(2.0 * ds * rate.K + ds**2 * at.J, w) + 2.0 * dot(rate.T + ds * at.K, w_dot)
    return out


def frames(y: Array, y_dot: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return (u, u̇) and (v, v̇), each `(m, 3)`."""
    return (y[:, 3:6], y_dot[:, 3:6]), (y[:, 6:], y_dot[:, 6:])


def restoring_acceleration(violation: Array, rate: Array, dt: float, evaluation: Evaluation) -> Array:
    """Return Φ̈ of eq. 5 at τ = Δt, from Φ and Φ̇ at the start of the step.

    "end": Φ̈ + (2/Δt)(Φ̇ + ΔtΦ̈) + (Φ + ΔtΦ̇ + Δt²Φ̈)/Δt² = 0. "start": the literal eq. 5,
    unstable.
    """
    if evaluation == "start":
        return -2.0 / dt * rate - violation / dt**2
    return -0.25 * (3.0 / dt * rate + violation / dt**2)


# -- the linear system of a step ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Posed(Generic[Body]):
    """The linear system of one step, in the increments of position Δt² a and Δt² s̈, from a guess
    without forces.

    - `problem`: the implicit step that is linearised, without friction.
    - `at`, `points`: holds and curve at the start.
    - `tangent`: banded [N/m].
    - `guess`: the step without forces; `r_q` (n, c) [N] and `r` (m, 6) are the residuals there.
    - `phi` (m, 5): Φ at the end by the linearisation.
    - `border`: rows and columns of the holds.
    """

    problem: Problem[Body]
    state: State[Body]
    at: Passage
    points: Points
    tangent: Array
    guess: Iterate
    r_q: Array
    r: Array
    phi: Array
    border: Border

    def band(self) -> Array:
        """Return A/Δt², banded [N/m], with the prescribed unknowns held; a new array."""
        return self.problem.system.hold_still(self.problem.inertia + self.tangent)


def pose(system: System[Body], state: State[Body], dt: float, evaluation: Evaluation = "end") -> Posed[Body]:
    """Return the linear system of a step of `dt` [s] through holes without friction, with one
    back-substitution of the organ.

    Raises `CouplingError` for an organ whose lips may touch, and for a thread that is drawn by
    hand.
    """
    if system.organ.lips(state.organ)[0].size:
        raise CouplingError("the linear step has no contact of lips; use Newton's scheme, or leave out contact")
    if system.by_hand.any():
        raise CouplingError("the linear step draws no thread by hand; use Newton's scheme, or leave out draw and pull")
    scheme, thread = BackwardEuler(dt), system.thread
    problem = dynamic_problem(system, state, dt, organ_answer(system, scheme, state))
    law = prescribed(problem.law, np.zeros(system.holds, dtype=bool), np.zeros(system.holds))
    problem = replace(problem, law=law)
    points, at = thread.points(state.q, state.frame), passage(thread.spline, state.q, state.s)
    tangent = thread.tangent(points, thread.EA * points.strain)
    guess = Iterate(
        q=with_ends(state.q + dt * state.v, system, problem.time),
        N=state.N,
        s=problem.law.s_free,
        lam=np.zeros_like(state.lam),
        y=problem.y_free,
        sigma=np.where(problem.law.may_slide, 1.0, 0.0),
    )
    r = np.zeros((system.holds, 6))
    r[:, S] = np.where(law.may_slide, 0.0, law.s_free - law.s_old)
    Phi, Phi_dot = phi(at, state.lam, state.y), phi_dot(system, state, at)
    asked = restoring_acceleration(Phi, Phi_dot, dt, evaluation)
    r[:, PHI] = problem.rows * (constraint_acceleration(problem, state, at, guess) - dt**2 * asked)
    Phi = Phi + dt * (Phi_dot + dt * asked)
    r_q = thread_residual(problem, points, tangent, state.q, guess.q)
    border = border_of(problem, replace(guess, y=state.y), at)
    return Posed(problem, state, at, points, tangent, guess, r_q, r, Phi, border)


def phi_dot(system: System[Body], state: State[Body], at: Passage) -> Array:
    """Return Φ̇ at the start of a step, shape `(m, 5)` [m/s, 1/s]."""
    rate = passage(system.thread.spline, state.v, state.s)
    return phi_rate(at, rate, state.y, state.s_dot, site_rates(system, state))


def constraint_acceleration(problem: Problem[Body], state: State[Body], at: Passage, guess: Iterate) -> Array:
    """Return Δt² Φ̈ at the guess, where s̈ = 0, shape `(m, 5)` [m, -]."""
    dt, spline, y_dot = problem.dt, problem.system.thread.spline, site_rates(problem.system, state)
    rate, moved = (passage(spline, x, state.s) for x in (state.v, guess.q - state.q - dt * state.v))
    linear = phi_rate(at, moved, state.y, np.zeros_like(state.s), guess.y - state.y - dt * y_dot)
    return linear + dt**2 * velocity_terms(at, rate, state.y, state.s_dot, y_dot)


def site_rates(system: System[Body], state: State[Body]) -> Array:
    """Return ẏ of every hold at the start of a step, `(m, 9)`.

    It is Y V of an organ with inertia, and the last known rate of an organ without inertia.
    """
    known = np.zeros_like(state.y) if state.y_dot is None else state.y_dot.copy()
    moving = system.organ.impulse(state.organ)
    if moving is not None:
        known[: len(system.piercings)] = moving.y_free.reshape(-1, NINE)
    return known


def thread_residual(problem: Problem[Body], points: Points, tangent: Array, q: Array, q_new: Array) -> Array:
    """Return the thread's equation without multipliers at q⁺ = `q_new`, shape `(n, c)` [N].

    The elastic force is linearised at `q`.
    """
    thread = problem.system.thread
    elastic = thread.gradient(points) + banded_product(tangent, q_new - q)
    return elastic + problem.mass_factor * thread.momentum(q_new - problem.q_ref) - problem.load


def banded_product(band: Array, x: Array) -> Array:
    """Return the product of a banded matrix with `x` (n, c)."""
    size, h = band.shape[1], half_band_of(band)
    return np.asarray(dgbmv(size, size, h, h, 1.0, band[h:], x.ravel())).reshape(x.shape)


def constrained(posed: Posed[Body], held: Flags, injected: Array) -> Posed[Body]:
    """Return the same step with some abscissae held and forces injected; expensive parts are shared.

    `held` (m,): ds = 0 in this step, a fixed point in the place of the sliding one (§4.3, static
    case). `injected` (m,) [N]: force of the hole on the thread along its tangent t at the other
    holes (pseudo-static and kinetic case). It enters as Φ_sᵀλ − ε s̈ = |T| F, so that λ and the
    reaction on the organ contain it.
    """
    law = prescribed(posed.problem.law, held, injected)
    slides = np.where(law.may_slide, 1.0, 0.0)
    r, ideal = posed.r.copy(), replace(posed.problem, law=law._replace(injected=np.zeros_like(injected)))
    r[:, S] = np.where(law.may_slide, -np.linalg.norm(posed.at.T, axis=1) * injected, law.s_free - law.s_old)
    guess = replace(posed.guess, sigma=slides)
    border = border_of(ideal, replace(guess, y=posed.state.y), posed.at)
    return replace(posed, problem=replace(ideal, law=law), guess=guess, r=r, border=border)


# -- solvers -----------------------------------------------------------------------------------------------------------


Answer = tuple[
    Array, Array
]  # increments from the guess: of q (n, c) [m]; of s, λ, y in the order of the border (m, 15)
Solver = Callable[[Posed[Body]], Answer]


def solve_whole(posed: Posed[Body]) -> Answer:
    """Solve the whole system, also at ε = 0: a banded thread with a dense border. Raises `SingularError`."""
    problem, site = posed.problem, np.zeros_like(posed.guess.y)
    residuals = posed.r_q, posed.r, site
    return newton_directions(posed.band(), problem.system.held, posed.border, problem.C, posed.at, [residuals])[0]


# -- the step ----------------------------------------------------------------------------------------------------------


def linear_step(system: System[Body], state: State[Body], dt: float) -> Step[Body]:
    """Return one step of `dt` [s] by one linear solve.

    Raises `CouplingError` if holes have friction, and `StepError`, `InversionError`.
    """
    refuse_friction(system)
    return solve_posed(pose(system, state, dt))


def linear_two_pass(system: System[Body], state: State[Body], dt: float, passes: int = PASSES) -> Step[Body]:
    """Return one step of `dt` [s] with friction by the passes of §4.3, each with one linear solve:
    the paper's algorithm.

    The organ is asked once. Raises `StepError`, `InversionError`.
    """
    posed = pose(system, state, dt)
    law = law_of(system, state.s, state.present, posed.problem.law.inertia, posed.problem.law.s_free)
    verdict = first_verdict(system, law, state, dt)
    step = solve_posed(with_verdict(posed, law, verdict))
    for number in range(1, passes):
        new = judge(law, verdict, step.solution, frictionless=number == 1)
        if is_settled(verdict, new, step.solution):
            break
        verdict, step = new, solve_posed(with_verdict(posed, law, new))
    z = replace(step.solution.iterate, sigma=motion(law, verdict, step.solution.iterate))
    solution = replace(step.solution, problem=replace(step.solution.problem, law=law), iterate=z)
    return replace(step, new=replace(step.new, sigma=z.sigma), solution=solution)


def with_verdict(posed: Posed[Body], law: Law, verdict: Verdict) -> Posed[Body]:
    """Return the linear system of a pass."""
    return constrained(posed, law.rough & (verdict.sense == 0.0), verdict.friction)


def refuse_friction(system: System[Body]) -> None:
    """Raise `CouplingError` if a hole has friction."""
    if system.rough.any():
        name = system.piercings[int(np.argmax(system.rough))].name
        raise CouplingError(
            f"friction at piercing {name!r}: the linear step has no implicit friction; solve it in two passes, or by "
            "Newton's scheme, or leave the friction out"
        )


def solve_posed(posed: Posed[Body], solver: Solver = solve_whole) -> Step[Body]:
    """Solve a linear system and return its step.

    Raises `StepError` if the system is singular or its solution is inaccurate or runs away, and
    `InversionError`.
    """
    problem, state, guess = posed.problem, posed.state, posed.guess
    system, dt, p = problem.system, problem.dt, len(problem.system.piercings)
    try:
        dq, dz = solver(posed)
    except SingularError as error:
        raise StepError(state.time, dt, str(error)) from error
    q, lam = guess.q + dq, np.where(problem.rows, dz[:, PHI], 0.0)
    s = np.where(
        guess.sigma == 0.0, problem.law.s_old, guess.s + dz[:, S]
    )  # a held abscissa keeps its exact value and does not creep
    residual = check_accuracy(posed, q, dq, dz)
    force = site_force(posed.at, lam, state.y)
    organ = problem.answer.accept(force[:p].ravel(), NO_FORCES)
    y = problem.y_free + (problem.C @ force.ravel()).reshape(-1, NINE)
    new = replace(
        forgetful(state),
        time=problem.time,
        q=q,
        v=(q - state.q) / dt,
        N=problem.system.thread.EA * residual.points.strain,
        memory=problem.system.thread.memory,
        organ=organ,
        s=s,
        s_dot=(s - state.s) / dt,
        lam=lam,
        y=y,
        y_dot=(y - state.y) / dt,
        sigma=np.where(system.rough, np.sign(s - state.s), 1.0) * guess.sigma,
        reaction=reactions(problem, residual.thread),
        frame=system.thread.transport_frame(state.frame, q),
    )
    if system.thread.turns_too_far(state.frame, q):
        raise StepError(state.time, dt, "a tangent turned by more than 120°, too far for the twist's frame")
    at = passage(system.thread.spline, q, s)
    refuse_missed(posed, phi(at, lam, y))
    new = with_sense(system, state, new, at)
    iterate = Iterate(q, new.N, s, lam, state.y, new.sigma)
    solution = Solution(problem, iterate, residual, 1, linearisation(posed, residual.points, q))
    return Step(state, new, dt, solution, replace(residual.configuration, at=at))


def check_accuracy(posed: Posed[Body], q: Array, dq: Array, dz: Array) -> Residual:
    """Return the residuals of the solution of the linear system.

    Raises `StepError` if they are not small, or if the forces moved the thread by more than its
    length, which is far beyond the range of the linearisation.
    """
    problem, state, thread = posed.problem, posed.state, posed.problem.system.thread
    length = thread.spline.end - thread.spline.start
    if not np.all(np.isfinite(dq)) or np.abs(dq * thread.lever).max() > length:
        raise StepError(state.time, problem.dt, "the linear step ran away; take a smaller dt, or Newton's scheme")
    lam = dz[:, PHI]
    free = thread_residual(problem, posed.points, posed.tangent, state.q, q)
    balance, push = free.copy(), spread(thread_force(posed.at, lam, state.y), posed.at, thread.n)
    balance[:, :3] -= push
    at = values_at_holds(posed.at, dq[None]).reshape(-1, NINE)
    B, D = posed.border.B, posed.border.D
    holds = posed.r + np.matvec(B, at) + np.matvec(D, dz)
    terms = np.abs(posed.r) + np.matvec(np.abs(B), np.abs(at)) + np.matvec(np.abs(D), np.abs(dz))
    force_scale = max(
        np.abs(free / thread.lever).max(), np.abs(posed.r_q / thread.lever).max(), np.abs(lam[:, :3]).max(initial=0.0)
    )
    points = thread.points(q, state.frame)
    residual = Residual(
        Configuration(points, posed.at, thread.gradient(points), thread),
        site_force(posed.at, lam, state.y),
        push,
        balance,
        holds,
        np.zeros_like(state.y),
        float(force_scale),
    )
    largest = np.abs(np.delete((balance / thread.lever).ravel(), problem.system.held)).max(initial=0.0)
    force_unit = np.abs(problem.inertia + posed.tangent).max() * length
    floor = ROUND_OFF * np.array([force_unit, length, length, length, 1.0, 1.0])
    accurate = np.abs(holds).max(axis=0, initial=0.0) <= ACCURACY * terms.max(axis=0, initial=0.0) + floor
    if largest > ACCURACY * force_scale + floor[S] or not accurate.all():
        raise failure(problem, residual.holds, "the linear solution is inaccurate; with the elimination, raise epsilon")
    return residual


def refuse_missed(posed: Posed[Body], end: Array) -> None:
    """Raise `StepError` if the true P(s) − x in `end`, Φ (m, 5), is far from that of the linearisation."""
    problem = posed.problem
    missed = np.linalg.norm((end - posed.phi)[:, :3], axis=1) * problem.rows[:, 0]
    if missed.max(initial=0.0) > TRUST * problem.system.thread.section.diameter:
        name = problem.system.piercings[int(np.argmax(missed))].name
        cause = f"the linearised step misses a hole by {missed.max():.3g} m, more than the thread's diameter"
        raise StepError(posed.state.time, problem.dt, f"{cause}; take a smaller dt, or Newton's scheme", name)


def checked(take: Take[Body]) -> Take[Body]:
    """Return the linear step `take` with a check of created energy.

    The step raises `CreatedEnergyError` if it creates more than CREATED of the energy at its end
    and of its work. In this case the constraint forces, which are those of the start, drive the
    motion that they should prevent. The step is not halved, because halves just below the bound
    would continue with created energy.
    """

    def step(system: System[Body], state: State[Body], dt: float) -> Step[Body]:
        step = take(system, state, dt)
        refuse_created(system, step)
        return step

    return step


def refuse_created(system: System[Body], step: Step[Body]) -> None:
    """Raise `CreatedEnergyError` if a step created more than CREATED of the available energy."""
    energies = audit_step(system, initial_energies(system, step.old), step)
    created = -energies.numerical_dissipation
    share = created / (energies.at_stake + np.finfo(float).tiny)
    if share > CREATED:
        raise CreatedEnergyError(step.old.time, step.dt, created, share, *farthest_off(system, step))


def farthest_off(system: System[Body], step: Step[Body]) -> tuple[str, float]:
    """Return the piercing that is farthest from the thread at the end of a step, and the distance [m].

    Without piercings the name is empty.
    """
    new, p = step.new, len(system.piercings)
    off = np.linalg.norm(phi(step.end.at, new.lam, new.y)[:p, :3], axis=1) * new.present[:p]
    return max(
        zip((piercing.name for piercing in system.piercings), off.tolist(), strict=True),
        key=itemgetter(1),
        default=("", 0.0),
    )


def linearisation(posed: Posed[Body], points: Points, q: Array) -> float:
    """Return the work of the linearised elastic force of the step minus that of the true force at its end [J]."""
    thread, dq = posed.problem.system.thread, q - posed.state.q
    used = thread.gradient(posed.points) + banded_product(posed.tangent, dq)
    return float(np.sum((used - thread.gradient(points)) * dq))
