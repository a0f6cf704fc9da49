"""The law of sliding at a hole: the one scalar equation per piercing that fixes its abscissa.

With t = T̂/|T̂| the tangent of the thread as it is met, f = Φ_sᵀλ/|T̂| the driving force along the thread and N the force
that presses it on the hole:

    ideal hole     ε s̈ = Φ_sᵀλ                      (eq. 7; eq. 6 at ε = 0)
    stick          s = s_old,            |f| ≤ F₀ + μ_s N
    drawn          s = s_old − Δd        a hand draws the length Δd through the hole, whatever it takes
    pulled         f = F                 a hand draws with the force F, whatever it takes to hold that
    slip           f = σ (F₀ + μ_k N),   σ = sign(ds/dt)

N = |λ_n| of a hole without length, λ_n the part of λ across the thread (§4.3). A channel of length ℓ_c that imposes the
direction presses at both its ends: each bears half of λ_n, and the couple t × m, m = μ_u u + μ_v v, is a force m/ℓ_c at
the one and −m/ℓ_c at the other, so

    N = |λ_n/2 + m/ℓ_c| + |λ_n/2 − m/ℓ_c|

which is max(|λ_n|, 2|m|/ℓ_c) where both lie in a plane with the thread. The thread's velocity relative to the hole is
v_t = −|T̂| ds/dt, so friction dissipates (F₀ + μ_k N)|T̂||ds/dt|.

Φ_sᵀλ is what changes over the hole of the force conjugate to s, T + T²/2EA of a strand under the tension T: the
difference of the tensions times 1 + T̄/EA, T̄ their mean, and that is |T̂| of a thread that is resolved. On spans longer
than √(EI/T) the spline rounds the corner at a direction that is imposed, and |T| is less there: |T̂| of such a hole is
that of the tensions of its strands at the start of the step, at rest at the end (`coupling.step.tension.stretches_at`).

Both bounds have a law of one's own added where a hole has one, F₀ + μN + F(N) (`coupling.interfaces.FrictionLaw`).

Which of stick and slip holds is an active set, σ ∈ {−1, 0, 1} a hold. It changes only between solved iterates: one on
the way has forces that mean nothing, and where μ_k < μ_s both may hold, so that a wrong change would stand.

A tie that slides does so as one (`coupling.ties`): its strands have two equations together, joined from those above. So
have the first and the last hole of a loop that hands draw, who keep the knot where it is between them, and of one that
is tied in holes without friction: nothing else keeps it from running round in them.

That force enters as a given one, f = `injected`. So does a friction found elsewhere (the two-pass algorithm of §4.3).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.interfaces import Body, FrictionLaw
from coupling.kernels.bordered import (
    AT_K,
    AT_T,
    BORDER,
    LAM,
    MU_U,
    MU_V,
    NO_JOINTS,
    Border,
    S,
    U,
    V,
    lacking_force_rate,
    tilting_rates,
)
from coupling.kernels.constraints import (
    Parts,
    Passage,
    driving_force,
    effective_place,
    force_on_tangent,
    held_energy,
    lacking_force,
    parts,
    phi_s,
    shrinkage,
    tangent,
    tilt_of,
)
from coupling.system import System
from coupling.ties import in_pairs
from thread.vectors import cross, dot


@dataclass(frozen=True)
class Law:
    """What the law of sliding needs besides the iterate, over `m` holds.

    `s_old` (m,) [m]; `s_held` (m,) [m], where a thread that does not slide is at the end of the step; `static`,
    `kinetic`, `grip`, `per_channel` (m,); `inertia` = ε a [N/m], of all holds or of each, and `s_free` (m,) [m] make
    ε s̈ = inertia (s − s_free), and c ds/dt of a tie that is drawn; `rough` and `may_slide` (m,); `injected` (m,) [N],
    a given force along the thread where it slides, added to the friction of the rough holds; `stretch` (m,) [-], |T̂| of
    the holds that impose a direction where the spline lacks compliance; `strands` (t, 2) of ties
    in force; `loops` (k, 2), first and last hole of those that slide in them as one; `by_hand` (m,), where hands draw;
    `own`, the law of one's own of each hold, None or empty where there is none; `factor`, by which all friction is
    multiplied.
    """

    s_old: Array
    s_held: Array
    static: Array
    kinetic: Array
    grip: Array
    per_channel: Array
    rough: Flags
    may_slide: Flags
    inertia: float | Array
    s_free: Array
    injected: Array
    stretch: Array
    strands: Indices = field(default_factory=lambda: NO_JOINTS.strands)
    loops: Indices = field(default_factory=lambda: NO_JOINTS.strands)
    by_hand: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    own: tuple[FrictionLaw | None, ...] = ()
    factor: float = 1.0

    @cached_property
    def pairs(self) -> Indices:
        """Holds that slide as one, shape `(k, 2)`."""
        return np.concatenate([self.strands, self.loops])

    @cached_property
    def ideal(self) -> bool:
        """Whether no force but that of ε acts along the thread."""
        return not (self.rough.any() or self.injected.any())


def law_of(
    system: System[Body],
    s_old: Array,
    present: Flags,
    inertia: float | Array,
    s_free: Array,
    drawn: Array | float = 0.0,
    pulls: Array | float = 0.0,
    time: float = np.inf,
    stretch: Array | None = None,
) -> Law:
    """Return the law at the start of a step, at `time` [s], in which lengths `drawn` (m,) [m] are drawn through, and at
    whose end hands pull with the forces `pulls` (m,) [N], of a thread with the `stretch` (m,) [-], else 1; an absent
    hold keeps its abscissa. Without a time no tie is drawn."""
    drawn_ties, (by_length, by_force) = system.drawn_ties(time), system.in_hand(time)
    in_hand, tied = by_length | by_force, system.of_ties & ~drawn_ties
    rough = system.rough & ~drawn_ties & ~in_hand
    may_slide = system.may_slide & present & (rough | ~tied) & ~by_length
    injected = np.asarray(pulls * (present & ~tied & (by_force | system.of_ties)), dtype=np.float64)
    strands = system.strands[present[system.strands].all(axis=1)]
    loops = joined_loops(system, s_old, present, drawn_ties, in_hand)
    by_hand, s_held, own = in_hand | drawn_ties, s_old - drawn * (present & by_length), system.own_friction
    taut = np.ones(len(s_old)) if stretch is None else stretch
    return Law(
        s_old, s_held, *system.friction, rough, may_slide, inertia, s_free, injected, taut, strands, loops, by_hand, own
    )


def joined_loops(system: System[Body], s: Array, present: Flags, drawn_ties: Flags, in_hand: Flags) -> Indices:
    """Return the first and the last hole of every closed loop that slides in them as one, shape `(k, 2)`: a loop that
    hands draw, or that is tied in holes without friction. `drawn_ties` (m,), strands that are drawn;
    `in_hand` (m,), holes at which a hand has the thread.

    A loop that is held in a hole runs round in none, nor does one that friction in one of these two holds back.
    """
    out, p = [], len(system.piercings)
    slides, rough = (system.may_slide & ~in_hand)[:p], system.rough[:p]
    for tie, strands in zip(system.ties, system.strands, strict=True):
        within, pair = present[:p] & (s[:p] > s[strands[0]]) & (s[:p] < s[strands[1]]), list(tie.between)
        alike = rough[pair[0]] == rough[pair[1]] if drawn_ties[strands[0]] else not rough[within].any()
        if present[strands].all() and within[pair].all() and slides[within].all() and alike:
            out.append(tie.between)
    return np.array(out, dtype=np.intp).reshape(-1, 2)


def prescribed(law: Law, held: Flags, injected: Array) -> Law:
    """Return the law with its friction given: fixed points where `held`, elsewhere sliding points under the force
    `injected` (m,) [N] of the hole on the thread along t, in addition to that of a hand."""
    smooth = np.zeros_like(law.rough)
    return replace(law, rough=smooth, may_slide=law.may_slide & ~held, injected=law.injected + injected)


def side_by_side(law: Law, times: int) -> Law:
    """Return the law of the same holds so many times, one after the other, as if nothing tied one to another."""
    return Law(
        s_old=np.tile(law.s_old, times),
        s_held=np.tile(law.s_held, times),
        static=np.tile(law.static, times),
        kinetic=np.tile(law.kinetic, times),
        grip=np.tile(law.grip, times),
        per_channel=np.tile(law.per_channel, times),
        rough=np.tile(law.rough, times),
        may_slide=np.tile(law.may_slide, times),
        inertia=np.tile(np.broadcast_to(law.inertia, law.s_old.shape), times),
        s_free=np.tile(law.s_free, times),
        injected=np.tile(law.injected, times),
        stretch=np.tile(law.stretch, times),
        own=law.own * times,
        factor=law.factor,
    )


def channel_forces(lam: Array, y: Array, per_channel: Array) -> Array:
    """Return λ/2 ± m/ℓ_c, the force of each end of the channel on the thread, shape `(2, m, 3)` [N]."""
    half, couple = 0.5 * lam[:, :3], per_channel[:, None] * force_on_tangent(lam, y)
    return np.stack([half + couple, half - couple])


def part_across(force: Array, t: Array) -> Array:
    """Return the part of forces `(2, m, 3)` across the unit tangents `t` (m, 3)."""
    return force - dot(force, t)[..., None] * t


def normal_force(thread: Passage, lam: Array, y: Array, per_channel: Array) -> Array:
    """Return N = |λ_n/2 + m/ℓ_c| + |λ_n/2 − m/ℓ_c|, what presses the thread on the hole, shape `(m,)` [N]; |λ_n|
    without a channel."""
    ends = part_across(channel_forces(lam, y, per_channel), tangent(thread, lam, y)[1])
    return np.asarray(np.linalg.norm(ends, axis=2).sum(axis=0))


def net_drive(law: Law, thread: Passage, s: Array, lam: Array, y: Array) -> Array:
    """Return Φ_sᵀλ − ε s̈, shape `(m,)` [N]."""
    return driving_force(thread, lam, y) - law.inertia * (s - law.s_free)


def stretch_met(law: Law, thread: Passage, lam: Array, y: Array) -> Array:
    """Return |T̂|, how long the thread is at each hole per rest length, shape `(m,)` [-]."""
    size = tangent(thread, lam, y)[0]
    return size if thread.bare else np.where(thread.directed, law.stretch, size)


def force_along_thread(law: Law, thread: Passage, s: Array, lam: Array, y: Array) -> Array:
    """Return f, the driving force along the unit tangent, shape `(m,)` [N]."""
    return np.asarray(net_drive(law, thread, s, lam, y) / stretch_met(law, thread, lam, y))


def static_bound(law: Law, thread: Passage, lam: Array, y: Array) -> Array:
    """Return F₀ + μ_s N, with a law of one's own more, shape `(m,)` [N]."""
    N = normal_force(thread, lam, y, law.per_channel)
    return np.asarray(law.factor * (law.grip + law.static * N + by_own_law(law, "static", N)))


