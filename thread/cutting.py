"""Cutting of a spline: four knots at one place, inserted exactly (Boehm), which do not change its
functions.
"""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import BSpline

from thread.arrays import Array
from thread.errors import ThreadError
from thread.spline import DEGREE, Spline

SLIVER = 0.1  # of a span: a cut that is nearer to a knot is made at the knot


def insert_knots(spline: Spline, knots: Array, fields: Sequence[Array]) -> tuple[Spline, list[Array]]:
    """Return the spline with additional simple `knots` [m], and unchanged functions `fields` (n, c)
    on it (Boehm 1980).
    """
    width = [field.shape[1] for field in fields]
    curve = BSpline(spline.knots, np.concatenate(fields, axis=1), DEGREE)
    for knot in knots:
        curve = curve.insert_knot(knot)
    coefficients = np.asarray(curve.c)[: len(curve.t) - DEGREE - 1]
    return Spline(np.asarray(curve.t)), np.split(coefficients, np.cumsum(width)[:-1], axis=1)


def cut(spline: Spline, s: float, fields: Sequence[Array]) -> tuple[Spline, float, list[Array]]:
    """Return the spline cut at `s` [m], the abscissa of the cut, and unchanged functions `fields`
    (n, c) on both sides.

    If a break is nearer to `s` than SLIVER of the span, the cut is made at the break, because a
    sliver would have almost no mass.

    Raises `ThreadError` for an abscissa at an end of the spline or of a piece, or outside the
    spline.
    """
    breaks = spline.breaks
    span = int(np.clip(np.searchsorted(breaks, s, side="right") - 1, 0, len(breaks) - 2))
    nearest = float(breaks[np.argmin(np.abs(breaks - s))])
    place = nearest if abs(nearest - s) < SLIVER * (breaks[span + 1] - breaks[span]) else float(s)
    if not spline.start < place < spline.end or place in spline.cuts:
        raise ThreadError(f"cut at {s:.6g} m: the thread ends there, or beyond; cut between {breaks[0]:.6g} and "
                          f"{breaks[-1]:.6g} m, inside a piece")  # fmt: skip
    there = int(np.sum(spline.knots == place))
    touching, fields = insert_knots(spline, np.full(DEGREE - there, place), fields)
    after = int(np.searchsorted(touching.knots, place))  # first of three knots; the point before is on the curve
    knots = np.insert(touching.knots, after, place)
    return Spline(knots), place, [np.insert(field, after - 1, field[after - 1], axis=0) for field in fields]
