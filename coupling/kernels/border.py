"""The linearised holds, and one Newton direction of thread and holds (`coupling.kernels.bordered`)."""

from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.kernels.band import REACH, solve_dense
from coupling.kernels.friction import Joints, Law, linearise_law
from coupling.kernels.holes import Held, Hold, hold_among
from thread.kernels.loops import entry, loop, numbers, owning
from thread.kernels.records import record
from thread.kernels.vectors import add_column, add_matrix, add_row, diagonal, dot

LAW, S, LAM, MU_U, MU_V, X, U, V = numbers(0, 0, 1, 4, 5, 6, 9, 12)  # row of the law; columns of a hold's unknowns
G, C1, C2 = numbers(1, 4, 5)  # rows of B and D, after the row of the law of sliding
AT_P, AT_T, AT_K = numbers(0, 3, 6)  # the thread's nine numbers
OF_X, OF_U, OF_V = numbers(0, 3, 6)  # the organ's nine numbers
NINE, OWN, BORDER = 9, 6, 15
LARGEST = 1e300  # a number that is not below this is inf or nan; if sums are reordered, x − x can be zero for nan


@record
class Border(NamedTuple):
    """The linearised holds, block by block over `m` holds.

    Thread: A dq + V E dz = −r_q. Holds: B Vᵀdq + D dz = −r. Organ: dy − C (F dz + R Vᵀdq) = −r_y.
    The blocks are `E` (m, 9, 15), `B` (m, 6, 9), `D` (m, 6, 15), `F` (m, 9, 15) and `R` (m, 9, 9).
    `S` (m, m) is −∂²Π/∂s² of a thread whose knots travel; it is added to D in the laws of sliding.
    The V of such a thread has one column H_qs in the place of b''.

    E = (H_qs, −Φ_qᵀ, H_qy), F = (−H_ys, Φ_yᵀ, −H_yy) and R = −H_yq. Here q means the thread's nine
    numbers at a hold, (P, T, T'). The first row of B and D is the law of sliding; the other rows
    are Φ_q and (Φ_s, 0, Φ_y). The named blocks are views: a change of a named block changes the
    border.

    `at` (15m,) numbers the unknowns that are solved for. `read` and `push` (m, 9) number those of
    (P, T, T') on which the holds depend and on which they exert forces. All are −1 for the others.
    """

    E: Array
    B: Array
    D: Array
    F: Array
    R: Array
    S: Array
    at: Indices
    read: Indices
    push: Indices

    @property
    def H_qs(self) -> Array:
        """−∂(Φ_qᵀλ)/∂s, shape `(m, 9)`."""
        return self.E[:, :, 0]

    @property
    def H_qy(self) -> Array:
        """−∂(Φ_qᵀλ)/∂y, shape `(m, 9, 9)`; H_qU = H_qy Y."""
        return self.E[:, :, OWN:]

    @property
    def Phi_q(self) -> Array:
        """∂Φ/∂(P, T, T'), shape `(m, 5, 9)`; Φ_q of the control points is `Phi_q` Vᵀ."""
        return self.B[:, 1:]

    @property
    def Phi_s(self) -> Array:
        """∂Φ/∂s, shape `(m, 5)`."""
        return self.D[:, 1:, 0]

    @property
    def Phi_y(self) -> Array:
        """∂Φ/∂y, shape `(m, 5, 9)`."""
        return self.D[:, 1:, OWN:]

    @property
    def minus_H_ys(self) -> Array:
        """∂(Φ_yᵀλ)/∂s, shape `(m, 9)`."""
        return self.F[:, :, 0]


@loop
def clear_border(border: Border) -> None:
    """Set the blocks of each hold to zero."""
    for block in (border.E, border.B, border.D, border.F, border.R):
        for k in range(block.shape[0]):
            for i in range(block.shape[1]):
                for j in range(block.shape[2]):
                    block[k, i, j] = 0.0


