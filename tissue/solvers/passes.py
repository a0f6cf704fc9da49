"""Compiled loops of conjugate gradients and of multigrid over fields of several columns, `(n, k)`.

Between two products with a large matrix, the time of a loop is the time of its memory access. Each
loop therefore passes over memory once and writes its results into fields of the caller. Its
docstring names these fields. Numba compiles the loops at their first call. Sums are in double
precision and in the order of the rows.
"""

import numpy as np
from numpy.typing import NDArray

from tissue.arrays import Array, Single
from tissue.loops import compiled

Numbers = NDArray[np.int32]


@compiled
def dot(a: Array, b: Array) -> Array:
    """Return the scalar products column by column, shape `(k,)`."""
    out = np.zeros(a.shape[1])
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            out[k] += a[i, k] * b[i, k]
    return out


@compiled
def conjugation(r: Array, q: Array, z: Array | Single) -> tuple[Array, Array]:
    """Return r·z and q·z, shape `(k,)` each.

    r are residuals, q is their last change up to a factor, and z are the preconditioned residuals.
    """
    new, turned = np.zeros(r.shape[1]), np.zeros(r.shape[1])
    for i in range(r.shape[0]):
        for k in range(r.shape[1]):
            new[k] += r[i, k] * z[i, k]
            turned[k] += q[i, k] * z[i, k]
    return new, turned


@compiled
def turn(z: Array | Single, beta: Array, p: Array) -> None:
    """Write the next direction z + β p into `p`, with β of each column `(k,)`."""
    for i in range(p.shape[0]):
        for k in range(p.shape[1]):
            p[i, k] = z[i, k] + beta[k] * p[i, k]


@compiled
def advance(step: Array, p: Array, q: Array, x: Array, r: Array) -> tuple[Array, Array]:
    """Write x + step p into `x` and r − step q into `r`, and return r·r and x·x, shape `(k,)` each.

    `step` `(k,)` has one number per column.
    """
    rr, xx = np.zeros(x.shape[1]), np.zeros(x.shape[1])
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            x[i, k] += step[k] * p[i, k]
            r[i, k] -= step[k] * q[i, k]
            rr[k] += r[i, k] * r[i, k]
            xx[k] += x[i, k] * x[i, k]
    return rr, xx


@compiled
def product_by_rows(first: Numbers, at: Numbers, values: Array, x: Array, out: Array) -> None:
    """Write A x into `out`, `(m, k)`, for a matrix A stored by rows.

    The entries of a row begin at index `first`; `at` are their columns and `values` their numbers,
    `(e,)` each. Four entries at a time are added to sums that are read and written once.
    """
    sums = np.empty(x.shape[1])
    for i in range(first.size - 1):
        sums[:] = 0.0
        j, end = first[i], first[i + 1]
        while j + 4 <= end:
            a, b, c, d = values[j], values[j + 1], values[j + 2], values[j + 3]
            u, v, w, z = x[at[j]], x[at[j + 1]], x[at[j + 2]], x[at[j + 3]]
            for k in range(x.shape[1]):
                sums[k] = (((sums[k] + a * u[k]) + b * v[k]) + c * w[k]) + d * z[k]
            j += 4
        while j < end:
            a, u = values[j], x[at[j]]
            for k in range(x.shape[1]):
                sums[k] += a * u[k]
            j += 1
        out[i] = sums


@compiled
def product(first: Numbers, at: Numbers, blocks: Single, x: Single, out: Single) -> None:
    """Write A x into `out`, `(m, k)`, for a matrix A in blocks whose sides are multiples of three.

    The blocks of a row begin at index `first`; `at` `(b,)` are their columns and `blocks` `(b, r,
    c)` their numbers. Sums are in the order of the columns.
    """
    high, wide = blocks.shape[1], blocks.shape[2]
    for i in range(first.size - 1):
        for p in range(0, high, 3):
            row = high * i + p
            y0, y1, y2 = out[row], out[row + 1], out[row + 2]
            for k in range(x.shape[1]):
                y0[k] = y1[k] = y2[k] = 0.0
            for j in range(first[i], first[i + 1]):
                for q in range(0, wide, 3):
                    a, c = blocks[j], wide * at[j] + q
                    a00, a01, a02 = a[p, q], a[p, q + 1], a[p, q + 2]  # read once: the compiler cannot know that
                    a10, a11, a12 = a[p + 1, q], a[p + 1, q + 1], a[p + 1, q + 2]  # `out` is another array
                    a20, a21, a22 = a[p + 2, q], a[p + 2, q + 1], a[p + 2, q + 2]
                    for k in range(x.shape[1]):
                        u, v, w = x[c, k], x[c + 1, k], x[c + 2, k]
                        y0[k] = ((y0[k] + a00 * u) + a01 * v) + a02 * w
                        y1[k] = ((y1[k] + a10 * u) + a11 * v) + a12 * w
                        y2[k] = ((y2[k] + a20 * u) + a21 * v) + a22 * w


@compiled
def product_of_one(first: Numbers, at: Numbers, blocks: Single, x: Single, out: Single) -> None:
    """Write A x into `out` as `product` does, for a single column `(n, 1)`.

    The sums stay in registers.
    """
    high, wide = blocks.shape[1], blocks.shape[2]
    for i in range(first.size - 1):
        for p in range(0, high, 3):
            y0 = y1 = y2 = np.float32(0.0)
            for j in range(first[i], first[i + 1]):
                a = blocks[j]
                for q in range(0, wide, 3):
                    c = wide * at[j] + q
                    u, v, w = x[c, 0], x[c + 1, 0], x[c + 2, 0]
                    y0 = ((y0 + a[p, q] * u) + a[p, q + 1] * v) + a[p, q + 2] * w
                    y1 = ((y1 + a[p + 1, q] * u) + a[p + 1, q + 1] * v) + a[p + 1, q + 2] * w
                    y2 = ((y2 + a[p + 2, q] * u) + a[p + 2, q + 1] * v) + a[p + 2, q + 2] * w
            row = high * i + p
            out[row, 0], out[row + 1, 0], out[row + 2, 0] = y0, y1, y2


@compiled
def relax(
    keep: np.float32, pull: np.float32, scaling: Single, b: Single, product: Single, d: Single, x: Single
) -> None:
    """Write the next correction, keep d + pull D⁻¹(b − `product`), into `d`, and add it to `x`.

    `scaling` is the diagonal of D⁻¹, `(n,)`, and `product` is A x.
    """
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            d[i, k] = keep * d[i, k] + pull * (scaling[i] * (b[i, k] - product[i, k]))
            x[i, k] += d[i, k]


@compiled
def relax_zero(pull: np.float32, scaling: Single, b: Single, d: Single, x: Single) -> None:
    """Write the result of `relax` for x = 0, pull D⁻¹b, into `d` and `x`.

    Both can be uninitialised.
    """
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            d[i, k] = x[i, k] = pull * (scaling[i] * b[i, k])
