"""Columns solved by several processes, each of which solves its share.

The processes make the same calls, as processes started by MPI do.

Every process has the matrix and its levels or factor; only the columns are distributed. A
communicator of mpi4py has the members of `Ranks`, but this module does not need mpi4py.
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
        """Return the number of processes."""

    def allgather(self, sendobj: Array) -> list[Array]:
        """Return the data of every process, in order, after all processes have made this call."""


@dataclass(frozen=True)
class SharedColumns:
    """A solver whose columns are distributed among `ranks`.

    All processes call it together with the same numbers.
    """

    own: Solver
    ranks: Ranks

    @property
    def A(self) -> csr_matrix:
        """The matrix, shape `(n, n)`."""
        return self.own.A

    def solve(self, b: Array, guess: Callable[[], Array] | None = None, rough: bool = False) -> Array:
        """Return A⁻¹ b for b of shape `(n, k)` or `(n,)`, the same in every process.

        Only the columns of `(n, k)` are distributed; every process solves a b of shape `(n,)`
        itself.
        """
        if b.ndim == 1:
            return self.own.solve(b, guess, rough)
        share = np.array_split(np.arange(b.shape[1]), self.ranks.Get_size())[self.ranks.Get_rank()]
        return np.hstack(self.ranks.allgather(self.own.solve(b[:, share], rough=rough)))
