"""The energy audit of a step (`coupling.kernels.steps.audit`), and the additional terms of some
threads and organs.

If thread and organ are stepped one after the other (`coupling.paper.staggered`), the holes move
after the thread has moved, and the works of the constraints on the two do not cancel. The
difference is `coupling.paper.staggered.work_of_the_lag` and is part of the remainder. It belongs to
the integrator: a negative numerical dissipation is energy that the scheme has created.

The linear step (`coupling.paper.linear_step`) uses the elastic force linearised at the start of the
step. Its work minus that of the true force is part of the integrator's share, by the formula of
both. Its constraint forces are those of the start, and Φ is not zero at its ends. Kinetic energy,
elastic energy, external work, viscous work and friction work are exact. The remainder is the work
of the constraints on the violation Φ that they allow.
"""

from dataclasses import astuple, dataclass

import numpy as np

from coupling.arrays import Array
from coupling.integrators import BDF2
from coupling.interfaces import Body
from coupling.kernels.constraints import Passage, driving_force, site_force
from coupling.kernels.iteration import Passing
from coupling.kernels.steps import audit
from coupling.kernels.steps.audit import Holes, Met, Motion, OnThread, Works
from coupling.kernels.steps.watch import at_stake
from coupling.step.packets import points_at_start
from coupling.step.stepping import Step, scheme_of, thread_motion
from coupling.system import State, System
from thread.riding import plain, potential_rates, put_on

NONE, PLANE = np.zeros(0), np.zeros((0, 0))


@dataclass(frozen=True)
class Energies:
    """Energies at a time and works since the start, all [J].

    - `loan`: energy taken by the last step that the next step may return with BDF2
      (`coupling.run.watch`).
    - `prestretch`: `elastic_tissue` at the start if a prestretch stores it, after the release of
      gapes.
    - `balance_error` = external work − change of kinetic and elastic energy − friction − viscous −
      numerical.
    """

    kinetic: float
    elastic_thread: float
    elastic_tissue: float
    external_work: float
    friction_dissipation: float
    viscous_dissipation: float
    numerical_dissipation: float
    balance_error: float
    loan: float = 0.0
    prestretch: float = 0.0

    @property
    def elastic(self) -> float:
        """Elastic energy of thread and organ."""
        return self.elastic_thread + self.elastic_tissue

    @property
    def of_deformation(self) -> float:
        """Elastic energy of the thread, plus the absolute change of the tissue's elastic energy
        from that of a prestretch.
        """
        return self.elastic_thread + abs(self.elastic_tissue - self.prestretch)

    @property
    def at_stake(self) -> float:
        """Sum of the kinetic energy, the elastic energy of deformation, and the absolute value of
        the work so far.
        """
        return at_stake(self.kinetic, self.elastic_thread, self.elastic_tissue, self.prestretch, self.external_work)


def initial_energies(system: System[Body], state: State[Body]) -> Energies:
    """Return the energies at the start, before any work."""
    organ_kinetic, organ_elastic, *_, stored = system.organ.energies(state.organ, state.organ)
    v, s_dot = map(np.ascontiguousarray, (state.v, state.s_dot))
    kinetic = audit.kinetic(v, momentum_of(system, v), s_dot, float(system.epsilon)) + organ_kinetic
    there = organ_elastic if stored else 0.0
    return Energies(kinetic, thread_elastic(system, state), organ_elastic, 0.0, 0.0, 0.0, 0.0, 0.0, prestretch=there)


def stored(system: System[Body], state: State[Body]) -> float:
    """Return the kinetic and elastic energy of thread and organ [J]."""
    energies = initial_energies(system, state)
    return energies.kinetic + energies.elastic


def momentum_of(system: System[Body], v: Array) -> Array:
    """Return M v of the thread as an array for the kernels, shape `(n, c)`."""
    return np.ascontiguousarray(system.thread.momentum(v))


def thread_elastic(system: System[Body], state: State[Body]) -> float:
    """Return the elastic energy of the thread [J]."""
    thread = system.thread.with_memory(state.memory)
    return thread.stored_energy(thread.points(state.q, state.frame))


