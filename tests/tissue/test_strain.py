"""Strain and rotation of cells against fields that have known ones."""

import numpy as np
import pytest
from skfem import MeshTet

import tissue
from tests.bounds import IDENTITY


def body_of(element: str) -> tissue.Elasticity:
    mesh = MeshTet.init_tensor(*(np.linspace(-0.02, 0.02, n) for n in (3, 4, 3)))
    return tissue.elasticity(mesh, tissue.Material(1.0e5, 0.3, 1000.0), element)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_uniform_gradient_is_strain_and_rotation_everywhere(element: str) -> None:
    """Independent check: principal strains 0.1, −0.3 and 0.05 along turned axes, and a rotation vector of 0.2 rad."""
    body, axes = body_of(element), np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    w = 0.2 * axes[0]
    spin = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    gradient = axes @ np.diag([0.1, -0.3, 0.05]) @ axes.T + spin
    strain, rotation = tissue.cell_strain(body, body.flat(body.points @ gradient.T))
    assert strain.shape == rotation.shape == (body.mesh.nelements,)
    assert np.abs(strain / 0.3 - 1.0).max() < IDENTITY
    assert np.abs(rotation / 0.2 - 1.0).max() < IDENTITY


def test_a_cell_of_p2_has_its_largest_strain_at_a_vertex() -> None:
    """Independent check: u_x = κx²/2 strains a cell by κ|x|, at most that of its farthest vertex."""
    body = body_of("P2")
    x = body.points[:, 0]
    strain, rotation = tissue.cell_strain(body, body.flat(np.column_stack([5.0 * x**2, 0 * x, 0 * x])))
    farthest = np.abs(body.mesh.p[0, body.mesh.t]).max(axis=0)
    assert np.abs(strain - 10.0 * farthest).max() < IDENTITY * 0.2
    assert rotation.max() < IDENTITY


def test_the_share_of_the_strain_energy_goes_by_stiffness_volume_and_square() -> None:
    """Independent check: cells of a quarter of the volume, four times as stiff and twice as strained as the others."""
    mesh = MeshTet.init_tensor(*(np.linspace(0.0, 0.04, n) for n in (5, 3, 3)))
    stiff = mesh.p[0, mesh.t].mean(axis=0) < 0.01
    body = tissue.elasticity(mesh, tissue.Material(np.where(stiff, 4.0e5, 1.0e5), 0.3, 1000.0))
    share = tissue.energy_share(body, np.where(stiff, 0.02, 0.01), stiff)
    assert abs(share / (16.0 / 19.0) - 1.0) < IDENTITY
    assert tissue.energy_share(body, np.zeros(mesh.nelements), stiff) == 0.0
