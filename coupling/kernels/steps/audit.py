"""The energy audit of a step: every joule of work is booked in one place, each place by its own formula.

The thread's equation is multiplied by Δq and the organ's by ΔU. With Φ = 0 at both ends of the
step, the work of the constraints is −Φ_sᵀλ Δs, which the driving force Φ_sᵀλ takes through the
hole, plus a remainder. The remainder is of second order in the step and belongs to the integrator.

Backward Euler dissipates ½Δvᵀ M Δv, and ∂E(q⁺)·Δq − ΔE of the elastic energy. With BDF2, a⁺ ≠ Δv/Δt
and Δq ≠ Δt v⁺; the inertia then takes a⁺ᵀMΔq − v⁺ᵀMΔv in addition, which can have either sign.

All these works are by the forces at the end of the step, a rectangle rule of first order. The
difference from the exact work is part of the integrator's share. After a step of BDF2 and after a
load step, the works of external forces, of damping and of friction in steady sliding are by the
mean of the forces at both ends (trapezoidal rule). The share of the integrator is then of second
order, like the motion.

This rule applies to friction only if the thread continues to slide in the same direction and ε is
zero. Otherwise the friction force jumps, and the work of the force at the end is never negative. If
a hand draws the thread through a hole, by a length or with a force, −Φ_sᵀλ Δs is the work of the
hand and is external.
"""

from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Flags
from coupling.kernels.holes import driving_force, hold_at
from coupling.kernels.iteration import Found, Given, Knots, Passing, add_momentum, pass_hold
from thread.kernels.loops import entry, loop, owning
from thread.kernels.records import record

# Energy turnover of the thread in a step, in this order [J]: kinetic and elastic energy at its end; the works of
# external forces, of friction and of damping; the loss by the integrator without the change of the elastic energy; the
# remainder of the constraints' work; and the additional loss by the integrator compared with backward Euler, from the
# two-step formula and from the mean of the forces at both ends.
KINETIC, ELASTIC, EXTERNAL, FRICTION, VISCOUS, NUMERICAL, REMAINDER, TWO_STEP, BY_MEAN = range(9)
TURNS = 9
# Energy turnover of the organ in a step, as in `tissue.organs.meshed.OrganEnergies`, and the part of
# BODY_NUMERICAL that is due to the mean of the forces at both ends [J].
BODY_KINETIC, BODY_ELASTIC, BODY_LOADS, BODY_VISCOUS, BODY_NUMERICAL, BODY_RUBBED, BODY_BY_MEAN = range(7)
BODY = 7


@record
class Motion(NamedTuple):
    """A state of thread and holds, as `coupling.system.State`.

    `f_y` (m, 9) are the forces on the sites. `U`, `V`, `A` (n,) are the motion of the organ's
    modes. `drift` (1,) are the largest forces so far. If knots travel, `drive` (m,) [N] is −∂Π/∂s.
    All arrays are consecutive parts of `numbers`.
    """

    q: Array
    v: Array
    N: Array
    s: Array
    s_dot: Array
    lam: Array
    y: Array
    sigma: Array
    sense: Array
    reaction: Array
    stretch: Array
    f_y: Array
    U: Array
    V: Array
    A: Array
    drift: Array
    drive: Array
    numbers: Array


class Works(NamedTuple):
    """The data of a step for the audit.

    - `damping` [1/s].
    - `a` [1/s²]: factor of the time scheme.
    - `at` (n, c): reference q_a of the inertia.
    - `two_step`: whether the scheme uses the two earlier states.
    - `more` (2, 3) [N]: excess of the loads on both ends at the start of the step over those at its
      end.
    """

    damping: float
    a: float
    at: Array
    two_step: bool
    more: Array


class Holes(NamedTuple):
    """The data of the holds for the audit, shape `(m,)` each.

    - `rough`: holds with friction.
    - `by_hand`: holds at which a hand draws the thread.
    - `slides`: holds that slide with their own inertia, ε s̈ = `inertia` (s − `s_free`).
    - `epsilon`: ε [kg].
    - `rides`: whether knots travel.
    """

    rough: Flags
    by_hand: Flags
    slides: Flags
    inertia: Array
    s_free: Array
    epsilon: float
    rides: bool


