"""The constraints at one hold (eqs. 4, 8, 9), and the forces that come with them.

    g = P(s) − x,   c₁ = T·u,   c₂ = T·v

The spline lacks compliance where a force λ and m = μ_u u + μ_v v, the force conjugate to T, act on it
(`thread.compliance`): c₀ by the force across the thread, c₁, c₂ by m. Along itself it lacks next to nothing. With the
axis a = T, â = a/|a|, τ = λ·â and n̂ the unit normal of the frame, u × v over its size, the hole acts on the thread at

    P̂ = P + c₀ (λ − τâ) + c₁|a| m,   T̂ = T + c₁|a| λ + c m,   c = c₂ + c₃ (Γ − 1),
    Γ = |a|²γ,   γ = ½(1 + ψ)·½(1 + √(½(1 + ψ))),   ψ = |â·n̂|,

which stand for P, T in Φ. They are the slopes by λ and m of one potential,

    λ·(P − x) + m·T + ½c₀(λ² − τ²) + c₁|a| λ·m + ½c m²,

whose slopes by q, s and y are the forces on thread and abscissa and on the organ. It does not change when all turn
together: λ along the thread, which acts at P̂ and not at P, turns the thread's tangent by the force conjugate to a,
w = −c₀ τ (λ − τâ)/|a|. It does not turn the hole: the strands on both sides of it go through the hole, and not through
P, which is the further from it the longer the spans.

Where spans are much longer than √(EI/T), T leaves n̂ by an angle φ, that by which the strands do on the mean, and c₂ is
all that turns it. What the hole bears is then the elastica's: strands turned by φ + ½θ and φ − ½θ bear together

    2√(EI T) (sin ½(φ + ½θ) + sin ½(φ − ½θ)) = 2 sin ½φ/g,   1/g = 2√(EI T) cos ¼θ,

the slope of 4(1 − cos ½φ)/g; `coupling.step.tension` counts the cosine of ¼θ to √(EI T). With |a|m for the couple and
c = g|a|²γ the potential stores ½ sin²φ/(gγ): that is the same where γ = cos²½φ cos²¼φ. On shorter spans the spline
makes part of the turn itself. The share c₃ of c₂ is what then turns as far as the elastica does (`thread.compliance`),
and the rest is of small turns. What Γ adds to the forces is e ∂Γ, with e = ½c₃m²: it turns the thread and the frame and
draws the thread out, whose corner the spline rounds, |a| < 1. The frame it does not stretch: n̂ is a direction alone,
for the frame of a linear organ that turns far is longer than it was. c₁ goes by the couple too: a turn moves T by |a|
times itself.
"""

from math import sqrt
from typing import NamedTuple

from coupling.arrays import Array
from thread.kernels.loops import loop, numbers
from thread.kernels.vectors import (
    ZERO,
    Matrix,
    Vector,
    added,
    applied,
    combined,
    cross,
    diagonal,
    dot,
    minus,
    norm,
    outer,
    plus,
    product,
    scaled,
    sum_of,
    times,
    transposed,
    vector,
)

FIRST, AT_U, AT_V = numbers(0, 3, 6)


class Hold(NamedTuple):
    """One hold at an iterate.

    Of the thread P [m], T, K = T' [1/m], J = T'' [1/m²] and c₀, c₁, c₂, c₃ of the missing compliance, each with two
    derivatives by s; λ [N], μ_u, μ_v [N m]; of the organ x [m], u, v. `m` = μ_u u + μ_v v [N m]. The axis a is T: its
    `unit` vector and `size`, and λ `along` and `across` it [N]. How far T leaves the frame, as
    `coupling.kernels.constraints.Tilt`: `normal` n̂, `area`, `cosine` ψ, n̂ − ψâ `of_along` and â − ψn̂ `of_normal`,
    γ with its derivatives `slope` and `bend` by ψ, `share` Γ, `by_T`, `by_n`. `directed`: the frame tells where the
    thread goes. `bare`: no hold of the thread lacks compliance. ∂P/∂s at fixed q, `P_s`: T, or zero where the knots
    ride with the holes (`rides`); then P, T at the hole do not depend on s, and `drive` is −∂Π/∂s [N], of the potential
    of the thread (`thread.kernels.travel`).
    """

    P: Vector
    T: Vector
    K: Vector
    J: Vector
    c0: Vector
    c1: Vector
    c2: Vector
    c3: Vector
    directed: bool
    bare: bool
    lam: Vector
    mu_u: float
    mu_v: float
    x: Vector
    u: Vector
    v: Vector
    P_s: Vector
    rides: bool
    drive: float
    m: Vector
    unit: Vector
    size: float
    along: float
    across: Vector
    normal: Vector
    area: float
    cosine: float
    of_along: Vector
    of_normal: Vector
    gamma: float
    slope: float
    bend: float
    share: float
    by_T: Vector
    by_n: Vector


