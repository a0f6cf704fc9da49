"""The thread: a spline with mass, stretch and bending, assembled over its spans.

Unknowns are the control points `q`, shape `(n, 3)` [m], numbered point by point: unknown 3i + a is coordinate a
of point i. Matrices are banded (11 diagonals each side) in the storage LAPACK's `gbtrf` wants.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags_array

from thread.energy import (
    axial_stiffness,
    axial_strain,
    curvature_squared,
    curvature_squared_gradient,
    curvature_squared_hessian,
    dot,
)
from thread.errors import ThreadError
from thread.spline import Indices, Spline

Array = NDArray[np.float64]

LOCAL = 4  # functions of a cubic on one span
HALF_BAND = 3 * LOCAL - 1
BAND_ROWS = 3 * HALF_BAND + 1  # gbtrf keeps room for the fill of row exchanges above the band
DIAGONAL = 2 * HALF_BAND  # row of the storage that holds the main diagonal

MASS_POINTS = 4  # exact for the product of two cubics
ELASTIC_POINTS = 2
# Membrane locking: a cubic cannot keep |T| = 1 all along a span whose curvature changes, and at the stiffness of a real
# suture that blocks its bending. So a span resists its mean strain in full and what deviates from it by this part:
# measured on the elastica with 20 control points (PL²/EI = 10) the error is 6e-4 with 1, 9e-5 with 0.1, 2e-5 with 0;
# with 0 a coarse thread finds ways to stretch where it bends, and Newton fails.
DEVIATION = 0.1


class CrossSection(Protocol):
    """What a thread needs of its section; `thread.catalogue.Section` is one."""

    @property
    def diameter(self) -> float:
        """[m]"""

    @property
    def rhoA(self) -> float:
        """Mass per rest length [kg/m]."""

    @property
    def EA(self) -> float:
        """Axial stiffness [N]."""

    @property
    def EI(self) -> float:
        """Bending stiffness [N m²]."""


@dataclass(frozen=True)
class Rule:
    """Gauss points of every span: weights `(spans, g)` [m] and basis derivatives `(spans, g, 4 orders, 4)`."""

    s: Array
    w: Array
    b: Array


def gauss_rule(spline: Spline, points: int) -> Rule:
    """Gauss–Legendre rule with `points` points a span."""
    x, w = np.polynomial.legendre.leggauss(points)
    left, right = spline.breaks[:-1, None], spline.breaks[1:, None]
    s = 0.5 * (left + right) + 0.5 * (right - left) * x
    _, b = spline.basis(s.ravel())
    return Rule(s, 0.5 * (right - left) * w, b.reshape(*s.shape, 4, LOCAL))


@dataclass(frozen=True)
class Points:
    """The curve at the quadrature points of an iterate: what energy, force and tangent share.

    `T`, `K` (spans, g, 3), first and second derivative of P [-, 1/m]; `strain` (spans, g), axial, the deviation from
    the mean of the span reduced: EA times it is the axial force; `full_strain` (spans, g), nothing reduced.
    """

    T: Array
    K: Array
    strain: Array
    full_strain: Array


@dataclass(frozen=True)
class Thread:
    """A spline thread with the section's mass and stiffness.

    `bending` False sets EI = 0. `damping` [1/s] is mass-proportional viscosity. `point_masses` (2,) [kg] sit on the
    start and the end. Energies: ½∫EA ε² ds + ½∫EI κ² ds (§3; straight at rest).
    """

    spline: Spline
    section: CrossSection
    bending: bool = True
    damping: float = 0.0
    point_masses: tuple[float, float] = (0.0, 0.0)
    elastic_points: int = ELASTIC_POINTS
    deviation: float = DEVIATION

    def __post_init__(self) -> None:
        if not self.damping >= 0.0:
            raise ThreadError(f"damping: {self.damping} 1/s; allowed are numbers from 0 on")
        if min(self.point_masses) < 0.0:
            raise ThreadError(f"mass of an end: {min(self.point_masses)} kg; allowed are numbers from 0 on")

    @property
    def n(self) -> int:
        """Number of control points."""
        return self.spline.n

    @property
    def EA(self) -> float:
        """Axial stiffness [N]."""
        return self.section.EA

    @property
    def EI(self) -> float:
        """Bending stiffness [N m²], zero where bending is left out."""
        return self.section.EI if self.bending else 0.0

    @cached_property
    def points_of_span(self) -> Indices:
        """Control points that live on each span, shape `(spans, 4)`."""
        return self.spline.first[:, None] + np.arange(LOCAL)

    @cached_property
    def elastic_rule(self) -> Rule:
        """Reduced rule of both elastic energies."""
        return gauss_rule(self.spline, self.elastic_points)

    # -- linear parts ------------------------------------------------------------------------------------------

    @cached_property
    def mass_matrix(self) -> csr_matrix:
        """Consistent mass ∫ρA b_i b_j ds (eq. 3) plus the end masses, shape `(n, n)` [kg]; the same for x, y, z."""
        rule = gauss_rule(self.spline, MASS_POINTS)
        b = rule.b[:, :, 0, :]
        blocks = self.section.rhoA * np.einsum("eg,egi,egj->eij", rule.w, b, b)
        row, column = np.broadcast_arrays(self.points_of_span[:, :, None], self.points_of_span[:, None, :])
        M = csr_matrix((blocks.ravel(), (row.ravel(), column.ravel())), shape=(self.n, self.n))
        ends = np.zeros(self.n)
        ends[[0, -1]] = self.point_masses
        return csr_matrix(M + diags_array(ends))

    @cached_property
    def mass_band(self) -> Array:
        """The mass of all three coordinates in banded storage `(34, 3n)` [kg]."""
        M = self.mass_matrix.tocoo()
        band = np.zeros((BAND_ROWS, 3 * self.n))
        for axis in range(3):
            band[DIAGONAL + 3 * (M.row - M.col), 3 * M.col + axis] = M.data
        return band

    @property
    def force_unit(self) -> float:
        """EI/L² (EA·10⁻⁹ without bending): the force scale of a thread nothing pulls [N]."""
        length = self.spline.end - self.spline.start
        return self.EI / length**2 if self.bending else 1e-9 * self.EA

    # -- assembly ----------------------------------------------------------------------------------------------

    @cached_property
    def _band_index(self) -> Indices:
        dof = 3 * self.points_of_span[:, :, None] + np.arange(3)
        row, column = dof[:, :, None, :, None], dof[:, None, :, None, :]
        return np.asarray((DIAGONAL + row - column) * (3 * self.n) + column).ravel()

    def band_at(self, first: Indices, blocks: Array) -> Array:
        """Sum matrices on the four points from `first` (m,) on, `(m, 4, 4, 3, 3)`, into banded storage."""
        dof = 3 * (first[:, None, None] + np.arange(LOCAL)[:, None]) + np.arange(3)
        row, column = dof[:, :, None, :, None], dof[:, None, :, None, :]
        band = np.zeros((BAND_ROWS, 3 * self.n))
        np.add.at(band, (DIAGONAL + row - column, np.broadcast_to(column, blocks.shape)), blocks)
        return band

    def band(self, blocks: Array) -> Array:
        """Sum span matrices `(spans, 4, 4, 3, 3)` into banded storage `(34, 3n)`."""
        size = BAND_ROWS * 3 * self.n
        return np.bincount(self._band_index, blocks.ravel(), size).astype(np.float64, copy=False).reshape(BAND_ROWS, -1)

    @cached_property
    def _vector_index(self) -> Indices:
        return np.asarray(3 * self.points_of_span[:, :, None] + np.arange(3)).ravel()

    def vector(self, blocks: Array) -> Array:
        """Sum span vectors `(spans, 4, 3)` into control-point values `(n, 3)`."""
        return np.bincount(self._vector_index, blocks.ravel(), 3 * self.n).astype(np.float64, copy=False).reshape(-1, 3)

    @cached_property
    def _evaluation(self) -> Array:
        """Rows that map the four points of a span to T at its Gauss points, then to T', `(spans, 2g, 4)`."""
        b = self.elastic_rule.b
        return np.concatenate([b[:, :, 1], b[:, :, 2]], axis=1)

    @cached_property
    def _force_map(self) -> Array:
        """Transposed, weighted evaluation: point values of the stress to span forces, `(spans, 4, 2g)`."""
        w = np.tile(self.elastic_rule.w, 2)
        return np.ascontiguousarray((self._evaluation * w[:, :, None]).swapaxes(1, 2))

    @cached_property
    def _tangent_map(self) -> Array:
        """Weighted products b_i b_j that carry point Hessians (TT, TK, KT, KK) to span matrices, `(spans, 16, 4g)`."""
        w, d1, d2 = self.elastic_rule.w, self.elastic_rule.b[:, :, 1], self.elastic_rule.b[:, :, 2]
        pairs = ((d1, d1), (d1, d2), (d2, d1), (d2, d2))
        maps = [np.einsum("eg,egi,egj->eijg", w, x, y) for x, y in pairs]
        return np.ascontiguousarray(np.concatenate(maps, axis=-1).reshape(len(w), LOCAL * LOCAL, -1))

    @cached_property
    def _softening(self) -> Array:
        """Mean of a span plus a part of the deviation from it, as a matrix (g, g); the Gauss weights are equal."""
        g = self.elastic_points
        return self.deviation * np.eye(g) + (1.0 - self.deviation) / g

    @cached_property
    def _mean_weight(self) -> Array:
        """Stiffness of the mean strain left beside that of the points, shape (spans, 1, 1) [N/m]."""
        return (1.0 - self.deviation) * self.EA / np.diff(self.spline.breaks)[:, None, None]

    @cached_property
    def _mean_map(self) -> Array:
        """From T at the points of a span to the derivative of ∫ε ds over it by its four points, `(spans, 4, g)`."""
        return np.ascontiguousarray(self._force_map[:, :, : self.elastic_points])

    # -- nonlinear parts ---------------------------------------------------------------------------------------

    def points(self, q: Array) -> Points:
        """Evaluate the curve at the quadrature points."""
        values = self._evaluation @ q[self.points_of_span]
        T, K = values[:, : self.elastic_points], values[:, self.elastic_points :]
        strain = axial_strain(T)
        return Points(T, K, self.softened(strain), strain)

    def softened(self, strain: Array) -> Array:
        """Mean of each span plus the part `deviation` of what deviates from it, shape as given (spans, g)."""
        return strain @ self._softening

    def energy(self, points: Points) -> float:
        """Elastic energy [J]."""
        stretch, bend = points.strain * points.full_strain, curvature_squared(points.T, points.K)
        return float(0.5 * np.sum(self.elastic_rule.w * (self.EA * stretch + self.EI * bend)))

    def gradient(self, points: Points) -> Array:
        """Derivative of the elastic energy by the control points, shape `(n, 3)` [N]."""
        d_T, d_K = curvature_squared_gradient(points.T, points.K)
        half = 0.5 * self.EI
        stress = np.concatenate([self.EA * points.strain[..., None] * points.T + half * d_T, half * d_K], axis=1)
        return self.vector(self._force_map @ stress)

    def tangent(self, points: Points, N: Array) -> Array:
        """Second derivative of the elastic energy, banded `(34, 3n)` [N/m].

        `N` (spans, g) [N] is the axial force at the Gauss points: `EA * points.strain` for the exact Hessian, the
        iterated force for the mixed-integration-point Newton.
        """
        spans, g = N.shape
        H = np.empty((spans, 4, g, 3, 3))
        H[:, 0], H[:, 1], H[:, 3] = curvature_squared_hessian(points.T, points.K)
        H[:, 2] = H[:, 1].swapaxes(-1, -2)
        H *= 0.5 * self.EI
        H[:, 0] += axial_stiffness(points.T, N, self.deviation * self.EA)
        blocks = (self._tangent_map @ H.reshape(spans, 4 * g, 9)).reshape(-1, LOCAL, LOCAL, 3, 3)
        mean = self._mean_map @ points.T
        blocks += (self._mean_weight * mean)[:, :, None, :, None] * mean[:, None, :, None, :]
        return self.band(blocks)

    def next_axial_force(self, points: Points, dq: Array) -> Array:
        """N of the next iterate, EA (ε + T·δT): the solution of its own linearised equation N/EA = ε(q) [N]."""
        d_T = self._evaluation[:, : self.elastic_points] @ dq[self.points_of_span]
        return self.EA * (points.strain + self.softened(dot(points.T, d_T)))
