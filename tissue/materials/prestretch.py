"""Tissue that is stretched in its reference shape, as skin is: W(F F₀) / det F₀ with F₀ = diag(λ₁,
λ₂, λ₃).

The density of the stress-free tissue is evaluated at F F₀. It is divided by det F₀, because a
stress-free volume grows by the factor det F₀ to the volume in the reference shape. Tissue that is
cut free returns to its stress-free shape.
"""

from dataclasses import dataclass

import numpy as np

from tissue.arrays import Array
from tissue.errors import TissueError
from tissue.materials.density import Density


@dataclass(frozen=True)
class Prestretched:
    """A `density` of stress-free tissue in a reference shape with principal `stretches` along x, y
    and z.

    The stretches have shape `(3,)`, or `(3, …)` with axes that broadcast against the points. Raises
    `TissueError` unless all stretches are positive.
    """

    density: Density
    stretches: Array

    def __post_init__(self) -> None:
        given = np.asarray(self.stretches, dtype=float)
        if given.shape[:1] != (3,) or not np.all((given > 0.0) & np.isfinite(given)):
            raise TissueError(f"prestretch = {given.tolist()}: allowed are three positive stretches (1: none)")

    def _along(self, F: Array) -> Array:
        """Return the stretches with axes for the points, `(3, …)`."""
        given = np.asarray(self.stretches, dtype=float)
        return given.reshape(3, *[1] * (F.ndim - 1 - given.ndim), *given.shape[1:])

    def energy(self, F: Array) -> Array:
        """Return W, shape `(…)` [J/m³]."""
        along = self._along(F)
        return np.asarray(self.density.energy(F * along) / np.prod(along, axis=0))

    def stress(self, F: Array) -> Array:
        """Return P, shape `(3, 3, …)` [Pa]."""
        along = self._along(F)
        return np.asarray(self.density.stress(F * along) * (along / np.prod(along, axis=0)))

    def tangent(self, F: Array) -> Array:
        """Return A, shape `(3, 3, 3, 3, …)` [Pa]."""
        along = self._along(F)
        out = self.density.tangent(F * along)
        out *= (along / np.prod(along, axis=0))[:, None, None]
        out *= along
        return np.asarray(out)