class OnThread(NamedTuple):
    """Forces on the control points at the end of a step, shape `(n, c)` each [N].

    - `elastic`, `load`: elastic forces and loads.
    - `balance`: the sum of all forces; at `held` unknowns it is the force of the holders.
    - `push` (n, 3): forces of the holes.
    - `moved`, `faster`, `momentum`: M Δq, M Δv and M v.
    - `v_old` [m/s]: velocity at the start of the step, on the knots of its end.
    """

    elastic: Array
    load: Array
    balance: Array
    held: Flags
    push: Array
    moved: Array
    faster: Array
    momentum: Array
    v_old: Array


class Met(NamedTuple):
    """The thread at the holes at the start of a step (`was`) and at its end (`now`)."""

    was: Passing
    now: Passing


@loop
def drive_in(motion: Motion, holes: Holes, at: Passing, k: int) -> float:
    """Return the driving force Φ_sᵀλ at hold k of a state [N]."""
    return driving_force(hold_at(at.D[k], holes.rides, at.drive[k], motion.lam[k], motion.y[k]))


@loop
def pass_holds(knots: Knots, given: Given, now: Motion, at: Passing) -> None:
    """Evaluate the thread at its holes."""
    for k in range(len(now.s)):
        pass_hold(knots, given, now.q, now.s[k], k, at)


@loop
def product(a: Array, b: Array) -> float:
    """Return the sum of the products of the entries of two arrays (n, c)."""
    total = 0.0
    for i in range(a.shape[0]):
        for x in range(a.shape[1]):
            total += a[i, x] * b[i, x]
    return total


@loop
def work_along(force: Array, old: Array, new: Array) -> float:
    """Return the work of forces (n, c) along the way from one place to another [J]."""
    work = 0.0
    for i in range(force.shape[0]):
        for x in range(force.shape[1]):
            work += force[i, x] * (new[i, x] - old[i, x])
    return work


@loop
def outside_work(on: OnThread, old: Array, new: Array) -> float:
    """Return the work of the loads and of the holders of the ends from places `old` to `new` [J].

    The reactions of the holders are the balance at the prescribed unknowns.
    """
    work = work_along(on.load, old, new)
    for i in range(old.shape[0]):
        for x in range(old.shape[1]):
            if on.held[i, x]:
                work += on.balance[i, x] * (new[i, x] - old[i, x])
    return work


@loop
def more_outside(works: Works, held: Flags, old: Motion, new: Motion) -> float:
    """Return the excess of external work with the loads and holders of the start over that with
    those of the end [J].
    """
    work = 0.0
    for end in range(2):
        i = end * (len(old.q) - 1)
        for x in range(old.q.shape[1]):
            more = works.more[end, x] if x < works.more.shape[1] else 0.0
            if held[i, x]:
                more += old.reaction[end, x] - new.reaction[end, x]
            work += more * (new.q[i, x] - old.q[i, x])
    return work


@loop
def audit_sliding(
    works: Works, holes: Holes, old: Motion, new: Motion, k: int, drives: tuple[float, float], out: Array
) -> None:
    """Add the work of sliding at hold k to `out`.

    It is friction or the work of hands, the dissipation of ε, and the remainder of the constraints'
    work. After BDF2, the difference due to the mean of the driving forces is added. `drives` [N]
    are the driving forces Φ_sᵀλ at both ends of the step.
    """
    ds, drive, ideal = new.s[k] - old.s[k], drives[1], 0.0
    if holes.slides[k]:
        ideal = holes.inertia[k] * (new.s[k] - holes.s_free[k])
    out[NUMERICAL] += ideal * ds - 0.5 * holes.epsilon * (new.s_dot[k] ** 2 - old.s_dot[k] ** 2)
    if not holes.rides:  # if knots travel, Φ does not depend on s
        out[REMAINDER] -= drive * ds
    for j in range(9):
        out[REMAINDER] -= new.f_y[k, j] * (new.y[k, j] - old.y[k, j])
    goes_on = holes.rough[k] and old.sigma[k] == new.sigma[k] and holes.epsilon == 0.0
    more = 0.5 * (drives[0] - drive) * ds if works.two_step and (holes.by_hand[k] or goes_on) else 0.0
    out[BY_MEAN] -= more
    if holes.by_hand[k]:
        out[EXTERNAL] -= (drive - ideal) * ds + more
    else:
        out[FRICTION] += (drive - ideal) * ds + more


