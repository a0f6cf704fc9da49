"""Elastic layers bonded to a rigid base: how far a footprint on them moves, by Hankel transform; and their mesh."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import jv
from skfem import MeshTet

import tissue
from studies import unbounded
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


def stack_compliance(a: float, heights: list[float], moduli: list[float], nu: float) -> Array:
    """Compliance `(6,)` of a parabolic footprint of radius `a` on layers, from the top, on a rigid base [m/N, 1/(N m)].

    To forces along x, y, z and to the couples of ⟨∂u/∂x⟩. With u_x, u_y of a traction at angle θ to k the averages over
    θ are ½(c_l + c_t) for forces and ⅜c_l + ⅛c_t, ⅛c_l + ⅜c_t, ½c_n times k² for couples. What the top layer's
    half-space has is taken off under the integral and put back in closed form.
    """
    x, dx = np.polynomial.legendre.leggauss(400)
    ends = np.array([0.0, 0.5, 2.0, 8.0, max(40.0 * a / heights[0], 9.0)]) / a
    k = (ends[:-1, None] + np.diff(ends)[:, None] * (x + 1.0) / 2.0).ravel()
    dk, mu = (np.diff(ends)[:, None] * dx / 2.0).ravel(), np.array(moduli) / (2.0 * (1.0 + nu))
    normal, along, across = stack_answers(k, heights, mu, nu)
    normal, along, across = (
        normal - (1.0 - nu) / (mu[0] * k),
        along - (1.0 - nu) / (mu[0] * k),
        across - 1.0 / (mu[0] * k),
    )
    force = (8.0 * jv(2, k * a) / (k * a) ** 2) ** 2 * k * dk / (2.0 * np.pi)
    couple = force * k**2
    more = [force @ (along + across) / 2.0, force @ (along + across) / 2.0, force @ normal]
    more += [couple @ (3.0 * along + across) / 8.0, couple @ (along + 3.0 * across) / 8.0, couple @ normal / 2.0]
    closed = np.diag(unbounded.disc_compliance(nu))[[0, 1, 2, 3, 6, 9]]
    return closed * np.repeat([a**-1.0, a**-3.0], 3) / moduli[0] + np.array(more)


def stack_answers(k: Array, heights: list[float], mu: Array, nu: float) -> tuple[Array, Array, Array]:
    """c_n, c_l, c_t of `layer_answers` for layers from the top, each with the four solutions written there about its
    own faces; displacement and traction go on from layer to layer. Across k it is the addition theorem of tanh."""
    levels, n = -np.concatenate([[0.0], np.cumsum(heights)]), 4 * len(heights)
    c = (3.0 - 4.0 * nu) / k

    def state(layer: int, z: float) -> Array:
        up, down = np.exp(k * (z - levels[layer])), np.exp(-k * (z - levels[layer + 1]))
        above, below = z - levels[layer], z - levels[layer + 1]
        U = np.stack([up, above * up, down, below * down])
        W = np.stack([-up, (c - above) * up, down, (c + below) * down])
        slope_U = np.stack([k * up, (1.0 + k * above) * up, -k * down, (1.0 - k * below) * down])
        slope_W = np.stack([-k * up, (k * (c - above) - 1.0) * up, -k * down, (1.0 - k * (c + below)) * down])
        ratio, lam = mu[layer] / mu[0], 2.0 * nu / (1.0 - 2.0 * nu)
        traction = [ratio * ((lam + 2.0) * slope_W + lam * k * U), ratio * (slope_U - k * W)]
        return np.moveaxis(np.stack([U, W, *traction]), -1, 0)

    A, load = np.zeros((k.size, n, n)), np.zeros((n, 2))
    A[:, :2, :4], load[:2] = state(0, 0.0)[:, 2:], np.eye(2) / mu[0]
    for layer in range(len(heights) - 1):
        rows, level = slice(4 * layer + 2, 4 * layer + 6), levels[layer + 1]
        A[:, rows, 4 * layer : 4 * layer + 4] = state(layer, level)
        A[:, rows, 4 * layer + 4 : 4 * layer + 8] = -state(layer + 1, level)
    A[:, -2:, -4:] = state(len(heights) - 1, levels[-1])[:, :2]
    share, top = np.linalg.solve(A, np.broadcast_to(load, (k.size, n, 2)))[:, :4], state(0, 0.0)
    across = np.zeros(k.size)
    for height, modulus in zip(heights[::-1], mu[::-1], strict=True):
        own = np.tanh(k * height) / (modulus * k)
        across = (across + own) / (1.0 + across * own * (modulus * k) ** 2)
    return np.einsum("ki,ki->k", top[:, 1], share[..., 0]), np.einsum("ki,ki->k", top[:, 0], share[..., 1]), across


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
