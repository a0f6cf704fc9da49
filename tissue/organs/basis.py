"""A small basis for the motion of an organ under forces at its sites and under its loads.

    V = [Φ,  K⁻¹F,  (K⁻¹M) K⁻¹F,  …,  (K⁻¹M)ᵏ K⁻¹F],   F = [Yᵀ, weight, loads]

The first block holds the static answers to all forces, so that slow motion is exact. Then follow k
blocks of a Krylov space. Each of them matches two more moments of the transfer function from forces
to sites (Su & Craig, AIAA J. 29, 1991). The lowest modes Φ are optional. Rayleigh damping is a
function of M and K, so that the space with damping is the same. V is orthonormal in K.

The residual of U = V η in the equation of motion, r = F f − M V (η̈ + α η̇) − K V (η + β η̇), is
orthogonal to V. F and K V lie in the space of K V, and M V does except for its last block. Hence

    K⁻¹ r = −(I − V VᵀK) K⁻¹M V (η̈ + α η̇),   ‖r‖ in K⁻¹ = ‖R (η̈ + α η̇)‖

with one small matrix R: the dual norm of the residual needs no solve.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import LinearOperator, eigsh

from tissue.arrays import Array

DEPENDENT = 1e-8  # of a vector's length in K: a smaller new direction is round-off
MODES = 1e-10  # relative residual of the modes: the basis need not contain them exactly
MASSLESS = 1e-14  # of the largest 1/ω² of a basis: a smaller value is round-off, and the mode has no mass


@dataclass(frozen=True)
class ModalBasis:
    """A basis in which stiffness is the identity and mass is diagonal.

    `vectors` has shape `(N, r)`, and `mu` (r,) = 1/ω² [s²]. `missed` is the matrix R of the module,
    shape `(m, r)`.
    """

    vectors: Array
    mu: Array
    missed: Array


@dataclass(frozen=True)
class Krylov:
    """Vectors V `(N, r)`, orthonormal in K; the first `inner` of them exclude the last block.

    `M` is VᵀMV. `missed` has two matrices R: of the vectors without the last block, and of all
    vectors.
    """

    vectors: Array
    inner: int
    M: Array
    missed: tuple[Array, Array]

    def modal(self, inner: bool) -> ModalBasis:
        """Return the modes in the space of all vectors, or without the last block if `inner`."""
        r = self.inner if inner else self.M.shape[0]
        mu, Q = np.linalg.eigh(self.M[:r, :r])
        mu = np.where(mu > MASSLESS * mu[-1], mu, 0.0)
        return ModalBasis(self.vectors[:, :r] @ Q, mu, self.missed[0 if inner else 1] @ Q)


def build_krylov(
    K: csr_matrix, M: csr_matrix, solve: Callable[[Array], Array], forces: Array, blocks: int, modes: Array
) -> Krylov:
    """Return the basis of `modes` (N, m), of the static answers to `forces` (N, f) and of `blocks`
    + 1 further blocks.

    `solve` returns K⁻¹ b.
    """
    inner_products = Orthonormal(K)
    inner_products.extend(modes)
    last = inner_products.extend(solve(forces))
    for _ in range(blocks):
        last = inner_products.extend(solve(np.asarray(M @ last)))
    r = inner_products.V.shape[1]
    outer = inner_products.extend(solve(np.asarray(M @ last)))
    V = inner_products.V
    rest = inner_products.without(solve(np.asarray(M @ outer)))
    reduced = V.T @ np.asarray(M @ V)
    missed = np.zeros((outer.shape[1], V.shape[1]))
    missed[:, r:] = _root(rest.T @ np.asarray(K @ rest))
    # Without the last block, the residual of K⁻¹M V lies in that block alone. R is then the block of VᵀM V that
    # couples the two.
    return Krylov(V, r, 0.5 * (reduced + reduced.T), (reduced[r:, :r], missed))


def vibration_modes(K: csr_matrix, M: csr_matrix, solve: Callable[[Array], Array], count: int) -> Array:
    """Return the `count` lowest vibration modes, shape `(N, count)`."""
    N = K.shape[0]
    inverse = LinearOperator((N, N), matvec=lambda b: solve(np.ravel(b)))
    _, modes = eigsh(K, count, M, sigma=0.0, OPinv=inverse, tol=MODES, v0=np.ones(N))
    return np.asarray(modes)


class Orthonormal:
    """Vectors orthonormal in K, which grow block by block."""

    def __init__(self, K: csr_matrix, expected: int = 0) -> None:
        """Allocate memory for `expected` vectors; more memory is allocated when needed."""
        self.K, self._size = K, 0
        self._room = np.empty((2, K.shape[0], expected))  # V and K V; copying both took half of the time of a block

    @property
    def V(self) -> Array:
        """The vectors, shape `(N, r)`."""
        return np.asarray(self._room[0, :, : self._size])

    @property
    def KV(self) -> Array:
        """K V, shape `(N, r)`."""
        return np.asarray(self._room[1, :, : self._size])

    def extend(self, X: Array) -> Array:
        """Add the new directions of vectors `(N, k)`, made orthonormal, and return them."""
        lengths = self._lengths(X)
        X = X[:, lengths > 0.0] / lengths[lengths > 0.0]
        for tolerance in (DEPENDENT, 0.5):  # the second pass removes round-off only
            X = self.without(X)
            w, Q = np.linalg.eigh(X.T @ np.asarray(self.K @ X))
            X = X @ (Q[:, w > tolerance**2] / np.sqrt(w[w > tolerance**2]))
        self._append(X, np.asarray(self.K @ X))
        return X

    def _append(self, X: Array, KX: Array) -> None:
        """Append vectors `(N, k)` and their products with K."""
        before, self._size = self._size, self._size + X.shape[1]
        if self._size > self._room.shape[2]:
            wider = np.empty((*self._room.shape[:2], max(self._size, before + before // 2)))
            wider[:, :, :before] = self._room[:, :, :before]
            self._room = wider
        self._room[:, :, before : self._size] = X, KX

    def without(self, X: Array) -> Array:
        """Return vectors `(N, k)` without their components in the basis."""
        return X - self.V @ (self.KV.T @ X)

    def _lengths(self, X: Array) -> Array:
        return np.sqrt(np.einsum("ij,ij->j", X, np.asarray(self.K @ X)))


def _root(gram: Array) -> Array:
    """Return R with RᵀR = `gram`, a symmetric matrix that is positive semidefinite up to round-off."""
    w, Q = np.linalg.eigh(gram)
    return np.asarray(np.sqrt(np.maximum(w, 0.0))[:, None] * Q.T)
