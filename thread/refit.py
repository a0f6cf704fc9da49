"""The change of a spline from one knot sequence to another, which keeps curve, velocity and momentum.

New knots are inserted exactly (Boehm), and four at one place cut the curve; surplus knots are removed by a
least-squares projection that keeps the total momentum, and P and T at given abscissae.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_array
from scipy.sparse.linalg import splu

from thread.arrays import Array
from thread.errors import ThreadError
from thread.knots import clamped_knots, graded, piecewise_knots
from thread.quadrature import gauss_rule
from thread.spline import DEGREE, Spline

SLIVER = 0.1  # of a span: a cut nearer to a knot is at the knot
PROJECTION_POINTS = 4  # a span: exact for the product of two cubics


def insert_knots(spline: Spline, knots: Array, fields: Sequence[Array]) -> tuple[Spline, list[Array]]:
    """Return the spline with further simple `knots` [m], and `fields` (n, c) on it: the same functions (Boehm 1980)."""
    width = [field.shape[1] for field in fields]
    curve = BSpline(spline.knots, np.concatenate(fields, axis=1), DEGREE)
    for knot in knots:
        curve = curve.insert_knot(knot)
    coefficients = np.asarray(curve.c)[: len(curve.t) - DEGREE - 1]
    return Spline(np.asarray(curve.t)), np.split(coefficients, np.cumsum(width)[:-1], axis=1)


def cut(spline: Spline, s: float, fields: Sequence[Array]) -> tuple[Spline, float, list[Array]]:
    """Return the spline cut at `s` [m], the place of the cut, and `fields` (n, c) on it: the same functions on either
    side. A break nearer to `s` than SLIVER of its span is cut instead: a sliver would have next to no mass.

    Raises `ThreadError` for an abscissa at an end of the spline, or of one of its pieces, or beyond.
    """
    breaks = spline.breaks
    span = int(np.clip(np.searchsorted(breaks, s, side="right") - 1, 0, len(breaks) - 2))
    nearest = float(breaks[np.argmin(np.abs(breaks - s))])
    place = nearest if abs(nearest - s) < SLIVER * (breaks[span + 1] - breaks[span]) else float(s)
    if not spline.start < place < spline.end or place in spline.cuts:
        raise ThreadError(f"cut at {s:.6g} m: the thread ends there, or beyond; cut between {breaks[0]:.6g} and "
                          f"{breaks[-1]:.6g} m where it is whole")  # fmt: skip
    there = int(np.sum(spline.knots == place))
    touching, fields = insert_knots(spline, np.full(DEGREE - there, place), fields)
    after = int(np.searchsorted(touching.knots, place))  # the first of three knots: the point before goes through it
    knots = np.insert(touching.knots, after, place)
    return Spline(knots), place, [np.insert(field, after - 1, field[after - 1], axis=0) for field in fields]


@dataclass(frozen=True)
class Projection:
    """Least-squares projection in ∫|·|² ds from a spline to one with fewer knots.

    The projection keeps ∫· ds, and value and slope at the abscissae `kept` (k,) [m].
    """

    fine: Spline
    coarse: Spline
    kept: Array

    @cached_property
    def _samples(self) -> tuple[Array, Array]:
        rule = gauss_rule(self.fine, PROJECTION_POINTS)
        return rule.s.ravel(), rule.w.ravel()

    @cached_property
    def _fit(self) -> tuple[csr_array, csr_array]:
        s, _ = self._samples
        return evaluation(self.fine, s, 0), evaluation(self.coarse, s, 0)

    def project(self, field: Array) -> Array:
        """Return a field (n, c) of the fine spline on the coarse one."""
        (_, w), (fine, coarse) = self._samples, self._fit
        weighted = csr_array(coarse.multiply(w[:, None]))
        M, load = (weighted.T @ coarse).tocsc(), weighted.T @ (fine @ field)
        before, after = (
            np.vstack([evaluation(x, self.kept, 0).toarray(), evaluation(x, self.kept, 1).toarray(), w @ matrix])
            for x, matrix in ((self.fine, fine), (self.coarse, coarse))
        )
        size = np.linalg.norm(after, axis=1, keepdims=True)
        before, after = before / size, after / size
        solve = splu(M).solve
        out, by_rows = solve(np.ascontiguousarray(load)), solve(np.ascontiguousarray(after.T))
        for _ in range(2):  # the second for the round-off of the first
            out += by_rows @ np.linalg.lstsq(after @ by_rows, before @ field - after @ out, rcond=1e-14)[0]
        return np.asarray(out)

    def tangent_change(self, before: Array, after: Array) -> Array:
        """Return the difference of the tangents of the curve `before` (n_fine, 3) and `after` (n_coarse, 3).

        The result is the largest difference on each fine span, shape `(spans,)` [-].
        """
        s, _ = self._samples
        difference = evaluation(self.fine, s, 1) @ before - evaluation(self.coarse, s, 1) @ after
        return np.linalg.norm(difference, axis=1).reshape(-1, PROJECTION_POINTS).max(axis=1)


def evaluation(spline: Spline, s: Array, order: int) -> csr_array:
    """Return the matrix from control values to the derivative of that `order` at `s` (m,) [m], shape `(m, n)`."""
    first, b = spline.basis(s)
    row = np.repeat(np.arange(len(s)), DEGREE + 1)
    column = (first[:, None] + np.arange(DEGREE + 1)).ravel()
    return csr_array((b[:, order].ravel(), (row, column)), shape=(len(s), spline.n))


@dataclass(frozen=True)
class Refit:
    """A thread's functions on other knots: the new spline, and the fields on it."""

    spline: Spline
    fields: list[Array]


