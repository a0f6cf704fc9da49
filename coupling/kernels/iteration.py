"""Newton's iteration on one step, one active set after another (`coupling.step.newton`)."""

from typing import Any, NamedTuple

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.kernels.band import REACH, hold_still, solve_band
from coupling.kernels.border import (
    AT_K,
    BORDER,
    LARGEST,
    NINE,
    OF_U,
    OF_V,
    OF_X,
    Border,
    clear_border,
    linearise_hold,
    number_border,
    put_columns,
    put_riding,
    site_residual,
    solve_holds,
    stiffen_hold,
    thread_direction,
    values_at_hold,
    values_riding,
)
from coupling.kernels.friction import (
    Law,
    Ruled,
    fit_sigma,
    is_length,
    join_residuals,
    residual,
    rule_hold,
    rule_set,
)
from coupling.kernels.holes import Hold, gap, hold_at, site_force
from thread.kernels import curve as on_curve
from thread.kernels.curve import FIRST, Curve, Stretched, along_span, put
from thread.kernels.loops import entry, loop, outermost, owning, sources
from thread.kernels.records import record
from thread.kernels.travel import (
    Field,
    Ridden,
    Ride,
    add_elastic_rates,
    add_end_masses,
    add_inertia,
    clear_ridden,
    next_riding_force,
    on_span,
    place_curve,
    place_knots,
)
from thread.kernels.vectors import add_row, dot, sum_of

SOLVED, RAN_AWAY, SINGULAR_THREAD, SINGULAR_HOLDS, NOT_CONVERGED, ALTERNATES = range(6)  # ends of an iteration
# Of EA, because the axial force is EA times a difference of numbers close to 1; and of a stiffness times a place.
ROUND_OFF = 2e-14
KNOWN_SPANS = 15.0  # mean spans from the origin within which a strain has an error of ROUND_OFF
LEFT = 0.1  # of the length between two holes: least part that one correction leaves
FORCE_TOLERANCE = 1e-10  # of the largest force in the step
DIRECTION_TOLERANCE = 1e-11  # of |T||u| ≈ 1
ALONG = 4.0  # of the round-off of forces: with travelling knots the force along the thread is from two strands
MARGIN = 4.0  # of the force tolerance, for stick and slip; two solved sets can differ by twice the tolerance
RETURNS = 2  # to one active set, at most: after the first one hole or pair changes, the second is a cycle
HOW, TOTAL, SETS, OF_SET = range(4)  # entries of `Trail.made`
TINY = 2.2250738585072014e-308
Limits = tuple[float, float, float]  # tolerances of a force, a gap and a force along the thread


@record
class Knots(NamedTuple):
    """The spline.

    `breaks` (spans + 1,) [m], `first` (spans,), `polynomials` (spans, 4, 4), and the upper band of
    M, `mass` (n, 4) [kg].
    """

    breaks: Array
    first: Indices
    polynomials: Array
    mass: Array


@record
class Given(NamedTuple):
    """The constant data of one step.

    - `q_ref`, `load` (n, 3): reference of the inertia and load on the thread.
    - `held` (n, 3): the prescribed unknowns of the thread.
    - `y_free` (m, 9), `C` (9m, 9m): the organ's answer.
    - `rows` (m, 5), `directed` (m,): the active constraints, and the holds that impose a direction.
    - `spans` (m, 2), `piece` (m, 2) [m]: the first and last span of the piece of each hold, and the
      abscissae at which the thread leaves the hold.
    - `stiffen`: whether the stiffness of the constraints is added to the thread's band.
    - `gaps` (t, 3) [m]: gaps between the strands of ties.
    - `rounded` (m, 9) [m, -]: round-off of the sites.
    - `ride`, `fields`: the travel of knots, and the two earlier curves. If knots travel, the sum of
      these curves replaces `q_ref`, and `load` does not contain the thread's weight.
    """

    q_ref: Array
    load: Array
    held: Flags
    y_free: Array
    C: Array
    rows: Flags
    directed: Flags
    spans: Indices
    piece: Array
    mass_factor: float
    stiffen: bool
    gaps: Array
    rounded: Array
    ride: Ride
    fields: tuple[Field, Field]


