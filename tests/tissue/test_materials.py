"""Strain-energy densities: their derivatives by slope, and stress in closed form."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import tensortrax.math as tm

import tissue
from tests.bounds import IDENTITY, RESIDUAL, SEPARATED, SLOPE
from tissue.arrays import Array
from tissue.materials.density import Density, Sum, determinant
from tissue.materials.fibres import Fibres
from tissue.materials.isotropic import Exponential, Volumetric
from tissue.materials.own import Own
from tissue.materials.prestretch import Prestretched

MU, KAPPA, B, K1, K2 = 2.0e4, 3.0e5, 2.0, 1.5e4, 3.0
ALPHA = 6.0  # exponent of Ogden's solid
STRETCHES = np.array([1.05, 1.0, 0.952])


def isotropic(b: float) -> Sum:
    return Sum([Exponential(MU, b), Volumetric(KAPPA)])


def mooney_rivlin(F: Any) -> Any:
    C = F.T @ F
    I1, J = tm.trace(C), tm.linalg.det(F)
    I2 = 0.5 * (I1 * I1 - tm.trace(C @ C))
    return 3e3 * (I1 * J ** (-2 / 3) - 3.0) + 1e3 * (I2 * J ** (-4 / 3) - 3.0) + 1e5 * tm.log(J) ** 2 / tm.sqrt(I1)


def ogden(F: Any) -> Any:
    squares, J = tm.linalg.eigvalsh(F.T @ F), tm.linalg.det(F)
    return 2.0 * MU / ALPHA**2 * (tm.sum(squares ** (ALPHA / 2)) * J ** (-ALPHA / 3) - 3.0)


DENSITIES: dict[str, Density] = {
    "neo-Hookean": isotropic(0.0),
    "exponential": isotropic(B),
    "fibres": Fibres([1.0, 0.2, 0.1], K1, K2),
    "prestretch": Prestretched(Sum([isotropic(B), Fibres([1.0, 0.0, 0.0], K1, K2)]), STRETCHES),
    "own": Own(mooney_rivlin),
    "ogden": Own(ogden),
}


def deformations(size: float, count: int = 5) -> Array:
    """Random deformation gradients about one that stretches along x, shape `(3, 3, count)`."""
    random = np.random.default_rng(4).standard_normal((3, 3, count))
    return np.asarray(np.diag([1.3, 0.9, 0.95])[:, :, None] + size * random)


@pytest.mark.parametrize("name", DENSITIES)
def test_stress_and_tangent_are_the_derivatives_of_the_energy(name: str) -> None:
    """Independent check: the error of a central difference falls by 100 when its step falls by 10."""
    density, F = DENSITIES[name], deformations(0.1)
    dF = np.random.default_rng(5).standard_normal(F.shape)
    P = np.einsum("ij...,ij...->...", density.stress(F), dF)
    A = np.einsum("ijkl...,kl...->ij...", density.tangent(F), dF)
    for of, exact in ((density.energy, P), (density.stress, A)):
        errors = [np.abs((of(F + h * dF) - of(F - h * dF)) / (2 * h) - exact).max() for h in (1e-2, 1e-3)]
        assert abs(np.log10(errors[0] / errors[1]) - 2.0) < SLOPE
    tangent = density.tangent(F)
    assert np.abs(tangent - np.moveaxis(tangent, (0, 1), (2, 3))).max() <= IDENTITY * np.abs(tangent).max()


def cauchy(density: Density, F: Array) -> Array:
    """σ = P Fᵀ / J of one deformation gradient `(3, 3)`."""
    return np.asarray(density.stress(F[:, :, None])[:, :, 0] @ F.T / np.linalg.det(F))


def close(got: float, exact: float, scale: float) -> bool:
    return abs(got - exact) <= RESIDUAL * scale


@pytest.mark.parametrize("b", [0.0, B])
@pytest.mark.parametrize(
    ("stretches", "difference"),
    [(lambda x: (x, x**-0.5, x**-0.5), lambda x: x**2 - 1 / x), (lambda x: (x, x, x**-2), lambda x: x**2 - x**-4)],
    ids=["uniaxial", "equibiaxial"],
)
def test_stretches_without_change_of_volume(
    b: float, stretches: Callable[[float], tuple[float, ...]], difference: Callable[[float], float]
) -> None:
    """Independent check: σ₁ − σ₃ = μ exp(b (I₁ − 3)) (λ₁² − λ₃²)."""
    for x in (0.7, 1.0, 1.6):
        F = np.diag(stretches(x))
        exact = MU * np.exp(b * (np.sum(F**2) - 3.0)) * difference(x)
        sigma = cauchy(isotropic(b), F)
        assert close(sigma[0, 0] - sigma[2, 2], exact, MU + abs(exact))
        assert close(sigma[0, 1], 0.0, MU)


@pytest.mark.parametrize("b", [0.0, B])
def test_simple_shear(b: float) -> None:
    """Independent check: σ₁₂ = μ exp(b γ²) γ and the normal stress difference γ σ₁₂ (Rivlin)."""
    F = np.eye(3)
    F[0, 1] = gamma = 0.8
    sigma, exact = cauchy(isotropic(b), F), MU * np.exp(b * gamma**2) * gamma
    assert close(sigma[0, 1], exact, exact)
    assert close(sigma[0, 0] - sigma[1, 1], gamma * exact, exact)


def test_a_change_of_volume_alone() -> None:
    """Independent check: σ = κ (J − 1) I, whatever the stiffening."""
    sigma = cauchy(isotropic(B), 1.2 * np.eye(3))
    assert np.abs(sigma - KAPPA * (1.2**3 - 1.0) * np.eye(3)).max() <= RESIDUAL * KAPPA


def test_fibres_carry_tension_alone() -> None:
    """Independent check: σ₁ − σ₃ = 2 k₁ (λ² − 1) exp(k₂ (λ² − 1)²) λ² along stretched fibres, nothing when they are
    pushed together, and the same in a frame turned by 90°."""
    family = Fibres([2.0, 0.0, 0.0], K1, K2)
    x, F = 1.2**2 - 1.0, np.diag([1.2, 1.2**-0.5, 1.2**-0.5])
    exact = 2.0 * K1 * x * np.exp(K2 * x**2) * 1.2**2
    sigma = cauchy(family, F)
    assert close(sigma[0, 0] - sigma[2, 2], exact, exact)
    assert not cauchy(family, np.diag([0.8, 0.8**-0.5, 0.8**-0.5])).any()
    turned = Fibres([0.0, 3.0, 0.0], K1, K2)
    assert close(cauchy(turned, F[[2, 0, 1]][:, [2, 0, 1]])[1, 1], sigma[0, 0], exact)


def test_where_no_fibres_are_none_stiffen() -> None:
    """Independent check: a stretch at which the others' energy is beyond all numbers."""
    F = np.diag([1.6, 1.0, 1.0])
    there, none = Fibres([1.0, 0.0, 0.0], K1, 2e3), Fibres([1.0, 0.0, 0.0], 0.0, 2e3)
    assert there.energy(F) == np.inf
    assert none.energy(F) == 0.0 and not none.stress(F).any() and not none.tangent(F).any()


