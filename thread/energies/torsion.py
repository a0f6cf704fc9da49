"""Torsional energy of the thread, from the twist per length ω = θ' + τ (`thread.frames`).

`OnStations` is the common part of the energies of a twisted thread. It evaluates the thread at its
stations, and distributes derivatives by T, T' and a quantity of θ to the control points.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thread.arrays import Array, Indices
from thread.errors import ThreadError
from thread.frames import Frame, Stations, reference_twist, reference_twist_derivatives
from thread.vectors import outer


@dataclass(frozen=True)
class Twisted:
    """A thread with twist at its stations.

    `T`, `K` (m, g, 3), `omega` (m, g) twist [1/m], `theta` (m, g) [rad], and the `frame` from which
    θ is measured.
    """

    T: Array
    K: Array
    omega: Array
    theta: Array
    frame: Frame

    @cached_property
    def slopes(self) -> tuple[Array, Array, Array, Array]:
        """Derivatives of the frame's twist, used by force and tangent."""
        return reference_twist_derivatives(self.T, self.K, self.frame)


def evaluate(stations: Stations, q: Array, frame: Frame | None) -> Twisted:
    """Return the thread `q` (n, 4) at its stations. Raises `ThreadError` if `frame` is None."""
    if frame is None:
        raise ThreadError("the shape of a thread with twist is not defined without a frame; give the frame")
    values, g = stations.rows @ q[stations.points], stations.w.shape[1]
    T, K = values[:, :g, :3], values[:, g : 2 * g, :3]
    omega = values[:, 3 * g :, 3] + reference_twist(T, K, frame)
    return Twisted(T, K, omega, values[:, 2 * g : 3 * g, 3], frame)


def spread_gradient(stations: Stations, rows: tuple[Array, ...], by: tuple[Array, ...]) -> Array:
    """Return vectors of the groups (m, reach, 4) from derivatives by (T, T', a quantity of θ).

    The last of `rows` belongs to the quantity of θ.
    """
    out = np.empty((len(stations.first), stations.reach, 4))
    w = stations.w[..., None]
    out[..., :3] = rows[0].swapaxes(1, 2) @ (w * by[0]) + rows[1].swapaxes(1, 2) @ (w * by[1])
    out[..., 3] = np.einsum("eg,egi->ei", stations.w * by[2], rows[2])
    return out


def spread_hessian(stations: Stations, rows: tuple[Array, ...], H: Array) -> Array:
    """Return matrices of the groups (m, reach, reach, 4, 4) from second derivatives by (T, T', a
    quantity of θ).

    `H` (m, g, 7, 7): each of the seven is a row of one of the four coordinates.
    """
    m, g = stations.w.shape
    local = np.zeros((m, g, 7, stations.reach, 4))
    for axis in range(3):
        local[:, :, axis, :, axis] = rows[0]
        local[:, :, 3 + axis, :, axis] = rows[1]
    local[:, :, 6, :, 3] = rows[2]
    B = local.reshape(m, g, 7, -1)
    weighted = (stations.w[..., None, None] * H) @ B
    full = B.reshape(m, g * 7, -1).swapaxes(1, 2) @ weighted.reshape(m, g * 7, -1)
    return full.reshape(m, stations.reach, 4, stations.reach, 4).swapaxes(2, 3)


@dataclass(frozen=True)
class OnStations:
    """The common part of the energies of a twisted thread: their stations and control points."""

    stations: Stations

    seen = 4

    @property
    def first(self) -> Indices:
        """First control point of each group, shape `(m,)`."""
        return self.stations.first

    @property
    def reach(self) -> int:
        """Control points of a group."""
        return self.stations.reach

    def evaluate(self, q: Array, frame: Frame | None) -> Twisted:
        """Return the thread at the stations."""
        return evaluate(self.stations, q, frame)


@dataclass(frozen=True)
class Torsion(OnStations):
    """Torsional energy ½∫GJ ω² ds of a round section; `GJ` [N m²]."""

    GJ: float

    @cached_property
    def _rows(self) -> tuple[Array, ...]:
        return self.stations.T, self.stations.K, self.stations.theta_s

    def energy(self, at: Twisted) -> float:
        """Return the elastic energy [J]."""
        return float(0.5 * self.GJ * np.sum(self.stations.w * at.omega**2))

    def gradient(self, at: Twisted) -> Array:
        """Return the derivative by the control points of each group, shape `(m, reach, 4)` [N, N
        m].
        """
        by_T, by_K, _, _ = at.slopes
        torque = self.GJ * at.omega
        return spread_gradient(self.stations, self._rows, (torque[..., None] * by_T, torque[..., None] * by_K, torque))

    def tangent(self, at: Twisted, N: Array) -> Array:
        """Return the second derivative by the control points of each group, shape `(m, reach,
        reach, 4, 4)`.
        """
        by_T, by_K, TT, TK = at.slopes
        by = np.concatenate([by_T, by_K, np.ones_like(by_T[..., :1])], axis=-1)
        H = self.GJ * outer(by, by)
        torque = (self.GJ * at.omega)[..., None, None]
        H[..., :3, :3] += torque * TT
        H[..., :3, 3:6] += torque * TK
        H[..., 3:6, :3] += torque * TK.swapaxes(-1, -2)
        return spread_hessian(self.stations, self._rows, H)
