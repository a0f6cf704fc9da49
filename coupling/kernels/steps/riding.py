"""Steps of a thread whose knots travel with its holes (`thread.kernels.travel`).

This module has the earlier curves of its inertia, its velocity, the check of its packets, and its
part of the audit.
"""

from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.kernels.band import REACH
from coupling.kernels.iteration import Found, Given, Passing, add_momentum, copy_into, pass_knot
from coupling.kernels.steps.audit import (
    ELASTIC,
    EXTERNAL,
    NUMERICAL,
    TWO_STEP,
    Holes,
    Met,
    Motion,
    OnThread,
    Works,
    audit_step,
    product,
    work_along,
)
from coupling.kernels.steps.tension import INSIDE, Along
from thread.kernels.curve import Curve, elastic_energy
from thread.kernels.loops import entry, loop, owning
from thread.kernels.records import record
from thread.kernels.travel import (
    LEFT,
    RIGHT,
    Field,
    Ridden,
    Ride,
    add_elastic_rates,
    add_end_masses,
    add_inertia,
    clear_ridden,
    on_span,
    place_knots,
    read_field,
    strand_end,
)
from thread.kernels.vectors import cross, dot, norm


@record
class Fit(NamedTuple):
    """The conditions under which knots fit (`thread.packets.Travel`).

    - `first` (m,) [m]: spans next to the holes at the start of a step. The wanted spans are `part`
      √(EI/T), at most `longest` [m]. Spans may be between `fine` and `coarse` times the wanted
      ones.
    - `rigid`, `made` (spans,) [m]: for the strand of each span, the length of its packets, and the
      length between them when the knots were made. The latter may change by a factor of `grown`.
    - `between` and `limits` as of `Ride`.
    - `strand` (n,): the strand whose middle contains each control point, −1 elsewhere.
    - `turned`, `flat` [rad]: the thread turns by at most `turned` at a control point in a middle.
      In a strand whose knots were made for a bend, `bent` (strands,), one point turns it by at
      least `flat`.
    - `EI` [N m²], the thread's `length` [m], and the `least` tension [N].
    """

    first: Array
    rigid: Array
    made: Array
    between: Indices
    limits: Array
    strand: Indices
    bent: Flags
    part: float
    longest: float
    coarse: float
    fine: float
    grown: float
    turned: float
    flat: float
    EI: float
    length: float
    least: float


@loop
def place_field(field: Field, ride: Ride, s: Array) -> None:
    """Write the places of the knots of an earlier curve, with holes at `s` (m,) [m]."""
    place_knots(ride, s, field.S)
    put_breaks(field.polynomials, field.first, field.S, field.at, field.knots[1] - field.knots[0])


@loop
def put_breaks(polynomials: Array, first: Indices, S: Array, breaks: Array, width: float) -> None:
    """Write the abscissae of the ends of spans that all have the same `width` in χ."""
    last = len(first) - 1
    for e in range(len(first)):
        breaks[e] = on_span(polynomials[e, 0], S, first[e])
    breaks[last + 1] = breaks[last]
    for r in range(1, 4):
        breaks[last + 1] += on_span(polynomials[last, r], S, first[last]) * width**r


@loop
def put_curve(field: Field, x: float, q: Array, y: float, v: Array) -> None:
    """Write x q + y v, the control values of an earlier curve."""
    for i in range(len(q)):
        for a in range(3):
            field.c[i, a] = x * q[i, a] + y * v[i, a]


@loop
def place_along(ride: Ride, S: Array, field: Field, along: Along) -> None:
    """Write the abscissae of a thread whose knots are at `S` (n,) [m]; its spans are those of a `field`."""
    put_breaks(field.polynomials, field.first, S, along.breaks, field.knots[1] - field.knots[0])
    for e in range(len(along.axial)):
        middle = 0.5 * (along.breaks[e] + along.breaks[e + 1])
        for g in range(along.axial.shape[1]):
            s = on_span(ride.axial_value[e, g], S, field.first[e])
            along.axial[e, g] = s + INSIDE * (middle - s)
            along.share[e, g] = ride.axial_w[e, g] * on_span(ride.axial_slope[e, g], S, field.first[e])
    for i in range(len(S)):
        along.greville[i] = S[i]


