"""The law of sliding at one hold (`coupling.step.sliding`)."""

from typing import NamedTuple

from coupling.arrays import Array, Flags, Indices
from coupling.kernels.holes import Held, Hold, driving_force, hold_among
from thread.kernels.loops import entry, loop, numbers
from thread.kernels.records import record
from thread.kernels.vectors import Vector, add_row, dot, minus, norm, plus, sum_of, times

LAW, S, LAM, MU_U, MU_V, U, V = numbers(0, 0, 1, 4, 5, 9, 12)  # row of the law; columns as in `coupling.kernels.border`
AT_T, AT_K = numbers(3, 6)
TINY = 2.2250738585072014e-308


@record
class Joints(NamedTuple):
    """The joints of strands in ties (`coupling.ties`).

    `strands` (t, 2) are the holds of the active ties. `pairs` (k, 2) are holds that slide as one,
    with joined equations. The `compliance` [m/N] of the thread turns forces into lengths.
    """

    strands: Indices
    pairs: Indices
    compliance: float


@record
class Law(NamedTuple):
    """The data of the law of sliding without the iterate, over `m` holds (`coupling.step.sliding.law_of`).

    - `s_old` (m,) [m]: abscissae at the start of the step.
    - `s_held` (m,) [m]: abscissae at the end of the step of holds that do not slide.
    - `static`, `kinetic`, `grip`, `barb`, `per_channel` (m,): coefficients.
    - `rough`, `may_slide` (m,): holds with friction, and holds that can slide.
    - `by_hand` (m,): holds at which hands draw.
    - `inertia` [N/m], `s_free` [m] (m,): the term inertia (s − s_free), which is ε s̈ with inertia = ε a,
      or c ds/dt of a tie that is drawn.
    - `injected` (m,) [N]: a given force along the thread where it slides, added to the friction.
    - `stretch` (m,) [-]: replaces |T| if knots travel.
    - `one_way` (m,): the only sense of ds, 1 or −1, in which a rough hold slides; 0 for both.
    - `own_static`, `own_kinetic` (m,) [N], `own_slope` (m,) [-]: a user's law of friction at the normal
      forces of the iterate, zero without such a law.
    - `joints`: active ties, and holds that slide as one.
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
    by_hand: Flags
    inertia: Array
    s_free: Array
    injected: Array
    stretch: Array
    one_way: Array
    own_static: Array
    own_kinetic: Array
    own_slope: Array
    joints: Joints


@record
class Ruled(NamedTuple):
    """The evaluated law of sliding over `m` holds.

    - `N` [N]: normal force.
    - `f` [N]: force along the thread.
    - `met` [-]: length of the tangent.
    - `static` and `kinetic` [N]: bounds of friction.
    - `judged` (m, 3) [N]: f without the force of hands, bound and barb for the decision whether a hold sticks.
    - `residual` (m, 1) [N, m]: residual of the law.
    - `fits` (m,): the active set that fits.
    """

    N: Array
    f: Array
    met: Array
    static: Array
    kinetic: Array
    judged: Array
    residual: Array
    fits: Array


@loop
def channel_forces(h: Hold, per_channel: float) -> tuple[Vector, Vector]:
    """Return λ/2 ± m/ℓ_c [N]."""
    return sum_of(0.5, h.lam, per_channel, h.m), sum_of(0.5, h.lam, -per_channel, h.m)


@loop
def part_across(force: Vector, t: Vector) -> Vector:
    """Return the part of a force across the unit tangent t."""
    return sum_of(1.0, force, -dot(force, t), t)


@loop
def normal_force(h: Hold, per_channel: float) -> float:
    """Return N = |λ_n/2 + m/ℓ_c| + |λ_n/2 − m/ℓ_c| [N]."""
    t, ends = times(1.0 / norm(h.T), h.T), channel_forces(h, per_channel)
    return norm(part_across(ends[0], t)) + norm(part_across(ends[1], t))


@loop
def kinetic_bound(law: Law, k: int, h: Hold, sigma: float) -> float:
    """Return F₀ + σ B + μ_k N, plus the bound of a user's law [N]."""
    return law.grip[k] + sigma * law.barb[k] + law.kinetic[k] * normal_force(h, law.per_channel[k]) + law.own_kinetic[k]


@loop
def static_bound(law: Law, k: int, h: Hold) -> float:
    """Return F₀ + μ_s N, plus the bound of a user's law [N]; the barb's σ B is not included."""
    return law.grip[k] + law.static[k] * normal_force(h, law.per_channel[k]) + law.own_static[k]


