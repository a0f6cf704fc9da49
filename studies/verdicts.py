"""Verdicts: whether a number converges under refinement, and whether a run stays within its theory.

Under refinement: observed order, Richardson's limit, grid-convergence index, verdict. `h` is the
refined quantity (cell, span, step …), finest first, and `f` the number measured with it. Celik,
Ghia, Roache, Freitas, Coleman, Raad: Procedure for estimation and reporting of uncertainty due to
discretization, J. Fluids Eng. 130 (2008) 078001; Roache: Verification and validation in
computational science and engineering (1998); Eça, Hoekstra: A procedure for the estimation of the
numerical uncertainty of CFD calculations, J. Comput. Phys. 262 (2014) 104.

Of a run: linear range, fine cells and spans, rest at the end; and a remark if one of them fails.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

SAFETY, UNSURE = 1.25, 3.0  # Roache's factors: for three grids that agree with the theory, and for all others
STEEPEST = 12.0  # largest order in the search
AGREES = 0.35  # of an order, from the formal order: 95 of 100 test series with noise then contain their limit
SLOWEST = 0.5  # an order below which the limit is not trusted
CONVERGED = 0.05  # index above which a number is not called converged
UNRESOLVED = 3e-3  # of the number: a random change of this size comes from the cut of a hole's rim by the mesh
FLAT = 0.05  # an order this near to zero counts as zero: a logarithm
STILL = 1e-9  # of the number: smaller changes are round-off

LINEAR = 0.3  # largest displacement of a hole in footprints, and largest bearing strain: an order-of-magnitude bound
BETWEEN = 2.0  # spans between two holes: 2 miss 4 % of the stiffness of one hole against the other, 1.2 miss 25 %
RESOLVED = 0.5  # spans at a hole over √(EI/T): above this, forces along the thread have errors of several per cent
SETTLED = 1e-4  # kinetic over elastic energy, like (v/ω)² over u²: the oscillation is below 1 % of the deformation


@dataclass(frozen=True)
class Verdict:
    """A verdict under refinement.

    `kind` is "converged", "unresolved", "pre-asymptotic", "diverging", or "zero" for a number that
    is zero at every level. `order` is the observed order, NaN if the number swings. `limit` is
    Richardson's limit, NaN without a limit. `index` is half the width of the interval about the
    finest number, over this number.
    """

    kind: str
    order: float
    limit: float
    index: float

    @property
    def text(self) -> str:
        """The verdict in words."""
        if self.kind == "diverging":
            return f"DIVERGING, order {self.order:.2f}" if self.order < -FLAT else "DIVERGING like a logarithm"
        if self.kind == "converged":
            return f"converged to {100 * self.index:.2g} %" + ", order not resolved" * bool(np.isnan(self.limit))
        if self.kind == "unresolved":
            return f"changes by less than {100 * UNRESOLVED:g} %, order not resolved"
        return "zero at every level, no verdict" if self.kind == "zero" else "pre-asymptotic"


def observed_order(h: Sequence[float], f: Sequence[float]) -> float:
    """Return the order p of f = f₀ + C hᵖ through three numbers.

    It solves (f₃ − f₂)/(f₂ − f₁) = (h₃ᵖ − h₂ᵖ)/(h₂ᵖ − h₁ᵖ), whose right side grows with p. This is
    Celik's equation for any ratio of the grids, with its sign: p ≤ 0 if the changes do not
    decrease. NaN if the number swings or does not change.
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
    """Return the grid-convergence index of the finest number.

    It is `safety` · |f₁ − f₂|/|f₁|/(rᵖ − 1).
    """
    return float(safety * abs(f[0] - richardson(h, f, p)) / abs(f[0]))


