"""The monolithic matrix itself (§4.4, last paragraph): thread, organ, abscissae and multipliers in
one sparse system.

    | A_t        H_qU      H_qs   −Φ_qᵀ         |   dq
    | H_Uq       A_o       H_Us   −YᵀΦ_yᵀ  −Gᵀ  |   dU
    | H_sq       H_sU     H_ss   −Φ_sᵀ         |   ds       (signs of the row of s as in the law of sliding)
    | Φ_q        Φ_y Y     Φ_s                  |   dλ
    |            G_𝒜                     1_∖𝒜 |   dp       (pressed pairs: g = 0; open ones: p = 0)

If pairs rub, the last row is the tangent of Coulomb's law (`coupling.joins.rubbing`), and G
contains the slips too. The places of ties follow U, without stiffness, and the rows of s of their
strands are joined (`coupling.ties`).

The default solver condenses the organ instead (`coupling.step.newton`). The algebra is the same in
another order, at the cost of one back-substitution of the organ. The matrix here is for inspection
and comparison.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.sparse import block_array, block_diag, coo_array, csc_array, csr_array, csr_matrix, diags_array, hstack
from scipy.sparse.linalg import splu

from coupling.answer import all_holds
from coupling.arrays import Array
from coupling.errors import CouplingError
from coupling.interfaces import Body
from coupling.joins.contact import NO_FORCES
from coupling.joins.rubbing import rows_of
from coupling.kernels.border import NINE, OWN, Border
from coupling.kernels.bordered import LAM, MU_V, OF_X, S, Y, columns
from coupling.step.newton import (
    Iterate,
    Problem,
    Residual,
    Solution,
    allowed_share,
    border_of,
    next_axial_force,
    solve,
    thread_matrix,
)
from coupling.step.sliding import sliding_strands
from thread.banded import diagonal_of
from tissue.organs.meshed import Equation

MULTIPLIERS = slice(LAM.start, MU_V + 1)


@dataclass(frozen=True)
class Monolith(Iterate):
    """An iterate with the organ's unknowns `U` (N,) [m] and the contact forces `p` (k,) [N] added
    to those of the thread.
    """

    U: Array
    p: Array = field(default_factory=lambda: NO_FORCES)


@dataclass(frozen=True)
class BlockSystem:
    """A linear system in blocks: `matrix` (size, size), `right` (size,), and the place of each
    unknown, `blocks`.

    The keys of `blocks` are "q", "U", "s", "lam" and "p". q is ordered point by point, U as the
    organ numbers its free unknowns, s and lam hold by hold, and p pair by pair.
    """

    matrix: csc_array
    right: Array
    blocks: dict[str, slice]


@runtime_checkable
class AssembledAnswer(Protocol):
    """An answer with the organ's own rows, as the assembled matrix needs them."""

    @property
    def equation(self) -> Equation:
        """Equation of the organ, linearised at the same state as the answer."""


def equation_of(problem: Problem[Body]) -> Equation:
    """Return the organ's rows of a step. Raises `CouplingError` if the answer has none."""
    if not isinstance(problem.answer, AssembledAnswer):
        raise CouplingError(f"{type(problem.answer).__name__} has no equation to assemble; use the condensed solver")
    return problem.answer.equation


def sparse_band(band: Array) -> coo_array:
    """Return a banded matrix in coordinate form."""
    size = band.shape[1]
    place, column = np.ogrid[: band.shape[0], :size]
    row = place - diagonal_of(band) + column
    column = np.broadcast_to(column, band.shape)
    inside = (row >= 0) & (row < size) & (band != 0.0)
    return coo_array((band[inside], (row[inside], column[inside])), shape=(size, size))


def diagonal(blocks: Array) -> csr_array:
    """Return a sparse matrix with blocks (m, r, k) on its diagonal, shape `(m r, m k)`."""
    m, r, k = blocks.shape
    hold, row, column = np.indices(blocks.shape)
    index = ((hold * r + row).ravel(), (hold * k + column).ravel())
    return csr_array((blocks.ravel(), index), shape=(m * r, m * k))


