"""Rows over the organ's unknowns that average displacement and slope over a site's footprint."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, eye_array, kron

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.shapes import shapes
from tissue.sites.surface import Surface


@dataclass(frozen=True)
class Average:
    """The points of one average.

    They have `reference` coordinates `(k, 3)` in `cells` `(k,)`. The sum of the `weights` is one.
    """

    reference: Array
    cells: Indices
    weights: Array


@dataclass(frozen=True)
class AverageSlope:
    """The average gradient ⟨∇U⟩ = Σ_q U(x_q) c_qᵀ.

    It has the `points` x_q `(k, 3)` [m] in `cells` `(k,)`, and the `vectors` c_q `(k, 3)` [1/m].
    """

    points: Array
    cells: Indices
    vectors: Array


NO_SLOPE = AverageSlope(np.zeros((0, 3)), np.zeros(0, np.intp), np.zeros((0, 3)))  # of a bare point


def normal_rows(gradient: csr_matrix, u0: Array) -> csr_matrix:
    """Return the rows of ⟨∇U⟩ u₀ from the rows of ⟨∂U_i/∂x_j⟩ (row 3i + j)."""
    return csr_matrix(kron(eye_array(3), u0[None]) @ gradient)


def fibre_rows(gradient: csr_matrix, u0: Array) -> csr_matrix:
    """Return the rows of −⟨∇U⟩ᵀ u₀."""
    return csr_matrix(-kron(u0[None], eye_array(3)) @ gradient)


def value_rows(elasticity: Elasticity, average: Average) -> csr_matrix:
    """Return the rows ⟨N⟩ of the averaged displacement, shape `(3, N)`."""
    phi, _ = shapes(elasticity.cell, average.reference)
    unknowns, weights = _by_node(elasticity, average.cells, (phi * average.weights)[:, None])
    rows = np.tile(np.arange(3), len(unknowns))
    return csr_matrix((weights[0].repeat(3), (rows, unknowns.ravel())), shape=(3, elasticity.N))


def gradient_rows(elasticity: Elasticity, surface: Surface, average: Average, slope: AverageSlope) -> csr_matrix:
    """Return the rows of ⟨∂U_i/∂x_j⟩, row 3i + j, shape `(9, N)` [1/m]."""
    phi, _ = shapes(elasticity.cell, surface.reference(slope.points, slope.cells))
    by_parts = _slope_rows(elasticity, slope.cells, phi[:, None] * slope.vectors.T)
    _, dphi = shapes(elasticity.cell, average.reference)
    local = np.einsum("nak,kaj->njk", dphi, surface.to_reference[average.cells]) * average.weights
    missing = (
        np.eye(3) - (slope.points - slope.points.mean(axis=0)).T @ slope.vectors if slope.cells.size else np.eye(3)
    )
    if np.abs(missing).max() <= 1e-12:
        return by_parts
    return csr_matrix(by_parts + kron(eye_array(3), missing.T) @ _slope_rows(elasticity, average.cells, local))


def _slope_rows(elasticity: Elasticity, cells: Indices, slopes: Array) -> csr_matrix:
    """Return slopes of shape functions, summed over points; row 3i + j is ∂U_i/∂x_j.

    The `slopes` `(n, 3, k)` belong to points in `cells` `(k,)`.
    """
    unknowns, sums = _by_node(elasticity, cells, slopes)
    shape = (3, 3, len(unknowns))
    rows = np.broadcast_to(np.arange(9).reshape(3, 3, 1), shape)
    data, columns = np.broadcast_to(sums, shape), np.broadcast_to(unknowns.T[:, None], shape)
    return csr_matrix((data.ravel(), (rows.ravel(), columns.ravel())), shape=(9, elasticity.N))


def _by_node(elasticity: Elasticity, cells: Indices, values: Array) -> tuple[Indices, Array]:
    """Return the unknowns of m nodes, `(m, 3)`, and the sums over points at each node, `(j, m)`.

    The `values` `(n, j, k)` of shape functions belong to points in `cells` `(k,)`. There are far
    more points than nodes.
    """
    unknowns = elasticity.basis.element_dofs[:, cells].reshape(len(values), 3, -1)
    _, first, node = np.unique(unknowns[:, 0], return_index=True, return_inverse=True)
    sums = np.array([np.bincount(node.ravel(), own.ravel(), first.size) for own in values.swapaxes(0, 1)])
    return unknowns.swapaxes(1, 2).reshape(-1, 3)[first], sums