@loop
def pass_knots(ride: Ride, S: Array, q: Array, drive: Array, at: Passing) -> None:
    """Evaluate the thread at the knots of its holes."""
    for k in range(len(ride.first)):
        pass_knot(ride, S, q, k, at)
        at.drive[k] = drive[k]


@loop
def fits(fit: Fit, q: Array, T: Array, s: Array, present: Flags) -> bool:
    """Return whether knots fit the tensions next to the holes, the lengths of the strands, and the
    bends of a thread.

    The thread is at `q` (n, 3) [m] with tensions `T` (m, 2) [N] next to its holes at `s` (m,) [m].
    """
    for k in range(len(s)):
        if present[k] and fit.first[k] > 0.0:
            layer = min(np.sqrt(fit.EI / max(T[k, 0], T[k, 1], fit.least)), fit.length)
            wanted = min(fit.part * layer, fit.longest)
            if not fit.fine * wanted <= fit.first[k] <= fit.coarse * wanted:
                return False
    for e in range(len(fit.made)):
        low, high = strand_end(fit.between, fit.limits, s, e, LEFT), strand_end(fit.between, fit.limits, s, e, RIGHT)
        length = high - low - fit.rigid[e]
        if not (length < fit.grown * fit.made[e] and length * fit.grown > fit.made[e]):
            return False
    return bends_as_made(fit, q)


@loop
def bends_as_made(fit: Fit, q: Array) -> bool:
    """Return whether the middles of strands bend about as much as when their knots were made."""
    at, largest, last = -1, 0.0, len(q) - 1
    for i in range(1, last + 1):
        strand = fit.strand[i] if i < last else -1
        if strand != at:
            if at >= 0 and fit.bent[at] and largest < fit.flat:
                return False
            at, largest = strand, 0.0
        if strand >= 0:
            largest = max(largest, turn_at(q, i))
        if largest > fit.turned:
            return False
    return True


@loop
def turn_at(q: Array, i: int) -> float:
    """Return the angle between the two legs of the polygon of control points (n, 3) at point i [rad]."""
    back = (q[i, 0] - q[i - 1, 0], q[i, 1] - q[i - 1, 1], q[i, 2] - q[i - 1, 2])
    forth = (q[i + 1, 0] - q[i, 0], q[i + 1, 1] - q[i, 1], q[i + 1, 2] - q[i, 2])
    return float(np.arctan2(norm(cross(back, forth)), dot(back, forth)))


@owning
def put_on(ride: Ride, field: Field, S: Array, mass: Array, out: Array) -> None:
    """Write the control values of an earlier curve on other knots, shape `(n, 3)`, by least squares.

    The knots are at `S` (n,) [m]. The least squares are weighted with the mass, whose upper band is
    `mass` (n, 4) [kg] (`thread.riding.put_on`).
    """
    n = len(S)
    for i in range(n):
        for x in range(3):
            out[i, x] = 0.0
    for e in range(len(field.first)):
        first = field.first[e]
        for g in range(ride.mass_w.shape[1]):
            b = ride.value[e, g]
            P = read_field(field, on_span(b, S, first), e)[0]
            w = ride.rhoA * ride.mass_w[e, g] * on_span(ride.mass_slope[e, g], S, first)
            for i in range(4):
                out[first + i, 0] += w * b[i] * P[0]
                out[first + i, 1] += w * b[i] * P[1]
                out[first + i, 2] += w * b[i] * P[2]
    for end in range(2):
        i = end * (n - 1)
        for x in range(3):
            out[i, x] += ride.ends[end] * field.c[i, x]
    solve_mass(mass, out)


@owning
def put_rates(ride: Ride, fields: tuple[Field, Field], d: float, r: Found, q: Array, v: Array) -> None:
    """Write v = d (q − Σ of the earlier curves), (n, 3) [m/s], on the knots of a solved step."""
    places = np.zeros(q.shape)
    put_on(ride, fields[0], r.ridden.S, r.ridden.mass, v)
    put_on(ride, fields[1], r.ridden.S, r.ridden.mass, places)
    for i in range(len(q)):
        for x in range(3):
            v[i, x] = d * (q[i, x] - v[i, x] - places[i, x])


