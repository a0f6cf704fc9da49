"""The constraints at one hole (eqs. 4, 8, 9), and their forces.

    g = P(s) − x,   c₁ = T·u,   c₂ = T·v

The forces λ on P and m = μ_u u + μ_v v on T are the derivatives of λ·(P − x) + m·T by q, s and y.
If knots travel with the holes, P and T do not depend on s.
"""

from typing import NamedTuple

from coupling.arrays import Array
from thread.kernels.loops import loop, numbers
from thread.kernels.records import record
from thread.kernels.vectors import ZERO, Vector, dot, minus, sum_of, times, vector

FIRST, AT_U, AT_V = numbers(0, 3, 6)


class Hold(NamedTuple):
    """One hold at an iterate.

    - Of the thread: P [m], T, K = T' [1/m] and J = T'' [1/m²].
    - Multipliers: λ [N], and μ_u, μ_v [N m]; `m` = μ_u u + μ_v v [N m] is the force conjugate to T.
    - Of the organ: x [m], u, v.
    - `P_s`: ∂P/∂s at constant q. It is T, or zero if knots travel (`rides`).
    - `drive`: −∂Π/∂s [N] of the thread's potential (`thread.kernels.travel`), if knots travel. K
      and J are then zero too.
    """

    P: Vector
    T: Vector
    K: Vector
    J: Vector
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


@loop
def hold_at(D: Array, rides: bool, drive: float, lam: Array, y: Array) -> Hold:
    """Return a hold from P to T'', `D` (4, 3), the multipliers `lam` (5,) and `y` (9,)."""
    T, u, v = vector(D[1], FIRST), vector(y, AT_U), vector(y, AT_V)
    P_s = T
    if rides:
        P_s = ZERO
    return Hold(
        vector(D[0], FIRST),
        T,
        vector(D[2], FIRST),
        vector(D[3], FIRST),
        vector(lam, FIRST),
        lam[3],
        lam[4],
        vector(y, FIRST),
        u,
        v,
        P_s,
        rides,
        drive,
        sum_of(lam[3], u, lam[4], v),
    )


@record
class Held(NamedTuple):
    """The arrays of all holds.

    They are `D` (m, 4, 3) from P to T'', `lam` (m, 5) and `y` (m, 9). If knots travel (`rides`),
    `drive` (m,) [N] is the force along the thread.
    """

    D: Array
    rides: bool
    drive: Array
    lam: Array
    y: Array


@loop
def hold_among(at: Held, k: int) -> Hold:
    """Return hold k."""
    return hold_at(at.D[k], at.rides, at.drive[k], at.lam[k], at.y[k])


@loop
def driving_force(h: Hold) -> float:
    """Return the force that drives the thread along itself, −∂Π/∂s + Φ_sᵀλ [N]."""
    return h.drive + dot(h.lam, h.P_s) + dot(h.m, h.K)


@loop
def site_force(h: Hold) -> tuple[Vector, Vector, Vector]:
    """Return Φ_yᵀλ, conjugate to x, u and v."""
    return times(-1.0, h.lam), times(h.mu_u, h.T), times(h.mu_v, h.T)


@loop
def gap(h: Hold) -> Vector:
    """Return g = P − x [m]."""
    return minus(h.P, h.x)


@loop
def phi(h: Hold) -> tuple[Vector, float, float]:
    """Return Φ = (g, c₁, c₂) [m, -]."""
    return gap(h), dot(h.T, h.u), dot(h.T, h.v)


@loop
def phi_s(h: Hold) -> tuple[Vector, float, float]:
    """Return ∂Φ/∂s = (P_s, T'·u, T'·v) [-, 1/m]."""
    return h.P_s, dot(h.K, h.u), dot(h.K, h.v)
