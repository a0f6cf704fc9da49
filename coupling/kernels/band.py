"""A symmetric matrix over the thread, in 3 × 3 blocks of points that are at most three apart.

`A` (n + 3, 3, 12): row x of point i, with columns for the unknowns of the points i to i + 3. The
entries below the diagonal of the first block are not read, and the last three points are padding.
If the matrix is positive definite, L D Lᵀ without pivoting is as accurate as any other
factorisation. Under compression the matrix can be indefinite; it is then solved with row pivoting,
at three times the cost.
"""

import numpy as np

from coupling.arrays import Array, Flags
from thread.kernels.loops import loop, owning

REACH = 3  # coupled points on each side, for a cubic spline
HALF = 3 * (REACH + 1) - 1  # diagonals on each side
BLOCK = 64  # columns of a full matrix that are eliminated together; a product then updates all others


@loop
def hold_still(A: Array, held: Flags) -> None:
    """Replace the rows and columns of the unknowns `held` (n, 3) by those of the identity."""
    for i in range(len(held)):
        for x in range(3):
            if held[i, x]:
                for c in range(A.shape[2]):
                    A[i, x, c] = 0.0
                for k in range(min(i, REACH) + 1):
                    for y in range(3):
                        A[i - k, y, 3 * k + x] = 0.0
                A[i, x, x] = 1.0


@owning
def factorise(A: Array) -> bool:
    """Factorise in place: 1/D on the diagonal, and the rows of Lᵀ to its right.

    Returns False if A is not positive definite.
    """
    U = np.zeros((3, 12))
    for i in range(len(A) - REACH):
        B = A[i]
        for x in range(3):
            if not B[x, x] > 0.0:
                return False
            for z in range(x + 1, 3):
                lower = B[x, z] / B[x, x]
                for c in range(z, 12):
                    B[z, c] -= lower * B[x, c]
        for x in range(3):
            for c in range(12):
                U[x, c] = B[x, c]
        for x in range(3):
            B[x, x] = 1.0 / U[x, x]
            for c in range(x + 1, 12):
                B[x, c] *= B[x, x]
        for k in range(1, REACH + 1):
            for x in range(3):
                a, b, c, row = B[0, 3 * k + x], B[1, 3 * k + x], B[2, 3 * k + x], A[i + k, x]
                for z in range(12 - 3 * k):
                    row[z] -= a * U[0, 3 * k + z] + b * U[1, 3 * k + z] + c * U[2, 3 * k + z]
    return True