@loop
def hold_at(D: Array, c: Array, directed: bool, bare: bool, rides: bool, drive: float, lam: Array, y: Array) -> Hold:
    """Return a hold from P to T'', `D` (4, 3), c `(3 derivatives, 4)`, `lam` (5,) and `y` (9,)."""
    T, force, u, v = vector(D[1], FIRST), vector(lam, FIRST), vector(y, AT_U), vector(y, AT_V)
    size = norm(T)
    unit = times(1.0 / size, T)
    along, n = dot(force, unit), cross(u, v)
    area = norm(n) if dot(T, n) >= 0.0 else -norm(n)
    normal = times(1.0 / area, n)
    cosine = dot(unit, normal)
    of_along, of_normal = sum_of(1.0, normal, -cosine, unit), sum_of(1.0, unit, -cosine, normal)
    half = sqrt(0.5 * (1.0 + cosine))  # cos ½φ
    P_s = T
    if rides:
        P_s = ZERO
    gamma, slope = 0.5 * half**2 * (1.0 + half), 0.25 * (1.0 + 1.5 * half)
    return Hold(
        vector(D[0], FIRST),
        T,
        vector(D[2], FIRST),
        vector(D[3], FIRST),
        (c[0, 0], c[1, 0], c[2, 0]),
        (c[0, 1], c[1, 1], c[2, 1]),
        (c[0, 2], c[1, 2], c[2, 2]),
        (c[0, 3], c[1, 3], c[2, 3]),
        directed,
        bare,
        force,
        lam[3],
        lam[4],
        vector(y, FIRST),
        u,
        v,
        P_s,
        rides,
        drive,
        sum_of(lam[3], u, lam[4], v),
        unit,
        size,
        along,
        sum_of(1.0, force, -along, unit),
        normal,
        area,
        cosine,
        of_along,
        of_normal,
        gamma,
        slope,
        0.09375 / half,
        size**2 * gamma,
        times(size, sum_of(2.0 * gamma, unit, slope, of_along)),
        times(size**2 / area * slope, of_normal),
    )


@loop
def axis_force(h: Hold) -> Vector:
    """Return w = −c₀ τ (λ − τâ)/|a| [N m]."""
    return times(-h.c0[0] * h.along / h.size, h.across)


@loop
def axis_force_rate(h: Hold) -> Vector:
    """Return its derivative by s with a held [N]."""
    return times(-h.c0[1] * h.along / h.size, h.across)


@loop
def tilt_force(h: Hold) -> float:
    """Return e = ½c₃m² [N m]."""
    return 0.5 * h.c3[0] * dot(h.m, h.m)


@loop
def tilt_force_rate(h: Hold) -> float:
    """Return its derivative by s [N]."""
    return 0.5 * h.c3[1] * dot(h.m, h.m)


@loop
def turned_compliance(h: Hold, c2: float, c3: float) -> float:
    """Return c = c₂ + c₃(Γ − 1) [1/(N m)]."""
    return c2 + c3 * (h.share - 1.0)


@loop
def lacking_force(h: Hold) -> Vector:
    """Return w + e ∂Γ/∂T + c₁(λ·m) â [N m]."""
    if h.bare:
        return ZERO
    turned = sum_of(1.0, axis_force(h), tilt_force(h), h.by_T)
    return sum_of(1.0, turned, h.c1[0] * dot(h.lam, h.m), h.unit)