@loop
def linearise(h: Hold, E: Array, B: Array, D: Array, F: Array, R: Array) -> None:
    """Linearise Φ = (g, c₁, c₂) and the forces Φ_qᵀλ, Φ_yᵀλ of one hold into blocks of zeros (`Border`)."""
    one = diagonal(1.0)

    add_matrix(1.0, one, B, G, AT_P)
    add_row(1.0, h.u, B, C1, AT_T)
    add_row(1.0, h.v, B, C2, AT_T)
    add_column(1.0, h.P_s, D, G, S)
    D[C1, S] += dot(h.K, h.u)
    D[C2, S] += dot(h.K, h.v)
    add_matrix(-1.0, one, D, G, X)
    add_row(1.0, h.T, D, C1, U)
    add_row(1.0, h.T, D, C2, V)

    if h.rides:
        E[AT_K, S] += 1.0
    else:
        add_column(-1.0, h.lam, E, AT_T, S)
        add_column(-1.0, h.m, E, AT_K, S)
    add_matrix(-1.0, one, E, AT_P, LAM)
    add_column(-1.0, h.u, E, AT_T, MU_U)
    add_column(-1.0, h.v, E, AT_T, MU_V)
    add_matrix(-h.mu_u, one, E, AT_T, U)
    add_matrix(-h.mu_v, one, E, AT_T, V)

    add_matrix(-1.0, one, F, OF_X, LAM)
    add_column(1.0, h.T, F, OF_U, MU_U)
    add_column(1.0, h.T, F, OF_V, MU_V)
    add_column(h.mu_u, h.K, F, OF_U, S)
    add_column(h.mu_v, h.K, F, OF_V, S)

    add_matrix(h.mu_u, one, R, OF_U, AT_T)
    add_matrix(h.mu_v, one, R, OF_V, AT_T)


@loop
def linearise_hold(law: Law, k: int, sigma: float, h: Hold, rows: Flags, border: Border) -> None:
    """Linearise hold k into its part of a border, with the active constraints `rows` (5,)."""
    B, D = border.B[k], border.D[k]
    linearise(h, border.E[k], B, D, border.F[k], border.R[k])
    linearise_law(law, k, sigma, h, B, D)
    drop_constraints(B, D, rows)


@loop
def drop_constraints(B: Array, D: Array, rows: Flags) -> None:
    """Replace the rows of inactive constraints by λ = 0; `rows` (5,) are the active constraints."""
    for j in range(5):
        if not rows[j]:
            for z in range(NINE):
                B[1 + j, z] = 0.0
            for z in range(BORDER):
                D[1 + j, z] = 0.0
            D[1 + j, 1 + j] = 1.0


@loop
def put_columns(first: int, b: Array, orders: int, X: Array, push: Indices) -> None:
    """Write V = (b, b', b'') ⊗ I₃ of one hold into its columns of `X` (n + 3, 3, 1 + k), which are zero before.

    Only the first `orders` of b, b', b'' are written. `push` (9,) gives the columns.
    """
    for order in range(orders):
        for x in range(3):
            column = 1 + push[3 * order + x]
            for i in range(4 if column > 0 else 0):
                X[first + i, x, column] = b[order, i]


@loop
def put_riding(k: int, by_qs: Array, X: Array, column: int) -> None:
    """Write H_qs of hold k into a column of `X` (n + 3, 3, 1 + k)."""
    for i in range(len(by_qs)):
        for x in range(3):
            X[i, x, column] = by_qs[i, x, k]


@loop
def values_riding(k: int, by_qs: Array, X: Array, row: Array) -> None:
    """Add H_qsᵀ X of hold k to its `row` (1 + k,) of the values, which is zero before."""
    for i in range(len(by_qs)):
        for x in range(3):
            weight = by_qs[i, x, k]
            if weight != 0.0:
                for j in range(len(row)):
                    row[j] += weight * X[i, x, j]


