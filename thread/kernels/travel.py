"""Knots that travel with the holes (`thread.packets`): the curve at given abscissae s, and its
potential as a function of s.

With S' = dS/dχ at a point, T = P'/S' and T' = (P'' − T S'')/S'². If a hole moves while the control
points are constant, P' and P'' are constant and S' changes. The turn per rest length is |P' ×
P''|²/(|P'|⁴ S'²), without S''. Per dχ it follows

    bending  ½EI ψ/S',  ψ of P', P'' alone      ∂ = −½EI φ,  ∂² = EI φ/S',  φ = ψ/S'²
    stretch  ½EA ε² S',  ε = ½(P'²/S'² − 1)      ∂ = ½EA ε² − EA ε |T|²,  ∂² = |T|² (N + EA |T|²)/S'

and the mixed derivatives by q. The mean ε̄ of a natural strain over a span from S_a to S_b changes
with both ends:

    dε̄ = ((ε̄(S_b) − ε̄) dS_b − (ε̄(S_a) − ε̄) dS_a)/(S_b − S_a)

With e = ε − ε̄ instead of ε, the derivative by ε̄ is −EA e S', the second one EA S', and the mixed
one by ε̄ and S' is −(N − EA |T|²).

Inertia and weight are integrals over S of two kinds of fields: the thread's present curve, and the
earlier curves, each on its own knots. The earlier curves are evaluated at the material points of
the present curve:

    Π = … + ½a∫ρA |P(S) − P̂(S)|² dS − ∫ρA g·P dS
"""

from typing import NamedTuple

from thread.arrays import Array, Indices
from thread.kernels.curve import FIRST, Curve, Stretched, along_span, bending_gradient, crushing, point
from thread.kernels.loops import entry, loop
from thread.kernels.records import record
from thread.kernels.vectors import Vector, dot, minus, plus, sum_of, vector

LEFT, RIGHT = 0, 1
Pair = Array | tuple[float, float]
CLOSE = 1e-14  # of a span: abscissae that are no further apart count as equal
TRIES = 60  # Newton steps for the χ of an abscissa, on the span that contains it


@record
class Ride(NamedTuple):
    """The travel of knots, if `on`: S_i = `a` (n,) [m] + `b` (n, m) s.

    `between` (spans, 2) are the holds at both ends of the strand of each span, −1 for an end of a
    piece of the thread. `limits` (spans, 2) [m] is the abscissa of this end. The next arrays have
    functions in χ, weights, and the rates of S' by the abscissae of the two holds:

    - Bending: `slope`, `bend` (spans, g, 4), `w` (spans, g), `rate` (spans, g, 2).
    - Stretch: `axial_value`, `axial_slope`, `axial_w`, `axial_rate`; at both ends of each span
      `edge_slope`, `edge_w`, and the rates of S itself, `edge_moves` (spans, 2, 2).
    - Mass: `value`, `mass_slope`, `mass_w`, `mass_rate`; and the rates of S itself, `moves`.

    `first` (m,) and `at` (m, 2, 4): functions and slopes at the holds. `rhoA` [kg/m]; the `gravity`
    on each span, (spans, 3) [m/s²]; masses of the `ends` (2,) [kg].
    """

    on: bool
    a: Array
    b: Array
    between: Indices
    limits: Array
    slope: Array
    bend: Array
    w: Array
    rate: Array
    axial_value: Array
    axial_slope: Array
    axial_w: Array
    axial_rate: Array
    edge_slope: Array
    edge_w: Array
    edge_moves: Array
    value: Array
    mass_slope: Array
    mass_w: Array
    mass_rate: Array
    moves: Array
    first: Indices
    at: Array
    rhoA: float
    gravity: Array
    ends: Array


@record
class Field(NamedTuple):
    """An earlier curve.

    The ends of its spans in χ, `knots` (spans + 1,), and in S, `at` (spans + 1,) [m]; `first`
    (spans,), `polynomials` (spans, 4, 4); control values `S` (n,) [m] and `c` (n, 3) [m].
    """

    knots: Array
    at: Array
    first: Indices
    polynomials: Array
    S: Array
    c: Array


