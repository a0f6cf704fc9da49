"""The thread: a spline with mass, stretch and bending, assembled over its spans.

Unknowns are the control points `q`, shape `(n, 3)` [m], numbered point by point: unknown 3i + a is coordinate a
of point i. Matrices are banded (11 diagonals each side) in the storage LAPACK's `gbtrf` wants.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.sparse import csr_matrix, diags_array

from thread.compliance import beam_compliance, patch_of, spline_compliance
from thread.energy import (
    axial_stiffness,
    axial_strain,
    crushing,
    crushing_gradient,
    crushing_hessian,
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


def exact_weights(spline: Spline, s: Array) -> Array:
    """Weights (n − 1,) [m] at as many points that integrate every function the derivative of the spline consists of.

    Raises `ThreadError` where one is not positive: the spans are too unequal.
    """
    if s.size != spline.n - 1:
        raise ThreadError("knots: repeated knots at both ends of a span; put a span between them")
    t = spline.knots[1:-1]
    functions = BSpline(t, np.eye(spline.n - 1), 2)(s)
    w = np.linalg.solve(functions.T, (t[3:] - t[:-3]) / 3.0)
    if not np.all(w > 0.0):
        raise ThreadError("knots: neighbouring spans differ too much for a positive rule; grade them more gently")
    return np.asarray(w, dtype=np.float64)


@dataclass(frozen=True)
class Points:
    """The curve at the quadrature points of an iterate: what energy, force and tangent share.

    `T`, `K` (spans, g, 3), first and second derivative of P at the points of the bending [-, 1/m]; `T_axial` (spans, g,
    3) and `strain` (spans, g) at those of the stretch.
    """

    T: Array
    K: Array
    T_axial: Array
    strain: Array


@dataclass(frozen=True)
class Thread:
    """A spline thread with the section's mass and stiffness.

    `bending` False sets EI = 0. `damping` [1/s] is mass-proportional viscosity. `point_masses` (2,) [kg] sit on the
    start and the end. `hole_compliance` adds what the spline lacks in compliance where it is held
    (`thread.compliance`). Energies: ½∫EA ε² ds + ½∫EI κ² ds (§3; straight at rest).
    """

    spline: Spline
    section: CrossSection
    bending: bool = True
    damping: float = 0.0
    point_masses: tuple[float, float] = (0.0, 0.0)
    elastic_points: int = ELASTIC_POINTS
    hole_compliance: bool = True

    def __post_init__(self) -> None:
        if not self.damping >= 0.0:
            raise ThreadError(f"damping: {self.damping} 1/s; allowed are numbers from 0 on")
        if not min(self.point_masses) >= 0.0:
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
        """Gauss rule of the bending energy."""
        return gauss_rule(self.spline, self.elastic_points)

    @cached_property
    def axial_rule(self) -> Rule:
        """Rule of the stretching energy: the middle of each span, and the Gauss points of the two end spans, of a
        span that begins at a repeated knot, and of one that ends at a triple knot.

        A cubic cannot keep |T| = 1 all along a span whose curvature changes, and at the stiffness of a real suture a
        full rule blocks its bending (membrane locking). These are n − 1 points, as many as T has functions, so nothing
        stretches unseen either; their weights integrate each of those functions exactly, so a uniform tension is in
        equilibrium on any knots. The single point is written as two equal ones, to keep one shape for all spans.

        Between those points |T| may still fall to nothing, and a hole that imposes a sharp turn would find that out
        (T·u = 0 holds for T = 0): `crushing_energy`, on the rule of the bending, is against it.
        """
        spline, full = self.spline, self.elastic_rule
        breaks, repeats = np.unique(spline.knots, return_counts=True)
        single = ((repeats[:-1] == 1) & (repeats[1:] < LOCAL - 1))[:, None]
        s = np.where(single, 0.5 * (breaks[:-1] + breaks[1:])[:, None], full.s)
        once = np.ones(s.shape, dtype=bool)
        once[single[:, 0], 1:] = False
        w = np.zeros(s.shape)
        w[once] = exact_weights(spline, s[once])
        w = np.where(single, w.sum(axis=1, keepdims=True) / s.shape[1], w)
        _, b = spline.basis(s.ravel())
        return Rule(s, w, b.reshape(*s.shape, LOCAL, LOCAL))

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
    def largest_mass(self) -> float:
        """Largest entry of the mass matrix [kg]."""
        return float(abs(self.mass_matrix).max())

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

    # -- at a hole ---------------------------------------------------------------------------------------------

    @cached_property
    def _patches(self) -> dict[int, tuple[float, float, Array]]:
        return {}

    def missing_compliance(self, s: Array, b: Array) -> Array:
        """Compliance that the spline lacks at the abscissae `s` (m,) [m], with its derivatives by s.

        `b` (m, 4, 4): the basis there. Shape `(m, 3 derivatives, 3)`: displacement by force [m/N], rotation by force
        [1/N], rotation by couple [1/(N m)]. Zero without bending, or without `hole_compliance`.
        """
        out = np.zeros((len(s), 3, 3))
        if self.EI == 0.0 or not self.hole_compliance:
            return out
        for k, span in enumerate(self.spline.spans_of(s).tolist()):
            if span not in self._patches:
                self._patches[span] = patch_of(self.spline, span)
            low, high, inverse = self._patches[span]
            if low < s[k] < high:
                lack = beam_compliance(s[k] - low, high - low) - spline_compliance(b[k], inverse)
                out[k] = lack / self.EI
        return out

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
        """Rows from the four points of a span to T and T' of the bending and T of the stretch, `(spans, 3g, 4)`."""
        bending, axial = self.elastic_rule.b, self.axial_rule.b
        return np.concatenate([bending[:, :, 1], bending[:, :, 2], axial[:, :, 1]], axis=1)

    @cached_property
    def _force_map(self) -> Array:
        """Transposed, weighted evaluation: point values of the stress to span forces, `(spans, 4, 3g)`."""
        w = np.concatenate([self.elastic_rule.w, self.elastic_rule.w, self.axial_rule.w], axis=1)
        return np.ascontiguousarray((self._evaluation * w[:, :, None]).swapaxes(1, 2))

    @cached_property
    def _tangent_map(self) -> Array:
        """Weighted b_i b_j that carry point Hessians (TT, TK, KT, KK, axial) to span matrices, `(spans, 16, 5g)`."""
        w, d1, d2 = self.elastic_rule.w, self.elastic_rule.b[:, :, 1], self.elastic_rule.b[:, :, 2]
        axial, w_axial = self.axial_rule.b[:, :, 1], self.axial_rule.w
        products = ((w, d1, d1), (w, d1, d2), (w, d2, d1), (w, d2, d2), (w_axial, axial, axial))
        maps = [np.einsum("eg,egi,egj->eijg", *product) for product in products]
        return np.ascontiguousarray(np.concatenate(maps, axis=-1).reshape(len(w), LOCAL * LOCAL, -1))

    # -- nonlinear parts ---------------------------------------------------------------------------------------

    def points(self, q: Array) -> Points:
        """Evaluate the curve at the quadrature points."""
        values, g = self._evaluation @ q[self.points_of_span], self.elastic_points
        T_axial = values[:, 2 * g :]
        return Points(values[:, :g], values[:, g : 2 * g], T_axial, axial_strain(T_axial))

    def energy(self, points: Points) -> float:
        """Elastic energy [J]."""
        stretch = self.EA * np.sum(self.axial_rule.w * points.strain**2)
        bend = self.EI * np.sum(self.elastic_rule.w * curvature_squared(points.T, points.K))
        crush = self.EA * np.sum(self.elastic_rule.w * crushing(points.T))
        return float(0.5 * (stretch + bend + crush))

    def gradient(self, points: Points) -> Array:
        """Derivative of the elastic energy by the control points, shape `(n, 3)` [N]."""
        d_T, d_K = curvature_squared_gradient(points.T, points.K)
        half = 0.5 * self.EI
        bend_T = half * d_T + 0.5 * self.EA * crushing_gradient(points.T)
        axial = self.EA * points.strain[..., None] * points.T_axial
        return self.vector(self._force_map @ np.concatenate([bend_T, half * d_K, axial], axis=1))

    def tangent(self, points: Points, N: Array) -> Array:
        """Second derivative of the elastic energy, banded `(34, 3n)` [N/m].

        `N` (spans, g) [N] is the axial force at the points of the stretch: `EA * points.strain` for the exact Hessian,
        the iterated force for the mixed-integration-point Newton.
        """
        spans, g = len(N), self.elastic_points
        H = np.empty((spans, 4 * g + N.shape[1], 3, 3))
        bending = H[:, : 4 * g].reshape(spans, 4, g, 3, 3)
        bending[:, 0], bending[:, 1], bending[:, 3] = curvature_squared_hessian(points.T, points.K)
        bending[:, 2] = bending[:, 1].swapaxes(-1, -2)
        bending *= 0.5 * self.EI
        bending[:, 0] += 0.5 * self.EA * crushing_hessian(points.T)
        H[:, 4 * g :] = axial_stiffness(points.T_axial, N, self.EA)
        return self.band((self._tangent_map @ H.reshape(spans, -1, 9)).reshape(-1, LOCAL, LOCAL, 3, 3))

    def next_axial_force(self, points: Points, dq: Array) -> Array:
        """N of the next iterate, EA (ε + T·δT): the solution of its own linearised equation N/EA = ε(q) [N]."""
        d_T = self._evaluation[:, 2 * self.elastic_points :] @ dq[self.points_of_span]
        return self.EA * (points.strain + dot(points.T_axial, d_T))
