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

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.interfaces import Body, FrictionLaw
from coupling.kernels.constraints import Passage, held_at
from coupling.kernels.friction import Joints, Ruled, fit, rule
from coupling.kernels.friction import Law as Table
from coupling.system import System
from thread.riding import plain

NO_PAIRS = np.zeros((0, 2), dtype=np.intp)


@dataclass(frozen=True)
class Law:
    """The data of the law of sliding without the iterate, over `m` holds.

    - `s_old` (m,) [m]: abscissae at the start of the step.
    - `s_held` (m,) [m]: abscissae at the end of the step of holds that do not slide.
    - `static`, `kinetic`, `grip`, `barb`, `per_channel` (m,): coefficients.
    - `rough`, `may_slide` (m,): holds with friction, and holds that can slide.
    - `inertia` [N/m], of all holds or of each, and `s_free` (m,) [m]: the term inertia (s −
      s_free), which is ε s̈ with inertia = ε a, or c ds/dt of a tie that is drawn.
    - `injected` (m,) [N]: a given force along the thread where it slides, added to the friction.
    - `stretch` (m,) [-]: replaces |T| if knots travel.
    - `strands` (t, 2): holds of active ties.
    - `loops` (k, 2): first and last hole of loops that slide in them as one.
    - `by_hand` (m,): holds at which hands draw.
    - `one_way` (m,): the only sense of ds, 1 or −1, in which a rough hold slides; 0 for both.
    - `own`: user's law of friction of each hold, None for a hold without one; empty if no hold has
      one.
    - `tie_compliance` [m/N]: compliance of the thread, by which the balance of a tie becomes a
      length.
    """

    s_old: Array
    s_held: Array
    static: Array
    kinetic: Array
    grip: Array
    barb: Array
    per_channel: Array
    rough: Flags
    may_slide: Flags
    inertia: float | Array
    s_free: Array
    injected: Array
    stretch: Array
    one_way: Array
    strands: Indices = field(default_factory=lambda: NO_PAIRS)
    loops: Indices = field(default_factory=lambda: NO_PAIRS)
    by_hand: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    own: tuple[FrictionLaw | None, ...] = ()
    tie_compliance: float = 1.0

    @cached_property
    def pairs(self) -> Indices:
        """Holds that slide as one, shape `(k, 2)`."""
        return np.concatenate([self.strands, self.loops])

    @cached_property
    def table(self) -> Table:
        """The law as arrays for the kernels, without users' laws."""
        none = np.zeros(len(self.s_old))
        return Table(
            s_old=plain(self.s_old),
            s_held=plain(self.s_held),
            static=plain(self.static),
            kinetic=plain(self.kinetic),
            grip=plain(self.grip),
            barb=plain(self.barb),
            per_channel=plain(self.per_channel),
            rough=self.rough,
            may_slide=self.may_slide,
            s_free=plain(self.s_free),
            injected=plain(self.injected),
            stretch=self.stretch.copy(),
            one_way=plain(self.one_way),
            inertia=self.inertia + none,
            own_static=none,
            own_kinetic=none,
            own_slope=none,
            joints=Joints(np.ascontiguousarray(self.strands), self.pairs, self.tie_compliance),
            ideal=self.ideal,
        )

    @cached_property
    def has_own(self) -> bool:
        """Whether a hold has a user's law of friction."""
        return any(own is not None for own in self.own)

    @cached_property
    def ideal(self) -> bool:
        """Whether no force except that of ε acts along the thread."""
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
    may_slide = system.may_slide & present & (rough | ~tied) & ~by_length
    injected = np.asarray(pulls * (present & ~tied & (by_force | system.of_ties)), dtype=np.float64)
    strands = system.strands[present[system.strands].all(axis=1)]
    loops = joined_loops(system, s_old, present, drawn_ties, in_hand)
    spline = system.thread.spline
    give = float((spline.end - spline.start) / system.thread.EA)
    by_hand, s_held, own = in_hand | drawn_ties, s_old - drawn * (present & by_length), system.own_friction
    taut = np.ones(len(s_old)) if stretch is None else stretch
    return Law(
        s_old, s_held, static, kinetic, np.where(drawn_ties, 0.0, grip), barb, per_channel, rough, may_slide, inertia,
        s_free, injected, taut, one_way, strands, loops, by_hand, own, tie_compliance=give,
    )  # fmt: skip


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
    return replace(law, rough=smooth, may_slide=law.may_slide & ~held, injected=law.injected + injected)


