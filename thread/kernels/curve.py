"""Stretch and bending of the thread, span by span: ½∫EA ε² ds + ½∫EI κ² ds (§3), straight at rest.

ε = ½(|T|² − 1) is the Green–Lagrange strain (Nocent & Rémion 2001). The axial force N is an unknown
of the iteration: at N = EA ε the tangent is the exact second derivative (mixed integration points,
Magisano, Leonetti & Garcea 2017). A thread that relaxes has a natural strain ε̄(S), and ε − ε̄
replaces ε (`thread.relaxation`).
"""

from typing import NamedTuple

from thread.arrays import Array, Indices
from thread.kernels.loops import entry, loop, numbers
from thread.kernels.records import record
from thread.kernels.vectors import (
    Matrix,
    Vector,
    add_matrix,
    add_row,
    added,
    combined,
    diagonal,
    dot,
    outer,
    sum_of,
    times,
    transposed,
)

FIRST, *_ = numbers(0)


@record
class Curve(NamedTuple):
    """The elastic thread on its knots.

    `first` (spans,) are the first control points of the spans. The other arrays have b' and b'' at
    the quadrature points:

    - Bending: `slope` b' and `bend` b'' (spans, g, 4), weights `w` (spans, g) [m].
    - Stretch: `axial_slope` b' (spans, a, 4), weights `axial_w` (spans, a) [m].
    - Both ends of each span: `edge_slope` b' (spans, 2, 4), weights `edge_w` (spans, 2) [m], zero
      without a hole.

    `natural` (spans,) [-] is the natural strain of each span. `natural_slope` (spans, 2) [1/m] is
    the natural strain at its two ends minus this value, over the length of the span. EA [N], EI [N
    m²].
    """

    first: Indices
    slope: Array
    bend: Array
    w: Array
    axial_slope: Array
    axial_w: Array
    edge_slope: Array
    edge_w: Array
    natural: Array
    natural_slope: Array
    EA: float
    EI: float


@record
class Stretched(NamedTuple):
    """The curve at its quadrature points.

    `T`, `K` (spans, g, 3): first and second derivative of P at the points of bending [-, 1/m].
    `T_axial` (spans, a, 3) and the elastic `strain` ε − ε̄ (spans, a) at the points of stretch.
    `T_edge` (spans, 2, 3) at the holes.
    """

    T: Array
    K: Array
    T_axial: Array
    strain: Array
    T_edge: Array


@loop
def along_span(b: Array, q: Array, first: int) -> Vector:
    """Return Σ b_i q_i over the four points from `first` on."""
    x = b[0] * q[first, 0] + b[1] * q[first + 1, 0] + b[2] * q[first + 2, 0] + b[3] * q[first + 3, 0]
    y = b[0] * q[first, 1] + b[1] * q[first + 1, 1] + b[2] * q[first + 2, 1] + b[3] * q[first + 3, 1]
    z = b[0] * q[first, 2] + b[1] * q[first + 1, 2] + b[2] * q[first + 2, 2] + b[3] * q[first + 3, 2]
    return x, y, z


@loop
def put(a: Vector, M: Array, i: int, j: int) -> None:
    """Write a vector into row i of an array, from column j on."""
    M[i, j], M[i, j + 1], M[i, j + 2] = a


@loop
def evaluate(curve: Curve, q: Array, at: Stretched) -> None:
    """Write the values of the curve at its quadrature points into `at`."""
    for e in range(len(curve.first)):
        first = curve.first[e]
        for g in range(curve.w.shape[1]):
            put(along_span(curve.slope[e, g], q, first), at.T[e], g, FIRST)
            put(along_span(curve.bend[e, g], q, first), at.K[e], g, FIRST)
        for g in range(curve.axial_w.shape[1]):
            T = along_span(curve.axial_slope[e, g], q, first)
            put(T, at.T_axial[e], g, FIRST)
            at.strain[e, g] = 0.5 * (dot(T, T) - 1.0) - curve.natural[e]
        for g in range(2):
            if curve.edge_w[e, g] > 0.0:
                put(along_span(curve.edge_slope[e, g], q, first), at.T_edge[e], g, FIRST)


@loop
def point(a: Array, e: int, g: int) -> Vector:
    """Return the vector at point g of span e."""
    return a[e, g, 0], a[e, g, 1], a[e, g, 2]


@loop
def crushing(curve: Curve, a: float) -> tuple[float, float, float]:
    """Return ½EA p⁴, p = ½(1 − a), for a = |T|² < 1, and its first two derivatives by a.

    The term prevents |T| → 0 between the points of stretch. At a shortening of 1 % it is 1e-4 of
    the energy of stretch.
    """
    p = max(0.5 * (1.0 - a), 0.0)
    return 0.5 * curve.EA * p**4, -curve.EA * p**3, 1.5 * curve.EA * p**2


