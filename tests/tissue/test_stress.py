"""Stress at the nodes against fields whose stress is known."""

import numpy as np
import pytest
from skfem import MeshTet

import tissue
from tests.bounds import IDENTITY


def body_of(element: str) -> tissue.Elasticity:
    mesh = MeshTet.init_tensor(*(np.linspace(-0.02, 0.02, n) for n in (4, 5, 4)))
    return tissue.elasticity(mesh, tissue.Material(1.0e5, 0.3, 1000.0), element)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_uniform_strain_gives_hookes_stress_in_vtk_order(element: str) -> None:
    body = body_of(element)
    gradient = np.random.default_rng(0).standard_normal((3, 3))
    strain = 0.5 * (gradient + gradient.T)
    lam, mu = 1.0e5 * 0.3 / (1.3 * 0.4), 1.0e5 / 2.6
    tensor = lam * np.trace(strain) * np.eye(3) + 2.0 * mu * strain
    expected = [tensor[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))]
    stress = tissue.stress_recovery(body).stress(body.flat(body.points @ gradient.T))
    assert stress.shape == (len(body.points), 6)
    assert np.abs(stress - expected).max() <= 1e-12 * np.abs(tensor).max()
    deviator = tensor - np.trace(tensor) / 3.0 * np.eye(3)
    assert tissue.von_mises(stress) == pytest.approx(
        np.full(len(stress), np.sqrt(1.5 * np.sum(deviator**2))), rel=1e-11
    )


def test_pure_bending_stress_is_exact_in_p2() -> None:
    """σ_xx = Eκz and nothing else: the von Mises stress is its absolute value."""
    body, kappa, nu = body_of("P2"), 2.0, 0.3
    x, y, z = body.points.T
    field = kappa * np.column_stack([x * z, -nu * y * z, -0.5 * (x**2 + nu * (z**2 - y**2))])
    stress = tissue.stress_recovery(body).stress(body.flat(field))
    exact = np.zeros_like(stress)
    exact[:, 0] = 1.0e5 * kappa * z
    assert np.abs(stress - exact).max() <= 1e-11 * np.abs(exact).max()
    assert np.abs(tissue.von_mises(stress) - np.abs(exact[:, 0])).max() <= 1e-11 * np.abs(exact).max()


def test_stiff_cells_carry_more_stress_under_one_strain() -> None:
    mesh = body_of("P1").mesh
    stiff = mesh.p[0, mesh.t].mean(axis=0) > 0.0067
    body = tissue.elasticity(mesh, tissue.Material(np.where(stiff, 3.0e5, 1.0e5), 0.3, 1000.0))
    stress = tissue.stress_recovery(body).stress(body.flat(body.points * [1.0, -0.3, -0.3]))
    right, left = body.points[:, 0] > 0.019, body.points[:, 0] < 0.0
    assert stress[right, 0] == pytest.approx(np.full(right.sum(), 3.0e5), rel=1e-11)
    assert stress[left, 0] == pytest.approx(np.full(left.sum(), 1.0e5), rel=1e-11)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_interpolation_is_exact_for_the_elements_own_fields(element: str) -> None:
    """A linear field, and with P2 a quadratic one; a point outside is refused."""
    body = body_of(element)
    low, high = body.points.min(axis=0), body.points.max(axis=0)
    points = low + (high - low) * np.random.default_rng(1).random((20, 3))

    def field(x: np.ndarray) -> np.ndarray:
        linear = x @ [1.0, -2.0, 0.5] + 0.1
        return linear if element == "P1" else linear * (x @ [0.3, 1.0, 2.0])

    got = tissue.interpolation(body, points) @ field(body.points)
    assert np.abs(got - field(points)).max() <= 1e-12 * np.abs(field(body.points)).max()
    with pytest.raises(tissue.TissueError, match="outside the organ"):
        tissue.interpolation(body, high[None] + 1.0)


def test_principal_stresses_and_directions_make_the_stress_again() -> None:
    """Independent check: values fall, directions are unit vectors, and Σ σ n nᵀ is the stress."""
    stress = np.random.default_rng(3).standard_normal((20, 6)) * 1e4
    values, directions = tissue.principal(stress)
    assert np.all(np.diff(values, axis=1) <= 0.0)
    again = np.einsum("mk,mki,mkj->mij", values, directions, directions)
    found = np.stack([again[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))], axis=1)
    assert np.abs(found - stress).max() <= 1e-12 * np.abs(stress).max()


@pytest.mark.parametrize(
    "values", [(1, 1, 0), (1, 0, 0), (2, 2, 2), (0, 0, 0), (1, 1, -1), (1, 1 + 1e-9, -1), (1, 1e-12, 0)]
)
def test_principal_stresses_that_meet_have_directions_across_one_another(values: tuple[float, float, float]) -> None:
    """Independent check: of tensors with two or three principal values that are equal, or nearly so, along axes turned
    at random and along x, y and z, the values are found to round-off, and Σ σ n nᵀ is the tensor."""
    turned = np.linalg.qr(np.random.default_rng(4).standard_normal((50, 3, 3)))[0]
    axes = np.concatenate([turned, np.eye(3)[[[0, 1, 2], [1, 2, 0], [2, 0, 1]]]])
    tensor = axes @ np.diag(values) @ axes.swapaxes(1, 2)
    stress = np.stack([tensor[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))], axis=1)
    found, directions = tissue.principal(stress)
    assert np.abs(found - np.sort(values)[::-1]).max() <= IDENTITY
    assert np.abs(np.einsum("mk,mki,mkj->mij", found, directions, directions) - tensor).max() <= IDENTITY
    assert np.abs(directions @ directions.swapaxes(1, 2) - np.eye(3)).max() <= IDENTITY
