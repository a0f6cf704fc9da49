"""Twist of the thread: the material frame measured from a frame that is carried along without spinning.

A section's material directions are d₁ = a₁ cos θ + a₂ sin θ and d₂ = t × d₁, with a₁(s) a reference frame that follows
the tangent t in time by parallel transport: at every s, a step turns it by the smallest rotation that takes the tangent
t_o at the start of the step to t (Bergou et al. 2010; Meier, Popp & Wall 2014; θ as a fourth coordinate of a spline:
Theetten, Grisoni, Andriot & Barsky 2008). So θ' is not the whole twist. The frame's axial vector along s turns with it
and gains that of the rotation itself; its component along t is

    τ = τ_o − (t_o × t)·(t_o' + t') / (1 + t_o·t)

and the twist per length is ω = θ' + τ. Nothing but T, T' and θ' at the point enters, and the data of the step (t_o,
t_o', τ_o): the energies are local in the control points. θ means the same before and after the frame is carried, and
θ̇ is the spin of the section about its tangent. At a clamped end the tangent rests, so θ there is the clamp's angle.

With T = ∂P/∂s, r = |T|, D = r + t_o·T, c = t_o × t_o', e = T' × t_o:   τ = τ_o + c·T/D − e·T/(r D),  affine in T'.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thread.energy import IDENTITY, cross, dot, outer
from thread.errors import ThreadError
from thread.quadrature import Rule
from thread.spline import Array, Indices, Spline

LARGEST_TURN = -0.5  # cosine of the largest turn of a tangent in one step (120°): at 180° no rotation is the smallest
SUBSTEPS = 16  # of a span in the transport along the thread at the start

# ε_ijk: the derivative of (T × t)_j by T_i is −ε_kij t_k.
LEVI_CIVITA = np.zeros((3, 3, 3))
LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
LEVI_CIVITA[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


@dataclass(frozen=True)
class Frame:
    """The reference frame at the stations of a thread, at one time.

    `t` (m, g, 3) unit tangent, `t_s` (m, g, 3) its derivative by s [1/m], `tau` (m, g) twist of the frame [1/m], `a_1`
    (m, g, 3) its first direction.
    """

    t: Array
    t_s: Array
    tau: Array
    a_1: Array

    @cached_property
    def binormal(self) -> Array:
        """c = t × t' [1/m]."""
        return cross(self.t, self.t_s)


@dataclass(frozen=True)
class Stations:
    """Places where the twist is taken: `reach` control points each group from `first` (m,) on, weights `w` (m, g) [m].

    `s` (m, g) [m]; rows `T`, `K`, `theta`, `theta_s`, each (m, g, reach), give T, T', θ and the twist of θ.
    """

    first: Indices
    s: Array
    w: Array
    T: Array
    K: Array
    theta: Array
    theta_s: Array

    @property
    def reach(self) -> int:
        """Control points of a group."""
        return self.T.shape[2]

    @cached_property
    def points(self) -> Indices:
        """Control points of each group, shape `(m, reach)`."""
        return self.first[:, None] + np.arange(self.reach)

    @cached_property
    def rows(self) -> Array:
        """All rows below one another, shape `(m, 4g, reach)`."""
        return np.concatenate([self.T, self.K, self.theta, self.theta_s], axis=1)

    def curve(self, q: Array) -> tuple[Array, Array]:
        """T and T' [-, 1/m], each (m, g, 3)."""
        local = q[self.points][..., :3]
        return self.T @ local, self.K @ local


def gauss_stations(spline: Spline, rule: Rule) -> Stations:
    """Stations at the points of a quadrature rule."""
    return Stations(spline.first, rule.s, rule.w, rule.b[:, :, 1], rule.b[:, :, 2], rule.b[:, :, 0], rule.b[:, :, 1])


# -- the frame ---------------------------------------------------------------------------------------------------------


def turned(x: Array, t_o: Array, t: Array) -> Array:
    """`x` across t_o after the smallest rotation that takes the unit tangent `t_o` to `t`; all (..., 3)."""
    return x - (dot(x, t) / (1.0 + dot(t_o, t)))[..., None] * (t_o + t)


