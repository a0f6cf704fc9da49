"""Sliding point and sliding direction (eqs. 4, 8, 9) of all holds at once, by the formulas of
`coupling.kernels.holes`.

    g = P(s) − x,   c₁ = T·u,   c₂ = T·v

At each piercing the thread gives P, T = ∂P/∂s, T' and T'' at the abscissa s, and the organ gives y
= (x, u, v). The multipliers are λ (3) [N] and μ_u, μ_v [N m] in one array `lam`, shape `(p, 5)`.
The constraints are functions of these few numbers only; they do not use the global matrix.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Indices
from coupling.kernels import holes
from coupling.kernels.friction import normal_force
from coupling.kernels.holes import AT_U, AT_V, Held, hold_among
from thread.kernels.curve import FIRST, put
from thread.kernels.loops import entry, loop, numbers
from thread.kernels.travel import Ridden
from thread.placed import Placed
from thread.spline import ORDERS, Spline
from thread.vectors import cross
from tissue.recent import Recent

Functions = tuple[Indices, Array]  # `first` (p,) and `b` (p, 4, 4), as in `Passage`
C1, C2 = numbers(3, 4)  # c₁, c₂ among the five numbers of Φ
LOCAL = np.arange(ORDERS)
LOCAL_UNKNOWNS = 3 * LOCAL[:, None] + np.arange(3)  # of the four points of a span, counted from those of the first


@dataclass(frozen=True)
class Passage:
    """The thread at the holes.

    `first` (p,) and `b` (p, 4, 4) are the basis there. `D` (p, 4, 3) has P [m], T [-], T' [1/m] and
    T'' [1/m²]. `drive` (p,) [N] is −∂Π/∂s of a thread whose knots travel, for which D does not
    depend on s; None if knots do not travel. `ridden` has all derivatives of Π by s; None if they
    were not asked for.
    """

    first: Indices
    b: Array
    D: Array
    drive: Array | None = None
    ridden: Ridden | None = None

    @property
    def P(self) -> Array:
        """Place of the thread, shape `(p, 3)` [m]."""
        return self.D[:, 0]

    @property
    def T(self) -> Array:
        """Tangent ∂P/∂s of the thread, shape `(p, 3)` [-]."""
        return self.D[:, 1]

    @property
    def K(self) -> Array:
        """T' [1/m], shape `(p, 3)`."""
        return self.D[:, 2]

    @property
    def J(self) -> Array:
        """T'' [1/m²], shape `(p, 3)`."""
        return self.D[:, 3]

    @cached_property
    def _recent(self) -> "Recent[Meeting]":
        """The cache of the last meetings at these holds."""
        return Recent()


def knot_functions(spline: Spline, s: Array) -> Functions:
    """Return the functions of a thread whose knots travel, at the knots of its holes; P and T there
    do not depend on s.

    `spline` is the one of (P, S), and `s` (p,) [m] are the abscissae. A hold without a knot is
    evaluated at its s.
    """
    assert isinstance(spline, Placed)
    travel = spline.travel
    chi = spline.chi.breaks[travel.at]
    if len(travel.holds) < len(s):
        others = np.setdiff1d(np.arange(len(s)), travel.holds)
        chi[others] = spline.parameter(s[others])
    first, b = spline.chi.basis(chi)
    b = b[:, :4] * np.array([1.0, 1.0, 0.0, 0.0])[:, None]
    b[:, 1] /= np.einsum("mi,mi->m", b[:, 1], spline.places[first[:, None] + LOCAL])[:, None]
    return first, b


def passage_by(functions: Functions, q: Array, drive: Array | None = None, ridden: Ridden | None = None) -> Passage:
    """Evaluate the thread with control values `q` (n, c) by its functions at the holes.

    `drive` (p,) [N] is −∂Π/∂s if knots travel, or `ridden` contains it.
    """
    first, b = functions
    D = np.ascontiguousarray((b @ q[first[:, None] + LOCAL])[..., :3])
    return Passage(first, b, D, drive if ridden is None else -ridden.by_s, ridden)


def passage(spline: Spline, q: Array, s: Array, home: Array | None = None) -> Passage:
    """Evaluate the thread with control values `q` (n, c) at the abscissae `s` (p,) [m].

    If `home` is given, each hold is on the piece of a cut thread that contains its abscissa in
    `home`.
    """
    return passage_by(spline.basis(s, home), q)


class Meeting(NamedTuple):
    """Constraints and forces between thread and holes, over `m` holds.

    `phi` and `phi_s` (m, 5) are Φ and ∂Φ/∂s. The forces `on_tangent` (m, 3) [N m] are conjugate to
    T, and `on_site` (m, 9) to y. `drive` (m,) [N] is the force along the thread, and `pressing`
    (m,) [N] the normal force on the hole.
    """

    phi: Array
    phi_s: Array
    on_tangent: Array
    on_site: Array
    drive: Array
    pressing: Array


