"""A parabolic footprint on a half-space and in full space: its compliance, and the field around it.

A footprint has twelve averages: ⟨U_i⟩, then ⟨∂U_i/∂x_j⟩ as 3 + 3i + j. On the half-space z < 0 the
values are averaged over the disc of radius a. The slopes are averaged over the disc or over the
half ball below it. In full space the values are averaged over the ball. Forces conjugate to the
averages have the same weight, so every compliance is symmetric and scales as

    ⟨U⟩⟨U⟩: 1/Ea,   ⟨U⟩⟨∇U⟩: 1/Ea²,   ⟨∇U⟩⟨∇U⟩: 1/Ea³.

On the half-space they follow from the Fourier transform along the surface. At wave vector k the
response is given in the frame (along k, across k, z). The integral over the direction of k is a sum
over eight angles, exact for tensors of rank 4.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import jv

from tissue.arrays import Array

TWELVE = 12
ANGLES = 8
LARGEST = 160.0  # wave number times radius, end of the integrals of the half ball: the neglected part is below 1e-4
# ∫ŵ² dk, ∫ŵ² k dk, ∫ŵ² k² dk of the unit disc, ŵ = 8J₂(k)/k²
DISC = (2048.0 / (315.0 * np.pi), 8.0 / 3.0, 256.0 / (15.0 * np.pi))
BALL = 10.0 / 7.0  # ⟨⟨1/r⟩⟩ of the unit ball


def ball_compliance(nu: float) -> float:
    """Return the displacement of the unit ball in full space along a unit force on it, E = 1.

    Kelvin's solution at wave vector k is (I − kkᵀ/2(1−ν)k²)/μk², with ⟨k_i k_j⟩ = k²δ_ij/3.
    """
    mu = 1.0 / (2.0 * (1.0 + nu))
    return float(BALL / (4.0 * np.pi * mu) * (1.0 - 1.0 / (6.0 * (1.0 - nu))))


@lru_cache(maxsize=64)
def disc_compliance(nu: float) -> Array:
    """Return the compliance of averages over the unit disc, E = 1, shape `(12, 12)`.

    The disc is on the half-space z < 0. Slopes along z are not averaged and are zero.
    """
    G = surface_green(nu)
    R = np.zeros((3, 3, 3, 3), complex)  # averages (value, slope along k, slope along z) × component, twice
    for m, (row, column) in ((0, (0, 0)), (1, (0, 1)), (1, (1, 0)), (2, (1, 1))):
        R[row, :, column] = (1j) ** row * (-1j) ** column * DISC[m] * G
    return around(R.reshape(9, 9))


@lru_cache(maxsize=64)
def half_ball_compliance(nu: float) -> Array:
    """Return the compliance of values on a unit disc and slopes below it, shape `(12, 12)`.

    The slopes are averaged over the half ball. The footprint is on the half-space, E = 1.
    """
    k, dk = panels(LARGEST, 32, 12)
    R = np.einsum("k,kab->ab", k * dk, depth_answers(k, nu))
    R[:3, :3] = DISC[0] * surface_green(nu)
    return around(R)


def surface_green(nu: float) -> NDArray[np.complex128]:
    """Return k times the surface displacement under a unit traction, E = 1, `(3, 3)`.

    The traction has the wave number k. The frame is (along k, across k, z).
    """
    skew = 0.5j * (1.0 - 2.0 * nu)
    green = np.array([[1.0 - nu, 0.0, -skew], [0.0, 1.0, 0.0], [skew, 0.0, 1.0 - nu]], dtype=np.complex128)
    return 2.0 * (1.0 + nu) * green


def around(R: NDArray[np.complex128]) -> Array:
    """Return (1/4π²) ∫ dθ of responses `(9, 9)`, as compliance `(12, 12)`.

    The responses are in the frame of k. The compliance is of the twelve averages.
    """
    C = np.zeros((TWELVE, TWELVE))
    for theta in 2.0 * np.pi * np.arange(ANGLES) / ANGLES:
        along = np.array([np.cos(theta), np.sin(theta), 0.0])
        axes = np.column_stack([along, [-along[1], along[0], 0.0], [0.0, 0.0, 1.0]])
        Q = np.zeros((TWELVE, 9))
        Q[:3, :3] = axes
        Q[3:, 3:6] = np.einsum("ia,j->ija", axes, along).reshape(9, 3)
        Q[3:, 6:] = np.einsum("ia,j->ija", axes, axes[:, 2]).reshape(9, 3)
        C += (Q @ R @ Q.T).real
    return C / (2.0 * np.pi * ANGLES)


def depth_answers(k: Array, nu: float) -> NDArray[np.complex128]:
    """Return responses of the half-space to disc and half ball, E = 1, shape `(k, 9, 9)`.

    They are at wave numbers `k`. They are values, slopes along k and slopes along z, each along k,
    across k and along z. With u = (−iU, V, W)(z) e^{ikx} the energy is ½∫ λ(kU+W')² + 2μ(k²U²+W'²)
    + μ(U'−kW)² + μ(V'²+k²V²) dz. It is minimised over polynomials on intervals of the depth of the
    ball, graded toward the surface. The half-space below holds them by its own stiffness.
    """
    mu, lam = 1.0 / (2.0 * (1.0 + nu)), nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    z, dz, N, D = line_elements(np.array([-1.0, -0.75, -0.5, -0.3, -0.18, -0.1, -0.05, -0.025, -0.01, -0.003, 0.0]), 5)
    A, B, C = ((X * dz[:, None]).T @ Y for X, Y in ((N, N), (D, D), (N, D)))
    n, kk = A.shape[0], k[:, None, None]
    K = np.zeros((k.size, 3, n, 3, n))
    K[:, 0, :, 0] = (lam + 2.0 * mu) * kk**2 * A + mu * B
    K[:, 2, :, 2] = (lam + 2.0 * mu) * B + mu * kk**2 * A
    K[:, 0, :, 2] = kk * (lam * C - mu * C.T)
    K[:, 2, :, 0] = kk * (lam * C.T - mu * C)
    K[:, 1, :, 1] = mu * (B + kk**2 * A)
    below = np.array([[1.0 - nu, 0.0, 0.5 - nu], [0.0, 1.0, 0.0], [0.5 - nu, 0.0, 1.0 - nu]]) / mu
    K[:, :, 0, :, 0] += kk * np.linalg.inv(below)
    rho, kr = np.sqrt(1.0 - z**2), k[:, None] * np.sqrt(1.0 - z**2)
    disc, ball = 8.0 * jv(2, k) / k**2, 15.0 * rho**2 * jv(2, kr) / k[:, None] ** 2
    phase, surface = np.diag([-1j, 1.0, 1.0]), np.eye(n)[-1]
    loads = [disc[:, None] * surface, 1j * k[:, None] * ((ball * dz) @ N), (ball * dz) @ D]
    F = np.stack([np.einsum("ab,kn->kabn", phase, load) for load in loads], axis=1).reshape(k.size, 9, 3 * n)
    parts = np.concatenate([F.real, -F.imag], axis=1).swapaxes(1, 2)  # complex columns take four times longer
    u = np.linalg.solve(K.reshape(k.size, 3 * n, 3 * n), parts)
    return np.asarray(F @ (u[..., :9] + 1j * u[..., 9:]))


def line_elements(breaks: Array, degree: int) -> tuple[Array, Array, Array, Array]:
    """Return quadrature points and weights on a line, with polynomials and their slopes.

    The piecewise polynomials and slopes are given at these points.
    """
    x, dx = np.polynomial.legendre.leggauss(degree + 6)
    nodes = -np.cos(np.pi * np.arange(degree + 1) / degree)
    shapes = np.linalg.inv(np.polynomial.polynomial.polyvander(nodes, degree))
    value = np.polynomial.polynomial.polyvander(x, degree) @ shapes
    slope = np.polynomial.polynomial.polyvander(x, degree - 1) @ (np.arange(1, degree + 1)[:, None] * shapes[1:])
    m, h = len(breaks) - 1, np.diff(breaks)
    N, D = np.zeros((2, m, x.size, m * degree + 1))
    for e in range(m):
        own = slice(e * degree, (e + 1) * degree + 1)
        N[e, :, own], D[e, :, own] = value, 2.0 / h[e] * slope
    z = breaks[:-1, None] + 0.5 * h[:, None] * (x + 1.0)
    return z.ravel(), (0.5 * h[:, None] * dx).ravel(), N.reshape(z.size, -1), D.reshape(z.size, -1)


def panels(end: float, count: int, points: int) -> tuple[Array, Array]:
    """Return the composite Gauss rule on [0, end]."""
    x, dx = np.polynomial.legendre.leggauss(points)
    width = end / count
    return (width * (np.arange(count)[:, None] + 0.5 * (x + 1.0))).ravel(), np.tile(0.5 * width * dx, count)


def kelvin(offset: Array, nu: float) -> Array:
    """Return displacement i of full space under a unit force j, E = 1, shape `(…, 3, 3)`.

    The force is at distance `offset` `(…, 3)`.
    """
    r = np.linalg.norm(offset, axis=-1)[..., None, None]
    pair = offset[..., :, None] * offset[..., None, :]
    return np.asarray((1.0 + nu) / (8.0 * np.pi * (1.0 - nu)) * ((3.0 - 4.0 * nu) * np.eye(3) + pair / r**2) / r)


def surface_force(offset: Array, nu: float) -> Array:
    """Return displacement i of the half-space z < 0 under a unit force j, E = 1.

    The force is on the surface at distance `offset` `(…, 3)`. Boussinesq's and Cerruti's solutions
    (Johnson, Contact Mechanics, 3.18 and 3.75). Points above the surface are moved to the surface.
    """
    x, y, depth = offset[..., 0], offset[..., 1], np.maximum(-offset[..., 2], 0.0)
    size = (1.0 + nu) / (2.0 * np.pi)
    rho = np.sqrt(x**2 + y**2 + depth**2)
    one, b = size / rho, 1.0 / (rho + depth)  # 1/ρ and, below, 1/ρ³, both multiplied by `size`
    cube, k = one / rho**2, (1.0 - 2.0 * nu) * b
    both, pull, push = cube - k * b * one, depth * cube, k * one
    u = np.empty((3, 3, *rho.shape))  # one component at a time, which halves the time
    for j, (s, t) in enumerate(((x, y), (y, x))):
        u[j, j] = one + s * s * both + size * k
        u[1 - j, j] = s * t * both
        u[2, j] = -s * (pull + push)
        u[j, 2] = -s * (pull - push)
    u[2, 2] = depth * pull + 2.0 * (1.0 - nu) * one
    return np.moveaxis(u, (0, 1), (-2, -1))
