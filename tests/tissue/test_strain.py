"""Strain and rotation of cells against fields that have known ones."""

import numpy as np
import pytest
from skfem import ElementTetP1, MeshTet
from skfem.quadrature import get_quadrature

import tissue
from tests.bounds import IDENTITY, LODE, TWO_SOLVERS
from tissue.materials.density import determinant
from tissue.strain import PAIRS, extreme_values


def body_of(element: str, nu: float = 0.3) -> tissue.Elasticity:
    mesh = MeshTet.init_tensor(*(np.linspace(-0.02, 0.02, n) for n in (3, 4, 3)))
    return tissue.elasticity(mesh, tissue.Material(1.0e5, nu, 1000.0), element)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_uniform_gradient_is_strain_and_rotation_everywhere(element: str) -> None:
    """Independent check: principal strains 0.1, −0.3 and 0.05 along turned axes, and a rotation vector of 0.2 rad."""
    body, axes = body_of(element), np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    w = 0.2 * axes[0]
    spin = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    gradient = axes @ np.diag([0.1, -0.3, 0.05]) @ axes.T + spin
    strain, rotation = tissue.strains(body, body.flat(body.points @ gradient.T))[:2]
    assert strain.shape == rotation.shape == (body.mesh.nelements,)
    assert np.abs(strain / 0.3 - 1.0).max() < IDENTITY
    assert np.abs(rotation / 0.2 - 1.0).max() < IDENTITY


@pytest.mark.parametrize(
    "values", [(3.0, 1.0, -2.0), (1.0, 1.0, -2.0), (2.0, -1.0, -1.0), (4.0, 4.0, 4.0), (0.0, 0.0, 0.0)]
)
def test_extreme_values_by_invariants_are_eigenvalues(values: tuple[float, float, float]) -> None:
    """Independent check: tensors with known principal values along any axes, two of them alike or all, and of any
    size."""
    axes = np.linalg.qr(np.random.default_rng(0).standard_normal((200, 3, 3)))[0]
    for size in (1e-30, 1.0, 1e9):
        tensor = axes * (size * np.array(values)) @ axes.swapaxes(1, 2)
        low, high = extreme_values([tensor[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), *PAIRS)])
        scale = LODE * size * max(map(abs, values))
        assert np.abs(low - size * min(values)).max() <= scale
        assert np.abs(high - size * max(values)).max() <= scale


def test_a_cell_of_p2_has_its_largest_strain_at_a_vertex() -> None:
    """Independent check: u_x = κx²/2 strains a cell by κ|x|, at most that of its farthest vertex."""
    body = body_of("P2")
    x = body.points[:, 0]
    strain, rotation = tissue.strains(body, body.flat(np.column_stack([5.0 * x**2, 0 * x, 0 * x])))[:2]
    farthest = np.abs(body.mesh.p[0, body.mesh.t]).max(axis=0)
    assert np.abs(strain - 10.0 * farthest).max() < IDENTITY * 0.2
    assert rotation.max() < IDENTITY


def test_the_share_of_the_strain_energy_goes_by_stiffness_volume_and_square() -> None:
    """Independent check: cells of a quarter of the volume, four times as stiff and twice as strained as the others."""
    mesh = MeshTet.init_tensor(*(np.linspace(0.0, 0.04, n) for n in (5, 3, 3)))
    stiff = mesh.p[0, mesh.t].mean(axis=0) < 0.01
    body = tissue.elasticity(mesh, tissue.Material(np.where(stiff, 4.0e5, 1.0e5), 0.3, 1000.0))
    strain = np.where(stiff, 0.02, 0.01)
    measure = tissue.energy_measure(body, strain)
    share = measure[stiff].sum() / measure.sum()
    assert abs(share / (16.0 / 19.0) - 1.0) < IDENTITY
    assert tissue.energy_measure(body, np.zeros(mesh.nelements)).sum() == 0.0


