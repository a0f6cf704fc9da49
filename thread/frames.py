"""The reference frame from which the twist of a thread is measured: its transport and its own
twist.

A section's material directions are d₁ = a₁ cos θ + a₂ sin θ and d₂ = t × d₁. The reference frame
a₁(s) follows the tangent t in time by parallel transport: at every s, a step turns the frame by the
smallest rotation from the tangent t_o at the start of the step to t (Bergou et al. 2010; Meier,
Popp & Wall 2014; θ as a fourth coordinate of a spline: Theetten, Grisoni, Andriot & Barsky 2008).
θ' is therefore not the whole twist. The frame's axial vector along s turns with the frame, and the
axial vector of the rotation itself is added. Its component along t is

    τ = τ_o − (t_o × t)·(t_o' + t') / (1 + t_o·t)

and the twist per length is ω = θ' + τ. It depends only on T, T' and θ' at the point and on the data
of the step (t_o, t_o', τ_o), so that the energies are local in the control points. θ has the same
meaning before and after the transport of the frame, and θ̇ is the spin of the section about its
tangent. At a clamped end the tangent is constant, so that θ there is the clamp's angle.

With T = ∂P/∂s, r = |T|, D = r + t_o·T, c = t_o × t_o', e = T' × t_o: τ = τ_o + c·T/D − e·T/(r D),
affine in T'.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from thread.arrays import Array, Indices
from thread.errors import ThreadError
from thread.quadrature import GaussRule
from thread.spline import Spline
from thread.vectors import IDENTITY, cross, dot, outer, reflected, transverse_part, unit_vector

LARGEST_TURN = -0.5  # cosine of the largest turn of a tangent in one step (120°); at 180° no unique rotation
SUBSTEPS = 16  # per span, in the transport along the thread at the start

# ε_ijk: the derivative of (T × t)_j by T_i is −ε_kij t_k.
LEVI_CIVITA = np.zeros((3, 3, 3))
LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
LEVI_CIVITA[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


@dataclass(frozen=True)
class Frame:
    """The reference frame at the stations of a thread, at one time.

    `t` (m, g, 3) unit tangent, `t_s` (m, g, 3) its derivative by s [1/m], `tau` (m, g) twist of the
    frame [1/m], `a_1` (m, g, 3) its first direction.
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
    """Points at which the twist is evaluated, in groups of `reach` control points from `first` (m,)
    on.

    `s` (m, g) [m] are their abscissae, and `home` (m, g) [m] identifies their piece of a cut
    thread. `w` (m, g) [m] are weights. Rows `T`, `K`, `theta`, `theta_s`, (m, g, reach) each, give
    T, T', θ and the twist of θ.
    """

    first: Indices
    s: Array
    home: Array
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
        """Return T and T' [-, 1/m], each (m, g, 3)."""
        local = q[self.points][..., :3]
        return self.T @ local, self.K @ local


def gauss_stations(spline: Spline, rule: GaussRule) -> Stations:
    """Return the stations at the points of a quadrature rule."""
    b = rule.b
    return Stations(spline.first, rule.s, rule.s, rule.w, b[:, :, 1], b[:, :, 2], b[:, :, 0], b[:, :, 1])


# -- the frame ---------------------------------------------------------------------------------------------------------


def turned(x: Array, t_o: Array, t: Array) -> Array:
    """Return `x`, normal to t_o, after the smallest rotation from the unit tangent `t_o` to `t`;
    all (..., 3).
    """
    return x - (dot(x, t) / (1.0 + dot(t_o, t)))[..., None] * (t_o + t)


def untwisted_frame(spline: Spline, stations: Stations, q: Array, towards: Array) -> Frame:
    """Return the frame without twist of a thread at rest, transported along the curve (Bishop's
    frame).

    At the start a₁ is as near as possible to the direction `towards` (3,). On each further piece of
    a cut thread, a₁ starts as near as possible to its direction at the end of the previous piece.
    Raises `ThreadError` if `towards` is along the thread.
    """
    inner = (spline.breaks[:-1, None] + np.diff(spline.breaks)[:, None] * np.arange(SUBSTEPS) / SUBSTEPS).ravel()
    a, piece = np.empty((*stations.s.shape, 3)), spline.piece_of(stations.home)
    for k, (start, end) in enumerate(pairwise(spline.piece_ends)):
        s = np.union1d(np.append(inner[(inner >= start) & (inner < end)], end), stations.s[piece == k])
        along = transported(spline, q, s, start, towards)
        a[piece == k] = along[np.searchsorted(s, stations.s[piece == k])]
        towards = along[-1]
    T, K = stations.curve(q)
    t = unit_vector(T)
    a_1 = unit_vector(transverse_part(a, t))
    return Frame(t, tangent_rate(T, K), np.zeros(stations.s.shape), a_1)


