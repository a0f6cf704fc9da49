"""Sliding point and sliding direction (eqs. 4, 8, 9) with their derivatives, all piercings at once.

Per piercing the thread offers P, T = ∂P/∂s, T' and T'' at the abscissa s; the organ offers y = (x, u, v). Multipliers
are λ (3) [N] and μ_u, μ_v [N m] in one array `lam`, shape `(p, 5)`. Constraints return rows over these few numbers
and never see the global matrix:

    g = P(s) − x,   c₁ = T·u,   c₂ = T·v

The spline lacks compliance where a force λ and m = μ_u u + μ_v v, the force conjugate to T, act on it
(`thread.compliance`): c₀ by the force across the thread, c₁, c₂ by m. Along itself it lacks next to nothing. With the
axis a = T, â = a/|a|, τ = λ·â and n̂ the unit normal of the frame, u × v over its size, the hole acts on the thread at

    P̂ = P + c₀ (λ − τâ) + c₁|a| m,   T̂ = T + c₁|a| λ + c m,   c = c₂ + c₃ (Γ − 1),
    Γ = |a|²γ,   γ = ½(1 + ψ)·½(1 + √(½(1 + ψ))),   ψ = |â·n̂|,

which stand for P, T in Φ. They are the slopes by λ and m of one potential,

    λ·(P − x) + m·T + ½c₀(λ² − τ²) + c₁|a| λ·m + ½c m²,

whose slopes by q, s and y are the forces on thread and abscissa and on the organ. It does not change when all turn
together: λ along the thread, which acts at P̂ and not at P, turns the thread's tangent by the force conjugate to a,
w = −c₀ τ (λ − τâ)/|a|. It does not turn the hole: the strands on both sides of it go through the hole, and not through
P, which is the further from it the longer the spans.

Where spans are much longer than √(EI/T), T leaves n̂ by an angle φ, that by which the strands do on the mean, and c₂ is
all that turns it. What the hole bears is then the elastica's: strands turned by φ + ½θ and φ − ½θ bear together

    2√(EI T) (sin ½(φ + ½θ) + sin ½(φ − ½θ)) = 2 sin ½φ/g,   1/g = 2√(EI T) cos ¼θ,

the slope of 4(1 − cos ½φ)/g; `coupling.step.tension` counts the cosine of ¼θ to √(EI T). With |a|m for the couple and
c = g|a|²γ the potential stores ½ sin²φ/(gγ): that is the same where γ = cos²½φ cos²¼φ. On shorter spans the spline
makes part of the turn itself. The share c₃ of c₂ is what then turns as far as the elastica does (`thread.compliance`),
and the rest is of small turns. What Γ adds to the forces is e ∂Γ, with e = ½c₃m²: it turns the thread and the frame and
draws the thread out, whose corner the spline rounds, |a| < 1. The frame it does not stretch: n̂ is a direction alone,
for the frame of a linear organ that turns far is longer than it was. c₁ goes by the couple too: a turn moves T by |a|
times itself.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coupling.arrays import Array, Indices
from thread.compliance import LACKS
from thread.spline import Spline
from thread.thread import Thread
from thread.vectors import cross, dot


@dataclass(frozen=True)
class Passage:
    """The thread where it passes the holes.

    `first` (p,) and `b` (p, 4, 4): the basis there; `P` [m], `T` [-], `K` = T' [1/m], `J` = T'' [1/m²], each (p, 3);
    `c` (p, 3 derivatives by s, 4): the missing compliances c₀, c₁, c₂, c₃ [m/N, 1/N, 1/(N m) twice]; `directed` (p,):
    where the hole's frame tells where the thread goes at the hole, and not the thread itself.
    """

    first: Indices
    b: Array
    P: Array
    T: Array
    K: Array
    J: Array
    c: Array
    directed: NDArray[np.bool_]

    @cached_property
    def bare(self) -> bool:
        """Whether the spline lacks nothing."""
        return not self.c.any()

    @cached_property
    def _split(self) -> list[tuple[Array, "Parts"]]:
        """What `parts` made last: a residual and its tangent ask a dozen times for the same."""
        return []

    @cached_property
    def _tilted(self) -> list[tuple[Array, "Tilt"]]:
        """What `tilt_of` made last, likewise."""
        return []


LOCAL = np.arange(4)
LOCAL_UNKNOWNS = 3 * LOCAL[:, None] + np.arange(3)  # of the four points on a span, from the first point's on


def passage(
    thread: Thread,
    q: Array,
    s: Array,
    directed: NDArray[np.bool_],
    home: Array | None = None,
    layers: Array | None = None,
) -> Passage:
    """Evaluate the thread with control values `q` (n, c) at the abscissae `s` (p,) [m], on the pieces of a cut thread
    that hold the abscissae `home` where they are given; `directed` (p,): holes that impose a direction;
    `layers` (p,) [m], √(EI/T) there, None without tension."""
    bare = bare_passage(thread.spline, q, s, home)
    return replace(bare, c=thread.missing_compliance(s, home, layers), directed=directed)


def bare_passage(spline: Spline, q: Array, s: Array, home: Array | None = None) -> Passage:
    """Evaluate the thread without the missing compliance: of rates, and under impulses, which a compliance without
    mass does not answer."""
    first, b = spline.basis(s, home)
    D = (b @ q[first[:, None] + LOCAL])[..., :3]
    none = np.zeros(len(s), dtype=bool)
    return Passage(first, b, D[:, 0], D[:, 1], D[:, 2], D[:, 3], np.zeros((len(s), 3, LACKS)), none)


def force_on_tangent(lam: Array, y: Array) -> Array:
    """Return m = μ_u u + μ_v v, the force conjugate to T, shape `(p, 3)` [N m]."""
    return lam[:, 3:4] * y[:, 3:6] + lam[:, 4:5] * y[:, 6:]


@dataclass(frozen=True)
class Parts:
    """λ along and across the thread: `unit` â (p, 3) and `size` |a| (p,) of the axis, `along` τ = λ·â (p,) and
    `across` λ − τâ (p, 3) [N]."""

    unit: Array
    size: Array
    along: Array
    across: Array


def parts(thread: Passage, lam: Array) -> Parts:
    """Split the force of each hole into its parts along and across the thread, remembered for the array asked last."""
    for known_lam, known in thread._split:
        if known_lam is lam:
            return known
    size = np.linalg.norm(thread.T, axis=1)
    unit = thread.T / size[:, None]
    along = dot(lam[:, :3], unit)
    part = Parts(unit, size, along, lam[:, :3] - along[:, None] * unit)
    thread._split[:] = [(lam, part)]
    return part


@dataclass(frozen=True)
class Tilt:
    """How far the thread leaves the frames: ψ = |â·n̂|, `cosine` (p,) [-]; Γ = |T|²γ, `share` (p,) [-], and its
    derivatives by T and by n = u × v, `by_T` and `by_n` (p, 3) [-]; γ with its first two derivatives by ψ, `profile`,
    `(p, 1)` each; the unit vectors `along` â and `normal` n̂, pointing as the thread goes, (p, 3), with `size` |T| and
    `area` ±|n|, below zero where n points against the thread, (p, 1)."""

    cosine: Array
    share: Array
    by_T: Array
    by_n: Array
    profile: tuple[Array, Array, Array]
    along: Array
    normal: Array
    size: Array
    area: Array

    @property
    def of_along(self) -> Array:
        """|T| ∂ψ/∂T = n̂ − ψâ, shape `(p, 3)` [-]."""
        return self.normal - self.cosine[:, None] * self.along

    @property
    def of_normal(self) -> Array:
        """±|n| ∂ψ/∂n = â − ψn̂, shape `(p, 3)` [-]."""
        return self.along - self.cosine[:, None] * self.normal


def tilt_of(thread: Passage, y: Array) -> Tilt:
    """Return how far the thread leaves the frames, remembered for the array asked last."""
    for known_y, known in thread._tilted:
        if known_y is y:
            return known
    n, size = cross(y[:, 3:6], y[:, 6:]), np.linalg.norm(thread.T, axis=1, keepdims=True)
    area = np.copysign(np.linalg.norm(n, axis=1), dot(thread.T, n))[:, None]
    along, normal = thread.T / size, n / area
    cosine = dot(along, normal)[:, None]
    profile = far_turned(cosine)
    by_T = size * (2.0 * profile[0] * along + profile[1] * (normal - cosine * along))
    by_n = size**2 / area * profile[1] * (along - cosine * normal)
    tilt = Tilt(cosine[:, 0], (size**2 * profile[0])[:, 0], by_T, by_n, profile, along, normal, size, area)
    thread._tilted[:] = [(y, tilt)]
    return tilt


def far_turned(cosine: Array) -> tuple[Array, Array, Array]:
    """Return γ = ½(1 + ψ)·½(1 + √(½(1 + ψ))) and its first two derivatives by ψ, `cosine`, of the same shape each."""
    squared = 0.5 * (1.0 + cosine)  # cos²½φ
    half = np.sqrt(squared)
    return 0.5 * squared * (1.0 + half), 0.25 * (1.0 + 1.5 * half), 0.09375 / half


def turned_compliance(thread: Passage, y: Array, derivative: int = 0) -> Array:
    """Return c = c₂ + c₃(Γ − 1), or its derivative by s with T held, shape `(p,)` [1/(N m)]."""
    return np.asarray(thread.c[:, derivative, 2] + thread.c[:, derivative, 3] * (tilt_of(thread, y).share - 1.0))


def tilt_force(thread: Passage, lam: Array, y: Array, derivative: int = 0) -> Array:
    """Return e = ½c₃m², the force conjugate to Γ, or its derivative by s, shape `(p, 1)` [N m]."""
    m = force_on_tangent(lam, y)
    return np.asarray(0.5 * thread.c[:, derivative, 3] * dot(m, m))[:, None]


def axis_force(thread: Passage, part: Parts, derivative: int = 0) -> Array:
    """Return w = −c₀ τ (λ − τâ)/|a| conjugate to a, or its derivative by s with a held, shape `(p, 3)` [N m]."""
    return -(thread.c[:, derivative, 0] * part.along / part.size)[:, None] * part.across


def axis_turned(part: Parts, da: Array) -> Array:
    """Return the change of τâ as the axis changes by `da` (p, 3), shape `(p, 3)` [N]."""
    along_a = dot(part.unit, da)[:, None] * part.unit
    turned = dot(part.across, da)[:, None] * part.unit + part.along[:, None] * (da - along_a)
    return turned / part.size[:, None]


def effective_place(thread: Passage, lam: Array, y: Array, derivative: int = 0) -> tuple[Array, Array]:
    """Return P̂ and T̂, the place and the tangent at which a hole meets the thread, or their first derivatives by s
    at constant multipliers, each `(p, 3)`."""
    P, T = (thread.P, thread.T, thread.K)[derivative : derivative + 2]
    if thread.bare:
        return P, T
    c, m, part = thread.c[:, derivative, :, None], force_on_tangent(lam, y), parts(thread, lam)
    arm = c[:, 1] * part.size[:, None]
    if derivative:
        arm = arm + thread.c[:, 0, 1:2] * dot(part.unit, thread.K)[:, None]
    P_met = P + c[:, 0] * part.across + arm * m
    T_met = T + arm * lam[:, :3] + turned_compliance(thread, y, derivative)[:, None] * m
    if derivative:
        P_met -= thread.c[:, 0, :1] * axis_turned(part, thread.K)
        T_met += (thread.c[:, 0, 3] * dot(tilt_of(thread, y).by_T, thread.K))[:, None] * m
    return P_met, T_met


def held_energy(thread: Passage, lam: Array, y: Array, derivative: int = 0) -> Array:
    """Return what the missing compliance stores, ½c₀(λ² − τ²) + c₁|a|λ·m + ½c m², or its derivative by s with T held,
    shape `(p,)` [J]."""
    c, m, part = thread.c[:, derivative], force_on_tangent(lam, y), parts(thread, lam)
    alone = c[:, 0] * dot(part.across, part.across) + turned_compliance(thread, y, derivative) * dot(m, m)
    return np.asarray(0.5 * alone + c[:, 1] * part.size * dot(lam[:, :3], m))


def shrinkage(thread: Passage, part: Parts) -> Array:
    """Return 1 − c₀ (λ − τâ)·T'/|T|², shape `(p,)` [-]: the length of a bent thread at P̂, on its inner side, over
    that at P."""
    return 1.0 - thread.c[:, 0, 0] * dot(part.across, thread.K) / dot(thread.T, thread.T)


def tangent(thread: Passage, lam: Array, y: Array) -> tuple[Array, Array]:
    """Return |T̂| and the unit tangent t = T̂/|T̂| of the thread at P̂, shapes `(p,)` and `(p, 3)` [-]. Where a
    direction is imposed T̂ is T turned into the frame's normal, for what bends grows no shorter; else the tangent of
    the curve through P̂, so that Φ_sᵀλ = λ·T̂."""
    T = thread.T
    if not thread.bare:
        part, tilt = parts(thread, lam), tilt_of(thread, y)
        in_frame = tilt.size * tilt.normal
        at_P_hat = shrinkage(thread, part)[:, None] * T + thread.c[:, 0, 1:2] * part.across
        T = np.where(thread.directed[:, None], in_frame, at_P_hat)
    size = np.linalg.norm(T, axis=1)
    return size, T / size[:, None]


def phi(thread: Passage, lam: Array, y: Array) -> Array:
    """Return Φ = (g, c₁, c₂), shape `(p, 5)` [m, -]; `lam` (p, 5), `y` (p, 9)."""
    P, T = effective_place(thread, lam, y)
    out = np.empty((len(y), 5))
    out[:, :3] = P - y[:, :3]
    out[:, 3] = dot(T, y[:, 3:6])
    out[:, 4] = dot(T, y[:, 6:])
    return out


def phi_s(thread: Passage, lam: Array, y: Array) -> Array:
    """Return ∂Φ/∂s = (P̂', T̂'·u, T̂'·v) at constant multipliers, shape `(p, 5)`."""
    P_s, T_s = effective_place(thread, lam, y, 1)
    out = np.empty((len(y), 5))
    out[:, :3] = P_s
    out[:, 3] = dot(T_s, y[:, 3:6])
    out[:, 4] = dot(T_s, y[:, 6:])
    return out


def driving_force(thread: Passage, lam: Array, y: Array) -> Array:
    """Return Φ_sᵀλ, what pulls the thread along itself, shape `(p,)` [N]: λ·T + m·T' (eq. 6, with the configurational
    force of the direction constraint, Bigoni et al. 2015), and the slope of the energy of the missing compliance."""
    plain = dot(lam[:, :3], thread.T) + dot(force_on_tangent(lam, y), thread.K)
    if thread.bare:
        return plain
    return plain + held_energy(thread, lam, y, 1) + dot(lacking_force(thread, lam, y), thread.K)


def lacking_force(thread: Passage, lam: Array, y: Array, derivative: int = 0) -> Array:
    """Return w + e ∂Γ/∂T + c₁(λ·m) â, what the missing compliance adds to the force conjugate to T, or its derivative
    by s with T held, shape `(p, 3)` [N m]."""
    part, turn = parts(thread, lam), tilt_force(thread, lam, y, derivative) * tilt_of(thread, y).by_T
    return axis_force(thread, part, derivative) + turn + both_force(thread, lam, y, derivative) * part.unit


def both_force(thread: Passage, lam: Array, y: Array, derivative: int = 0) -> Array:
    """Return c₁ λ·m, the force conjugate to |a|, or its derivative by s, shape `(p, 1)` [N m]."""
    return np.asarray(thread.c[:, derivative, 1] * dot(lam[:, :3], force_on_tangent(lam, y)))[:, None]


def thread_force(thread: Passage, lam: Array, y: Array) -> Array:
    """Return Φ_qᵀλ through the thread's numbers: the forces conjugate to P and T, shape `(p, 2, 3)` [N, N m]."""
    out = np.empty((len(lam), 2, 3))
    out[:, 0], out[:, 1] = lam[:, :3], force_on_tangent(lam, y)
    if not thread.bare:
        out[:, 1] += lacking_force(thread, lam, y)
    return out


def site_force(thread: Passage, lam: Array, y: Array) -> Array:
    """Return Φ_yᵀλ = (−λ, μ_u T̂ + e v × Γ_n, μ_v T̂ + e Γ_n × u), the force on the organ conjugate to y, shape
    `(p, 9)` [N, N m]; Γ_n = ∂Γ/∂(u × v)."""
    T = effective_place(thread, lam, y)[1]
    out = np.empty((len(lam), 9))
    out[:, :3], out[:, 3:6], out[:, 6:] = -lam[:, :3], lam[:, 3:4] * T, lam[:, 4:5] * T
    if not thread.bare:
        turn = tilt_force(thread, lam, y) * tilt_of(thread, y).by_n
        out[:, 3:6] += cross(y[:, 6:], turn)
        out[:, 6:] += cross(turn, y[:, 3:6])
    return out


def couple_on_thread(thread: Passage, lam: Array, y: Array) -> Array:
    """Return the reaction couple of the direction constraint on the thread, shape `(p, 3)` [N m]: the moment about P̂
    of all that the hole does to the thread, zero for a free hole."""
    force = thread_force(thread, lam, y)
    return cross(thread.P - effective_place(thread, lam, y)[0], force[:, 0]) + cross(thread.T, force[:, 1])


def axis_stiffness(thread: Passage, lam: Array) -> Array:
    """Return ∂w/∂a = −c₀ [λ_⊥λ_⊥ᵀ − τ(âλ_⊥ᵀ + λ_⊥âᵀ) − τ²(1 − ââᵀ)]/|a|², symmetric, shape `(p, 3, 3)` [N m]."""
    part = parts(thread, lam)
    unit, across, tau = part.unit[:, :, None], part.across[:, :, None], part.along[:, None, None]
    T = lambda x: x.swapaxes(1, 2)  # noqa: E731
    mixed = unit * T(across)
    inner = across * T(across) - tau * (mixed + T(mixed)) - tau**2 * (np.eye(3) - unit * T(unit))
    return np.asarray(-(thread.c[:, 0, 0] / part.size**2)[:, None, None] * inner)


def tilt_stiffness(tilt: Tilt) -> tuple[Array, Array, Array]:
    """Return ∂²Γ by T and T, by T and n, by n and n, each `(p, 3, 3)` [-]."""
    one = np.eye(3)
    along, normal, of_T, of_n = (a[:, :, None] for a in (tilt.along, tilt.normal, tilt.of_along, tilt.of_normal))
    size, area, cosine = tilt.size[:, :, None], tilt.area[:, :, None], tilt.cosine[:, None, None]
    value, slope, bend = (each[:, :, None] for each in tilt.profile)
    T = lambda x: x.swapaxes(1, 2)  # noqa: E731
    across, flat = one - along * T(along), one - normal * T(normal)
    by_T = slope * (along * T(of_T) + of_T * T(along) - cosine * across) + bend * of_T * T(of_T)
    mixed = slope * (2.0 * along * T(of_n) + across @ flat) + bend * of_T * T(of_n)
    by_n = bend * of_n * T(of_n) - slope * (normal * T(of_n) + of_n * T(normal) + cosine * flat)
    return 2.0 * value * one + by_T, size / area * mixed, (size / area) ** 2 * by_n


def lacking_stiffness(thread: Passage, lam: Array, y: Array) -> Array:
    """Return ∂(w + e ∂Γ/∂T + c₁(λ·m) â)/∂T, symmetric, shape `(p, 3, 3)` [N m]."""
    part, turn = parts(thread, lam), tilt_force(thread, lam, y)[:, :, None] * tilt_stiffness(tilt_of(thread, y))[0]
    across = np.eye(3) - part.unit[:, :, None] * part.unit[:, None]
    lengthwise = (both_force(thread, lam, y) / part.size[:, None])[:, :, None] * across
    return axis_stiffness(thread, lam) + turn + lengthwise


def force_by_axis(thread: Passage, lam: Array, y: Array) -> Array:
    """Return ∂P̂/∂a = −c₀ ∂(τâ)/∂a + c₁ m âᵀ, shape `(p, 3, 3)` [m]."""
    part, m = parts(thread, lam), force_on_tangent(lam, y)[:, :, None]
    unit, across = part.unit[:, :, None], part.across[:, None, :]
    turn = unit * across + part.along[:, None, None] * (np.eye(3) - unit * unit.swapaxes(1, 2))
    c0, c1 = thread.c[:, 0, :2].T[:, :, None, None]
    return np.asarray(c1 * m * unit.swapaxes(1, 2) - c0 / part.size[:, None, None] * turn)


def spread(forces: Array, thread: Passage, n: int) -> Array:
    """Spread forces conjugate to (P, T), `(p, 2, 3)`, over `n` control points: Q_i = F ∂P/∂q_i, shape `(n, 3)`."""
    local = thread.b[:, :2].swapaxes(1, 2) @ forces
    index = 3 * thread.first[:, None, None] + LOCAL_UNKNOWNS
    return np.bincount(index.ravel(), local.ravel(), 3 * n).astype(np.float64, copy=False).reshape(n, 3)
