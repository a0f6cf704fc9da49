"""Gauss–Legendre points on the spans of a spline."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from thread.arrays import Array
from thread.placed import Placed
from thread.spline import ORDERS, Spline


@dataclass(frozen=True)
class GaussRule:
    """Points of every span: abscissae `s` and weights `w`, `(spans, g)` [m], and basis derivatives
    `b`.

    `b` has shape `(spans, g, 4 orders, 4)`.
    """

    s: Array
    w: Array
    b: Array


legendre = cache(np.polynomial.legendre.leggauss)


def gauss_rule(spline: Spline, points: int) -> GaussRule:
    """Return the Gauss–Legendre rule with a number of `points` on each span, in the parameter of
    its knots.
    """
    x, w = legendre(points)
    left, right = spline.parameters[:-1, None], spline.parameters[1:, None]
    middle = 0.5 * (left + right)
    return carried(spline, knot_rule(spline, middle + 0.5 * (right - left) * x, 0.5 * (right - left) * w))


def knot_rule(spline: Spline, parameter: Array, w: Array) -> GaussRule:
    """Return a rule over the parameter of the knots from points and weights in it, `(spans, g)`
    each.

    It does not change if the knots travel.
    """
    b = spline.chi.basis_on(np.repeat(np.arange(len(w)), w.shape[1]), parameter.ravel())
    return GaussRule(parameter, w, b.reshape(*w.shape, ORDERS, ORDERS))


def carried(spline: Spline, rule: GaussRule) -> GaussRule:
    """Return the rule over the abscissae from the one over the parameter of the knots."""
    if not isinstance(spline, Placed):
        return rule
    s, rate, b = spline.carried(rule.b, spline.first)
    return GaussRule(s, rule.w * rate, b)
