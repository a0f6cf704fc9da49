"""The energy audit of a step: every joule of work goes somewhere, each place by its own formula.

Dot the thread's equation with Δq and the organ's with ΔU. With Φ = 0 at both ends of the step the constraints' work
is what the driving force Φ_sᵀλ takes through the hole, −Φ_sᵀλ Δs, plus a remainder of second order in the step, which
belongs to the integrator. Backward Euler dissipates ½Δvᵀ M Δv, and of the elastic energy ∂E(q⁺)·Δq − ΔE. Under BDF2,
a⁺ ≠ Δv/Δt and Δq ≠ Δt v⁺, and the inertia takes a⁺ᵀMΔq − v⁺ᵀMΔv more, of either sign. All these works are those of the
forces at the end of the step along it, a rectangle rule of first order; what separates it from the exact work stands
with the integrator's share. After a step of BDF2 the works from outside, of damping and of a friction that goes on are
those of the mean of the forces at both ends, the trapezoidal rule, and so the integrator's share is of second order as
its motion is. Friction counts so where the thread slides on, the same way and without ε: elsewhere its force jumps, and
what the force at the end takes is never negative. Where a hand draws the thread through a hole, by a length or with a
force, −Φ_sᵀλ Δs is its work, and external.

A step has the compliance c of the holes as a number, by its √(EI/T), and there is no path from the one before to it.
Before a step of backward Euler c is exchanged in place. Between both ends it is under BDF2, whose other works are means
of both, at rest, where load steps are long and the sum over them is to be of second order, and where c⁺ does not bear a
hole in place.
"""

from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Flags
from coupling.kernels.band import solve_dense
from coupling.kernels.holes import Hold, driving_force, held_energy, hold_at, turned_compliance
from coupling.kernels.iteration import Found, Given, Knots, Passing, Unknowns, add_momentum, pass_hold
from thread.kernels.loops import entry, loop, owning
from thread.kernels.vectors import dot

# What a step of the thread turns over, in this order [J]: kinetic and elastic energy at its end; the works from
# outside, of friction and of damping; what the integrator took, but for the change of the elastic energy; the remainder
# of the constraints' work; that of exchanged compliances; and what the integrator took more than backward Euler would,
# by looking back over two steps and by the mean of the forces at both ends.
KINETIC, ELASTIC, EXTERNAL, FRICTION, VISCOUS, NUMERICAL, REMAINDER, LAYERED, TWO_STEP, BY_MEAN = range(10)
TURNS = 10
# What a step of the organ turns over, as in `coupling.interfaces.OrganEnergies`, and what of BODY_NUMERICAL is by the
# mean of the forces at both ends [J].
BODY_KINETIC, BODY_ELASTIC, BODY_LOADS, BODY_VISCOUS, BODY_NUMERICAL, BODY_RUBBED, BODY_BY_MEAN = range(7)
BODY = 7


class Motion(NamedTuple):
    """A state of thread and holds, as `coupling.system.State`; `layers` are infinite where there is no tension, and
    `f_y` (m, 9) the forces on the sites. Of modes of the organ `U`, `V`, `A` (n,) and what their check leaves open so
    far, or the largest forces, `drift` (1,). Where knots travel −∂Π/∂s, `drive` (m,) [N]."""

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
    layers: Array
    stretch: Array
    f_y: Array
    U: Array
    V: Array
    A: Array
    drift: Array
    drive: Array


class Works(NamedTuple):
    """What the audit reads of a step: `damping` [1/s]; factor `a` [1/s²] of its scheme and the reference q_a `at`
    (n, c) of the inertia; whether it looks back over two (`two_step`), and if so by how much more the loads on both
    ends are at its start, `more` (2, 3) [N]; whether √(EI/T) is exchanged `between` its ends, not in place; and the
    part of a compliance with less of which a hole does not bear its exchange in place, `borne`."""

    damping: float
    a: float
    at: Array
    two_step: bool
    more: Array
    between: bool
    borne: float