@loop
def values_at_hold(first: int, b: Array, orders: int, X: Array, out: Array, read: Indices) -> None:
    """Write Vᵀ X of one hold to its rows of `out` (t, 1 + k), given by `read` (9,).

    Only the first `orders` of b, b', b'' are used.
    """
    for order in range(orders):
        b0, b1, b2, b3 = b[order, 0], b[order, 1], b[order, 2], b[order, 3]
        for x in range(3):
            if read[3 * order + x] < 0:
                continue
            row = out[read[3 * order + x]]
            r0, r1, r2, r3 = X[first, x], X[first + 1, x], X[first + 2, x], X[first + 3, x]
            for j in range(len(row)):
                row[j] = b0 * r0[j] + b1 * r1[j] + b2 * r2[j] + b3 * r3[j]


@loop
def site_residual(joints: Joints, C: Array, y_free: Array, gaps: Array, y: Array, f_y: Array, out: Array) -> None:
    """Write y − y_free − C f_y into `out` (m, 9).

    The residuals of x are different for the two strands of a tie. They are x_a − x_b minus the gap
    between the strands, from `gaps` (t, 3) [m], and the sum of the two forces times the compliance.
    """
    for i in range(len(C)):
        moved = 0.0
        for j in range(len(C)):
            moved += C[i, j] * f_y[j // NINE, j % NINE]
        k, x = i // NINE, i % NINE
        out[k, x] = y[k, x] - y_free[k, x] - moved
    for tie in range(len(joints.strands)):
        a, b = joints.strands[tie, 0], joints.strands[tie, 1]
        for x in range(3):
            out[a, x] = y[a, x] - y[b, x] - gaps[tie, x]
            out[b, x] = joints.compliance * (f_y[a, x] + f_y[b, x])


@loop
def stiffen_hold(
    scale: float, rows: Flags, b: Array, border: Border, holds: Array, k: int, K: Array, push: Array
) -> None:
    """Add the stiffness of the constraints of hold k to the thread: its terms in E, in `K` (9, 9)
    and in `push` (9,).

    E gets Φ_qᵀ Γ (Φ_s ds + Φ_y dy), `K` gets Φ_qᵀ Γ Φ_q over (P, T, T'), and `push` gets Φ_qᵀ Γ Φ.
    The scale of Γ is the `scale` [N/m] of the thread's matrix over its control points.
    """
    B, D, E, square = border.B[k], border.D[k], border.E[k], 0.0
    for i in range(4):
        square += b[0, i] ** 2 + b[1, i] ** 2
    for c in range(5):
        gamma = (scale if c < 3 else scale / square) if rows[c] else 0.0
        row, by_hold = B[1 + c], D[1 + c]
        for i in range(NINE):
            weighted = gamma * row[i]
            if weighted != 0.0:
                for j in range(BORDER):
                    E[i, j] += weighted * by_hold[j]
                for j in range(NINE):
                    K[i, j] += weighted * row[j]
                push[i] += weighted * holds[1 + c]


@loop
def is_given(border: Border, r: Array, k: int, row: int) -> bool:
    """Return whether a row of hold k only keeps its own unknown unchanged, as for an inactive multiplier."""
    given = r[k, row] == 0.0
    for z in range(NINE):
        given &= border.B[k, row, z] == 0.0
    for z in range(BORDER):
        given &= border.D[k, row, z] == (1.0 if z == row else 0.0)
    return given


@loop
def number_unknowns(border: Border, r: Array, joints: Joints) -> None:
    """Number the unknowns of the holds that are solved for, in `at`.

    These are s, the active multipliers and, for a strand of a tie, its x. For another number of a
    site the unknown is its force, if the force depends on the thread. The rest of dy follows from
    the forces.
    """
    at = border.at
    for i in range(len(at)):
        k, j = i // BORDER, i % BORDER
        at[i] = -1
        if j < OWN:
            at[i] = -1 if j > 0 and is_given(border, r, k, j) else 0
        else:
            for z in range(NINE):
                if border.R[k, j - OWN, z] != 0.0:
                    at[i] = 0
    for tie in range(len(joints.strands)):
        for side in range(2):
            for x in range(3):
                at[BORDER * joints.strands[tie, side] + OWN + x] = 0
    count = 0
    for i in range(len(at)):
        if at[i] == 0:
            at[i] = count
            count += 1


@loop
def number_border(border: Border, r: Array, joints: Joints) -> tuple[int, int]:
    """Number the unknowns, and P, T and T' in `read` and `push`; return the counts of these two.

    A hold without a direction, for example, exerts no force on T.
    """
    number_unknowns(border, r, joints)
    reads, pushes, at = 0, 0, border.at
    for k in range(len(border.E)):
        E, B, R = border.E[k], border.B[k], border.R[k]
        for i in range(NINE):
            read = push = False
            for z in range(OWN):
                read |= at[BORDER * k + z] >= 0 and B[z, i] != 0.0
                push |= at[BORDER * k + z] >= 0 and E[i, z] != 0.0
            for j in range(NINE):
                read |= R[j, i] != 0.0
                push |= E[i, OWN + j] != 0.0
            border.read[k, i] = reads if read else -1
            border.push[k, i] = pushes if push else -1
            reads += read
            pushes += push
    return reads, pushes


@loop
def is_strand(joints: Joints, k: int) -> bool:
    """Return whether hold k is a strand of a tie."""
    found = False
    for tie in range(len(joints.strands)):
        found |= joints.strands[tie, 0] == k or joints.strands[tie, 1] == k
    return found


@owning
def solve_holds(
    border: Border, C: Array, G: Array, r: Array, r_y: Array, joints: Joints, sigma: Array, dz: Array
) -> bool:
    """Solve the numbered border for `dz` (m, 15), with the thread eliminated. Returns False if the
    matrix is singular.

    The other arguments are those of `holds_matrix`.
    """
    size = 0
    for i in range(len(border.at)):
        size = max(size, 1 + border.at[i])
    M = np.zeros((size, size + 1))
    holds_matrix(border, C, G, r, r_y, joints, sigma, M)
    if not solve_dense(M):
        return False
    spread_numbers(border, C, r_y, joints, M, dz)
    return True


@owning
def spread_numbers(border: Border, C: Array, r_y: Array, joints: Joints, M: Array, dz: Array) -> None:
    """Write the solved unknowns of the holds, and dy = C (F dz + R Vᵀdq) − r_y, into `dz` (m, 15).

    The solved unknowns are the last column of `M` (k, k + 1).
    """
    at, force = border.at, np.zeros(C.shape[0])
    for k in range(len(r_y)):
        for j in range(BORDER):
            dz[k, j] = M[at[BORDER * k + j], len(M)] if at[BORDER * k + j] >= 0 else 0.0
        for i in range(NINE):
            for z in range(OWN):
                force[NINE * k + i] += border.F[k, i, z] * dz[k, z]
            force[NINE * k + i] += dz[k, OWN + i]
    for k in range(len(r_y)):
        strand = is_strand(joints, k)
        for i in range(NINE):
            if strand and i < 3:
                continue
            moved = 0.0
            for j in range(len(force)):
                moved += C[NINE * k + i, j] * force[j]
            dz[k, OWN + i] = moved - r_y[k, i]


@owning
def holds_matrix(
    border: Border, C: Array, G: Array, r: Array, r_y: Array, joints: Joints, sigma: Array, M: Array
) -> None:
    """Write the equations of the holds into `M` (k, k + 1), which is zero before; the last column
    is the right-hand side.

    The thread is eliminated by Vᵀdq = w − G E dz, and the sites by dy = C (F dz + R Vᵀdq) − r_y.
    The first column of `G` (t, 1 + k) is w.
    """
    m, size, at = len(r), len(M), border.at
    force = forces_on_sites(border, joints, size)
    sites = sparse_product(C, force)
    for k in range(m):
        strand = is_strand(joints, k)
        for i in range(NINE):
            row = sites[NINE * k + i]
            if strand and i < 3:
                row[at[BORDER * k + OWN + i]] = 1.0
            else:
                row[size] = -r_y[k, i]
    thread = np.zeros((len(G), size + 1))
    np.dot(G, pushes_on_thread(border, sites, G.shape[1]), thread)
    for k in range(m):
        add_own_equations(border, k, thread, sites, r, M)
        if len(sigma) > 0 and sigma[k] != 0.0:
            for other in range(m):
                M[at[BORDER * k], at[BORDER * other]] += border.S[k, other]
        add_force_equations(border, k, thread, M)
    join_sites(joints, force, r_y, at, M)
    join_laws(joints, sigma, r, at, M)


@owning
def sparse_product(A: Array, X: Array) -> Array:
    """Return A X of a matrix `X` with few entries."""
    count = 0
    rows, columns = np.empty(X.size, np.int64), np.empty(X.size, np.int64)
    for i in range(len(X)):
        for z in range(X.shape[1]):
            if X[i, z] != 0.0:
                rows[count], columns[count] = i, z
                count += 1
    out = np.zeros((len(A), X.shape[1]))
    for a in range(len(A)):
        for e in range(count):
            out[a, columns[e]] += A[a, rows[e]] * X[rows[e], columns[e]]
    return out


@owning
def forces_on_sites(border: Border, joints: Joints, size: int) -> Array:
    """Return F dz + R Vᵀdq over the unknowns in use, shape `(9m, size + 1)`, with a last column of zeros."""
    at, force = border.at, np.zeros((NINE * len(border.F), size + 1))
    for k in range(len(border.F)):
        strand = is_strand(joints, k)
        for i in range(NINE):
            for z in range(OWN):
                if at[BORDER * k + z] >= 0:
                    force[NINE * k + i, at[BORDER * k + z]] += border.F[k, i, z]
            place = at[BORDER * k + OWN + i]
            if place >= 0 and not (strand and i < 3):
                force[NINE * k + i, place] = 1.0
    return force


@owning
def pushes_on_thread(border: Border, sites: Array, rows: int) -> Array:
    """Return −E dz over the unknowns in use, shape `(rows, size + 1)`; the last column is the constant part.

    The first row belongs to w, the thread without these forces. `sites` is dy in the same form.
    """
    E, at, push = border.E, border.at, border.push
    out = np.zeros((rows, sites.shape[1]))
    out[0, sites.shape[1] - 1] = 1.0
    for k in range(len(E)):
        for i in range(NINE):
            if push[k, i] < 0:
                continue
            row = out[1 + push[k, i]]
            for z in range(OWN):
                if at[BORDER * k + z] >= 0:
                    row[at[BORDER * k + z]] -= E[k, i, z]
            for j in range(NINE):
                by_site = E[k, i, OWN + j]
                if by_site != 0.0:
                    for z in range(len(row)):
                        row[z] -= by_site * sites[NINE * k + j, z]
    return out


@loop
def add_own_equations(border: Border, k: int, thread: Array, sites: Array, r: Array, M: Array) -> None:
    """Add B Vᵀdq + D dz = −r of hold k to its rows.

    `thread` (t, size + 1) is Vᵀdq of the thread's numbers, and `sites` (9m, size + 1) is dy.
    """
    last, at, read = M.shape[1] - 1, border.at, border.read
    for i in range(OWN):
        if at[BORDER * k + i] < 0:
            continue
        row = M[at[BORDER * k + i]]
        for j in range(NINE):
            b, d = border.B[k, i, j], border.D[k, i, OWN + j]
            if b != 0.0:
                for z in range(last + 1):
                    row[z] += b * thread[read[k, j], z]
            if d != 0.0:
                for z in range(last + 1):
                    row[z] += d * sites[NINE * k + j, z]
        for z in range(OWN):
            if at[BORDER * k + z] >= 0:
                row[at[BORDER * k + z]] += border.D[k, i, z]
        row[last] = -row[last] - r[k, i]


@loop
def add_force_equations(border: Border, k: int, thread: Array, M: Array) -> None:
    """Add f − R Vᵀdq = 0 for the forces on the site of hold k that depend on the thread."""
    last = M.shape[1] - 1
    for i in range(NINE):
        pushed, own = False, border.at[BORDER * k + OWN + i]
        for j in range(NINE):
            push = border.R[k, i, j]
            if push != 0.0 and own >= 0:
                pushed = True
                for z in range(last + 1):
                    M[own, z] -= push * thread[border.read[k, j], z]
        if pushed:
            M[own, own] += 1.0
            M[own, last] = -M[own, last]


@loop
def join_laws(joints: Joints, sigma: Array, r: Array, at: Indices, M: Array) -> None:
    """Join the laws of holds that slide as one.

    The first equation is then that the sum of their abscissae is constant. The second is the
    difference of both laws. Their residuals in `r` (m, 6) are already joined.
    """
    last = M.shape[1] - 1
    for pair in range(len(joints.pairs)):
        first = joints.pairs[pair, 0]
        if sigma[first] == 0.0:
            continue
        one, other = at[BORDER * first], at[BORDER * joints.pairs[pair, 1]]
        for c in range(last + 1):
            M[other, c] -= M[one, c]
            M[one, c] = 0.0
        M[other, last] -= r[first, LAW]
        M[one, last] = -r[first, LAW]
        M[one, one] = M[one, other] = 1.0


@loop
def join_sites(joints: Joints, force: Array, r_y: Array, at: Indices, M: Array) -> None:
    """Replace the equations of the strands' x by those of their ties.

    Both strands are at one place, and the sum of the forces on them is zero.
    """
    last = M.shape[1] - 1
    for tie in range(len(joints.strands)):
        for x in range(3):
            a, b = joints.strands[tie, 0], joints.strands[tie, 1]
            first, second = at[BORDER * a + OWN + x], at[BORDER * b + OWN + x]
            for z in range(last + 1):
                M[first, z] = 0.0
                M[second, z] = joints.compliance * (force[NINE * a + x, z] + force[NINE * b + x, z])
            M[first, first], M[first, second], M[first, last] = 1.0, -1.0, -r_y[a, x]
            M[second, last] -= r_y[b, x]


@owning
def thread_direction(border: Border, dz: Array, X: Array, dq: Array) -> bool:
    """Write dq = −A⁻¹r_q − A⁻¹V E dz, shape `(n, 3)`, from `X` (n + 3, 3, 1 + k).

    Returns False if an entry is inf or nan.
    """
    E, at, push = border.E, border.push, np.zeros(X.shape[2] - 1)
    for k in range(len(E)):
        for i in range(NINE):
            for z in range(BORDER if at[k, i] >= 0 else 0):
                push[at[k, i]] += E[k, i, z] * dz[k, z]
    for i in range(len(X) - REACH):
        for x in range(3):
            moved = X[i, x, 0]
            for j in range(len(push)):
                moved -= X[i, x, 1 + j] * push[j]
            if not abs(moved) < LARGEST:
                return False
            dq[i, x] = moved
    return True


@loop
def linearise_all(law: Law, sigma: Array, rows: Flags, at: Held, border: Border) -> None:
    """Linearise all holds into a `border` of zeros, with the active constraints `rows` (m, 5)."""
    for k in range(len(at.lam)):
        linearise_hold(law, k, sigma[k], hold_among(at, k), rows[k], border)


@loop
def stiffen_all(scale: float, rows: Flags, b: Array, border: Border, holds: Array, K: Array, push: Array) -> None:
    """Stiffen the thread at every hold as in `stiffen_hold`; `K` (m, 9, 9) and `push` (m, 9) are zero before."""
    for k in range(len(holds)):
        stiffen_hold(scale, rows[k], b[k], border, holds[k], k, K[k], push[k])


linearise_holds, number = entry(linearise_all), entry(number_border)
write_matrix = entry(holds_matrix)
site_residuals, stiffen_holds, numbers_of = entry(site_residual), entry(stiffen_all), entry(spread_numbers)