@record
class Ridden(NamedTuple):
    """The dependence of the potential on the abscissae at an iterate.

    S_i, `S` (n,) [m]; the derivatives `by_s` (m,) [N], `by_ss` (m, m) [N/m] and `by_qs` (n, 3, m)
    [N/m]; the upper band of the mass, `mass` (n, 4) [kg].
    """

    S: Array
    by_s: Array
    by_ss: Array
    by_qs: Array
    mass: Array


@loop
def on_span(b: Array, S: Array, first: int) -> float:
    """Return Σ b_i S_i over the four control values from `first` on."""
    return b[0] * S[first] + b[1] * S[first + 1] + b[2] * S[first + 2] + b[3] * S[first + 3]


@loop
def carry_functions(first: Indices, b: Array, S: Array, at: Array, rate: Array, by_S: Array) -> None:
    """Write S, S' and the functions and their derivatives by S, from the functions of χ, `b`
    (spans, g, 4, 4).

    `at`, `rate` (spans, g), `by_S` (spans, g, 4, 4), for knots at `S` (n,) [m].
    """
    for e in range(len(first)):
        for g in range(b.shape[1]):
            of_chi, out = b[e, g], by_S[e, g]
            S1, S2, S3 = (
                on_span(of_chi[1], S, first[e]),
                on_span(of_chi[2], S, first[e]),
                on_span(of_chi[3], S, first[e]),
            )
            at[e, g], rate[e, g] = on_span(of_chi[0], S, first[e]), S1
            for i in range(4):
                T = of_chi[1, i] / S1
                K = (of_chi[2, i] - T * S2) / S1**2
                out[0, i], out[1, i], out[2, i] = of_chi[0, i], T, K
                out[3, i] = (of_chi[3, i] - 3.0 * K * (S1 * S2) - T * S3) / S1**3


@loop
def strand_end(between: Indices, limits: Array, s: Array, e: int, side: int) -> float:
    """Return the abscissa of the strand of span e at one `side` [m].

    The strand is `between` holds at `s` (m,) [m], or ends at `limits`, as in `Ride`.
    """
    k = between[e, side]
    return s[k] if k >= 0 else limits[e, side]


@loop
def place_knots(ride: Ride, s: Array, S: Array) -> None:
    """Write S_i = a_i + Σ b_ik s_k."""
    for i in range(len(S)):
        S[i] = ride.a[i]
        for k in range(len(s)):
            S[i] += ride.b[i, k] * s[k]


@loop
def place_curve(ride: Ride, S: Array, curve: Curve) -> None:
    """Write the functions and weights of the curve for knots at `S` (n,) [m]."""
    for e in range(len(curve.first)):
        first = curve.first[e]
        for g in range(curve.w.shape[1]):
            rate, bend = on_span(ride.slope[e, g], S, first), on_span(ride.bend[e, g], S, first)
            curve.w[e, g] = ride.w[e, g] * rate
            for i in range(4):
                slope = ride.slope[e, g, i] / rate
                curve.slope[e, g, i] = slope
                curve.bend[e, g, i] = (ride.bend[e, g, i] - slope * bend) / rate**2
        for g in range(curve.axial_w.shape[1]):
            rate = on_span(ride.axial_slope[e, g], S, first)
            curve.axial_w[e, g] = ride.axial_w[e, g] * rate
            for i in range(4):
                curve.axial_slope[e, g, i] = ride.axial_slope[e, g, i] / rate
        for g in range(2):
            rate = on_span(ride.edge_slope[e, g], S, first)
            curve.edge_w[e, g] = ride.edge_w[e, g] * rate
            for i in range(4):
                curve.edge_slope[e, g, i] = ride.edge_slope[e, g, i] / rate


