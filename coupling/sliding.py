"""The law of sliding at a hole: the one scalar equation per piercing that fixes its abscissa.

With t = T̂/|T̂| the tangent of the thread as it is met, f = Φ_sᵀλ/|T̂| the driving force along the thread and N the force
that presses it on the hole:

    ideal hole     ε s̈ = Φ_sᵀλ                      (eq. 7; eq. 6 at ε = 0)
    stick          s = s_old,            |f| ≤ F₀ + μ_s N
    drawn          s = s_old − Δd        a hand draws the length Δd through the hole, whatever it takes
    slip           f = σ (F₀ + μ_k N),   σ = sign(ds/dt)

N = |λ_n| of a hole without length, λ_n the part of λ across the thread (§4.3). A channel of length ℓ_c that imposes the
direction presses at both its ends: each bears half of λ_n, and the couple t × m, m = μ_u u + μ_v v, is a force m/ℓ_c at
the one and −m/ℓ_c at the other, so

    N = |λ_n/2 + m/ℓ_c| + |λ_n/2 − m/ℓ_c|

which is max(|λ_n|, 2|m|/ℓ_c) where both lie in a plane with the thread. The thread's velocity relative to the hole is
v_t = −|T̂| ds/dt, so friction dissipates (F₀ + μ_k N)|T̂||ds/dt|.

Which of stick and slip holds is an active set, σ ∈ {−1, 0, 1} a hold. It changes only between solved iterates: one on
the way has forces that mean nothing, and where μ_k < μ_s both may hold, so that a wrong change would stand.

A friction found elsewhere (the two-pass algorithm of §4.3) enters as a given force instead: f = `injected`.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from coupling.border import AT_K, AT_T, BORDER, LAM, MU_U, MU_V, Border, S, U, V, by_multipliers
from coupling.constraints import Array, Passage, dot, driving_force, held_energy, met, moment_arm, phi_s, tangent
from coupling.system import Flags, System


@dataclass(frozen=True)
class Law:
    """What the law of sliding needs beside the iterate, over `m` holds.

    `s_old` (m,) [m]; `s_held` (m,) [m], where a thread that does not slide is at the end of the step; `static`,
    `kinetic`, `grip`, `per_channel` (m,); `inertia` = ε a [N/m] and `s_free` (m,) [m] make
    ε s̈ = inertia (s − s_free); `rough` and `may_slide` (m,); `injected` (m,) [N], a given force along the thread where
    it slides, beside the friction of the rough holds.
    """

    s_old: Array
    s_held: Array
    static: Array
    kinetic: Array
    grip: Array
    per_channel: Array
    rough: Flags
    may_slide: Flags
    inertia: float
    s_free: Array
    injected: Array

    @cached_property
    def ideal(self) -> bool:
        """Whether no force but that of ε acts along the thread."""
        return not (self.rough.any() or self.injected.any())


def law_of(
    system: System, s_old: Array, present: Flags, inertia: float, s_free: Array, drawn: Array | float = 0.0
) -> Law:
    """The law at the start of a step in which lengths `drawn` (m,) [m] are drawn through; an absent hold keeps its
    abscissa."""
    none = np.zeros(len(s_old))
    s_held = s_old - drawn * present
    return Law(s_old, s_held, *system.friction, system.rough, system.may_slide & present, inertia, s_free, none)


def prescribed(law: Law, held: Flags, injected: Array) -> Law:
    """The law with its friction given: fixed points where `held`, elsewhere sliding points under the force `injected`
    (m,) [N] of the hole on the thread along t."""
    smooth = np.zeros_like(law.rough)
    return replace(law, rough=smooth, may_slide=law.may_slide & ~held, injected=injected)


def bearing(lam: Array, y: Array, per_channel: Array) -> Array:
    """λ/2 ± m/ℓ_c, the force of each end of the channel on the thread, shape `(2, m, 3)` [N]."""
    half, couple = 0.5 * lam[:, :3], per_channel[:, None] * moment_arm(lam, y)
    return np.stack([half + couple, half - couple])


def pressing(force: Array, t: Array) -> Array:
    """The part of forces `(2, m, 3)` across the unit tangents `t` (m, 3)."""
    return force - dot(force, t)[..., None] * t


def normal_force(thread: Passage, lam: Array, y: Array, per_channel: Array) -> Array:
    """N = |λ_n/2 + m/ℓ_c| + |λ_n/2 − m/ℓ_c|, what presses the thread on the hole; |λ_n| without a channel, shape `(m,)`
    [N]."""
    ends = pressing(bearing(lam, y, per_channel), tangent(thread, lam, y)[1])
    return np.asarray(np.linalg.norm(ends, axis=2).sum(axis=0))


def net_drive(law: Law, thread: Passage, s: Array, lam: Array, y: Array) -> Array:
    """Φ_sᵀλ − ε s̈, shape `(m,)` [N]."""
    return driving_force(thread, lam, y) - law.inertia * (s - law.s_free)


def along(law: Law, thread: Passage, s: Array, lam: Array, y: Array) -> Array:
    """f, the driving force along the unit tangent, shape `(m,)` [N]."""
    return np.asarray(net_drive(law, thread, s, lam, y) / tangent(thread, lam, y)[0])


def static_bound(law: Law, thread: Passage, lam: Array, y: Array) -> Array:
    """F₀ + μ_s N, shape `(m,)` [N]."""
    return np.asarray(law.grip + law.static * normal_force(thread, lam, y, law.per_channel))


def kinetic_bound(law: Law, thread: Passage, lam: Array, y: Array) -> Array:
    """F₀ + μ_k N, shape `(m,)` [N]."""
    return np.asarray(law.grip + law.kinetic * normal_force(thread, lam, y, law.per_channel))


def admissible(law: Law, slip: Array) -> Array:
    """The active set made to fit the holds: an ideal hole slides, one that may not slide sticks, shape `(m,)`."""
    return np.where(law.may_slide, np.where(law.rough, slip, 1.0), 0.0)


def next_slip(law: Law, slip: Array, thread: Passage, s: Array, lam: Array, y: Array, margin: float) -> Array:
    """Active set after a solved iterate: a stuck point slips when f leaves the static cone by more than the `margin`
    [N] of the solve, a slipping one sticks when it moved against its own friction. Shape `(m,)`, in {−1, 0, 1}."""
    if not law.rough.any():
        return admissible(law, slip)
    f = along(law, thread, s, lam, y)
    from_stick = np.where(np.abs(f) > static_bound(law, thread, lam, y) + margin, np.sign(f), 0.0)
    from_slip = np.where(slip * (s - law.s_old) < 0.0, 0.0, slip)
    return admissible(law, np.where(slip == 0.0, from_stick, from_slip))


def cone_residual(law: Law, slip: Array, thread: Passage, s: Array, lam: Array, y: Array) -> Array:
    """By how much the force along the thread breaks Coulomb's law, shape `(m,)` [N], zero where it is obeyed.

    Stick: what |f| exceeds F₀ + μ_s N by; slip: how far f is from σ (F₀ + μ_k N). Zero for a hold without friction.
    """
    f = along(law, thread, s, lam, y)
    stuck = np.maximum(np.abs(f) - static_bound(law, thread, lam, y), 0.0)
    slipping = np.abs(f - slip * kinetic_bound(law, thread, lam, y))
    return np.where(law.rough & law.may_slide, np.where(slip == 0.0, stuck, slipping), 0.0)


def residual(law: Law, slip: Array, thread: Passage, s: Array, lam: Array, y: Array) -> Array:
    """Left-hand side of the law, shape `(m,)`: [N] where the thread slides, [m] where it is held."""
    drive = net_drive(law, thread, s, lam, y)
    if law.ideal:
        return np.where(slip == 0.0, s - law.s_held, drive)
    given = law.injected + law.rough * slip * kinetic_bound(law, thread, lam, y)
    return np.where(slip == 0.0, s - law.s_held, drive - tangent(thread, lam, y)[0] * given)


def linearise_law(border: Border, law: Law, slip: Array, thread: Passage, lam: Array, y: Array) -> None:
    """Write the row of s into a border under construction."""
    arm, force = moment_arm(lam, y), lam[:, :3]
    row_T, row = force.copy(), np.zeros((len(lam), BORDER))
    d_phi, T_s = phi_s(thread, lam, y), met(thread, lam, y, 1)[1]
    row[:, LAM], row[:, MU_U], row[:, MU_V] = d_phi[:, :3], d_phi[:, 3], d_phi[:, 4]
    row[:, U], row[:, V] = lam[:, 3:4] * T_s, lam[:, 4:5] * T_s
    row[:, S] = dot(force, thread.K) + dot(arm, thread.J) + held_energy(thread, lam, y, 2) - law.inertia
    if not law.ideal:
        row_T += add_friction(row, law, slip, thread, lam, y)
    sliding = (slip != 0.0)[:, None]
    held = np.zeros((1, BORDER))
    held[0, S] = 1.0
    border.B[:, S, AT_T], border.B[:, S, AT_K] = row_T * sliding, arm * sliding
    border.D[:, S] = np.where(sliding, row, held)


def add_friction(row: Array, law: Law, slip: Array, thread: Passage, lam: Array, y: Array) -> Array:
    """Subtract the derivative of |T̂|(injected + σ(F₀ + μ_k N)) from the row of s; its part by T, `(m, 3)`, is
    returned, what T̂ owes to the other unknowns added to the row as well."""
    size, t = tangent(thread, lam, y)
    ends = bearing(lam, y, law.per_channel)
    normal = unit(pressing(ends, t))
    sigma = slip * law.rough
    given = law.injected + sigma * kinetic_bound(law, thread, lam, y)
    by_T = (sigma * law.kinetic)[:, None] * (dot(ends, t)[..., None] * normal).sum(axis=0) - given[:, None] * t
    by_force = -(0.5 * sigma * size * law.kinetic)[:, None] * (normal[0] + normal[1])
    by_m = -(sigma * size * law.kinetic * law.per_channel)[:, None] * (normal[0] - normal[1])
    row[:, LAM] += by_force
    row[:, MU_U] += dot(by_m, y[:, 3:6])
    row[:, MU_V] += dot(by_m, y[:, 6:])
    row[:, U] += lam[:, 3:4] * by_m
    row[:, V] += lam[:, 4:5] * by_m
    row += np.vecmat(by_T, by_multipliers(thread.c[:, 0], lam, y)[1])
    row[:, S] += dot(by_T, met(thread, lam, y, 1)[1])
    return by_T


def unit(a: Array) -> Array:
    """Vectors along the last axis divided by their lengths; one of zero length stays zero."""
    return np.asarray(a / np.maximum(np.linalg.norm(a, axis=-1, keepdims=True), np.finfo(float).tiny))
