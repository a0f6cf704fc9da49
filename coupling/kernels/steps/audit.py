"""What a step of the thread turns over (`coupling.reports.audit`)."""

from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Flags
from coupling.kernels.band import solve_dense
from coupling.kernels.curve import Curve, Stretched, point
from coupling.kernels.friction import Law
from coupling.kernels.holes import Hold, driving_force, held_energy, hold_at, turned_compliance
from coupling.kernels.iteration import Found, Given, Knots, Passing, Unknowns, add_momentum, pass_hold
from coupling.kernels.loops import loop, owning
from coupling.kernels.vectors import dot

# What a step of the thread turns over, in this order [J]: kinetic and elastic energy at its end; the works from
# outside, of friction and of damping; what the integrator took, but for the change of the elastic energy; `layer_work`;
# what of NUMERICAL is by looking back over two steps, and by the mean of the forces at both ends.
KINETIC, ELASTIC, EXTERNAL, FRICTION, VISCOUS, NUMERICAL, LAYERED, TWO_STEP = range(8)
TURNS = 8


class Motion(NamedTuple):
    """A state of thread and holds, as `coupling.system.State`; `layers` are infinite where there is no tension, and
    `f_y` (m, 9) the forces on the sites. Of modes of the organ `U`, `V`, `A` (n,) and what their check leaves open so
    far, or the largest forces, `drift` (1,)."""

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


class Works(NamedTuple):
    """What the audit reads of thread and step: `damping` [1/s], ε [kg], number of `piercings`; holds that are `rough`;
    factor `d` [1/s] of the velocity, reference q_a `at` (n, 3) of the inertia and its factor `a` [1/s²]; whether the
    step looks back over two (`two_step`), and if so by how much more the loads on both ends are at its start, `more`
    (2, 3) [N]; and the part of a compliance with less of which a hole does not bear its exchange in place, `borne`."""

    damping: float
    epsilon: float
    piercings: int
    rough: Flags
    a: float
    at: Array
    two_step: bool
    more: Array
    borne: float


@loop
def hold_in(motion: Motion, directed: Flags, at: Passing, k: int) -> Hold:
    """Return hold k of a state."""
    return hold_at(at.D[k], at.c[k], directed[k], False, motion.lam[k], motion.y[k])


@loop
def pass_holds(knots: Knots, given: Given, z: Unknowns, at: Passing) -> None:
    """Evaluate the thread at its holes, and what it lacks there by what is known of that now."""
    for k in range(len(z.s)):
        pass_hold(knots, given, z, k, at)


@loop
def elastic_energy(curve: Curve, at: Stretched) -> float:
    """Return the energy of stretch and bending [J]."""
    energy = 0.0
    for e in range(len(curve.first)):
        for g in range(curve.w.shape[1]):
            T, K = point(at.T, e, g), point(at.K, e, g)
            a, b, c = dot(T, T), dot(T, K), dot(K, K)
            crushed = max(0.5 * (1.0 - a), 0.0) ** 4
            energy += curve.w[e, g] * (curve.EI * ((a * c - b * b) / a**2) + curve.EA * crushed)
        for g in range(curve.axial_w.shape[1]):
            energy += curve.EA * curve.axial_w[e, g] * at.strain[e, g] ** 2
    return 0.5 * energy


@loop
def product(a: Array, b: Array) -> float:
    """Return the sum of the products of the entries of two arrays (n, 3)."""
    total = 0.0
    for i in range(len(a)):
        for x in range(3):
            total += a[i, x] * b[i, x]
    return total


@loop
def work_along(force: Array, old: Array, new: Array) -> float:
    """Return the work of forces (n, 3) on the way from one place to another [J]."""
    work = 0.0
    for i in range(len(force)):
        for x in range(3):
            work += force[i, x] * (new[i, x] - old[i, x])
    return work


