"""Isotropic linear elastic material."""

from dataclasses import dataclass

import numpy as np

from tissue.arrays import Array
from tissue.errors import TissueError

PerCell = float | Array  # one number, or one per cell, shape `(cells,)`


@dataclass(frozen=True)
class Material:
    """Young's modulus E [Pa], Poisson ratio ν [-] and density ρ [kg/m³], each one number or one per
    cell, `(cells,)`. `lasting` is the part of μ that does not relax [-].

    Raises `TissueError` unless E > 0, −1 < ν < 0.5 (ν = 0.5 is incompressible: λ is infinite) and
    ρ > 0.
    """

    youngs_modulus: PerCell
    poisson_ratio: PerCell
    density: PerCell
    lasting: PerCell = 1.0

    def __post_init__(self) -> None:
        _require("youngs_modulus", self.youngs_modulus, 0.0, np.inf, "Pa", "give a positive stiffness")
        _require("poisson_ratio", self.poisson_ratio, -1.0, 0.5, "-", "for incompressible tissue take 0.4999")
        _require("density", self.density, 0.0, np.inf, "kg/m³", "give a positive density")

    @property
    def lame_lambda(self) -> PerCell:
        """λ = Eν / ((1+ν)(1−2ν)) [Pa]."""
        E, nu = self.youngs_modulus, self.poisson_ratio
        return E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))

    @property
    def lame_mu(self) -> PerCell:
        """μ = E / (2(1+ν)) [Pa]."""
        return self.youngs_modulus / (2.0 * (1.0 + self.poisson_ratio))

    @property
    def bulk_modulus(self) -> PerCell:
        """κ = λ + 2μ/3 [Pa]."""
        return self.lame_lambda + 2.0 / 3.0 * self.lame_mu


def _require(name: str, value: PerCell, low: float, high: float, unit: str, remedy: str) -> None:
    values = np.atleast_1d(np.asarray(value, dtype=float))
    wrong = values[~((values > low) & (values < high))]
    if wrong.size:
        raise TissueError(f"{name} = {wrong[0]:g} {unit}: allowed is {low:g} < {name} < {high:g}; {remedy}")