def audit_step(system: System[Body], before: Energies, step: Step[Body]) -> Energies:
    """Return the audit after a step, from the audit `before` it."""
    energies = np.array(astuple(before))
    after = energies.copy()
    audit.enter(turned_over(step), body_of(step), energies, after)
    return Energies(*after.tolist())


def turned_over(step: Step[Body]) -> Array:
    """Return the energy turnover of the thread in a step, `coupling.kernels.steps.audit.TURNS` numbers [J]."""
    old, new, solution = step.old, step.new, step.solution
    residual, y = solution.residual, solution.iterate.y
    lag = residual.f_y * (new.y - y)  # y: places of the holes when the thread was solved
    turns = np.zeros(audit.TURNS)
    thread, points = residual.configuration.thread, residual.configuration.points
    relaxed = thread.dissipated(points)
    turns[audit.ELASTIC] = thread.stored_energy(points)
    turns[audit.VISCOUS] += relaxed
    turns[audit.NUMERICAL] -= relaxed
    at_end, by_mean = closing_works(step, mean=False).sum(), closing_works(step).sum()
    turns[audit.EXTERNAL], turns[audit.BY_MEAN] = by_mean, by_mean - at_end
    turns[audit.NUMERICAL] += lying_work(step) + solution.linearisation
    turns[audit.REMAINDER] = -lag.sum()
    before, after = motion_of(old, old.y, residual.f_y), motion_of(new, y, residual.f_y)
    q, v = start_on_end(step)
    on, start = forces_on(step, q, v), points_at_start(solution.problem.system, old, new)
    motions = before._replace(q=plain(start)), after
    audit.audit(works_of(step), holes_of(step), on, *motions, met_by(step), turns)
    add_rubbing(step, start, turns)
    if solution.problem.system.thread.travels:
        add_travelling(step, on, start, v, turns)
    else:
        weight = solution.problem.weights * solution.problem.system.weight
        by_mean = (weight_over(step) - 1.0) * np.vdot(weight, new.q - old.q)
        turns[[audit.EXTERNAL, audit.BY_MEAN]] += by_mean
    return turns


def start_on_end(step: Step[Body]) -> tuple[Array, Array]:
    """Return q and v (n, c) of the start of a step.

    If knots travel, they are on the knots of its end, at the material points.
    """
    old, spline, thread = step.old, step.old.spline, step.solution.residual.configuration.thread
    if spline is None:
        return old.q, old.v
    return put_on(thread, [(spline, old.q)]), put_on(thread, [(spline, old.v)])


def add_travelling(step: Step[Body], on: OnThread, q: Array, v: Array, turns: Array) -> None:
    """Add the energy turnover of a step due to the travel of knots.

    `q` (n, c) [m] is the start on the knots χ of the end, with the holes at their old abscissae.
    `v` (n, c) [m/s] is the velocity at the start, on the knots of the end. The terms are ∂Π/∂s of
    each part of the potential: elastic energy, weight and inertia. The work of the inertia beyond
    the change of the kinetic energy is the integrator's.
    """
    old, new, solution = step.old, step.new, step.solution
    problem, r, thread = solution.problem, solution.residual, solution.residual.configuration.thread
    ds, dq, n = new.s - old.s, new.q - q, thread.n
    weight, by_weight, by_elastic = potential_rates(thread, problem.gravity, new.q)
    assert new.drive is not None
    by_inertia = rubbing_drive(step) - new.drive - by_elastic - by_weight
    inertia = r.thread.reshape(n, -1) - r.configuration.elastic + problem.load - weight + r.push
    change = 0.5 * np.vdot(new.v, on.momentum)
    change -= 0.5 * np.vdot(old.v, problem.system.at(old).thread.momentum(old.v))
    taken = thread.damping * np.vdot(new.v, on.moved) + 0.5 * np.vdot(on.faster, new.v - v)
    weighed, share = -np.vdot(weight, dq) - by_weight @ ds, weight_over(step)
    turns[audit.EXTERNAL] += share * weighed
    turns[audit.BY_MEAN] += (share - 1.0) * weighed
    turns[audit.NUMERICAL] += by_elastic @ ds
    beyond = np.vdot(inertia, dq) + by_inertia @ ds - change - taken
    if is_of_bdf2(step):
        turns[audit.TWO_STEP] += beyond + np.vdot(new.v, on.faster)
    else:
        turns[audit.NUMERICAL] += beyond