def kinetic_bound(law: Law, thread: Passage, lam: Array, y: Array) -> Array:
    """Return F₀ + μ_k N, with a law of one's own more, shape `(m,)` [N]."""
    N = normal_force(thread, lam, y, law.per_channel)
    return np.asarray(law.factor * (law.grip + law.kinetic * N + by_own_law(law, "kinetic", N)))


def kinetic_slope(law: Law, N: Array) -> Array:
    """Return the derivative of `kinetic_bound` by the normal forces N `(m,)` [N], shape `(m,)` [-]."""
    return np.asarray(law.factor * (law.kinetic + by_own_law(law, "slope", N)))


def by_own_law(law: Law, part: str, N: Array) -> Array:
    """Return "static", "kinetic" [N] or "slope" [-] of the holds' own laws under the normal forces N `(m,)` [N], zero
    of a hold without one, shape `(m,)`."""
    out = np.zeros(N.size)
    for k, own in enumerate(law.own):
        if own is not None:
            out[k] = getattr(own, part)(float(N[k]))
    return out


def admissible_sigma(law: Law, sigma: Array) -> Array:
    """Fit the active set to the holds: an ideal hole slides, one that may not slide sticks, and those that slide as one
    do so against one another, shape `(m,)`."""
    fitted = np.where(law.may_slide, np.where(law.rough, sigma, 1.0), 0.0)
    fitted[law.pairs[:, 1]] = -fitted[law.pairs[:, 0]]
    return fitted


