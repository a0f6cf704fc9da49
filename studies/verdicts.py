"""Verdicts: whether a number converges under refinement, and whether a run stays within its theory.

Under refinement: observed order, Richardson's limit, grid-convergence index, verdict. Everywhere `h` is what is refined
(cell, span, step …), finest first, and `f` the number measured with it. Celik, Ghia, Roache, Freitas, Coleman, Raad:
Procedure for estimation and reporting of uncertainty due to discretization, J. Fluids Eng. 130 (2008) 078001; Roache:
Verification and validation in computational science and engineering (1998); Eça, Hoekstra: A procedure for the
estimation of the numerical uncertainty of CFD calculations, J. Comput. Phys. 262 (2014) 104.

Of a run: linear range, cells and spans fine enough, a run that came to rest; and the remark if not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

SAFETY, UNSURE = 1.25, 3.0  # Roache's factors: three grids that agree with the theory, and anything less
STEEPEST = 12.0  # orders that are looked for
AGREES = 0.35  # of an order: so near the formal one, 95 of 100 planted series with noise have their limit within it
SLOWEST = 0.5  # an order below which the limit is not trusted
CONVERGED = 0.05  # index above which no number is called converged
UNRESOLVED = 3e-3  # of the number: how a mesh happens to cut the rim of a hole changes it by as much, at no order
FLAT = 0.05  # an order this near zero is none: a logarithm
STILL = 1e-9  # of the number: changes by as little are round-off

LINEAR = 0.3  # footprints that a hole may move by, or strain in the tissue that bears a thread: both of its size
BETWEEN = 2.0  # spans between two holes: 2 leave 4 % of their stiffness against one another to be missed, 1.2 a quarter
RESOLVED = 0.5  # spans at a hole over √(EI/T): beyond, forces along the thread are off by several per cent
SETTLED = 1e-4  # kinetic over elastic energy: what still swings is below 1 % of what is deformed, as (v/ω)² is to u²


@dataclass(frozen=True)
class Verdict:
    """`kind` is "converged", "unresolved", "pre-asymptotic" or "diverging"; observed `order`, NaN if the number
    swings; Richardson's `limit`, NaN if there is none; `index`, half the width of the interval about the finest
    number, over that number."""

    kind: str
    order: float
    limit: float
    index: float

    @property
    def text(self) -> str:
        """In words."""
        if self.kind == "diverging":
            return f"DIVERGING, order {self.order:.2f}" if self.order < -FLAT else "DIVERGING like a logarithm"
        if self.kind == "converged":
            return f"converged to {100 * self.index:.2g} %" + ", order not resolved" * bool(np.isnan(self.limit))
        if self.kind == "unresolved":
            return f"changes by less than {100 * UNRESOLVED:g} %, order not resolved"
        return "pre-asymptotic"


def observed_order(h: Sequence[float], f: Sequence[float]) -> float:
    """Solve for p of f = f₀ + C hᵖ through three numbers: (f₃ − f₂)/(f₂ − f₁) = (h₃ᵖ − h₂ᵖ)/(h₂ᵖ − h₁ᵖ), which grows
    with p.

    That is Celik's equation for any ratio of the grids, with its sign: p ≤ 0 where the changes do not fall. NaN where
    the number swings, or does not change.
    """
    (h1, h2, h3), (f1, f2, f3) = h, f
    if (f3 - f2) * (f2 - f1) <= 0.0:
        return float("nan")

    def excess(p: float) -> float:
        return float(np.log((f3 - f2) / (f2 - f1)) - np.log(growth(h3 / h2, p) / growth(h1 / h2, p) * -1.0))

    low, high = excess(-STEEPEST), excess(STEEPEST)
    if low <= 0.0 or high >= 0.0:
        return -STEEPEST if low <= 0.0 else STEEPEST
    return float(brentq(excess, -STEEPEST, STEEPEST))


def growth(ratio: float, p: float) -> float:
    """Return (rᵖ − 1)/p, log r at p = 0."""
    return float(np.expm1(p * np.log(ratio)) / p) if p else float(np.log(ratio))


def richardson(h: Sequence[float], f: Sequence[float], p: float) -> float:
    """Return the limit f₀ of f = f₀ + C hᵖ through the two finest numbers."""
    return float(f[0] + (f[0] - f[1]) / ((h[1] / h[0]) ** p - 1.0))


def convergence_index(h: Sequence[float], f: Sequence[float], p: float, safety: float = SAFETY) -> float:
    """Return the grid-convergence index of the finest number, `safety` · |f₁ − f₂|/|f₁|/(rᵖ − 1)."""
    return float(safety * abs(f[0] - richardson(h, f, p)) / abs(f[0]))


def verdict(h: Sequence[float], f: Sequence[float], formal: float) -> Verdict:
    """Return the verdict on three or more numbers; `formal` is the theoretical order.

    Changes that do not fall support no limit and have no interval: the number diverges, or swings without end. A swing
    that falls has `UNSURE` times the range of all numbers for its interval. An order is sure near the formal one, where
    the numbers one level coarser show it too; the interval is then the grid-convergence index. Otherwise the larger
    factor is taken, and no less than the range of all (Eça & Hoekstra 2014). An order above the formal one is luck: two
    finest numbers may be near one another where the error turns, and the formal one is taken.

    Small changes without an order are "unresolved" and not called convergence, since a slow divergence looks the same.
    Of a finest number that is zero or not finite nothing is said.
    """
    whole = dict(sorted(zip(h, f, strict=True)))
    if len(whole) < 3:
        raise ValueError(f"a verdict needs three different refinements, got {len(whole)}; run more")
    h, f = list(whole), list(whole.values())
    if not np.all(np.isfinite(f)) or (np.any(f) and f[0] == 0.0):
        return Verdict("pre-asymptotic", float("nan"), float("nan"), float("inf"))
    change = float(np.ptp(f) / np.max(np.abs(f))) if np.any(f) else 0.0
    if change <= STILL:
        return Verdict("converged", float("nan"), float(f[0]), change)
    p = observed_order(h[:3], f[:3])
    index = interval_index(h, f, p, formal)
    limit = richardson(h, f, min(p, formal)) if p > FLAT else float("nan")
    return Verdict(kind_of(p, f, change, index), p, limit, index)


def interval_index(h: Sequence[float], f: Sequence[float], p: float, formal: float) -> float:
    """Return half the width of the interval over the finest number; infinite if the changes do not fall."""
    spread = float(np.ptp(f) / abs(f[0]))
    if p <= FLAT or (np.isnan(p) and abs(f[0] - f[1]) > abs(f[1] - f[2])):
        return float("inf")
    if np.isnan(p):
        return UNSURE * spread
    if is_sure(h, f, p, formal):
        return convergence_index(h, f, min(p, formal))
    return max(convergence_index(h, f, min(p, formal), UNSURE), SAFETY * spread)


def is_sure(h: Sequence[float], f: Sequence[float], p: float, formal: float) -> bool:
    """Return whether an observed order is near the formal one, and the numbers one level coarser show it too."""
    before = observed_order(h[1:4], f[1:4]) if len(h) > 3 else p
    return abs(p - formal) <= AGREES and abs(before - p) <= 2.0 * AGREES


def kind_of(p: float, f: Sequence[float], change: float, index: float) -> str:
    """Return the kind of a number of an observed order, whose values differ by the share `change`."""
    if index <= CONVERGED and not p < SLOWEST:
        return "converged"
    if change <= UNRESOLVED and not p >= SLOWEST:
        return "unresolved"
    one_way = abs(np.sign(np.diff(f)).sum()) == len(f) - 1
    return "diverging" if p <= FLAT and one_way else "pre-asymptotic"


def beyond_linear(what: str, moved: float, footprint: float) -> list[str]:
    """Return a remark where a hole moved [m] farther than small strains allow with its footprint [m]."""
    if moved <= LINEAR * footprint:
        return []
    return [f"{what}: a hole moved by {moved / footprint:.2g} footprints, BEYOND the linear range (about {LINEAR})"]


def beyond_bearing(what: str, strain: float) -> list[str]:
    """Return a remark where the bearing strain T/(d ℓ E) of a thread is not small."""
    if strain <= LINEAR:
        return []
    return [f"{what}: the bearing strain T/(d ℓ E) is {strain:.2g}, BEYOND the linear range (about {LINEAR})"]


def bearing_strain(tension: float, diameter: float, bite: float, youngs_modulus: float) -> float:
    """Return T/(d ℓ E): mean pressure of a thread on the tissue that it lies in over a length ℓ, over the tissue's
    E."""
    return tension / (diameter * bite * youngs_modulus)


def too_coarse(what: str, size: float, footprint: float) -> list[str]:
    """Return a remark where cells [m] are larger than the radius of a footprint [m] that nothing else makes up for."""
    if size <= footprint:
        return []
    return [f"{what}: cells of {size / footprint:.3g} footprint radii, TOO COARSE: the hole is as stiff as the mesh is"]


def not_settled(what: str, kinetic: float, elastic: float) -> list[str]:
    """Return a remark if a run still moves at its end, by its kinetic over its elastic energy [J]."""
    share = unrest(kinetic, elastic)
    if share <= SETTLED:
        return []
    return [f"{what}: NOT SETTLED, its kinetic energy is {share:.2g} of the elastic (at most {SETTLED:g})"]


def unrest(kinetic: float, elastic: float) -> float:
    """Return the kinetic over elastic energy, zero where nothing moves and infinite if nothing but motion is
    there."""
    return kinetic / elastic if elastic else float("inf") if kinetic else 0.0
