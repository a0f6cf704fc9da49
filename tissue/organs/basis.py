"""The Krylov space for the motion of an organ under forces at its sites and under its loads.

    V = [K⁻¹F,  (K⁻¹M) K⁻¹F,  …,  (K⁻¹M)ᵏ K⁻¹F],   F = [Yᵀ, weight, loads]

The first block holds the static answers to all forces, so that slow motion is exact. Then follow k
blocks of a Krylov space. Each of them matches two more moments of the transfer function from forces
to sites (Su & Craig, AIAA J. 29, 1991). Rayleigh damping is a function of M and K, so that the
space with damping is the same. V is orthonormal in K.

The residual of U = V η in the equation of motion, r = F f − M V (η̈ + α η̇) − K V (η + β η̇), is
orthogonal to V. F and K V lie in the space of K V, and M V does except for its last block. Hence

    K⁻¹ r = −(I − V VᵀK) K⁻¹M V (η̈ + α η̇),   ‖r‖ in K⁻¹ = ‖R (η̈ + α η̇)‖

with one small matrix R: the dual norm of the residual needs no solve. K⁻¹ r lies in the next block
alone, so that R is the part of the mass that couples the two.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from tissue.arrays import Array
from tissue.errors import TissueError
from tissue.organs.dynamic import DynamicOrgan
from tissue.organs.meshed import OrganState, TimeScheme
from tissue.organs.modal import Modes

DEPENDENT = 1e-8  # of a vector's length in K: a smaller new direction is round-off
MASSLESS = 1e-14  # of the largest 1/ω² of a basis: a smaller value is round-off, and the mode has no mass


@dataclass(frozen=True, eq=False)
class Level:
    """The organ in a number of `blocks` of its Krylov space.

    `modes` are its modes. `turn` (n, n) is the matrix from the modes to the vectors of the space.
    `missed` (m, n) is R of the module.
    """

    blocks: int
    modes: Modes
    turn: Array
    missed: Array

    def left(self, state: OrganState) -> float:
        """Return the norm in K⁻¹ of the residual of the equations of motion for all unknowns [√J]."""
        return float(np.linalg.norm(self.missed @ self.modes.rates(state)))

    def forces(self, state: OrganState) -> float:
        """Return the norm of the forces of inertia, stiffness and damping in a state [√J]."""
        inertia = self.modes.mu * self.modes.rates(state)
        return float(np.linalg.norm(inertia) + np.linalg.norm(state.U + self.modes.rayleigh[1] * state.V))

    def shortfall(self, scheme: TimeScheme) -> float:
        """Return the largest relative deficit of a site's compliance in a step [-].

        As in every Galerkin solution, it is the square of the residual of the response to a unit
        force.
        """
        operator = self.modes.operator(scheme.a, scheme.d)
        left = (scheme.a + self.modes.rayleigh[0] * scheme.d) * (self.missed @ operator.W)
        own = operator.C.diagonal()
        return float(((left**2).sum(axis=0)[own > 0.0] / own[own > 0.0]).max(initial=0.0))


class Space:
    """The Krylov space of an organ; each block is computed when it is first needed.

    The first block has the static answers to all forces. Memory is allocated for a number of
    further `blocks`; more is allocated when needed.
    """

    def __init__(self, organ: DynamicOrgan, blocks: int) -> None:
        self._organ, self._factor = organ, organ.solver_of(organ.K)
        forces = np.column_stack([organ.Y.T.toarray(), organ.load, organ.surface_load])
        forces = forces[:, forces.any(axis=0)]
        self._basis = Orthonormal(organ.K, forces.shape[1] * (blocks + 2))
        self._ends, self._M = list[int](), np.zeros((0, 0))
        self._levels: dict[int, Level] = {}
        self._next = forces

    @property
    def vectors(self) -> Array:
        """The vectors of the basis so far, shape `(N, r)`."""
        return self._basis.V

    def level(self, blocks: int) -> Level:
        """Return the organ in the space of the static answers and `blocks` further blocks."""
        if blocks not in self._levels:
            while len(self._ends) < blocks + 2:  # the next block gives their residual
                self._extend()
            self._levels[blocks] = self._make(blocks)
        return self._levels[blocks]

    def level_of(self, vectors: int, most: int) -> Level:
        """Return the organ in the space of the first `vectors` vectors.

        Raises `TissueError` if no number of blocks up to `most` has this number of vectors.
        """
        while vectors not in self._ends and len(self._ends) <= most:
            self._extend()
        if vectors not in self._ends:
            raise TissueError(
                f"no number of blocks of the organ's Krylov space has {vectors} vectors; start the run again"
            )
        return self.level(self._ends.index(vectors))

    def _extend(self) -> None:
        """Add a block."""
        self._next = np.asarray(self._organ.M @ self._basis.extend(self._factor.solve(self._next)))
        before, mixed = self._M.shape[0], self.vectors.T @ self._next
        corner = 0.5 * (mixed[before:] + mixed[before:].T)
        self._M = np.block([[self._M, mixed[:before]], [mixed[:before].T, corner]])
        self._ends.append(self.vectors.shape[1])

    def _make(self, blocks: int) -> Level:
        organ, r, behind = self._organ, self._ends[blocks], self._ends[blocks + 1]
        mu, turn = np.linalg.eigh(self._M[:r, :r])
        mu, V = np.where(mu > MASSLESS * mu[-1], mu, 0.0), self._basis.V[:, :r]
        Y, load, surface_load = (np.asarray(F) @ turn for F in (organ.Y @ V, organ.load @ V, organ.surface_load.T @ V))
        modes = Modes(mu, Y, load, surface_load.T, organ.rayleigh)
        return Level(blocks, modes, turn, self._M[r:behind, :r] @ turn)


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
