"""Families of fibres that carry only tension (Holzapfel, Gasser & Ogden, J. Elasticity 61, 2000).

    W = k₁/(2k₂) (exp(k₂ ⟨Ī₄ − 1⟩²) − 1),    Ī₄ = J^(−2/3) |F a|²

A shortened fibre has no stiffness. When a fibre is stretched beyond its reference length, its
stiffness starts at k₁. The first derivative of W is therefore continuous, but the second one is
not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tissue.arrays import Array
from tissue.errors import TissueError
from tissue.material import PerCell
from tissue.materials.invariant import Invariant, invariant


@dataclass(frozen=True)
class Fibres:
    """One family: its `direction` (3,), of any length, stiffness `k1` [Pa] and stiffening `k2` [-].

    k1 and k2 are numbers, or arrays that broadcast against the points; k1 = 0 means no fibres.
    Raises `TissueError` unless k1 ≥ 0, k2 > 0 and the direction is a finite vector other than zero.
    """

    direction: ArrayLike
    k1: PerCell
    k2: PerCell

    def __post_init__(self) -> None:
        a = np.asarray(self.direction, dtype=float)
        if a.shape != (3,) or not np.all(np.isfinite(a)) or not a.any():
            raise TissueError(f"direction = {self.direction!r} of fibres: allowed is a vector other than zero")
        if not np.all((np.asarray(self.k1) >= 0.0) & np.isfinite(self.k1)):
            raise TissueError(f"k1 = {np.min(self.k1):g} Pa of fibres: allowed is 0 or more; leave the fibres out")
        if not np.all((np.asarray(self.k2) > 0.0) & np.isfinite(self.k2)):
            raise TissueError(f"k2 = {np.min(self.k2):g} of fibres: allowed is a positive number; 10 is common")

    def _invariant(self, F: Array) -> Invariant:
        a = np.asarray(self.direction, dtype=float)
        a = a / np.linalg.norm(a)
        return invariant(F, np.outer(a, a))

    def _grown(self, x: Array) -> Array:
        with np.errstate(over="ignore"):
            return np.asarray(self.k1 * np.exp(self.k2 * x**2))

    def _stretched(self, at: Invariant) -> Array:
        """Return ⟨Ī₄ − 1⟩, zero at points without fibres, shape `(…)`."""
        return np.asarray(np.where(np.asarray(self.k1) > 0.0, np.maximum(at.value - 1.0, 0.0), 0.0))

    def energy(self, F: Array) -> Array:
        """Return W, shape `(…)` [J/m³]."""
        x = self._stretched(self._invariant(F))
        with np.errstate(over="ignore"):
            return np.asarray(0.5 * self.k1 / self.k2 * np.expm1(self.k2 * x**2))

    def stress(self, F: Array) -> Array:
        """Return P, shape `(3, 3, …)` [Pa]."""
        at = self._invariant(F)
        x = self._stretched(at)
        return np.asarray(x * self._grown(x) * at.gradient())

    def tangent(self, F: Array) -> Array:
        """Return A, shape `(3, 3, 3, 3, …)` [Pa]."""
        at = self._invariant(F)
        x = self._stretched(at)
        grown = self._grown(x)
        return at.tangent(x * grown, np.where(at.value > 1.0, grown * (1.0 + 2.0 * self.k2 * x**2), 0.0))