class Holes(NamedTuple):
    """What the audit reads of the holds, (m,) each: constraints in force, `rows` (m, 5), and `directed`; those that are
    `rough`, those where a hand has the thread, and those where it `slides` by an inertia of its own: ε s̈ = `inertia`
    (s − `s_free`); `epsilon`, ε [kg]; and whether the knots ride with the holes (`rides`)."""

    rows: Flags
    directed: Flags
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
    """The thread at the holes, as it `was` at the start of a step and is `now` at its end, and what the spline would
    lack, (m, 4), by the √(EI/T) of the end at the start, `mid`, and by that of the start at the end, `back`."""

    was: Passing
    now: Passing
    mid: Array
    back: Array


@loop
def hold_in(motion: Motion, holes: Holes, at: Passing, k: int) -> Hold:
    """Return hold k of a state."""
    D, c, directed, bare = at.D[k], at.c[k], holes.directed[k], holes.rides
    return hold_at(D, c, directed, bare, holes.rides, at.drive[k], motion.lam[k], motion.y[k])


@loop
def pass_holds(knots: Knots, given: Given, z: Unknowns, at: Passing) -> None:
    """Evaluate the thread at its holes, and what it lacks there by what is known of that now."""
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
def is_exchanged(holes: Holes, met: Met, k: int) -> bool:
    """Whether the compliance of hold k is taken anew, and the hold imposes anything."""
    other, imposed = False, False
    for j in range(met.mid.shape[1]):
        other |= met.was.c[k, 0, j] != met.mid[k, j]
    for j in range(5):
        imposed |= holes.rows[k, j]
    return other and imposed


@loop
def bears(h: Hold, after: Array, borne: float) -> bool:
    """Whether c⁺, `after` (4,), takes up by forces of the size of those at a hold what the hold is off the drawn
    thread: at a knot a spline without tension lacks nothing under a force. Less of it than a part `borne` does not."""
    c0, c1, c2 = after[0], after[1], after[2]
    own = c0 * turned_compliance(h, c2, after[3]) - (c1 * h.size) ** 2
    return c0 > borne * h.c0[0] and (not h.directed or own > borne * c0 * c2)


@loop
def exchange_between(one: Hold, other: Hold, met: Met, k: int) -> float:
    """Return ½λ⁻(c⁻ − c⁺)λ⁺ [J] of hold k, as it is at the start and at the end of a step: the work of a c that goes
    from c⁻ to c⁺ on any path under a constant force, as in a constant place."""
    c0, c1, c2, c3 = lets_go(met, k, 0), lets_go(met, k, 1), lets_go(met, k, 2), lets_go(met, k, 3)
    turned = c2 + c3 * (0.5 * (one.share + other.share) - 1.0)
    mixed = 0.5 * (one.size + other.size) * (dot(one.lam, other.m) + dot(other.lam, one.m))
    return 0.25 * (c0 * dot(one.across, other.across) + c1 * mixed + turned * dot(one.m, other.m))


@loop
def lets_go(met: Met, k: int, j: int) -> float:
    """Return by how much the compliance number `j` of hold k falls, at both ends of the step together."""
    return met.was.c[k, 0, j] - met.mid[k, j] + (met.back[k, j] - met.now.c[k, 0, j])


@loop
def by_multipliers(h: Hold, c0: float, c1: float, turning: float, C: Array) -> None:
    """Write ∂Φ/∂λ of a hold that lacks c₀, c₁ and, by its couple, `turning` into `C` (5, 5)."""
    arm = c1 * h.size
    for i in range(3):
        for j in range(3):
            C[i, j] = -c0 * h.unit[i] * h.unit[j]
        C[i, i] += c0
        C[i, 3] = C[3, i] = arm * h.u[i]
        C[i, 4] = C[4, i] = arm * h.v[i]
    C[3, 3], C[4, 4] = turning * dot(h.u, h.u), turning * dot(h.v, h.v)
    C[3, 4] = C[4, 3] = turning * dot(h.u, h.v)


