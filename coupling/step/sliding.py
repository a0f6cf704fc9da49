"""The law of sliding at a hole: the one scalar equation per piercing that fixes its abscissa.

With t = T/|T| the tangent of the thread, f = Φ_sᵀλ/|T| the driving force along the thread and N the force
that presses it on the hole:

    ideal hole     ε s̈ = Φ_sᵀλ                      (eq. 7; eq. 6 at ε = 0)
    stick          s = s_old,            |f| ≤ F₀ + μ_s N
    drawn          s = s_old − Δd        a hand draws the length Δd through the hole, whatever it takes
    pulled         f = F                 a hand draws with the force F, whatever it takes to hold that
    slip           f = σ (F₀ + μ_k N),   σ = sign(ds/dt)
    barb           F₀ + σ B in place of F₀, on either side: the grip is another one in each sense

N = |λ_n| of a hole without length, λ_n the part of λ across the thread (§4.3). A channel of length ℓ_c that imposes the
direction presses at both its ends: each bears half of λ_n, and the couple t × m, m = μ_u u + μ_v v, is a force m/ℓ_c at
the one and −m/ℓ_c at the other, so

    N = |λ_n/2 + m/ℓ_c| + |λ_n/2 − m/ℓ_c|

which is max(|λ_n|, 2|m|/ℓ_c) where both lie in a plane with the thread. The thread's velocity relative to the hole is
v_t = −|T| ds/dt, so friction dissipates (F₀ + μ_k N)|T||ds/dt|.

Φ_sᵀλ is what changes over the hole of the force conjugate to s, T + T²/2EA of a strand under the tension T: the
difference of the tensions times 1 + T̄/EA, T̄ their mean. Where knots travel, which leave a corner at a hole that is
smaller than the spans beside it, that is in the place of |T|, of the tensions at the start of the step, at rest at the
end (`coupling.step.tension.stretches_at`).

Both bounds have a law of one's own added where a hole has one, F₀ + μN + F(N) (`coupling.interfaces.FrictionLaw`).

Which of stick and slip holds is an active set, σ ∈ {−1, 0, 1} a hold. Newton's method changes it only between solved
iterates: one on the way has forces that mean nothing, and where μ_k < μ_s both may hold, so that a wrong change would
stand. A way downhill knows the forces that hold the sites, and changes it on the way (`coupling.step.descent`).

A tie that slides does so as one (`coupling.ties`): its strands have two equations together, joined from those above. So
have the first and the last hole of a loop that hands draw, who keep the knot where it is between them, and of one that
is tied in holes without friction: nothing else keeps it from running round in them.

That force enters as a given one, f = `injected`. So does a friction found elsewhere (the two-pass algorithm of §4.3).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.interfaces import Body, FrictionLaw
from coupling.kernels.constraints import Passage, hold_arrays
from coupling.kernels.friction import Joints, Ruled, fit, rule
from coupling.kernels.friction import Law as Table
from coupling.system import System
from thread.riding import plain

NO_PAIRS = np.zeros((0, 2), dtype=np.intp)


@dataclass(frozen=True)
class Law:
    """What the law of sliding needs besides the iterate, over `m` holds.

    `s_old` (m,) [m]; `s_held` (m,) [m], where a thread that does not slide is at the end of the step; `static`,
    `kinetic`, `grip`, `barb`, `per_channel` (m,); `inertia` = ε a [N/m], of all holds or of each, and `s_free` (m,) [m]
    make ε s̈ = inertia (s − s_free), and c ds/dt of a tie that is drawn; `rough` and `may_slide` (m,); `injected` (m,)
    [N], a given force along the thread where it slides, added to the friction of the rough holds; `stretch` (m,) [-],
    in the place of |T| where knots travel; `strands` (t, 2) of ties in force; `loops` (k, 2), first and last hole of
    those that slide in them as one; `by_hand` (m,), where hands draw; `own`, the law of one's own of each hold, None or
    empty where there is none; `tie_compliance` [m/N] of the thread, by which the balance of a tie becomes a length.
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
        """The law as the kernels read it, without laws of one's own."""
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
            inertia=self.inertia + none,
            own_static=none,
            own_kinetic=none,
            own_slope=none,
            joints=Joints(np.ascontiguousarray(self.strands), self.pairs, self.tie_compliance),
            ideal=self.ideal,
        )

    @cached_property
    def has_own(self) -> bool:
        """Whether a hold has a law of friction of one's own."""
        return any(own is not None for own in self.own)

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
    spline = system.thread.spline
    give = float((spline.end - spline.start) / system.thread.EA)
    by_hand, s_held, own = in_hand | drawn_ties, s_old - drawn * (present & by_length), system.own_friction
    taut = np.ones(len(s_old)) if stretch is None else stretch
    return Law(
        s_old, s_held, *system.friction, rough, may_slide, inertia, s_free, injected, taut, strands, loops, by_hand,
        own, tie_compliance=give,
    )  # fmt: skip


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
    alike = {name: x for name, x in vars(law).items() if isinstance(x, np.ndarray) and x.shape == law.s_old.shape}
    tiled: dict[str, Any] = {name: np.tile(x, times) for name, x in alike.items()}
    return replace(law, own=law.own * times, strands=NO_PAIRS, loops=NO_PAIRS, **tiled)


