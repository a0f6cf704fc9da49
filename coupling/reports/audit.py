"""The energy audit of a step: every joule of work goes somewhere, each place by its own formula.

Dot the thread's equation with Δq and the organ's with ΔU. With Φ = 0 at both ends of the step the constraints' work
is what the driving force Φ_sᵀλ takes through the hole, −Φ_sᵀλ Δs, plus a remainder of second order in the step, which
belongs to the integrator. Backward Euler dissipates ½Δvᵀ M Δv, and of the elastic energy ∂E(q⁺)·Δq − ΔE. Under BDF2,
a⁺ ≠ Δv/Δt and Δq ≠ Δt v⁺, and the inertia takes a⁺ᵀMΔq − v⁺ᵀMΔv more, of either sign. All these works are those of the
forces at the end of the step along it, a rectangle rule of first order; what separates it from the exact work stands
with the integrator's share. After a step of BDF2 the works from outside, of damping and of a friction that goes on are
those of the mean of the forces at both ends, the trapezoidal rule, and so the integrator's share is of second order as
its motion is (`mean_force_works`). Where a hand draws the thread through a hole, by a length or
with a force, −Φ_sᵀλ Δs is its work, and external.

When thread and organ are stepped one after the other (`coupling.paper.staggered`) the holes move after the thread has,
and the constraints' work on the two does not cancel: `coupling.paper.staggered.work_of_the_lag`, which is in the
remainder. It is the integrator's too: a negative numerical dissipation is energy that the scheme has created.

The linear step (`coupling.paper.linear_step`) takes the elastic force as linearised at the start of the step; its work
beyond that of the true force stands with the integrator's, by the formula of both. Its constraint forces are those of
the start, and Φ is not zero at its ends: exact are kinetic, elastic, external, viscous and friction work; the remainder
is the constraints' work on what they let the thread do.
"""

from dataclasses import dataclass, replace

import numpy as np

from coupling.arrays import Array, Flags
from coupling.integrators import BDF2
from coupling.interfaces import Body
from coupling.kernels.bordered import lacking_give
from coupling.kernels.constraints import (
    Passage,
    driving_force,
    force_on_tangent,
    held_energy,
    parts,
    site_force,
    thread_force,
    tilt_of,
    turned_compliance,
)
from coupling.step.stepping import Step, end_load, scheme_of, thread_motion
from coupling.system import State, System
from thread.vectors import dot, outer

BORNE = 0.01  # of a compliance: with less of it left, a hole that stays in place is met under forces without measure