@loop
def carry_points(ride: Ride, S: Array, q: Array, rates: Array, dt: float, out: Array) -> None:
    """Add to `out` (n, 3) [m] the motion of control values `q` in `dt` [s] due to holes that move
    along a thread at rest.

    Knots are at `S` (n,) [m], and the holes move at `rates` (m,) [m/s]. The motion is T Ṡ_i Δt,
    with T by central differences.
    """
    for i in range(1, len(q) - 1):
        way = 0.0
        for k in range(len(rates)):
            way += dt * ride.b[i, k] * rates[k]
        for x in range(3):
            out[i, x] += way * (q[i + 1, x] - q[i - 1, x]) / (S[i + 1] - S[i - 1])


@loop
def add_mixed(x: float, a: Vector, ride: Ride, e: int, rates: Pair, i: int, out: Ridden) -> None:
    """Add x a times `rates` (2,) to ∂²Π/∂q_i∂s for the two holds of span e."""
    for side in range(2):
        k = ride.between[e, side]
        if k >= 0:
            y = x * rates[side]
            out.by_qs[i, 0, k] += y * a[0]
            out.by_qs[i, 1, k] += y * a[1]
            out.by_qs[i, 2, k] += y * a[2]


@loop
def add_rates(by: float, by_by: float, ride: Ride, e: int, rates: Array, out: Ridden) -> None:
    """Add the first and second derivative by S', `by` and `by_by`, to the derivatives by the two
    holds of span e.
    """
    for side in range(2):
        k = ride.between[e, side]
        if k >= 0:
            out.by_s[k] += by * rates[side]
            for other in range(2):
                j = ride.between[e, other]
                if j >= 0:
                    out.by_ss[k, j] += by_by * rates[side] * rates[other]


@loop
def add_moves(
    by_rate: float,
    by_move: float,
    twice: float,
    both: float,
    ride: Ride,
    e: int,
    rates: Array,
    moves: Pair,
    out: Ridden,
) -> None:
    """Add derivatives by S' and S to the derivatives by the two holds of span e.

    `by_rate` is by S', `by_move` by S, `twice` the second one by S, and `both` by S' and S. S'
    changes by `rates`, and S by `moves`.
    """
    for side in range(2):
        k = ride.between[e, side]
        if k >= 0:
            out.by_s[k] += by_rate * rates[side] + by_move * moves[side]
            for facing in range(2):
                j = ride.between[e, facing]
                if j >= 0:
                    mixed = moves[side] * rates[facing] + rates[side] * moves[facing]
                    out.by_ss[k, j] += both * mixed + twice * moves[side] * moves[facing]


@loop
def add_elastic_rates(curve: Curve, ride: Ride, at: Stretched, N: Array, out: Ridden) -> None:
    """Add the derivatives of stretch and bending by the abscissae.

    The axial force `N` (spans, a) [N] is a separate unknown in the second derivatives.
    """
    for e in range(len(curve.first)):
        if ride.between[e, LEFT] < 0 and ride.between[e, RIGHT] < 0:
            continue
        for g in range(curve.w.shape[1]):
            add_bending_rates(curve, ride, at, e, g, out)
        for g in range(curve.axial_w.shape[1]):
            T, strain, w = point(at.T_axial, e, g), at.strain[e, g], ride.axial_w[e, g]
            a, S1 = dot(T, T), curve.axial_w[e, g] / ride.axial_w[e, g]
            by = curve.EA * strain * (0.5 * strain - a)
            by_by = a * (N[e, g] + curve.EA * a) / S1
            add_rates(w * by, w * by_by, ride, e, ride.axial_rate[e, g], out)
            for i in range(4):
                x = -w * (curve.EA * a + N[e, g]) * curve.axial_slope[e, g, i]
                add_mixed(x, T, ride, e, ride.axial_rate[e, g], curve.first[e] + i, out)
            add_natural_rates(curve, ride, at, N, e, g, out)


@loop
def natural_rate(curve: Curve, ride: Ride, e: int, side: int) -> float:
    """Return the rate of the natural strain of span e by the hold at a `side` of its strand [1/m]."""
    low, high = curve.natural_slope[e, 0], curve.natural_slope[e, 1]
    return high * ride.edge_moves[e, RIGHT, side] - low * ride.edge_moves[e, LEFT, side]


