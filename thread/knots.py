"""Where the knots of a spline stand that stand still: uniform, graded and cut."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from thread.arrays import Array, Indices
from thread.errors import ThreadError
from thread.spline import DEGREE, ORDERS


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
