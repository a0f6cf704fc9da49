"""Factorisation of symmetric positive definite matrices, and the contract of every solver here.

Every solver of A x = b measures the residual ‖Ax − b‖ of its solution. It raises `FactorError` if
the residual exceeds `RESIDUAL` times ‖A‖‖x‖ + ‖b‖. A factor measures the residual along `PROBES`
random directions (Freivalds, Proc. IFIP Congress 77, 1977). A residual thirty times too large then
passes with a probability of 5 in 10⁵.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from tissue.arrays import Array
from tissue.errors import FactorError
from tissue.solvers import direct

Direct = Callable[[csr_matrix, Array | None, direct.Pattern], direct.BackSubstitution]

METHODS: dict[str, Direct] = {"superlu": direct.superlu, "cholmod": direct.cholmod, "pardiso": direct.pardiso}
RESIDUAL = 1e-10  # ‖Ax − b‖ / (‖A‖‖x‖ + ‖b‖): the bound on every solver here
PROBES = 3  # random directions: the measured residual is below 1/30 of the true one with a probability of 5 in 10⁵
PROVING = ("cholmod", "pardiso")  # their Cholesky factorisation fails at a pivot that is not positive
SYMMETRY = 1e-12  # ‖(A − Aᵀ)x‖ / ‖A‖‖x‖
SINGULAR = 1e13  # with a larger ‖A‖‖A⁻¹‖, a solution within RESIDUAL has no correct digit


@dataclass(frozen=True)
class Factor:
    """A factorised symmetric positive definite matrix `A`, shape `(n, n)`. Made by `factorize`."""

    A: csr_matrix
    norm: float
    back_substitute: Callable[[Array], Array]

    def solve(self, b: Array, guess: Callable[[], Array] | None = None, rough: bool = False) -> Array:
        """Return A⁻¹ b for b of shape `(n,)` or `(n, k)`.

        Raises `FactorError` if the residual exceeds its bound.
        """
        x, (Z, AZ) = self.back_substitute(b), self.probes
        check_size(np.linalg.norm(AZ @ x - Z @ b, axis=0) / np.sqrt(PROBES), self.norm, x, b)
        return x

    @cached_property
    def probes(self) -> tuple[Array, Array]:
        """Random directions z, as rows, and A z, shape `(PROBES, n)` each: the root mean square of
        |zᵀr| is ‖r‖. A product of the solution with A itself takes a large part of the time of a
        back-substitution.
        """
        Z = np.random.default_rng(0).standard_normal((PROBES, self.A.shape[0]))
        return Z, np.ascontiguousarray((self.A @ Z.T).T)


def factorize(
    A: csr_matrix,
    places: Array | None = None,
    method: str = "superlu",
    one_of_many: bool = False,
    pattern: direct.Pattern | None = None,
) -> Factor:
    """Return the factor of `A`; `places` `(n, 3)` of its unknowns allow a better ordering.

    `method` "cholmod" needs cvxopt, "pardiso" pypardiso. For `one_of_many` tangents of a held
    organ, positive pivots are a sufficient check. The search for an eigenvalue near zero would take
    a dozen back-substitutions. Tangents with the same `pattern` share their symbolic factorisation;
    None means a single matrix. Raises `FactorError` if A is not symmetric, singular or not positive
    definite.
    """
    if method not in METHODS:
        raise FactorError(f"method = {method!r}: allowed are {', '.join(map(repr, METHODS))}")
    if not direct.is_installed(method):
        raise FactorError(f"method = {method!r} needs {direct.LIBRARIES[method]}; install it or take 'superlu'")
    A = csr_matrix(A)
    norm = checked_norm(A)
    if not A.shape[0]:
        return Factor(A, norm, np.copy)
    factor = Factor(A, norm, METHODS[method](A, places, pattern or direct.Pattern()))
    if not (one_of_many and method in PROVING):
        _check_definite(factor)
    return factor


def factorize_indefinite(A: csr_matrix, places: Array | None = None, pattern: direct.Pattern | None = None) -> Factor:
    """Return the LU factor with row exchanges of a symmetric matrix with eigenvalues of any sign.

    `places` and `pattern` are those of `factorize`. Raises `FactorError` if the matrix is singular.
    """
    A = csr_matrix(A)
    norm = float(np.max(abs(A) @ np.ones(A.shape[0]), initial=0.0))
    return Factor(A, norm, direct.indefinite(A, places, pattern or direct.Pattern()))


def check_size(residual: Array | float, norm: float, x: Array, b: Array, allowed: float = RESIDUAL) -> None:
    """Raise `FactorError` if the `residual` of a column exceeds the `allowed` fraction of ‖A‖‖x‖ +
    ‖b‖.
    """
    scale = norm * np.linalg.norm(x, axis=0) + np.linalg.norm(b, axis=0)
    if not np.all(residual <= allowed * scale):  # also true if the residual is not a number
        worst = float(np.max(residual / np.maximum(scale, np.finfo(float).tiny)))
        raise FactorError(f"‖Ax − b‖ = {worst:.1e} (‖A‖‖x‖ + ‖b‖), allowed is {allowed:g}")


def checked_norm(A: csr_matrix) -> float:
    """Return ‖A‖, the largest row sum, of a square symmetric matrix with a positive diagonal.

    Raises `FactorError` for any other matrix.
    """
    if A.shape[0] != A.shape[1]:
        raise FactorError(f"the matrix has shape {A.shape}; only a square matrix can be factorised")
    norm = float(np.max(abs(A) @ np.ones(A.shape[0]), initial=0.0))
    x = np.random.default_rng(0).standard_normal(A.shape[0])  # Aᵀ itself would be a second copy of a large matrix
    difference = float(np.linalg.norm(A @ x - A.T @ x))
    if not difference <= SYMMETRY * norm * np.linalg.norm(x):
        raise FactorError(f"the matrix is not symmetric: ‖(A − Aᵀ)x‖ = {difference:.1e}, ‖A‖ = {norm:.1e}")
    if A.shape[0] and not A.diagonal().min() > 0.0:
        raise FactorError(f"the matrix is not positive definite: its diagonal goes down to {A.diagonal().min():.1e}")
    return norm


def _check_definite(factor: Factor) -> None:
    """Raise `FactorError` if the eigenvalue nearest to zero is not positive or is below round-off.

    The eigenvalue is found by inverse iteration from three starts.
    """
    # SuperLU returns its pivots only with a second copy of the whole factor. Their signs are
    # therefore not checked.
    x = np.random.default_rng(0).standard_normal((factor.A.shape[0], 3))
    for _ in range(4):
        x /= np.linalg.norm(x, axis=0)
        b, x = x, factor.solve(x)
        inverse = np.linalg.norm(x, axis=0)
        if factor.norm * inverse.max() > SINGULAR:
            raise FactorError(f"the matrix is singular: ‖A‖‖A⁻¹‖ > {factor.norm * inverse.max():.0e}; hold the body")
        if np.einsum("ij,ij->j", b, x).min() <= 0.0:
            raise FactorError("the matrix is not positive definite: xᵀA⁻¹x < 0")
