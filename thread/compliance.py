"""The compliance that a cubic spline lacks where a point force or a couple acts on it.

A force F and a couple m at an abscissa s bend a rod with a jump of shear and of curvature there. A C² spline has
neither inside a span: it is too stiff by an amount that depends on where in the span s lies, and a rod that slides
through a hole feels the difference as a lattice, a force along it that swings from knot to knot by up to a quarter of
m²/2EI however fine the spans. The lack is a local matter: a smooth load leaves none. So it is taken on a patch of spans
around s, clamped at its ends, as the difference of two linear answers,

    c(s) = g(s) − β(s)ᵀ K⁻¹ β(s),     β = (b, b'),   K = ∫EI b'' b''ᵀ ds,

g being the compliance of the clamped beam itself (force–force, force–couple, couple–couple), and added where the
rod is held. c is positive semidefinite, since the spline's answer is a Galerkin one; it falls with h³, h² and h.
"""

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from thread.spline import FALLING, ORDERS, POWER, Spline, clamped

Array = NDArray[np.float64]

REACH = 6  # spans on each side of that of the hole; what a spline feels of its patch's ends falls by 0.27 a span

_X = Polynomial([0.0, 1.0])
# Clamped beam of unit length and EI, force and couple at x: deflection by force, slope by force, slope by couple.
_BEAM = (
    _X**3 * (1 - _X) ** 3 / 3,
    _X**2 * (1 - _X) ** 2 * (1 - 2 * _X) / 2,
    _X * (1 - _X) * (1 - 3 * _X + 3 * _X**2),
)
_POWERS = np.arange(7)
_COEFFICIENTS = np.zeros((3, 3, 7))  # derivative, entry, power of x
for _k in range(3):
    for _j, _g in enumerate(_BEAM):
        _c = _g.deriv(_k).coef if _k else _g.coef
        _COEFFICIENTS[_k, _j, : len(_c)] = _c
_LENGTHS = np.array([3, 2, 1]) - np.arange(3)[:, None]  # power of the beam's length


def beam_compliance(a: Array, length: Array) -> Array:
    """Compliance of clamped beams of EI = 1 at `a` (m,) [m], shape `(m, 3 derivatives by a, 3)`: deflection by force
    [m³ over EI], slope by force, slope by couple (Roark, table of clamped beams)."""
    x = (a / length)[:, None] ** _POWERS
    return np.einsum("kjp,mp->mkj", _COEFFICIENTS, x) * length[:, None, None] ** _LENGTHS


def patch_of(spline: Spline, span: int) -> tuple[float, float, Array]:
    """Ends [m] of the patch around a span, and the inverse of its stiffness at EI = 1 over the four functions of that
    span, shape `(4, 4)`; zero for a function that does not vanish at the patch's clamped ends."""
    breaks = spline.breaks
    low, high = breaks[max(span - REACH, 0)], breaks[min(span + 1 + REACH, len(breaks) - 1)]
    inside = spline.knots[(spline.knots > low) & (spline.knots < high)]
    patch = Spline(clamped(np.concatenate([[low], inside, [high]])))
    free = np.arange(2, patch.n - 2)
    inverse = np.zeros((patch.n, patch.n))
    inverse[np.ix_(free, free)] = np.linalg.inv(bending_stiffness(patch)[np.ix_(free, free)])
    local = patch.first[np.searchsorted(patch.breaks, breaks[span])] + np.arange(ORDERS)
    return float(low), float(high), inverse[np.ix_(local, local)]


def bending_stiffness(spline: Spline) -> Array:
    """∫ b'' b''ᵀ ds, shape `(n, n)` [1/m³]."""
    K = np.zeros((spline.n, spline.n))
    x, w = np.polynomial.legendre.leggauss(2)  # exact for the product of two straight lines
    for first, polynomials, h in zip(spline.first, spline.polynomials, np.diff(spline.breaks), strict=True):
        at = 0.5 * h * (1.0 + x)
        curvature = (FALLING[2] * (at[:, None] ** POWER[2])) @ polynomials
        local = np.ix_(first + np.arange(ORDERS), first + np.arange(ORDERS))
        K[local] += np.einsum("g,gi,gj->ij", 0.5 * h * w, curvature, curvature)
    return K


def spline_compliance(b: Array, inverse: Array) -> Array:
    """βᵀK⁻¹β and its first two derivatives by s, shape `(m, 3, 3)` as in `beam_compliance`; `b` (m, 4 orders, 4),
    `inverse` (m, 4, 4)."""
    p = b @ inverse @ b.swapaxes(1, 2)
    out = np.empty((len(b), 3, 3))
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = p[:, 0, 0], p[:, 0, 1], p[:, 1, 1]
    out[:, 1, 0], out[:, 1, 1], out[:, 1, 2] = 2 * p[:, 0, 1], p[:, 1, 1] + p[:, 0, 2], 2 * p[:, 1, 2]
    out[:, 2, 0] = 2 * (p[:, 0, 2] + p[:, 1, 1])
    out[:, 2, 1] = 3 * p[:, 1, 2] + p[:, 0, 3]
    out[:, 2, 2] = 2 * (p[:, 1, 3] + p[:, 2, 2])
    return out
