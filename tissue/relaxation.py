"""Tissue that relaxes: a Prony series of the distortional stress at finite strain.

The model is from Simo, Comput. Methods Appl. Mech. Eng. 60, 1987; its form is from Holzapfel &
Gasser, Comput. Methods Appl. Mech. Eng. 190, 2001:

    S = S_vol + (1 − Σ g_i) S_iso + Σ Q_i,    dQ_i/dt + Q_i/τ_i = g_i dS_iso/dt

S is the second Piola stress of the tissue without prestretch. The modulus of the material is the
instantaneous one. After a long time, the distortional stress is 1 − Σ g_i of its instantaneous
value. At small strain this is linear viscoelasticity. Over a step of Δt in which S_iso changes
linearly from S to S⁺, with x_i = Δt/τ_i and φ(x) = (1 − e⁻ˣ)/x,

    Q_i⁺ = e^(−x_i) Q_i + g_i φ(x_i) (S⁺ − S).

The stress at the end of the step therefore derives from an energy. As without relaxation, the step
is a minimum:

    γ W_iso + ½ H : (C − 1),    γ = 1 − Σ g_i (1 − φ_i),    H = Σ e^(−x_i) Q_i − Σ g_i φ_i S.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissue.arrays import Array
from tissue.errors import TissueError
from tissue.material import PerCell
from tissue.materials.density import Density


@dataclass(frozen=True, eq=False)
class Prony:
    """Shares g [-] of the distortional stress that relax, and their relaxation times τ [s], `(b,)`.

    A share is one number or one per cell, `(c,)`. Raises `TissueError` unless g ≥ 0, Σ g < 1 and
    τ > 0.
    """

    shares: Sequence[PerCell]
    times: Sequence[float]

    def __post_init__(self) -> None:
        if len(self.shares) != len(self.times) or not self.times:
            raise TissueError("relaxation: allowed are one time for each share, and at least one share")
        least, all_of_it = min(float(np.min(share)) for share in self.shares), float(np.max(self.total))
        if not (least >= 0.0 and all_of_it < 1.0):
            raise TissueError(
                f"relaxation: shares from {least:g}, in sum up to {all_of_it:g}; allowed are shares of 0 or more and a "
                "sum below 1, because the rest carries a lasting load"
            )
        if not all(0.0 < time < np.inf for time in self.times):
            raise TissueError(f"relaxation: times {list(self.times)} s; allowed are positive numbers")

    @property
    def total(self) -> PerCell:
        """Σ g, the share that has relaxed after a long time [-]."""
        return sum(self.shares, start=np.zeros(()))

    def decays(self, dt: float) -> Array:
        """Return e^(−Δt/τ) of each time, shape `(b,)`."""
        return np.exp(-dt / np.asarray(self.times))

    def means(self, dt: float) -> Array:
        """Return φ(Δt/τ), the mean decay over Δt, shape `(b,)`.

        It is 1 for Δt = 0, and 0 for an infinite Δt.
        """
        x = dt / np.asarray(self.times)
        return np.divide(-np.expm1(-x), x, out=np.where(x > 0.0, 0.0, 1.0), where=(x > 0.0) & np.isfinite(x))

    def met(self, dt: float) -> PerCell:
        """Return γ, the part of the distortional stiffness that acts in a step of Δt [-]."""
        left = (share * (1.0 - mean) for share, mean in zip(self.shares, self.means(dt), strict=True))
        return 1.0 - sum(left, start=np.zeros(()))

    def held(self, stresses: Array, S: Array, dt: float) -> Array:
        """Return H of a step of Δt from the stresses Q_i `(b, 3, 3, …)` and S `(3, 3, …)` at its
        start [Pa].
        """
        parts = zip(self.decays(dt), self.means(dt), self.shares, stresses, strict=True)
        return np.asarray(sum(decay * Q - share * mean * S for decay, mean, share, Q in parts))

    def after(self, stresses: Array, change: Array, dt: float) -> Array:
        """Return Q_i after a step of Δt in which S_iso changed by `change` `(3, 3, …)` [Pa], shape
        `(b, 3, 3, …)`.
        """
        parts = zip(self.decays(dt), self.means(dt), self.shares, stresses, strict=True)
        return np.stack([decay * Q + share * mean * change for decay, mean, share, Q in parts])


@dataclass(frozen=True)
class Part:
    """A `density` times a factor `part`, one number or one per cell."""

    density: Density
    part: PerCell

    def energy(self, F: Array) -> Array:
        """Return W, shape `(…)` [J/m³]."""
        return self.part * self.density.energy(F)

    def stress(self, F: Array) -> Array:
        """Return P, shape `(3, 3, …)` [Pa]."""
        return self.part * self.density.stress(F)

    def tangent(self, F: Array) -> Array:
        """Return A, shape `(3, 3, 3, 3, …)` [Pa]."""
        return self.part * self.density.tangent(F)


@dataclass(frozen=True)
class Held:
    """The density ½ H : (C − 1) of a constant second Piola stress H `(3, 3, …)` [Pa]."""

    H: Array

    def energy(self, F: Array) -> Array:
        """Return W, shape `(…)` [J/m³]."""
        return np.asarray(0.5 * (np.einsum("ij...,ij...->...", F, self.stress(F)) - np.einsum("ii...->...", self.H)))

    def stress(self, F: Array) -> Array:
        """Return P = F H, shape `(3, 3, …)` [Pa]."""
        return np.asarray(np.einsum("ik...,kj...->ij...", F, self.H))

    def tangent(self, F: Array) -> Array:
        """Return A, shape `(3, 3, 3, 3, …)` [Pa]."""
        out = np.zeros((3, 3, *self.H.shape))
        for i in range(3):
            out[i, :, i] = self.H
        return out
