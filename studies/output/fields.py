"""Fields of thread and organ for pictures: plain arrays.

The process of a picture reads these classes without the solver's libraries.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.arrays import Array


@dataclass(frozen=True)
class ThreadRecord:
    """The thread at one time, sampled at m abscissas."""

    points: Array  # (m, 3) [m]
    s: Array  # (m,) rest arc length [m]
    tension: Array  # (m,) [N]
    curvature: Array  # (m,) [1/m]
    radius: float  # of the thread [m]
    pieces: tuple[int, ...] = ()  # number of points of each piece of a cut thread; empty if the thread is whole
    torque: Array | None = None  # (m,) about the tangent, right-handed [N m]; None without twist
    bearing: Array | None = None  # (m, 3) of tracts on the thread [N/m], zero elsewhere; None without tracts

    def split(self, values: Array | NDArray[np.int64]) -> list[Any]:
        """Return values of the samples, (m, …), piece by piece."""
        return np.split(values, np.cumsum(self.pieces[:-1], dtype=np.int64))


@dataclass(frozen=True)
class OrganTopology:
    """The organ's mesh in the reference shape, for output."""

    points: Array  # (nodes, 3) [m]
    cells: NDArray[np.int64]  # (cells, 4), or (cells, 10) with the mid-edge nodes 01 12 02 03 13 23