def assemble(problem: Problem[Body], z: Monolith, r: Residual) -> BlockSystem:
    """Assemble the Newton system of thread and organ at an iterate."""
    organ, (n, c), m, t = equation_of(problem), z.q.shape, len(z.s), len(problem.law.joints.strands)
    border = border_of(problem, z, r.passage)
    V = csr_array(columns(r.passage, n, c))
    Y_all, rest = over_holds(problem, organ.Y), csr_array((3 * t, 3 * t))
    A = block_diag([organ.A, rest], format="csr")
    thread = sparse_band(thread_matrix(problem, z, r))
    J, held_sum = joined_laws(problem, z)
    own = [J @ diagonal(border.B[:, :1]), diagonal(border.B[:, 1:OWN])]
    by_law = [J @ column for column in split_by_unknown(border, "law", Y_all)]
    by_law[1] = by_law[1] + held_sum + J @ csr_array((z.sigma != 0.0)[:, None] * border.S)
    by_F = [-Y_all.T @ x for x in split_by_unknown(border, "F", Y_all)]
    G = csr_array(hstack([csr_array(organ.G), csr_array((len(organ.g0), 3 * t))]))
    by_gap, by_push = law_of_lips(problem, z)
    rows = [
        [thread, *(V @ column for column in split_by_unknown(border, "E", Y_all)), None],
        [
            -Y_all.T @ diagonal(border.R) @ V.T,
            A + by_F[0],
            *by_F[1:],
            -G.T,
        ],
        [own[0] @ V.T, *by_law, None],
        [own[1] @ V.T, *split_by_unknown(border, "phi", Y_all), None],
        [None, by_gap @ G, None, None, by_push],
    ]
    matrix = block_array(rows, format="csr")
    organ_residual = A @ z.U - np.pad(organ.b, (0, 3 * t)) - Y_all.T @ r.f_y.ravel() - G.T @ z.p
    lips = by_gap @ (organ.g0 + G @ z.U) + by_push @ z.p
    right = -np.concatenate([r.thread.ravel(), organ_residual, r.holds[:, S], r.holds[:, 1:OWN].ravel(), lips])
    ends = np.cumsum([0, c * n, len(z.U), m, 5 * m, len(z.p)])
    blocks = {name: slice(int(ends[k]), int(ends[k + 1])) for k, name in enumerate(("q", "U", "s", "lam", "p"))}
    return hold_still(problem, BlockSystem(csc_array(matrix), right, blocks))


def law_of_lips(problem: Problem[Body], z: Iterate) -> tuple[csr_array, csr_array]:
    """Return the factors of the gaps and of the forces of the pairs in the law of contact, shape `(k, k)` each."""
    if problem.contact is not None and problem.contact.rubs:
        return rows_of(problem.contact.law, z.pressed, z.rubbing)
    pressed = z.pressed.astype(np.float64)
    return csr_array(diags_array(pressed)), csr_array(diags_array(1.0 - pressed))


def split_by_unknown(border: Border, which: str, Y_all: csr_array) -> list[csr_array]:
    """Return the columns of a part of the border by unknown: through y to U, then s, then the multipliers."""
    part = {"E": border.E, "F": border.F, "law": border.D[:, :1], "phi": border.D[:, 1:OWN]}[which]
    return [diagonal(part[:, :, Y]) @ Y_all, diagonal(part[:, :, S : S + 1]), diagonal(part[:, :, MULTIPLIERS])]


def joined_laws(problem: Problem[Body], z: Iterate) -> tuple[csr_array, csr_array]:
    """Return the factor of the rows of s for strands of ties that slide together, and the term that
    is added by s.

    The added equation is that the sum of both abscissae is constant. Shape `(m, m)` each.
    """
    J, kept = np.eye(len(z.s)), np.zeros((len(z.s), len(z.s)))
    one, other = sliding_strands(problem.law, z.sigma)
    J[other, one], J[one, one] = -1.0, 0.0
    kept[one, one] = kept[one, other] = 1.0
    return csr_array(J), csr_array(kept)