@record
class Bounds(NamedTuple):
    """The tolerances and limits of an iteration.

    - `rounded` (1,) [N]: round-off of forces, added to their tolerance.
    - `least` [N]: lower bound of the largest force.
    - `gap` [m]: tolerance of a place.
    - `longest` [m]: largest move in a correction.
    - `iterations`, `sets`: limits of the corrections for one active set, and of the sets.
    - `pieces` (p, 2), `floats` (p,): first control point of each piece of the thread and of what
      follows it, and whether nothing holds the piece.
    """

    rounded: Array
    least: float
    gap: float
    longest: float
    iterations: int
    sets: int
    pieces: Indices
    floats: Flags


@record
class Unknowns(NamedTuple):
    """The iterate, as `coupling.step.newton.Iterate`."""

    q: Array
    N: Array
    s: Array
    lam: Array
    y: Array
    sigma: Array


@record
class Trail(NamedTuple):
    """The history of an iteration.

    `seen` (sets, m) are the solved active sets. `made` (4,) has the end of the iteration (HOW), all
    corrections (TOTAL), the number of solved SETS, and the corrections of the unsolved set
    (OF_SET).
    """

    seen: Array
    made: Indices


@record
class Passing(NamedTuple):
    """The thread at its holes, as `coupling.kernels.constraints.Passage`.

    `D` (m, 4, 3) has P to T''; `b` (m, 4, 4), `first` (m,). `drive` (m,) [N] is zero if knots do
    not travel.
    """

    first: Indices
    b: Array
    D: Array
    drive: Array


@record
class Found(NamedTuple):
    """The residual at the iterate, as `coupling.step.newton.Residual`.

    It has the thread at its holes, `passing`, and at its quadrature points, `stretched`; the
    `trail` of the iteration; and what depends on the abscissae if knots travel, `ridden`. The
    linearised holds, `border`, and their law, `ruled`, are those of the last evaluation.
    """

    elastic: Array
    balance: Array
    push: Array
    holds: Array
    site: Array
    f_y: Array
    passing: Passing
    stretched: Stretched
    trail: Trail
    ridden: Ridden
    border: Border
    ruled: Ruled


def force_rounded(EA: float, by_place: float, span: float, place: float) -> float:
    """Return the round-off of forces that cancel [N].

    The stiffnesses are `EA` [N] and `by_place` [N/m], and the largest `place` is in m. The strain
    is a difference of places over a `span` [m], so that it has fewer digits if the thread is many
    spans away from the origin.
    """
    return ROUND_OFF * (EA * max(1.0, place / (KNOWN_SPANS * span)) + by_place * place)


rounded_force = loop(force_rounded)


@loop
def clear(M: Array) -> None:
    """Set a matrix to zero."""
    for i in range(M.shape[0]):
        for j in range(M.shape[1]):
            M[i, j] = 0.0


@loop
def copy_into(a: Array, b: Array) -> None:
    """Write the numbers of a vector into another."""
    for i in range(len(a)):
        b[i] = a[i]


@loop
def span_of(breaks: Array, s: float, low: int, high: int) -> int:
    """Return the index of the span from `low` to `high` that contains s, or is nearest to it."""
    while low < high:
        middle = (low + high + 1) // 2
        if s < breaks[middle]:
            high = middle - 1
        else:
            low = middle
    return low


@loop
def pass_hold(knots: Knots, given: Given, q: Array, s: float, k: int, r: Passing) -> None:
    """Evaluate the thread at hold k, which is at the abscissa s."""
    span = span_of(knots.breaks, s, given.spans[k, 0], given.spans[k, 1])
    x, p, first = s - knots.breaks[span], knots.polynomials[span], knots.first[span]
    r.first[k] = first
    for i in range(4):
        r.b[k, 0, i] = p[0, i] + x * (p[1, i] + x * (p[2, i] + x * p[3, i]))
        r.b[k, 1, i] = p[1, i] + x * (2.0 * p[2, i] + x * 3.0 * p[3, i])
        r.b[k, 2, i] = 2.0 * p[2, i] + 6.0 * x * p[3, i]
        r.b[k, 3, i] = 6.0 * p[3, i]
    for order in range(4):
        put(along_span(r.b[k, order], q, first), r.D[k], order, FIRST)