@loop
def meet_all(at: Held, per_channel: Array, out: Meeting) -> None:
    """Evaluate thread and holes into `out`."""
    for k in range(len(at.lam)):
        h = hold_among(at, k)
        place, out.phi[k, C1], out.phi[k, C2] = holes.phi(h)
        rate, out.phi_s[k, C1], out.phi_s[k, C2] = holes.phi_s(h)
        put(place, out.phi, k, FIRST)
        put(rate, out.phi_s, k, FIRST)
        put(h.m, out.on_tangent, k, FIRST)
        f_x, f_u, f_v = holes.site_force(h)
        put(f_x, out.on_site, k, FIRST)
        put(f_u, out.on_site, k, AT_U)
        put(f_v, out.on_site, k, AT_V)
        out.drive[k] = holes.driving_force(h)
        out.pressing[k] = normal_force(h, per_channel[k])


meet = entry(meet_all)


def meeting(thread: Passage, lam: Array, y: Array, per_channel: Array | None = None) -> Meeting:
    """Evaluate thread and holes under the multipliers `lam` (m, 5) with the site variables `y` (m, 9).

    The channels have the length 1/`per_channel` (m,) [m]; None means no channels. The last results
    are cached by the argument arrays.
    """
    m = len(lam)

    def make() -> Meeting:
        out = Meeting(*(np.empty((m, *of)) for of in ((5,), (5,), (3,), (9,), (), ())))
        meet(held_at(thread, lam, y), np.zeros(m) if per_channel is None else per_channel, out)
        return out

    return thread._recent.of((lam, y, per_channel), make)


def held_at(thread: Passage, lam: Array, y: Array) -> Held:
    """Return the arrays from which the kernels make a hold, each in C order."""
    rides = thread.drive is not None
    drive = np.zeros(len(thread.D)) if thread.drive is None else thread.drive
    D, drive, lam, y = (np.ascontiguousarray(x, dtype=float) for x in (thread.D, drive, lam, y))
    return Held(D, rides, drive, lam, y)


def phi(thread: Passage, lam: Array, y: Array) -> Array:
    """Return Φ = (g, c₁, c₂), shape `(m, 5)` [m, -]; `lam` (m, 5), `y` (m, 9)."""
    return meeting(thread, lam, y).phi


def phi_s(thread: Passage, lam: Array, y: Array) -> Array:
    """Return ∂Φ/∂s = (T, T'·u, T'·v), zero if knots travel, shape `(m, 5)`."""
    return meeting(thread, lam, y).phi_s


def driving_force(thread: Passage, lam: Array, y: Array) -> Array:
    """Return the force that pulls the thread along itself, Φ_sᵀλ, or −∂Π/∂s if knots travel, shape `(m,)` [N].

    Φ_sᵀλ is λ·T + m·T' (eq. 6, with the configurational force of the direction constraint, Bigoni
    et al. 2015).
    """
    return meeting(thread, lam, y).drive


def pressing_force(thread: Passage, lam: Array, y: Array, per_channel: Array) -> Array:
    """Return N = |λ_n/2 + m/ℓ_c| + |λ_n/2 − m/ℓ_c|, the force that presses the thread on the hole,
    shape `(m,)` [N].

    It is |λ_n| without a channel.
    """
    return meeting(thread, lam, y, per_channel).pressing


def tangent(thread: Passage) -> Array:
    """Return the unit tangent t = T/|T|, the direction of friction, shape `(m, 3)` [-]."""
    return np.asarray(thread.T / np.linalg.norm(thread.T, axis=1)[:, None])


def thread_force(thread: Passage, lam: Array, y: Array) -> Array:
    """Return Φ_qᵀλ as the forces conjugate to P and T, shape `(m, 2, 3)` [N, N m]."""
    return np.stack([lam[:, :3], meeting(thread, lam, y).on_tangent], axis=1)


def site_force(thread: Passage, lam: Array, y: Array) -> Array:
    """Return Φ_yᵀλ = (−λ, μ_u T, μ_v T), the force on the organ conjugate to y, shape `(m, 9)` [N, N m]."""
    return meeting(thread, lam, y).on_site


def couple_on_thread(thread: Passage, lam: Array, y: Array) -> Array:
    """Return the reaction couple of the direction constraint on the thread, shape `(m, 3)` [N m].

    The couple is the moment about P of all forces of the hole on the thread. It is zero for a hole
    without a direction.
    """
    return cross(thread.T, meeting(thread, lam, y).on_tangent)


def spread(forces: Array, thread: Passage, n: int) -> Array:
    """Spread forces conjugate to (P, T), `(m, 2, 3)`, over `n` control points: Q_i = F ∂P/∂q_i, shape `(n, 3)`."""
    local = thread.b[:, :2].swapaxes(1, 2) @ forces
    index = 3 * thread.first[:, None, None] + LOCAL_UNKNOWNS
    return np.bincount(index.ravel(), local.ravel(), 3 * n).astype(np.float64, copy=False).reshape(n, 3)
