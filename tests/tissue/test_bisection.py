"""Bisection of cells down to a size."""

import numpy as np
from skfem import MeshTet

from meshes.block import block
from tests.bounds import IDENTITY
from tissue.refinement.refine import cell_sizes, refine, refine_to


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


def test_round_off_does_not_decide_which_edge_is_cut() -> None:
    """Independent check: a cell that is its own image about y = 0, whose longest edges are images of one another, with
    nodes moved by 1e-16 and 1e-15: the same cells."""
    points = np.array([[3.0, 0.0, 0.1], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.3, 0.0, 1.0]]).T
    cells = []
    for seed in range(8):
        noise = 10.0 ** -(15 + seed % 2) * np.random.default_rng(seed).uniform(-1.0, 1.0, points.shape)
        cells.append(refine(MeshTet(points + noise, np.array([[0], [1], [2], [3]])), np.array([0])).mesh.t)
    assert all(np.array_equal(each, cells[0]) for each in cells)
