"""The paper's springs (§3): between points along the curve, by generalized forces Q_i = F ∂P/∂q_i.

Points P_0 … P_m lie at the abscissae s_k. Spring k joins P_(k−1) to P_k and has the rest length
ℓ_k. With the directions

    d_k = (P_k − P_(k−1))/ℓ_k   of the springs,   d_0 = T(start), d_(m+1) = T(end)   of the curve's ends

and ℓ̄_k half the length of the springs next to P_k, every spring is calibrated by the section:

    stretch   ½ EA ℓ_k ε_k²,                ε_k = ½(|d_k|² − 1), the strain of the continuous energy
    bend      ½ (EI/ℓ̄_k) (2 tan φ_k/2)²,    φ_k the angle from d_k to d_(k+1) (discrete rods: Bergou et al. 2008)
    twist     ½ (GJ/ℓ̄_k) (Δθ_k + ℓ̄_k τ_k)², Δθ_k of the sections in the middle of the springs next to P_k

The sums tend to ½∫EA ε² ds, ½∫EI κ² ds and ½∫GJ ω² ds with the square of the spacing. Without the
two springs at the ends, half a spacing of the thread would bend and twist without energy, an error
of first order.

n − 1 springs, as many as T has functions, keep the length of the thread and leave it free to bend.
With more springs a thread as stiff as a real suture locks (membrane locking).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thread.arrays import Array, Indices
from thread.errors import ThreadError
from thread.frames import Stations
from thread.knots import apportion
from thread.spline import ORDERS, Spline
from thread.vectors import IDENTITY, dot, outer, unit_vector


@dataclass(frozen=True)
class SpringLayout:
    """Springs on a spline: abscissae `s` (m + 1,) of their ends [m].

    At a cut of the spline there are two ends, one for each piece, without a spring between them.
    """

    spline: Spline
    s: Array

    def __post_init__(self) -> None:
        if self.s.size < 2 or np.any(self.length < 0.0) or np.sum(self.length == 0.0) != self.spline.pieces - 1:
            raise ThreadError(f"springs: {self.s.size - 1} springs with ends that do not rise; give at least one")

    @cached_property
    def length(self) -> Array:
        """Rest lengths ℓ_k, zero across a cut, shape `(m,)` [m]."""
        return np.diff(self.s)

    @cached_property
    def share(self) -> Array:
        """Length ℓ̄_k of thread that each point represents, shape `(m + 1,)` [m]."""
        return 0.5 * (np.append(0.0, self.length) + np.append(self.length, 0.0))

    @cached_property
    def neighbours(self) -> tuple[Array, Array]:
        """Abscissae of the points before and after each point, `(m + 1,)` each [m]; at an end of
        the thread its own.
        """
        return np.append(self.s[0], self.s[:-1]), np.append(self.s[1:], self.s[-1])

    @cached_property
    def home(self) -> Array:
        """Middle of the thread that each point represents, which identifies its piece, shape `(m +
        1,)` [m].
        """
        before, after = self.neighbours
        return 0.25 * (before + after) + 0.5 * self.s

    @cached_property
    def window(self) -> tuple[Indices, int]:
        """First control point on which each P_k and its neighbours depend, and the largest number
        of these control points.
        """
        first, last = (self.spline.basis(s, self.home)[0] for s in self.neighbours)
        reach = int(np.max(last - first)) + ORDERS
        return np.minimum(first, self.spline.n - reach), reach

    def rows(self, s: Array, order: int = 0) -> Array:
        """Return derivatives of the basis functions at one abscissa per point, over its window,
        shape `(m + 1, reach)`.
        """
        window, reach = self.window
        first, b = self.spline.basis(s, self.home)
        out = np.zeros((len(s), reach))
        np.put_along_axis(out, (first - window)[:, None] + np.arange(ORDERS), b[:, order], axis=1)
        return out

    @cached_property
    def directions(self) -> Array:
        """Rows of the directions before and after each point, shape `(m + 1, 2, reach)`."""
        before, after = self.neighbours
        P, T = self.rows(self.s), self.rows(self.s, 1)
        lengths = np.append(0.0, self.length)[:, None], np.append(self.length, 0.0)[:, None]
        steps = P - self.rows(before), self.rows(after) - P
        chords = [np.divide(d, h, out=T.copy(), where=h > 0.0) for d, h in zip(steps, lengths, strict=True)]
        return np.stack(chords, axis=1)

    @cached_property
    def stations(self) -> Stations:
        """The points P_k as stations of the twist."""
        before, after = (self.rows(0.5 * (self.s + other)) for other in self.neighbours)
        rows = (self.rows(self.s, 1), self.rows(self.s, 2), self.rows(self.s), (after - before) / self.share[:, None])
        T, K, theta, theta_s = (x[:, None] for x in rows)
        return Stations(self.window[0], self.s[:, None], self.home[:, None], self.share[:, None], T, K, theta, theta_s)


def spread_springs(spline: Spline, count: int) -> SpringLayout:
    """Return `count` springs from end to end of the pieces of a spline.

    n − 1 springs join the Greville abscissae of a piece. Additional springs are divided among the
    pieces. The springs are denser in regions with denser control points.
    """
    t = spline.knots
    greville = np.split((t[1:-3] + t[2:-2] + t[3:-1]) / 3.0, spline.piece_starts[1:])
    fewest = np.array([len(points) - 1 for points in greville])
    counts = fewest + apportion(count - fewest.sum() + len(fewest), fewest) - 1
    places = [
        np.interp(np.linspace(0.0, len(points) - 1.0, number + 1), np.arange(len(points)), points)
        for points, number in zip(greville, counts.tolist(), strict=True)
    ]
    return SpringLayout(spline, np.concatenate(places))


def bend(a: Array, b: Array) -> Array:
    """Return (2 tan φ/2)² of the angle φ between a and b, both (..., 3): 4 (1 − c)/(1 + c), c = cos
    φ [-].
    """
    u, v = unit_vector(a), unit_vector(b)
    return 2.0 * dot(u - v, u - v) / (1.0 + dot(u, v))


def bend_gradient(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the derivatives of `bend` by a and by b, (..., 3) each."""
    u, v = unit_vector(a), unit_vector(b)
    c = dot(u, v)[..., None]
    f_c = -8.0 / (1.0 + c) ** 2
    return f_c * (v - c * u) / norm(a), f_c * (u - c * v) / norm(b)