@owning
def exchange_in_place(h: Hold, rows: Flags, after: Array) -> float:
    """Return the work of exchanging what the spline lacks at a hold for `after` (4,) while thread and hole stay where
    they are, where its constraints `rows` (5,) are in force [J].

    Backward Euler goes downhill in a potential that has c⁺ all along, from where the thread is. There the hole is met
    under another force λ*: with C = ∂Φ/∂λ, C⁺λ* = C⁻λ. That stores ½λ*ᵀC⁺λ* − ½λᵀC⁻λ = ½λᵀ(C⁻ − C⁺)λ* more; what
    the step then loses is never negative where the potential is convex. The spline lacks nothing along the thread,
    where λ* is λ.
    """
    before_C, C, free, M = np.zeros((5, 5)), np.zeros((5, 5)), np.zeros((5, 5)), np.zeros((5, 6))
    by_multipliers(h, h.c0[0], h.c1[0], turned_compliance(h, h.c2[0], h.c3[0]), before_C)
    by_multipliers(h, after[0], after[1], turned_compliance(h, after[2], after[3]), C)
    lam = (h.lam[0], h.lam[1], h.lam[2], h.mu_u, h.mu_v)
    let_go, held = np.zeros(5), after[0] if after[0] > 0.0 else 1.0
    for i in range(5):
        free[i, i] = 1.0 if rows[i] else 0.0
        for j in range(5):
            let_go[i] += (before_C[i, j] - C[i, j]) * lam[j]
            if i < 3 and j < 3 and rows[0]:
                free[i, j] -= h.unit[i] * h.unit[j]
    for i in range(5):
        for j in range(5):
            M[i, j] = held * ((1.0 if i == j else 0.0) - free[i, j])
            M[i, 5] += free[i, j] * let_go[j]
            for one in range(5):
                for other in range(5):
                    M[i, j] += free[i, one] * C[one, other] * free[other, j]
    if not solve_dense(M):
        return np.nan
    work = 0.0
    for i in range(5):
        work += 0.5 * let_go[i] * (lam[i] + M[i, 5])
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
def audit_holes(works: Works, holes: Holes, old: Motion, new: Motion, met: Met, out: Array) -> None:
    """Add what the holes store, what sliding takes, and what the compliance takes in as √(EI/T) is taken anew."""
    between, in_place, borne = 0.0, 0.0, not works.between
    for k in range(len(new.s)):
        one, other = hold_in(old, holes, met.was, k), hold_in(new, holes, met.now, k)
        out[ELASTIC] += held_energy(other, 0)
        audit_sliding(works, holes, old, new, k, (driving_force(one), driving_force(other)), out)
        between += exchange_between(one, other, met, k)
        if borne and is_exchanged(holes, met, k):
            borne = bears(one, met.mid[k], works.borne)
            in_place += exchange_in_place(one, holes.rows[k], met.mid[k]) if borne else 0.0
    out[LAYERED] += in_place if borne else between


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
    """Add what a step of the thread turns over to `out` (10,) [J], in which the elastic energy of the thread itself at
    its end stands already."""
    out[KINETIC] += kinetic_energy(new.v, on.momentum, new.s_dot, holes.epsilon)
    out[EXTERNAL] += outside_work(on, old.q, new.q)
    out[NUMERICAL] += work_along(on.elastic, old.q, new.q)
    out[REMAINDER] -= work_along(on.push, old.q, new.q)
    audit_holes(works, holes, old, new, met, out)
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
    """Write the energies after a step into `out` (10,), as `coupling.reports.audit.Energies`, from those before it
    and what thread and organ, `body` (7,), turned over. The last of them is what the step took only to give back."""
    layered, kinetic = turns[LAYERED], turns[KINETIC] + body[BODY_KINETIC]
    external, viscous = turns[EXTERNAL] + body[BODY_LOADS], turns[VISCOUS] + body[BODY_VISCOUS]
    friction, two_step = turns[FRICTION] + body[BODY_RUBBED], turns[TWO_STEP] + turns[BY_MEAN]
    numerical = turns[NUMERICAL] + turns[REMAINDER] + two_step - (turns[ELASTIC] - energies[1] - layered)
    numerical += body[BODY_NUMERICAL]
    change = kinetic - energies[0] + turns[ELASTIC] - energies[1] + body[BODY_ELASTIC] - energies[2]
    out[0], out[1], out[2] = kinetic, turns[ELASTIC], body[BODY_ELASTIC]
    out[3] = energies[3] + external
    out[4] = energies[4] + friction
    out[5] = energies[5] + viscous
    out[6] = energies[6] + numerical
    out[7] = energies[7] + (external + layered - change - friction - viscous - numerical)
    out[8] = energies[8] + layered
    out[9] = numerical - 2.0 * (two_step + body[BODY_BY_MEAN])


audit, enter, kinetic = entry(audit_step), entry(book), entry(kinetic_energy)  # as Python calls them