@loop
def barrier(curve: Curve, a: float) -> tuple[float, float, float]:
    """Return ½EA p⁴/a and its first two derivatives by a; p is as in `crushing`.

    The term is infinite for |T| → 0. It acts at the knot of a hole, where no point of stretch or
    bending lies. Without it a corner of the path would collapse there.
    """
    p = max(0.5 * (1.0 - a), 0.0)
    return (
        0.5 * curve.EA * p**4 / a,
        -0.5 * curve.EA * p**3 * (2.0 / a + p / a**2),
        0.5 * curve.EA * p**2 * (3.0 / a + 4.0 * p / a**2 + 2.0 * p**2 / a**3),
    )


@loop
def bending_gradient(curve: Curve, T: Vector, K: Vector) -> tuple[Vector, Vector]:
    """Return the derivatives of ½EI κ² and of the term of `crushing` by T and T'."""
    a, b, c = dot(T, T), dot(T, K), dot(K, K)
    phi_a = (2.0 * b * b / a - c) / a**2
    phi_b = -2.0 * b / a**2
    half = 0.5 * curve.EI
    by_T = sum_of(2.0 * (half * phi_a + crushing(curve, a)[1]), T, half * phi_b, K)
    return by_T, sum_of(half * phi_b, T, half * 2.0 / a, K)


@loop
def bending_hessian(curve: Curve, T: Vector, K: Vector) -> tuple[Matrix, Matrix, Matrix]:
    """Return the second derivatives of the terms of `bending_gradient` by (T, T), (T, T') and (T',
    T').
    """
    a, b, c = dot(T, T), dot(T, K), dot(K, K)
    half = 0.5 * curve.EI
    phi_b, phi_bb = half * -2.0 * b / a**2, half * -2.0 / a**2
    phi_ab = -2.0 * phi_b / a
    phi_a = -half * c / a**2 + 0.5 * b * phi_ab
    phi_aa = half * (2.0 * c - 6.0 * b * b / a) / a**3
    _, slope, bent = crushing(curve, a)
    by_TT = sum_of(4.0 * (phi_aa + bent), T, 2.0 * phi_ab, K)
    TT = added(outer(T, by_TT), outer(K, sum_of(2.0 * phi_ab, T, phi_bb, K)))
    TK = added(outer(T, sum_of(2.0 * phi_ab, T, 2.0 * phi_bb, K)), outer(K, times(phi_bb, T)))
    KK = added(diagonal(half * 2.0 / a), outer(T, times(phi_bb, T)))
    return added(TT, diagonal(2.0 * (phi_a + slope))), added(TK, diagonal(phi_b)), KK


@loop
def add_span_gradient(curve: Curve, at: Stretched, e: int, F: Array, first: int) -> None:
    """Add ∂E/∂q of one span to the four rows of `F` (…, 3) [N] from the `first` on."""
    for g in range(curve.w.shape[1]):
        by_T, by_K = bending_gradient(curve, point(at.T, e, g), point(at.K, e, g))
        w, slope, bend = curve.w[e, g], curve.slope[e, g], curve.bend[e, g]
        for i in range(4):
            add_row(1.0, sum_of(w * slope[i], by_T, w * bend[i], by_K), F, first + i, FIRST)
    for g in range(curve.axial_w.shape[1]):
        N, slope = curve.axial_w[e, g] * curve.EA * at.strain[e, g], curve.axial_slope[e, g]
        T = point(at.T_axial, e, g)
        for i in range(4):
            add_row(N * slope[i], T, F, first + i, FIRST)
    for g in range(2):
        if curve.edge_w[e, g] > 0.0:
            T = point(at.T_edge, e, g)
            N = 2.0 * curve.edge_w[e, g] * barrier(curve, dot(T, T))[1]
            for i in range(4):
                add_row(N * curve.edge_slope[e, g, i], T, F, first + i, FIRST)


@loop
def add_gradient(curve: Curve, at: Stretched, F: Array) -> None:
    """Add ∂E/∂q to `F` (n, 3) [N]."""
    for e in range(len(curve.first)):
        add_span_gradient(curve, at, e, F, curve.first[e])


@loop
def add_block(A: Array, i: int, j: int, x: float, block: Matrix) -> None:
    """Add x times the block of the points i and j ≥ i to a symmetric block band."""
    add_matrix(x, block, A[i], FIRST, 3 * (j - i))


