"""Banded storage of the thread's matrices in the layout of LAPACK's `gbtrf`, and the sums that fill
it.

The unknown c i + a is coordinate a of control point i; c is the number of coordinates of a point.
With h diagonals on each side the storage has 3h + 1 rows. The h rows above the band are memory for
the fill of row exchanges in `gbtrf`.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thread.arrays import Array, Indices


def half_band_of(band: Array) -> int:
    """Return the number of diagonals on each side of the main one, from a matrix in banded storage."""
    return (len(band) - 1) // 3


def diagonal_of(band: Array) -> int:
    """Return the row of the banded storage with the main diagonal."""
    return 2 * half_band_of(band)


@dataclass(frozen=True)
class Elements:
    """Groups of `reach` neighbouring control points, from `first` (m,) on, and their places in the
    thread's matrices.

    The thread has `n` points with `coordinates` each. An element depends on the first `seen` of
    them. `half_band` belongs to the storage.
    """

    first: Indices
    reach: int
    seen: int
    n: int
    coordinates: int
    half_band: int

    @cached_property
    def points(self) -> Indices:
        """Control points of each element, shape `(m, reach)`."""
        return self.first[:, None] + np.arange(self.reach)

    @cached_property
    def unknowns(self) -> Indices:
        """Unknowns of each element, shape `(m, reach, seen)`."""
        return np.asarray(self.coordinates * self.points[:, :, None] + np.arange(self.seen))

    @cached_property
    def _vector_index(self) -> Indices:
        return self.unknowns.ravel()

    @cached_property
    def _band_index(self) -> Indices:
        row, column = self.unknowns[:, :, None, :, None], self.unknowns[:, None, :, None, :]
        return np.asarray((2 * self.half_band + row - column) * (self.coordinates * self.n) + column).ravel()

    def vector(self, blocks: Array) -> Array:
        """Return the sum of element vectors `(m, reach, seen)` at the control points, shape `(n,
        coordinates)`.
        """
        size = self.coordinates * self.n
        summed = np.bincount(self._vector_index, blocks.ravel(), size)
        return summed.astype(np.float64, copy=False).reshape(self.n, -1)

    def band(self, blocks: Array) -> Array:
        """Return the sum of element matrices `(m, reach, reach, seen, seen)` in banded storage."""
        rows = 3 * self.half_band + 1
        summed = np.bincount(self._band_index, blocks.ravel(), rows * self.coordinates * self.n)
        return summed.astype(np.float64, copy=False).reshape(rows, -1)
