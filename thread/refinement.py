"""Knots that follow what the thread does: fine beside its holes and where its curvature changes, coarse elsewhere.

The breaks are those of a tree: `roots` equal spans, each halved again and again, at most `LEVELS` times, where the
wanted span is smaller. Knots that come are inserted exactly (Boehm); knots that go are taken out by a least-squares
projection that keeps the total momentum, and P and T at given abscissae.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_array
from scipy.sparse.linalg import splu

from thread.errors import ThreadError
from thread.quadrature import gauss_rule
from thread.spline import DEGREE, Array, Indices, Spline, clamped

LEVELS = 9  # halvings of a root at most
PROJECTION_POINTS = 4  # a span: exact for the product of two cubics
SLOPE = 0.5  # growth of the wanted span with the distance from a hole, at most
LAYER = 3.0  # κ falls like exp(−x/ℓ) beside a hole, so the wanted span may grow like exp(x/3ℓ)


@dataclass(frozen=True)
class Tree:
    """Places where a break may stand: `roots` equal spans over `[start, end]` [m], halved up to LEVELS times.

    Raises `ThreadError` for less than one root.
    """

    start: float
    end: float
    roots: int

    def __post_init__(self) -> None:
        if self.roots < 1:
            raise ThreadError(f"adaptive knots: {self.roots} coarse spans; allowed are numbers from 1 on")

    @property
    def cells(self) -> int:
        """Number of the finest spans."""
        return self.roots << LEVELS

    @property
    def root(self) -> float:
        """Length of a coarse span [m]."""
        return (self.end - self.start) / self.roots

    @cached_property
    def places(self) -> Array:
        """Every place a break may have, shape `(cells + 1,)` [m]."""
        return self.start + (self.end - self.start) * (np.arange(self.cells + 1) / self.cells)

    @cached_property
    def middles(self) -> Array:
        """Middle of each finest span, shape `(cells,)` [m]."""
        return 0.5 * (self.places[:-1] + self.places[1:])

    def breaks(self, wanted: Array) -> Indices:
        """Indices into `places` of the breaks that make no span longer than `wanted` (cells,) [m] anywhere on it."""
        present = np.zeros(self.cells + 1, dtype=bool)
        present[:: 1 << LEVELS] = True
        split = np.ones(self.roots, dtype=bool)
        for level in range(LEVELS):
            block = 1 << (LEVELS - level)
            smallest = wanted.reshape(-1, block).min(axis=1)
            split = split & (self.root / (1 << level) > smallest)
            present[block // 2 :: block] |= split
            split = np.repeat(split, 2)
        return np.flatnonzero(present)

    def index(self, breaks: Array) -> Indices:
        """Where breaks made of `places` stand in them."""
        return np.searchsorted(self.places, breaks)


def spline_on(tree: Tree, index: Indices) -> Spline:
    """The cubic spline with simple knots at the breaks of that index."""
    return Spline(clamped(tree.places[index]))


def wanted_at_holes(s: Array, holes: Array, layers: Array, at: float, beside: float) -> Array:
    """Span wanted at the abscissae `s` (k,) [m] for holes that go from `holes[:, 0]` to `holes[:, 1]` [m], the thread
    bending over `layers` (m,) [m] = √(EI/T) beside each.

    `at` [-] of the layer at the hole; beyond, `beside` [-] of it and more as the curvature falls, growing by SLOPE.
    """
    out = np.full(s.shape, np.inf)
    for (start, end), layer in zip(holes, layers, strict=True):
        x = np.maximum(np.maximum(min(start, end) - s, s - max(start, end)), 0.0)
        falling = beside * layer * np.exp(np.minimum(x / (LAYER * layer), 50.0))
        out = np.minimum(out, np.minimum(at * layer + SLOPE * x, falling))
    return out


def wanted_by_curvature(spline: Spline, q: Array, angle: float) -> Array:
    """Span wanted on each span by its own curve, shape `(spans,)` [m].

    The curvature of a cubic is straight on each span: the jump of its slope at a knot, times the span squared, is the
    angle [rad] that it misses, of third order. Wanted is `angle`; at most four times, at least a quarter of the span.
    """
    h = np.diff(spline.breaks)
    D = spline.curve(q[:, :3], 0.5 * (spline.breaks[:-1] + spline.breaks[1:]))
    jumps = np.linalg.norm(np.diff(D[:, 3], axis=0), axis=1)
    missed = h**2 * np.maximum(np.append(jumps, 0.0), np.insert(jumps, 0, 0.0))
    return np.asarray(h * np.cbrt(np.clip(angle / np.maximum(missed, np.finfo(float).tiny), 4.0**-3, 4.0**3)))


# -- from one spline to another --------------------------------------------------------------------------------------


def inserted(spline: Spline, knots: Array, fields: Sequence[Array]) -> tuple[Spline, list[Array]]:
    """The spline with further simple `knots` [m], and `fields` (n, c) on it: the same functions (Boehm 1980)."""
    width = [field.shape[1] for field in fields]
    curve = BSpline(spline.knots, np.concatenate(fields, axis=1), DEGREE)
    for knot in knots:
        curve = curve.insert_knot(knot)
    coefficients = np.asarray(curve.c)[: len(curve.t) - DEGREE - 1]
    return Spline(np.asarray(curve.t)), np.split(coefficients, np.cumsum(width)[:-1], axis=1)


@dataclass(frozen=True)
class Projection:
    """From a spline to one with fewer knots: least squares in ∫|·|² ds, with ∫· ds, and the value and slope at the
    abscissae `kept` (k,) [m] as they were."""

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

    def onto(self, field: Array) -> Array:
        """A field (n, c) of the fine spline on the coarse one."""
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

    def turned(self, before: Array, after: Array) -> Array:
        """By how much the tangent of the curve `before` (n_fine, 3) differs from that `after` (n_coarse, 3), the
        largest on each fine span, shape `(spans,)` [-]."""
        s, _ = self._samples
        difference = evaluation(self.fine, s, 1) @ before - evaluation(self.coarse, s, 1) @ after
        return np.linalg.norm(difference, axis=1).reshape(-1, PROJECTION_POINTS).max(axis=1)


def evaluation(spline: Spline, s: Array, order: int) -> csr_array:
    """Matrix from control values to the derivative of that `order` at `s` (m,) [m], shape `(m, n)`."""
    first, b = spline.basis(s)
    row = np.repeat(np.arange(len(s)), DEGREE + 1)
    column = (first[:, None] + np.arange(DEGREE + 1)).ravel()
    return csr_array((b[:, order].ravel(), (row, column)), shape=(len(s), spline.n))


@dataclass(frozen=True)
class Refit:
    """A thread's functions on other knots: the new spline, and the fields on it."""

    spline: Spline
    fields: list[Array]


def refit(tree: Tree, spline: Spline, wanted: Indices, fields: Sequence[Array], kept: Array, bound: float) -> Refit:
    """The fields (n, c) on the breaks `wanted` of the tree, the first of them the curve.

    Knots that are missing are inserted, those too many taken out. A knot whose removal would turn the tangent by more
    than `bound` [-] on a span next to it stays.
    """
    present = tree.index(spline.breaks)
    fine, fields = inserted(spline, tree.places[np.setdiff1d(wanted, present)], fields)
    going = np.setdiff1d(present, wanted)
    while going.size:
        staying = np.setdiff1d(tree.index(fine.breaks), going)
        projection = Projection(fine, spline_on(tree, staying), kept)
        curve = projection.onto(fields[0])
        bad = np.flatnonzero(projection.turned(fields[0][:, :3], curve[:, :3]) > bound)
        if bad.size == 0:
            return Refit(projection.coarse, [curve, *(projection.onto(field) for field in fields[1:])])
        at = np.searchsorted(tree.index(fine.breaks), going)
        near = np.abs(at[:, None] - (bad + 0.5)).min(axis=1) <= 1.5
        going = going[~near] if near.any() else going[:0]
    return Refit(fine, fields)