def verdict(h: Sequence[float], f: Sequence[float], formal: float, estimated: bool = False) -> Verdict:
    """Return the verdict on three or more numbers; `formal` is the theoretical order.

    If `estimated`, `h` are estimates of the relative error. If the changes do not decrease but are
    not larger than the estimates, the estimates scatter, and this is no divergence: the formal
    order and the larger factor are used.

    If the changes do not decrease, there is no limit and no interval: the number diverges, or
    swings without end. For a decreasing swing, the interval is `UNSURE` times the range of all
    numbers. An order is sure if it is near the formal order and the numbers one level coarser
    agree. The interval is then the grid-convergence index. Otherwise the larger factor is used, and
    at least the range of all numbers (Eça & Hoekstra 2014). An order above the formal one is
    accidental: the two finest numbers can be close where the error changes sign. The formal order
    is then used.

    Small changes without an order are "unresolved" and not called convergence, because a slow
    divergence looks the same. A finest number that is zero or not finite gets no verdict.
    """
    whole = dict(sorted(zip(h, f, strict=True)))
    if len(whole) < 3:
        raise ValueError(f"a verdict needs three different refinements, got {len(whole)}; run more")
    h, f = list(whole), list(whole.values())
    if not np.all(np.isfinite(f)) or f[0] == 0.0:
        return Verdict("pre-asymptotic" if np.any(f) else "zero", float("nan"), float("nan"), float("inf"))
    change = float(np.ptp(f) / np.max(np.abs(f)))
    if change <= STILL:
        return Verdict("converged", float("nan"), float(f[0]), change)
    p = observed_order(h[:3], f[:3])
    if estimated and p <= FLAT and UNRESOLVED < change <= max(h):
        index = max(convergence_index(h, f, formal, UNSURE), SAFETY * float(np.ptp(f) / abs(f[0])))
        if index <= 1.0:
            return Verdict("pre-asymptotic", p, richardson(h, f, formal), index)
    index = interval_index(h, f, p, formal)
    limit = richardson(h, f, min(p, formal)) if p > FLAT else float("nan")
    return Verdict(kind_of(p, f, change, index), p, limit, index)


def interval_index(h: Sequence[float], f: Sequence[float], p: float, formal: float) -> float:
    """Return half the width of the interval over the finest number.

    Infinite if the changes do not decrease.
    """
    spread = float(np.ptp(f) / abs(f[0]))
    if p <= FLAT or (np.isnan(p) and abs(f[0] - f[1]) > abs(f[1] - f[2])):
        return float("inf")
    if np.isnan(p):
        return UNSURE * spread
    if is_sure(h, f, p, formal):
        return convergence_index(h, f, min(p, formal))
    return max(convergence_index(h, f, min(p, formal), UNSURE), SAFETY * spread)


def is_sure(h: Sequence[float], f: Sequence[float], p: float, formal: float) -> bool:
    """Return whether an observed order is near the formal one.

    The numbers one level coarser must agree.
    """
    before = observed_order(h[1:4], f[1:4]) if len(h) > 3 else p
    return abs(p - formal) <= AGREES and abs(before - p) <= 2.0 * AGREES


def kind_of(p: float, f: Sequence[float], change: float, index: float) -> str:
    """Return the kind of verdict for an observed order.

    The numbers differ by the share `change`.
    """
    if index <= CONVERGED and not p < SLOWEST:
        return "converged"
    if change <= UNRESOLVED and not p >= SLOWEST:
        return "unresolved"
    one_way = abs(np.sign(np.diff(f)).sum()) == len(f) - 1
    return "diverging" if p <= FLAT and one_way else "pre-asymptotic"


def beyond_linear(what: str, moved: float, footprint: float) -> Iterator[str]:
    """Yield a remark if a hole moved [m] beyond the range of small strains.

    The range follows from its footprint [m].
    """
    if not moved <= LINEAR * footprint:
        yield f"{what}: a hole moved by {moved / footprint:.2g} footprints, BEYOND the linear range (about {LINEAR})"


def beyond_bearing(what: str, strain: float) -> Iterator[str]:
    """Yield a remark if the bearing strain T/(d ℓ E) of a thread is not small."""
    if not strain <= LINEAR:
        yield f"{what}: the bearing strain T/(d ℓ E) is {strain:.2g}, BEYOND the linear range (about {LINEAR})"


def bearing_strain(tension: float, diameter: float, bite: float, youngs_modulus: float) -> float:
    """Return the bearing strain T/(d ℓ E).

    It is the mean pressure of a thread on tissue over a length ℓ, over the tissue's E.
    """
    return tension / (diameter * bite * youngs_modulus)


def too_coarse(what: str, size: float, footprint: float) -> Iterator[str]:
    """Yield a remark if cells [m] are larger than the radius of a footprint [m]."""
    if not size <= footprint:
        radii = f"{size / footprint:.3g} footprint radii"
        yield f"{what}: cells of {radii}, TOO COARSE: the mesh sets the hole's stiffness"


def not_settled(what: str, share: float) -> Iterator[str]:
    """Yield a remark if a run still moves at its end.

    `share` is its kinetic over its elastic energy [-].
    """
    if not share <= SETTLED:
        yield f"{what}: NOT SETTLED, its kinetic energy is {share:.2g} of the elastic (at most {SETTLED:g})"


def unrest(kinetic: float, elastic: float) -> float:
    """Return the kinetic over elastic energy [-].

    Zero for a run at rest, and infinite without elastic energy.
    """
    return kinetic / elastic if elastic else float("inf") if kinetic else 0.0
