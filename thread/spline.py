"""Clamped cubic B-splines over rest arc length (eq. 1): P(s, t) = Σ b_i(s) q_i(t)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline, make_interp_spline

from thread.arrays import Array, Indices
from thread.errors import ThreadError

DEGREE = 3
ORDERS = 4  # b, b', b'', b''': all derivatives of a cubic

# d^k/dx^k x^r = FALLING[k, r] x^(r-k); POWER is the exponent if the factor is not zero.
AT_A_TIME = 256  # spans on which all functions are evaluated together: 5000 spans would need a gigabyte
_R = np.arange(ORDERS)
FALLING = np.array([[float(np.prod(np.arange(r - k + 1, r + 1))) if r >= k else 0.0 for r in _R] for k in _R])
POWER = np.maximum(_R[None, :] - _R[:, None], 0)


@dataclass(frozen=True)
class Spline:
    """A clamped cubic B-spline basis on a non-decreasing knot sequence.

    `knots`: shape `(n + 4,)` [m of rest arc length], the first four equal and the last four equal.
    Interior knots can be double (C¹), triple (C⁰) or fourfold. At a fourfold knot the curve is cut:
    no function is non-zero on both sides, and every matrix over the control points is block
    diagonal. Raises `ThreadError` for knots that are not a sequence of this kind.
    """

    knots: Array

    def __post_init__(self) -> None:
        knots = self.knots
        if knots.ndim != 1 or knots.size < 2 * ORDERS or not np.all(np.isfinite(knots)):
            raise ThreadError(f"knots: shape {knots.shape}; allowed are at least 8 finite numbers in one row")
        if np.any(np.diff(knots) < 0) or knots[0] == knots[-1]:
            raise ThreadError("knots: not in increasing order; sort them")
        if np.any(knots[:ORDERS] != knots[0]) or np.any(knots[-ORDERS:] != knots[-1]):
            raise ThreadError("knots: the spline is not clamped; repeat the first and the last knot four times")
        if np.any(knots[ORDERS:] <= knots[:-ORDERS]):
            raise ThreadError("knots: a knot is repeated more than four times; four times already cut the curve")

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
        """Ends of the spans except the first and the last, shape `(spans − 1,)` [m]."""
        return self.breaks[1:-1]

    @cached_property
    def cuts(self) -> Array:
        """Abscissae of the cuts of the curve, shape `(pieces − 1,)` [m]."""
        return self.knots[self.piece_starts[1:]]

    @property
    def pieces(self) -> int:
        """Number of pieces, one more than the number of cuts."""
        return self.cuts.size + 1

    @cached_property
    def piece_ends(self) -> Array:
        """Ends of the pieces, shape `(pieces + 1,)` [m]."""
        return np.concatenate([[self.start], self.cuts, [self.end]])

    @cached_property
    def piece_starts(self) -> Indices:
        """First control point of each piece, shape `(pieces,)`."""
        inside = self.knots[ORDERS:-ORDERS]
        return np.append(0, ORDERS + np.flatnonzero(inside[: 1 - ORDERS] == inside[ORDERS - 1 :]))

    @cached_property
    def piece_points(self) -> Indices:
        """Number of control points of each piece, shape `(pieces,)`."""
        return np.diff(self.piece_starts, append=self.n)

    @cached_property
    def home(self) -> Array:
        """An abscissa in the middle of the piece of each control point, shape `(n,)` [m]."""
        return np.repeat(0.5 * (self.piece_ends[:-1] + self.piece_ends[1:]), self.piece_points)

    def piece_of(self, s: ArrayLike) -> Indices:
        """Return the index of the piece that contains each abscissa; at a cut the piece that begins
        there.
        """
        return np.asarray(np.searchsorted(self.cuts, s, side="right"), dtype=np.intp)

    def has_left(self, s: Array, home: Array) -> NDArray[np.bool_]:
        """Return whether abscissae `s` lie outside the pieces that contain the abscissae `home`."""
        piece = self.piece_of(home)
        return np.asarray((s < self.piece_ends[piece]) | (s > self.piece_ends[piece + 1]))

    @cached_property
    def first(self) -> Indices:
        """Index of the first of the four functions on each span, shape `(spans,)`."""
        return np.searchsorted(self.knots, self.breaks[:-1], side="right") - ORDERS

    @property
    def chi(self) -> "Spline":
        """The same functions over the knots themselves, here the spline itself."""
        return self

    @property
    def parameters(self) -> Array:
        """Ends of the spans in the parameter of the knots, here the abscissa, shape `(spans + 1,)`."""
        return self.breaks

    @cached_property
    def greville(self) -> Array:
        """Greville abscissae of the control points, the means of the knots within their functions,
        shape `(n,)` [m].
        """
        return (self.knots[1:-3] + self.knots[2:-2] + self.knots[3:-1]) / DEGREE

    def through(self, values: Array) -> Array:
        """Return the control values of the curve that has `values` (n, c) at the Greville
        abscissae.
        """
        low, high = self.piece_ends[:-1], self.piece_ends[1:]
        # round-off can put the mean of three equal ends outside the piece
        at = np.clip(self.greville, np.repeat(low, self.piece_points), np.repeat(high, self.piece_points))
        each = zip(self.piece_starts, self.piece_points, strict=True)
        pieces = [
            make_interp_spline(at[k : k + n], values[k : k + n], DEGREE, self.knots[k : k + n + ORDERS]).c
            for k, n in each
        ]
        return np.concatenate(pieces)

    @cached_property
    def polynomials(self) -> Array:
        """Local power coefficients, shape `(spans, 4, 4)`: function i of a span is Σ_r [:, r, i] (s
        − left)^r.
        """
        functions = BSpline(self.knots, np.eye(self.n), DEGREE)
        parts = np.array_split(np.arange(self.first.size), -(-self.first.size // AT_A_TIME))
        return np.concatenate([self._polynomials_on(functions, part) for part in parts])

    def _polynomials_on(self, functions: BSpline, spans: Indices) -> Array:
        """Return the coefficients of the functions on some of the spans; most function values are
        zero there.
        """
        local = self.first[spans, None] + _R
        taylor = [functions(self.breaks[spans], nu=r) / FALLING[r, r] for r in range(ORDERS)]
        return np.array([np.take_along_axis(x, local, axis=1) for x in taylor]).swapaxes(0, 1)

    def spans_of(self, s: Array, home: Array | None = None) -> Indices:
        """Return the index of the span that contains each abscissa; the outer spans include
        abscissae beyond the ends.

        `home` (m,) [m] are abscissae that identify the pieces. The outer spans of a piece then
        include abscissae beyond its ends. None means that each abscissa lies on its own piece.
        """
        span = np.searchsorted(self.interior, s, side="right")
        if home is None or not self.cuts.size:
            return span
        ends, piece = np.searchsorted(self.breaks, self.piece_ends), self.piece_of(home)
        return np.clip(span, ends[piece], ends[piece + 1] - 1)

    def folds(self, q: Array, s: Array) -> NDArray[np.bool_]:
        """Return which spans without any of the abscissae `s` (m,) are folded, shape `(spans,)`.

        In a folded span the tangent of the curve with control points `q` (n, 3) turns by more than
        90°.
        """
        ends = self.breaks[:-1], self.breaks[1:]
        before, after = (self.curve(q, place, home=0.5 * (ends[0] + ends[1]))[:, 1] for place in ends)
        folded = np.asarray(np.vecdot(before, after) < 0.0)
        folded[self.spans_of(s)] = False
        return folded

    def interpolate(self, s: Array, home: Array, at: Array, at_home: Array, values: Array) -> Array:
        """Return `values` from increasing abscissae `at`, interpolated at the abscissae `s`, each
        on its piece of the curve.

        `home` and `at_home` [m] identify the pieces of `s` and of `at` and have the shapes of `s`
        and of `at`. `values` have the shape of `at`.
        """
        if self.pieces == 1:
            return np.interp(s, at.ravel(), values.ravel())
        piece, own = self.piece_of(home), self.piece_of(at_home)
        out = np.empty(s.shape)
        for k in range(self.pieces):
            out[piece == k] = np.interp(s[piece == k], at[own == k], values[own == k])
        return out

    def basis(self, s: ArrayLike, home: Array | None = None) -> tuple[Indices, Array]:
        """Return the basis functions and their derivatives at abscissae `s`, shape `(m,)` [m];
        `home` as for `spans_of`.

        The results are the index of the first function at each point, shape `(m,)`, and the values,
        shape `(m, 4, 4)`: `[:, k, i]` is the k-th derivative of function `first + i` [1/m^k].
        """
        s = np.asarray(s, dtype=np.float64)
        span = self.spans_of(s, home)
        return self.first[span], self.basis_on(span, s)

    def basis_on(self, span: Indices, s: Array) -> Array:
        """Return the functions of the spans (m,) and their derivatives at `s` (m,) [m], shape `(m,
        4, 4)`.
        """
        powers = FALLING * ((s - self.breaks[span])[:, None] ** _R)[:, POWER]
        return np.asarray(powers @ self.polynomials[span])

    def curve(self, q: Array, s: ArrayLike, home: Array | None = None) -> Array:
        """Return P and its first three derivatives at `s`, shape `(m, 4, 3)` [m, -, 1/m, 1/m²];
        `home` as for `spans_of`.
        """
        first, b = self.basis(s, home)
        return np.asarray(b @ q[first[:, None] + _R])