def next_sigma(law: Law, sigma: Array, thread: Passage, s: Array, lam: Array, y: Array, margin: float) -> Array:
    """Return the active set after a solved iterate, shape `(m,)`, in {−1, 0, 1}. A stuck point slips when f leaves
    the static cone by more than the `margin` [N] of the solve; a slipping one sticks when it moved against its own
    friction. Holds that slide as one are judged together, by |T̂| f and its bound as their equation has them."""
    if not law.rough.any():
        return admissible_sigma(law, sigma)
    f, bound = judged_forces(law, thread, s, lam, y)
    from_stick = np.where(np.abs(f) > bound + margin, np.sign(f), 0.0)
    from_slip = np.where(sigma * (s - law.s_old) < 0.0, 0.0, sigma)
    return admissible_sigma(law, np.where(sigma == 0.0, from_stick, from_slip))


def judged_forces(law: Law, thread: Passage, s: Array, lam: Array, y: Array) -> tuple[Array, Array]:
    """Return f and the bound F₀ + μ_s N by which a stuck point is judged, shape `(m,)` each [N]."""
    f, bound = force_along_thread(law, thread, s, lam, y), static_bound(law, thread, lam, y)
    if not law.pairs.size:
        return f, bound
    size = stretch_met(law, thread, lam, y)
    size = size / in_pairs(law.pairs, size)
    return in_pairs(law.pairs, size * f, -1.0), in_pairs(law.pairs, size * bound)


