"""Stress at the nodes from a displacement field: computed cell by cell, then averaged by volume.

A pressure averaged at the vertices (`tissue.elasticity`) is used at the vertices. At the middle of
an edge it is the mean of both vertices. A pressure averaged over each cell is one of its cell values.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags_array, vstack

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity, cellwise_lambda, slope_matrix
from tissue.errors import TissueError
from tissue.material import PerCell
from tissue.shapes import shapes
from tissue.sites.surface import outer_surface
from tissue.strain import symmetric


@dataclass(frozen=True)
class StressRecovery:
    """Matrices from a displacement field to the stress at the nodes; made by `stress_recovery`.

    `slopes` `(6m, m)` gives nodal averages of λ∂/∂x_j and μ∂/∂x_j, j = x, y, z. `pressure` `(m, N)`
    gives the averaged part of the pressure.
    """

    slopes: csr_matrix
    pressure: csr_matrix
    nodes: Indices

    def stress(self, U: Array) -> Array:
        """Return the stress xx, yy, zz, xy, yz, xz per node, shape `(m, 6)` [Pa].

        `U` [m] is a field over all unknowns `(N,)`.
        """
        m = len(self.nodes)
        spread, shear = np.asarray(self.slopes @ U[self.nodes]).reshape(2, 3, m, 3)  # [j, node, i]: ∂U_i/∂x_j
        pressure = np.einsum("imi->m", spread) + self.pressure @ U
        normal = [pressure + 2.0 * shear[i, :, i] for i in range(3)]
        return np.column_stack([*normal, *(shear[i, :, j] + shear[j, :, i] for i, j in ((0, 1), (1, 2), (0, 2)))])


def stress_recovery(elasticity: Elasticity, share: PerCell | None = None) -> StressRecovery:
    """Return the recovery of σ = λ tr ε I + 2μ ε, computed at each cell's nodes and averaged by
    volume.

    With a `share`, one number or one per cell, only this share of 2μ dev ε is recovered.
    """
    material = elasticity.material
    spread = cellwise_lambda(material, elasticity.dilatation)
    pressure, shear = _nodal_pressure(elasticity), material.lame_mu
    if share is not None:
        shear = share * np.asarray(material.lame_mu)
        spread, pressure = -2.0 / 3.0 * shear, csr_matrix(pressure.shape)
    average, slopes = nodal_averages(elasticity), _nodal_slopes(elasticity)
    parts = np.split(np.arange(slopes.shape[0]), 3)  # ∂/∂x, ∂/∂y, ∂/∂z
    blocks = [
        average
        @ diags_array(np.resize(np.broadcast_to(modulus, len(elasticity.cells)), average.shape[1]))
        @ slopes[rows]
        for modulus in (spread, shear)
        for rows in parts
    ]
    return StressRecovery(csr_matrix(vstack(blocks)), pressure, elasticity.nodes)


def _nodal_slopes(elasticity: Elasticity) -> csr_matrix:
    """Return the matrix from a nodal field to ∂/∂x_j at the nodes of each cell, shape `(3 a c, m)`
    [1/m], as `slope_matrix`.

    In a linear cell the slopes are constant, and a = 1.
    """
    if elasticity.element == "P1":
        return elasticity.corner_slopes
    return slope_matrix(elasticity, np.asarray(elasticity.cell.doflocs))


def nodal_averages(elasticity: Elasticity) -> csr_matrix:
    """Return the matrix that averages cell values at each node by volume, shape `(m, a c)`.

    The cell values are in the order of `_nodal_slopes`.
    """
    cells, m, volume = elasticity.cells, len(elasticity.nodes), elasticity.six_volumes
    total = np.bincount(cells.ravel(), np.repeat(volume, cells.shape[1]), minlength=m)
    places = 1 if elasticity.element == "P1" else cells.shape[1]
    columns = np.resize(np.arange(places * len(cells)), cells.size)
    return csr_matrix(((volume / total[cells.T]).ravel(), (cells.T.ravel(), columns)), shape=(m, places * len(cells)))


def interpolation(elasticity: Elasticity, points: Array) -> csr_matrix:
    """Return the matrix `(k, m)` that interpolates a nodal field at points `(k, 3)` [m] by the
    shape functions.

    Raises `TissueError` for a point outside the body.
    """
    surface = outer_surface(elasticity.mesh)
    cells = surface.containing(points)
    if np.any(cells < 0):
        outside = [float(x) for x in points[np.argmin(cells)]]
        raise TissueError(f"the point {outside} [m] is outside the organ; give points inside it")
    phi, _ = shapes(elasticity.cell, surface.reference(points, cells))
    rows = np.broadcast_to(np.arange(len(points)), phi.shape)
    shape = (len(points), len(elasticity.nodes))
    return csr_matrix((phi.ravel(), (rows.ravel(), elasticity.cells[cells].T.ravel())), shape=shape)


def von_mises(stress: Array) -> Array:
    """Return the von Mises stress, shape `(m,)` [Pa], of stress `(m, 6)`.

    It is √(½[(σxx−σyy)² + (σyy−σzz)² + (σzz−σxx)²] + 3(σxy² + σyz² + σxz²)).
    """
    xx, yy, zz, xy, yz, xz = stress.T
    normal = 0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2)
    return np.asarray(np.sqrt(normal + 3.0 * (xy**2 + yz**2 + xz**2)))


def principal(stress: Array) -> tuple[Array, Array]:
    """Return the principal values of stress `(m, 6)`, largest first, `(m, 3)` [Pa], and their unit
    directions.

    The directions are rows of `(m, 3, 3)`.
    """
    values, directions = np.linalg.eigh(symmetric(stress.T))
    return values[:, ::-1], directions.swapaxes(1, 2)[:, ::-1]


def _nodal_pressure(elasticity: Elasticity) -> csr_matrix:
    """Return the averaged part of λ div U at every node, shape `(m, N)` [Pa/m]."""
    pressure = elasticity.pressure
    if pressure is None:
        return csr_matrix((len(elasticity.nodes), elasticity.N))
    if elasticity.dilatation == "mean":
        average = nodal_averages(elasticity)
        return csr_matrix(average @ vstack([pressure] * (average.shape[1] // len(elasticity.cells))))
    if elasticity.element == "P1":
        return pressure
    first, second = elasticity.mesh.edges
    return csr_matrix(vstack([pressure, 0.5 * (pressure[first] + pressure[second])]))
