"""Factorisation of symmetric positive definite matrices, and the contract of every solver here.

Every solver of A x = b measures ‖Ax − b‖ afterwards and raises `FactorError` where it exceeds `RESIDUAL` of
‖A‖‖x‖ + ‖b‖. Of a single column a factor sees it along `PROBES` random directions, by which one that is thirty
times too large passes five times in 10⁵.
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
PROBES = 3  # directions that a residual is seen along: less than a thirtieth of it is seen five times in 10⁵
PROVING = ("cholmod", "pardiso")  # whose Cholesky refuses a pivot that is not positive
SYMMETRY = 1e-12  # ‖(A − Aᵀ)x‖ / ‖A‖‖x‖
SINGULAR = 1e13  # ‖A‖‖A⁻¹‖ beyond which no digit of a solution to RESIDUAL is left


@dataclass(frozen=True)
class Factor:
    """A factorised symmetric positive definite matrix `A`, shape `(n, n)`. Made by `factorize`."""

    A: csr_matrix
    norm: float
    back_substitute: Callable[[Array], Array]

    def solve(self, b: Array, guess: Callable[[], Array] | None = None, rough: bool = False) -> Array:
        """Return A⁻¹ b for b of shape `(n,)` or `(n, k)`; raise `FactorError` when the residual exceeds its bound.

        The residual of a single column, as of a step in time, is seen along random directions (Freivalds, Proc. IFIP
        Congress 77, 1977): a product with A takes a good part of the time of a back-substitution.
        """
        x = self.back_substitute(b)
        if b.ndim > 1:
            check_residual(self.A, self.norm, x, b)
        else:
            Z, AZ = self.probes
            check_size(float(np.linalg.norm(AZ @ x - Z @ b)) / np.sqrt(PROBES), self.norm, x, b)
        return x

    @cached_property
    def probes(self) -> tuple[Array, Array]:
        """Random directions z, as rows, and A z, shape `(PROBES, n)` each: |zᵀr| is ‖r‖ in the root mean square."""
        Z = np.random.default_rng(0).standard_normal((PROBES, self.A.shape[0]))
        return Z, np.ascontiguousarray((self.A @ Z.T).T)


def factorize(
    A: csr_matrix,
    places: Array | None = None,
    method: str = "superlu",
    one_of_many: bool = False,
    pattern: direct.Pattern | None = None,
) -> Factor:
    """Factorise `A`; `places` `(n, 3)` of its unknowns allow a better ordering.

    `method` "cholmod" needs cvxopt, "pardiso" pypardiso. Of `one_of_many` tangents of an organ that is held, positive
    pivots are proof enough: the search for an eigenvalue next to zero takes a dozen back-substitutions. Their `pattern`
    keeps what they share, None for a matrix that is alone. Raises `FactorError` when A is not symmetric, singular or
    not definite.
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


def factorize_indefinite(A: csr_matrix) -> Factor:
    """Factorise a symmetric matrix by LU with row exchanges, whatever the signs of its eigenvalues.

    Raises `FactorError` if it is singular.
    """
    A = csr_matrix(A)
    return Factor(A, float(np.max(abs(A) @ np.ones(A.shape[0]), initial=0.0)), direct.indefinite(A))


def check_residual(A: csr_matrix, norm: float, x: Array, b: Array, allowed: float = RESIDUAL) -> None:
    """Raise `FactorError` if ‖Ax − b‖ exceeds the `allowed` part of its scale, column by column."""
    check_size(np.linalg.norm(A @ x - b, axis=0), norm, x, b, allowed)


def check_size(residual: Array | float, norm: float, x: Array, b: Array, allowed: float = RESIDUAL) -> None:
    """Raise `FactorError` if the size of a residual exceeds the `allowed` part of its scale, for each column."""
    scale = norm * np.linalg.norm(x, axis=0) + np.linalg.norm(b, axis=0)
    if not np.all(residual <= allowed * scale):  # also catches what is not a number
        worst = float(np.max(residual / np.maximum(scale, np.finfo(float).tiny)))
        raise FactorError(f"‖Ax − b‖ = {worst:.1e} (‖A‖‖x‖ + ‖b‖), allowed is {allowed:g}")


def checked_norm(A: csr_matrix) -> float:
    """Return ‖A‖ (the largest row sum) of a square symmetric matrix with a positive diagonal. Raises `FactorError`."""
    if A.shape[0] != A.shape[1]:
        raise FactorError(f"the matrix has shape {A.shape}; only a square one can be factorised")
    norm = float(np.max(abs(A) @ np.ones(A.shape[0]), initial=0.0))
    x = np.random.default_rng(0).standard_normal(A.shape[0])  # Aᵀ itself would be a second copy of a large matrix
    difference = float(np.linalg.norm(A @ x - A.T @ x))
    if not difference <= SYMMETRY * norm * np.linalg.norm(x):
        raise FactorError(f"the matrix is not symmetric: ‖(A − Aᵀ)x‖ = {difference:.1e}, ‖A‖ = {norm:.1e}")
    if A.shape[0] and not A.diagonal().min() > 0.0:
        raise FactorError(f"the matrix is not positive definite: its diagonal goes down to {A.diagonal().min():.1e}")
    return norm


def _check_definite(factor: Factor) -> None:
    """Refuse a matrix whose eigenvalue next to zero is not positive or is lost in round-off.

    The eigenvalue is found by inverse iteration from three starts.
    """
    # SuperLU can give up its pivots only as a second copy of the whole factor, so their signs are not read.
    x = np.random.default_rng(0).standard_normal((factor.A.shape[0], 3))
    for _ in range(4):
        x /= np.linalg.norm(x, axis=0)
        b, x = x, factor.solve(x)
        inverse = np.linalg.norm(x, axis=0)
        if factor.norm * inverse.max() > SINGULAR:
            raise FactorError(f"the matrix is singular: ‖A‖‖A⁻¹‖ > {factor.norm * inverse.max():.0e}; hold the body")
        if np.einsum("ij,ij->j", b, x).min() <= 0.0:
            raise FactorError("the matrix is not positive definite: xᵀA⁻¹x < 0")