@loop
def add_span_tangent(curve: Curve, at: Stretched, N: Array, e: int, A: Array, first: int) -> None:
    """Add ∂²E/∂q² of one span to the rows of a block band from the `first` point on.

    The axial force `N` (spans, a) [N] is a separate unknown.
    """
    for g in range(curve.w.shape[1]):
        TT, TK, KK = bending_hessian(curve, point(at.T, e, g), point(at.K, e, g))
        KT, w, slope, bend = transposed(TK), curve.w[e, g], curve.slope[e, g], curve.bend[e, g]
        for i in range(4):
            of_T = combined(w * slope[i], TT, w * bend[i], KT)
            of_K = combined(w * slope[i], TK, w * bend[i], KK)
            for j in range(i, 4):
                add_block(A, first + i, first + j, 1.0, combined(slope[j], of_T, bend[j], of_K))
    for g in range(curve.axial_w.shape[1]):
        w, slope, T = curve.axial_w[e, g], curve.axial_slope[e, g], point(at.T_axial, e, g)
        stiff = added(diagonal(w * N[e, g]), outer(T, times(w * curve.EA, T)))
        for i in range(4):
            for j in range(i, 4):
                add_block(A, first + i, first + j, slope[i] * slope[j], stiff)
    for g in range(2):
        if curve.edge_w[e, g] > 0.0:
            w, slope, T = curve.edge_w[e, g], curve.edge_slope[e, g], point(at.T_edge, e, g)
            _, by, by_by = barrier(curve, dot(T, T))
            stiff = added(diagonal(2.0 * w * by), outer(T, times(4.0 * w * by_by, T)))
            for i in range(4):
                for j in range(i, 4):
                    add_block(A, first + i, first + j, slope[i] * slope[j], stiff)


@loop
def add_tangent(curve: Curve, at: Stretched, N: Array, A: Array) -> None:
    """Add ∂²E/∂q² to a block band, with the axial force `N` as for one span."""
    for e in range(len(curve.first)):
        add_span_tangent(curve, at, N, e, A, curve.first[e])


@loop
def bending_energy(curve: Curve, T: Vector, K: Vector) -> float:
    """Return ½EI κ² plus the term of `crushing` [N].

    κ = |T × T'|/|T|² is the turn of the tangent per rest length. As in Reissner's rod, the bending
    moment then exerts no axial force. With the turn per deformed length, the axial force would jump
    by 2 EI κ² at a jump of curvature.
    """
    a, b, c = dot(T, T), dot(T, K), dot(K, K)
    return 0.5 * curve.EI * ((a * c - b * b) / a**2) + crushing(curve, a)[0]


@loop
def elastic_energy(curve: Curve, at: Stretched) -> float:
    """Return the energy of stretch and bending [J]."""
    energy = 0.0
    for e in range(len(curve.first)):
        for g in range(curve.w.shape[1]):
            energy += curve.w[e, g] * bending_energy(curve, point(at.T, e, g), point(at.K, e, g))
        for g in range(curve.axial_w.shape[1]):
            energy += 0.5 * curve.EA * curve.axial_w[e, g] * at.strain[e, g] ** 2
        for g in range(2):
            if curve.edge_w[e, g] > 0.0:
                T = point(at.T_edge, e, g)
                energy += curve.edge_w[e, g] * barrier(curve, dot(T, T))[0]
    return energy


@loop
def next_axial_force(curve: Curve, at: Stretched, dq: Array, N: Array) -> None:
    """Write EA (ε + T·δT), N of the next iterate, into `N` (spans, a) [N]."""
    for e in range(len(curve.first)):
        for g in range(curve.axial_w.shape[1]):
            d_T = along_span(curve.axial_slope[e, g], dq, curve.first[e])
            N[e, g] = curve.EA * (at.strain[e, g] + dot(point(at.T_axial, e, g), d_T))


@loop
def add_gradients(curve: Curve, at: Stretched, F: Array) -> None:
    """Add the gradient of each span to `F` (spans, 4, 3) [N]."""
    for e in range(len(F)):
        add_span_gradient(curve, at, e, F[e], FIRST)


@loop
def add_tangents(curve: Curve, at: Stretched, N: Array, A: Array) -> None:
    """Add the tangent of each span to `A` (spans, 4, 3, 12), a block band for each."""
    for e in range(len(A)):
        add_span_tangent(curve, at, N, e, A[e], FIRST)


evaluated, energy_of, force_of = entry(evaluate), entry(elastic_energy), entry(next_axial_force)
gradient_of, tangent_of = entry(add_gradients), entry(add_tangents)
