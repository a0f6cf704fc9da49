"""Strain-energy densities: W, P = ∂W/∂F and A = ∂²W/∂F² at many points at once, and sums of
densities.

Deformation gradients F have shape `(3, 3, …)`: the axes of the points come last, so that numbers
per point or per cell broadcast against F. W [J/m³] has shape `(…)`, P_ij [Pa] `(3, 3, …)` and
A_ijkl = ∂P_ij/∂F_kl [Pa] `(3, 3, 3, 3, …)`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Protocol

import numpy as np

from tissue.arrays import Array


class Density(Protocol):
    """A strain-energy density per volume of the reference shape."""

    def energy(self, F: Array) -> Array:
        """Return W, shape `(…)` [J/m³]."""

    def stress(self, F: Array) -> Array:
        """Return P = ∂W/∂F, shape `(3, 3, …)` [Pa]."""

    def tangent(self, F: Array) -> Array:
        """Return A = ∂²W/∂F², shape `(3, 3, 3, 3, …)` [Pa]."""


@dataclass(frozen=True)
class Sum:
    """The sum of one or more densities."""

    parts: Sequence[Density]

    def energy(self, F: Array) -> Array:
        """Return W, shape `(…)` [J/m³]."""
        return reduce(np.add, (part.energy(F) for part in self.parts))

    def stress(self, F: Array) -> Array:
        """Return P, shape `(3, 3, …)` [Pa]."""
        return reduce(np.add, (part.stress(F) for part in self.parts))

    def tangent(self, F: Array) -> Array:
        """Return A, shape `(3, 3, 3, 3, …)` [Pa]."""
        return reduce(np.add, (part.tangent(F) for part in self.parts))


def cofactor(F: Array) -> Array:
    """Return ∂J/∂F = J F⁻ᵀ, shape `(3, 3, …)`."""
    out = np.empty_like(F)
    for i, j, k in AROUND:
        for m, n, o in AROUND:
            np.multiply(F[j, n], F[k, o], out=out[i, m, ...])
            out[i, m] -= F[j, o] * F[k, n]
    return out


def determinant(F: Array) -> Array:
    """Return J = det F, shape `(…)`."""
    (a, b, c), (d, e, f), (g, h, i) = F
    return np.asarray(a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g))


def determinant_tangent(F: Array) -> Array:
    """Return ∂²J/∂F² = ε_ikm ε_jln F_mn, shape `(3, 3, 3, 3, …)`."""
    out = np.zeros((3, 3, 3, 3, *F.shape[2:]))
    for i, k, m, first in CYCLIC:
        for j, n, o, second in CYCLIC:
            out[i, j, k, n] += first * second * F[m, o]
    return out


AROUND = [(0, 1, 2), (1, 2, 0), (2, 0, 1)]
CYCLIC = [(0, 1, 2, 1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0), (0, 2, 1, -1.0), (2, 1, 0, -1.0), (1, 0, 2, -1.0)]
