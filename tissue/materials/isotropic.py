"""Isotropic tissue: neo-Hookean and exponential densities, and the volumetric term.

    W = μ/(2b) (exp(b (Ī₁ − 3)) − 1) + κ/2 (J − 1)²,    Ī₁ = J^(−2/3) tr FᵀF

b → 0 is the neo-Hookean solid; b = 5 gives the J-shaped curve of soft tissue (Demiray, J. Biomech.
5, 1972). At small strain both equal the linear organ with the same μ and κ.
"""

from dataclasses import dataclass

import numpy as np

from tissue.arrays import Array
from tissue.errors import TissueError
from tissue.material import PerCell
from tissue.materials.density import cofactor, determinant, determinant_tangent
from tissue.materials.invariant import invariant


@dataclass(frozen=True)
class Exponential:
    """μ/(2b) (exp(b (Ī₁ − 3)) − 1): shear modulus `mu` [Pa] and stiffening `b` [-], 0 for a
    neo-Hookean solid.

    Each is a number, or an array that broadcasts against the points. Raises `TissueError` unless
    μ > 0 and b ≥ 0.
    """

    mu: PerCell
    b: PerCell = 0.0

    def __post_init__(self) -> None:
        if not np.all((np.asarray(self.mu) > 0.0) & np.isfinite(self.mu)):
            raise TissueError(f"mu = {np.min(self.mu):g} Pa: allowed is a positive number; give a positive stiffness")
        if not np.all((np.asarray(self.b) >= 0.0) & np.isfinite(self.b)):
            raise TissueError(f"stiffening = {np.min(self.b):g}: allowed is 0 (neo-Hookean) or more; soft tissue has 5")

    def energy(self, F: Array) -> Array:
        """Return W, shape `(…)` [J/m³]."""
        x = invariant(F).value - 3.0
        b = np.asarray(self.b)
        stiff = b > 0.0
        with np.errstate(over="ignore"):
            grown = np.expm1(b * x) / np.where(stiff, b, 1.0)
        return np.asarray(0.5 * self.mu * np.where(stiff, grown, x))

    def stress(self, F: Array) -> Array:
        """Return P, shape `(3, 3, …)` [Pa]."""
        at = invariant(F)
        return self._slope(at.value) * at.gradient()

    def tangent(self, F: Array) -> Array:
        """Return A, shape `(3, 3, 3, 3, …)` [Pa]."""
        at = invariant(F)
        slope = self._slope(at.value)
        return at.tangent(slope, slope * self.b)

    def _slope(self, value: Array) -> Array:
        """Return ∂W/∂Ī₁, shape `(…)` [Pa]."""
        with np.errstate(over="ignore"):
            return np.asarray(0.5 * self.mu * np.exp(np.asarray(self.b) * (value - 3.0)))


@dataclass(frozen=True)
class Volumetric:
    """κ/2 (J − 1)² with the bulk modulus `kappa` [Pa], a number or an array that broadcasts against
    the points.
    """

    kappa: PerCell

    def energy(self, F: Array) -> Array:
        """Return W, shape `(…)` [J/m³]."""
        return np.asarray(0.5 * self.kappa * (determinant(F) - 1.0) ** 2)

    def stress(self, F: Array) -> Array:
        """Return P, shape `(3, 3, …)` [Pa]."""
        return np.asarray(self.kappa * (determinant(F) - 1.0) * cofactor(F))

    def tangent(self, F: Array) -> Array:
        """Return A, shape `(3, 3, 3, 3, …)` [Pa]."""
        cof = cofactor(F)
        out = self.kappa * np.einsum("ij...,kl...->ijkl...", cof, cof)
        out += self.kappa * (determinant(F) - 1.0) * determinant_tangent(F)
        return np.asarray(out)