def refit(spline: Spline, wanted: Array, fields: Sequence[Array], kept: Array, bound: float) -> Refit:
    """Return the fields (n, c), the first of them the curve, on the breaks `wanted` [m], which the cuts are among.

    Missing knots are inserted, surplus ones are removed, on every piece of a cut curve by itself. A knot whose removal
    would turn the tangent by more than `bound` [-] on a span next to the knot stays, and so does one without which
    neighbouring spans would differ too much (`thread.knots.graded`). Value and slope stay at the ends of the pieces and
    at the abscissae `kept` (k,) [m].
    """
    if spline.pieces == 1:
        return refit_piece(spline, wanted, fields, kept, bound)
    starts, home, parts = spline.piece_starts[1:], spline.piece_of(kept), []
    by_piece = zip(*(np.split(field, starts) for field in fields), strict=True)
    for k, (own, (low, high)) in enumerate(zip(by_piece, pairwise(spline.piece_ends), strict=True)):
        breaks = spline.breaks[(spline.breaks >= low) & (spline.breaks <= high)]
        there = wanted[(wanted >= low) & (wanted <= high)]
        parts.append(refit_piece(Spline(clamped_knots(breaks)), there, own, kept[home == k], bound))
    knots = piecewise_knots([part.spline.breaks for part in parts])
    return Refit(Spline(knots), [np.concatenate(each) for each in zip(*(part.fields for part in parts), strict=True)])


def refit_piece(spline: Spline, wanted: Array, fields: Sequence[Array], kept: Array, bound: float) -> Refit:
    """Return the same of a curve in one piece."""
    present = spline.breaks
    fine, fields = insert_knots(spline, np.setdiff1d(wanted, present), fields)
    going = np.setdiff1d(present, wanted)
    while going.size:
        staying = graded(np.setdiff1d(fine.breaks, going), fine.breaks)
        going = np.setdiff1d(going, staying)
        if not going.size:
            break
        ends = np.concatenate([[spline.start], kept, [spline.end]])
        projection = Projection(fine, Spline(clamped_knots(staying)), ends)
        curve = projection.project(fields[0])
        bad = np.flatnonzero(projection.tangent_change(fields[0][:, :3], curve[:, :3]) > bound)
        if bad.size == 0:
            return Refit(projection.coarse, [curve, *(projection.project(field) for field in fields[1:])])
        at = np.searchsorted(fine.breaks, going)
        near = np.abs(at[:, None] - (bad + 0.5)).min(axis=1) <= 1.5
        going = going[~near] if near.any() else going[:0]
    return Refit(fine, list(fields))