def ruled(law: Law, sigma: Array, thread: Passage, s: Array, lam: Array, y: Array, margin: float = 0.0) -> Ruled:
    """Evaluate the law of sliding of all holds: forces, bounds, residual, and the active set that fits where a stuck
    point may exceed its bound by the `margin` [N] of the solve."""
    m = len(s)
    N, f, met, static, kinetic, fits = np.empty((6, m))
    out = Ruled(N, f, met, static, kinetic, np.empty((m, 3)), np.empty((m, 1)), fits)
    arrays = hold_arrays(thread, lam, y)
    rule(law.table, sigma, s, margin, *arrays, out)
    if law.has_own:
        rule(with_own_laws(law, out.N), sigma, s, margin, *arrays, out)
    return out


def with_own_laws(law: Law, N: Array) -> Table:
    """Return the law as the kernels read it, with the holds' own laws of friction under the normal forces N (m,)
    [N]."""
    own = {part: np.zeros(len(N)) for part in ("static", "kinetic", "slope")}
    for part, values in own.items():
        for k, each in enumerate(law.own):
            if each is not None:
                values[k] = getattr(each, part)(float(N[k]))
    return law.table._replace(own_static=own["static"], own_kinetic=own["kinetic"], own_slope=own["slope"])


def cone_residual(law: Law, sigma: Array, thread: Passage, s: Array, lam: Array, y: Array) -> Array:
    """Return by how much the force along the thread breaks Coulomb's law, shape `(m,)` [N], zero where it is obeyed.

    Stick: what |f| exceeds F₀ ± B + μ_s N by; slip: how far f is from σ (F₀ + μ_k N). Zero for a hold without friction.
    """
    now = ruled(law, sigma, thread, s, lam, y)
    stuck = np.maximum(np.abs(now.f - law.table.barb) - now.static, 0.0)
    slipping = np.abs(now.f - sigma * now.kinetic)
    return np.where(law.rough & law.may_slide, np.where(sigma == 0.0, stuck, slipping), 0.0)


def admissible_sigma(law: Law, sigma: Array) -> Array:
    """Fit the active set to the holds: an ideal hole slides, one that may not slide sticks, and those that slide as one
    do so against one another, shape `(m,)`."""
    fitted = np.array(sigma, dtype=float)
    fit(law.table, fitted)
    return fitted


def sliding_strands(law: Law, sigma: Array) -> tuple[Indices, Indices]:
    """Return the holds that slide as one, at which ties that slide hold their strands and loops go through their holes,
    shape `(k,)` each. The equation of the first says that their abscissae have the same sum, that of the second is the
    difference of both."""
    one, other = law.pairs[sigma[law.pairs[:, 0]] != 0.0].T
    return one, other


def driven(law: Law, sigma: Array, drive: Array) -> Array:
    """Return what driving forces `drive` (m,) [N] add to the residuals of the law, shape `(m,)` [N]."""
    out = np.where(sigma != 0.0, drive, 0.0)
    one, other = sliding_strands(law, sigma)
    out[other] -= out[one]
    out[one] = 0.0
    return out