@loop
def lacking_force_rate(h: Hold) -> Vector:
    """Return its derivative by s with T held [N]."""
    if h.bare:
        return ZERO
    turned = sum_of(1.0, axis_force_rate(h), tilt_force_rate(h), h.by_T)
    return sum_of(1.0, turned, h.c1[1] * dot(h.lam, h.m), h.unit)


@loop
def on_frame(h: Hold, by_n: Vector) -> tuple[Vector, Vector]:
    """Return what a force conjugate to u × v is on u and on v."""
    return cross(h.v, by_n), cross(by_n, h.u)


@loop
def tilting_rates(h: Hold) -> tuple[Vector, Vector]:
    """Return the derivatives by s of e ∂Γ/∂u and e ∂Γ/∂v [N]."""
    turned = applied(transposed(tilt_mixed(h)), h.K)
    return on_frame(h, sum_of(tilt_force_rate(h), h.by_n, tilt_force(h), turned))


@loop
def axis_turned(h: Hold, da: Vector) -> Vector:
    """Return the change of τâ as the axis changes by `da` [N]."""
    turned = sum_of(dot(h.across, da), h.unit, h.along, sum_of(1.0, da, -dot(h.unit, da), h.unit))
    return times(1.0 / h.size, turned)


@loop
def effective_place(h: Hold) -> Vector:
    """Return P̂ [m]."""
    if h.bare:
        return h.P
    return plus(h.P, sum_of(h.c0[0], h.across, h.c1[0] * h.size, h.m))


@loop
def effective_tangent(h: Hold) -> Vector:
    """Return T̂."""
    if h.bare:
        return h.T
    return plus(h.T, sum_of(h.c1[0] * h.size, h.lam, turned_compliance(h, h.c2[0], h.c3[0]), h.m))


@loop
def arm_rate(h: Hold) -> float:
    """Return the derivative of c₁|a| by s [1/(N m)]."""
    return h.c1[1] * h.size + h.c1[0] * dot(h.unit, h.K)


@loop
def place_rate(h: Hold) -> Vector:
    """Return ∂P̂/∂s at constant multipliers."""
    if h.bare:
        return h.P_s
    rate = plus(h.T, sum_of(h.c0[1], h.across, arm_rate(h), h.m))
    return sum_of(1.0, rate, -h.c0[0], axis_turned(h, h.K))


@loop
def tangent_rate(h: Hold) -> Vector:
    """Return ∂T̂/∂s at constant multipliers [1/m]."""
    if h.bare:
        return h.K
    by_couple = turned_compliance(h, h.c2[1], h.c3[1]) + h.c3[0] * dot(h.by_T, h.K)
    return plus(h.K, sum_of(arm_rate(h), h.lam, by_couple, h.m))


@loop
def held_energy(h: Hold, k: int) -> float:
    """Return ½c₀(λ² − τ²) + c₁|a|λ·m + ½c m² [J], or its derivative number `k` by s with T held [N, N/m]."""
    if h.bare:
        return 0.0
    turned = turned_compliance(h, h.c2[k], h.c3[k])
    alone = h.c0[k] * dot(h.across, h.across) + turned * dot(h.m, h.m)
    return 0.5 * alone + h.c1[k] * h.size * dot(h.lam, h.m)


@loop
def shrinkage(h: Hold) -> float:
    """Return 1 − c₀ (λ − τâ)·T'/|T|²."""
    return 1.0 - h.c0[0] * dot(h.across, h.K) / dot(h.T, h.T)


@loop
def tangent(h: Hold) -> Vector:
    """Return the thread's tangent at P̂, of length |T̂|."""
    if h.bare:
        return h.T
    if h.directed:
        return times(h.size, h.normal)
    return sum_of(shrinkage(h), h.T, h.c1[0], h.across)


@loop
def driving_force(h: Hold) -> float:
    """Return the force that drives the thread along itself, −∂Π/∂s + Φ_sᵀλ [N]."""
    return h.drive + dot(h.lam, h.P_s) + dot(h.m, h.K) + held_energy(h, 1) + dot(lacking_force(h), h.K)