@loop
def layer_work(
    works: Works, given: Given, old: Motion, new: Motion, was: Passing, now: Passing, mid: Array, back: Array
) -> float:
    """Return what the compliance of the holes takes in as √(EI/T) is taken anew [J]; `mid` (m, 4) is what the spline
    lacks where the holes were by the new one, `back` where they are by the old one."""
    if works.two_step or not bears_all(works, given, old, was, mid):
        return exchange_between(given, old, new, was, now, mid, back)
    work = 0.0
    for k in range(len(mid)):
        if is_exchanged(given, was, mid, k):
            work += exchange_in_place(hold_in(old, given.directed, was, k), given.rows[k], mid[k])
    return work


@loop
def is_exchanged(given: Given, was: Passing, mid: Array, k: int) -> bool:
    """Whether the compliance of hold k is taken anew, and the hold imposes anything."""
    other, imposed = False, False
    for j in range(mid.shape[1]):
        other |= was.c[k, 0, j] != mid[k, j]
    for j in range(5):
        imposed |= given.rows[k, j]
    return other and imposed


@loop
def bears_all(works: Works, given: Given, old: Motion, was: Passing, mid: Array) -> bool:
    """Whether all holds whose compliance is taken anew bear that (`coupling.reports.audit.bears`)."""
    for k in range(len(mid)):
        if is_exchanged(given, was, mid, k):
            c0, c1, c2, one = mid[k, 0], mid[k, 1], mid[k, 2], hold_in(old, given.directed, was, k)
            own = c0 * turned_compliance(one, c2, mid[k, 3]) - (c1 * one.size) ** 2
            turns = not given.directed[k] or own > works.borne * c0 * c2
            if not (c0 > works.borne * was.c[k, 0, 0] and turns):
                return False
    return True


@loop
def exchange_between(
    given: Given, old: Motion, new: Motion, was: Passing, now: Passing, mid: Array, back: Array
) -> float:
    """Return the work of an exchange between both ends of a step [J]."""
    work = 0.0
    for k in range(len(mid)):
        one, other = hold_in(old, given.directed, was, k), hold_in(new, given.directed, now, k)
        c0, c1 = lets_go(was, mid, back, now, k, 0), lets_go(was, mid, back, now, k, 1)
        c2, c3 = lets_go(was, mid, back, now, k, 2), lets_go(was, mid, back, now, k, 3)
        turned = c2 + c3 * (0.5 * (one.share + other.share) - 1.0)
        mixed = 0.5 * (one.size + other.size) * (dot(one.lam, other.m) + dot(other.lam, one.m))
        work += c0 * dot(one.across, other.across) + c1 * mixed + turned * dot(one.m, other.m)
    return 0.25 * work


