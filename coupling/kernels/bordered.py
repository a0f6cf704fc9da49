"""One Newton direction of the condensed system: a banded thread with a small dense border.

The thread's unknowns meet everything else only through P, T and T' at the holds, the nine columns of
V = (b, b', b'') ⊗ I₃ each; so the thread enters the border by its own compliance G = Vᵀ A⁻¹ V, as the organ does by C.

Unknowns of the border, per hold: s, λ (3), μ_u, μ_v, then y = (x, u, v).
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgbtrf, dgbtrs, dgesv

from coupling.arrays import Array, Indices
from coupling.kernels.constraints import (
    LOCAL,
    Passage,
    effective_place,
    force_by_axis,
    force_on_tangent,
    lacking_force,
    lacking_stiffness,
    parts,
    tilt_force,
    tilt_of,
    tilt_stiffness,
    turned_compliance,
)
from thread.banded import half_band_of
from thread.vectors import cross, dot

S, LAM, MU_U, MU_V, X, U, V = 0, slice(1, 4), 4, 5, slice(6, 9), slice(9, 12), slice(12, 15)
PHI, Y = slice(1, 6), slice(6, 15)  # rows of Φ, and of the multipliers that go with them; of y
OWN, BORDER = 6, 15  # equations of a hold without and with its site variables
AT_P, AT_T, AT_K = slice(0, 3), slice(3, 6), slice(6, 9)  # the thread's nine numbers
G, C1, C2 = slice(0, 3), 3, 4  # the constraints g, c₁, c₂ among the five rows of Φ
OF_X, OF_U, OF_V = slice(0, 3), slice(3, 6), slice(6, 9)  # x, u, v among the nine numbers of y
NINE = 9
FLAT = 1e-3  # of the largest stiffness along the thread: a smaller one is taken for this
I3 = np.eye(3)


@dataclass(frozen=True)
class Joints:
    """How strands are joined in ties (`coupling.ties`): the holds `strands` (t, 2) in force, those of them that slide,
    `one` and `other` (k,), and a `compliance` [m/N] that makes a length of the balance of forces."""

    strands: Indices
    one: Indices
    other: Indices
    compliance: float = 1.0

    @property
    def places(self) -> tuple[Indices, Indices]:
        """Numbers of the x of both strands among the 9m numbers y, shape `(t, 3)` each."""
        first, second = NINE * self.strands.T[:, :, None] + np.arange(3)
        return first, second

    def residual(self, r_y: Array, y: Array, f_y: Array, gaps: Array) -> Array:
        """Return residuals of y (m, 9) with those of ties: x_a − x_b − `gaps` (t, 3), and what is left of the
        forces."""
        (a, b), out = self.strands.T, r_y.copy()
        out[a, OF_X] = y[a, OF_X] - y[b, OF_X] - gaps
        out[b, OF_X] = self.compliance * (f_y[a, OF_X] + f_y[b, OF_X])
        return out


NO_JOINTS = Joints(np.zeros((0, 2), dtype=np.intp), *np.zeros((2, 0), dtype=np.intp))


SINGULAR_THREAD = "the thread's matrix is singular"
SINGULAR_HOLDS = "the holds' matrix is singular: two constraints say the same, or nothing holds the thread"


class SingularError(ArithmeticError):
    """The matrix of a Newton step is singular."""


@dataclass(frozen=True)
class Border:
    """The linearised holds, block by block over `m` holds.

    Thread: A dq + V E dz = −r_q. Holds: B Vᵀdq + D dz = −r. Organ: dy − C (F dz + R Vᵀdq) = −r_y.
    `E` (m, 9, 15), `B` (m, 6, 9), `D` (m, 6, 15), `F` (m, 9, 15), `R` (m, 9, 9).

    E = (H_qs, −Φ_qᵀ, H_qy), F = (−H_ys, Φ_yᵀ, −H_yy) and R = −H_yq, where q stands for the thread's nine numbers at a
    hold, (P, T, T'). The first row of B and D is the law of sliding, the others are Φ_q and (Φ_s, Φ_λ, Φ_y). The blocks
    that have a name here are views: who writes into one writes into the border.
    """

    E: Array
    B: Array
    D: Array
    F: Array
    R: Array

    @property
    def H_qs(self) -> Array:
        """−∂(Φ_qᵀλ)/∂s, shape `(m, 9)`."""
        return self.E[:, :, S]

    @property
    def H_qy(self) -> Array:
        """−∂(Φ_qᵀλ)/∂y, shape `(m, 9, 9)`; H_qU = H_qy Y."""
        return self.E[:, :, Y]

    @property
    def Phi_q(self) -> Array:
        """∂Φ/∂(P, T, T'), shape `(m, 5, 9)`; Φ_q of the control points is `Phi_q` Vᵀ."""
        return self.B[:, PHI]

    @property
    def Phi_s(self) -> Array:
        """∂Φ/∂s, shape `(m, 5)`."""
        return self.D[:, PHI, S]

    @property
    def Phi_lam(self) -> Array:
        """∂Φ/∂λ, the block c of the compliance that the spline lacks, shape `(m, 5, 5)`; zero where it lacks none."""
        return self.D[:, PHI, PHI]

    @property
    def Phi_y(self) -> Array:
        """∂Φ/∂y, shape `(m, 5, 9)`."""
        return self.D[:, PHI, Y]

    @property
    def minus_H_ys(self) -> Array:
        """∂(Φ_yᵀλ)/∂s, shape `(m, 9)`."""
        return self.F[:, :, S]


def empty_border(m: int) -> Border:
    """Return the border of `m` holds with every block zero."""
    E, B, D = np.zeros((m, NINE, BORDER)), np.zeros((m, OWN, NINE)), np.zeros((m, OWN, BORDER))
    return Border(E, B, D, F=np.zeros((m, NINE, BORDER)), R=np.zeros((m, NINE, NINE)))


def linearise(thread: Passage, lam: Array, y: Array) -> Border:
    """Linearise Φ = (g, c₁, c₂) and the forces Φ_qᵀλ, Φ_yᵀλ; the row of s is left to the law of sliding.

    `lam` (m, 5) [N, N m], `y` (m, 9).
    """
    border = empty_border(len(lam))
    u, v, mu_u, mu_v = y[:, 3:6], y[:, 6:], lam[:, 3:4], lam[:, 4:5]
    T, (P_s, T_s) = effective_place(thread, lam, y)[1], effective_place(thread, lam, y, 1)
    H_qs, H_qy, minus_H_ys = border.H_qs, border.H_qy, border.minus_H_ys
    Phi_q, Phi_s, Phi_y = border.Phi_q, border.Phi_s, border.Phi_y

    Phi_q[:, G, AT_P] = I3
    Phi_q[:, C1, AT_T], Phi_q[:, C2, AT_T] = u, v
    Phi_s[:, G], Phi_s[:, C1], Phi_s[:, C2] = P_s, dot(T_s, u), dot(T_s, v)
    Phi_y[:, G, OF_X] = -I3
    Phi_y[:, C1, OF_U], Phi_y[:, C2, OF_V] = T, T

    H_qs[:, AT_T], H_qs[:, AT_K] = -lam[:, :3], -force_on_tangent(lam, y)
    H_qy[:, AT_T, OF_U], H_qy[:, AT_T, OF_V] = -mu_u[:, :, None] * I3, -mu_v[:, :, None] * I3
    minus_H_ys[:, OF_U], minus_H_ys[:, OF_V] = mu_u * T_s, mu_v * T_s

    border.E[:, :, PHI] -= Phi_q.swapaxes(1, 2)
    border.F[:, :, PHI] += Phi_y.swapaxes(1, 2)
    border.R[:] -= H_qy.swapaxes(1, 2)
    if not thread.bare:
        add_compliance(border, thread, lam, y)
    return border


def add_compliance(border: Border, thread: Passage, lam: Array, y: Array) -> None:
    """Add what Φ and the forces owe to the missing compliance, into a border under construction; the stiffness of the
    thread's own axis is left to the thread's band (`own_stiffness`)."""
    dP, dT = derivatives_by_multipliers(thread, lam, y)
    border.D[:, PHI] += constraints_by(dP, dT, y)
    border.F[:, 3:6] += lam[:, 3:4, None] * dT
    border.F[:, 6:9] += lam[:, 4:5, None] * dT
    add_own_turning(border, thread, lam, y)
    add_tilting(border, thread, lam, y)


def derivatives_by_multipliers(thread: Passage, lam: Array, y: Array) -> tuple[Array, Array]:
    """Return the derivatives of P̂ and T̂ by a hold's multipliers and frame, each `(m, 3, 15)`."""
    c0, c1, _, c3 = thread.c[:, 0].T[:, :, None, None]
    unit, tilt, dm = parts(thread, lam).unit, tilt_of(thread, y), moment_by_border(lam, y)
    arm = c1 * tilt.size[:, :, None]
    dP, dT = arm * dm, turned_compliance(thread, y)[:, None, None] * dm
    dP[:, :, LAM] += c0 * (I3 - unit[:, :, None] * unit[:, None])
    dT[:, :, LAM] += arm * I3
    return dP, dT + c3 * force_on_tangent(lam, y)[:, :, None] * (tilt.by_n[:, None] @ normal_by_frame(y))


def constraints_by(dP: Array, dT: Array, y: Array) -> Array:
    """Return the derivatives of Φ = (g, c₁, c₂) from those of P̂ and T̂, `dP` and `dT` (m, 3, k), shape `(m, 5, k)`."""
    along = [(vector[:, :, None] * dT).sum(axis=1, keepdims=True) for vector in (y[:, 3:6], y[:, 6:])]
    return np.concatenate([dP, *along], axis=1)


def lacking_give(thread: Passage, lam: Array, y: Array) -> Array:
    """Return ∂Φ/∂λ by the compliance that the spline lacks alone, as `Border.Phi_lam` has it, shape `(m, 5, 5)`."""
    dP, dT = (each[:, :, PHI] for each in derivatives_by_multipliers(thread, lam, y))
    return constraints_by(dP, dT, y)


def moment_by_border(lam: Array, y: Array) -> Array:
    """Return the derivative of m = μ_u u + μ_v v by a hold's multipliers and frame, shape `(m, 3, 15)`."""
    dm = np.zeros((len(lam), 3, BORDER))
    dm[:, :, MU_U], dm[:, :, MU_V] = y[:, 3:6], y[:, 6:]
    dm[:, :, U], dm[:, :, V] = lam[:, 3:4, None] * I3, lam[:, 4:5, None] * I3
    return dm


def normal_by_frame(y: Array) -> Array:
    """Return the derivative of n = u × v by a hold's frame, shape `(m, 3, 15)`."""
    dn = np.zeros((len(y), 3, BORDER))
    dn[:, :, U], dn[:, :, V] = -skew(y[:, 6:]), skew(y[:, 3:6])
    return dn


def skew(a: Array) -> Array:
    """Return the matrices of a × , shape `(m, 3, 3)`; `a` (m, 3)."""
    return np.asarray(cross(a[:, None], I3).swapaxes(1, 2))


def add_own_turning(border: Border, thread: Passage, lam: Array, y: Array) -> None:
    """Add what the thread's own axis brings into P̂, and what the missing compliance adds to the force on the thread
    along it."""
    by_axis = force_by_axis(thread, lam, y)
    border.B[:, LAM, AT_T] += by_axis
    border.E[:, AT_T, LAM] -= by_axis.swapaxes(1, 2)
    border.E[:, AT_T, S] -= lacking_force_rate(thread, lam, y)
    border.E[:, AT_K, S] -= lacking_force(thread, lam, y)


def add_tilting(border: Border, thread: Passage, lam: Array, y: Array) -> None:
    """Add what T̂ and the forces owe to Γ, which tells how far the thread leaves the frame, and to |T|."""
    tilt, e, dn = tilt_of(thread, y), tilt_force(thread, lam, y)[:, :, None], normal_by_frame(y)
    of_T_n, of_n = tilt_stiffness(tilt)[1:]
    dm = moment_by_border(lam, y)
    de = thread.c[:, 0, 3:] * np.vecmat(force_on_tangent(lam, y), dm)
    both = thread.c[:, 0, 1:2] * np.vecmat(lam[:, :3], dm)
    by_T = tilt.by_T[:, :, None] * de[:, None] + tilt.along[:, :, None] * both[:, None] + e * (of_T_n @ dn)
    by_n, turned = tilt.by_n[:, :, None] * de[:, None] + e * (of_n @ dn), e * skew(tilt.by_n)
    border.E[:, AT_T] -= by_T
    border.B[:, MU_U, AT_T] += by_T[:, :, MU_U]
    border.B[:, MU_V, AT_T] += by_T[:, :, MU_V]
    for of, at in ((OF_U, U), (OF_V, V)):
        border.R[:, of, AT_T] += by_T[:, :, at].swapaxes(1, 2)
        border.F[:, of] += dn[:, :, at].swapaxes(1, 2) @ by_n
    border.F[:, OF_U, V] -= turned
    border.F[:, OF_V, U] += turned
    by_u, by_v = tilting_rates(thread, lam, y)
    border.F[:, OF_U, S] += by_u
    border.F[:, OF_V, S] += by_v


def tilting_rates(thread: Passage, lam: Array, y: Array) -> tuple[Array, Array]:
    """Return the derivatives by s of e ∂Γ/∂u and e ∂Γ/∂v, each `(m, 3)` [N]."""
    tilt = tilt_of(thread, y)
    turned = tilt_force(thread, lam, y) * np.vecmat(thread.K, tilt_stiffness(tilt)[1])
    rate = tilt_force(thread, lam, y, 1) * tilt.by_n + turned
    return cross(y[:, 6:], rate), cross(rate, y[:, 3:6])


def lacking_force_rate(thread: Passage, lam: Array, y: Array) -> Array:
    """Return the derivative of `lacking_force` by s along the thread, whose tangent turns with its curvature, shape
    `(m, 3)` [N]."""
    return lacking_force(thread, lam, y, 1) + np.matvec(lacking_stiffness(thread, lam, y), thread.K)


def own_stiffness(thread: Passage, lam: Array, y: Array) -> Array:
    """Return what the thread's own axis at a hole adds to its matrix, −b' b'ᵀ times
    `lacking_stiffness` on its four points, shape `(m, 4, 4, 3, 3)` [N/m]."""
    slope = thread.b[:, 1]
    return np.asarray(np.einsum("ma,mb,mij->mabij", slope, slope, -lacking_stiffness(thread, lam, y)))


def drop_constraints(border: Border, absent: NDArray[np.bool_]) -> Border:
    """Replace the rows of the constraints that are `absent`, (m, 5), by λ = 0."""
    B, D = border.B.copy(), border.D.copy()
    hold, k = np.nonzero(absent)
    B[hold, PHI.start + k] = 0.0
    D[hold, PHI.start + k] = 0.0
    D[hold, PHI.start + k, LAM.start + k] = 1.0
    return replace(border, B=B, D=D)


@cache
def column_pattern(c: int) -> tuple[Indices, Indices]:
    """Return, of each b^(order)_local ⊗ I₃, its row of Vᵀ and its column counted from the first point's."""
    order, local, axis = np.ogrid[:3, :4, :3]
    return 3 * order + axis, c * local + axis


def columns(thread: Passage, n: int, c: int) -> Array:
    """Return V = (b, b', b'') ⊗ I₃ of every hold over the `c` coordinates of `n` points, shape `(c n, 9m)`, Fortran
    order."""
    m = len(thread.first)
    V = np.zeros((m, NINE, c * n))
    row, column = column_pattern(c)
    V[np.arange(m)[:, None, None, None], row, c * thread.first[:, None, None, None] + column] = thread.b[:, :3, :, None]
    return V.reshape(NINE * m, c * n).T


def values_at_holds(thread: Passage, X: Array) -> Array:
    """Return Vᵀ X by the four local points of each hold, shape `(9m, k)`; `X` (n, c, k)."""
    m = len(thread.first)
    local = X[thread.first[:, None] + LOCAL, :3]
    return (thread.b[:, :3] @ local.reshape(m, 4, -1)).reshape(NINE * m, -1)


def banded_solve(A: Array, b: Array) -> Array:
    """Solve the banded system `A`, `b` (c n, k); both are overwritten. Raises `SingularError`."""
    h = half_band_of(A)
    lu, pivots, info = dgbtrf(A, h, h, overwrite_ab=1)
    if info != 0:
        raise SingularError(SINGULAR_THREAD)
    x, _ = dgbtrs(lu, h, h, b, pivots, overwrite_b=1)
    return np.asarray(x)


def newton_direction(
    A: Array,
    held: Indices,
    border: Border,
    C: Array,
    thread: Passage,
    r_q: Array,
    r: Array,
    r_y: Array,
    joints: Joints = NO_JOINTS,
    reach: Array | None = None,
) -> tuple[Array, Array]:
    """Solve for the Newton direction dq (n, c) and dz (m, 15).

    `A` banded, overwritten, its rows and columns of `held` (the thread's prescribed unknowns) those of the
    identity; `C` (9m, 9m) organ compliance; residuals `r_q` (n, c), `r` (m, 6) of the holds, `r_y` (m, 9) of y;
    `joints` of ties. With `reach` (m,) [m] the abscissae go downhill and no further than that, and all else with them
    (`own_downhill`). Raises `SingularError`.
    """
    (n, c), m = r_q.shape, len(r)
    right = np.empty((c * n, 1 + NINE * m), order="F")
    right[:, 0], right[:, 1:] = -r_q.ravel(), columns(thread, n, c)
    right[held] = 0.0
    X = banded_solve(A, right)
    if m == 0:
        return X[:, 0].reshape(n, c), np.empty((0, BORDER))
    G = values_at_holds(thread, X.reshape(n, c, -1))
    matrix, rhs, unknown = holds_system(border, C, G[:, 0].reshape(m, NINE), G[:, 1:], r, r_y, joints)
    at = np.searchsorted(unknown, BORDER * np.arange(m) + S)
    own = solve_own(matrix, rhs) if reach is None else own_downhill(matrix, rhs, reach, at)
    dz = np.zeros((m, BORDER))
    dz.ravel()[unknown] = own
    push = np.matvec(border.E, dz).ravel()
    return (X[:, 0] - X[:, 1:] @ push).reshape(n, c), dz


def solve_own(matrix: Array, rhs: Array) -> Array:
    """Solve the border's own system. Raises `SingularError`."""
    _, _, own, info = dgesv(matrix, rhs)
    if info != 0 or not np.all(np.isfinite(own)):
        raise SingularError(SINGULAR_HOLDS)
    return np.asarray(own)


def own_downhill(matrix: Array, rhs: Array, reach: Array, at: Indices) -> Array:
    """Solve the border's own system with the abscissae led: none goes further than `reach` (m,) [m], and none uphill.
    `matrix` is overwritten; `at` (m,) are the columns of the abscissae.

    All else is eliminated first, so that what is left of the laws of sliding is H ds = f: f (k,) [N] the force that
    drives the thread along itself, H (k, k) [N/m] what holds against it, which is the second derivative of the
    potential along the way that all else follows. Where H is not positive, Newton's way leads up to a saddle, and the
    sizes of its eigenvalues make one that leads down (Nocedal & Wright, Numerical Optimization, 2006, §3.4). Rows that
    speak of abscissae alone, of strands that stick or are tied, stand. Raises `SingularError`.
    """
    row = OWN * np.arange(len(reach))
    driven = np.flatnonzero(np.delete(matrix[row], at, axis=1).any(axis=1))
    row, at, unit = row[driven], at[driven], 1 + np.arange(len(driven))
    law, law_rhs = matrix[row], rhs[row]
    right = np.zeros((len(rhs), 1 + len(driven)), order="F")
    right[:, 0] = rhs
    matrix[row], right[row, 0] = 0.0, 0.0
    matrix[row, at] = right[row, unit] = 1.0
    own = solve_own(matrix, right)
    H, f = -law @ own[:, 1:], law @ own[:, 0] - law_rhs
    sizes, axes = np.linalg.eigh(0.5 * (H + H.T))
    if (sizes > 0.0).all():
        ds = np.linalg.solve(H, f)
    else:
        sizes = np.maximum(np.abs(sizes), max(FLAT * np.abs(sizes).max(), np.finfo(float).tiny))
        ds = axes @ ((axes.T @ f) / sizes)
    share = np.min(reach[driven] / np.maximum(np.abs(ds), np.finfo(float).tiny), initial=1.0)
    return np.asarray(own[:, 0] + own[:, 1:] @ (share * ds))


def holds_system(
    border: Border, C: Array, w: Array, G: Array, r: Array, r_y: Array, joints: Joints = NO_JOINTS
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return the matrix and right-hand side of the border once the thread is eliminated, Vᵀdq = w − G E dz, and the
    numbers of its unknowns among those of all holds, `(15m,)`.

    What of a site does not give way (its rows of C are zero) and is in its place does not move, and is left out: the
    frames of balls along a tract, clamped ends, and all of sites fixed in space.
    """
    m, row = len(r), np.arange(NINE * len(r))
    moves = row if joints.strands.size else np.flatnonzero(C.any(axis=1) | (r_y.ravel() != 0.0))
    E = border.E if moves.size else border.E[:, :, :OWN]
    GE = np.matmul(G.reshape(NINE * m, m, NINE).swapaxes(0, 1), E).swapaxes(0, 1).reshape(m, NINE, -1)
    own = plus_diagonal(-border.B @ GE, border.D[:, :, : E.shape[2]]).reshape(OWN * m, -1)
    by_thread = np.matvec(border.B, w)
    if joints.one.size:
        join_laws(own, by_thread, joints)
    own_rhs = (-r - by_thread).ravel()
    own_unknown = np.arange(BORDER * m).reshape(m, BORDER)[:, :OWN].ravel()
    if not moves.size:
        return own, own_rhs, own_unknown
    at_site = BORDER * (row // NINE) + OWN + row % NINE
    force = plus_diagonal(-border.R @ GE, border.F).reshape(NINE * m, -1)
    unknown = np.sort(np.concatenate([own_unknown, at_site[moves]]))
    if moves.size < row.size:
        own, force = own[:, unknown], force[:, unknown]
    site = -C[moves] @ force
    site[np.arange(moves.size), np.searchsorted(unknown, at_site[moves])] += 1.0
    site_rhs = C[moves] @ np.matvec(border.R, w).ravel() - r_y.ravel()[moves]
    if joints.strands.size:
        join_sites(site, site_rhs, force, np.matvec(border.R, w), r_y, joints)
    return np.concatenate([own, site]), np.concatenate([own_rhs, site_rhs]), unknown


def join_laws(own: Array, by_thread: Array, joints: Joints) -> None:
    """Join the laws of sliding of the strands of ties, in place: rows of the holds' matrix and what the thread does to
    them, `(m, 6)`."""
    one, other, width = OWN * joints.one, OWN * joints.other, own.shape[1] // len(by_thread)
    own[other] -= own[one]
    by_thread[joints.other, S] -= by_thread[joints.one, S]
    own[one], by_thread[joints.one, S] = 0.0, 0.0
    own[one, width * joints.one + S] = own[one, width * joints.other + S] = 1.0


def join_sites(site: Array, rhs: Array, force: Array, by_thread: Array, r_y: Array, joints: Joints) -> None:
    """Put the equations of ties in the place of those of their strands' x, in place: rows `site` (9m, 15m) and `rhs`
    (9m,); the forces on all sites change by `force` (9m, 15m) dz + `by_thread` (m, 9)."""
    first, second = joints.places
    column = lambda place: BORDER * (place // NINE) + OWN + place % NINE  # noqa: E731
    site[first] = site[second] = 0.0
    site[first, column(first)], site[first, column(second)] = 1.0, -1.0
    site[second] = joints.compliance * (force[first] + force[second])
    rhs[first] = -r_y.ravel()[first]
    both = by_thread.ravel()[first] + by_thread.ravel()[second]
    rhs[second] = -r_y.ravel()[second] - joints.compliance * both


def plus_diagonal(full: Array, blocks: Array) -> Array:
    """Add the blocks (m, r, k) to the diagonal of `full` (m, r, m k), in place."""
    m, r, k = blocks.shape
    hold = np.arange(m)
    full.reshape(m, r, m, k)[hold, :, hold] += blocks
    return full