@loop
def net_drive(law: Law, k: int, h: Hold, s: float) -> float:
    """Return Φ_sᵀλ − ε s̈ [N]."""
    return driving_force(h) - law.inertia[k] * (s - law.s_free[k])


@loop
def stretch_met(law: Law, k: int, h: Hold) -> float:
    """Return the length of the thread at a hole per rest length.

    The length is |T|. If knots travel, it is that of the adjacent strands.
    """
    return law.stretch[k] if h.rides else norm(h.T)


@loop
def is_ideal(law: Law, k: int) -> bool:
    """Return whether no force except that of ε acts along the thread at a hold."""
    return not law.rough[k] and law.injected[k] == 0.0


@loop
def residual(law: Law, k: int, sigma: float, h: Hold, s: float) -> float:
    """Return the left-hand side of the law: [N] if the thread slides, [m] if it is held."""
    if sigma == 0.0:
        return s - law.s_held[k]
    drive = net_drive(law, k, h, s)
    if is_ideal(law, k):
        return drive
    given = law.injected[k]
    if law.rough[k]:
        given += sigma * kinetic_bound(law, k, h, sigma)
    return drive - stretch_met(law, k, h) * given


@loop
def slides_as_one(law: Law, sigma: Array, pair: int) -> bool:
    """Return whether a pair of joined holds slides."""
    return sigma[law.joints.pairs[pair, 0]] != 0.0


@loop
def join_residuals(law: Law, sigma: Array, s: Array, out: Array) -> None:
    """Join the residuals of holds that slide as one, in the first column of `out` (m, …).

    The first equation is then that the sum of their abscissae is constant. The second is the
    difference of both laws.
    """
    for pair in range(len(law.joints.pairs)):
        if slides_as_one(law, sigma, pair):
            one, other = law.joints.pairs[pair, 0], law.joints.pairs[pair, 1]
            out[other, LAW] -= out[one, LAW]
            out[one, LAW] = s[one] - law.s_old[one] + s[other] - law.s_old[other]


@loop
def is_length(law: Law, sigma: Array, k: int) -> bool:
    """Return whether the residual of the law at a hold is a length."""
    length = sigma[k] == 0.0
    for pair in range(len(law.joints.pairs)):
        length |= slides_as_one(law, sigma, pair) and law.joints.pairs[pair, 0] == k
    return length


@loop
def fit_sigma(law: Law, sigma: Array) -> None:
    """Fit the active set to the holds, in place.

    A hole without friction slides, and a hole that cannot slide sticks. Holds that slide as one
    slide in opposite directions.
    """
    for k in range(len(sigma)):
        if not law.may_slide[k]:
            sigma[k] = 0.0
        elif not law.rough[k]:
            sigma[k] = 1.0
    for pair in range(len(law.joints.pairs)):
        sigma[law.joints.pairs[pair, 1]] = -sigma[law.joints.pairs[pair, 0]]


@loop
def judge(law: Law, judged: Array, met: Array) -> None:
    """Replace force, bound and barb, `judged` (m, 3), of holds that slide as one by those of their
    common equation.
    """
    for pair in range(len(law.joints.pairs)):
        one, other = law.joints.pairs[pair, 0], law.joints.pairs[pair, 1]
        size = 0.5 * (met[one] + met[other])
        f = 0.5 * (met[other] * judged[other, 0] - met[one] * judged[one, 0]) / size
        bound = 0.5 * (met[other] * judged[other, 1] + met[one] * judged[one, 1]) / size
        barb = 0.5 * (met[other] * judged[other, 2] - met[one] * judged[one, 2]) / size
        judged[other, 0], judged[one, 0] = f, -f
        judged[other, 2], judged[one, 2] = barb, -barb
        judged[other, 1], judged[one, 1] = bound, bound


@loop
def excess(judged: Array, sense: float) -> float:
    """Return the excess of the force along the thread in a `sense` over the bound with the barb [N]."""
    return sense * (judged[0] - judged[2]) - judged[1]


@loop
def next_sigma(law: Law, k: int, sigma: float, s: float, judged: Array, margin: float) -> float:
    """Return σ after a solved iterate.

    A sticking hold slides if its force exceeds the bound by the margin [N]. A sliding hold sticks
    if it moved in the direction of its own friction, further than the margin stretches the thread.
    """
    if sigma != 0.0 and law.one_way[k] != -sigma:
        return 0.0 if sigma * (s - law.s_old[k]) < -margin * law.joints.compliance else sigma
    sense = law.one_way[k] if law.one_way[k] != 0.0 else 1.0 if judged[0] > 0.0 else -1.0
    return sense if excess(judged, sense) > margin else 0.0


