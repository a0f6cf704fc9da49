"""Finite strain on the organ's elements: energy, force and tangent of ∫ W(F) dX with F = I + ∇U
(total Lagrangian).

W is a density of distortion (`tissue.materials`) plus κ/2 (J − 1)² with the same E and ν as the
linear organ. At small strain the body equals the linear organ. If the linear organ averages its
dilatation (`tissue.elasticity`), the excess λ̄ of λ acts here on averages of J:
½ Σ_a θ_a²/S_a with θ_a = ∫ ψ_a (J − 1) dX and S_a = ∫ ψ_a/λ̄ dX (Bonet & Burton, Commun. Numer.
Meth. Engng 14, 1998). ψ_a is a hat function of a vertex, or one in a cell and zero elsewhere. This
term is an energy, so that the tangent is symmetric.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix, diags_array

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity, cellwise_lambda, excess_lambda, shape_gradients
from tissue.errors import TissueError
from tissue.loops import compiled
from tissue.material import PerCell
from tissue.materials.density import Density, Sum, cofactor, determinant, determinant_tangent
from tissue.materials.isotropic import Exponential, Volumetric
from tissue.materials.prestretch import Prestretched
from tissue.relaxation import Held, Part
from tissue.shapes import shapes

I3 = np.eye(3)
NONE = (1.0, 1.0, 1.0)  # stretches without prestretch


@dataclass(frozen=True)
class Pattern:
    """The pattern by which local matrices are added to a sparse matrix with `indices`, `indptr` and
    `shape`.

    `block` `(…)` is the index of each local block. `order` sorts the entries of all blocks into the
    data of the sparse matrix.
    """

    block: Indices
    order: Indices
    indices: Indices
    indptr: Indices
    shape: tuple[int, int]

    def assembled(self, sums: Array) -> csr_matrix:
        """Return the matrix of summed blocks, shape `(blocks, rows, columns)`."""
        return csr_matrix((sums.ravel()[self.order], self.indices, self.indptr), shape=self.shape)


def pattern(nodes: Indices, kept: Indices) -> Pattern:
    """Return the pattern of 3×3 blocks at the pairs of `nodes` `(n, c)` of each cell.

    The matrix keeps only the scalar rows and columns `kept`.
    """
    count = int(nodes.max()) + 1
    pairs = nodes[:, None].astype(np.int64) * count + nodes
    known, block = np.unique(pairs, return_inverse=True)
    indptr = np.searchsorted(known, np.arange(count + 1, dtype=np.int64) * count)
    numbers = np.arange(1.0, 9.0 * known.size + 1.0).reshape(-1, 3, 3)
    whole = bsr_matrix((numbers, known % count, indptr), shape=(3 * count, 3 * count)).tocsr()
    whole = csr_matrix(whole)[kept][:, kept]
    order = np.rint(whole.data).astype(np.intp) - 1
    indices, starts = whole.indices.astype(np.intp), whole.indptr.astype(np.intp)
    return Pattern(block.reshape(pairs.shape), order, indices, starts, whole.shape)


@compiled
def stiffness_blocks(slopes: Array, A: Array, D: Array, stiffness: Array, block: Indices) -> Array:
    """Return the sums of K_nm = Σ_q ∂φ_n/∂X_j A_ijkl ∂φ_m/∂X_l + k D_n ⊗ D_m over the cells,
    `(blocks, 3, 3)`.

    `slopes` has shape `(n, 3, q, c)`, `A` `(3, 3, 3, 3, q, c)`, `D` `(n, 3, c)`, and the
    `stiffness` k `(c,)`. `block` `(n, n, c)` is the index of each local block.
    """
    nodes, _, points, cells = slopes.shape
    sums, local = np.zeros((block.max() + 1, 3, 3)), np.empty((3, 3, nodes, nodes))
    for c in range(cells):
        local[:] = 0.0
        for q in range(points):
            g = slopes[:, :, q, c].T.copy()
            for i in range(3):
                for k in range(3):
                    for r in range(3):
                        a0, a1, a2 = A[i, 0, k, r, q, c], A[i, 1, k, r, q, c], A[i, 2, k, r, q, c]
                        for n in range(nodes):
                            h = a0 * g[0, n] + a1 * g[1, n] + a2 * g[2, n]
                            for m in range(nodes):
                                local[i, k, n, m] += h * g[r, m]
        for n in range(nodes):
            for m in range(nodes):
                for i in range(3):
                    for k in range(3):
                        sums[block[n, m, c], i, k] += local[i, k, n, m] + stiffness[c] * D[n, i, c] * D[m, k, c]
    return sums


@dataclass(frozen=True, eq=False)
class Hyperelasticity:
    """A body at finite strain.

    The elastic `body` gives mesh, supports, E, ν and mass. `distortion` is the density of
    distortion; None means the neo-Hookean solid with the body's μ. `prestretch` are principal
    stretches of the reference shape along x, y, z, `(3,)` or `(3, cells)` [-]. Fields U [m] are
    over all unknowns `(N,)`. Forces are over all unknowns, tangents over the free ones.
    """

    body: Elasticity
    distortion: Density | None = None
    prestretch: Array | Sequence[float] = NONE

    def __post_init__(self) -> None:
        given = np.asarray(self.prestretch, dtype=float)
        if given.shape not in {(3,), (3, self.body.mesh.nelements)}:
            raise TissueError(f"prestretch: shape {given.shape}; allowed is (3,), or one column per cell")

    @cached_property
    def slopes(self) -> Array:
        """∂φ_n/∂X_j, shape `(n, 3, q, c)` [1/m]."""
        found = shape_gradients(self.body, self.body.rule[0])
        return np.ascontiguousarray(np.moveaxis(found, (2, 3, 1, 0), (0, 1, 2, 3)))

    @cached_property
    def weights(self) -> Array:
        """Volume of each quadrature point, shape `(q, c)` [m³]."""
        return np.asarray(np.outer(self.body.rule[1], self.body.six_volumes))

    @cached_property
    def kappa(self) -> PerCell:
        """Bulk modulus that acts at each point [Pa]."""
        material = self.body.material
        lam = cellwise_lambda(material, self.body.dilatation)
        return lam + 2.0 / 3.0 * material.lame_mu

    @cached_property
    def density(self) -> Density:
        """W without averaged terms."""
        return self.density_of([self._distortion])

    @cached_property
    def _distortion(self) -> Density:
        """The density of distortion of the tissue without prestretch."""
        return self.distortion or Exponential(self.body.material.lame_mu)

    def density_of(self, parts: Sequence[Density]) -> Density:
        """Return the sum of the densities `parts` and of the volumetric density, for the reference
        shape.

        The given densities are for the tissue without prestretch.
        """
        whole, stretches = Sum([*parts, Volumetric(self.kappa)]), np.asarray(self.prestretch, dtype=float)
        return whole if np.all(stretches == 1.0) else Prestretched(whole, stretches)

    def relaxing(self, part: PerCell, H: Array | None) -> Density:
        """Return the density of relaxing tissue (`tissue.relaxation`) for one step.

        The density of distortion is multiplied by `part`, and a constant stress H `(3, 3, q, c)`
        [Pa] is added; None means no stress. Both are for the tissue without prestretch.
        """
        return self.density_of([Part(self._distortion, part), *([] if H is None else [Held(H)])])

    def distortional_stress(self, F: Array) -> Array:
        """Return S_iso, the second Piola stress of distortion of the tissue without prestretch,
        `(3, 3, q, c)` [Pa].
        """
        F = F * np.asarray(self.prestretch, dtype=float).reshape(3, 1, -1)
        inverse = cofactor(F) / determinant(F)
        return np.asarray(np.einsum("ki...,kj...->ij...", inverse, self._distortion.stress(F)))

    # --- averaged terms ---------------------------------------------------------------------------------------

    @cached_property
    def _hats(self) -> Array:
        """ψ_a dX of the averages in which the cells take part, shape `(j, q, c)` [m³]; zero in cells with
        λ̄ = 0.
        """
        psi, _ = shapes(self.body.averages[1], self.body.rule[0])
        return np.asarray(psi[:, :, None] * self.weights * (self._excess > 0.0))

    @cached_property
    def _excess(self) -> Array:
        """λ̄, the averaged part of λ, shape `(c,)` [Pa]."""
        return excess_lambda(self.body, self.body.dilatation)

    @cached_property
    def _before(self) -> Array:
        """J of the prestretch, `(c,)` or `(1,)`."""
        return np.atleast_1d(np.prod(np.asarray(self.prestretch, dtype=float), axis=0))

    @cached_property
    def _stiffness_of_averages(self) -> Array:
        """1/S_a, shape `(averages,)` [Pa/m³]; zero for an average without a cell with λ̄ > 0."""
        softness = np.divide(1.0, self._excess, out=np.zeros(self._excess.size), where=self._excess > 0.0)
        S = self._sums(self._hats * (softness / self._before))
        return np.divide(1.0, S, out=np.zeros(S.size), where=S > 0.0)

    def _sums(self, local: Array) -> Array:
        """Return the sums `(averages,)` of values `(j, q, c)` at the points of the cells."""
        numbers = self.body.averages[0]
        return np.asarray(np.bincount(numbers.ravel(), local.sum(axis=1).ravel()), dtype=float)

    def _gaps(self, J: Array) -> Array:
        """Return θ_a, shape `(averages,)` [m³]."""
        return self._sums(self._hats * (J - 1.0 / self._before))

    def pressure(self, J: Array) -> Array:
        """Return θ_a/S_a, the averaged part of κ (J − 1), shape `(averages,)` [Pa]."""
        return self._stiffness_of_averages * self._gaps(J)

    def _pressure_at_points(self, J: Array) -> Array:
        """Return Σ_a ψ_a p_a dX, shape `(q, c)` [N m]."""
        return np.asarray(np.einsum("aqc,ac->qc", self._hats, self.pressure(J)[self.body.averages[0]]))

    # --- energy and its derivatives ---------------------------------------------------------------------------

    def gradient(self, U: Array) -> Array:
        """Return F = I + ∂U/∂X at the points of the cells, shape `(3, 3, q, c)`."""
        local = U[self._unknowns]
        return np.asarray(np.einsum("nic,njqc->ijqc", local, self.slopes)) + I3[:, :, None, None]

    @cached_property
    def _unknowns(self) -> Indices:
        """Unknowns of each cell by node and component, shape `(n, 3, c)`."""
        return np.ascontiguousarray(np.moveaxis(self.body.nodes[self.body.cells], 0, 2))

    def energy(self, F: Array, density: Density | None = None) -> float:
        """Return the stored energy [J] of deformation gradients from `gradient`.

        It is infinite if a cell is inverted.

        Here and below, a given `density` replaces the density of the body.

        The energy is zero in the shape of the tissue without prestretch. It therefore includes the
        energy of the reference shape, `energy_of_prestretch`.
        """
        J = determinant(F)
        if not J.min() > 0.0:
            return np.inf
        stored = float(np.sum(self.weights * (density or self.density).energy(F)))
        if self.body.pressure is not None:
            stored += float(0.5 * self._stiffness_of_averages @ self._gaps(J) ** 2)
        return stored if np.isfinite(stored) else np.inf

    def energy_of_prestretch(self, density: Density | None = None) -> float:
        """Return the energy that a prestretch stores in the reference shape [J]."""
        if np.all(np.asarray(self.prestretch, dtype=float) == 1.0):
            return 0.0
        return self.energy(self.gradient(np.zeros(self.body.N)), density)

    def energy_at_points(self, F: Array, density: Density | None = None) -> Array:
        """Return the stored energy of each quadrature point, shape `(q, c)` [J].

        It includes the share of the point in averaged terms.
        """
        stored = self.weights * (density or self.density).energy(F)
        if self.body.pressure is not None:
            J = determinant(F)
            stored = stored + 0.5 * self._pressure_at_points(J) * (J - 1.0 / self._before)
        return np.asarray(stored)

    def stress(self, F: Array, density: Density | None = None) -> Array:
        """Return the first Piola stress P at the points of the cells, shape `(3, 3, q, c)` [Pa]."""
        P = (density or self.density).stress(F)
        if self.body.pressure is not None:
            P = P + self._pressure_at_points(determinant(F)) / self.weights * cofactor(F)
        return P

    def forces(self, F: Array, density: Density | None = None) -> tuple[Array, float]:
        """Return ∂energy/∂U over all unknowns, shape `(N,)` [N], and the largest force of a cell on
        a node [N].

        At clamped unknowns the force is the force of the support.
        """
        P = self.weights * self.stress(F, density)
        local = np.einsum("ijqc,njqc->nic", P, self.slopes)
        whole = np.asarray(np.bincount(self._unknowns.ravel(), local.ravel(), self.body.N), dtype=float)
        return whole, float(np.abs(local).max(initial=0.0))

    def tangent(self, F: Array, density: Density | None = None) -> csr_matrix:
        """Return ∂²energy/∂U² over the free unknowns, shape `(free, free)` [N/m], symmetric."""
        A, kind = self.weights * (density or self.density).tangent(F), self.body.dilatation
        local, stiffness = np.zeros(self._unknowns.shape), np.zeros(A.shape[-1])
        if kind != "cell":
            A += self._pressure_at_points(determinant(F)) * determinant_tangent(F)
        if kind == "mean":
            local, stiffness = np.ascontiguousarray(self._rates(F)[0]), self._stiffness_of_averages
        K = self._cells.assembled(stiffness_blocks(self.slopes, A, local, stiffness, self._cells.block))
        return csr_matrix(K + self._volume_tangent(F)) if kind == "nodal" else K

    def _rates(self, F: Array) -> Array:
        """Return ∂θ_a/∂U of each cell, shape `(j, n, 3, c)` [m²]."""
        return np.einsum("aqc,ijqc,njqc->anic", self._hats, cofactor(F), self.slopes, optimize=True)

    def _volume_tangent(self, F: Array) -> csr_matrix:
        """Return Σ_a D_a D_aᵀ/S_a with D_a = ∂θ_a/∂U over the free unknowns."""
        local, numbers = self._rates(F), self.body.averages[0]
        rows = np.broadcast_to(numbers[:, None, None], local.shape).ravel()
        columns = np.broadcast_to(self._unknowns, local.shape).ravel()
        D = csr_matrix((local.ravel(), (rows, columns)), (int(numbers.max()) + 1, self.body.N))[:, self.body.free]
        return csr_matrix(D.T @ (diags_array(self._stiffness_of_averages) @ D))

    @cached_property
    def _cells(self) -> Pattern:
        """The pattern of the cells' matrices."""
        by_nodes = np.argsort(self.body.nodes.ravel())
        return pattern(self.body.cells.T, by_nodes[self.body.free])
