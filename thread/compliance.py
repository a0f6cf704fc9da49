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

A rod under tension T bends over ℓ = √(EI/T). Both answers are then those under T, K = ∫EI b'' b''ᵀ + T b' b'ᵀ ds: else
a spline with spans much longer than ℓ would give way like a beam of span h where the rod turns within ℓ. For h ≫ ℓ the
spline is a string, c₀ is what it rounds a corner by, and c₂ → 1/(2√(EI T)) is all of the rod's own. The patch is then
pinned at its ends: what a spline lacks at a clamped end, a string carries to the hole. The rod's answer is then no
polynomial, and is replaced by the one through as many points of the span.

Of the turn under a couple the spline then makes a part itself and lacks the rest, the share c₂/g of g = 1/(2√(EI T)),
that of an endless rod. That share of c₂ is what turns as the rod does, far (`coupling.kernels.constraints`):

    c₃ = c₂²/g,

which is c₂ where the spline is a string, of second order in h/ℓ where it resolves ℓ, and zero without tension. It goes
through points of the span too, and its slope from span to span as that of c₂ does.
"""

from dataclasses import dataclass
from functools import cache
from math import comb, perm

import numpy as np

from thread.arrays import Array, Indices
from thread.knots import clamped_knots
from thread.spline import FALLING, ORDERS, POWER, Spline

SLACK = 0.05  # spans at a hole over ℓ below which the tension changes c by less than 4e-3 of itself
REACH = 6  # spans on each side of that of the hole; what a spline feels of its patch's ends falls by 0.27 a span

POWERS = np.arange(7)  # of s on a span, in which c is a polynomial
LACKS = 4  # c₀, c₁, c₂, c₃
AT = np.linspace(0.0, 1.0, len(POWERS) - 2)
SLOPES = np.stack([np.eye(len(POWERS))[1], POWERS.astype(np.float64)])  # of the powers at 0 and at 1
# Clamped beam of unit length and EI, a force or a couple at x: deflection by force x³(1 − x)³/3, slope by couple
# x(1 − x)(1 − 3x + 3x²) (Roark, table of clamped beams). The slope by force is half the derivative of the first,
# whatever the structure.
DEFLECTION = np.array([0.0, 0.0, 0.0, 1.0, -3.0, 3.0, -1.0]) / 3.0
SLOPE = np.array([0.0, 1.0, -4.0, 6.0, -3.0, 0.0, 0.0])
BINOMIAL = np.array([[comb(j, k) for j in POWERS] for k in POWERS], dtype=np.float64)
FALLING_POWERS = np.array([[perm(j, k) for j in POWERS] for k in range(3)], dtype=np.float64)  # of d^k/ds^k s^j
SUMS = np.add.outer(np.arange(ORDERS), np.arange(ORDERS))  # powers in the product of two cubics


@dataclass(frozen=True)
class Patch:
    """The spans around one that goes from `start` to `end` [m], held at `low` and `high` [m].

    `values` (4, 4), polynomials of the span's four functions; of all of the patch's functions `bending` ∫ b'' b''ᵀ
    [1/m³] and `stretching` ∫ b' b'ᵀ [1/m], (k, k); `own` (4,), where the span's four stand among them.
    """

    start: float
    end: float
    low: float
    high: float
    values: Array
    bending: Array
    stretching: Array
    own: Indices

    def is_slack(self, layer: float) -> bool:
        """Whether the tension is too small to matter."""
        return self.end - self.start < SLACK * layer

    def inverse(self, layer: float) -> Array:
        """Return the inverse of the stiffness at EI = 1 under the tension 1/`layer`² over the span's four functions,
        shape `(4, 4)`; zero for one that does not vanish at the ends, clamped without tension, pinned under one."""
        k, fixed = len(self.bending), 2 if np.isinf(layer) else 1
        free = slice(fixed, k - fixed)
        out = np.zeros((k, k))
        out[free, free] = np.linalg.inv((self.bending + self.stretching / layer**2)[free, free])
        return out[np.ix_(self.own, self.own)]


def missing_on(patch: Patch, layer: float = np.inf) -> Array:
    """Return the compliance at EI = 1 that the spline lacks on the span of a patch, as polynomials in the distance
    from its start [m], for a thread that bends over `layer` = √(EI/T) [m].

    Shape `(3 derivatives by s, 4, 7 powers)`: deflection by force [m³ over EI], slope by force, slope by couple, and
    the share of that which turns far as the rod does.
    """
    values, inverse = patch.values, patch.inverse(np.inf if patch.is_slack(layer) else layer)
    slopes = np.append(FALLING[1][1:, None] * values[1:], np.zeros((1, ORDERS)), axis=0)
    deflection, slope = slack_rod(patch) if patch.is_slack(layer) else taut_rod(patch, layer)
    force = deflection - quadratic_form(values, inverse)
    couple = slope - quadratic_form(slopes, inverse)
    by_force = np.append(0.5 * POWERS[1:] * force[1:], 0.0)
    far = np.zeros_like(couple) if patch.is_slack(layer) else share_of_rod(patch, layer, couple)
    out = np.zeros((3, LACKS, len(POWERS)))
    for k in range(3):
        out[k, :, : len(POWERS) - k] = (FALLING_POWERS[k] * np.stack([force, by_force, couple, far]))[:, k:]
    return out


def share_of_rod(patch: Patch, layer: float, couple: Array) -> Array:
    """Return c₃ = c₂²/g on the span of a patch, from c₂, `couple` (7,), as power coefficients of the distance from its
    start. The polynomial has c₃ at points of the span and its slope at both ends: where a slope jumps from span to span
    the force along the thread does, and a thread that comes to rest there finds no balance."""
    powers, length = osculation(), (patch.end - patch.start) ** POWERS.astype(np.float64)
    c2 = AT[:, None] ** POWERS @ (length * couple)
    slopes = SLOPES @ (length * couple)
    return np.asarray(2.0 / layer / length * (powers @ np.concatenate([c2**2, 2.0 * c2[[0, -1]] * slopes])))


def slack_rod(patch: Patch) -> tuple[Array, Array]:
    """Return deflection by force and slope by couple of the clamped rod without tension on the span of a patch, each
    as power coefficients `(7,)` of the distance from its start."""
    length = patch.high - patch.low
    per_length, at = length ** -POWERS.astype(np.float64), (patch.start - patch.low) / length
    force, couple = (per_length * moved_polynomial(c, at) for c in (DEFLECTION, SLOPE))
    return length**3 * force, length * couple


def taut_rod(patch: Patch, layer: float) -> tuple[Array, Array]:
    """Return the same of the pinned rod under the tension 1/`layer`², as the polynomials through points of the
    span."""
    at, powers = interpolation()
    h, length = patch.end - patch.start, patch.high - patch.low
    answers = rod_answers((patch.start - patch.low + h * at) / length, layer / length)
    scale = h ** -POWERS.astype(np.float64)
    return length**3 * scale * (powers @ answers[:, 0]), length * scale * (powers @ answers[:, 1])


@cache
def interpolation() -> tuple[Array, Array]:
    """Return Chebyshev's points on [0, 1], shape `(7,)`, and what makes the powers of the polynomial through values
    there, shape `(7, 7)`."""
    at = 0.5 + 0.5 * np.polynomial.chebyshev.chebpts1(len(POWERS))
    return at, np.linalg.inv(at[:, None] ** POWERS).astype(np.float64)


@cache
def osculation() -> Array:
    """Return what makes the powers of the polynomial on [0, 1] with given values `AT` and slopes at both ends, shape
    `(7, 7)`."""
    return np.linalg.inv(np.concatenate([AT[:, None] ** POWERS, SLOPES])).astype(np.float64)


def rod_answers(x: Array, layer: float) -> Array:
    """Return deflection by force and slope by couple, at the load, of a pinned rod of unit length and EI under the
    tension 1/`layer`², loaded at `x` (k,). Shape `(k, 2)`.

    On either side w = A₁ + A₂ ξ + A₃ exp(−ξ/ℓ) + A₄ exp(−(X − ξ)/ℓ), ξ from 0 at the pinned end to X at the load.
    Its rows: w and w'' vanish at both ends, w and its slope go on at the load, the two derivatives above jump there.
    """
    A, loads = np.zeros((len(x), 8, 8)), np.zeros((len(x), 8, 2))
    for side, X, sign in ((0, x, 1.0), (1, 1.0 - x, -1.0)):
        far, one, none = np.exp(-X / layer), np.ones_like(X), np.zeros_like(X)
        rows = {
            2 * side: (one, none, one, far),
            2 * side + 1: (none, none, one, far),
            4: (sign * one, sign * X, sign * far, sign * one),
            5: (none, one, -far / layer, one / layer),
            6: (none, none, sign * far, sign * one),
            7: (none, none, -far, one),
        }
        for row, terms in rows.items():
            A[:, row, 4 * side : 4 * side + 4] = np.stack(terms, axis=1)
    loads[:, 7, 0], loads[:, 6, 1] = -(layer**3), layer**2
    w = np.linalg.solve(A, loads)
    return np.stack([(A[:, 4, :4] * w[:, :4, 0]).sum(axis=1), (A[:, 5, :4] * w[:, :4, 1]).sum(axis=1)], axis=1)


def moved_polynomial(c: Array, x: float) -> Array:
    """Return the power coefficients of p(x + ξ) in ξ from those `c` (7,) of p."""
    return (BINOMIAL * x ** np.maximum(POWERS - POWERS[:, None], 0)) @ c


def quadratic_form(b: Array, inverse: Array) -> Array:
    """Return the power coefficients of bᵀ K⁻¹ b, shape `(7,)`, from those of `b` (4, 4) and `inverse` (4, 4)."""
    return np.bincount(SUMS.ravel(), (b @ inverse @ b.T).ravel()).astype(np.float64, copy=False)


def patch_of(spline: Spline, span: int) -> Patch:
    """Return the patch of a span: REACH spans on each side of it, or those up to the ends of the thread's piece."""
    breaks, ends = spline.breaks, spline.piece_ends
    piece = spline.piece_of(breaks[span])
    low = max(breaks[max(span - REACH, 0)], ends[piece])
    high = min(breaks[min(span + 1 + REACH, len(breaks) - 1)], ends[piece + 1])
    inside = spline.knots[(spline.knots > low) & (spline.knots < high)]
    patch = Spline(clamped_knots(np.concatenate([[low], inside, [high]])))
    own = patch.first[np.searchsorted(patch.breaks, breaks[span])] + np.arange(ORDERS)
    bending, stretching = (products(patch, k) for k in (2, 1))
    place = float(breaks[span]), float(breaks[span + 1]), float(low), float(high)
    return Patch(*place, spline.polynomials[span], bending, stretching, own)


def products(spline: Spline, order: int) -> Array:
    """Assemble ∫ b⁽ᵏ⁾ b⁽ᵏ⁾ᵀ ds of the first or second derivatives, k = `order`, shape `(n, n)`."""
    x, w = np.polynomial.legendre.leggauss(4 - order)  # exact
    h = np.diff(spline.breaks)
    at = 0.5 * h[:, None] * (1.0 + x)
    b = (FALLING[order] * at[..., None] ** POWER[order]) @ spline.polynomials
    blocks = np.einsum("eg,egi,egj->eij", 0.5 * h[:, None] * w, b, b)
    local = spline.first[:, None] + np.arange(ORDERS)
    K = np.zeros((spline.n, spline.n))
    np.add.at(K, (local[:, :, None], local[:, None, :]), blocks)
    return K