def cone_residual(law: Law, sigma: Array, thread: Passage, s: Array, lam: Array, y: Array) -> Array:
    """Return by how much the force along the thread breaks Coulomb's law, shape `(m,)` [N], zero where it is obeyed.

    Stick: what |f| exceeds F₀ + μ_s N by; slip: how far f is from σ (F₀ + μ_k N). Zero for a hold without friction.
    """
    f = force_along_thread(law, thread, s, lam, y)
    stuck = np.maximum(np.abs(f) - static_bound(law, thread, lam, y), 0.0)
    slipping = np.abs(f - sigma * kinetic_bound(law, thread, lam, y))
    return np.where(law.rough & law.may_slide, np.where(sigma == 0.0, stuck, slipping), 0.0)


def residual(law: Law, sigma: Array, thread: Passage, s: Array, lam: Array, y: Array) -> Array:
    """Return the left-hand side of the law, shape `(m,)`: [N] where the thread slides, [m] where it is held."""
    drive = net_drive(law, thread, s, lam, y)
    if not law.ideal:
        given = law.injected + law.rough * sigma * kinetic_bound(law, thread, lam, y)
        drive = drive - stretch_met(law, thread, lam, y) * given
    out = np.where(sigma == 0.0, s - law.s_held, drive)
    one, other = sliding_strands(law, sigma)
    out[other] -= out[one]
    out[one] = (s - law.s_old)[one] + (s - law.s_old)[other]
    return out


def sliding_strands(law: Law, sigma: Array) -> tuple[Indices, Indices]:
    """Return the holds that slide as one, at which ties that slide hold their strands and loops go through their holes,
    shape `(k,)` each. The equation of the first says that their abscissae have the same sum, that of the second is the
    difference of both."""
    one, other = law.pairs[sigma[law.pairs[:, 0]] != 0.0].T
    return one, other


def in_metres(law: Law, sigma: Array) -> Flags:
    """Return where the left-hand side of the law is a length, shape `(m,)`."""
    lengths = sigma == 0.0
    lengths[sliding_strands(law, sigma)[0]] = True
    return lengths


def linearise_law(border: Border, law: Law, sigma: Array, thread: Passage, lam: Array, y: Array) -> None:
    """Write the row of s into a border under construction."""
    row_T, row_K, row = lam[:, :3].copy(), force_on_tangent(lam, y), np.zeros((len(lam), BORDER))
    d_phi, T_s = phi_s(thread, lam, y), effective_place(thread, lam, y, 1)[1]
    row[:, LAM], row[:, MU_U], row[:, MU_V] = d_phi[:, :3], d_phi[:, 3], d_phi[:, 4]
    row[:, U], row[:, V] = lam[:, 3:4] * T_s, lam[:, 4:5] * T_s
    row[:, S] = dot(row_T, thread.K) + dot(row_K, thread.J) + held_energy(thread, lam, y, 2) - law.inertia
    if not thread.bare:
        turn = add_turning(row, thread, lam, y)
        row_T, row_K = row_T + turn[0], row_K + turn[1]
    if not law.ideal:
        friction = add_friction(row, law, sigma, thread, lam, y)
        row_T, row_K = row_T + friction[0], row_K + friction[1]
    sliding = (sigma != 0.0)[:, None]
    held = np.zeros((1, BORDER))
    held[0, S] = 1.0
    border.B[:, S, AT_T], border.B[:, S, AT_K] = row_T * sliding, row_K * sliding
    border.D[:, S] = np.where(sliding, row, held)