def transported(spline: Spline, q: Array, s: Array, home: float, towards: Array) -> Array:
    """Return a direction normal to the thread, transported without twist along the abscissae `s`
    (m,) [m], `(m, 3)`.

    The abscissae are on the piece that contains `home` [m]. At the first one the direction is as
    near as possible to `towards` (3,).

    The transport is by double reflection (Wang, Jüttler, Zheng & Liu 2008), of fourth order. Raises
    `ThreadError` if `towards` is along the thread.
    """
    P, T = spline.curve(q, s, np.full(s.shape, home))[..., :3].swapaxes(0, 1)[:2]
    t = unit_vector(T)
    first = towards - dot(towards, t[0]) * t[0]
    if np.linalg.norm(first) < 1e-6 * np.linalg.norm(towards):
        raise ThreadError(f"frame: {towards} lies along the thread at its start; give a direction across it")
    a = np.empty_like(t)
    a[0] = unit_vector(first)
    for k in range(len(s) - 1):
        a[k + 1] = double_reflection(P[k + 1] - P[k], t[k], t[k + 1], a[k])
    return a


def double_reflection(chord: Array, t: Array, t_next: Array, a: Array) -> Array:
    """Return `a` (3,), normal to t, transported to the end of a chord with the tangent `t_next`."""
    mirrored, a = reflected(t, chord), reflected(a, chord)
    return reflected(a, t_next - mirrored)


def tangent_rate(T: Array, K: Array) -> Array:
    """Return t' of t = T/|T| [1/m]."""
    r = np.linalg.norm(T, axis=-1, keepdims=True)
    return transverse_part(K, T / r) / r


def transport_frame(stations: Stations, frame: Frame, q: Array) -> Frame:
    """Return the frame after the thread has moved to `q` (n, c)."""
    T, K = stations.curve(q)
    t = unit_vector(T)
    a_1 = unit_vector(transverse_part(turned(frame.a_1, frame.t, t), t))
    return Frame(t, tangent_rate(T, K), reference_twist(T, K, frame), a_1)


def interpolate_frame(spline: Spline, frame: Frame, known: Stations, stations: Stations, q: Array) -> Frame:
    """Return the frame at `stations` of the curve `q`, interpolated from the stations `known` of a
    `spline`.

    The twist and the first direction are interpolated along s, on each piece of the spline.
    """
    at = lambda values: spline.interpolate(stations.s, stations.home, known.s, known.home, values)  # noqa: E731
    T, K = stations.curve(q)
    t = unit_vector(T)
    a_1 = np.stack([at(component) for component in np.moveaxis(frame.a_1, -1, 0)], axis=-1)
    return Frame(t, tangent_rate(T, K), at(frame.tau), unit_vector(transverse_part(a_1, t)))


def turns_too_far(frame: Frame, T: Array) -> bool:
    """Return whether a tangent has turned from the frame's tangent by more than the largest allowed
    turn.
    """
    return bool((dot(frame.t, unit_vector(T)) <= LARGEST_TURN).any())


# -- its twist ---------------------------------------------------------------------------------------------------------


def reference_twist(T: Array, K: Array, frame: Frame) -> Array:
    """Return τ of the frame transported to tangents T, with `K` = T' [1/m]."""
    r = np.linalg.norm(T, axis=-1)
    c, e = frame.binormal, cross(K, frame.t)
    return frame.tau + (dot(c, T) - dot(e, T) / r) / (r + dot(frame.t, T))


def reference_twist_derivatives(T: Array, K: Array, frame: Frame) -> tuple[Array, Array, Array, Array]:
    """Return ∂τ/∂T, ∂τ/∂T' (..., 3), ∂²τ/∂T∂T, ∂²τ/∂T∂T' (..., 3, 3); ∂²τ/∂T'∂T' is zero.

    With S = 1/(r D): τ − τ_o = c·T/D − S e·T, ∂S = −S g, g = t/r + h/D, ∂D = h = t_o + t.
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
