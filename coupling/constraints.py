"""Sliding point and sliding direction (eqs. 4, 8, 9) with their derivatives, all piercings at once.

Per piercing the thread offers P, T = ∂P/∂s, T' and T'' at the abscissa s; the organ offers y = (x, u, v). Multipliers
are λ (3) [N] and μ_u, μ_v [N m] in one array `lam`, shape `(p, 5)`. Constraints return rows over these few numbers
and never see the global matrix:

    g = P(s) − x,   c₁ = T·u,   c₂ = T·v
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thread.spline import Spline

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Passage:
    """The thread where it passes the holes.

    `first` (p,) and `b` (p, 4, 4): the basis there; `P` [m], `T` [-], `K` = T' [1/m], `J` = T'' [1/m²], each (p, 3).
    """

    first: Indices
    b: Array
    P: Array
    T: Array
    K: Array
    J: Array


LOCAL = np.arange(4)
LOCAL_UNKNOWNS = 3 * LOCAL[:, None] + np.arange(3)  # of the four points on a span, from the first point's on


def passage(spline: Spline, q: Array, s: Array) -> Passage:
    """Evaluate the thread with control values `q` (n, c) at the abscissae `s` (p,) [m]."""
    first, b = spline.basis(s)
    D = (b @ q[first[:, None] + LOCAL])[..., :3]
    return Passage(first, b, D[:, 0], D[:, 1], D[:, 2], D[:, 3])


def dot(a: Array, b: Array) -> Array:
    """Row-wise scalar product, shape `(p,)`."""
    return np.vecdot(a, b)


def phi(thread: Passage, y: Array) -> Array:
    """Φ = (g, c₁, c₂), shape `(p, 5)` [m, -]; `y` (p, 9)."""
    out = np.empty((len(y), 5))
    out[:, :3] = thread.P - y[:, :3]
    out[:, 3] = dot(thread.T, y[:, 3:6])
    out[:, 4] = dot(thread.T, y[:, 6:])
    return out


def phi_s(thread: Passage, y: Array) -> Array:
    """∂Φ/∂s = (T, T'·u, T'·v), shape `(p, 5)`."""
    out = np.empty((len(y), 5))
    out[:, :3] = thread.T
    out[:, 3] = dot(thread.K, y[:, 3:6])
    out[:, 4] = dot(thread.K, y[:, 6:])
    return out


def moment_arm(lam: Array, y: Array) -> Array:
    """m = μ_u u + μ_v v, the force conjugate to T, shape `(p, 3)` [N m]."""
    return lam[:, 3:4] * y[:, 3:6] + lam[:, 4:5] * y[:, 6:]


def driving_force(thread: Passage, lam: Array, y: Array) -> Array:
    """Φ_sᵀλ = λ·T + m·T', shape `(p,)` [N]: what pulls the thread along itself (eq. 6, with the
    configurational force of the direction constraint, Bigoni et al. 2015)."""
    return dot(lam[:, :3], thread.T) + dot(moment_arm(lam, y), thread.K)


def thread_force(lam: Array, y: Array) -> Array:
    """Φ_qᵀλ through the thread's numbers: forces conjugate to P and T, shape `(p, 2, 3)` [N, N m]."""
    out = np.empty((len(lam), 2, 3))
    out[:, 0], out[:, 1] = lam[:, :3], moment_arm(lam, y)
    return out


def site_force(thread: Passage, lam: Array) -> Array:
    """Φ_yᵀλ = (−λ, μ_u T, μ_v T): the force on the organ conjugate to y, shape `(p, 9)` [N, N m]."""
    out = np.empty((len(lam), 9))
    out[:, :3], out[:, 3:6], out[:, 6:] = -lam[:, :3], lam[:, 3:4] * thread.T, lam[:, 4:5] * thread.T
    return out


def couple_on_thread(thread: Passage, lam: Array, y: Array) -> Array:
    """Reaction couple of the direction constraint on the thread, T × m, shape `(p, 3)` [N m]."""
    return np.cross(thread.T, moment_arm(lam, y))


def spread(forces: Array, thread: Passage, n: int) -> Array:
    """Generalized forces Q_i = F ∂P/∂q_i of forces conjugate to (P, T), `(p, 2, 3)`, on `n` control points (n, 3)."""
    local = thread.b[:, :2].swapaxes(1, 2) @ forces
    index = 3 * thread.first[:, None, None] + LOCAL_UNKNOWNS
    return np.bincount(index.ravel(), local.ravel(), 3 * n).astype(np.float64, copy=False).reshape(n, 3)