def over_holds(problem: Problem[Body], Y: csr_matrix) -> csr_array:
    """Return Y over all holds and unknowns, shape `(9m, N + 3t)`.

    The site variables of a clamped end do not move. The strands of a tie have the place of the tie,
    three unknowns after those of the organ.
    """
    system, strands = problem.system, problem.law.joints.strands
    point = np.arange(3 * len(strands))
    row = (NINE * strands[:, :, None] + np.arange(3)).swapaxes(0, 1).ravel()
    others = coo_array(
        (np.ones(row.size), (row - Y.shape[0], np.tile(point, 2))), (NINE * system.holds_off_organ, 3 * len(strands))
    )
    return csr_array(block_diag([Y, others], format="csr"))


def all_variables(problem: Problem[Body], U: Array) -> Array:
    """Return the site variables of all holds from the unknowns `U` (N + 3t,), shape `(m, 9)`."""
    organ, strands = equation_of(problem), problem.law.joints.strands
    N = organ.Y.shape[1]
    y = all_holds(problem.system, organ.y0 + organ.Y @ U[:N])
    y[strands, OF_X] = U[N:].reshape(-1, 1, 3)
    y[strands[:, 0], OF_X] += problem.gaps
    return y


def hold_still(problem: Problem[Body], system: BlockSystem) -> BlockSystem:
    """Replace the rows and columns of the thread's prescribed unknowns by those of the identity."""
    free = np.ones(len(system.right))
    free[problem.system.held] = 0.0
    keep = diags_array(free)
    return replace(
        system, matrix=csc_array(keep @ system.matrix @ keep + diags_array(1.0 - free)), right=free * system.right
    )


Linear = Callable[[BlockSystem], Array]


def solve_direct(system: BlockSystem) -> Array:
    """Solve a block system by sparse LU with row pivoting."""
    return np.asarray(splu(system.matrix).solve(system.right))


def monolithic_solve(problem: Problem[Body], start: Iterate, U: Array, linear: Linear = solve_direct) -> Solution[Body]:
    """Solve a step by Newton's method on the assembled matrix, from `start` and the organ's `U` (N,).

    Each correction is solved by `linear`. The convergence test is that of the condensed solver; its
    row y = y_free + C Φ_yᵀλ checks the organ's equation through its condensation. The iterate of
    the solution is a `Monolith`. Raises `StepError`.
    """

    def correct(problem: Problem[Body], z: Iterate, r: Residual) -> tuple[Problem[Body], Iterate]:
        assert isinstance(z, Monolith)
        system = assemble(problem, z, r)
        x = linear(system)
        x *= allowed_share(problem, x[system.blocks["q"]].reshape(z.q.shape))
        dq = x[system.blocks["q"]].reshape(z.q.shape)
        U_next = z.U + x[system.blocks["U"]]
        return problem, replace(
            z,
            q=z.q + dq,
            N=next_axial_force(problem, r, dq, x[system.blocks["s"]][:, None]),
            s=z.s + x[system.blocks["s"]],
            lam=z.lam + x[system.blocks["lam"]].reshape(-1, 5),
            y=all_variables(problem, U_next),
            U=U_next,
            p=z.p + x[system.blocks["p"]],
        )

    organ = equation_of(problem)
    U = np.concatenate([U, start.y[problem.law.joints.strands[:, 1], OF_X].ravel()])
    y, p = all_variables(problem, U), np.zeros(len(organ.g0))
    first = Monolith(
        start.q, start.N, start.s, start.lam, y, start.sigma, U, p, pressed=start.pressed, rubbing=start.rubbing
    )
    return solve(problem, first, correct)