@pytest.mark.parametrize(
    ("element", "nu", "dilatation"),
    [(of, nu, "auto") for of in ("P1", "P2") for nu in (0.3, 0.49)] + [("P2", 0.49, "mean")],
)
def test_the_energy_density_adds_up_to_the_energy(element: str, nu: float, dilatation: str) -> None:
    """Independent check: of a field of any shape the sum over cells of density times volume is ½ UᵀKU, where the
    dilatation is averaged too, as it is in one of two materials."""
    mesh = MeshTet.init_tensor(*(np.linspace(-0.02, 0.02, n) for n in (3, 4, 3)))
    poisson = np.where(np.arange(mesh.nelements) % 2 == 0, nu, 0.2)
    body = tissue.elasticity(mesh, tissue.Material(1.0e5, poisson, 1000.0), element, dilatation=dilatation)
    assert (body.pressure is not None) == (nu > 0.45)
    U = np.random.default_rng(1).standard_normal(body.N) * 1e-3
    corners = mesh.p.T[mesh.t.T]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    density = tissue.strains(body, U).energy_density
    assert density @ volume == pytest.approx(0.5 * U @ (body.K @ U), rel=IDENTITY)


def test_a_uniform_strain_has_hookes_energy() -> None:
    """Independent check: W = ½ E ε² in a bar that narrows by ν."""
    body = body_of("P1")
    density = tissue.strains(body, body.flat(body.points * [0.01, -0.003, -0.003])).energy_density
    assert np.abs(density / (0.5e5 * 0.01**2) - 1.0).max() < IDENTITY


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_uniform_deformation_has_its_determinant(element: str) -> None:
    """Independent check: J = det F of a body that is stretched, sheared and turned."""
    body = body_of(element)
    F = np.array([[1.4, 0.3, 0.0], [-0.2, 0.9, 0.1], [0.0, -0.4, 1.1]])
    U = body.flat(body.points @ (F - np.eye(3)).T)
    for J in (tissue.volume_ratio(body, U), tissue.nodal_volume_ratio(body, U)):
        assert np.abs(J / np.linalg.det(F) - 1.0).max() < IDENTITY
    assert tissue.nodal_volume_ratio(body, U).shape == (len(body.points),)


def test_the_volume_ratio_of_a_bent_cell_is_that_of_its_volume() -> None:
    """Independent check: u_k = κ x_k²/2 makes J = Π (1 + κ x_k), whose mean over a cell a rule of degree 8 gives."""
    body = body_of("P2")
    J = tissue.volume_ratio(body, body.flat(10.0 * body.points**2))
    places, weights = get_quadrature(ElementTetP1(), 8)
    x = body.mesh.mapping().F(places)
    assert np.ptp(J) > 0.5
    assert np.abs(J - 6.0 * np.prod(1.0 + 20.0 * x, axis=0) @ weights).max() < IDENTITY


@pytest.mark.parametrize(("element", "nu"), [("P1", 0.3), ("P2", 0.3), ("P2", 0.49)])
def test_the_averaged_volume_ratio_alone_is_that_of_all_measures(element: str, nu: float) -> None:
    """Consistency check: of a field of any shape, to the bit."""
    body = body_of(element, nu)
    U = 1e-3 * np.random.default_rng(2).standard_normal(body.N)
    assert np.array_equal(tissue.strains(body, U).nodal_volume_ratio, tissue.nodal_volume_ratio(body, U))


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_the_averaged_volume_ratio_is_what_the_law_acts_on(element: str) -> None:
    """Consistency check: in tissue of one stiffness the law's pressure at the vertices goes as J − 1 there, with a
    deformation that differs from cell to cell."""
    body = body_of(element, 0.4999)
    rng = np.random.default_rng(0)
    U = body.flat(1e-4 * rng.standard_normal(body.points.shape))
    hyper = tissue.Hyperelasticity(body)
    vertices = body.mesh.nvertices
    J, pressure = tissue.nodal_volume_ratio(body, U)[:vertices], hyper.pressure(determinant(hyper.gradient(U)))
    assert np.abs(J - 1.0).max() > 1e-3
    assert pressure / pressure[0] == pytest.approx((J - 1.0) / (J[0] - 1.0), rel=TWO_SOLVERS)
