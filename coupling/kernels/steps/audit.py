"""The energy audit of a step: every joule of work goes somewhere, each place by its own formula.

Dot the thread's equation with Δq and the organ's with ΔU. With Φ = 0 at both ends of the step the constraints' work
is what the driving force Φ_sᵀλ takes through the hole, −Φ_sᵀλ Δs, plus a remainder of second order in the step, which
belongs to the integrator. Backward Euler dissipates ½Δvᵀ M Δv, and of the elastic energy ∂E(q⁺)·Δq − ΔE. Under BDF2,
a⁺ ≠ Δv/Δt and Δq ≠ Δt v⁺, and the inertia takes a⁺ᵀMΔq − v⁺ᵀMΔv more, of either sign. All these works are those of the
forces at the end of the step along it, a rectangle rule of first order; what separates it from the exact work stands
with the integrator's share. After a step of BDF2 and after a load step the works from outside, of damping and of
friction in steady sliding are those of the mean of the forces at both ends, the trapezoidal rule, and so the share of
the integrator is of second order as the motion is. Friction counts so where the thread slides on, the same way and
without ε: elsewhere its force jumps, and what the force at the end takes is never negative. Where a hand draws the
thread through a hole, by a length or with a force, −Φ_sᵀλ Δs is its work, and external.
"""

from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Flags
from coupling.kernels.holes import driving_force, hold_at
from coupling.kernels.iteration import Found, Given, Knots, Passing, Unknowns, add_momentum, pass_hold
from thread.kernels.loops import entry, loop, owning

# What a step of the thread turns over, in this order [J]: kinetic and elastic energy at its end; the works from
# outside, of friction and of damping; what the integrator took, but for the change of the elastic energy; the remainder
# of the constraints' work; and what the integrator took more than backward Euler would, by looking back over two steps
# and by the mean of the forces at both ends.
KINETIC, ELASTIC, EXTERNAL, FRICTION, VISCOUS, NUMERICAL, REMAINDER, TWO_STEP, BY_MEAN = range(9)
TURNS = 9
# What a step of the organ turns over, as in `coupling.interfaces.OrganEnergies`, and what of BODY_NUMERICAL is by the
# mean of the forces at both ends [J].
BODY_KINETIC, BODY_ELASTIC, BODY_LOADS, BODY_VISCOUS, BODY_NUMERICAL, BODY_RUBBED, BODY_BY_MEAN = range(7)
BODY = 7


class Motion(NamedTuple):
    """A state of thread and holds, as `coupling.system.State`; `f_y` (m, 9) are the forces on the sites. Of modes of
    the organ `U`, `V`, `A` (n,) and what their check leaves open so far, or the largest forces, `drift` (1,). Where
    knots travel −∂Π/∂s, `drive` (m,) [N]. All of them lie one after the other in `numbers`."""

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
    """What the audit reads of a step: `damping` [1/s]; factor `a` [1/s²] of its scheme and the reference q_a `at`
    (n, c) of the inertia; whether it looks back over two (`two_step`), and if so by how much more the loads on both
    ends are at its start, `more` (2, 3) [N]."""

    damping: float
    a: float
    at: Array
    two_step: bool
    more: Array


class Holes(NamedTuple):
    """What the audit reads of the holds, (m,) each: those that are `rough`, those where a hand has the thread, and
    those where it `slides` by an inertia of its own: ε s̈ = `inertia` (s − `s_free`); `epsilon`, ε [kg]; and whether
    the knots ride with the holes (`rides`)."""

    rough: Flags
    by_hand: Flags
    slides: Flags
    inertia: Array
    s_free: Array
    epsilon: float
    rides: bool


class OnThread(NamedTuple):
    """What acts on the control points at the end of a step, (n, c) each [N]: forces that are `elastic`, of the `load`,
    of all together, `balance`, which the holders bear where unknowns are `held`, and of the holes, `push` (n, 3); and
    M Δq, `moved`, M Δv, `faster`, M v, `momentum`."""

    elastic: Array
    load: Array
    balance: Array
    held: Flags
    push: Array
    moved: Array
    faster: Array
    momentum: Array


class Met(NamedTuple):
    """The thread at the holes, as it `was` at the start of a step and is `now` at its end."""

    was: Passing
    now: Passing


@loop
def drive_in(motion: Motion, holes: Holes, at: Passing, k: int) -> float:
    """Return the driving force Φ_sᵀλ at hold k of a state [N]."""
    return driving_force(hold_at(at.D[k], holes.rides, at.drive[k], motion.lam[k], motion.y[k]))