@loop
def rule_hold(law: Law, k: int, sigma: float, h: Hold, s: float, out: Ruled) -> None:
    """Evaluate the law at one hold."""
    out.N[k], out.met[k] = normal_force(h, law.per_channel[k]), stretch_met(law, k, h)
    out.f[k] = net_drive(law, k, h, s) / out.met[k]
    out.static[k], out.kinetic[k] = static_bound(law, k, h), kinetic_bound(law, k, h, sigma)
    out.residual[k, LAW] = residual(law, k, sigma, h, s)
    out.judged[k, 0], out.judged[k, 1], out.judged[k, 2] = out.f[k] - law.injected[k], out.static[k], law.barb[k]


@loop
def rule_set(law: Law, sigma: Array, s: Array, margin: float, out: Ruled) -> None:
    """Join the laws of holds that slide as one, and choose the active set that fits.

    Every hold has been evaluated before.
    """
    join_residuals(law, sigma, s, out.residual)
    judge(law, out.judged, out.met)
    for k in range(len(sigma)):
        out.fits[k] = next_sigma(law, k, sigma[k], s[k], out.judged[k], margin)
    fit_sigma(law, out.fits)


@loop
def linearise_law(law: Law, k: int, sigma: float, h: Hold, B: Array, D: Array) -> None:
    """Write the row of s: row 0 of `B` (6, 9) and of `D` (6, 15), which are both zero before."""
    if sigma == 0.0:
        D[LAW, S] = 1.0
        return
    add_row(1.0, h.P_s, D, LAW, LAM)
    D[LAW, MU_U] += dot(h.K, h.u)
    D[LAW, MU_V] += dot(h.K, h.v)
    add_row(h.mu_u, h.K, D, LAW, U)
    add_row(h.mu_v, h.K, D, LAW, V)
    D[LAW, S] += dot(h.lam, h.K) + dot(h.m, h.J) - law.inertia[k]
    if h.rides:
        B[LAW, AT_K] -= 1.0
    else:
        add_row(1.0, h.lam, B, LAW, AT_T)
        add_row(1.0, h.m, B, LAW, AT_K)
    if not is_ideal(law, k):
        add_friction(law, k, sigma, h, B, D)


@loop
def unit_or_zero(a: Vector) -> Vector:
    """Return a/|a|, or zero if a is zero."""
    return times(1.0 / max(norm(a), TINY), a)


@loop
def add_friction(law: Law, k: int, sigma: float, h: Hold, B: Array, D: Array) -> None:
    """Subtract the derivative of |T|(injected + σ(F₀ + μ_k N)).

    If knots travel, the length in the place of |T| is constant.
    """
    size = norm(h.T)
    t = times(1.0 / size, h.T)
    one, other = channel_forces(h, law.per_channel[k])
    n_one, n_other = unit_or_zero(part_across(one, t)), unit_or_zero(part_across(other, t))
    rough_sigma = sigma if law.rough[k] else 0.0
    given = law.injected[k] + rough_sigma * kinetic_bound(law, k, h, sigma)
    press = rough_sigma * stretch_met(law, k, h) * (law.kinetic[k] + law.own_slope[k])
    by_m = times(-press * law.per_channel[k], minus(n_one, n_other))
    add_row(-0.5 * press, plus(n_one, n_other), D, LAW, LAM)
    D[LAW, MU_U] += dot(by_m, h.u)
    D[LAW, MU_V] += dot(by_m, h.v)
    add_row(h.mu_u, by_m, D, LAW, U)
    add_row(h.mu_v, by_m, D, LAW, V)
    by_t = sum_of(press * dot(one, t), n_one, press * dot(other, t), n_other)
    by_T = sum_of(0.0 if h.rides else -given, t, 1.0 / size, by_t)
    D[LAW, S] += dot(by_T, h.K)
    add_row(1.0, by_T, B, LAW, AT_T)


@loop
def rule_all(law: Law, sigma: Array, s: Array, margin: float, at: Held, out: Ruled) -> None:
    """Evaluate the law of sliding of all holds into `out`."""
    for k in range(len(s)):
        rule_hold(law, k, sigma[k], hold_among(at, k), s[k], out)
    rule_set(law, sigma, s, margin, out)


rule, fit = entry(rule_all), entry(fit_sigma)  # for Python