def rubbing_drive(step: Step[Body]) -> Array:
    """Return the driving forces at the holds due to the friction of the thread on the organ, shape `(m,)` [N]."""
    strands, touch = step.solution.problem.strands, step.solution.residual.touch
    if strands is None or touch is None:
        return np.zeros_like(step.new.s)
    return strands.drive(touch.P, step.solution.iterate.s)


def add_rubbing(step: Step[Body], q: Array, turns: Array) -> None:
    """Add the thread's part of the work of its friction on the organ.

    The step began with `q` (n, c) [m]. The friction is part of the push, and thus of the
    constraints' work; it is booked as friction instead.
    """
    strands, touch = step.solution.problem.strands, step.solution.residual.touch
    if strands is None or touch is None or not strands.friction:
        return
    P, old, new = touch.P[strands.count :], step.old, step.new
    slips = [strands.opens(*at)[strands.count :] for at in ((q, new.s), (new.q, new.s))]
    pushed = float(P @ (slips[1] - slips[0]))
    turns[audit.REMAINDER] += pushed
    turns[audit.FRICTION] -= pushed + float(rubbing_drive(step) @ (new.s - old.s))


def weight_over(step: Step[Body]) -> float:
    """Return the mean weight over a load step relative to that at its end [-]; 1 in motion."""
    if not step.solution.problem.stiffen:
        return 1.0
    return 0.5 * (1.0 + step.old.time / step.new.time) if step.new.time else 0.5


def works_of(step: Step[Body]) -> Works:
    """Return the data of a step for the audit."""
    system, two_step, old, new = step.solution.problem.system, is_by_mean(step), step.old, step.new
    a, at = 0.0, np.zeros_like(new.q)
    # only for ends that are not held; their reactions are the loads on them
    more = np.where(system.held_flags[[0, -1]], 0.0, old.reaction - new.reaction)[:, :3]
    if is_of_bdf2(step) and not system.thread.travels:
        scheme = scheme_of(old, step.dt)
        a, at = float(scheme.a), plain(scheme.inertia_reference(*thread_motion(scheme, old)))
    return Works(float(system.thread.damping), a, at, two_step, plain(more))


def holes_of(step: Step[Body]) -> Holes:
    """Return the data of the holds for the audit; in a hole with a hand, the sliding is the hand's motion."""
    problem, law = step.solution.problem, step.solution.problem.law
    system = problem.system
    return Holes(
        rough=system.rough,
        by_hand=law.by_hand,
        slides=law.may_slide & ~system.of_ties,
        inertia=law.inertia,
        s_free=law.s_free,
        epsilon=float(system.epsilon),
        rides=system.thread.travels,
    )


def forces_on(step: Step[Body], q: Array, v: Array) -> OnThread:
    """Return the forces on the thread at the end of a step that began with `q` and `v` (n, c) on
    the knots of its end.
    """
    new, problem, r = step.new, step.solution.problem, step.solution.residual
    system = problem.system.on(r.configuration.thread.spline)
    moved, faster, momentum = (momentum_of(system, x) for x in (new.q - q, new.v - v, new.v))
    elastic, load, balance = map(plain, (r.configuration.elastic, problem.load, r.thread.reshape(new.q.shape)))
    return OnThread(elastic, load, balance, problem.system.held_flags, plain(r.push), moved, faster, momentum, plain(v))


def motion_of(state: State[Body], y: Array, f_y: Array) -> Motion:
    """Return the arrays of a state for the audit, with the sites at `y` (m, 9) under the forces `f_y` (m, 9)."""
    q, v, s, s_dot, lam, y, sigma, reaction, f_y = map(
        plain, (state.q, state.v, state.s, state.s_dot, state.lam, y, state.sigma, state.reaction, f_y)
    )
    return Motion(q, v, PLANE, s, s_dot, lam, y, sigma, NONE, reaction, NONE, f_y, *(NONE,) * 6)


