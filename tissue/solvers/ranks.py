"""Columns solved by several processes that make the same calls, each its share of them, as MPI starts them.

Every process has the matrix and its levels or factor; it is the columns alone that are spread. A communicator of mpi4py
has the members of `Ranks`, and nothing here needs it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.sparse import csr_matrix

from tissue.arrays import Array
from tissue.solvers.choice import Solver


class Ranks(Protocol):
    """Processes that make the same calls, with the used members of `mpi4py.MPI.Comm`."""

    def Get_rank(self) -> int:
        """Return the number of this process, from zero."""

    def Get_size(self) -> int:
        """Return how many processes there are."""

    def allgather(self, sendobj: Array) -> list[Array]:
        """Return the data of every process, in their order, once all of them have called."""


@dataclass(frozen=True)
class SharedColumns:
    """A solver whose columns are shared out among `ranks`: all of them call it at once with the same numbers."""

    own: Solver
    ranks: Ranks

    @property
    def A(self) -> csr_matrix:
        """The matrix, shape `(n, n)`."""
        return self.own.A

    def solve(self, b: Array, guess: Callable[[], Array] | None = None, rough: bool = False) -> Array:
        """Return A⁻¹ b for b of shape `(n, k)`, the same in every process; one of shape `(n,)` is solved by each."""
        if b.ndim == 1:
            return self.own.solve(b, guess, rough)
        share = np.array_split(np.arange(b.shape[1]), self.ranks.Get_size())[self.ranks.Get_rank()]
        return np.hstack(self.ranks.allgather(self.own.solve(b[:, share], rough=rough)))
