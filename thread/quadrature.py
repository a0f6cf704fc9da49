"""Gauss–Legendre points on the spans of a spline."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from thread.arrays import Array
from thread.spline import ORDERS, Spline


@dataclass(frozen=True)
class GaussRule:
    """Points of every span: abscissae `s` and weights `w`, `(spans, g)` [m], and basis derivatives `b`.

    `b` has shape `(spans, g, 4 orders, 4)`.
    """

    s: Array
    w: Array
    b: Array


legendre = cache(np.polynomial.legendre.leggauss)


def gauss_rule(spline: Spline, points: int) -> GaussRule:
    """Return the Gauss–Legendre rule with a number of `points` on each span, in the parameter of its knots."""
    x, w = legendre(points)
    left, right = spline.parameters[:-1, None], spline.parameters[1:, None]
    return rule_at(spline, 0.5 * (left + right) + 0.5 * (right - left) * x, 0.5 * (right - left) * w)


def rule_at(spline: Spline, parameter: Array, w: Array) -> GaussRule:
    """Return the rule from points and weights in the parameter of the knots, `(spans, g)` each."""
    s, rate, b = spline.evaluate(parameter.ravel(), np.repeat(np.arange(len(w)), w.shape[1]))
    return GaussRule(s.reshape(w.shape), w * rate.reshape(w.shape), b.reshape(*w.shape, ORDERS, ORDERS))
