"""Conjugate gradients for several right-hand sides at a time, preconditioned by multigrid or by the
diagonal.

The columns of Yᵀ are solved together, because one pass over the matrix then serves all columns.
Between two products, each field is also read only once (`tissue.solvers.passes`). The
preconditioner works in single precision and is therefore not exactly the same map in every call.
The direction is conjugated by Polak and Ribière's formula, which tolerates this (Golub and Ye, SIAM
J. Sci. Comput. 21, 1999).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from tissue.arrays import Array, Single
from tissue.errors import FactorError
from tissue.solvers.factor import RESIDUAL, check_size, checked_norm
from tissue.solvers.multigrid import multigrid

Preconditioner = Callable[[Array], Array | Single]

TOLERANCE = 1e-11  # ‖r‖ / ‖b‖: the residual does work; 1e-10 leaves 2e-12 of it in the audit, 1e-8 leaves 3e-11
ROUGH = 1e-7  # ‖r‖ / ‖b‖ for products of second order in the error: error 1e-8 of a column, 1e-14 of products
ROUND_OFF = 1e-15  # a smaller ‖r‖ / ‖A‖‖x‖ is round-off
ITERATIONS = 500
COLUMNS = 20  # solved together: two holes; a product of K with 20 columns takes 1.3 times as long as with 10
KEPT = 2**25  # bytes; malloc requests a larger field from the system anew each time


@dataclass(frozen=True)
class ConjugateGradients:
    """A symmetric positive definite matrix `A` `(n, n)` with an iterative solution for each
    right-hand side.

    Made by `conjugate_gradients`.
    """

    A: csr_matrix
    norm: float
    preconditioner: Preconditioner

    def solve(self, b: Array, guess: Callable[[], Array] | None = None, rough: bool = False) -> Array:
        """Return A⁻¹ b for b of shape `(n,)` or `(n, k)`.

        The iteration starts from `guess()`, or from zero if `guess` is None. With `rough` its
        tolerance is `ROUGH`.
        """
        if b.ndim == 2:
            parts = np.array_split(b, -(-b.shape[1] // COLUMNS), axis=1) if b.size else []
            return np.hstack([np.empty((len(b), 0)), *(self.solve_together(part, None, rough) for part in parts)])
        return self.solve_together(b, None if guess is None else guess(), rough)

    def solve_together(self, b: Array, guess: Array | None = None, rough: bool = False) -> Array:
        """Return A⁻¹ b with all columns solved together; they must fit into memory."""
        x, _ = self.iterate(np.ascontiguousarray(b), guess, rough)
        check_size(np.linalg.norm(self.A @ x - b, axis=0), self.norm, x, b, ROUGH if rough else RESIDUAL)
        return x

    def iterate(self, b: Array, guess: Array | None = None, rough: bool = False) -> tuple[Array, int]:
        """Return the solution, and the number of iterations.

        Raises `FactorError` if the iterations do not converge.
        """
        from tissue.solvers import passes

        shape, b = b.shape, b.reshape(len(b), -1)
        x = np.zeros_like(b) if guess is None else guess.reshape(b.shape).copy()
        r = b.copy() if guess is None else b - self.A @ x
        tolerance = ROUGH if rough else TOLERANCE
        goal = tolerance * np.sqrt(passes.dot(b, b))
        p, q, rz, step = np.zeros_like(b), np.zeros_like(b), np.zeros_like(goal), np.zeros_like(goal)
        rr, xx = passes.dot(r, r), passes.dot(x, x)
        for iteration in range(ITERATIONS + 1):
            left = np.sqrt(rr)
            if np.all(left <= np.maximum(goal, ROUND_OFF * self.norm * np.sqrt(xx))):
                return x.reshape(shape), iteration
            z = self.preconditioner(r)
            new, along = passes.conjugation(r, q, z)
            passes.turn(z, _ratio(-step * along, rz), p)
            del z  # before the next cycle, because fields of many columns need the most memory
            self._multiply(p, q)
            rz = new
            curvature = passes.dot(p, q)
            if not np.all(curvature >= 0.0):
                raise FactorError("the matrix is not positive definite: pᵀAp < 0 in conjugate gradients")
            step = _ratio(rz, curvature)
            rr, xx = passes.advance(step, p, q, x, r)
        worst = float(np.max(_ratio(left, goal / tolerance)))
        raise FactorError(
            f"conjugate gradients: ‖Ax − b‖ = {worst:.1e} ‖b‖ after {ITERATIONS} iterations, allowed is {tolerance:g}; "
            "take a direct solver, a Poisson ratio further from 0.5 or cells of better shape"
        )

    def _multiply(self, p: Array, q: Array) -> None:
        """Write A p into `q`, `(n, k)` each."""
        from tissue.solvers.passes import product_by_rows

        if p.nbytes <= KEPT:
            q[...] = self.A @ p
        else:
            product_by_rows(self.A.indptr, self.A.indices, self.A.data, p, q)


def conjugate_gradients(A: csr_matrix, places: Array | None = None) -> ConjugateGradients:
    """Return conjugate gradients with multigrid for a stiffness matrix over unknowns at `places`
    `(n, 3)`.

    Without `places`, for a mass matrix, the preconditioner is the diagonal. Raises `FactorError` if
    A is not symmetric.
    """
    A = csr_matrix(A)
    norm = checked_norm(A)
    if places is not None:
        return ConjugateGradients(A, norm, multigrid(A, places))
    scaling = 1.0 / A.diagonal()
    return ConjugateGradients(A, norm, lambda r: (scaling * r.T).T)


def _ratio(a: Array, b: Array) -> Array:
    """Return a / b column by column; zero in a column with b = 0."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0.0)
