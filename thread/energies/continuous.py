"""Stretch and bending as continuous energies, by the formulas of `thread.kernels.curve`."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thread.arrays import Array, Indices
from thread.kernels.curve import Curve, Stretched, energy_of, evaluated, force_of, gradient_of, tangent_of
from thread.quadrature import GaussRule
from thread.spline import ORDERS


@dataclass(frozen=True)
class Continuous:
    """Stretch and bending energy on the spans of a spline.

    `first` (spans,): first control point of each span. `bending` and `stretch`: their quadrature.
    `holes`: the ends of the spans with half of each span if a hole is there, else zero
    (`thread.kernels.curve.barrier`). `EA` [N], `EI` [N m²]. `natural`: the natural strain of each
    span and its excess at the ends, as in `thread.kernels.curve.Curve`; None: zero.
    """

    first: Indices
    bending: GaussRule
    stretch: GaussRule
    holes: GaussRule
    EA: float
    EI: float
    natural: tuple[Array, Array] | None = None

    reach = ORDERS
    seen = 3

    @property
    def s(self) -> Array:
        """Abscissae of the strain, shape `(spans, a)` [m]."""
        return self.stretch.s

    @property
    def home(self) -> Array:
        """Abscissae in the middle of the spans, which identify the piece of each strain, shape
        `(spans, a)` [m].
        """
        return np.broadcast_to(self.bending.s.mean(axis=1, keepdims=True), self.stretch.s.shape)

    @cached_property
    def curve(self) -> Curve:
        """The elastic thread in the form of the kernels."""
        plain = lambda x: np.ascontiguousarray(x, dtype=float)  # noqa: E731
        bending, stretch = self.bending, self.stretch
        slope, bend, axial_slope = plain(bending.b[:, :, 1]), plain(bending.b[:, :, 2]), plain(stretch.b[:, :, 1])
        first = self.first.astype(np.int64)
        natural, natural_slope = self.natural or (np.zeros(len(first)), np.zeros((len(first), 2)))
        return Curve(
            first,
            slope,
            bend,
            plain(bending.w),
            axial_slope,
            plain(stretch.w),
            plain(self.holes.b[:, :, 1]),
            plain(self.holes.w),
            plain(natural),
            plain(natural_slope),
            float(self.EA),
            float(self.EI),
        )

    def evaluate(self, q: Array, frame: object = None) -> Stretched:
        """Return the curve at the quadrature points; the bending of a round section does not need
        the frame.
        """
        bent, stretched = self.curve.w.shape, self.curve.axial_w.shape
        T, K, T_axial, T_edge = (np.empty((*shape, 3)) for shape in (bent, bent, stretched, self.holes.w.shape))
        at = Stretched(T, K, T_axial, np.empty(stretched), T_edge)
        evaluated(self.curve, np.ascontiguousarray(q), at)
        return at

    def energy(self, at: Stretched) -> float:
        """Return the elastic energy [J]."""
        return float(energy_of(self.curve, at))

    def gradient(self, at: Stretched) -> Array:
        """Return the derivative by the control points of each span, shape `(spans, 4, 3)` [N]."""
        F = np.zeros((len(self.first), ORDERS, 3))
        gradient_of(self.curve, at, F)
        return F

    def tangent(self, at: Stretched, N: Array) -> Array:
        """Return the second derivative by the control points of each span, shape `(spans, 4, 4, 3,
        3)` [N/m].

        `N` (spans, a) [N] is the axial force, an unknown of the iteration.
        """
        band, H = np.zeros((len(N), ORDERS, 3, 3 * ORDERS)), np.empty((len(N), ORDERS, ORDERS, 3, 3))
        tangent_of(self.curve, at, np.ascontiguousarray(N), band)
        for i in range(ORDERS):
            for j in range(i, ORDERS):
                H[:, i, j] = band[:, i, :, 3 * (j - i) : 3 * (j - i) + 3]
                H[:, j, i] = H[:, i, j].swapaxes(1, 2)
        return H

    def next_axial_force(self, at: Stretched, dq: Array) -> Array:
        """Return N of the next iterate, EA (ε + T·δT) [N]: the solution of the linearised equation
        N/EA = ε(q).
        """
        N = np.empty_like(at.strain)
        force_of(self.curve, at, np.ascontiguousarray(dq), N)
        return N
