"""Where the knots of a spline stand: uniform, graded, cut, or by a tree that follows the thread's curve.

The breaks of the tree are those of coarse spans, each halved again and again, at most `LEVELS` times, where the wanted
span is smaller: next to the holes, and where the curvature changes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from thread.arrays import Array, Indices
from thread.errors import ThreadError
from thread.spline import DEGREE, ORDERS, Spline

LEVELS = 9  # halvings of a coarse span at most
SLIVER = 0.25  # of a coarse span: what a cut leaves of one is no shorter, since neighbours differ too much then
GRADE = 4.0  # ratio of neighbouring spans: from 5 on a row of them has no positive rule (`thread.thread.exact_weights`)
ROUND_OFF = 1e-9  # of a span
SLOPE = 0.5  # growth of the wanted span with the distance from a hole, at most
LAYER = 3.0  # κ falls like exp(−x/ℓ) from a hole on, so the wanted span may grow like exp(x/3ℓ)


def uniform_knots(length: float, n: int, cuts: Sequence[float] = ()) -> Array:
    """Return the clamped knots of `n` control points with spans as equal over `[0, length]` [m] as the `cuts` [m] let
    them be."""
    return (
        graded_knots(length, n, [], 1.0, length, cuts)
        if cuts
        else clamped_knots(np.linspace(0.0, length, n - DEGREE + 1))
    )


def clamped_knots(breaks: Array) -> Array:
    """Return the clamped knots on the given span ends, shape `(spans + 1,)` [m]."""
    return np.concatenate([np.full(DEGREE, breaks[0]), breaks, np.full(DEGREE, breaks[-1])])


def piecewise_knots(pieces: Sequence[Array]) -> Array:
    """Return the clamped knots of pieces that follow one another, given by their span ends [m], cut between pieces."""
    knots = [clamped_knots(breaks) for breaks in pieces]
    return np.concatenate([knots[0], *(piece[ORDERS:] for piece in knots[1:])])


def knots_at(breaks: Array, cuts: Array) -> Array:
    """Return the clamped knots on the given span ends, shape `(spans + 1,)` [m], cut at those among them that are in
    `cuts`."""
    ends = [breaks[0], *cuts, breaks[-1]]
    return piecewise_knots([breaks[(breaks >= low) & (breaks <= high)] for low, high in pairwise(ends)])


def apportion(spans: int, shares: Array) -> Indices:
    """Return whole numbers, each at least 1, that sum to `spans` and are as nearly as possible proportional to
    `shares`.
    """
    exact = (spans - shares.size) * shares / shares.sum()
    out = np.floor(exact).astype(np.intp)
    out[np.argsort(out - exact, kind="stable")[: spans - shares.size - out.sum()]] += 1
    return out + 1


def graded_knots(length: float, n: int, centres: ArrayLike, ratio: float, reach: float, cuts: ArrayLike = ()) -> Array:
    """Return the clamped knots of `n` control points, `ratio` times denser near the `centres`, cut at the
    abscissae `cuts`.

    The span at distance x from the nearest centre is proportional to the ratio by which a smooth density falls:
    `1 + (ratio − 1) exp(−(x/reach)²)`. A thread that must leave a hole in a given direction bends over √(EI/T),
    often below a millimetre, and spans longer than that lock (bending boundary layer). `length`, `centres`,
    `reach`, `cuts` in [m], `ratio` ≥ 1. Raises `ThreadError` for other values.
    """
    centres, cuts = (np.atleast_1d(np.asarray(x, dtype=np.float64)) for x in (centres, cuts))
    if not ratio >= 1.0:
        raise ThreadError(f"graded knots: the ratio is {ratio}; allowed are numbers from 1 (uniform) on")
    if n <= DEGREE * (cuts.size + 1) + cuts.size:
        raise ThreadError(f"graded knots: {n} control points in {cuts.size + 1} pieces; each cubic needs at least 4")
    if np.any(np.diff(cuts) <= 0.0) or np.any((cuts <= 0.0) | (cuts >= length)):
        raise ThreadError(f"graded knots: cuts at {cuts} m; they must rise and lie inside the length {length} m")
    if (ratio == 1.0 or centres.size == 0) and not cuts.size:
        return uniform_knots(length, n)
    s = np.linspace(0.0, length, 4001)
    nearest = np.min(np.abs(s[:, None] - centres), axis=1, initial=np.inf)
    density = 1.0 + (ratio - 1.0) * np.exp(-((nearest / reach) ** 2))
    share = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    ends = np.concatenate([[0.0], cuts, [length]])
    at = np.interp(ends, s, share)
    pieces = []
    for k, spans in enumerate(apportion(n - DEGREE * (cuts.size + 1), np.diff(at))):
        breaks = np.interp(np.linspace(at[k], at[k + 1], spans + 1), share, s)
        breaks[[0, -1]] = ends[k : k + 2]
        pieces.append(breaks)
    return piecewise_knots(pieces)


def graded(breaks: Array, places: Array) -> Array:
    """Return span ends `breaks` (k,) [m] with as many of the `places` (m,) [m] as it takes that no span is longer than
    GRADE of its neighbours, each the nearest to the middle of such a span, where there are places in it."""
    while True:
        spans, left = np.diff(breaks), np.setdiff1d(places, breaks)
        shortest = np.minimum(np.append(np.inf, spans[:-1]), np.append(spans[1:], np.inf))
        steep = np.flatnonzero(spans > (1.0 + ROUND_OFF) * GRADE * shortest)
        if not (steep.size and left.size):
            return breaks
        low, high = breaks[steep], breaks[steep + 1]
        nearest = left[np.abs(left - 0.5 * (low + high)[:, None]).argmin(axis=1)]
        inside = (nearest > low) & (nearest < high)
        if not inside.any():
            return breaks
        breaks = np.union1d(breaks, nearest[inside])


@dataclass(frozen=True)
class Tree:
    """Places where a break may stand: the `coarse` breaks (roots + 1,) [m], and those between two of them that halve
    the span up to LEVELS times.

    Raises `ThreadError` for breaks that do not rise.
    """

    coarse: Array

    def __post_init__(self) -> None:
        if self.coarse.size < 2 or np.any(np.diff(self.coarse) <= 0.0):
            raise ThreadError(
                f"adaptive knots: {max(self.roots, 0)} coarse spans; allowed are numbers from 1 on, with breaks that "
                f"rise, not {self.coarse} m"
            )

    @property
    def roots(self) -> int:
        """Number of the coarse spans."""
        return self.coarse.size - 1

    @property
    def cells(self) -> int:
        """Number of the finest spans."""
        return self.roots << LEVELS

    @cached_property
    def root(self) -> Array:
        """Length of each coarse span, shape `(roots,)` [m]."""
        return np.diff(self.coarse)

    def cut(self, places: Array) -> "Tree":
        """Return the tree of a curve that is cut at `places` (k,) [m], its coarse breaks: of the others those go that
        would leave a coarse span shorter than SLIVER of the one that is cut."""
        if not places.size:
            return self
        near = np.abs(self.coarse[1:-1, None] - places) < SLIVER * self.root_at(places)
        return Tree(np.union1d(self.coarse[np.concatenate([[True], ~near.any(axis=1), [True]])], places))

    def root_at(self, s: Array) -> Array:
        """Return the length of the coarse span that holds each abscissa `s` (k,) [m], shape `(k,)` [m]."""
        return self.root[np.clip(np.searchsorted(self.coarse, s, side="right") - 1, 0, self.roots - 1)]

    @cached_property
    def places(self) -> Array:
        """Every place a break may have, shape `(cells + 1,)` [m]."""
        return np.interp(np.arange(self.cells + 1) / (1 << LEVELS), np.arange(self.roots + 1), self.coarse)

    @cached_property
    def middles(self) -> Array:
        """Middle of each finest span, shape `(cells,)` [m]."""
        return 0.5 * (self.places[:-1] + self.places[1:])

    def breaks(self, wanted: Array) -> Indices:
        """Return indices into `places` of the breaks that make no span longer than `wanted` (cells,) [m]
        anywhere on the span.
        """
        present = np.zeros(self.cells + 1, dtype=bool)
        present[:: 1 << LEVELS] = True
        split = np.ones(self.roots, dtype=bool)
        for level in range(LEVELS):
            block = 1 << (LEVELS - level)
            smallest = wanted.reshape(-1, block).min(axis=1)
            split = split & (np.repeat(self.root, 1 << level) / (1 << level) > smallest)
            present[block // 2 :: block] |= split
            split = np.repeat(split, 2)
        return np.flatnonzero(present)


def spans_at_holes(s: Array, holes: Array, layers: Array, at: float, beside: float) -> Array:
    """Return the span length wanted at the abscissae `s` (k,) [m] because of the holes.

    Each hole moves from `holes[:, 0]` to `holes[:, 1]` [m] in the step, and the thread bends over `layers` (m,)
    [m] = √(EI/T) on each side
    of a hole. Wanted are `at` [-] of the layer at the hole; beyond, `beside` [-] of the
    layer and more as the curvature falls, growing by SLOPE.
    """
    out = np.full(s.shape, np.inf)
    for (start, end), layer in zip(holes, layers, strict=True):
        x = np.maximum(np.maximum(min(start, end) - s, s - max(start, end)), 0.0)
        falling = beside * layer * np.exp(np.minimum(x / (LAYER * layer), 50.0))
        out = np.minimum(out, np.minimum(at * layer + SLOPE * x, falling))
    return out


def spans_by_curvature(spline: Spline, q: Array, angle: float) -> Array:
    """Return the span length wanted on each span by its own curve, shape `(spans,)` [m].

    The curvature of a cubic is straight on each span: the jump of its slope at a knot, times the span squared,
    is the angle [rad] that the span misses, of third order. Wanted is a missed `angle`; the result is at most
    four times and at least a quarter of the span.
    """
    h = np.diff(spline.breaks)
    D = spline.curve(q[:, :3], 0.5 * (spline.breaks[:-1] + spline.breaks[1:]))
    jumps = np.where(np.isin(spline.interior, spline.cuts), 0.0, np.linalg.norm(np.diff(D[:, 3], axis=0), axis=1))
    missed = h**2 * np.maximum(np.append(jumps, 0.0), np.insert(jumps, 0, 0.0))
    return np.asarray(h * np.cbrt(np.clip(angle / np.maximum(missed, np.finfo(float).tiny), 4.0**-3, 4.0**3)))
