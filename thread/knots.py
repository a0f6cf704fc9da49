"""Knots of a spline that do not travel: uniform, and cut."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from thread.arrays import Array, Indices
from thread.errors import ThreadError
from thread.spline import DEGREE, ORDERS


def uniform_knots(length: float, n: int, cuts: ArrayLike = ()) -> Array:
    """Return the clamped knots of `n` control points over `[0, length]` [m], with spans as equal as
    the `cuts` [m] allow.

    Raises `ThreadError` for too few points and for cuts that do not increase or are not inside the
    length.
    """
    cuts = np.asarray(cuts, dtype=np.float64)
    if n <= DEGREE * (cuts.size + 1) + cuts.size:
        raise ThreadError(f"knots: {n} control points in {cuts.size + 1} pieces; each cubic needs at least 4")
    if np.any(np.diff(cuts) <= 0.0) or np.any((cuts <= 0.0) | (cuts >= length)):
        raise ThreadError(f"knots: cuts at {cuts} m; they must increase and lie inside the length {length} m")
    ends = np.concatenate([[0.0], cuts, [length]])
    spans = apportion(n - DEGREE * (cuts.size + 1), np.diff(ends)).tolist()
    each = zip(pairwise(ends.tolist()), spans, strict=True)
    return piecewise_knots([np.linspace(low, high, count + 1) for (low, high), count in each])


def clamped_knots(breaks: Array) -> Array:
    """Return the clamped knots on the given span ends, shape `(spans + 1,)` [m]."""
    return np.concatenate([np.full(DEGREE, breaks[0]), breaks, np.full(DEGREE, breaks[-1])])


def piecewise_knots(pieces: Sequence[Array]) -> Array:
    """Return the clamped knots of consecutive pieces, given by their span ends [m], with cuts
    between pieces.
    """
    knots = [clamped_knots(breaks) for breaks in pieces]
    return np.concatenate([knots[0], *(piece[ORDERS:] for piece in knots[1:])])


def apportion(spans: int, shares: Array) -> Indices:
    """Return whole numbers of at least 1 that sum to `spans` and are nearly proportional to
    `shares`.
    """
    exact = (spans - shares.size) * shares / shares.sum()
    out = np.floor(exact).astype(np.intp)
    out[np.argsort(out - exact, kind="stable")[: spans - shares.size - out.sum()]] += 1
    return out + 1
