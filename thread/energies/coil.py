"""Rest curvature: a thread keeps the curvature of the coil in its packet.

At rest the thread is a circle of curvature κ̄ towards the material direction d₁. The section's
angle θ therefore gives the side to which the thread bends at rest. With t' = k₁ d₁ + k₂ d₂, the
turn of the bent thread per rest length,

    ½ EI |t' − κ̄ d₁|² = ½ EI κ² − EI κ̄ k₁ + ½ EI κ̄²

The first term is the bending energy without memory, and the other two terms are this energy. d₁ is
p, the direction a₁ cos θ + a₂ sin θ in the frame of the start of the step, turned with the tangent
(`thread.frames`). With K = T', r = |T|, D = r + t_o·T and h = t_o + t it follows

    k₁ = (K·p − (p·T)(K·h)/D)/r
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thread.arrays import Array
from thread.energies.torsion import OnStations, Twisted, spread_gradient, spread_hessian
from thread.frames import Frame
from thread.vectors import IDENTITY, cross, dot, outer


def direction(theta: Array, frame: Frame) -> tuple[Array, Array]:
    """Return p and its derivative by θ, each (..., 3)."""
    a_1, a_2 = frame.a_1, cross(frame.t, frame.a_1)
    cos, sin = np.cos(theta)[..., None], np.sin(theta)[..., None]
    return cos * a_1 + sin * a_2, cos * a_2 - sin * a_1


def curvature_along(T: Array, K: Array, p: Array, t_o: Array) -> Array:
    """Return k₁, the curvature towards p, shape of `T` without its last axis [1/m]."""
    r = np.linalg.norm(T, axis=-1)
    h = t_o + T / r[..., None]
    return (dot(K, p) - dot(p, T) * dot(K, h) / (r + dot(t_o, T))) / r


def curvature_along_derivatives(T: Array, K: Array, p: Array, t_o: Array) -> tuple[Array, Array, Array, Array]:
    """Return ∂k₁/∂T, ∂k₁/∂K (..., 3), ∂²k₁/∂T∂T, ∂²k₁/∂T∂K (..., 3, 3); k₁ is linear in K and in p.

    With P = p·T, k = K·h and Q = P k/D: k₁ = (K·p − Q)/r.
    """
    r = np.linalg.norm(T, axis=-1)[..., None]
    t = T / r
    h, D = t_o + t, r + dot(t_o, T)[..., None]
    P, k = dot(p, T)[..., None], dot(K, h)[..., None]
    along = dot(t, K)[..., None]
    k_T = (K - along * t) / r
    Pk_T = k * p + P * k_T
    Q_T, rest = (Pk_T - P * k / D * h) / D, dot(K, p)[..., None] - P * k / D
    by_T = -(rest / r * t + Q_T) / r
    by_K = (p - P / D * h) / r
    r, D, P, k, along, rest = (x[..., None] for x in (r, D, P, k, along, rest))
    plane = IDENTITY - outer(t, t)
    k_TT = -(symmetric_product(t, k_T * r[..., 0]) + along * plane) / r**2
    Q_TT = (symmetric_product(p, k_T) + P * k_TT) / D - symmetric_product(Pk_T, h) / D**2
    Q_TT += P * k / D**2 * (2.0 / D * outer(h, h) - plane / r)
    TT = rest / r**3 * (3.0 * outer(t, t) - IDENTITY) + symmetric_product(t, Q_T) / r**2 - Q_TT / r
    h_T = plane / r
    TK = -(outer(t, by_K) + outer(p / D[..., 0], h) + P / D * h_T - P / D**2 * outer(h, h)) / r
    return by_T, by_K, TT, TK


def symmetric_product(a: Array, b: Array) -> Array:
    """Return a ⊗ b + b ⊗ a."""
    ab = outer(a, b)
    return ab + ab.swapaxes(-1, -2)


@dataclass(frozen=True)
class Coil(OnStations):
    """The energy that rest curvature adds to the bending energy: `EI` [N m²], curvature at rest
    `kappa` [1/m].
    """

    EI: float
    kappa: float

    @cached_property
    def _rows(self) -> tuple[Array, ...]:
        return self.stations.T, self.stations.K, self.stations.theta

    def energy(self, at: Twisted) -> float:
        """Return the energy [J]."""
        p, _ = direction(at.theta, at.frame)
        k_1 = curvature_along(at.T, at.K, p, at.frame.t)
        return float(self.EI * self.kappa * np.sum(self.stations.w * (0.5 * self.kappa - k_1)))

    def gradient(self, at: Twisted) -> Array:
        """Return the derivative by the control points of each group, shape `(m, reach, 4)` [N, N
        m].
        """
        p, p_theta = direction(at.theta, at.frame)
        by_T, by_K, _, _ = curvature_along_derivatives(at.T, at.K, p, at.frame.t)
        by_theta = curvature_along(at.T, at.K, p_theta, at.frame.t)
        return spread_gradient(self.stations, self._rows, (by_T, by_K, by_theta)) * (-self.EI * self.kappa)

    def tangent(self, at: Twisted, N: Array) -> Array:
        """Return the second derivative by the control points of each group, shape `(m, reach,
        reach, 4, 4)`.
        """
        p, p_theta = direction(at.theta, at.frame)
        _, _, TT, TK = curvature_along_derivatives(at.T, at.K, p, at.frame.t)
        theta_T, theta_K, _, _ = curvature_along_derivatives(at.T, at.K, p_theta, at.frame.t)
        H = np.zeros((*at.theta.shape, 7, 7))
        H[..., :3, :3], H[..., :3, 3:6], H[..., 3:6, :3] = TT, TK, TK.swapaxes(-1, -2)
        H[..., :3, 6] = H[..., 6, :3] = theta_T
        H[..., 3:6, 6] = H[..., 6, 3:6] = theta_K
        H[..., 6, 6] = -curvature_along(at.T, at.K, p, at.frame.t)
        return spread_hessian(self.stations, self._rows, -self.EI * self.kappa * H)