@dataclass(frozen=True)
class Energies:
    """Energies at a time and works since the start, all [J].

    `layer_work`: what the holes' compliance takes in as the tension that it is of is taken anew (`layer_work`).
    `loan`: what the last step took only to give back, of which the next one may by BDF2 (`coupling.run.watch`).
    `prestretch`: `elastic_tissue` at the start where a prestretch stores it, what gapes having released its part.
    `balance_error` = external work + layer work − change of kinetic and elastic energy − friction − viscous −
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
    layer_work: float = 0.0
    loan: float = 0.0
    prestretch: float = 0.0

    @property
    def elastic(self) -> float:
        """Of thread and organ."""
        return self.elastic_thread + self.elastic_tissue

    @property
    def of_deformation(self) -> float:
        """Elastic energy of the thread, and what deformation has added to that of a prestretch or released of it."""
        return self.elastic_thread + abs(self.elastic_tissue - self.prestretch)

    @property
    def at_stake(self) -> float:
        """Kinetic energy, the elastic one of deformation, and the work done so far, of either sign."""
        return self.kinetic + self.of_deformation + abs(self.external_work)


def initial_energies(system: System[Body], state: State[Body]) -> Energies:
    """Return the energies at the start; no work has been done."""
    organ_kinetic, organ_elastic, *_, stored = system.organ.energies(state.organ, state.organ)
    kinetic, thread = thread_kinetic(system, state) + organ_kinetic, thread_elastic(system, state)
    there = organ_elastic if stored else 0.0
    return Energies(kinetic, thread, organ_elastic, 0.0, 0.0, 0.0, 0.0, 0.0, prestretch=there)


def thread_kinetic(system: System[Body], state: State[Body]) -> float:
    """Return ½ vᵀ M v of the thread, and ½ ε ṡ² of eq. 7 [J]."""
    momentum = system.thread.momentum(state.v)
    return float(0.5 * np.sum(state.v * momentum) + 0.5 * system.epsilon * np.sum(state.s_dot**2))


def thread_elastic(system: System[Body], state: State[Body]) -> float:
    """Return the elastic energy of the thread, and of what it lacks in compliance at the holes [J]."""
    at = system.passage_of(state)
    held = float(held_energy(at, state.lam, state.y).sum())
    return system.thread.energy(system.thread.points(state.q, state.frame)) + held


def audit_step(system: System[Body], before: Energies, step: Step[Body]) -> Energies:
    """Add a step to the audit `before` it."""
    old, new, thread = step.old, step.new, system.thread
    dq, dv = new.q - old.q, new.v - old.v
    solution, now = step.solution, step.solution.residual.configuration
    elastic = thread.energy(now.points) + float(held_energy(now.at, new.lam, solution.iterate.y).sum())
    organ_kinetic, organ_elastic, load_work, organ_viscous, organ_numerical, rubbed, _ = system.organ.energies(
        old.organ, new.organ
    )

    layered = layer_work(step)
    external = np.sum(step.solution.problem.load * dq) + load_work + held_work(step)
    friction, eps_numerical, remainder, by_hand = sliding_work(system, step)
    more_external, more_friction, more_viscous = mean_force_works(system, step, load_work, organ_viscous)
    external, friction = external + by_hand + more_external, friction + more_friction + rubbed
    viscous = thread.damping * np.sum(new.v * thread.momentum(dq)) + organ_viscous + more_viscous
    lost = (
        0.5 * np.sum(dv * thread.momentum(dv))
        + lying_work(step)
        + np.sum(now.elastic * dq)
        - (elastic - before.elastic_thread - layered)
        + organ_numerical
        + eps_numerical
        + remainder
        + step.solution.linearisation
    )
    numerical = lost + two_step_inertia(system, step) + more_external - more_friction - more_viscous
    kinetic = thread_kinetic(system, new) + organ_kinetic
    change = kinetic - before.kinetic + elastic - before.elastic_thread + organ_elastic - before.elastic_tissue
    error = external + layered - change - friction - viscous - numerical
    return Energies(
        kinetic,
        elastic,
        organ_elastic,
        before.external_work + float(external),
        before.friction_dissipation + float(friction),
        before.viscous_dissipation + float(viscous),
        before.numerical_dissipation + float(numerical),
        before.balance_error + float(error),
        before.layer_work + layered,
        float(2.0 * lost - numerical),
        before.prestretch,
    )


def layer_work(step: Step[Body]) -> float:
    """Return what the compliance c of the holes takes in as the √(EI/T) of a step replaces that of the state before it
    [J].

    A step has c as a number, and there is no path from the one to the other. Before a step of backward Euler it is
    exchanged in place. Between both ends it is under BDF2, whose other works are means of both, at rest, where load
    steps are long and the sum over them is to be of second order, and where c⁺ does not bear a hole in place.
    """
    old, problem = step.old, step.solution.problem
    system, layers = problem.system, problem.layers
    if not old.lam.any() or layers is old.layers:
        return 0.0
    if layers is not None and old.layers is not None and np.array_equal(layers, old.layers):
        return 0.0
    if problem.stiffen or is_of_bdf2(step):
        return exchange_between(step)
    before = system.passage_of(old)
    after = replace(before, c=system.thread.missing_compliance(old.s, None, layers))
    rows = problem.rows & (before.c[:, 0] != after.c[:, 0]).any(axis=1, keepdims=True)
    if not bears(before, after, old.y)[rows.any(axis=1)].all():
        return exchange_between(step)
    return exchange_in_place(before, after, rows, old.lam, old.y)


def exchange_between(step: Step[Body]) -> float:
    """Return ½λ⁻(c⁻ − c⁺)λ⁺ [J], the work of a c that goes from c⁻ to c⁺ on any path under a constant force, as in a
    constant place."""
    old, new, layers = step.old, step.new, step.solution.problem.layers
    system, y = step.solution.problem.system, step.solution.iterate.y
    before, after = system.passage_of(old), step.solution.residual.passage
    there = before.c[:, 0] - lack_at(system, old.s, layers)
    here = lack_at(system, new.s, old.layers) - after.c[:, 0]
    c = 0.5 * (there + here)
    across = parts(before, old.lam).across, parts(after, new.lam).across
    tilts = tilt_of(before, old.y), tilt_of(after, y)
    turned, size = 0.5 * (tilts[0].share + tilts[1].share) - 1.0, 0.5 * (tilts[0].size + tilts[1].size)[:, 0]
    m = force_on_tangent(old.lam, old.y), force_on_tangent(new.lam, y)
    mixed = size * (dot(old.lam[:, :3], m[1]) + dot(new.lam[:, :3], m[0]))
    by_couple = (c[:, 2] + c[:, 3] * turned) * dot(*m)
    return float(0.5 * np.sum(c[:, 0] * dot(*across) + c[:, 1] * mixed + by_couple))


def exchange_in_place(before: Passage, after: Passage, rows: Flags, lam: Array, y: Array) -> float:
    """Return the work of exchanging the c of the passage `before` for that of `after` while thread and holes stay where
    they are, where the constraints `rows` (m, 5) feel it [J].

    Backward Euler goes downhill in a potential that has c⁺ all along, from where the thread is. There the holes are
    met under other forces λ*: with C = ∂Φ/∂λ, C⁺λ* = C⁻λ. That stores ½λ*ᵀC⁺λ* − ½λᵀC⁻λ = ½λᵀ(C⁻ − C⁺)λ* more; what
    the step then loses is never negative where the potential is convex. The spline lacks nothing along the thread,
    where λ* is λ.
    """
    C, C_after = (lacking_give(each, lam, y) for each in (before, after))
    let_go, unit = np.matvec(C - C_after, lam), parts(before, lam).unit
    free = rows[:, :, None] * np.eye(5)
    free[:, :3, :3] -= rows[:, :1, None] * outer(unit, unit)
    held = np.where(after.c[:, 0, :1] > 0.0, after.c[:, 0, :1], 1.0)[:, :, None] * (np.eye(5) - free)
    taken_up = np.linalg.solve(free @ C_after @ free + held, np.matvec(free, let_go)[..., None])[..., 0]
    return float(0.5 * np.sum(let_go * (lam + taken_up)))


def bears(before: Passage, after: Passage, y: Array) -> Flags:
    """Whether the c of the passage `after` takes up by forces of the size of those of `before` what the holes are off
    the drawn thread, shape `(m,)`: at a knot a spline without tension lacks nothing under a force."""
    c0, c1, c2, _ = after.c[:, 0].T
    turns = c0 * turned_compliance(after, y) - (c1 * tilt_of(after, y).size[:, 0]) ** 2 > BORNE * c0 * c2
    return np.asarray((c0 > BORNE * before.c[:, 0, 0]) & (turns | ~after.directed))


def lying_work(step: Step[Body]) -> float:
    """Return what keeps the pieces of a cut thread where they lie at rest takes from their way [J]
    (`coupling.rest.equilibrium.LYING`); zero in motion, where inertia is in its place."""
    problem = step.solution.problem
    if not problem.stiffen:
        return 0.0
    pull = problem.mass_factor * problem.system.thread.momentum(step.new.q - problem.q_ref)
    return float(np.sum(pull * (step.new.q - step.old.q)))


def lack_at(system: System[Body], s: Array, layers: Array | None) -> Array:
    """Return the compliance that the spline lacks at the abscissae `s` (m,) [m] of the holds, shape `(m, 4)`."""
    return system.thread.missing_compliance(s, None, layers)[:, 0]


def held_work(step: Step[Body]) -> float:
    """Return the work of the holders of the ends, whose reactions are the residuals at the prescribed unknowns [J]."""
    held = step.solution.problem.system.held
    dq = (step.new.q - step.old.q).ravel()
    return float(step.solution.residual.thread.ravel()[held] @ dq[held]) + float(closing_works(step).sum())


def closing_works(step: Step[Body]) -> Array:
    """Return the work of the hands that bring the strands of ties together, shape `(t,)` [J]."""
    strands = step.solution.problem.system.strands
    way = (step.new.y - step.old.y)[strands, :3] * step.new.present[strands][:, :, None]
    return -np.sum(step.solution.residual.f_y[strands, :3] * way, axis=(1, 2))


def drawing_works(step: Step[Body]) -> Array:
    """Return the work of the hands that draw ties tight, shape `(t,)` [J]; of BDF2 by the mean of their forces."""
    system, old, new = step.solution.problem.system, step.old, step.new
    if not system.ties:
        return np.zeros(0)
    strands, drive = system.strands, driving_force(step.solution.residual.passage, new.lam, step.solution.iterate.y)
    if is_of_bdf2(step):
        drive = 0.5 * (drive + driving_force(system.passage_of(old), old.lam, old.y))
    return -np.sum((drive * (new.s - old.s) * step.solution.problem.law.by_hand)[strands], axis=1)


def is_of_bdf2(step: Step[Body]) -> bool:
    """Whether a step was made by BDF2."""
    return step.new.before is not None and isinstance(scheme_of(step.old, step.dt), BDF2)


def mean_force_works(
    system: System[Body], step: Step[Body], load_work: float, organ_viscous: float
) -> tuple[float, float, float]:
    """Return by how much more the mean of the forces at both ends of a step of BDF2 does from outside, takes by
    friction and takes by damping than the forces at its end [J]; zero after one of backward Euler.

    `load_work` and `organ_viscous` [J] are what the organ's loads at the end do, and its damping there takes.
    Friction counts where the thread slides on, the same way and without ε: elsewhere its force jumps, and what the
    force at the end takes is never negative.
    """
    old, new, thread = step.old, step.new, system.thread
    if not is_of_bdf2(step):
        return 0.0, 0.0, 0.0
    _, _, load_back, viscous_back, *_ = system.organ.energies(new.organ, old.organ)  # by the forces of the start
    dq, outside, rubbed = new.q - old.q, more_outside(system, step) - load_back - load_work, 0.0
    by_hand = step.solution.problem.law.by_hand
    if (system.rough | by_hand).any():
        ds, at, now = new.s - old.s, system.passage_of(old), step.solution.residual.passage
        drive = driving_force(at, old.lam, old.y) - driving_force(now, new.lam, step.solution.iterate.y)
        goes_on = system.rough & ~by_hand & (old.sigma == new.sigma) & (system.epsilon == 0.0)
        outside, rubbed = outside - float(drive @ (ds * by_hand)), float(drive @ (ds * goes_on))
    damped = -thread.damping * np.sum((new.v - old.v) * thread.momentum(dq)) - organ_viscous
    return 0.5 * outside, 0.5 * rubbed, 0.5 * float(damped - viscous_back)


def more_outside(system: System[Body], step: Step[Body]) -> float:
    """Return what the loads and holders at the start of a step would do along it more than those at its end [J]."""
    old, new, held = step.old, step.new, system.held
    dq, holders = (new.q - old.q).ravel(), np.zeros_like(new.q)
    holders[[0, -1]] = old.reaction - new.reaction
    load = (end_load(system, old.time) - step.solution.problem.load).ravel()
    return float(load @ dq + holders.ravel()[held] @ dq[held])


def two_step_inertia(system: System[Body], step: Step[Body]) -> float:
    """Return a⁺ᵀMΔq − v⁺ᵀMΔv of the thread under BDF2 [J]; zero after a step without memory, of backward Euler."""
    old, new, momentum = step.old, step.new, system.thread.momentum
    if new.before is None:
        return 0.0
    scheme = scheme_of(old, step.dt)
    acceleration = scheme.a * (new.q - scheme.inertia_reference(*thread_motion(scheme, old)))
    work = np.sum(acceleration * momentum(new.q - old.q)) - np.sum(new.v * momentum(new.v - old.v))
    return float(work)


def sliding_work(system: System[Body], step: Step[Body]) -> tuple[float, float, float, float]:
    """Return friction's dissipation, ε's own dissipation, the remainder of the constraints' work, and that of the
    hands that draw the thread through holes [J]."""
    old, new, at = step.old, step.new, step.solution.residual.passage
    ds, p = new.s - old.s, len(system.piercings)
    y = step.solution.iterate.y  # where the holes were when the thread was solved; new.y but in a staggered step
    drive = driving_force(at, new.lam, y)
    law = step.solution.problem.law
    slides, hand = ds * ~law.by_hand, ds * law.by_hand
    # what is drawn goes as the hand goes
    ideal_inertia = law.inertia * (new.s - law.s_free) * (law.may_slide & ~system.of_ties)
    friction = np.sum((drive - ideal_inertia) * slides)
    eps_numerical = ideal_inertia @ ds - 0.5 * system.epsilon * np.sum(new.s_dot**2 - old.s_dot**2)
    work = np.sum(step.solution.residual.push * (new.q - old.q)[:, :3])
    at_sites = step.solution.residual.f_y * (new.y - old.y)
    work += np.sum(at_sites[:p]) + np.sum(at_sites[system.of_ties])
    return (
        float(friction),
        float(eps_numerical),
        float(-work - np.sum(drive * ds)),
        float(-np.sum((drive - ideal_inertia) * hand)),
    )


def multiplier_imbalance(system: System[Body], state: State[Body]) -> tuple[float, float]:
    """Return the total force [N] and moment [N m] of the multipliers on thread and organ together: zero but for
    round-off.

    The moment is taken on the site variables, x×f_x + u×f_u + v×f_v (Φ is invariant under a common rotation).
    """
    at = system.passage_of(state)
    on_thread, on_sites = thread_force(at, state.lam, state.y), site_force(at, state.lam, state.y).reshape(-1, 3, 3)
    force = on_thread[:, 0].sum(axis=0) + on_sites[:, 0].sum(axis=0)
    moment = np.cross(at.P, on_thread[:, 0]) + np.cross(at.T, on_thread[:, 1])
    moment += np.cross(state.y.reshape(-1, 3, 3), on_sites).sum(axis=1)
    return float(np.abs(force).max(initial=0.0)), float(np.abs(moment.sum(axis=0)).max(initial=0.0))
