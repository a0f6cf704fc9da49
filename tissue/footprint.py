"""Averaging rules over the width of the hole: ⟨f⟩ = Σ_q w_q f(x_q) with Σ_q w_q = 1, and ⟨∇f⟩ = Σ_q c_q f(x_q).

Points are in units of the radius. The rules are products of Gauss rules and equal angles, so they are exact for
polynomials far above the shape functions' degree; many points, because a shape function is only piecewise polynomial.

The gradient is averaged by parts, ⟨∂f/∂x_j⟩ = ∫ w ∂f/∂x_j = ∮ w f n_j − ∫ f ∂w/∂x_j, which asks for the values of f
alone. Gradients of shape functions jump from cell to cell, and a sum over points that are not many times more than
the cells under the footprint would be as wrong as a bare point (measured: a couple's compliance doubled at a/h = 5).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue.errors import TissueError

Array = NDArray[np.float64]

WEIGHTS = ("uniform", "parabolic")
RADIAL, AROUND, RIM = 16, 40, 720  # 640 points on the disc
POLAR = 8  # 8 · 16 · 24 = 3072 points in the ball, half of them in a half ball


@dataclass(frozen=True)
class Rule:
    """Points of the unit disc (z = 0) or the unit ball, shape `(k, 3)`, and their weights `(k,)`, which sum
    to one.
    """

    points: Array
    weights: Array

    def __post_init__(self) -> None:
        if abs(self.weights.sum() - 1.0) > 1e-12:
            raise TissueError(f"footprint weights sum to {self.weights.sum():.17g}; they must sum to one")


def disc(weight: str) -> Rule:
    """Unit disc: 1/π (uniform) or 2(1 − r²)/π (parabolic)."""
    _check(weight)
    # With τ = r², w r dr dθ is dτ dθ / 2π or (1 − τ) dτ dθ / π: a Gauss rule on τ and equal angles are exact.
    tau, d_tau = _gauss(RADIAL)
    radial = d_tau * (2.0 * (1.0 - tau) if weight == "parabolic" else np.ones(RADIAL))
    angle = (np.arange(AROUND) + 0.5) * (2.0 * np.pi / AROUND)
    r, theta = (a.ravel() for a in np.meshgrid(np.sqrt(tau), angle, indexing="ij"))
    points = np.column_stack([r * np.cos(theta), r * np.sin(theta), np.zeros_like(r)])
    return Rule(points, np.repeat(radial / AROUND, AROUND))


def ball(weight: str) -> Rule:
    """Unit ball: 3/4π (uniform) or 15(1 − ρ²)/8π (parabolic); a composite rule, exact on each half z < 0 and
    z > 0.
    """
    _check(weight)
    rho, d_rho = _gauss(POLAR)
    density = 7.5 * (1.0 - rho**2) if weight == "parabolic" else np.full(POLAR, 3.0)
    half, d_half = _gauss(POLAR)
    cosine, d_cosine = np.concatenate([-half, half]), np.concatenate([d_half, d_half]) / 2.0
    angle = (np.arange(3 * POLAR) + 0.5) * (2.0 * np.pi / (3 * POLAR))
    R, Z, A = (a.ravel() for a in np.meshgrid(rho, cosine, angle, indexing="ij"))
    across = R * np.sqrt(1.0 - Z**2)
    weights = np.einsum("i,j,k->ijk", density * rho**2 * d_rho, d_cosine, np.full(angle.size, 1.0 / angle.size))
    return Rule(np.column_stack([across * np.cos(A), across * np.sin(A), R * Z]), weights.ravel())


@dataclass(frozen=True)
class Slope:
    """⟨∇f⟩ = Σ_q c_q f(x_q) over the unit disc or ball: points `(k, 3)` and vectors c `(k, 3)`; Σ_q c_q = 0."""

    points: Array
    vectors: Array

    def __post_init__(self) -> None:
        drift = np.abs(self.vectors.sum(axis=0)).max()
        if drift > 1e-12:
            raise TissueError(f"footprint vectors sum to {drift:.1e}; the slope of a constant must be zero")


def disc_slope(weight: str) -> Slope:
    """Tangential gradient over the unit disc: −∇w = 4x/π (parabolic), or the rim alone, n/π (uniform)."""
    _check(weight)
    if weight == "parabolic":
        flat = disc("uniform")
        return Slope(flat.points, 4.0 * flat.weights[:, None] * flat.points)
    angle = (np.arange(RIM) + 0.5) * (2.0 * np.pi / RIM)
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(RIM)])
    return Slope(rim, 2.0 * rim / RIM)


def ball_slope(weight: str) -> Slope:
    """Gradient over the unit ball: −∇w = 15x/4π (parabolic), or the sphere alone, 3n/4π (uniform)."""
    _check(weight)
    rule, factor = (ball("uniform"), 5.0) if weight == "parabolic" else (_sphere(), 3.0)
    return Slope(rule.points, factor * rule.weights[:, None] * rule.points)


def half_ball_slope(weight: str) -> Slope:
    """Gradient over the half z < 0 of the unit ball: as for the ball, with the flat side's ∮ w f n."""
    _check(weight)
    whole, flat = ball_slope(weight), disc(weight)
    below = whole.points[:, 2] < 0.0
    lid = (15.0 / 8.0 if weight == "parabolic" else 3.0 / 2.0) * flat.weights[:, None] * np.array([0.0, 0.0, 1.0])
    return Slope(np.vstack([whole.points[below], flat.points]), np.vstack([2.0 * whole.vectors[below], lid]))


def _sphere() -> Rule:
    """Unit sphere, uniform; a composite rule, exact on each half."""
    half, d_half = _gauss(2 * POLAR)
    cosine, d_cosine = np.concatenate([-half, half]), np.concatenate([d_half, d_half]) / 2.0
    angle = (np.arange(8 * POLAR) + 0.5) * (2.0 * np.pi / (8 * POLAR))
    Z, A = (a.ravel() for a in np.meshgrid(cosine, angle, indexing="ij"))
    across = np.sqrt(1.0 - Z**2)
    return Rule(
        np.column_stack([across * np.cos(A), across * np.sin(A), Z]), np.repeat(d_cosine / angle.size, angle.size)
    )


def _gauss(count: int) -> tuple[Array, Array]:
    """Gauss–Legendre points and weights on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(count)
    return 0.5 * (x + 1.0), 0.5 * w


def _check(weight: str) -> None:
    if weight not in WEIGHTS:
        raise TissueError(f"weight = {weight!r}: allowed are 'uniform' and 'parabolic'; take 'parabolic'")
