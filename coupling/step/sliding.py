"""The law of sliding at a hole: one scalar equation per piercing that determines its abscissa.

With the tangent t = T/|T| of the thread, the driving force f = Φ_sᵀλ/|T| along it, and the force N
that presses it on the hole:

    ideal hole     ε s̈ = Φ_sᵀλ                      (eq. 7; eq. 6 at ε = 0)
    stick          s = s_old,            |f| ≤ F₀ + μ_s N
    drawn          s = s_old − Δd        a hand draws the length Δd through the hole with any force
    pulled         f = F                 a hand draws with the force F at any speed
    slip           f = σ (F₀ + μ_k N),   σ = sign(ds/dt)
    barb           F₀ + σ B in place of F₀ on both sides: the grip depends on the sense

For a hole without length N = |λ_n|, where λ_n is the part of λ across the thread (§4.3). A channel
of length ℓ_c that imposes the direction presses at both its ends. Each end bears half of λ_n. The
couple t × m, m = μ_u u + μ_v v, is a force m/ℓ_c at one end and −m/ℓ_c at the other, so that

    N = |λ_n/2 + m/ℓ_c| + |λ_n/2 − m/ℓ_c|

This is max(|λ_n|, 2|m|/ℓ_c) if both lie in a plane with the thread. The thread's velocity relative
to the hole is v_t = −|T| ds/dt, so that friction dissipates (F₀ + μ_k N)|T||ds/dt|.

Φ_sᵀλ is the jump over the hole of the force conjugate to s, which is T + T²/2EA of a strand under
the tension T. The jump is the difference of the tensions times 1 + T̄/EA with their mean T̄.
Travelling knots leave a corner at a hole that is smaller than the adjacent spans. With these knots
|T| is replaced by 1 + T̄/EA, with the tensions at the start of the step, at rest at the end
(`coupling.step.tension.stretches_at`).

A user's law of friction is added to both bounds, F₀ + μN + F(N)
(`coupling.interfaces.FrictionLaw`).

Stick and slip are an active set, with σ ∈ {−1, 0, 1} per hold. Newton's method changes it only
between solved iterates. The forces of an unsolved iterate have no meaning, and for μ_k < μ_s both
stick and slip can be valid, so that a wrong change would remain. A way downhill knows the forces
that hold the sites, and changes the set on the way (`coupling.step.descent`).

A tie slides as one (`coupling.ties`): its two strands have two joined equations instead of those
above. The same holds for the first and the last hole of two kinds of loops. A loop that hands draw
has them because the hands keep the place of the knot between the two holes. A loop that is tied in
holes without friction has them because it could otherwise slide round in the holes.

The force of hands is a given one, f = `injected`. A friction from another algorithm (the two
passes of §4.3) is given in the same way.
"""

from typing import Any

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.interfaces import Body, FrictionLaw
from coupling.kernels.bordered import NO_JOINTS
from coupling.kernels.constraints import Passage, held_at
from coupling.kernels.friction import Joints, Law, Ruled, fit, rule
from coupling.system import System
from thread.riding import plain

Own = tuple[FrictionLaw | None, ...]  # user's law of friction of each hold, None for a hold without one


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
    """Return the law at the start of a step at `time` [s].

    Lengths `drawn` (m,) [m] are drawn through the holes, and hands pull with the forces `pulls`
    (m,) [N] at the end of the step. The thread has the `stretch` (m,) [-]; None means 1. An absent
    hold keeps its abscissa. If `time` is inf, no tie is drawn.
    """
    drawn_ties, (by_length, by_force) = system.drawn_ties(time), system.in_hand(time)
    in_hand, tied = by_length | by_force, system.of_ties & ~drawn_ties
    full = system.over_ties([tie.force for tie in system.ties], -1.0)
    one_way = np.where(drawn_ties & (np.abs(pulls) < np.abs(full)), -np.sign(full), 0.0)
    rough = np.where(drawn_ties, one_way != 0.0, system.rough & ~in_hand)
    static, kinetic, grip, barb, per_channel = system.friction
    strands = system.strands[present[system.strands].all(axis=1)]
    loops = joined_loops(system, s_old, present, drawn_ties, in_hand)
    spline, none = system.thread.spline, np.zeros(len(s_old))
    give = float((spline.end - spline.start) / system.thread.EA)
    return Law(
        s_old=plain(s_old),
        s_held=plain(s_old - drawn * (present & by_length)),
        static=static,
        kinetic=kinetic,
        grip=np.where(drawn_ties, 0.0, grip),
        barb=barb,
        per_channel=per_channel,
        rough=rough,
        may_slide=system.may_slide & present & (rough | ~tied) & ~by_length,
        by_hand=in_hand | drawn_ties,
        inertia=inertia + none,
        s_free=plain(s_free),
        injected=np.asarray(pulls * (present & ~tied & (by_force | system.of_ties)), dtype=np.float64),
        stretch=none + 1.0 if stretch is None else stretch,
        one_way=one_way,
        own_static=none,
        own_kinetic=none,
        own_slope=none,
        joints=Joints(np.ascontiguousarray(strands), np.concatenate([strands, loops]), give),
    )