@loop
def add_natural_rates(curve: Curve, ride: Ride, at: Stretched, N: Array, e: int, g: int, out: Ridden) -> None:
    """Add the derivatives due to the natural strain by the abscissae at one point of stretch."""
    rates = natural_rate(curve, ride, e, LEFT), natural_rate(curve, ride, e, RIGHT)
    if rates[LEFT] == 0.0 and rates[RIGHT] == 0.0:
        return
    T, stiff = point(at.T_axial, e, g), curve.EA * curve.axial_w[e, g]
    both = -ride.axial_w[e, g] * (N[e, g] - curve.EA * dot(T, T))
    add_moves(0.0, -stiff * at.strain[e, g], stiff, both, ride, e, ride.axial_rate[e, g], rates, out)
    for i in range(4):
        add_mixed(-stiff * curve.axial_slope[e, g, i], T, ride, e, rates, curve.first[e] + i, out)


@loop
def add_bending_rates(curve: Curve, ride: Ride, at: Stretched, e: int, g: int, out: Ridden) -> None:
    """Add the derivatives of bending and `crushing` by the abscissae at one point."""
    T, K, w = point(at.T, e, g), point(at.K, e, g), ride.w[e, g]
    a, b, c, S1 = dot(T, T), dot(T, K), dot(K, K), curve.w[e, g] / ride.w[e, g]
    bending = 0.5 * curve.EI * (a * c - b * b) / a**2
    crush, slope, bent = crushing(curve, a)
    by = -bending + crush - 2.0 * a * slope
    by_by = (2.0 * bending + 2.0 * a * (slope + 2.0 * a * bent)) / S1
    add_rates(w * by, w * by_by, ride, e, ride.rate[e, g], out)
    by_T, by_K = bending_gradient(curve, T, K)
    by_T = sum_of(1.0, by_T, 4.0 * a * bent, T)
    for i in range(4):
        mixed = sum_of(curve.slope[e, g, i], by_T, curve.bend[e, g, i], by_K)
        add_mixed(-w, mixed, ride, e, ride.rate[e, g], curve.first[e] + i, out)


@loop
def read_field(field: Field, s: float, near: int) -> tuple[Vector, Vector, Vector]:
    """Return an earlier curve and its first two derivatives by S at an abscissa; the search begins
    at the span `near`.
    """
    last = len(field.first) - 1
    e = min(near, last)
    while e > 0 and s < field.at[e]:
        e -= 1
    while e < last and s > field.at[e + 1]:
        e += 1
    p, first, width = field.polynomials[e], field.first[e], field.knots[e + 1] - field.knots[e]
    low, span = field.at[e], field.at[e + 1] - field.at[e]
    x = width * (s - low) / span
    rate = span / width
    for _ in range(TRIES):
        miss, rate = -s, 0.0
        for i in range(4):
            S = field.S[first + i]
            miss += S * (p[0, i] + x * (p[1, i] + x * (p[2, i] + x * p[3, i])))
            rate += S * (p[1, i] + x * (2.0 * p[2, i] + x * 3.0 * p[3, i]))
        x -= miss / rate
        if abs(miss) <= CLOSE * span:
            break
    P, slope, bend, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0
    for i in range(4):
        q = (field.c[first + i, 0], field.c[first + i, 1], field.c[first + i, 2])
        by_x = p[1, i] + x * (2.0 * p[2, i] + x * 3.0 * p[3, i])
        twice = 2.0 * p[2, i] + 6.0 * x * p[3, i]
        P = sum_of(1.0, P, p[0, i] + x * (p[1, i] + x * (p[2, i] + x * p[3, i])), q)
        slope = sum_of(1.0, slope, by_x / rate, q)
        bend = sum_of(1.0, bend, twice / rate**2, q)
        turn += field.S[first + i] * twice / rate**2
    return P, slope, sum_of(1.0, bend, -turn, slope)


