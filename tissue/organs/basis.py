"""A small basis for the motion of an organ that is pulled at its sites and by its loads.

    V = [Φ,  K⁻¹F,  (K⁻¹M) K⁻¹F,  …,  (K⁻¹M)ᵏ K⁻¹F],   F = [Yᵀ, weight, loads]

Static answers to all that pulls, so that what is slow is exact, then k blocks of a Krylov space, each of which matches
two more moments of the transfer function from forces to sites (Su & Craig, AIAA J. 29, 1991), and the lowest modes Φ
where they are asked for. Rayleigh damping is a function of M and K, so that the space is the same with it. V is
orthonormal in K.

What U = V η leaves of the equation of motion, r = F f − M V (η̈ + α η̇) − K V (η + β η̇), is orthogonal to V. F and K V
are in K V, and so is M V but for its last block. Hence

    K⁻¹ r = −(I − V VᵀK) K⁻¹M V (η̈ + α η̇),   ‖r‖ in K⁻¹ = ‖R (η̈ + α η̇)‖

with one small matrix R: the dual norm of the residual takes no solve.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import LinearOperator, eigsh

from tissue.arrays import Array

DEPENDENT = 1e-8  # of a vector's length in K: what is left of it beside those before is round-off
MODES = 1e-10  # relative residual of the modes: they need not be exact, the basis has only to hold them nearly
MASSLESS = 1e-14  # of the largest 1/ω² of a basis: what is below has no mass but round-off


@dataclass(frozen=True)
class ModalBasis:
    """A basis in which stiffness is the identity and mass diagonal: `vectors` (N, r), `mu` (r,) = 1/ω² [s²]; `missed`
    is R, shape `(m, r)`, of the module."""

    vectors: Array
    mu: Array
    missed: Array


@dataclass(frozen=True)
class Krylov:
    """Vectors V `(N, r)` orthonormal in K, the first `inner` of them without the last block, and M V.

    `M` is VᵀMV, and `missed` R of the vectors without and with the last block.
    """

    vectors: Array
    inner: int
    M: Array
    missed: tuple[Array, Array]

    def modal(self, inner: bool) -> ModalBasis:
        """Return the basis of all vectors, or of those without the last block, by its own modes."""
        r = self.inner if inner else self.M.shape[0]
        mu, Q = np.linalg.eigh(self.M[:r, :r])
        mu = np.where(mu > MASSLESS * mu[-1], mu, 0.0)
        return ModalBasis(self.vectors[:, :r] @ Q, mu, self.missed[0 if inner else 1] @ Q)


def build_krylov(
    K: csr_matrix, M: csr_matrix, solve: Callable[[Array], Array], forces: Array, blocks: int, modes: Array
) -> Krylov:
    """Return the basis of `modes` (N, m), of the static answers to `forces` (N, f) and of `blocks` + 1 blocks, by
    `solve`, which makes K⁻¹ b."""
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
    # Without the last block, K⁻¹M V leaves what lies along that block alone: VᵀM V of the two.
    return Krylov(V, r, 0.5 * (reduced + reduced.T), (reduced[r:, :r], missed))


def vibration_modes(K: csr_matrix, M: csr_matrix, solve: Callable[[Array], Array], count: int) -> Array:
    """Return the `count` lowest vibration modes, shape `(N, count)`."""
    N = K.shape[0]
    inverse = LinearOperator((N, N), matvec=lambda b: solve(np.ravel(b)))
    _, modes = eigsh(K, count, M, sigma=0.0, OPinv=inverse, tol=MODES, v0=np.ones(N))
    return np.asarray(modes)


class Orthonormal:
    """Vectors orthonormal in K, to which others are added block by block."""

    def __init__(self, K: csr_matrix, expected: int = 0) -> None:
        """``expected``: vectors for which there is room at once; for more there is room made."""
        self.K, self._size = K, 0
        self._room = np.empty((2, K.shape[0], expected))  # V and K V: copied at every block they took half of its time

    @property
    def V(self) -> Array:
        """The vectors, shape `(N, r)`."""
        return np.asarray(self._room[0, :, : self._size])

    @property
    def KV(self) -> Array:
        """K V, shape `(N, r)`."""
        return np.asarray(self._room[1, :, : self._size])

    def extend(self, X: Array) -> Array:
        """Add the new directions of vectors `(N, k)`, and return them, orthonormal."""
        lengths = self._lengths(X)
        X = X[:, lengths > 0.0] / lengths[lengths > 0.0]
        for tolerance in (DEPENDENT, 0.5):  # the second time round-off alone is taken off
            X = self.without(X)
            w, Q = np.linalg.eigh(X.T @ np.asarray(self.K @ X))
            X = X @ (Q[:, w > tolerance**2] / np.sqrt(w[w > tolerance**2]))
        self._append(X, np.asarray(self.K @ X))
        return X

    def _append(self, X: Array, KX: Array) -> None:
        """Put vectors `(N, k)`, and what K makes of them, behind those that are there."""
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
    """Return R of RᵀR = a matrix that is symmetric and not negative but for round-off."""
    w, Q = np.linalg.eigh(gram)
    return np.asarray(np.sqrt(np.maximum(w, 0.0))[:, None] * Q.T)
