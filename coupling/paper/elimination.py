"""The paper's own solver of the linear step (§4.1): the accelerations are eliminated and the
multipliers remain.
"""

from dataclasses import dataclass

import numpy as np

from coupling.arrays import Array
from coupling.errors import CouplingError
from coupling.interfaces import Body
from coupling.kernels.border import BORDER, NINE
from coupling.kernels.bordered import (
    PHI,
    S,
    SingularError,
    Y,
    banded_solve,
    columns,
    values_at_holds,
)
from coupling.paper.assembled import sparse_band
from coupling.paper.linear_step import Answer, Posed


@dataclass(frozen=True)
class Elimination:
    """The system `matrix` λ = `right` after the elimination of the accelerations, in units of Δt² a.

    `matrix` (5m, 5m) = L A⁻¹ Lᵀ + L_s L_sᵀ/ε + Φ_y C Φ_yᵀ is symmetric, with ones for inactive
    constraints. `q` (c n,) and `s` (m,) are the tendencies, and `q_of` (c n, 5m), `s_of` (m, 5m)
    the corrections by λ.
    """

    matrix: Array
    right: Array
    q: Array
    s: Array
    q_of: Array
    s_of: Array


def elimination(posed: Posed[Body]) -> Elimination:
    """Eliminate the accelerations by tendency and correction (§4.1).

    Raises `CouplingError` at ε = 0, and `SingularError`.
    """
    problem, border = posed.problem, posed.border
    slides, inertia = posed.guess.sigma != 0.0, problem.law.inertia
    if not inertia[slides].all():
        raise CouplingError(
            "epsilon = 0: the elimination of tendency and correction divides by it; give epsilon > 0 or solve_whole"
        )
    L, L_s, L_y = (block_diagonal(x) for x in (border.B[:, PHI], border.D[:, PHI, S : S + 1], border.D[:, PHI, Y]))
    right = np.column_stack([-posed.r_q.ravel(), columns(posed.at, *posed.r_q.shape) @ L.T])
    right[problem.system.held] = 0.0
    X = banded_solve(posed.band(), np.asfortranarray(right))
    LX = L @ values_at_holds(posed.at, X.T.reshape(-1, *posed.r_q.shape))
    per_inertia = np.where(slides, 1.0, 0.0) / np.where(slides, inertia, 1.0)
    s, s_of = np.where(slides, per_inertia, -1.0) * posed.r[:, S], per_inertia[:, None] * L_s.T
    matrix = LX[:, 1:] + L_s @ s_of + L_y @ problem.C @ L_y.T + np.diag(1.0 - problem.rows.ravel())
    return Elimination(matrix, -posed.r[:, PHI].ravel() - LX[:, 0] - L_s @ s, X[:, 0], s, X[:, 1:], s_of)


def solve_by_elimination(posed: Posed[Body]) -> Answer:
    """Solve by the paper's own elimination (§4.1), for ε > 0; the condition number grows as 1/ε.

    Raises `CouplingError`, `SingularError`.
    """
    reduced, border = elimination(posed), posed.border
    try:
        lam = np.linalg.solve(reduced.matrix, reduced.right)
    except np.linalg.LinAlgError as error:
        raise SingularError("the matrix of the multipliers is singular: two constraints are equivalent") from error
    dz = np.zeros((len(posed.r), BORDER))
    dz[:, S], dz[:, PHI] = reduced.s + reduced.s_of @ lam, lam.reshape(-1, 5)
    dz[:, Y] = (posed.problem.C @ np.matvec(border.F, dz).ravel()).reshape(-1, NINE)
    return (reduced.q + reduced.q_of @ lam).reshape(posed.r_q.shape), dz


def whole_matrix(posed: Posed[Body]) -> Array:
    """Return the matrix of the whole system without units, shape `(c n + 6m, c n + 6m)`, for its
    condition number.

        [[A/μ, 0, −Lᵀ], [0, ε/μ, −L_sᵀ], [L, L_s, μ/Δt² Φ_y C Φ_yᵀ]]

    The units are 1 m/s² for accelerations, the largest entry μ of A for λ, and the mean span ℓ for
    directions. Rows of prescribed unknowns and of inactive constraints are those of the identity.
    """
    problem, border, dt = posed.problem, posed.border, posed.problem.dt
    thread, held = problem.system.thread, problem.system.held
    A = dt**2 * sparse_band(problem.inertia + posed.tangent).toarray()
    mu, span = np.abs(A).max(), (thread.spline.end - thread.spline.start) / (thread.n - 3)
    unit = np.tile([1.0, 1.0, 1.0, span, span], len(posed.r))[:, None]
    L, L_s, L_y = (
        block_diagonal(x) * unit for x in (border.B[:, PHI], border.D[:, PHI, S : S + 1], border.D[:, PHI, Y])
    )
    L, A = L @ columns(posed.at, *posed.r_q.shape).T, A / mu
    A[held], A[:, held], L[:, held] = 0.0, 0.0, 0.0
    A[held, held] = 1.0
    slides, size = posed.guess.sigma != 0.0, len(A)
    eps = np.diag(np.where(slides, problem.law.inertia * dt**2 / mu, 1.0))
    compliance = mu / dt**2 * L_y @ problem.C @ L_y.T + np.diag(1.0 - problem.rows.ravel())
    none = np.zeros((size, len(slides)))
    return np.block([[A, none, -L.T], [none.T, eps, -(slides * L_s).T], [L, L_s, compliance]])


def block_diagonal(blocks: Array) -> Array:
    """Return a dense matrix with blocks (m, r, k) on its diagonal, shape `(m r, m k)`."""
    m, r, k = blocks.shape
    out = np.zeros((m, r, m, k))
    out[np.arange(m), :, np.arange(m)] = blocks
    return out.reshape(m * r, m * k)
