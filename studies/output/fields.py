"""Fields of thread and organ for pictures: plain arrays.

The process of a picture reads these classes without the solver's libraries.
"""

from dataclasses import dataclass

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

    def split(self, values: Array) -> list[Array]:
        """Return values of the samples, (m, …), piece by piece."""
        return np.split(values, np.cumsum(self.pieces[:-1], dtype=np.int64))


@dataclass(frozen=True)
class OrganTopology:
    """The organ's mesh in the reference shape, for output."""

    points: Array  # (nodes, 3) [m]
    cells: NDArray[np.int64]  # (cells, 4), or (cells, 10) with the mid-edge nodes 01 12 02 03 13 23


@dataclass(frozen=True)
class OrganRecord:
    """The organ at one time."""

    displacement: Array  # (nodes, 3) [m]
    stress: Array  # (nodes, 6) xx yy zz xy yz xz [Pa]
    von_mises: Array  # (nodes,) [Pa]
    principal_stress: Array  # (nodes, 3) falling [Pa]
    first_direction: Array  # (nodes, 3) direction of the largest principal stress, unit
    third_direction: Array  # (nodes, 3) direction of the smallest principal stress, unit
    strain: Array  # (cells,) largest principal strain in each cell, in magnitude [-]
    rotation: Array  # (cells,) largest |½ curl U| in each cell [rad]
    energy_density: Array  # (cells,) mean strain energy per volume in each cell [Pa]
    volume_ratio: Array  # (cells,) volume between the corners of each cell over its reference volume [-]
    nodal_volume_ratio: Array  # (nodes,) J averaged at the vertices; at a mid-edge node the mean of both ends [-]
    strained: float  # share of the strain energy in cells whose strain is not small [-]
    rotated: float  # share of the strain energy in cells whose rotation is not small [-]
    pressed_turn: float = 0.0  # largest angle between a pressed normal and its reference direction [rad]
    contact_pressure: Array | None = None  # (nodes,) [Pa], zero outside the lips; None without contact
    lip_gap: Array | None = None  # (nodes,) [m], not a number outside the lips
    crossed: float = 0.0  # overlap of lips without contact, over their extent [-]
    principal_stretch: Array | None = None  # (cells, 3) falling [-]; None for a linear organ
    first_stretch: Array | None = None  # (cells, 3) direction of the largest stretch in the deformed shape, unit
    third_stretch: Array | None = None  # (cells, 3) direction of the smallest stretch, unit
    hole_strain: Array | None = None  # (p,) largest `strain` of the cells on which each hole bears [-]
    hole_energy: Array | None = None  # (p,) largest `energy_density` of these cells [Pa]