def bend_hessian(a: Array, b: Array) -> tuple[Array, Array, Array]:
    """Return the second derivatives of `bend` by (a, a), (a, b) and (b, b), each (..., 3, 3)."""
    u, v, A, B = unit_vector(a), unit_vector(b), norm(a), norm(b)
    c = dot(u, v)[..., None]
    f_c, f_cc = (-8.0 / (1.0 + c) ** 2)[..., None], (16.0 / (1.0 + c) ** 3)[..., None]
    c_a, c_b = (v - c * u) / A, (u - c * v) / B
    A, B, c = A[..., None], B[..., None], c[..., None]
    across_a, across_b = IDENTITY - outer(u, u), IDENTITY - outer(v, v)
    c_aa = -(A * (outer(u, c_a) + outer(c_a, u)) + c * across_a) / A**2
    c_bb = -(B * (outer(v, c_b) + outer(c_b, v)) + c * across_b) / B**2
    c_ab = across_a @ across_b / (A * B)
    return f_cc * outer(c_a, c_a) + f_c * c_aa, f_cc * outer(c_a, c_b) + f_c * c_ab, f_cc * outer(c_b, c_b) + f_c * c_bb


def norm(a: Array) -> Array:
    """Return |a| over the last axis; the axis remains, with length one."""
    return np.linalg.norm(a, axis=-1, keepdims=True)


@dataclass(frozen=True)
class Taut:
    """The springs of an iterate; all arrays have shape (m + 1, …).

    Directions `a`, `b` before and after each point, and the `strain` of the spring after the point.
    """

    a: Array
    b: Array
    strain: Array


@dataclass(frozen=True)
class Springs:
    """Stretch and bend springs: `EA` [N], `EI` [N m²].

    The last point has no spring after it: its strain has no effect.
    """

    layout: SpringLayout
    EA: float
    EI: float

    seen = 3

    @property
    def first(self) -> Indices:
        """First control point of each group, shape `(m + 1,)`."""
        return self.layout.window[0]

    @property
    def reach(self) -> int:
        """Control points of a group."""
        return self.layout.window[1]

    @cached_property
    def s(self) -> Array:
        """Abscissae of the strain: the middle of each spring, and the end, shape `(m + 1,)` [m]."""
        s = self.layout.s
        return np.append(0.5 * (s[1:] + s[:-1]), s[-1])

    @property
    def home(self) -> Array:
        """Abscissae that identify the piece of each strain on a cut thread, shape `(m + 1,)` [m]."""
        return self.layout.home

    @cached_property
    def _points(self) -> Indices:
        return self.first[:, None] + np.arange(self.reach)

    @property
    def _rows(self) -> Array:
        return self.layout.directions

    @cached_property
    def _length(self) -> Array:
        return np.append(self.layout.length, 0.0)

    def evaluate(self, q: Array, frame: object = None) -> Taut:
        """Return the directions before and after each point, and the strains."""
        d = (self._rows @ q[self._points])[..., :3]
        return Taut(d[:, 0], d[:, 1], 0.5 * (dot(d[:, 1], d[:, 1]) - 1.0))

    def energy(self, at: Taut) -> float:
        """Return the elastic energy [J]."""
        stretch = self.EA * np.sum(self._length * at.strain**2)
        return float(0.5 * (stretch + self.EI * np.sum(bend(at.a, at.b) / self.layout.share)))

    def gradient(self, at: Taut) -> Array:
        """Return the derivative by the control points of each group, shape `(m + 1, reach, 3)` [N]."""
        k = 0.5 * self.EI / self.layout.share[:, None]
        by_a, by_b = bend_gradient(at.a, at.b)
        pull = self.EA * (self._length * at.strain)[:, None] * at.b
        return self._rows.swapaxes(1, 2) @ np.stack([k * by_a, k * by_b + pull], axis=1)

    def tangent(self, at: Taut, N: Array) -> Array:
        """Return the second derivative by the control points of each group, shape `(m + 1, reach,
        reach, 3, 3)` [N/m].

        `N` (m + 1,) [N] are the axial forces.
        """
        k = 0.5 * self.EI / self.layout.share[:, None, None]
        aa, ab, bb = bend_hessian(at.a, at.b)
        H = np.empty((len(N), 2, 2, 3, 3))
        H[:, 0, 0], H[:, 0, 1], H[:, 1, 0] = k * aa, k * ab, k * ab.swapaxes(-1, -2)
        H[:, 1, 1] = k * bb + self._length[:, None, None] * (N[:, None, None] * IDENTITY + self.EA * outer(at.b, at.b))
        return np.einsum("mki,mklab,mlj->mijab", self._rows, H, self._rows, optimize=True)

    def next_axial_force(self, at: Taut, dq: Array) -> Array:
        """Return N of the next iterate, EA (ε + d·δd) [N]."""
        change = (self._rows[:, 1:] @ dq[self._points])[:, 0, :3]
        return self.EA * (at.strain + dot(at.b, change))