@owning
def solve_mass(mass: Array, X: Array) -> None:
    """Replace `X` (n, 3) by M⁻¹X, by L D Lᵀ of M with the upper band `mass` (n, 4)."""
    n, U = len(mass), mass.copy()
    for i in range(n):
        for k in range(1, min(REACH, n - 1 - i) + 1):
            lower = U[i, k] / U[i, 0]
            for j in range(k, REACH + 1):
                U[i + k, j - k] -= lower * U[i, j]
            for x in range(3):
                X[i + k, x] -= lower * X[i, x]
    for i in range(n - 1, -1, -1):
        for x in range(3):
            for k in range(1, min(REACH, n - 1 - i) + 1):
                X[i, x] -= U[i, k] * X[i + k, x]
            X[i, x] /= U[i, 0]


@owning
def kinetic_at(curve: Curve, ride: Ride, fields: tuple[Field, Field], q: Array, v: Array, part: Ridden) -> float:
    """Return the kinetic energy of the thread with its knots at those of the first field [J]; `part` is overwritten."""
    n = len(q)
    clear_ridden(part)
    copy_into(fields[0].S, part.S)
    F, momentum, none = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    add_inertia(curve, ride, fields, 0.0, q, F, part)
    add_end_masses(ride, fields, 0.0, q, F, part)
    add_momentum(part.mass, 1.0, v, none, momentum)
    return 0.5 * product(v, momentum)


@owning
def audit_ride(
    curve: Curve, given: Given, works: Works, holes: Holes, r: Found, part: Ridden, old: Motion, new: Motion,
    met: Met, out: Array,
) -> None:  # fmt: skip
    """Write the energy turnover of a thread whose knots travel in a step into `out`.

    The terms are those of `coupling.reports.audit.turned_over`. The first field has the knots at
    the start of the step.
    """
    ride, field, mass, n = given.ride, given.fields[0], r.ridden.mass, len(new.q)
    at_q, at_v, none = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    moved, faster, momentum, F = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    put_curve(field, 1.0, old.q, 0.0, old.v)
    put_on(ride, field, r.ridden.S, mass, at_q)
    put_curve(field, 1.0, old.v, 0.0, old.v)
    put_on(ride, field, r.ridden.S, mass, at_v)
    add_momentum(mass, 1.0, new.q, at_q, moved)
    add_momentum(mass, 1.0, new.v, at_v, faster)
    add_momentum(mass, 1.0, new.v, none, momentum)
    out[ELASTIC] = elastic_energy(curve, r.stretched)
    on = OnThread(r.elastic, given.load, r.balance, given.held, r.push, moved, faster, momentum, at_v)
    audit_step(works, holes, on, old, new, met, out)
    beyond, by_ds, by_weight = kinetic_at(curve, ride, given.fields, old.q, old.v, part), 0.0, 0.0
    clear_ridden(part)
    copy_into(r.ridden.S, part.S)
    add_elastic_rates(curve, ride, r.stretched, new.N, part)
    by_elastic = part.by_s.copy()
    clear_ridden(part)
    add_inertia(curve, ride, given.fields, 0.0, new.q, F, part)
    add_end_masses(ride, given.fields, 0.0, new.q, F, part)
    for k in range(len(new.s)):
        ds = new.s[k] - old.s[k]
        by_ds += by_elastic[k] * ds
        by_weight += part.by_s[k] * ds
        beyond += (r.ridden.by_s[k] - by_elastic[k] - part.by_s[k]) * ds
    for i in range(n):
        for x in range(3):
            inertia = r.balance[i, x] - r.elastic[i, x] + given.load[i, x] - F[i, x] + r.push[i, x]
            beyond += inertia * (new.q[i, x] - old.q[i, x])
    beyond -= 0.5 * product(new.v, momentum)
    beyond -= works.damping * product(new.v, moved) + 0.5 * work_along(faster, at_v, new.v)
    out[EXTERNAL] -= work_along(F, old.q, new.q) + by_weight
    out[NUMERICAL] += by_ds
    if works.two_step:
        out[TWO_STEP] += beyond + product(new.v, faster)
    else:
        out[NUMERICAL] += beyond


knots_fit = entry(fits)  # for Python
