"""Clamped cubic B-splines over rest arc length (eq. 1): P(s, t) = Σ b_i(s) q_i(t)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

from thread.errors import ThreadError

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

DEGREE = 3
ORDERS = 4  # b, b', b'', b''' : everything a cubic has

# d^k/dx^k x^r = FALLING[k, r] x^(r-k); POWER holds the exponent where the factor is not zero.
_R = np.arange(ORDERS)
FALLING = np.array([[float(np.prod(np.arange(r - k + 1, r + 1))) if r >= k else 0.0 for r in _R] for k in _R])
POWER = np.maximum(_R[None, :] - _R[:, None], 0)


@dataclass(frozen=True)
class Spline:
    """A clamped cubic B-spline basis on a non-decreasing knot sequence.

    `knots`: shape `(n + 4,)` [m of rest arc length], the first and the last four equal. Interior knots may be
    double (C¹) or triple (C⁰). Raises `ThreadError` when they are not such a sequence.
    """

    knots: Array

    def __post_init__(self) -> None:
        knots = self.knots
        if knots.ndim != 1 or knots.size < 2 * ORDERS or not np.all(np.isfinite(knots)):
            raise ThreadError(f"knots: shape {knots.shape}; allowed are at least 8 finite numbers in one row")
        if np.any(np.diff(knots) < 0) or knots[0] == knots[-1]:
            raise ThreadError("knots: not in rising order; sort them")
        if np.any(knots[:ORDERS] != knots[0]) or np.any(knots[-ORDERS:] != knots[-1]):
            raise ThreadError("knots: the spline is not clamped; repeat the first and the last knot four times")
        if np.any(knots[ORDERS:-1] <= knots[1:-ORDERS]):
            raise ThreadError("knots: a knot stands more than three times inside; the curve would come apart there")

    @property
    def n(self) -> int:
        """Number of control points."""
        return self.knots.size - ORDERS

    @property
    def start(self) -> float:
        """First abscissa [m]."""
        return float(self.knots[0])

    @property
    def end(self) -> float:
        """Last abscissa [m]."""
        return float(self.knots[-1])

    @cached_property
    def breaks(self) -> Array:
        """Ends of the non-empty spans, shape `(spans + 1,)` [m]."""
        return np.unique(self.knots)

    @cached_property
    def interior(self) -> Array:
        """Ends of the spans but the first and the last, shape `(spans − 1,)` [m]."""
        return self.breaks[1:-1]

    @cached_property
    def first(self) -> Indices:
        """Index of the first of the four functions living on each span, shape `(spans,)`."""
        return np.searchsorted(self.knots, self.breaks[:-1], side="right") - ORDERS

    @cached_property
    def polynomials(self) -> Array:
        """Local power coefficients, shape `(spans, 4, 4)`: function i of a span is Σ_r [:, r, i] (s − left)^r."""
        functions = BSpline(self.knots, np.eye(self.n), DEGREE)
        taylor = [functions(self.breaks[:-1], nu=r) / FALLING[r, r] for r in range(ORDERS)]
        return np.array([np.take_along_axis(x, self.first[:, None] + _R, axis=1) for x in taylor]).swapaxes(0, 1)

    def spans_of(self, s: Array) -> Indices:
        """Index of the span that holds each abscissa; the outer spans hold what lies beyond the ends."""
        return np.searchsorted(self.interior, s, side="right")

    def basis(self, s: ArrayLike) -> tuple[Indices, Array]:
        """Basis functions and their derivatives at abscissae `s`, shape `(m,)` [m].

        Returns the index of the first function of each point, shape `(m,)`, and the values, shape
        `(m, 4, 4)`: `[:, k, i]` is the k-th derivative of function `first + i` [1/m^k].
        """
        s = np.asarray(s, dtype=np.float64)
        span = self.spans_of(s)
        x = s - self.breaks[span]
        powers = FALLING * (x[:, None] ** _R)[:, POWER]
        return self.first[span], powers @ self.polynomials[span]

    def curve(self, q: Array, s: ArrayLike) -> Array:
        """P and its first three derivatives at `s`, shape `(m, 4, 3)` [m, -, 1/m, 1/m²]."""
        first, b = self.basis(s)
        return np.asarray(b @ q[first[:, None] + _R])


def uniform_knots(length: float, n: int) -> Array:
    """Clamped knots of `n` control points with equal spans over `[0, length]` [m]."""
    return clamped(np.linspace(0.0, length, n - DEGREE + 1))


def clamped(breaks: Array) -> Array:
    """Clamped knots on the given span ends, shape `(spans + 1,)` [m]."""
    return np.concatenate([np.full(DEGREE, breaks[0]), breaks, np.full(DEGREE, breaks[-1])])


def graded_knots(length: float, n: int, centres: ArrayLike, ratio: float, reach: float) -> Array:
    """Clamped knots of `n` control points, `ratio` times denser near the `centres`.

    The span at distance x from the nearest centre is proportional to the ratio by which a smooth density
    falls: `1 + (ratio − 1) exp(−(x/reach)²)`. A thread that must leave a hole in a given direction bends over
    √(EI/T), often below a millimetre, and spans longer than that lock (bending boundary layer).
    `length`, `centres`, `reach` in [m], `ratio` ≥ 1. Raises `ThreadError` for other values.
    """
    centres = np.atleast_1d(np.asarray(centres, dtype=np.float64))
    if not ratio >= 1.0:
        raise ThreadError(f"graded knots: the ratio is {ratio}; allowed are numbers from 1 (uniform) on")
    if n <= DEGREE:
        raise ThreadError(f"graded knots: {n} control points; a cubic needs at least 4")
    if ratio == 1.0 or centres.size == 0:
        return uniform_knots(length, n)
    s = np.linspace(0.0, length, 4001)
    nearest = np.min(np.abs(s[:, None] - centres), axis=1)
    density = 1.0 + (ratio - 1.0) * np.exp(-((nearest / reach) ** 2))
    share = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    breaks = np.interp(np.linspace(0.0, share[-1], n - DEGREE + 1), share, s)
    breaks[[0, -1]] = 0.0, length
    return clamped(breaks)