@loop
def lets_go(was: Passing, mid: Array, back: Array, now: Passing, k: int, j: int) -> float:
    """Return by how much the compliance number `j` of hold k falls, at both ends of the step together."""
    return was.c[k, 0, j] - mid[k, j] + (back[k, j] - now.c[k, 0, j])


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
    they are, where its constraints `rows` (5,) are in force [J]."""
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
def outside_work(given: Given, r: Found, old: Motion, new: Motion) -> float:
    """Return the work of the loads and of the holders of the ends [J]."""
    work = work_along(given.load, old.q, new.q)
    for i in range(len(old.q)):
        for x in range(3):
            if given.held[i, x]:
                work += r.balance[i, x] * (new.q[i, x] - old.q[i, x])
    return work


@loop
def more_outside(works: Works, given: Given, old: Motion, new: Motion) -> float:
    """Return what the loads and holders at the start of a step would do along it more than those at its end [J]."""
    work = 0.0
    for end in range(2):
        i = end * (len(old.q) - 1)
        for x in range(3):
            more = works.more[end, x]
            if given.held[i, x]:
                more += old.reaction[end, x] - new.reaction[end, x]
            work += more * (new.q[i, x] - old.q[i, x])
    return work


@loop
def audit_sliding(
    works: Works, law: Law, given: Given, r: Found, old: Motion, new: Motion, was: Passing, now: Passing, out: Array
) -> None:
    """Add what sliding takes to `out`: friction, ε's own dissipation and the remainder of the constraints' work, and
    after BDF2 by how much more the mean of the driving forces takes."""
    remainder = -work_along(r.push, old.q, new.q)
    for k in range(len(new.s)):
        ds, one, other = new.s[k] - old.s[k], hold_in(old, given.directed, was, k), hold_in(new, given.directed, now, k)
        drive, ideal = driving_force(other), 0.0
        if law.may_slide[k]:
            ideal = law.inertia[k] * (new.s[k] - law.s_free[k])
        out[FRICTION] += (drive - ideal) * ds
        remainder += ideal * ds - 0.5 * works.epsilon * (new.s_dot[k] ** 2 - old.s_dot[k] ** 2) - drive * ds
        if k < works.piercings:
            for j in range(9):
                remainder -= r.f_y[k, j] * (new.y[k, j] - old.y[k, j])
        if works.two_step and works.rough[k] and old.sigma[k] == new.sigma[k] and works.epsilon == 0.0:
            more = 0.5 * (driving_force(one) - drive) * ds
            out[FRICTION] += more
            out[TWO_STEP] -= more
    out[NUMERICAL] += remainder


@owning
def audit_inertia(works: Works, mass: Array, old: Motion, new: Motion, out: Array) -> None:
    """Add kinetic energy, what damping takes and what the integrator takes of the inertia to `out`."""
    moved, faster, none = np.zeros(new.q.shape), np.zeros(new.q.shape), np.zeros(new.q.shape)
    momentum = np.zeros(new.q.shape)
    add_momentum(mass, 1.0, new.q, old.q, moved)
    add_momentum(mass, 1.0, new.v, old.v, faster)
    add_momentum(mass, 1.0, new.v, none, momentum)
    out[KINETIC] = 0.5 * product(new.v, momentum)
    for k in range(len(new.s)):
        out[KINETIC] += 0.5 * works.epsilon * new.s_dot[k] ** 2
    taken = works.damping * product(new.v, moved)
    out[NUMERICAL] += 0.5 * work_along(faster, old.v, new.v)
    if works.two_step:
        out[TWO_STEP] += works.a * work_along(moved, works.at, new.q) - product(new.v, faster)
        more = -0.5 * works.damping * work_along(moved, old.v, new.v)
        out[TWO_STEP] -= more
        taken += more
    out[VISCOUS] += taken


@loop
def audit_step(
    curve: Curve, knots: Knots, law: Law, given: Given, works: Works, r: Found,
    old: Motion, new: Motion, was: Passing, mid: Array, back: Array, out: Array,
) -> None:  # fmt: skip
    """Write what a step of the thread turns over into `out` (8,) [J]: its kinetic and elastic energy at the end, the
    works of the step and what the integrator took but for the change of the elastic energy, the work of layers, and
    what BDF2 took by itself.
    `was`, `mid` and `back` are as for `layer_work`."""
    for i in range(len(out)):
        out[i] = 0.0
    now = Passing(r.first, r.b, r.D, r.c)
    out[ELASTIC] = elastic_energy(curve, Stretched(r.T, r.K, r.T_axial, r.strain))
    for k in range(len(new.s)):
        h = hold_in(new, given.directed, now, k)
        out[ELASTIC] += held_energy(h, 0)
    out[EXTERNAL] = outside_work(given, r, old, new)
    out[NUMERICAL] = work_along(r.elastic, old.q, new.q)
    out[LAYERED] = layer_work(works, given, old, new, was, now, mid, back)
    audit_sliding(works, law, given, r, old, new, was, now, out)
    audit_inertia(works, knots.mass, old, new, out)
    if works.two_step:
        more = 0.5 * more_outside(works, given, old, new)
        out[EXTERNAL] += more
        out[TWO_STEP] += more
    out[NUMERICAL] += out[TWO_STEP]
