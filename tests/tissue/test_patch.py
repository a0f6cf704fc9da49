"""Patches of cells: bisection, and their stiffness of second order."""

import numpy as np
from scipy.sparse import diags_array
from skfem import Basis, BilinearForm, ElementTetP0, ElementTetP2, ElementVector
from skfem.helpers import div

import tissue
from meshes.block import block
from tests.bounds import IDENTITY
from tissue.elasticity import NO_POINTS, stiffness
from tissue.refinement.refine import cell_sizes, refine_to
from tissue.sites.patch import Patch, quadratic_stiffness


def test_bisected_cells_are_small_enough_fill_their_parents_and_meet_at_whole_faces() -> None:
    """Independent check: volumes by parent; no more boundary than the block has, so that no face hangs."""
    mesh = block((4.0, 3.0, 2.0), 1.0)
    corner = np.array([2.0, 1.5, 0.0])

    def wanted(corners: np.ndarray) -> np.ndarray:
        return 0.1 + 0.4 * np.linalg.norm(corners.mean(axis=1) - corner, axis=1)

    parts = refine_to(mesh, wanted)
    fine = parts.mesh
    sizes = cell_sizes(fine.p.T[fine.t.T])
    assert (sizes <= wanted(fine.p.T[fine.t.T])).all()
    volumes = np.bincount(parts.parents, sizes**3, mesh.nelements)
    assert np.abs(volumes - cell_sizes(mesh.p.T[mesh.t.T]) ** 3).max() <= IDENTITY * volumes.max()
    a, b, c = np.moveaxis(fine.p.T[fine.facets[:, fine.boundary_facets()].T], 1, 0)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert abs(area - 52.0) <= IDENTITY * area


def test_quadratic_stiffness_is_that_of_the_organ() -> None:
    """Consistency check: scikit-fem's assembly, form by form, with moduli per cell."""
    mesh = block((0.03, 0.02, 0.01), 5e-3)
    basis = Basis(mesh, ElementVector(ElementTetP2()), quadrature=NO_POINTS)
    lam, mu = np.random.default_rng(0).uniform(1.0, 2.0, (2, mesh.nelements))
    K = stiffness(basis, lam, mu)
    assert abs(quadratic_stiffness(basis, lam, mu, 0.0) - K).max() <= IDENTITY * abs(K).max()


def test_a_cells_mean_dilatation_is_its_own() -> None:
    """Independent check: ∫ div φ_i dx by scikit-fem's piecewise constants, squared over the volume, cell by cell."""
    mesh = block((0.03, 0.02, 0.01), 5e-3)
    basis = Basis(mesh, ElementVector(ElementTetP2()), intorder=1)
    lam, mu, mean = np.random.default_rng(0).uniform(1.0, 2.0, (3, mesh.nelements))
    D = BilinearForm(lambda u, q, w: div(u) * q).assemble(basis, basis.with_element(ElementTetP0()))
    volumes = cell_sizes(mesh.p.T[mesh.t.T]) ** 3 / 6.0
    K = stiffness(basis, lam, mu) + D.T @ diags_array(mean / volumes) @ D
    assert abs(quadratic_stiffness(basis, lam, mu, mean) - K).max() <= IDENTITY * abs(K).max()


def test_a_patch_keeps_the_clamps_and_rollers_of_its_organ_and_is_held_where_it_is_cut() -> None:
    """Consistency check: a refined patch without anything to refine holds the very unknowns of a P2 organ."""
    mesh, material = block((0.03, 0.02, 0.01), 5e-3), tissue.Material(1e5, 0.3, 1000.0)
    body = tissue.elasticity(mesh, material, "P2", ["bottom"], roller=["left"])
    cells = np.flatnonzero(mesh.p[0, mesh.t].mean(axis=0) < 0.0)
    fine, _ = Patch(body, cells).refined(lambda corners: np.full(len(corners), np.inf))
    x = fine.points
    held = np.isin(fine.nodes, fine.clamped)
    assert (held.all(axis=1) == ((x[:, 2] < -0.0099) | (x[:, 0] > -1e-6))).all()
    assert (held[:, 0] == ((x[:, 2] < -0.0099) | (x[:, 0] > -1e-6) | (x[:, 0] < -0.0149))).all()
