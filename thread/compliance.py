"""The compliance that a cubic spline lacks where a point force or a couple acts on it.

A force F and a couple m at an abscissa s bend a rod with a jump of shear and of curvature there. A C² spline has
neither inside a span: the spline is too stiff by an amount that depends on where in the span s lies, and a rod that
slides through a hole feels the difference as a lattice, a force along it that swings from knot to knot by up to a
quarter of m²/2EI however fine the spans. The lack is local: a smooth load leaves none. So the lack is computed on a
patch of spans around s, clamped at its ends, as the difference of two linear answers,

    c(s) = g(s) − β(s)ᵀ K⁻¹ β(s),     β = (b, b'),   K = ∫EI b'' b''ᵀ ds,

g being the compliance of the clamped beam itself (force–force, force–couple, couple–couple), and added where the
rod is held. c is a polynomial of degree six on each span, and positive semidefinite since the spline's answer is a
Galerkin one; its three entries fall with h³, h² and h.
"""

import numpy as np
from numpy.polynomial import Polynomial

from thread.arrays import Array
from thread.knots import clamped_knots
from thread.spline import FALLING, ORDERS, POWER, Spline

REACH = 6  # spans on each side of that of the hole; what a spline feels of its patch's ends falls by 0.27 a span

_X = Polynomial([0.0, 1.0])
# Clamped beam of unit length and EI, a force or a couple at x: deflection by force, slope by couple (Roark, table of
# clamped beams). The slope by force is half the derivative of the first, whatever the structure.
DEFLECTION = _X**3 * (1 - _X) ** 3 / 3
SLOPE = _X * (1 - _X) * (1 - 3 * _X + 3 * _X**2)
POWERS = np.arange(7)  # of s on a span, in which c is a polynomial


def missing_on(spline: Spline, span: int) -> Array:
    """Return the compliance at EI = 1 that the spline lacks on a span, as polynomials in the distance from its
    start [m].

    Shape `(3 derivatives by s, 3, 7 powers)`: deflection by force [m³ over EI], slope by force, slope by
    couple.
    """
    start, low, high, inverse = patch_of(spline, span)
    at = (Polynomial([start - low, 1.0])) / (high - low)
    values, slopes = (FALLING[k][:, None] * spline.polynomials[span] for k in (0, 1))
    force = (high - low) ** 3 * DEFLECTION(at) - quadratic_form(values, inverse)
    couple = (high - low) * SLOPE(at) - quadratic_form(slopes[1:], inverse)
    out = np.zeros((3, 3, len(POWERS)))
    for j, lack in enumerate((force, 0.5 * force.deriv(), couple)):
        for k in range(3):
            c = lack.deriv(k).coef if k else lack.coef
            out[k, j, : len(c)] = c
    return out


def quadratic_form(b: Array, inverse: Array) -> Polynomial:
    """Return the polynomial bᵀ K⁻¹ b from power coefficients `b` (r, 4) and `inverse` (4, 4)."""
    product = b @ inverse @ b.T
    power = np.add.outer(np.arange(len(b)), np.arange(len(b)))
    return Polynomial(np.bincount(power.ravel(), product.ravel()))


def patch_of(spline: Spline, span: int) -> tuple[float, float, float, Array]:
    """Return the start of a span, the ends of the patch around the span [m], and the inverse of the patch's stiffness.

    The inverse is taken at EI = 1 over the four functions of the span, shape `(4, 4)`, and is zero for a
    function that does not vanish at the patch's clamped ends.
    """
    breaks, ends = spline.breaks, spline.piece_ends
    piece = spline.piece_of(breaks[span])
    low = max(breaks[max(span - REACH, 0)], ends[piece])
    high = min(breaks[min(span + 1 + REACH, len(breaks) - 1)], ends[piece + 1])
    inside = spline.knots[(spline.knots > low) & (spline.knots < high)]
    patch = Spline(clamped_knots(np.concatenate([[low], inside, [high]])))
    free = np.arange(2, patch.n - 2)
    inverse = np.zeros((patch.n, patch.n))
    inverse[np.ix_(free, free)] = np.linalg.inv(bending_stiffness(patch)[np.ix_(free, free)])
    local = patch.first[np.searchsorted(patch.breaks, breaks[span])] + np.arange(ORDERS)
    return float(breaks[span]), float(low), float(high), inverse[np.ix_(local, local)]


def bending_stiffness(spline: Spline) -> Array:
    """Assemble the bending stiffness ∫ b'' b''ᵀ ds at EI = 1, shape `(n, n)` [1/m³]."""
    K = np.zeros((spline.n, spline.n))
    x, w = np.polynomial.legendre.leggauss(2)  # exact for the product of two straight lines
    for first, polynomials, h in zip(spline.first, spline.polynomials, np.diff(spline.breaks), strict=True):
        at = 0.5 * h * (1.0 + x)
        curvature = (FALLING[2] * (at[:, None] ** POWER[2])) @ polynomials
        local = np.ix_(first + np.arange(ORDERS), first + np.arange(ORDERS))
        K[local] += np.einsum("g,gi,gj->ij", 0.5 * h * w, curvature, curvature)
    return K
