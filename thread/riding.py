"""A thread with travelling knots, in the form of the kernels (`thread.kernels.travel`)."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solveh_banded

from thread.arrays import Array
from thread.energies.continuous import Continuous
from thread.kernels.travel import (
    Field,
    Ridden,
    Ride,
    carried_of,
    elastic_rates_of,
    end_masses_of,
    inertia_of,
    riding_force_of,
)
from thread.placed import Placed
from thread.spline import ORDERS, Spline
from thread.thread import Points, Thread

LOCAL = np.arange(ORDERS)


def plain(x: Array) -> Array:
    """Return an array in the form of the kernels, in C order."""
    return np.ascontiguousarray(x, dtype=float)


def rates_of(spline: Placed, b: Array) -> Array:
    """Return the rates of Σ b_i S_i by the abscissae of the holds at both ends of the strand, shape
    `(spans, g, 2)`.

    `b` has shape (spans, g, 4). The rate is zero for an end of the thread.
    """
    travel, local = spline.travel, spline.first[:, None] + LOCAL
    moves, out = np.pad(travel.b, ((0, 0), (0, 1))), np.zeros((*b.shape[:2], 2))  # the last column is for END
    for side in range(2):
        out[:, :, side] = np.einsum("egi,ei->eg", b, moves[local, travel.between[:, side, None]])
    return out


def ride_of(thread: Thread, gravity: Array) -> Ride:
    """Return the travel of a thread's knots under `gravity` (3,) [m/s²], or (spans, 3) with one
    vector per span.
    """
    spline = thread.spline
    if not isinstance(spline, Placed):
        return standing(thread)
    chi, travel = spline.chi, spline.travel
    (bending, stretch, ends), mass = thread.knot_rules, thread.mass_over_knots
    B, A, M = bending.b, stretch.b, mass.b
    first, at = chi.basis(chi.breaks[travel.at])
    return Ride(
        True,
        plain(travel.a),
        plain(travel.b),
        travel.between.astype(np.int64),
        plain(travel.limits),
        plain(B[:, :, 1]),
        plain(B[:, :, 2]),
        plain(bending.w),
        rates_of(spline, B[:, :, 1]),
        plain(A[:, :, 0]),
        plain(A[:, :, 1]),
        plain(stretch.w),
        rates_of(spline, A[:, :, 1]),
        plain(ends.b[:, :, 1]),
        plain(ends.w),
        rates_of(spline, ends.b[:, :, 0]),
        plain(M[:, :, 0]),
        plain(M[:, :, 1]),
        plain(mass.w),
        rates_of(spline, M[:, :, 1]),
        rates_of(spline, M[:, :, 0]),
        first.astype(np.int64),
        plain(at[:, :2]),
        float(thread.section.rhoA),
        plain(np.broadcast_to(gravity, (len(spline.first), 3))),
        plain(np.array(thread.point_masses)),
    )


def standing(thread: Thread) -> Ride:
    """Return the empty `Ride` of a thread with fixed knots."""
    none, plane, block = np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0, 0))
    return Ride(
        False, none, plane, np.zeros((0, 2), np.int64), plane, block, block, plane, block, block, block, plane, block,
        block, plane, block, block, block, plane, block, block, np.zeros(0, np.int64), block,
        float(thread.section.rhoA), plane, plain(np.array(thread.point_masses)),
    )  # fmt: skip


def field_of(spline: Spline, c: Array) -> Field:
    """Return the field of an earlier curve with control values `c` (n, 3) [m] on its own spline."""
    knots = plain(spline.parameters)
    S = spline.places if isinstance(spline, Placed) else spline.greville
    return Field(
        knots, plain(spline.breaks), spline.first.astype(np.int64), plain(spline.polynomials), plain(S), plain(c)
    )


def put_on(thread: Thread, curves: Sequence[tuple[Spline, Array]]) -> Array:
    """Return the control values (n, c) of the sum of `curves`, approximated on a thread's knots.

    `curves` are splines with control values (n', c). The approximation is by least squares,
    weighted with the thread's mass, and preserves the momentum and the moment of momentum of the
    sum.
    """
    rule = thread.mass_rule
    where, total = rule.s.ravel(), 0.0
    ends = np.zeros((2, curves[0][1].shape[1]))
    for spline, values in curves:
        first, b = spline.basis(np.clip(where, spline.start, spline.end))
        total = total + np.einsum("mi,mic->mc", b[:, 0], values[first[:, None] + LOCAL])
        ends += values[[0, -1]]
    weighted = thread.section.rhoA * rule.w.ravel()[:, None] * total
    local = np.einsum("egi,egc->eic", rule.b[:, :, 0], weighted.reshape(*rule.w.shape, -1))
    load = np.zeros((thread.n, ends.shape[1]))
    np.add.at(load, thread.points_of_span, local)
    load[[0, -1]] += np.array(thread.point_masses)[:, None] * ends
    return np.asarray(solveh_banded(thread.mass_diagonals[:ORDERS], load))


def potential_rates(thread: Thread, gravity: Array, q: Array) -> tuple[Array, Array, Array]:
    """Return derivatives of the weight's potential and of the elastic energy of a thread with
    travelling knots.

    The results are the forces −∂(weight)/∂q, shape `(n, c)` [N], and the derivatives of the
    weight's potential and of the elastic energy by the abscissae of the holes, shape `(m,)` [N]
    each. `gravity` is as for `ride_of`.
    """
    spline, ride = thread.spline, ride_of(thread, gravity)
    assert isinstance(spline, Placed) and isinstance(thread.axial, Continuous)
    weight, elastic = empty_ridden(spline), empty_ridden(spline)
    F, place = np.zeros((thread.n, 3)), plain(q[:, :3])
    none = field_of(spline, np.zeros((thread.n, 3)))
    curve, at = thread.axial.curve, thread.axial.evaluate(place)
    inertia_of(curve, ride, (none, none), 0.0, place, F, weight)
    end_masses_of(ride, (none, none), 0.0, place, F, weight)
    elastic_rates_of(curve, ride, at, thread.EA * at.strain, elastic)
    return np.pad(F, ((0, 0), (0, q.shape[1] - 3))), weight.by_s, elastic.by_s


def empty_ridden(spline: Placed) -> Ridden:
    """Return a `Ridden` with zero derivatives."""
    n, m = spline.travel.b.shape
    return Ridden(plain(spline.places), np.zeros(m), np.zeros((m, m)), np.zeros((n, 3, m)), np.zeros((n, 4)))


def ride(
    thread: Thread, how: Ride, fields: tuple[Field, Field], factor: float, q: Array, N: Array
) -> tuple[Array, Ridden]:
    """Return the forces of inertia and weight, shape `(n, c)` [N], and the derivatives by the
    abscissae of the holes.

    Inertia is `factor` [1/s²] times mass times the distance from the earlier curves `fields`. The
    knots travel by `how`. The thread has control values `q` (n, c) and axial forces `N` (spans, a)
    [N].
    """
    assert isinstance(thread.spline, Placed) and isinstance(thread.axial, Continuous)
    out, F, place = empty_ridden(thread.spline), np.zeros((thread.n, 3)), plain(q[:, :3])
    curve, at = thread.axial.curve, thread.axial.evaluate(place)
    elastic_rates_of(curve, how, at, plain(N), out)
    inertia_of(curve, how, fields, float(factor), place, F, out)
    end_masses_of(how, fields, float(factor), place, F, out)
    return np.pad(F, ((0, 0), (0, q.shape[1] - 3))), out


def with_tie(thread: Thread, how: Ride, q: Array, tie: float, ridden: Ridden) -> Ridden:
    """Return the derivatives by the abscissae with the additional potential ½ tie ∫ρA |P(S) −
    P₀(S)|² dS.

    P₀ is the present curve with control values `q` (n, c) [m], and `tie` has the unit [1/s²].
    """
    assert isinstance(thread.spline, Placed) and isinstance(thread.axial, Continuous)
    out, place = empty_ridden(thread.spline), plain(q[:, :3])
    here, none = field_of(thread.spline, place), field_of(thread.spline, np.zeros((thread.n, 3)))
    weightless = how._replace(gravity=np.zeros_like(how.gravity))
    inertia_of(thread.axial.curve, weightless, (here, none), float(tie), place, np.zeros((thread.n, 3)), out)
    return ridden._replace(by_qs=ridden.by_qs + out.by_qs, by_ss=ridden.by_ss + out.by_ss)


def carried(spline: Placed, how: Ride, q: Array, rates: Array, dt: float) -> Array:
    """Return the motion of control values `q` (n, c) [m] in `dt` [s] due to moving holes, shape
    `(n, c)` [m].

    The holes move at `rates` (m,) [m/s] along a thread at rest.
    """
    out = np.zeros((len(q), 3))
    carried_of(how, plain(spline.places), plain(q[:, :3]), plain(rates), float(dt), out)
    return np.pad(out, ((0, 0), (0, q.shape[1] - 3)))


def with_riding_force(thread: Thread, how: Ride, points: Points, dz: Array, N: Array) -> Array:
    """Return axial forces `N` (spans, a) [N] including the change due to holes that move by the
    first column of `dz` (m, …).
    """
    assert isinstance(thread.axial, Continuous)
    N = plain(N.copy())
    riding_force_of(thread.axial.curve, how, points.at[0], np.ascontiguousarray(dz), N)
    return N
