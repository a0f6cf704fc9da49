"""Sliding point and sliding direction (eqs. 4, 8, 9) with their derivatives, all piercings at once.

Per piercing the thread offers P, T = ∂P/∂s, T' and T'' at the abscissa s; the organ offers y = (x, u, v). Multipliers
are λ (3) [N] and μ_u, μ_v [N m] in one array `lam`, shape `(p, 5)`. Constraints return rows over these few numbers
and never see the global matrix:

    g = P(s) − x,   c₁ = T·u,   c₂ = T·v

The spline lacks compliance where a force λ and a couple m = μ_u u + μ_v v act on it (`thread.compliance`), c₀ by the
force, c₁, c₂ by the couple: the thread is met where it is with it,

    P̂ = P + c₀ λ + c₁ m,   T̂ = T + c₁ λ + c₂ m,

and P̂, T̂ stand for P, T in Φ. This is the stationary point of λ·(P − x) + m·T + ½(c₀λ² + 2c₁λ·m + c₂m²), whose
derivatives by s and y are the driving force and the force on the organ. c₀ acts on all of λ, though along itself
the spline lacks next to nothing: a force λ_t along the thread moves P by c₀ λ_t too much, which is below
0.011 h (h/ℓ)² with ℓ = √(EI/λ_t), small where the span h is a part of ℓ and not where it is several.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thread.spline import Spline
from thread.thread import Thread

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Passage:
    """The thread where it passes the holes.

    `first` (p,) and `b` (p, 4, 4): the basis there; `P` [m], `T` [-], `K` = T' [1/m], `J` = T'' [1/m²], each (p, 3);
    `c` (p, 3 derivatives by s, 3): the missing compliances c₀, c₁, c₂ [m/N, 1/N, 1/(N m)].
    """

    first: Indices
    b: Array
    P: Array
    T: Array
    K: Array
    J: Array
    c: Array


LOCAL = np.arange(4)
LOCAL_UNKNOWNS = 3 * LOCAL[:, None] + np.arange(3)  # of the four points on a span, from the first point's on


def passage(thread: Thread, q: Array, s: Array, home: Array | None = None) -> Passage:
    """Evaluate the thread with control values `q` (n, c) at the abscissae `s` (p,) [m], on the pieces of a cut thread
    that hold the abscissae `home` where they are given."""
    bare = bare_passage(thread.spline, q, s, home)
    return replace(bare, c=thread.missing_compliance(s, home))


def bare_passage(spline: Spline, q: Array, s: Array, home: Array | None = None) -> Passage:
    """The same without the missing compliance: of rates, and under impulses, to which a massless lack gives nothing."""
    first, b = spline.basis(s, home)
    D = (b @ q[first[:, None] + LOCAL])[..., :3]
    return Passage(first, b, D[:, 0], D[:, 1], D[:, 2], D[:, 3], np.zeros((len(s), 3, 3)))


def dot(a: Array, b: Array) -> Array:
    """Row-wise scalar product, shape `(p,)`."""
    return np.vecdot(a, b)


def moment_arm(lam: Array, y: Array) -> Array:
    """m = μ_u u + μ_v v, the force conjugate to T, shape `(p, 3)` [N m]."""
    return lam[:, 3:4] * y[:, 3:6] + lam[:, 4:5] * y[:, 6:]


def met(thread: Passage, lam: Array, y: Array, derivative: int = 0) -> tuple[Array, Array]:
    """P̂ and T̂, or their derivatives by s at constant multipliers, each `(p, 3)`."""
    c, m, force = thread.c[:, derivative, :, None], moment_arm(lam, y), lam[:, :3]
    P, T = (thread.P, thread.T, thread.K, thread.J)[derivative : derivative + 2]
    return P + c[:, 0] * force + c[:, 1] * m, T + c[:, 1] * force + c[:, 2] * m


def tangent(thread: Passage, lam: Array, y: Array) -> tuple[Array, Array]:
    """|T̂| and the unit tangent t = T̂/|T̂| of the thread as it is met, shapes `(p,)` and `(p, 3)` [-]."""
    T = met(thread, lam, y)[1]
    size = np.linalg.norm(T, axis=1)
    return size, T / size[:, None]


def held_energy(thread: Passage, lam: Array, y: Array, derivative: int = 0) -> Array:
    """½(c₀λ² + 2c₁λ·m + c₂m²) or its derivative by s, shape `(p,)` [J]: what the missing compliance stores."""
    c, m, force = thread.c[:, derivative], moment_arm(lam, y), lam[:, :3]
    return 0.5 * (c[:, 0] * dot(force, force) + c[:, 2] * dot(m, m)) + c[:, 1] * dot(force, m)


def phi(thread: Passage, lam: Array, y: Array) -> Array:
    """Φ = (g, c₁, c₂), shape `(p, 5)` [m, -]; `lam` (p, 5), `y` (p, 9)."""
    P, T = met(thread, lam, y)
    out = np.empty((len(y), 5))
    out[:, :3] = P - y[:, :3]
    out[:, 3] = dot(T, y[:, 3:6])
    out[:, 4] = dot(T, y[:, 6:])
    return out


def phi_s(thread: Passage, lam: Array, y: Array) -> Array:
    """∂Φ/∂s = (P̂', T̂'·u, T̂'·v) at constant multipliers, shape `(p, 5)`."""
    P_s, T_s = met(thread, lam, y, 1)
    out = np.empty((len(y), 5))
    out[:, :3] = P_s
    out[:, 3] = dot(T_s, y[:, 3:6])
    out[:, 4] = dot(T_s, y[:, 6:])
    return out


def driving_force(thread: Passage, lam: Array, y: Array) -> Array:
    """Φ_sᵀλ, shape `(p,)` [N]: what pulls the thread along itself (eq. 6, with the configurational force of the
    direction constraint, Bigoni et al. 2015). λ·T + m·T', and of the missing compliance ½(c₀'λ² + 2c₁'λ·m + c₂'m²)."""
    return dot(lam[:, :3], thread.T) + dot(moment_arm(lam, y), thread.K) + held_energy(thread, lam, y, 1)


def thread_force(lam: Array, y: Array) -> Array:
    """Φ_qᵀλ through the thread's numbers: forces conjugate to P and T, shape `(p, 2, 3)` [N, N m]."""
    out = np.empty((len(lam), 2, 3))
    out[:, 0], out[:, 1] = lam[:, :3], moment_arm(lam, y)
    return out


def site_force(thread: Passage, lam: Array, y: Array) -> Array:
    """Φ_yᵀλ = (−λ, μ_u T̂, μ_v T̂): the force on the organ conjugate to y, shape `(p, 9)` [N, N m]."""
    T = met(thread, lam, y)[1]
    out = np.empty((len(lam), 9))
    out[:, :3], out[:, 3:6], out[:, 6:] = -lam[:, :3], lam[:, 3:4] * T, lam[:, 4:5] * T
    return out


def couple_on_thread(thread: Passage, lam: Array, y: Array) -> Array:
    """Reaction couple of the direction constraint on the thread about the hole, T̂ × m, shape `(p, 3)` [N m]."""
    return np.cross(met(thread, lam, y)[1], moment_arm(lam, y))


def spread(forces: Array, thread: Passage, n: int) -> Array:
    """Generalized forces Q_i = F ∂P/∂q_i of forces conjugate to (P, T), `(p, 2, 3)`, on `n` control points (n, 3)."""
    local = thread.b[:, :2].swapaxes(1, 2) @ forces
    index = 3 * thread.first[:, None, None] + LOCAL_UNKNOWNS
    return np.bincount(index.ravel(), local.ravel(), 3 * n).astype(np.float64, copy=False).reshape(n, 3)
