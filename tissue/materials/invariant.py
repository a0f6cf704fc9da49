"""Isochoric invariants Ī = J^(−2/3) tr(F M Fᵀ).

M = I gives Ī₁, and M = a ⊗ a gives the squared stretch Ī₄ of a fibre a.
"""

from dataclasses import dataclass

import numpy as np

from tissue.arrays import Array
from tissue.materials.density import cofactor, determinant

I3 = np.eye(3)


@dataclass(frozen=True)
class Invariant:
    """An invariant Ī, and the factors of its derivatives.

    Ī is `value`. The factors are `Q` = F M and `H` = F⁻ᵀ, `(3, 3, …)` each, `scale` = J^(−2/3), and
    `M`.
    """

    value: Array
    Q: Array
    H: Array
    scale: Array
    M: Array

    def gradient(self) -> Array:
        """Return ∂Ī/∂F = 2 J^(−2/3) Q − (2/3) Ī H, shape `(3, 3, …)`."""
        return np.asarray(2.0 * self.scale * self.Q - (2.0 / 3.0) * self.value * self.H)

    def tangent(self, slope: Array, bend: Array) -> Array:
        """Return the second derivative with respect to F of a function of Ī.

        `slope` and `bend` `(…)` are the first and second derivatives of the function with respect
        to Ī.

        ∂²Ī/∂F² = 2 J^(−2/3) I ⊠ M − (2/3)(D ⊗ H + H ⊗ D) − (4/9) Ī H ⊗ H + (2/3) Ī H ⊠ H with D =
        ∂Ī/∂F.
        """
        D, H, value = self.gradient(), self.H, self.value
        out = np.einsum("ij...,kl...->ijkl...", bend * D - (2.0 / 3.0) * slope * H, D)
        out -= np.einsum("ij...,kl...->ijkl...", slope * ((2.0 / 3.0) * D + (4.0 / 9.0) * value * H), H)
        out += np.einsum("il...,kj...->ijkl...", (2.0 / 3.0) * slope * value * H, H)
        even = 2.0 * slope * self.scale
        for i in range(3):
            out[i, :, i] += even * self.M
        return np.asarray(out)


def invariant(F: Array, M: Array = I3) -> Invariant:
    """Return the invariant of deformation gradients `(3, 3, …)`; `M` `(3, 3)`, or with trailing
    axes that broadcast.
    """
    plain = M is I3
    M = M.reshape(*M.shape, *[1] * (F.ndim - M.ndim)) if M.ndim < F.ndim else M
    J = determinant(F)
    with np.errstate(invalid="ignore", divide="ignore"):  # the caller refuses J ≤ 0
        scale = J ** (-2.0 / 3.0)
        H = cofactor(F) / J
    Q = F if plain else np.einsum("ik...,kj...->ij...", F, np.broadcast_to(M, F.shape))
    return Invariant(scale * np.einsum("ij...,ij...->...", F, Q), Q, H, scale, M)
