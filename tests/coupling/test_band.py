"""The elimination of a full matrix, the equations of the holds."""

import numpy as np
import pytest

from coupling.kernels.band import BLOCK, solve_dense
from tests.bounds import RESIDUAL
from thread.kernels.loops import entry


@pytest.mark.parametrize("size", [1, BLOCK, BLOCK + 1, 3 * BLOCK + 7])
def test_a_full_matrix_is_solved_by_blocks(size: int) -> None:
    """Independent check: numpy's solution, with zeros on the diagonal that only exchanges of rows avoid."""
    random = np.random.default_rng(size)
    A, b = random.standard_normal((size, size)), random.standard_normal((size, 2))
    A[range(0, size - 1, 2), range(0, size - 1, 2)] = 0.0
    M = np.hstack([A, b])
    assert entry(solve_dense)(M)
    expected = np.linalg.solve(A, b)
    assert np.abs(M[:, size:] - expected).max() <= RESIDUAL * np.abs(expected).max()


def test_a_singular_full_matrix_is_seen_in_any_block() -> None:
    """Independent check: the last of equal columns has no pivot."""
    A = np.random.default_rng(0).standard_normal((2 * BLOCK, 2 * BLOCK + 1))
    A[:, -2] = 0.0
    assert not entry(solve_dense)(A)