def add_turning(row: Array, thread: Passage, lam: Array, y: Array) -> tuple[Array, Array]:
    """Add the slope of the missing compliance's share in the driving force by the axis that it acts across and by the
    frame; its parts by T and T', each `(m, 3)`, are returned."""
    by_T, by_K = lacking_force_rate(thread, lam, y), lacking_force(thread, lam, y)
    by_u, by_v = tilting_rates(thread, lam, y)
    row[:, U] += by_u
    row[:, V] += by_v
    row[:, S] += dot(by_T + lacking_force(thread, lam, y, 1), thread.K) + dot(by_K, thread.J)
    return by_T, by_K


def add_friction(row: Array, law: Law, sigma: Array, thread: Passage, lam: Array, y: Array) -> tuple[Array, Array]:
    """Subtract the derivative of |T̂|(injected + σ(F₀ + μ_k N)) from the row of s; its parts by T and T', each `(m, 3)`,
    are returned."""
    size, t = stretch_met(law, thread, lam, y), tangent(thread, lam, y)[1]
    ends = channel_forces(lam, y, law.per_channel)
    normal = unit_or_zero(part_across(ends, t))
    rough_sigma = sigma * law.rough
    given = law.injected + rough_sigma * kinetic_bound(law, thread, lam, y)
    N = np.linalg.norm(part_across(ends, t), axis=2).sum(axis=0)
    press = rough_sigma * size * kinetic_slope(law, N)
    by_m = -(press * law.per_channel)[:, None] * (normal[0] - normal[1])
    row[:, LAM] -= (0.5 * press)[:, None] * (normal[0] + normal[1])
    row[:, MU_U] += dot(by_m, y[:, 3:6])
    row[:, MU_V] += dot(by_m, y[:, 6:])
    row[:, U] += lam[:, 3:4] * by_m
    row[:, V] += lam[:, 4:5] * by_m
    by_t = press[:, None] * (dot(ends, t)[..., None] * normal).sum(axis=0)
    return add_tangent(row, thread, lam, y, -given, by_t)


def add_tangent(row: Array, thread: Passage, lam: Array, y: Array, by_size: Array, by_t: Array) -> tuple[Array, Array]:
    """Add `by_size` (m,) times the derivative of |T̂| and `by_t` (m, 3), across t, times that of t to the row of s; the
    parts by T and T', each `(m, 3)`, are returned."""
    size, t = tangent(thread, lam, y)
    by_T, by_K = by_size[:, None] * t + by_t / size[:, None], np.zeros_like(t)
    if not thread.bare:
        directed = thread.directed[:, None]
        by_axis = by_t / tilt_of(thread, y).area * directed
        row[:, U] += cross(y[:, 6:], by_axis)
        row[:, V] += cross(by_axis, y[:, 3:6])
        by_T, by_K = add_effective_tangent(row, thread, parts(thread, lam), by_T * ~directed)
    row[:, S] += dot(by_T, thread.K) + dot(by_K, thread.J)
    return by_T, by_K


def add_effective_tangent(row: Array, thread: Passage, part: Parts, by: Array) -> tuple[Array, Array]:
    """Add `by` (m, 3) times the derivative of T̂ of free holes by λ and by s where T, T' are held to the row of s; the
    parts by T and T', each `(m, 3)`, are returned."""
    c0, c1, T, K = thread.c[:, :2, 0], thread.c[:, :2, 1], thread.T, thread.K
    per_square = dot(by, T) / dot(T, T)
    bend = per_square * dot(part.across, K)
    by_across = c1[:, :1] * by - (c0[:, 0] * per_square)[:, None] * K
    lengthwise = dot(by_across, part.unit)
    crosswise = by_across - lengthwise[:, None] * part.unit
    row[:, LAM] += crosswise
    row[:, S] += c1[:, 1] * dot(by, part.across) - c0[:, 1] * bend
    turned = (lengthwise[:, None] * part.across + part.along[:, None] * crosswise) / part.size[:, None]
    stretched = (2.0 * c0[:, 0] * bend / dot(T, T))[:, None] * T
    by_K = -(c0[:, 0] * per_square)[:, None] * part.across
    return shrinkage(thread, part)[:, None] * by + stretched - turned, by_K


def unit_or_zero(a: Array) -> Array:
    """Divide vectors along the last axis by their lengths; one of zero length stays zero."""
    return np.asarray(a / np.maximum(np.linalg.norm(a, axis=-1, keepdims=True), np.finfo(float).tiny))