def unit(x: Array) -> Array:
    """x/|x| over the last axis."""
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def untwisted(spline: Spline, stations: Stations, q: Array, towards: Array) -> Frame:
    """The frame without twist of a thread at rest, carried along the curve from its start (Bishop's frame), where a₁
    points `towards` (3,) as nearly as it can.

    The transport along s is by double reflection (Wang, Jüttler, Zheng & Liu 2008), of fourth order. Raises
    `ThreadError` where `towards` is along the thread.
    """
    inner = (spline.breaks[:-1, None] + np.diff(spline.breaks)[:, None] * np.arange(SUBSTEPS) / SUBSTEPS).ravel()
    s = np.union1d(np.append(inner, spline.end), stations.s)
    P, T = spline.curve(q, s)[..., :3].swapaxes(0, 1)[:2]
    t = unit(T)
    first = towards - dot(towards, t[0]) * t[0]
    if np.linalg.norm(first) < 1e-6 * np.linalg.norm(towards):
        raise ThreadError(f"frame: {towards} lies along the thread at its start; give a direction across it")
    a = np.empty_like(t)
    a[0] = unit(first)
    for k in range(len(s) - 1):
        a[k + 1] = double_reflection(P[k + 1] - P[k], t[k], t[k + 1], a[k])
    T, K = stations.curve(q)
    t = unit(T)
    return Frame(t, tangent_rate(T, K), np.zeros(stations.s.shape), unit(across(a[np.searchsorted(s, stations.s)], t)))


def double_reflection(chord: Array, t: Array, t_next: Array, a: Array) -> Array:
    """`a` (3,) across t, carried to the end of a chord where the tangent is `t_next`."""
    mirrored, a = reflected(t, chord), reflected(a, chord)
    return reflected(a, t_next - mirrored)


def reflected(x: Array, normal: Array) -> Array:
    """Mirror image in the plane across `normal`; x itself where that is zero."""
    square = normal @ normal
    return x - 2.0 * (normal @ x) / square * normal if square > 0.0 else x


def across(x: Array, t: Array) -> Array:
    """The part of x across the unit vector t."""
    return x - dot(x, t)[..., None] * t


def tangent_rate(T: Array, K: Array) -> Array:
    """t' of t = T/|T| [1/m]."""
    r = np.linalg.norm(T, axis=-1, keepdims=True)
    return across(K, T / r) / r


def carried(stations: Stations, frame: Frame, q: Array) -> Frame:
    """The frame after the thread has gone to `q`."""
    T, K = stations.curve(q)
    t = unit(T)
    a_1 = unit(across(turned(frame.a_1, frame.t, t), t))
    return Frame(t, tangent_rate(T, K), reference_twist(T, K, frame), a_1)


def moved(frame: Frame, known: Stations, stations: Stations, q: Array) -> Frame:
    """The frame at other stations of the curve `q`: its twist and first direction interpolated along s."""
    at = lambda values: np.interp(stations.s, known.s.ravel(), values.ravel())  # noqa: E731
    T, K = stations.curve(q)
    t = unit(T)
    a_1 = np.stack([at(component) for component in np.moveaxis(frame.a_1, -1, 0)], axis=-1)
    return Frame(t, tangent_rate(T, K), at(frame.tau), unit(across(a_1, t)))


def turned_too_far(frame: Frame, T: Array) -> bool:
    """Whether a tangent has turned so far from the frame's that the smallest rotation is in doubt."""
    return bool((dot(frame.t, unit(T)) <= LARGEST_TURN).any())


# -- its twist ---------------------------------------------------------------------------------------------------------


def reference_twist(T: Array, K: Array, frame: Frame) -> Array:
    """τ of the frame carried to tangents T, with `K` = T' [1/m]."""
    r = np.linalg.norm(T, axis=-1)
    c, e = frame.binormal, cross(K, frame.t)
    return frame.tau + (dot(c, T) - dot(e, T) / r) / (r + dot(frame.t, T))


def reference_twist_derivatives(T: Array, K: Array, frame: Frame) -> tuple[Array, Array, Array, Array]:
    """∂τ/∂T, ∂τ/∂T' (..., 3), ∂²τ/∂T∂T, ∂²τ/∂T∂T' (..., 3, 3); ∂²τ/∂T'∂T' is zero.

    With S = 1/(r D): τ − τ_o = c·T/D − S e·T,  ∂S = −S g,  g = t/r + h/D,  ∂D = h = t_o + t.
    """
    t_o, r = frame.t, np.linalg.norm(T, axis=-1)[..., None]
    t = T / r
    D, h = r + dot(t_o, T)[..., None], t_o + t
    S, g = 1.0 / (r * D), t / r + h / D
    c, e = frame.binormal, cross(K, t_o)
    cT, eT = dot(c, T)[..., None], dot(e, T)[..., None]
    Txt = cross(T, t_o)
    by_T = S * (eT * g - e) + c / D - (cT / D**2) * h
    S, cT, eT, r, D = (x[..., None] for x in (S, cT, eT, r, D))
    plane = IDENTITY - outer(t, t)
    dg = (plane - outer(t, t)) / r**2 + plane / (r * D) - outer(h, h) / D**2
    ge, ch = outer(g, e), outer(c, h)
    TT = eT * S * (dg - outer(g, g)) + S * (ge + ge.swapaxes(-1, -2))
    TT += (cT * (2.0 * outer(h, h) / D - plane / r) - (ch + ch.swapaxes(-1, -2))) / D**2
    spin = (t_o @ LEVI_CIVITA.reshape(3, 9)).reshape(*T.shape, 3)
    return by_T, S[..., 0] * Txt, TT, -S * (outer(g, Txt) + spin)


