"""An elastic layer bonded to a rigid base: how far a footprint on it moves, by Hankel transform; and its mesh."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import jv
from skfem import MeshTet

import tissue
from tissue.sites import footprint

Array = NDArray[np.float64]
HALF_SPACE = {"uniform": 16.0 / (3.0 * np.pi), "parabolic": 2048.0 / (315.0 * np.pi)}  # a ∫ŵ² dk


def layer_compliance(weight: str, a: float, h: float, E: float, nu: float) -> tuple[float, float]:
    """Normal and tangential compliance [m/N] of a footprint of radius `a` on a layer of thickness `h`.

    Load and mean displacement have the same weight, so C_zz = ∫ c_n ŵ² k dk / 2π, C_xx = ∫ ½(c_l + c_t) ŵ² k dk / 2π
    with the layer's answers at wave number k to a traction along its normal (c_n), along k (c_l) and across k (c_t).
    For k → ∞ they are those of the half-space, (1 − ν)/μk, (1 − ν)/μk and 1/μk, whose integrals are closed forms in
    ∫ŵ² dk; what is left decays like exp(−2kh).
    """
    x, dx = np.polynomial.legendre.leggauss(200)
    k, dk, mu = 15.0 * (x + 1.0) / h, 15.0 * dx / h, E / (2.0 * (1.0 + nu))
    w_hat = 2.0 * jv(1, k * a) / (k * a) if weight == "uniform" else 8.0 * jv(2, k * a) / (k * a) ** 2
    normal, along, across = layer_answers(k, h, mu, nu)
    density, S = w_hat**2 * k * dk / (2.0 * np.pi), HALF_SPACE[weight] / a
    C_zz = (1.0 - nu**2) * S / (np.pi * E) + density @ (normal - (1.0 - nu) / (mu * k))
    C_xx = (1.0 + nu) * (2.0 - nu) * S / (2.0 * np.pi * E) + density @ (along + across - (2.0 - nu) / (mu * k)) / 2.0
    return float(C_zz), float(C_xx)


def layer_answers(k: Array, h: float, mu: float, nu: float) -> tuple[Array, Array, Array]:
    """c_n, c_l, c_t [m/Pa] of the layer −h < z < 0 at wave numbers k [1/m].

    u_x = U(z) sin kx, u_z = W(z) cos kx solve Navier's equations for (U, W) = e^{kz}(1, −1), e^{kz}(z, c − z) and
    e^{−kz}(1, 1), e^{−kz}(z, c + z) with c = (3 − 4ν)/k: the first of each pair is harmonic and without dilatation,
    and μ(U'' − k²U) = (λ + μ)k(kU + W') gives c. Their sum has U = W = 0 at z = −h and σ_xz = μ(U' − kW),
    σ_zz = (λ + 2μ)W' + λkU at z = 0. Across k there is u_y = V(z) cos kx alone: V = sinh k(z + h), tanh(kh)/μk.
    """
    c, lam = (3.0 - 4.0 * nu) / k, 2.0 * mu * nu / (1.0 - 2.0 * nu)

    def solutions(z: float) -> tuple[Array, Array, Array, Array]:
        up, down = np.exp(k * z), np.exp(-k * (z + h))
        U = np.stack([up, z * up, down, z * down])
        W = np.stack([-up, (c - z) * up, down, (c + z) * down])
        slope_U = np.stack([k * up, (1.0 + k * z) * up, -k * down, (1.0 - k * z) * down])
        slope_W = np.stack([-k * up, (k * (c - z) - 1.0) * up, -k * down, (1.0 - k * (c + z)) * down])
        return U, W, slope_U, slope_W

    U, W, slope_U, slope_W = solutions(0.0)
    base_U, base_W, _, _ = solutions(-h)
    rows = np.stack([(lam + 2.0 * mu) * slope_W + lam * k * U, mu * (slope_U - k * W), base_U, base_W])
    share = np.linalg.solve(np.moveaxis(rows, -1, 0), np.broadcast_to(np.eye(4)[:, :2], (k.size, 4, 2)))
    return np.einsum("ik,ki->k", W, share[..., 0]), np.einsum("ik,ki->k", U, share[..., 1]), np.tanh(k * h) / (mu * k)


def quarter_layer(a: float, h: float, cells: int, growth: float, wide: float) -> MeshTet:
    """A quarter 0 < x, y < wide·h of the layer −h < z < 0, `cells` to the radius `a`, then growing."""
    across, down = graded(a, wide * h, a / cells, growth), graded(a, h, a / cells, growth)
    return MeshTet.init_tensor(across, across, -down[::-1]).with_boundaries({"base": lambda x: x[2] < 1e-9 - h})


def graded(inner: float, outer: float, spacing: float, growth: float) -> Array:
    """0 … outer, even up to `inner`, then growing."""
    line, step = list(np.arange(0.0, inner + 1e-9 * outer, spacing)), spacing
    while line[-1] < (1.0 - 1e-9) * outer:
        step *= growth
        line.append(line[-1] + step)
    stretched = np.array(line)
    beyond = stretched > inner + 1e-9 * outer
    stretched[beyond] = inner + (stretched[beyond] - inner) * (outer - inner) / (stretched[-1] - inner)
    return stretched


def footprint_compliance(body: tissue.Elasticity, a: float, weight: str, axis: int) -> float:
    """Compliance [m/N] of the whole disc on a `quarter_layer`, load along z (`axis` 2) or x (0), by symmetry."""
    x, component = body.basis.doflocs, np.empty(body.N, int)
    component[body.nodes] = np.arange(3)
    tiny = 1e-9 * a
    held = (x[1] < tiny) & (component == 1)
    held |= (x[0] < tiny) & ((component == 0) if axis == 2 else (component != 0))
    held[body.clamped] = True
    free, rule = np.flatnonzero(~held), footprint.disc(weight)
    quarter = (rule.points[:, 0] > 0.0) & (rule.points[:, 1] > 0.0)
    places = a * rule.points[quarter].T - np.array([[0.0], [0.0], [1e-3 * tiny]])
    probe = body.basis.with_element(body.basis.elem.elem).probes(places)
    load = np.zeros(body.N)
    load[body.nodes[:, axis]] = probe.T @ rule.weights[quarter]
    factor = tissue.factorize(body.K[free][:, free], x[:, free].T)
    return float(4.0 * load[free] @ factor.solve(load[free]))