def test_prestretch_is_a_stretch_that_is_there_already() -> None:
    """Independent check: in the reference shape σ₁ − σ₃ = μ J₀^(−5/3) exp(b (Ī₁ − 3)) (λ₁² − λ₃²), J₀ = det F₀."""
    sigma = cauchy(Prestretched(isotropic(B), STRETCHES), np.eye(3))
    J0, squares = np.prod(STRETCHES), STRETCHES**2
    grown = MU * J0 ** (-5.0 / 3.0) * np.exp(B * (J0 ** (-2.0 / 3.0) * squares.sum() - 3.0))
    assert close(sigma[0, 0] - sigma[2, 2], grown * (squares[0] - squares[2]), MU)


@pytest.mark.parametrize("name", ["exponential", "prestretch", "own"])
def test_a_rotation_stores_nothing_and_turns_the_stress(name: str) -> None:
    """Independent check: under a rotation by 90° W stays and P turns with it."""
    density, F = DENSITIES[name], deformations(0.1)
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = np.einsum("ij,jk...->ik...", R, F)
    W, P = density.energy(F), density.stress(F)
    assert np.abs(density.energy(turned) - W).max() <= IDENTITY * np.abs(W).max()
    assert np.abs(density.stress(turned) - np.einsum("ij,jk...->ik...", R, P)).max() <= IDENTITY * np.abs(P).max()
    rigid = isotropic(B).energy(R[:, :, None])
    assert np.abs(rigid).max() <= IDENTITY * MU


