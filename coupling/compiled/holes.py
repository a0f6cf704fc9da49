"""The constraints at one hold, and the forces that come with them (`coupling.constraints`)."""

from typing import NamedTuple

from coupling.arrays import Array
from coupling.compiled.loops import loop, numbers
from coupling.compiled.vectors import (
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

    Of the thread P [m], T, K = T' [1/m], J = T'' [1/m²] and c₀, c₁, c₂ of the missing compliance, each with two
    derivatives by s; λ [N], μ_u, μ_v [N m]; of the organ x [m], u, v. `m` = μ_u u + μ_v v [N m]. The axis a is T: its
    `unit` vector and `size`, and λ `along` and `across` it [N]. How far T leaves the frame, as
    `coupling.constraints.Tilt`: `normal` n̂, `area`, `cosine` ψ, `by_T`, `by_n`. `directed`: the frame tells where the
    thread goes. `bare`: no hold of the thread lacks compliance.
    """

    P: Vector
    T: Vector
    K: Vector
    J: Vector
    c0: Vector
    c1: Vector
    c2: Vector
    directed: bool
    bare: bool
    lam: Vector
    mu_u: float
    mu_v: float
    x: Vector
    u: Vector
    v: Vector
    m: Vector
    unit: Vector
    size: float
    along: float
    across: Vector
    normal: Vector
    area: float
    cosine: float
    by_T: Vector
    by_n: Vector


@loop
def hold_at(D: Array, c: Array, directed: bool, bare: bool, lam: Array, y: Array) -> Hold:
    """Return a hold from P to T'', `D` (4, 3), c `(3 derivatives, 3)`, `lam` (5,) and `y` (9,)."""
    T, force, u, v = vector(D[1], FIRST), vector(lam, FIRST), vector(y, AT_U), vector(y, AT_V)
    size = norm(T)
    unit = times(1.0 / size, T)
    along, n = dot(force, unit), cross(u, v)
    area = norm(n) if dot(T, n) >= 0.0 else -norm(n)
    normal = times(1.0 / area, n)
    cosine = dot(unit, normal)
    return Hold(
        vector(D[0], FIRST),
        T,
        vector(D[2], FIRST),
        vector(D[3], FIRST),
        (c[0, 0], c[1, 0], c[2, 0]),
        (c[0, 1], c[1, 1], c[2, 1]),
        (c[0, 2], c[1, 2], c[2, 2]),
        directed,
        bare,
        force,
        lam[3],
        lam[4],
        vector(y, FIRST),
        u,
        v,
        sum_of(lam[3], u, lam[4], v),
        unit,
        size,
        along,
        sum_of(1.0, force, -along, unit),
        normal,
        area,
        cosine,
        times(1.0 / size, sum_of(1.0, normal, -cosine, unit)),
        times(1.0 / area, sum_of(1.0, unit, -cosine, normal)),
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
    """Return e = ¼c₂m² [N m]."""
    return 0.25 * h.c2[0] * dot(h.m, h.m)


@loop
def tilt_force_rate(h: Hold) -> float:
    """Return its derivative by s [N]."""
    return 0.25 * h.c2[1] * dot(h.m, h.m)


@loop
def share(h: Hold) -> float:
    """Return γ."""
    return 0.5 * (1.0 + h.cosine)


@loop
def lacking_force(h: Hold) -> Vector:
    """Return w + e ∂ψ/∂T [N m]."""
    return sum_of(1.0, axis_force(h), tilt_force(h), h.by_T)


@loop
def lacking_force_rate(h: Hold) -> Vector:
    """Return its derivative by s with T held [N]."""
    return sum_of(1.0, axis_force_rate(h), tilt_force_rate(h), h.by_T)


@loop
def on_frame(h: Hold, by_n: Vector) -> tuple[Vector, Vector]:
    """Return what a force conjugate to u × v is on u and on v."""
    return cross(h.v, by_n), cross(by_n, h.u)


@loop
def tilting_rates(h: Hold) -> tuple[Vector, Vector]:
    """Return the derivatives by s of e ∂ψ/∂u and e ∂ψ/∂v [N]."""
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
    return plus(h.P, sum_of(h.c0[0], h.across, h.c1[0], h.m))


@loop
def effective_tangent(h: Hold) -> Vector:
    """Return T̂."""
    return plus(h.T, sum_of(h.c1[0], h.lam, h.c2[0] * share(h), h.m))


@loop
def place_rate(h: Hold) -> Vector:
    """Return ∂P̂/∂s at constant multipliers."""
    rate = plus(h.T, sum_of(h.c0[1], h.across, h.c1[1], h.m))
    return sum_of(1.0, rate, -h.c0[0], axis_turned(h, h.K))


@loop
def tangent_rate(h: Hold) -> Vector:
    """Return ∂T̂/∂s at constant multipliers [1/m]."""
    by_couple = h.c2[1] * share(h) + 0.5 * h.c2[0] * dot(h.by_T, h.K)
    return plus(h.K, sum_of(h.c1[1], h.lam, by_couple, h.m))


@loop
def held_energy(h: Hold, c0: float, c1: float, c2: float) -> float:
    """Return ½c₀(λ² − τ²) + c₁λ·m + ½c₂γm², with derivatives of c by s its own by s with T held [N, N/m]."""
    return 0.5 * (c0 * dot(h.across, h.across) + c2 * share(h) * dot(h.m, h.m)) + c1 * dot(h.lam, h.m)


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
    """Return Φ_sᵀλ [N]."""
    return dot(h.lam, h.T) + dot(h.m, h.K) + held_energy(h, h.c0[1], h.c1[1], h.c2[1]) + dot(lacking_force(h), h.K)


@loop
def force_on_tangent(h: Hold) -> Vector:
    """Return Φ_qᵀλ conjugate to T [N m]; that conjugate to P is λ."""
    return plus(h.m, lacking_force(h))


@loop
def site_force(h: Hold) -> tuple[Vector, Vector, Vector]:
    """Return Φ_yᵀλ conjugate to x, u and v."""
    T, turn = effective_tangent(h), on_frame(h, times(tilt_force(h), h.by_n))
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
    """Return ∂(w + e ∂ψ/∂T)/∂T [N m]."""
    return combined(1.0, axis_stiffness(h), tilt_force(h), second_slope(h.unit, h.size, h.by_T, h.cosine))


@loop
def second_slope(unit: Vector, size: float, by: Vector, cosine: float) -> Matrix:
    """Return the second derivative of ψ by T or by u × v, of which `unit`, `size` and the first derivative `by` are."""
    mixed = outer(unit, by)
    return scaled(-1.0 / size, combined(1.0, added(mixed, transposed(mixed)), cosine / size, without(unit)))


@loop
def tilt_mixed(h: Hold) -> Matrix:
    """Return the second derivative of ψ by T and u × v."""
    return scaled(1.0 / (h.size * h.area), product(without(h.unit), without(h.normal)))


@loop
def force_by_axis(h: Hold) -> Matrix:
    """Return ∂P̂/∂a = (∂w/∂λ)ᵀ [m]."""
    return scaled(-h.c0[0] / h.size, combined(1.0, outer(h.unit, h.across), h.along, without(h.unit)))


@loop
def without(unit: Vector) -> Matrix:
    """Return 1 − ââᵀ."""
    return combined(1.0, diagonal(1.0), -1.0, outer(unit, unit))


@loop
def gap(h: Hold) -> Vector:
    """Return g = P̂ − x [m]."""
    return minus(effective_place(h), h.x)
