"""Gauss–Legendre points on the spans of a spline."""

from dataclasses import dataclass

import numpy as np

from thread.arrays import Array
from thread.spline import ORDERS, Spline


@dataclass(frozen=True)
class GaussRule:
    """Gauss points of every span: weights `(spans, g)` [m] and basis derivatives `(spans, g, 4 orders, 4)`."""

    s: Array
    w: Array
    b: Array


def gauss_rule(spline: Spline, points: int) -> GaussRule:
    """Return the Gauss–Legendre rule with `points` points on each span."""
    x, w = np.polynomial.legendre.leggauss(points)
    left, right = spline.breaks[:-1, None], spline.breaks[1:, None]
    s = 0.5 * (left + right) + 0.5 * (right - left) * x
    _, b = spline.basis(s.ravel())
    return GaussRule(s, 0.5 * (right - left) * w, b.reshape(*s.shape, ORDERS, ORDERS))