@loop
def pass_knot(ride: Ride, S: Array, q: Array, k: int, r: Passing) -> None:
    """Evaluate the thread at the knot of hold k, with knots that travel and are at `S` (n,) [m].

    P and T do not depend on s.
    """
    first = ride.first[k]
    r.first[k], rate = first, on_span(ride.at[k, 1], S, first)
    for i in range(4):
        r.b[k, 0, i], r.b[k, 1, i] = ride.at[k, 0, i], ride.at[k, 1, i] / rate
        r.b[k, 2, i] = r.b[k, 3, i] = 0.0
    for order in range(4):
        put(along_span(r.b[k, order], q, first), r.D[k], order, FIRST)


@loop
def hold_of(given: Given, z: Unknowns, r: Found, k: int) -> Hold:
    """Return hold k."""
    return hold_at(r.passing.D[k], given.ride.on, -r.ridden.by_s[k], z.lam[k], z.y[k])


@loop
def add_momentum(mass: Array, factor: float, q: Array, q_ref: Array, out: Array) -> None:
    """Add factor M (q − q_ref) to `out` (n, 3)."""
    n = len(q)
    for i in range(n):
        for x in range(3):
            moved = factor * (q[i, x] - q_ref[i, x])
            out[i, x] += mass[i, 0] * moved
            for k in range(1, min(REACH, n - 1 - i) + 1):
                out[i + k, x] += mass[i, k] * moved
                out[i, x] += mass[i, k] * factor * (q[i + k, x] - q_ref[i + k, x])


@loop
def evaluate(curve: Curve, knots: Knots, law: Law, given: Given, z: Unknowns, r: Found) -> float:
    """Evaluate all residuals of a step. Returns the largest force [N]."""
    at, passing, ride = r.stretched, r.passing, given.ride
    clear_ridden(r.ridden)
    if ride.on:
        place_knots(ride, z.s, r.ridden.S)
        place_curve(ride, r.ridden.S, curve)
    on_curve.evaluate(curve, z.q, at)
    clear(r.elastic)
    clear(r.push)
    on_curve.add_gradient(curve, at, r.elastic)
    scale = balance_elastic(r, given.load)
    if ride.on:
        add_elastic_rates(curve, ride, at, z.N, r.ridden)
        add_inertia(curve, ride, given.fields, given.mass_factor, z.q, r.balance, r.ridden)
        add_end_masses(ride, given.fields, given.mass_factor, z.q, r.balance, r.ridden)
    elif given.mass_factor != 0.0:
        add_momentum(knots.mass, given.mass_factor, z.q, given.q_ref, r.balance)
    for k in range(len(z.s)):
        if ride.on:
            pass_knot(ride, r.ridden.S, z.q, k, passing)
        else:
            pass_hold(knots, given, z.q, z.s[k], k, passing)
        h, b = hold_of(given, z, r, k), passing.b[k]
        scale = max(scale, abs(h.lam[0]), abs(h.lam[1]), abs(h.lam[2]))
        for i in range(4):
            add_row(1.0, sum_of(b[0, i], h.lam, b[1, i], h.m), r.push, passing.first[k] + i, FIRST)
        evaluate_hold(law, given, z, k, h, r)
    join_residuals(law, z.sigma, z.s, r.holds)
    subtract_push(r)
    site_residual(law.joints, given.C, given.y_free, given.gaps, z.y, r.f_y, r.site)
    return scale


@loop
def balance_elastic(r: Found, load: Array) -> float:
    """Start the balance with the elastic force minus the load. Returns the largest of these forces [N]."""
    largest = 0.0
    for i in range(len(load)):
        for x in range(3):
            r.balance[i, x] = r.elastic[i, x] - load[i, x]
            largest = max(largest, abs(r.elastic[i, x]), abs(load[i, x]))
    return largest


@loop
def subtract_push(r: Found) -> None:
    """Subtract the forces of the holes from the balance."""
    for i in range(len(r.push)):
        for x in range(3):
            r.balance[i, x] -= r.push[i, x]


@loop
def evaluate_hold(law: Law, given: Given, z: Unknowns, k: int, h: Hold, r: Found) -> None:
    """Evaluate the law of sliding, Φ and the force on the site of one hold."""
    holds = r.holds[k]
    holds[0] = residual(law, k, z.sigma[k], h, z.s[k])
    holds[1], holds[2], holds[3] = gap(h)
    holds[4], holds[5] = dot(h.T, h.u), dot(h.T, h.v)
    for j in range(5):
        if not given.rows[k, j]:
            holds[1 + j] = z.lam[k, j]
    f_x, f_u, f_v = site_force(h)
    put(f_x, r.f_y, k, OF_X)
    put(f_u, r.f_y, k, OF_U)
    put(f_v, r.f_y, k, OF_V)