def met_by(step: Step[Body]) -> Met:
    """Return the thread at the holes at both ends of a step."""
    was = step.solution.problem.system.passage_of(step.old)
    return Met(passing_of(was), passing_of(step.solution.residual.passage))


def passing_of(at: Passage) -> Passing:
    """Return the thread at its holes as arrays for the kernels."""
    drive = np.zeros(len(at.D)) if at.drive is None else at.drive
    return Passing(at.first.astype(np.int64), plain(at.b), plain(at.D), plain(drive))


def body_of(step: Step[Body]) -> Array:
    """Return the energy turnover of the organ in a step, `coupling.kernels.steps.audit.BODY` numbers [J].

    The works of loads and damping are by the mean of the forces at both ends if `is_by_mean`.
    """
    old, new, organ = step.old.organ, step.new.organ, step.solution.problem.system.organ
    kinetic, elastic, loads, viscous, numerical, rubbed, _ = organ.energies(old, new)
    more_loads, more_viscous = 0.0, 0.0
    if is_by_mean(step):
        _, _, loads_back, viscous_back, *_ = organ.energies(new, old)  # by the forces at the start
        more_loads, more_viscous = -0.5 * (loads_back + loads), -0.5 * (viscous_back + viscous)
    by_mean, works = more_loads - more_viscous, (loads + more_loads, viscous + more_viscous)
    return np.array([kinetic, elastic, *works, numerical + by_mean, rubbed, by_mean])


def lying_work(step: Step[Body]) -> float:
    """Return the work against the tie that holds the pieces of a cut thread in place at rest [J].

    The tie is `coupling.rest.equilibrium.LYING`. The work is zero in motion, which has inertia
    instead, and with travelling knots, for which `add_travelling` contains it.
    """
    problem = step.solution.problem
    if not problem.stiffen or problem.system.thread.travels:
        return 0.0
    pull = problem.mass_factor * problem.system.thread.momentum(step.new.q - problem.q_ref)
    return float(np.sum(pull * (step.new.q - step.old.q)))


def closing_works(step: Step[Body], mean: bool = True) -> Array:
    """Return the work of the hands that bring the strands of ties together, shape `(t,)` [J].

    It is by the forces at the end of the step, or by their `mean` if `is_by_mean`.
    """
    system, old, new = step.solution.problem.system, step.old, step.new
    force, strands = step.solution.residual.f_y, system.strands
    if mean and system.ties and is_by_mean(step):
        force = 0.5 * (force + site_force(system.passage_of(old), old.lam, old.y))
    way = (new.y - old.y)[strands, :3] * new.present[strands][:, :, None]
    return -np.sum(force[strands, :3] * way, axis=(1, 2))


def drawing_works(step: Step[Body]) -> Array:
    """Return the work of the hands that draw ties tight, shape `(t,)` [J]; by the mean of their
    forces if `is_by_mean`.
    """
    system, old, new = step.solution.problem.system, step.old, step.new
    if not system.ties:
        return np.zeros(0)
    strands, drive = system.strands, driving_force(step.solution.residual.passage, new.lam, step.solution.iterate.y)
    if is_by_mean(step):
        drive = 0.5 * (drive + driving_force(system.passage_of(old), old.lam, old.y))
    return -np.sum((drive * (new.s - old.s) * step.solution.problem.law.by_hand)[strands], axis=1)


def is_by_mean(step: Step[Body]) -> bool:
    """Return whether works in a step are by the mean of the forces at both ends: at rest, and with BDF2.

    The works are those of external forces and of friction in steady sliding.
    """
    return step.solution.problem.stiffen or is_of_bdf2(step)


def is_of_bdf2(step: Step[Body]) -> bool:
    """Return whether a step was made by BDF2."""
    return step.new.before is not None and isinstance(scheme_of(step.old, step.dt), BDF2)
