"""One Newton direction of the condensed system: a banded thread with a small dense border.

The thread's unknowns are coupled to the rest only through P, T and T' at the holds, the nine
columns V = (b, b', b'') ⊗ I₃ of each. The thread therefore enters the border by its own compliance
G = Vᵀ A⁻¹ V, as the organ does by C.

The unknowns of the border, per hold, are s, λ (3), μ_u, μ_v, and y = (x, u, v), which follows from
the forces on the site.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg.lapack import dgbtrf, dgbtrs, dgesv

from coupling.arrays import Array, Flags, Indices
from coupling.kernels import border as kernels
from coupling.kernels.border import BORDER, NINE, OWN, Border
from coupling.kernels.constraints import LOCAL, Passage, held_at
from coupling.kernels.friction import Joints, Law
from thread.banded import half_band_of

S, LAM, MU_V = 0, slice(1, 4), 5  # columns of s, of λ and of μ_v
PHI, Y = slice(1, 6), slice(6, 15)  # rows of Φ, which are the columns of its multipliers; columns of y
OF_X = slice(0, 3)  # x among the nine numbers of y
NO_JOINTS = Joints(np.zeros((0, 2), dtype=np.intp), np.zeros((0, 2), dtype=np.intp), 1.0)
NO_SET = np.zeros(0)  # an active set of stick and slip without holds
RIDING = 6  # row of Vᵀ that has H_qs if knots travel


SINGULAR_THREAD = "the thread's matrix is singular"
SINGULAR_HOLDS = "the holds' matrix is singular: two constraints are equivalent, or nothing holds the thread"


class SingularError(ArithmeticError):
    """The matrix of a Newton step is singular."""


def empty_border(m: int) -> Border:
    """Return the border of `m` holds with every block zero."""
    blocks = (NINE, BORDER), (OWN, NINE), (OWN, BORDER), (NINE, BORDER), (NINE, NINE), (m,)
    numbers = (np.zeros(shape, np.int64) for shape in (BORDER * m, (m, NINE), (m, NINE)))
    return Border(*(np.zeros((m, *block)) for block in blocks), *numbers)


def linearise(law: Law, sigma: Array, rows: Flags, thread: Passage, lam: Array, y: Array) -> Border:
    """Linearise the law of sliding, the active constraints, and the forces on thread and organ.

    `sigma` (m,) is the active set and `rows` (m, 5) are the active constraints.
    """
    border = empty_border(len(lam))
    if thread.ridden is not None:
        border.S[:] = -thread.ridden.by_ss
    kernels.linearise_holds(law, sigma, rows, held_at(thread, lam, y), border)
    return border


def columns(thread: Passage, n: int, c: int) -> Array:
    """Return V = (b, b', b'') ⊗ I₃ of every hold over `c` coordinates of `n` points, shape `(c n, 9m)`.

    The array is in Fortran order. If knots travel, H_qs is in the place of b''.
    """
    m = len(thread.first)
    V = np.zeros((m, NINE, c * n))
    k, order, local, axis = np.ogrid[:m, :3, :4, :3]
    V[k, 3 * order + axis, c * (thread.first[:, None, None, None] + local) + axis] = thread.b[:, :3, :, None]
    if thread.ridden is not None:
        V.reshape(m, NINE, n, c)[:, RIDING, :, :3] = np.moveaxis(thread.ridden.by_qs, 2, 0)
    return V.reshape(NINE * m, c * n).T


def values_at_holds(thread: Passage, X: Array) -> Array:
    """Return Vᵀ X from the four local points of each hold, shape `(9m, k)`; `X` (k, n, c) is in C order."""
    m, count = len(thread.first), len(X)
    local = np.moveaxis(X[:, thread.first[:, None] + LOCAL, :3], 0, -1)
    values = (thread.b[:, :3] @ local.reshape(m, 4, -1)).reshape(m, NINE, count)
    if thread.ridden is not None:
        values[:, RIDING] = (X[:, :, :3].reshape(count, -1) @ thread.ridden.by_qs.reshape(-1, m)).T
    return values.reshape(NINE * m, count)


def banded_solve(A: Array, b: Array) -> Array:
    """Solve the banded system `A` with the right-hand sides `b` (c n, k); both are overwritten.

    Raises `SingularError`.
    """
    h = half_band_of(A)
    lu, pivots, info = dgbtrf(A, h, h, overwrite_ab=1)
    if info != 0:
        raise SingularError(SINGULAR_THREAD)
    x, _ = dgbtrs(lu, h, h, b, pivots, overwrite_b=1)
    return np.asarray(x)


def solve_holds(border: Border, C: Array, G: Array, r: Array, r_y: Array, joints: Joints, sigma: Array) -> Array:
    """Return the solution of the numbered border with the thread eliminated, shape `(m, 15)`.

    The result is that of the kernel with the same name; LAPACK is faster for many holds. Raises
    `SingularError`.
    """
    size, dz = 1 + border.at.max(), np.empty((len(r), BORDER))
    M = np.zeros((size, size + 1))
    kernels.write_matrix(border, C, G, r, r_y, joints, sigma, M)
    _, _, x, info = dgesv(M[:, :-1], M[:, -1])
    if info != 0 or not np.isfinite(x).all():
        raise SingularError(SINGULAR_HOLDS)
    M[:, -1] = x
    kernels.numbers_of(border, C, r_y, joints, M, dz)
    return dz


def newton_directions(
    A: Array,
    held: Indices,
    border: Border,
    C: Array,
    thread: Passage,
    residuals: Sequence[tuple[Array, Array, Array]],
    joined: tuple[Joints, Array] = (NO_JOINTS, NO_SET),
) -> list[tuple[Array, Array]]:
    """Return the Newton directions dq (n, c) and dz (m, 15) for several `residuals`.

    - `A`: the banded matrix of the thread, which is overwritten.
    - `held`: the prescribed unknowns of the thread; their rows and columns of A are those of the
      identity.
    - `C`: the compliance of the organ, shape `(9m, 9m)`.
    - `residuals`: those of the thread (n, c), of the holds (m, 6) and of y (m, 9).
    - `joined`: the joints of ties, and the active set (m,), which decides whether they slide as
      one.

    Raises `SingularError`.
    """
    (n, c), m, count = residuals[0][0].shape, len(residuals[0][1]), len(residuals)
    kernels.number(border, np.max([np.abs(r) for _, r, _ in residuals], axis=0), joined[0])
    pushed = np.flatnonzero(border.push >= 0)
    right = np.empty((c * n, count + pushed.size), order="F")
    right[:, :count] = np.transpose([-r_q.ravel() for r_q, _, _ in residuals])
    right[:, count:] = columns(thread, n, c)[:, pushed]
    right[held] = 0.0
    X = banded_solve(A, right)
    if m == 0:
        return [(X[:, k].reshape(n, c), np.empty((0, BORDER))) for k in range(count)]
    own, by_push = X[:, :count], X[:, count:]
    at_holds = values_at_holds(thread, X.T.reshape(-1, n, c))[border.read.ravel() >= 0]
    G = at_holds[:, count - 1 :].copy()
    out, C = [], np.ascontiguousarray(C)
    for k, (_, r, r_y) in enumerate(residuals):
        G[:, 0] = at_holds[:, k]
        dz = solve_holds(border, C, G, r, r_y, *joined)
        out.append(((own[:, k] - by_push @ np.matvec(border.E, dz).ravel()[pushed]).reshape(n, c), dz))
    return out