@loop
def kinetic_energy(v: Array, momentum: Array, s_dot: Array, epsilon: float) -> float:
    """Return ½ vᵀ M v of the thread plus ½ ε ṡ² of eq. 7 [J]."""
    energy = 0.5 * product(v, momentum)
    for k in range(len(s_dot)):
        energy += 0.5 * epsilon * s_dot[k] ** 2
    return energy


@loop
def audit_inertia(works: Works, on: OnThread, new: Motion, out: Array) -> None:
    """Add the losses by damping and by the integrator's inertia to `out`."""
    taken = works.damping * product(new.v, on.moved)
    out[NUMERICAL] += 0.5 * work_along(on.faster, on.v_old, new.v)
    if works.two_step:
        out[TWO_STEP] += works.a * work_along(on.moved, works.at, new.q) - product(new.v, on.faster)
        more = -0.5 * works.damping * work_along(on.moved, on.v_old, new.v)
        out[BY_MEAN] -= more
        taken += more
    out[VISCOUS] += taken


@loop
def audit_step(works: Works, holes: Holes, on: OnThread, old: Motion, new: Motion, met: Met, out: Array) -> None:
    """Add the energy turnover of the thread in a step to `out` (9,) [J].

    The elastic energy at the end of the step is already in `out`.
    """
    out[KINETIC] += kinetic_energy(new.v, on.momentum, new.s_dot, holes.epsilon)
    out[EXTERNAL] += outside_work(on, old.q, new.q)
    out[NUMERICAL] += work_along(on.elastic, old.q, new.q)
    out[REMAINDER] -= work_along(on.push, old.q, new.q)
    for k in range(len(new.s)):
        drives = drive_in(old, holes, met.was, k), drive_in(new, holes, met.now, k)
        audit_sliding(works, holes, old, new, k, drives, out)
    audit_inertia(works, on, new, out)
    if works.two_step:
        more = 0.5 * more_outside(works, on.held, old, new)
        out[EXTERNAL] += more
        out[BY_MEAN] += more


@owning
def audit_march(
    knots: Knots, given: Given, works: Works, holes: Holes, r: Found, old: Motion, new: Motion, met: Met, out: Array
) -> None:
    """Write the energy turnover of a thread with stretch and bending in a step to `out`; `r` is the
    residual at its end.
    """
    moved, faster, none = np.zeros(new.q.shape), np.zeros(new.q.shape), np.zeros(new.q.shape)
    momentum = np.zeros(new.q.shape)
    add_momentum(knots.mass, 1.0, new.q, old.q, moved)
    add_momentum(knots.mass, 1.0, new.v, old.v, faster)
    add_momentum(knots.mass, 1.0, new.v, none, momentum)
    on = OnThread(r.elastic, given.load, r.balance, given.held, r.push, moved, faster, momentum, old.v)
    audit_step(works, holes, on, old, new, met, out)


@loop
def book(turns: Array, body: Array, energies: Array, out: Array) -> None:
    """Write the energies after a step into `out` (9,), in the order of `coupling.reports.audit.Energies`.

    They follow from the energies before the step and the turnover of thread and organ, `body` (7,).
    The last one is the loan: energy taken by this step that the next step can return.
    """
    kinetic, external = turns[KINETIC] + body[BODY_KINETIC], turns[EXTERNAL] + body[BODY_LOADS]
    viscous = turns[VISCOUS] + body[BODY_VISCOUS]
    friction, two_step = turns[FRICTION] + body[BODY_RUBBED], turns[TWO_STEP] + turns[BY_MEAN]
    numerical = turns[NUMERICAL] + turns[REMAINDER] + two_step - (turns[ELASTIC] - energies[1])
    numerical += body[BODY_NUMERICAL]
    change = kinetic - energies[0] + turns[ELASTIC] - energies[1] + body[BODY_ELASTIC] - energies[2]
    out[0], out[1], out[2] = kinetic, turns[ELASTIC], body[BODY_ELASTIC]
    out[3] = energies[3] + external
    out[4] = energies[4] + friction
    out[5] = energies[5] + viscous
    out[6] = energies[6] + numerical
    out[7] = energies[7] + (external - change - friction - viscous - numerical)
    out[8] = numerical - 2.0 * (two_step + body[BODY_BY_MEAN])


audit, enter, kinetic = entry(audit_step), entry(book), entry(kinetic_energy)  # for Python