@loop
def is_converged(law: Law, given: Given, bounds: Bounds, force: float, z: Unknowns, r: Found) -> bool:
    """Return whether every equation holds to its tolerance; `force` [N] is the one of forces."""
    for i in range(len(r.balance)):
        for x in range(3):
            if not given.held[i, x] and not abs(r.balance[i, x]) <= force:
                return False
    along = force + (ALONG - 1.0) * bounds.rounded[0] if given.ride.on else force
    limits = force, bounds.gap, along
    return are_holds_solved(law, z.sigma, given.rows, limits, r.holds, r.site, given.rounded)


@loop
def are_holds_solved(
    law: Law, sigma: Array, rows: Flags, limits: Limits, holds: Array, site: Array, rounded: Array
) -> bool:
    """Return whether the law of sliding, Φ and the equations of the sites hold to the `limits`.

    The limits are those of a force [N], a gap [m] and a force along the thread [N]. The limit of a site
    is at least its round-off, `rounded` (m, 9).
    """
    force, gap, along = limits
    for k in range(len(holds)):
        if not abs(holds[k, 0]) <= (gap if is_length(law, sigma, k) else along):
            return False
        for j in range(5):
            limit = gap if j < 3 else DIRECTION_TOLERANCE
            if not abs(holds[k, 1 + j]) <= (limit if rows[k, j] else force):
                return False
        for j in range(NINE):
            if not abs(site[k, j]) <= max(gap if j < 3 else DIRECTION_TOLERANCE, rounded[k, j]):
                return False
    return True


@loop
def linearise_holds(law: Law, given: Given, z: Unknowns, r: Found) -> None:
    """Write the linearised holds."""
    border = r.border
    clear_border(border)
    for k in range(len(z.s)):
        for other in range(len(z.s)):
            border.S[k, other] = -r.ridden.by_ss[k, other]
        linearise_hold(law, k, z.sigma[k], hold_of(given, z, r, k), given.rows[k], border)


@owning
def thread_matrix(curve: Curve, knots: Knots, given: Given, z: Unknowns, r: Found) -> Array:
    """Return the thread's own matrix as a block band: inertia and stiffness."""
    n = len(z.q)
    A = np.zeros((n + REACH, 3, 3 * (REACH + 1)))
    mass = r.ridden.mass if given.ride.on else knots.mass
    for i in range(n):
        for k in range(REACH + 1):
            for x in range(3):
                A[i, x, 3 * k + x] = given.mass_factor * mass[i, k]
    on_curve.add_tangent(curve, r.stretched, z.N, A)
    return A


@loop
def largest(A: Array) -> float:
    """Return the largest absolute entry of an array of three axes."""
    found = 0.0
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            for k in range(A.shape[2]):
                found = max(found, abs(A[i, j, k]))
    return found


@owning
def add_constraint_stiffness(A: Array, given: Given, r: Found) -> None:
    """Add Φ_qᵀ Γ (Φ_q dq + … + Φ) to the thread's equations.

    The solution does not change. The matrix becomes regular even if the thread could move or turn
    freely without the constraints (statics).
    """
    scale, b, first = largest(A), r.passing.b, r.passing.first
    for k in range(len(r.holds)):
        K, push = np.zeros((NINE, NINE)), np.zeros(NINE)
        stiffen_hold(scale, given.rows[k], b[k], r.border, r.holds[k], k, K, push)
        add_at_hold(A, r.balance, K, push, b[k], first[k])