def side_by_side(law: Law, times: int) -> Law:
    """Return the law of several copies of the same holds, one after the other, without ties."""
    alike = {name: x for name, x in vars(law).items() if isinstance(x, np.ndarray) and x.shape == law.s_old.shape}
    tiled: dict[str, Any] = {name: np.tile(x, times) for name, x in alike.items()}
    return replace(law, own=law.own * times, strands=NO_PAIRS, loops=NO_PAIRS, **tiled)


def ruled(law: Law, sigma: Array, thread: Passage, s: Array, lam: Array, y: Array, margin: float = 0.0) -> Ruled:
    """Evaluate the law of sliding of all holds: forces, bounds, residual, and the active set that fits.

    A sticking point may exceed its bound by the `margin` [N] of the solve.
    """
    out, at = empty_ruled(len(s)), held_at(thread, lam, y)
    rule(law.table, sigma, s, margin, at, out)
    if law.has_own:
        rule(with_own_laws(law, out.N), sigma, s, margin, at, out)
    return out


def empty_ruled(m: int) -> Ruled:
    """Return arrays for the evaluated law of `m` holds."""
    N, f, met, static, kinetic, fits = np.empty((6, m))
    return Ruled(N, f, met, static, kinetic, np.empty((m, 3)), np.empty((m, 1)), fits)


def with_own_laws(law: Law, N: Array) -> Table:
    """Return the law as arrays for the kernels, with users' laws at the normal forces N (m,) [N]."""
    own = {part: np.zeros(len(N)) for part in ("static", "kinetic", "slope")}
    for part, values in own.items():
        for k, each in enumerate(law.own):
            if each is not None:
                values[k] = getattr(each, part)(float(N[k]))
    return law.table._replace(own_static=own["static"], own_kinetic=own["kinetic"], own_slope=own["slope"])


def cone_residual(law: Law, sigma: Array, thread: Passage, s: Array, lam: Array, y: Array) -> Array:
    """Return the violation of Coulomb's law by the force along the thread, shape `(m,)` [N].

    Stick: the excess of |f| over F₀ ± B + μ_s N. Slip: the difference of f from σ (F₀ + μ_k N). It
    is zero for a hold without friction.
    """
    now = ruled(law, sigma, thread, s, lam, y)
    stuck = np.maximum(np.abs(now.f - law.table.barb) - now.static, 0.0)
    slipping = np.abs(now.f - sigma * now.kinetic)
    return np.where(law.rough & law.may_slide, np.where(sigma == 0.0, stuck, slipping), 0.0)


def admissible_sigma(law: Law, sigma: Array) -> Array:
    """Return the active set fitted to the holds, shape `(m,)`.

    A hole without friction slides, and a hold that cannot slide sticks. Holds that slide as one
    slide in opposite directions.
    """
    fitted = np.array(sigma, dtype=float)
    fit(law.table, fitted)
    return fitted


def sliding_strands(law: Law, sigma: Array) -> tuple[Indices, Indices]:
    """Return the two holds of each pair that slides as one: strands of sliding ties and holes of
    loops, shape `(k,)` each.

    The equation of the first is that the sum of their abscissae is constant, and that of the second
    is the difference of both laws.
    """
    one, other = law.pairs[sigma[law.pairs[:, 0]] != 0.0].T
    return one, other


def driven(law: Law, sigma: Array, drive: Array) -> Array:
    """Return the change of the residuals of the law by driving forces `drive` (m,) [N], shape `(m,)` [N]."""
    out = np.where(sigma != 0.0, drive, 0.0)
    one, other = sliding_strands(law, sigma)
    out[other] -= out[one]
    out[one] = 0.0
    return out
