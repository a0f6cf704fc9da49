"""Stretch and bending as continuous energies, ½∫EA ε² ds + ½∫EI κ² ds (§3; Nocent & Rémion 2001), straight at rest.

The two share their evaluation, so that an iterate costs two matrix products on the whole thread.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thread.arrays import Array, Indices
from thread.energies.densities import (
    axial_stiffness,
    axial_strain,
    crushing,
    crushing_gradient,
    crushing_hessian,
    curvature_squared,
    curvature_squared_gradient,
    curvature_squared_hessian,
)
from thread.quadrature import GaussRule
from thread.spline import ORDERS
from thread.vectors import dot


@dataclass(frozen=True)
class Stretched:
    """The curve at the quadrature points of an iterate.

    `T`, `K` (spans, g, 3), first and second derivative of P at the points of the bending [-, 1/m]; `T_axial` (spans, a,
    3) and `strain` (spans, a) at those of the stretch.
    """

    T: Array
    K: Array
    T_axial: Array
    strain: Array


@dataclass(frozen=True)
class Continuous:
    """Stretch and bending energy on the spans of a spline.

    `first` (spans,): first control point of each; `bending`, `stretch`: their quadrature; `EA` [N], `EI` [N
    m²].
    """

    first: Indices
    bending: GaussRule
    stretch: GaussRule
    EA: float
    EI: float

    reach = ORDERS
    seen = 3

    @property
    def s(self) -> Array:
        """Abscissae at which the strain is known, shape `(spans, a)` [m]."""
        return self.stretch.s

    @property
    def home(self) -> Array:
        """Abscissae that tell the pieces of those of the strain: the same, shape `(spans, a)` [m]."""
        return self.stretch.s

    @cached_property
    def _points(self) -> Indices:
        return self.first[:, None] + np.arange(ORDERS)

    @cached_property
    def _evaluation(self) -> Array:
        """Rows from the four points of a span to T and T' of the bending and T of the stretch, `(spans, 2g + a, 4)`."""
        bending, axial = self.bending.b, self.stretch.b
        return np.concatenate([bending[:, :, 1], bending[:, :, 2], axial[:, :, 1]], axis=1)

    @cached_property
    def _force_map(self) -> Array:
        """Transposed, weighted evaluation: point values of the stress to span forces, `(spans, 4, 2g + a)`."""
        w = np.concatenate([self.bending.w, self.bending.w, self.stretch.w], axis=1)
        return np.ascontiguousarray((self._evaluation * w[:, :, None]).swapaxes(1, 2))

    @cached_property
    def _tangent_map(self) -> Array:
        """Weighted b_i b_j that carry point Hessians (TT, TK, KT, KK, axial) to span matrices, (spans, 16, 4g + a)."""
        w, d1, d2 = self.bending.w, self.bending.b[:, :, 1], self.bending.b[:, :, 2]
        axial, w_axial = self.stretch.b[:, :, 1], self.stretch.w
        products = ((w, d1, d1), (w, d1, d2), (w, d2, d1), (w, d2, d2), (w_axial, axial, axial))
        maps = [np.einsum("eg,egi,egj->eijg", *product) for product in products]
        return np.ascontiguousarray(np.concatenate(maps, axis=-1).reshape(len(w), ORDERS * ORDERS, -1))

    def evaluate(self, q: Array, frame: object = None) -> Stretched:
        """Evaluate the curve at the quadrature points; the bending of a round section does not need the frame."""
        values, g = (self._evaluation @ q[self._points])[..., :3], self.bending.w.shape[1]
        T_axial = values[:, 2 * g :]
        return Stretched(values[:, :g], values[:, g : 2 * g], T_axial, axial_strain(T_axial))

    def energy(self, at: Stretched) -> float:
        """Return the elastic energy [J]."""
        stretch = self.EA * np.sum(self.stretch.w * at.strain**2)
        bend = self.EI * np.sum(self.bending.w * curvature_squared(at.T, at.K))
        crush = self.EA * np.sum(self.bending.w * crushing(at.T))
        return float(0.5 * (stretch + bend + crush))

    def gradient(self, at: Stretched) -> Array:
        """Return the derivative by the control points of each span, shape `(spans, 4, 3)` [N]."""
        d_T, d_K = curvature_squared_gradient(at.T, at.K)
        half = 0.5 * self.EI
        bend_T = half * d_T + 0.5 * self.EA * crushing_gradient(at.T)
        axial = self.EA * at.strain[..., None] * at.T_axial
        return self._force_map @ np.concatenate([bend_T, half * d_K, axial], axis=1)

    def tangent(self, at: Stretched, N: Array) -> Array:
        """Return the second derivative by the control points of each span, shape `(spans, 4, 4, 3, 3)` [N/m].

        `N` (spans, a) [N] is the axial force (`thread.energies.densities.axial_stiffness`).
        """
        spans, g = len(N), self.bending.w.shape[1]
        H = np.empty((spans, 4 * g + N.shape[1], 3, 3))
        bending = H[:, : 4 * g].reshape(spans, 4, g, 3, 3)
        bending[:, 0], bending[:, 1], bending[:, 3] = curvature_squared_hessian(at.T, at.K)
        bending[:, 2] = bending[:, 1].swapaxes(-1, -2)
        bending *= 0.5 * self.EI
        bending[:, 0] += 0.5 * self.EA * crushing_hessian(at.T)
        H[:, 4 * g :] = axial_stiffness(at.T_axial, N, self.EA)
        return (self._tangent_map @ H.reshape(spans, -1, 9)).reshape(-1, ORDERS, ORDERS, 3, 3)

    def next_axial_force(self, at: Stretched, dq: Array) -> Array:
        """Return N of the next iterate, EA (ε + T·δT) [N]: the solution of the linearised equation N/EA = ε(q)."""
        d_T = (self._evaluation[:, 2 * self.bending.w.shape[1] :] @ dq[self._points])[..., :3]
        return self.EA * (at.strain + dot(at.T_axial, d_T))