@loop
def add_at_hold(A: Array, balance: Array, K: Array, push: Array, b: Array, first: int) -> None:
    """Add a stiffness `K` (9, 9) and a force `push` (9,) of (P, T, T') at a hold to its four control points."""
    for j in range(4):
        for i in range(NINE):
            balance[first + j, i % 3] += b[i // 3, j] * push[i]
    for i in range(4):
        for j in range(i, 4):
            for x in range(3):
                for y in range(3):
                    stiff = 0.0
                    for one in range(3):
                        for other in range(3):
                            stiff += b[one, i] * K[3 * one + x, 3 * other + y] * b[other, j]
                    A[first + i, x, 3 * (j - i) + y] += stiff


@owning
def newton_direction(A: Array, law: Law, sigma: Array, given: Given, r: Found, dq: Array, dz: Array) -> int:
    """Solve for the direction `dq` (n, 3), `dz` (m, 15). Returns SOLVED, or which matrix is singular."""
    n, m, rides, border, at = len(r.balance), len(r.holds), given.ride.on, r.border, r.passing
    orders = 2 if rides else 3
    reads, pushes = number_border(border, r.holds, law.joints)
    X, first = np.zeros((n + REACH, 3, 1 + pushes)), n
    for k in range(m):
        put_columns(at.first[k], at.b[k], orders, X, border.push[k])
        first = min(first, at.first[k])
        if rides and border.push[k, AT_K] >= 0:
            put_riding(k, r.ridden.by_qs, X, 1 + border.push[k, AT_K])
            first = 0
    for i in range(n):
        for x in range(3):
            X[i, x, 0] = -r.balance[i, x]
            if given.held[i, x]:
                for j in range(X.shape[2]):
                    X[i, x, j] = 0.0
    if not solve_band(A, X, first):
        return SINGULAR_THREAD
    G = np.zeros((reads, 1 + pushes))
    for k in range(m):
        values_at_hold(at.first[k], at.b[k], orders, X, G, border.read[k])
        if rides and border.read[k, AT_K] >= 0:
            values_riding(k, r.ridden.by_qs, X, G[border.read[k, AT_K]])
    if not solve_holds(border, given.C, G, r.holds, r.site, law.joints, sigma, dz):
        return SINGULAR_HOLDS
    return SOLVED if thread_direction(border, dz, X, dq) else SINGULAR_HOLDS


@loop
def longest_way(dq: Array, lever: Array, pieces: Indices, floats: Flags) -> float:
    """Return the longest way of a control point under a move `dq` (n, c) [m].

    The mean move of a piece of the thread that `floats` is subtracted.
    """
    longest = 0.0
    for k in range(len(floats)):
        first, end = pieces[k, 0], pieces[k, 1]
        for x in range(dq.shape[1]):
            mean = 0.0
            if floats[k]:
                for i in range(first, end):
                    mean += dq[i, x] / (end - first)
            for i in range(first, end):
                longest = max(longest, abs((dq[i, x] - mean) * lever[x]))
    return longest


@loop
def allowed_share(longest: float, pieces: Indices, floats: Flags, lever: Array, dq: Array) -> float:
    """Return the part of a correction `dq` (n, c) that is applied.

    No control point moves further than `longest` [m]; the mean move of a piece that `floats` does not
    count. A coordinate moves the thread by its `lever` (c,) [-, m].
    """
    return min(1.0, longest / max(longest_way(dq, lever, pieces, floats), TINY))


@loop
def share_between_holes(ride: Ride, S: Array, dz: Array) -> float:
    """Return the part of a correction that leaves at least LEFT of the length of each part of the
    thread between two holes.
    """
    share, before = 1.0, 0.0
    for i in range(len(S)):
        moved = 0.0
        for k in range(len(dz)):
            moved += ride.b[i, k] * dz[k, 0]
        if i > 0 and moved < before:
            share = min(share, (1.0 - LEFT) * (S[i] - S[i - 1]) / (before - moved))
        before = moved
    return share


@loop
def add_correction(bounds: Bounds, lever: Array, ride: Ride, S: Array, z: Unknowns, dq: Array, dz: Array) -> None:
    """Add the allowed part of a correction; `dq` and the first column of `dz` become the applied changes."""
    share = allowed_share(bounds.longest, bounds.pieces, bounds.floats, lever, dq)
    if ride.on:
        share = min(share, share_between_holes(ride, S, dz))
    for i in range(len(dq)):
        for x in range(3):
            dq[i, x] *= share
            z.q[i, x] += dq[i, x]
    for k in range(len(z.s)):
        dz[k, 0] *= share
        z.s[k] += dz[k, 0]
        for j in range(5):
            z.lam[k, j] += share * dz[k, 1 + j]
        for j in range(NINE):
            z.y[k, j] += share * dz[k, 6 + j]


@owning
def solve_set(
    curve: Curve, knots: Knots, law: Law, given: Given, bounds: Bounds, z: Unknowns, r: Found
) -> tuple[int, float]:
    """Iterate by Newton's method with the active set. Returns the end of the iteration and the
    largest force [N].

    The corrections are counted in the trail. The force is that of the last iterate, at which the
    residual is.
    """
    dq, dz = np.zeros((len(z.q), 3)), np.zeros((len(z.s), BORDER))
    lever, made = np.ones(3), r.trail.made
    while True:
        scale = max(evaluate(curve, knots, law, given, z, r), bounds.least)
        if made[OF_SET] == bounds.iterations:
            return NOT_CONVERGED, scale
        if not scale < LARGEST:
            return RAN_AWAY, scale
        if is_converged(law, given, bounds, FORCE_TOLERANCE * scale + bounds.rounded[0], z, r):
            return SOLVED, scale
        A = thread_matrix(curve, knots, given, z, r)
        linearise_holds(law, given, z, r)
        if given.stiffen:
            add_constraint_stiffness(A, given, r)
        hold_still(A, given.held)
        ending = newton_direction(A, law, z.sigma, given, r, dq, dz)
        if ending != SOLVED:
            return ending, scale
        add_correction(bounds, lever, given.ride, r.ridden.S, z, dq, dz)
        on_curve.next_axial_force(curve, r.stretched, dq, z.N)
        if given.ride.on:
            next_riding_force(curve, given.ride, r.stretched, dz, z.N)
        made[OF_SET] += 1
        made[TOTAL] += 1


@loop
def times_seen(seen: Array, count: int, sigma: Array) -> int:
    """Return how often an active set is among the first `count` of those `seen`."""
    times = 0
    for i in range(count):
        same = True
        for k in range(len(sigma)):
            same &= seen[i, k] == sigma[k]
        times += same
    return times


@loop
def next_set(law: Law, given: Given, z: Unknowns, r: Found, margin: float, seen: Array, count: int) -> bool:
    """Take the active set that fits the forces of a solved iterate. Returns False if the iterate has this set.

    `seen` (k, m) are the sets of the `count` iterates solved so far. If the fitting set is among
    them, only the first differing hold is changed.
    """
    first, out = -1, r.ruled
    for k in range(len(z.s)):
        rule_hold(law, k, z.sigma[k], hold_of(given, z, r, k), z.s[k], out)
    rule_set(law, z.sigma, z.s, margin, out)
    fitting = out.fits
    for k in range(len(z.s)):
        if first < 0 and fitting[k] != z.sigma[k]:
            first = k
    if first < 0:
        return False
    if times_seen(seen, count, fitting) > 0:
        z.sigma[first] = fitting[first]
        fit_sigma(law, z.sigma)
    else:
        copy_into(fitting, z.sigma)
    return True


@loop
def solve_step(curve: Curve, knots: Knots, law: Law, given: Given, bounds: Bounds, z: Unknowns, r: Found) -> int:
    """Iterate until every equation holds and stick and slip fit the solution. Returns the
    corrections, −1 if this was not reached.
    """
    seen, made = r.trail.seen, r.trail.made
    for i in range(len(made)):
        made[i] = 0
    fit_sigma(law, z.sigma)
    while made[SETS] < bounds.sets:
        made[HOW], scale = solve_set(curve, knots, law, given, bounds, z, r)
        if made[HOW] != SOLVED:
            return -1
        copy_into(z.sigma, seen[made[SETS]])
        made[SETS] += 1
        made[OF_SET] = 0
        often = times_seen(seen, made[SETS], z.sigma)
        margin = MARGIN * (FORCE_TOLERANCE * scale + bounds.rounded[0])
        if not next_set(law, given, z, r, margin, seen, made[SETS]):
            return made[TOTAL]
        if often > RETURNS:
            break
    made[HOW] = ALTERNATES
    return -1


def solve_of(digest: int) -> Any:
    """Return the function that solves a step, cached on disk for kernels of this `digest`.

    The loops of whole steps call the function by its address. Its arguments are therefore declared,
    unlike those of an `entry`.
    """

    @outermost
    def solve(curve: Curve, knots: Knots, law: Law, given: Given, bounds: Bounds, z: Unknowns, r: Found) -> int:
        """Solve a step, as `solve_step`."""
        assert digest
        return solve_step(curve, knots, law, given, bounds, z, r)

    return solve


solve = solve_of(sources(__file__))
share_between = entry(share_between_holes)
share, holds_solved = entry(allowed_share), entry(are_holds_solved)  # for Python