@loop
def solve_lower(A: Array, X: Array, first: int) -> None:
    """Replace `X` (n + 3, 3, k) by L⁻¹X.

    All columns of X except the first are zero before the point `first`.
    """
    for i in range(len(A) - REACH):
        columns, B = X.shape[2] if i >= first else 1, A[i]
        x, y, z = X[i, 0], X[i, 1], X[i, 2]
        xy, xz, yz = B[0, 1], B[0, 2], B[1, 2]
        for j in range(columns):
            y[j] -= xy * x[j]
            z[j] -= xz * x[j] + yz * y[j]
        for k in range(3, 12):
            a, b, c, row = B[0, k], B[1, k], B[2, k], X[i + k // 3, k % 3]
            for j in range(columns):
                row[j] -= a * x[j] + b * y[j] + c * z[j]


@loop
def solve_upper(A: Array, X: Array) -> None:
    """Replace `X` (n + 3, 3, k) by L⁻ᵀD⁻¹X."""
    for i in range(len(A) - REACH - 1, -1, -1):
        columns, B = X.shape[2], A[i]
        x, y, z = X[i, 0], X[i, 1], X[i, 2]
        xy, xz, yz = B[0, 1], B[0, 2], B[1, 2]
        for j in range(columns):
            x[j], y[j], z[j] = x[j] * B[0, 0], y[j] * B[1, 1], z[j] * B[2, 2]
        for k in range(3, 12):
            a, b, c, row = B[0, k], B[1, k], B[2, k], X[i + k // 3, k % 3]
            for j in range(columns):
                x[j] -= a * row[j]
                y[j] -= b * row[j]
                z[j] -= c * row[j]
        for j in range(columns):
            y[j] -= yz * z[j]
            x[j] -= xy * y[j] + xz * z[j]


@owning
def full_band(A: Array) -> Array:
    """Return the matrix row by row with room for row pivoting: entry (i, c) is at (i, c − i + HALF)."""
    size = 3 * (len(A) - REACH)
    band = np.zeros((size, 3 * HALF + 1))
    for i in range(size):
        for c in range(i, min(size, 3 * (i // 3 + REACH + 1))):
            entry = A[i // 3, i % 3, c - 3 * (i // 3)]
            band[i, c - i + HALF] = entry
            band[c, i - c + HALF] = entry
    return band


@loop
def eliminate_by_exchanges(band: Array, X: Array) -> bool:
    """Eliminate the entries below the diagonal of a full band with row pivoting, together with `X`
    (n + 3, 3, k).

    X are the right-hand sides. The pivot is the largest entry of the column. Returns False if all
    entries of a column are zero.
    """
    size, columns = len(band), X.shape[2]
    for j in range(size):
        below, right, best = min(size, j + HALF + 1), min(size, j + 2 * HALF + 1), j
        for i in range(j + 1, below):
            if abs(band[i, j - i + HALF]) > abs(band[best, j - best + HALF]):
                best = i
        if band[best, j - best + HALF] == 0.0:
            return False
        if best != j:
            for c in range(j, right):
                one, other = band[j, c - j + HALF], band[best, c - best + HALF]
                band[j, c - j + HALF], band[best, c - best + HALF] = other, one
            for z in range(columns):
                swapped = X[j // 3, j % 3, z]
                X[j // 3, j % 3, z] = X[best // 3, best % 3, z]
                X[best // 3, best % 3, z] = swapped
        for i in range(j + 1, below):
            factor = band[i, j - i + HALF] / band[j, HALF]
            for c in range(j + 1, right):
                band[i, c - i + HALF] -= factor * band[j, c - j + HALF]
            for z in range(columns):
                X[i // 3, i % 3, z] -= factor * X[j // 3, j % 3, z]
    return True


@owning
def solve_by_exchanges(A: Array, X: Array) -> bool:
    """Replace `X` (n + 3, 3, k) by A⁻¹X, with row pivoting. Returns False if A is singular."""
    band = full_band(A)
    size, columns = len(band), X.shape[2]
    if not eliminate_by_exchanges(band, X):
        return False
    for j in range(size - 1, -1, -1):
        for c in range(j + 1, min(size, j + 2 * HALF + 1)):
            for z in range(columns):
                X[j // 3, j % 3, z] -= band[j, c - j + HALF] * X[c // 3, c % 3, z]
        for z in range(columns):
            X[j // 3, j % 3, z] /= band[j, HALF]
    return True


@owning
def solve_band(A: Array, X: Array, first: int) -> bool:
    """Replace `X` (n + 3, 3, k) by A⁻¹X. Returns False if A is singular.

    All columns of X except the first are zero before the point `first`.
    """
    factors = A.copy()
    if not factorise(factors):
        return solve_by_exchanges(A, X)
    solve_lower(factors, X, first)
    solve_upper(factors, X)
    return True


@owning
def solve_dense(M: Array) -> bool:
    """Solve for the right-hand sides in the last columns of `M` (k, k + …), in place, with row pivoting.

    Returns False if the matrix is singular. The elimination is by blocks of columns (Golub and Van
    Loan, Matrix Computations, 3.4.7).
    """
    k, width = M.shape
    for first in range(0, k, BLOCK):
        last = min(first + BLOCK, k)
        if not eliminate(M, first, last, last if last < k else width):
            return False
        if last < k:
            eliminate_from_rest(M, first, last)
    for j in range(k - 1, -1, -1):
        for z in range(k, width):
            for c in range(j + 1, k):
                M[j, z] -= M[j, c] * M[c, z]
            M[j, z] /= M[j, j]
    return True


@loop
def eliminate(M: Array, first: int, last: int, end: int) -> bool:
    """Eliminate the columns from `first` to `last` of `M` below the diagonal, up to the column `end`.

    The factors of the rows replace the eliminated numbers. Returns False if all entries of a column
    are zero.
    """
    k, width = M.shape
    for j in range(first, last):
        best = j
        for i in range(j + 1, k):
            if abs(M[i, j]) > abs(M[best, j]):
                best = i
        if M[best, j] == 0.0:
            return False
        if best != j:
            for c in range(first, width):
                M[j, c], M[best, c] = M[best, c], M[j, c]
        for i in range(j + 1, k):
            factor = M[i, j] / M[j, j]
            M[i, j] = factor
            if factor != 0.0:
                for c in range(j + 1, end):
                    M[i, c] -= factor * M[j, c]
    return True


@owning
def eliminate_from_rest(M: Array, first: int, last: int) -> None:
    """Update the columns of `M` from `last` on by the factors of the columns from `first` to `last`."""
    k, width = M.shape
    for i in range(first + 1, last):
        for j in range(first, i):
            for c in range(last, width):
                M[i, c] -= M[i, j] * M[j, c]
    factors, rows = np.empty((k - last, last - first)), np.empty((last - first, width - last))
    for j in range(first, last):
        for i in range(last, k):
            factors[i - last, j - first] = M[i, j]
        for c in range(last, width):
            rows[j - first, c - last] = M[j, c]
    change = np.empty((k - last, width - last))
    np.dot(factors, rows, change)
    for i in range(last, k):
        for c in range(last, width):
            M[i, c] -= change[i - last, c - last]