@loop
def add_inertia(
    curve: Curve, ride: Ride, fields: tuple[Field, Field], factor: float, q: Array, F: Array, out: Ridden
) -> None:
    """Add the forces of inertia and weight to `F` (n, 3) [N], and their derivatives by the
    abscissae to `out`.

    Inertia is `factor` [1/s²] times mass times the distance from the sum of the earlier curves.
    """
    for e in range(len(curve.first)):
        first = curve.first[e]
        for g in range(ride.mass_w.shape[1]):
            b, rates, moves = ride.value[e, g], ride.mass_rate[e, g], ride.moves[e, g]
            s, S1 = on_span(b, out.S, first), on_span(ride.mass_slope[e, g], out.S, first)
            P, rho = along_span(b, q, first), ride.rhoA * ride.mass_w[e, g]
            gravity = vector(ride.gravity[e], FIRST)
            was, way, bend = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
            if factor != 0.0:
                one, other = read_field(fields[0], s, e), read_field(fields[1], s, e)
                was, way, bend = plus(one[0], other[0]), plus(one[1], other[1]), plus(one[2], other[2])
            R = minus(P, was)
            force = sum_of(factor, R, -1.0, gravity)
            for i in range(4):
                F[first + i, 0] += rho * S1 * b[i] * force[0]
                F[first + i, 1] += rho * S1 * b[i] * force[1]
                F[first + i, 2] += rho * S1 * b[i] * force[2]
                for j in range(i, 4):
                    out.mass[first + i, j - i] += rho * S1 * b[i] * b[j]
                add_mixed(rho * b[i], force, ride, e, rates, first + i, out)
                add_mixed(-factor * rho * S1 * b[i], way, ride, e, moves, first + i, out)
            by_rate = rho * (0.5 * factor * dot(R, R) - dot(gravity, P))
            by_move, by_both = -factor * rho * S1 * dot(R, way), -factor * rho * dot(R, way)
            twice = factor * rho * S1 * (dot(way, way) - dot(R, bend))
            add_moves(by_rate, by_move, twice, by_both, ride, e, rates, moves, out)


@loop
def add_end_masses(ride: Ride, fields: tuple[Field, Field], factor: float, q: Array, F: Array, out: Ridden) -> None:
    """Add inertia and weight of the point masses at both ends."""
    for end in range(2):
        i, mass, gravity = end * (len(q) - 1), ride.ends[end], ride.gravity[end * (len(ride.gravity) - 1)]
        out.mass[i, 0] += mass
        for x in range(3):
            was = 0.0
            if factor != 0.0:
                was = fields[0].c[end * (len(fields[0].c) - 1), x] + fields[1].c[end * (len(fields[1].c) - 1), x]
            F[i, x] += mass * (factor * (q[i, x] - was) - gravity[x])


@loop
def next_riding_force(curve: Curve, ride: Ride, at: Stretched, dz: Array, N: Array) -> None:
    """Add the change due to moving holes to the axial force `N` (spans, a) [N] of the next iterate.

    The holes move by the first column of `dz` (m, …) [m].
    """
    for e in range(len(curve.first)):
        for g in range(curve.axial_w.shape[1]):
            T, S1 = point(at.T_axial, e, g), curve.axial_w[e, g] / ride.axial_w[e, g]
            for side in range(2):
                k = ride.between[e, side]
                if k >= 0:
                    strain = dot(T, T) / S1 * ride.axial_rate[e, g, side] + natural_rate(curve, ride, e, side)
                    N[e, g] -= curve.EA * strain * dz[k, 0]


@loop
def clear_ridden(out: Ridden) -> None:
    """Set all sums in `out` to zero."""
    n, m = len(out.S), len(out.by_s)
    for k in range(m):
        out.by_s[k] = 0.0
        for j in range(m):
            out.by_ss[k, j] = 0.0
    for i in range(n):
        for x in range(4):
            out.mass[i, x] = 0.0
        for x in range(3):
            for k in range(m):
                out.by_qs[i, x, k] = 0.0


elastic_rates_of, inertia_of = entry(add_elastic_rates), entry(add_inertia)  # in the form that Python calls
end_masses_of, riding_force_of, carried_of = entry(add_end_masses), entry(next_riding_force), entry(carry_points)
functions_of = entry(carry_functions)