@loop
def force_on_tangent(h: Hold) -> Vector:
    """Return Φ_qᵀλ conjugate to T [N m]; that conjugate to P is λ."""
    return plus(h.m, lacking_force(h))


@loop
def site_force(h: Hold) -> tuple[Vector, Vector, Vector]:
    """Return Φ_yᵀλ conjugate to x, u and v."""
    T = effective_tangent(h)
    if h.bare:
        return times(-1.0, h.lam), times(h.mu_u, T), times(h.mu_v, T)
    turn = on_frame(h, times(tilt_force(h), h.by_n))
    return times(-1.0, h.lam), sum_of(h.mu_u, T, 1.0, turn[0]), sum_of(h.mu_v, T, 1.0, turn[1])


@loop
def axis_stiffness(h: Hold) -> Matrix:
    """Return ∂w/∂a [N m]."""
    mixed = outer(h.unit, h.across)
    across = added(outer(h.across, h.across), scaled(-h.along, added(mixed, transposed(mixed))))
    inner = combined(1.0, across, -(h.along**2), without(h.unit))
    return scaled(-h.c0[0] / h.size**2, inner)


@loop
def lacking_stiffness(h: Hold) -> Matrix:
    """Return ∂(w + e ∂Γ/∂T + c₁(λ·m) â)/∂T [N m]."""
    turned = combined(1.0, axis_stiffness(h), tilt_force(h), tilt_by_thread(h))
    return combined(1.0, turned, h.c1[0] * dot(h.lam, h.m) / h.size, without(h.unit))


@loop
def tilt_by_thread(h: Hold) -> Matrix:
    """Return the second derivative of Γ by T."""
    mixed = outer(h.unit, h.of_along)
    turned = combined(1.0, added(mixed, transposed(mixed)), -h.cosine, without(h.unit))
    turned = combined(h.slope, turned, h.bend, outer(h.of_along, h.of_along))
    return combined(1.0, turned, 2.0 * h.gamma, diagonal(1.0))


@loop
def tilt_mixed(h: Hold) -> Matrix:
    """Return the second derivative of Γ by T and u × v."""
    turned = combined(2.0, outer(h.unit, h.of_normal), 1.0, product(without(h.unit), without(h.normal)))
    return scaled(h.size / h.area, combined(h.slope, turned, h.bend, outer(h.of_along, h.of_normal)))


@loop
def tilt_by_frame(h: Hold) -> Matrix:
    """Return the second derivative of Γ by u × v."""
    mixed = outer(h.normal, h.of_normal)
    turned = combined(1.0, added(mixed, transposed(mixed)), h.cosine, without(h.normal))
    bent = outer(h.of_normal, h.of_normal)
    return scaled((h.size / h.area) ** 2, combined(-h.slope, turned, h.bend, bent))


@loop
def force_by_axis(h: Hold) -> Matrix:
    """Return ∂P̂/∂a [m]."""
    turned = combined(1.0, outer(h.unit, h.across), h.along, without(h.unit))
    return combined(-h.c0[0] / h.size, turned, h.c1[0], outer(h.m, h.unit))


@loop
def without(unit: Vector) -> Matrix:
    """Return 1 − ââᵀ."""
    return combined(1.0, diagonal(1.0), -1.0, outer(unit, unit))


@loop
def gap(h: Hold) -> Vector:
    """Return g = P̂ − x [m]."""
    return minus(effective_place(h), h.x)


@loop
def phi(h: Hold) -> tuple[Vector, float, float]:
    """Return Φ = (g, c₁, c₂) [m, -]."""
    T = effective_tangent(h)
    return gap(h), dot(T, h.u), dot(T, h.v)


@loop
def phi_s(h: Hold) -> tuple[Vector, float, float]:
    """Return ∂Φ/∂s = (P̂', T̂'·u, T̂'·v) at constant multipliers [-, 1/m]."""
    T_s = tangent_rate(h)
    return place_rate(h), dot(T_s, h.u), dot(T_s, h.v)
