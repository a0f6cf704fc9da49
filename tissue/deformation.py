"""Kinematics of a body at finite strain: deformation gradient, stretches, Cauchy stress."""

import numpy as np

from tissue.arrays import Array
from tissue.elasticity import Elasticity
from tissue.hyperelasticity import Hyperelasticity
from tissue.materials.density import Density, determinant
from tissue.stress import nodal_averages


def principal_stretch(hyper: Hyperelasticity, U: Array) -> tuple[Array, Array, Array]:
    """Return the principal stretches of each cell, the largest first, `(c, 3)` [-], its rotation
    [rad], `(c,)`, and the directions of the stretches.

    They are those of the mean of F over the cell, from the reference shape, without the prestretch.
    The directions are unit vectors in the deformed tissue, rows of `(c, 3, 3)` [-], with arbitrary
    sign. `U` [m] is a field over all unknowns `(N,)`.
    """
    left, stretch, right = np.linalg.svd(_cell_means(hyper, hyper.gradient(U)))
    R = left @ right
    sine = np.linalg.norm(R - R.swapaxes(1, 2), axis=(1, 2)) / np.sqrt(8.0)
    return stretch, np.arctan2(sine, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0)), left.swapaxes(1, 2)


def cell_energy(hyper: Hyperelasticity, U: Array, density: Density | None = None) -> Array:
    """Return the mean strain energy per reference volume in each cell, shape `(c,)` [Pa].

    Here and below, a given `density` replaces the density of the body.
    """
    return np.asarray(hyper.energy_at_points(hyper.gradient(U), density).sum(axis=0) / hyper.weights.sum(axis=0))


def cauchy_stress(hyper: Hyperelasticity, U: Array, density: Density | None = None) -> Array:
    """Return the Cauchy stress σ = P Fᵀ/J at the nodes: xx, yy, zz, xy, yz, xz, shape `(m, 6)` [Pa].

    The stress at a node is the mean of its cells, weighted by volume. The field of a cell is linear.
    It is fitted to the quadrature points, as for a linear material (`tissue.stress`).
    """
    body, F = hyper.body, hyper.gradient(U)
    sigma = np.einsum("ikqc,jkqc->ijqc", hyper.stress(F, density), F) / determinant(F)
    six = np.stack([sigma[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))], axis=-1)
    values = np.einsum("nq,qcs->ncs", _to_nodes(body), six)
    return np.asarray(nodal_averages(body) @ values.reshape(-1, 6))


def _to_nodes(body: Elasticity) -> Array:
    """Return the matrix from values at the quadrature points of a cell to its nodes, shape `(n, q)`.

    A linear field is fitted by least squares. A linear cell has one value, as in `nodal_averages`.
    """
    if body.element == "P1":
        return np.ones((1, 1))
    of_nodes, of_points = (np.insert(np.asarray(x), 0, 1.0, axis=1) for x in (body.cell.doflocs, body.rule[0]))
    return np.asarray(of_nodes @ np.linalg.pinv(of_points))


def _cell_means(hyper: Hyperelasticity, field: Array) -> Array:
    """Return the means over the cells of a field at their points `(3, 3, q, c)`, shape `(c, 3, 3)`."""
    share = hyper.weights / hyper.weights.sum(axis=0)
    return np.ascontiguousarray(np.moveaxis(np.einsum("ijqc,qc->ijc", field, share), 2, 0))