@loop
def pass_holds(knots: Knots, given: Given, z: Unknowns, at: Passing) -> None:
    """Evaluate the thread at its holes."""
    for k in range(len(z.s)):
        pass_hold(knots, given, z, k, at)


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
    """Return the work of forces (n, c) on the way from one place to another [J]."""
    work = 0.0
    for i in range(force.shape[0]):
        for x in range(force.shape[1]):
            work += force[i, x] * (new[i, x] - old[i, x])
    return work


@loop
def outside_work(on: OnThread, old: Array, new: Array) -> float:
    """Return the work of the loads and of the holders of the ends, whose reactions are the balance at the prescribed
    unknowns, from places `old` to `new` [J]."""
    work = work_along(on.load, old, new)
    for i in range(old.shape[0]):
        for x in range(old.shape[1]):
            if on.held[i, x]:
                work += on.balance[i, x] * (new[i, x] - old[i, x])
    return work


@loop
def more_outside(works: Works, held: Flags, old: Motion, new: Motion) -> float:
    """Return what the loads and holders at the start of a step would do along it more than those at its end [J]."""
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
    """Add what sliding takes at hold k to `out`, under the driving forces Φ_sᵀλ at both ends of a step, `drives` [N]:
    friction or the work of hands, ε's own dissipation and the remainder of the constraints' work; and after BDF2 by how
    much more the mean of the driving forces takes."""
    ds, drive, ideal = new.s[k] - old.s[k], drives[1], 0.0
    if holes.slides[k]:
        ideal = holes.inertia[k] * (new.s[k] - holes.s_free[k])
    out[NUMERICAL] += ideal * ds - 0.5 * holes.epsilon * (new.s_dot[k] ** 2 - old.s_dot[k] ** 2)
    if not holes.rides:  # else Φ does not depend on s
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
    """Return ½ vᵀ M v of the thread, and ½ ε ṡ² of eq. 7 [J]."""
    energy = 0.5 * product(v, momentum)
    for k in range(len(s_dot)):
        energy += 0.5 * epsilon * s_dot[k] ** 2
    return energy


@loop
def audit_inertia(works: Works, on: OnThread, old: Motion, new: Motion, out: Array) -> None:
    """Add what damping takes and what the integrator takes of the inertia to `out`."""
    taken = works.damping * product(new.v, on.moved)
    out[NUMERICAL] += 0.5 * work_along(on.faster, old.v, new.v)
    if works.two_step:
        out[TWO_STEP] += works.a * work_along(on.moved, works.at, new.q) - product(new.v, on.faster)
        more = -0.5 * works.damping * work_along(on.moved, old.v, new.v)
        out[BY_MEAN] -= more
        taken += more
    out[VISCOUS] += taken


@loop
def audit_step(works: Works, holes: Holes, on: OnThread, old: Motion, new: Motion, met: Met, out: Array) -> None:
    """Add what a step of the thread turns over to `out` (9,) [J], in which the elastic energy of the thread itself at
    its end stands already."""
    out[KINETIC] += kinetic_energy(new.v, on.momentum, new.s_dot, holes.epsilon)
    out[EXTERNAL] += outside_work(on, old.q, new.q)
    out[NUMERICAL] += work_along(on.elastic, old.q, new.q)
    out[REMAINDER] -= work_along(on.push, old.q, new.q)
    for k in range(len(new.s)):
        drives = drive_in(old, holes, met.was, k), drive_in(new, holes, met.now, k)
        audit_sliding(works, holes, old, new, k, drives, out)
    audit_inertia(works, on, old, new, out)
    if works.two_step:
        more = 0.5 * more_outside(works, on.held, old, new)
        out[EXTERNAL] += more
        out[BY_MEAN] += more


@owning
def audit_march(
    knots: Knots, given: Given, works: Works, holes: Holes, r: Found, old: Motion, new: Motion, met: Met, out: Array
) -> None:
    """Write what a step of a thread of stretch and bending, which ended at a residual `r`, turns over into `out`."""
    moved, faster, none = np.zeros(new.q.shape), np.zeros(new.q.shape), np.zeros(new.q.shape)
    momentum = np.zeros(new.q.shape)
    add_momentum(knots.mass, 1.0, new.q, old.q, moved)
    add_momentum(knots.mass, 1.0, new.v, old.v, faster)
    add_momentum(knots.mass, 1.0, new.v, none, momentum)
    on = OnThread(r.elastic, given.load, r.balance, given.held, r.push, moved, faster, momentum)
    audit_step(works, holes, on, old, new, met, out)


@loop
def book(turns: Array, body: Array, energies: Array, out: Array) -> None:
    """Write the energies after a step into `out` (9,), as `coupling.reports.audit.Energies`, from those before it
    and what thread and organ, `body` (7,), turned over. The last of them is what the step took only to give back."""
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


audit, enter, kinetic = entry(audit_step), entry(book), entry(kinetic_energy)  # as Python calls them
