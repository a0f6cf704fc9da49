"""Bisection of cells down to a size."""

import numpy as np

from meshes.block import block
from tests.bounds import IDENTITY
from tissue.refinement.refine import cell_sizes, refine_to


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
