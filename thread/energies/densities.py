"""Energy densities of the thread at points of the curve, with exact first and second derivatives.

Functions of arrays: the last axis of a vector argument is x, y, z, all axes before it are free.
"""

import numpy as np

from thread.arrays import Array
from thread.vectors import IDENTITY, dot, outer


def axial_strain(T: Array) -> Array:
    """Return Green–Lagrange strain ε = ½(|T|² − 1) of a thread at rest at |T| = 1 (Nocent & Rémion 2001) [-]."""
    return 0.5 * (dot(T, T) - 1.0)


def axial_stiffness(T: Array, N: Array, EA: float) -> Array:
    """Return the second derivative of ½EAε² by T with the axial force N as an unknown of its own [N].

    At N = EA ε the result is the exact Hessian; in the mixed-integration-point Newton N is the iterated force
    (Magisano, Leonetti & Garcea 2017). `T` (..., 3), `N` (...) [N]; returns (..., 3, 3).
    """
    return N[..., None, None] * IDENTITY + EA * outer(T, T)


def crushing(T: Array) -> Array:
    """Return (−ε)⁴ where the thread is shortened, 0 elsewhere [-].

    With the stretch evaluated at few points, |T| may fall to zero between them; this energy opposes that. Being
    of fourth order it hardly affects a thread that bends: at a shortening of 1 % it adds 1e-4 to the stretch's
    ε².
    """
    return np.maximum(-axial_strain(T), 0.0) ** 4


def crushing_gradient(T: Array) -> Array:
    """Return the derivative of (−ε)⁴ by T, shape `(..., 3)`."""
    return -4.0 * np.maximum(-axial_strain(T), 0.0)[..., None] ** 3 * T


def crushing_hessian(T: Array) -> Array:
    """Return the second derivative of (−ε)⁴ by T, shape `(..., 3, 3)`."""
    p = np.maximum(-axial_strain(T), 0.0)[..., None, None]
    return 12.0 * p**2 * outer(T, T) - 4.0 * p**3 * IDENTITY


def curvature_squared(T: Array, K: Array) -> Array:
    """Return κ² = |T × T'|²/|T|⁴, the turn of the tangent per rest length squared, `K` = T' = ∂²P/∂s² [1/m²].

    κ is |T| times the curvature of the curve, as in Reissner's rod, whose bending moment exerts no axial force:
    per deformed length the axial force would jump by twice EIκ² where the curvature does.
    """
    a, b, c = dot(T, T), dot(T, K), dot(K, K)
    return (a * c - b * b) / a**2


def curvature_squared_gradient(T: Array, K: Array) -> tuple[Array, Array]:
    """Return the derivatives of κ² by T and by T', each (..., 3).

    With a = T·T, b = T·T', c = T'·T': κ² = φ(a, b, c) = c/a − b²/a².
    """
    a, b, c = (x[..., None] for x in (dot(T, T), dot(T, K), dot(K, K)))
    phi_a = (2.0 * b * b / a - c) / a**2
    phi_b = -2.0 * b / a**2
    return 2.0 * phi_a * T + phi_b * K, phi_b * T + (2.0 / a) * K


def curvature_squared_hessian(T: Array, K: Array) -> tuple[Array, Array, Array]:
    """Return the second derivatives of κ² by (T, T), (T, T') and (T', T'), each (..., 3, 3)."""
    a, b, c = (x[..., None, None] for x in (dot(T, T), dot(T, K), dot(K, K)))
    per_a2 = 1.0 / a**2
    phi_b, phi_bb = -2.0 * b * per_a2, -2.0 * per_a2
    phi_ab = -2.0 * phi_b / a
    phi_a = -c * per_a2 + 0.5 * b * phi_ab
    phi_aa = (2.0 * c - 6.0 * b * b / a) * per_a2 / a
    TT, TK = outer(T, T), outer(T, K)
    KT = TK.swapaxes(-1, -2)
    H_TT = 2.0 * phi_a * IDENTITY + 4.0 * phi_aa * TT + 2.0 * phi_ab * (TK + KT) + phi_bb * outer(K, K)
    H_TK = phi_b * IDENTITY + 2.0 * phi_ab * TT + phi_bb * (2.0 * TK + KT)
    H_KK = (2.0 / a) * IDENTITY + phi_bb * TT
    return H_TT, H_TK, H_KK