def test_ones_own_density_is_as_exact_as_ours() -> None:
    """Independent check: the neo-Hookean solid written as a function, its stress and tangent against the formulas."""
    J = tm.linalg.det
    own = Own(lambda F: 0.5 * MU * (tm.trace(F.T @ F) * J(F) ** (-2 / 3) - 3.0) + 0.5 * KAPPA * (J(F) - 1.0) ** 2)
    F, ours = deformations(0.1, 7).reshape(3, 3, 7, 1), isotropic(0.0)
    for got, exact in ((own.stress(F), ours.stress(F)), (own.tangent(F), ours.tangent(F))):
        assert got.shape == exact.shape
        assert np.abs(got - exact).max() <= IDENTITY * np.abs(exact).max()
    assert np.abs(own.energy(F) - ours.energy(F)).max() <= IDENTITY * KAPPA


def test_a_density_of_principal_stretches() -> None:
    """Independent check: Ogden's σ₁ − σ₃ = 2μ/α (λ₁^α − λ₃^α) at constant volume, also where stretches are equal; at
    rest no stress and the tangent of a neo-Hookean solid."""
    density = Own(ogden)
    for x in (0.7, 1.6):
        sigma, exact = cauchy(density, np.diag([x, x**-0.5, x**-0.5])), 2 * MU / ALPHA * (x**ALPHA - x ** (-ALPHA / 2))
        assert abs(sigma[0, 0] - sigma[2, 2] - exact) <= SEPARATED * abs(exact)
    rest = np.eye(3)[:, :, None]
    assert np.abs(density.stress(rest)).max() <= SEPARATED * MU
    A, ours = density.tangent(rest), Exponential(MU, 0.0).tangent(rest)
    assert np.abs(A - ours).max() <= SEPARATED * MU


def test_small_strain_is_hookes_law() -> None:
    """Independent check: A at F = I is λ I ⊗ I + 2μ I_sym for every b, and its J is 1."""
    I3 = np.eye(3)
    lam = KAPPA - 2.0 * MU / 3.0
    hooke = lam * np.einsum("ij,kl->ijkl", I3, I3) + MU * (
        np.einsum("ik,jl->ijkl", I3, I3) + np.einsum("il,jk->ijkl", I3, I3)
    )
    for b in (0.0, B):
        A = isotropic(b).tangent(I3[:, :, None])[..., 0]
        assert np.abs(A - hooke).max() <= IDENTITY * KAPPA
    assert determinant(I3[:, :, None])[0] == 1.0


@pytest.mark.parametrize(
    "make",
    [
        lambda: Exponential(-1.0, 1.0),
        lambda: Exponential(1.0, -1.0),
        lambda: Fibres([0.0, 0.0, 0.0], 1.0, 1.0),
        lambda: Fibres([1.0, 0.0, 0.0], -1.0, 1.0),
        lambda: Fibres([1.0, 0.0, 0.0], 1.0, 0.0),
        lambda: Prestretched(isotropic(0.0), np.array([1.0, 0.0, 1.0])),
        lambda: Own(lambda F: 1.0).energy(np.eye(3)[:, :, None]),
        lambda: Own(lambda F: F @ F).energy(np.eye(3)[:, :, None]),
        lambda: Own(lambda F: np.exp(F[0, 0])).energy(np.eye(3)[:, :, None]),
    ],
)
def test_what_cannot_be_is_refused_in_words(make: Callable[[], Any]) -> None:
    with pytest.raises(tissue.TissueError, match="allowed"):
        make()
