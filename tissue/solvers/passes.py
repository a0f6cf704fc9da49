"""Passes of conjugate gradients and of multigrid over fields of several columns, `(n, k)`, each over memory once.

Between two products with a large matrix a pass takes as long as the memory that it reads and writes. So these loops,
compiled by Numba when they are first called, write into fields that belong to whoever calls; which these are is said of
each. Sums are in double precision and in the order of the rows.
"""

import numpy as np

from tissue.arrays import Array, Single
from tissue.loops import compiled


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
    """Return r·z and q·z of residuals, what their last change was a multiple of, and what the preconditioner makes of
    r, shape `(k,)` each."""
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
    """Write x + step p into `x` and r − step q into `r`, with the step of each column `(k,)`; return r·r and x·x, shape
    `(k,)` each."""
    rr, xx = np.zeros(x.shape[1]), np.zeros(x.shape[1])
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            x[i, k] += step[k] * p[i, k]
            r[i, k] -= step[k] * q[i, k]
            rr[k] += r[i, k] * r[i, k]
            xx[k] += x[i, k] * x[i, k]
    return rr, xx


@compiled
def relax(
    keep: np.float32, pull: np.float32, scaling: Single, b: Single, product: Single, d: Single, x: Single
) -> None:
    """Write the next correction, keep d + pull D⁻¹(b − `product`), into `d`, and x with it added into `x`; `scaling` is
    the diagonal of D⁻¹, `(n,)`, and `product` A x."""
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            d[i, k] = keep * d[i, k] + pull * (scaling[i] * (b[i, k] - product[i, k]))
            x[i, k] += d[i, k]
