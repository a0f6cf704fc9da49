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

from math import comb, perm

import numpy as np

from thread.arrays import Array
from thread.knots import clamped_knots
from thread.spline import FALLING, ORDERS, POWER, Spline

REACH = 6  # spans on each side of that of the hole; what a spline feels of its patch's ends falls by 0.27 a span

POWERS = np.arange(7)  # of s on a span, in which c is a polynomial
# Clamped beam of unit length and EI, a force or a couple at x: deflection by force x³(1 − x)³/3, slope by couple
# x(1 − x)(1 − 3x + 3x²) (Roark, table of clamped beams). The slope by force is half the derivative of the first,
# whatever the structure.
DEFLECTION = np.array([0.0, 0.0, 0.0, 1.0, -3.0, 3.0, -1.0]) / 3.0
SLOPE = np.array([0.0, 1.0, -4.0, 6.0, -3.0, 0.0, 0.0])
BINOMIAL = np.array([[comb(j, k) for j in POWERS] for k in POWERS], dtype=np.float64)
FALLING_POWERS = np.array([[perm(j, k) for j in POWERS] for k in range(3)], dtype=np.float64)  # of d^k/ds^k s^j
TWO_POINTS = np.polynomial.legendre.leggauss(2)  # exact for the product of two straight lines
SUMS = np.add.outer(np.arange(ORDERS), np.arange(ORDERS))  # powers in the product of two cubics


def missing_on(spline: Spline, span: int) -> Array:
    """Return the compliance at EI = 1 that the spline lacks on a span, as polynomials in the distance from its
    start [m].

    Shape `(3 derivatives by s, 3, 7 powers)`: deflection by force [m³ over EI], slope by force, slope by
    couple.
    """
    start, low, high, inverse = patch_of(spline, span)
    length = high - low
    values = spline.polynomials[span]
    slopes = np.append(FALLING[1][1:, None] * values[1:], np.zeros((1, ORDERS)), axis=0)
    per_length = length ** -POWERS.astype(np.float64)
    at = (start - low) / length
    force = length**3 * per_length * moved_polynomial(DEFLECTION, at) - quadratic_form(values, inverse)
    couple = length * per_length * moved_polynomial(SLOPE, at) - quadratic_form(slopes, inverse)
    by_force = np.append(0.5 * POWERS[1:] * force[1:], 0.0)
    out = np.zeros((3, 3, len(POWERS)))
    for k in range(3):
        out[k, :, : len(POWERS) - k] = (FALLING_POWERS[k] * np.stack([force, by_force, couple]))[:, k:]
    return out


def moved_polynomial(c: Array, x: float) -> Array:
    """Return the power coefficients of p(x + ξ) in ξ from those `c` (7,) of p."""
    return (BINOMIAL * x ** np.maximum(POWERS - POWERS[:, None], 0)) @ c


def quadratic_form(b: Array, inverse: Array) -> Array:
    """Return the power coefficients of bᵀ K⁻¹ b, shape `(7,)`, from those of `b` (4, 4) and `inverse` (4, 4)."""
    return np.bincount(SUMS.ravel(), (b @ inverse @ b.T).ravel()).astype(np.float64, copy=False)


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
    x, w = TWO_POINTS
    h = np.diff(spline.breaks)
    at = 0.5 * h[:, None] * (1.0 + x)
    curvature = (FALLING[2] * at[..., None] ** POWER[2]) @ spline.polynomials
    blocks = np.einsum("eg,egi,egj->eij", 0.5 * h[:, None] * w, curvature, curvature)
    local = spline.first[:, None] + np.arange(ORDERS)
    K = np.zeros((spline.n, spline.n))
    np.add.at(K, (local[:, :, None], local[:, None, :]), blocks)
    return K