def joined_loops(system: System[Body], s: Array, present: Flags, drawn_ties: Flags, in_hand: Flags) -> Indices:
    """Return the first and the last hole of every closed loop that slides in them as one, shape `(k, 2)`.

    Such a loop is drawn by hands, or tied in holes without friction. `drawn_ties` (m,) are the
    strands that are drawn, and `in_hand` (m,) the holes at which a hand holds the thread. A loop
    that is held in one of its holes does not slide round, nor does one with friction in only one of
    these two holes.
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
    """Return the law with a given friction.

    Points are fixed where `held`. Others slide under the force `injected` (m,) [N] of the hole on
    the thread along t, in addition to that of a hand.
    """
    smooth = np.zeros_like(law.rough)
    return law._replace(rough=smooth, may_slide=law.may_slide & ~held, injected=law.injected + injected)


def side_by_side(law: Law, times: int) -> Law:
    """Return the law of several copies of the same holds, one after the other, without ties."""
    tiled: dict[str, Any] = {name: np.tile(x, times) for name, x in law._asdict().items() if name != "joints"}
    return Law(**tiled, joints=NO_JOINTS)


def ruled(
    law: Law, sigma: Array, thread: Passage, s: Array, lam: Array, y: Array, margin: float = 0.0, own: Own = ()
) -> Ruled:
    """Evaluate the law of sliding of all holds: forces, bounds, residual, and the active set that fits.

    A sticking point may exceed its bound by the `margin` [N] of the solve. `own` are users' laws,
    empty if there are none.
    """
    out, at = empty_ruled(len(s)), held_at(thread, lam, y)
    rule(law, sigma, s, margin, at, out)
    if own:
        rule(with_own_laws(law, own, out.N), sigma, s, margin, at, out)
    return out


def empty_ruled(m: int) -> Ruled:
    """Return arrays for the evaluated law of `m` holds."""
    N, f, met, static, kinetic, fits = np.empty((6, m))
    return Ruled(N, f, met, static, kinetic, np.empty((m, 3)), np.empty((m, 1)), fits)


def with_own_laws(law: Law, own: Own, N: Array) -> Law:
    """Return the law with users' laws at the normal forces N (m,) [N]."""
    values = np.zeros((3, len(N)))
    for k, each in enumerate(own):
        if each is not None:
            values[:, k] = each.static(float(N[k])), each.kinetic(float(N[k])), each.slope(float(N[k]))
    static, kinetic, slope = values
    return law._replace(own_static=static, own_kinetic=kinetic, own_slope=slope)


def cone_residual(law: Law, own: Own, sigma: Array, thread: Passage, s: Array, lam: Array, y: Array) -> Array:
    """Return the violation of Coulomb's law by the force along the thread, shape `(m,)` [N].

    Stick: the excess of |f| over F₀ ± B + μ_s N. Slip: the difference of f from σ (F₀ + μ_k N). It
    is zero for a hold without friction.
    """
    now = ruled(law, sigma, thread, s, lam, y, own=own)
    stuck = np.maximum(np.abs(now.f - law.barb) - now.static, 0.0)
    slipping = np.abs(now.f - sigma * now.kinetic)
    return np.where(law.rough & law.may_slide, np.where(sigma == 0.0, stuck, slipping), 0.0)


def admissible_sigma(law: Law, sigma: Array) -> Array:
    """Return the active set fitted to the holds, shape `(m,)`.

    A hole without friction slides, and a hold that cannot slide sticks. Holds that slide as one
    slide in opposite directions.
    """
    fitted = np.array(sigma, dtype=float)
    fit(law, fitted)
    return fitted


def sliding_strands(law: Law, sigma: Array) -> tuple[Indices, Indices]:
    """Return the two holds of each pair that slides as one: strands of sliding ties and holes of
    loops, shape `(k,)` each.

    The equation of the first is that the sum of their abscissae is constant, and that of the second
    is the difference of both laws.
    """
    pairs = law.joints.pairs
    one, other = pairs[sigma[pairs[:, 0]] != 0.0].T
    return one, other


def driven(law: Law, sigma: Array, drive: Array) -> Array:
    """Return the change of the residuals of the law by driving forces `drive` (m,) [N], shape `(m,)` [N]."""
    out = np.where(sigma != 0.0, drive, 0.0)
    one, other = sliding_strands(law, sigma)
    out[other] -= out[one]
    out[one] = 0.0
    return out