@dataclass(frozen=True)
class Twisted:
    """A thread with twist at its stations: `T`, `K` (m, g, 3), `omega` (m, g) twist [1/m], `theta` (m, g) [rad], and
    the `frame` it is measured from."""

    T: Array
    K: Array
    omega: Array
    theta: Array
    frame: Frame

    @cached_property
    def slopes(self) -> tuple[Array, Array, Array, Array]:
        """Derivatives of the frame's twist, which force and tangent share."""
        return reference_twist_derivatives(self.T, self.K, self.frame)


def evaluated(stations: Stations, q: Array, frame: Frame | None) -> Twisted:
    """The thread `q` (n, 4) at its stations. Raises `ThreadError` without a frame."""
    if frame is None:
        raise ThreadError("a thread with twist has no shape of its own: give the frame it is measured from")
    values, g = stations.rows @ q[stations.points], stations.w.shape[1]
    T, K = values[:, :g, :3], values[:, g : 2 * g, :3]
    omega = values[:, 3 * g :, 3] + reference_twist(T, K, frame)
    return Twisted(T, K, omega, values[:, 2 * g : 3 * g, 3], frame)


def spread_gradient(stations: Stations, rows: tuple[Array, ...], by: tuple[Array, ...]) -> Array:
    """Vectors of the groups (m, reach, 4) from derivatives by (T, T', a quantity of θ); the last of `rows` is θ's."""
    out = np.empty((len(stations.first), stations.reach, 4))
    w = stations.w[..., None]
    out[..., :3] = rows[0].swapaxes(1, 2) @ (w * by[0]) + rows[1].swapaxes(1, 2) @ (w * by[1])
    out[..., 3] = np.einsum("eg,egi->ei", stations.w * by[2], rows[2])
    return out


def spread_hessian(stations: Stations, rows: tuple[Array, ...], H: Array) -> Array:
    """Matrices of the groups (m, reach, reach, 4, 4) from second derivatives by (T, T', a quantity of θ), (m, g, 7, 7).

    Each of the seven is a row of one of the four coordinates.
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
    """What the energies of a twisted thread share: where they are taken, and on which control points."""

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

    def at(self, q: Array, frame: Frame | None) -> Twisted:
        """Evaluate the thread at the stations."""
        return evaluated(self.stations, q, frame)


@dataclass(frozen=True)
class Torsion(OnStations):
    """Torsional energy ½∫GJ ω² ds of a round section; `GJ` [N m²]."""

    GJ: float

    @cached_property
    def _rows(self) -> tuple[Array, ...]:
        return self.stations.T, self.stations.K, self.stations.theta_s

    def energy(self, at: Twisted) -> float:
        """Elastic energy [J]."""
        return float(0.5 * self.GJ * np.sum(self.stations.w * at.omega**2))

    def gradient(self, at: Twisted) -> Array:
        """Derivative by the control points of each group, shape `(m, reach, 4)` [N, N m]."""
        by_T, by_K, _, _ = at.slopes
        torque = self.GJ * at.omega
        return spread_gradient(self.stations, self._rows, (torque[..., None] * by_T, torque[..., None] * by_K, torque))

    def tangent(self, at: Twisted, N: Array) -> Array:
        """Second derivative by the control points of each group, shape `(m, reach, reach, 4, 4)`."""
        by_T, by_K, TT, TK = at.slopes
        by = np.concatenate([by_T, by_K, np.ones_like(by_T[..., :1])], axis=-1)
        H = self.GJ * outer(by, by)
        torque = (self.GJ * at.omega)[..., None, None]
        H[..., :3, :3] += torque * TT
        H[..., :3, 3:6] += torque * TK
        H[..., 3:6, :3] += torque * TK.swapaxes(-1, -2)
        return spread_hessian(self.stations, self._rows, H)
