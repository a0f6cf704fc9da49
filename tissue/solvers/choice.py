"""The choice of an organ's solver: by name, or by the organ's size and the memory of the machine.

    superlu     of scipy, always available
    cholmod     with cvxopt: factorises about ten times as fast in half the memory
    pardiso     with pypardiso, on x86-64: the least fill on large meshes
    multigrid   conjugate gradients with PyAMG: memory and time are proportional to the size of the mesh

A step of an organ with inertia is a back-substitution. Its matrix is therefore factorised if the
factor fits into memory. An organ without inertia is solved only once for the columns of its sites.
Its matrix is not factorised if the factorisation takes longer than solving these columns by
multigrid.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Protocol

from scipy.sparse import csr_matrix

from tissue.arrays import Array
from tissue.errors import TissueError
from tissue.solvers.direct import BYTES, LIBRARIES, Pattern, is_installed
from tissue.solvers.factor import factorize
from tissue.solvers.iterative import conjugate_gradients
from tissue.solvers.memory import free_memory
from tissue.solvers.multigrid import is_by_nodes
from tissue.solvers.ordering import dissected

log = logging.getLogger(__name__)

MULTIGRID = "multigrid"
PYAMG = "pip install 'suturefem[large]'"
SOLVERS = ("auto", *LIBRARIES, MULTIGRID)
FACTOR_ONCE = {
    "cholmod": 250_000,
    "pardiso": 250_000,
    "superlu": 60_000,
}  # unknowns; with more unknowns multigrid solves 20 columns faster
SMALL = 50_000  # unknowns; a smaller organ's factor takes less than half a gigabyte and needs no estimate
SHARE = 0.8  # of the free memory that a factor can use
BYTES_OF_LEVELS = 45.0  # bytes of the levels of multigrid per entry of the matrix, as measured
MANY = 1000  # factors: in practice no limit
GIGA = 1e9


@dataclass(frozen=True)
class SolverChoice:
    """A solver's name, and the number of its factors (or sets of levels) that fit into memory, at
    least one.
    """

    name: str
    room: int


class Solver(Protocol):
    """A matrix A and a solver for it whose residual is within its bound."""

    @property
    def A(self) -> csr_matrix:
        """The matrix, symmetric and positive definite, shape `(n, n)`."""

    def solve(self, b: Array, guess: Callable[[], Array] | None = None, rough: bool = False) -> Array:
        """Return A⁻¹ b for b of shape `(n,)` or `(n, k)`.

        An iterative solver starts from `guess()`, or from zero if `guess` is None. It can stop
        early if `rough` is True.
        """


def solver(
    A: csr_matrix, places: Array, name: str, one_of_many: bool = False, pattern: Pattern | None = None
) -> Solver:
    """Return a solver for a stiffness matrix over unknowns at `places` `(n, 3)`.

    `name` is a name that `choose_solver` returned. `one_of_many` and `pattern` are as in
    `tissue.solvers.factor.factorize`.
    """
    log.info("factoring the organ: %d unknowns of its mesh, by %s", A.shape[0], name)
    return named(A, places, name, one_of_many, pattern)


def named(A: csr_matrix, places: Array, name: str, one_of_many: bool = False, pattern: Pattern | None = None) -> Solver:
    """Return the same solver as `solver`, without a log entry."""
    return conjugate_gradients(A, places) if name == MULTIGRID else factorize(A, places, name, one_of_many, pattern)


def solver_of_columns(A: csr_matrix, places: Array) -> Solver:
    """Return a solver for the columns of all holes of a mesh that is fine only at the holes.

    The factor of such a matrix is small for its size. A direct solver is the fastest if the factor
    fits into memory.
    """
    return named(A, places, choose_solver("auto", A, places, once=False).name, one_of_many=True)


def mass_solver(M: csr_matrix, places: Array, name: str) -> Solver:
    """Return a solver for a mass matrix.

    Conjugate gradients use only its diagonal as preconditioner.
    """
    return conjugate_gradients(M) if name == MULTIGRID else factorize(M, places, name)


def choose_solver(name: str, A: csr_matrix, places: Array, once: bool) -> SolverChoice:
    """Return the choice of a solver for a matrix with the pattern of A.

    `once` is True if the solver is used only for the columns of the sites.

    Multigrid needs three unknowns per node, and therefore an organ without rollers. Raises
    `TissueError` if the named solver is unknown, is not installed, cannot solve this matrix or
    needs more memory than is free.
    """
    if name not in SOLVERS:
        raise TissueError(f"solver = {name!r}: allowed are {', '.join(map(repr, SOLVERS))}; take 'auto'")
    if name in LIBRARIES and not is_installed(name):
        raise TissueError(f"solver = {name!r} needs {LIBRARIES[name]}; pip install it, or take 'auto'")
    if name == MULTIGRID and not has_pyamg():
        raise TissueError(f"solver = {name!r} needs pyamg; {PYAMG}, or take 'auto'")
    direct = next(method for method in LIBRARIES if is_installed(method)) if name == "auto" else name
    room = SHARE * free_memory()
    levels = SolverChoice(MULTIGRID, _times(room, BYTES_OF_LEVELS * A.nnz))
    by_nodes = is_by_nodes(places)
    has_levels = by_nodes and has_pyamg()
    if direct == MULTIGRID and not by_nodes:
        raise TissueError(
            f"solver = {name!r} needs three unknowns per node, and a roller fixes one of them; take 'auto' or a clamp"
        )
    if direct == MULTIGRID or (name == "auto" and has_levels and once and A.shape[0] > FACTOR_ONCE[direct]):
        return levels
    need = factor_bytes(A, places, direct)
    if need <= room:
        return SolverChoice(direct, _times(room, need))
    if name == "auto" and has_levels:
        return levels
    remedy = f"'multigrid' ({PYAMG}) or a coarser mesh" if by_nodes else "a coarser mesh"
    raise TissueError(
        f"solver = {name!r}: the factor of {A.shape[0]} unknowns takes about {need / GIGA:.2g} GB and "
        f"{room / GIGA:.2g} GB are available; take {remedy}"
    )


def has_pyamg() -> bool:
    """Return whether the library that aggregates the levels of multigrid is installed."""
    return find_spec("pyamg") is not None


def _times(room: float, need: float) -> int:
    """Return how many times a `need` of memory fits into the `room`, at least once."""
    return int(max(1.0, min(room / max(need, 1.0), MANY)))


def factor_bytes(A: csr_matrix, places: Array, method: str) -> float:
    """Return an estimate of the memory of a factor [byte], by nested dissection of the nodes.

    The estimate is zero for a small organ.
    """
    if A.shape[0] <= SMALL:
        return 0.0
    plan, _ = dissected(A, places)
    return float(BYTES[method] * (A.shape[0] / plan.order.size) ** 2 * plan.entries)
