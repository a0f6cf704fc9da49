"""Sparse Cholesky and LU factors by the installed libraries, with their back-substitution.

- SuperLU comes with scipy: LU in symmetric mode, with twice the entries and a tenth of the speed of
  the other two.
- CHOLMOD comes with cvxopt, whose wheels contain SuiteSparse and a BLAS (Chen, Davis, Hager and
  Rajamanickam, ACM TOMS 35, 2008). scikit-sparse has no wheels and is built with the installed
  BLAS.
- Pardiso comes with MKL and pypardiso, on x86-64. It is used in its symmetric positive definite
  mode, on the upper triangle. A loaded MKL changes the last bits of results of other libraries, and
  one in twenty runs of a wound at finite strain (92,000 unknowns, MKL 2026.2) ended with a
  segmentation fault inside MKL. It is therefore loaded only on request.
"""

import os
import sys
import weakref
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, triu
from scipy.sparse.linalg import SuperLU, splu

from tissue.arrays import Array, Indices
from tissue.errors import FactorError
from tissue.solvers.ordering import dissected

BackSubstitution = Callable[[Array], Array]

LIBRARIES = {"cholmod": "cvxopt", "pardiso": "pypardiso", "superlu": "scipy"}  # the fastest first
BYTES = {"cholmod": 10.0, "pardiso": 8.0, "superlu": 24.0}  # of memory per entry of the Cholesky factor, measured
DISSECT_BEYOND = 100_000  # with more unknowns CHOLMOD is faster with dissection than with minimum degree
COLUMNS = 12  # given to CHOLMOD together: its sparse solve takes four at a time, cvxopt's dense solve only one
SMALL_PIVOT = 0.1  # of the largest entry of its column: the usual threshold of symmetric indefinite LU
PARDISO_SPD = 2  # matrix type: real, symmetric, positive definite
METIS = 2
ANALYSE_AND_FACTORISE, FACTORISE, SOLVE = 12, 22, 33  # phases of Pardiso
NOT_DEFINITE = -4  # Pardiso's error: a zero or negative pivot


def is_installed(method: str) -> bool:
    """Return whether the library of a method is installed.

    The library is loaded, so that a later limit on BLAS threads also limits the threads of the
    library.
    """
    try:
        import_module(LIBRARIES[method])
    except (ImportError, OSError):  # not installed, or a library that it needs is missing
        return False
    return True


@dataclass(eq=False)
class Pattern:
    """A cache of parts of the symbolic factorisation.

    For each part only the last pattern is cached.
    """

    _found: dict[str, tuple[list[Any], Any]] = field(default_factory=dict, repr=False)

    def once(self, what: str, A: csr_matrix, find: Callable[[], Any]) -> Any:
        """Return the result of `find`, cached for matrices with the pattern of A."""
        rows = [A.indptr, A.indices]
        if what not in self._found or not all(map(np.array_equal, self._found[what][0], rows)):
            self._found[what] = rows, find()
        return self._found[what][1]


def superlu(A: csr_matrix, places: Array | None, pattern: Pattern) -> BackSubstitution:
    """Factorise by SuperLU in symmetric mode, with pivots only on the diagonal.

    Raises `FactorError`.
    """
    return _symmetric_lu(A, places, pattern, exchange=0.0)


def indefinite(A: csr_matrix, places: Array | None, pattern: Pattern) -> BackSubstitution:
    """Factorise an indefinite matrix by SuperLU, with an exchange of rows if a pivot on the
    diagonal is small.

    Raises `FactorError` if the matrix is singular.
    """
    return _symmetric_lu(A, places, pattern, exchange=SMALL_PIVOT)


def _symmetric_lu(A: csr_matrix, places: Array | None, pattern: Pattern, exchange: float) -> BackSubstitution:
    """Factorise by SuperLU in symmetric mode.

    The unknowns are ordered by their `places`, once per pattern. None means that SuperLU orders
    them. A pivot on the diagonal is kept if it is larger than the part `exchange` of the largest
    entry in its column. If this part is 0, the matrix must be positive definite. Raises
    `FactorError`.
    """
    order = np.arange(A.shape[0]) if places is None else pattern.once("by places", A, lambda: ordering(A, places))
    spec: Literal["MMD_AT_PLUS_A", "NATURAL"] = "MMD_AT_PLUS_A" if places is None else "NATURAL"
    ordered, mode = csc_matrix(A[order][:, order]), {"SymmetricMode": True}
    try:
        lu = splu(ordered, permc_spec=spec, diag_pivot_thresh=exchange, options=mode)
    except RuntimeError as error:
        raise FactorError(f"the matrix is singular ({error}); hold the body or give it inertia") from error
    if not exchange and not np.array_equal(lu.perm_r, lu.perm_c):
        raise FactorError("the matrix is not positive definite: a pivot had to be taken off the diagonal")

    def back_substitute(b: Array) -> Array:
        x = np.empty_like(b, dtype=float)
        x[order] = lu.solve(b[order])
        return x

    return back_substitute


def ordering(A: csr_matrix, places: Array) -> Indices:
    """Return the better of nested dissection and minimum degree, tried on the graph of the nodes.

    Unknowns at the same place are one node. With three unknowns per node, a trial costs 1/27 of the
    factorisation.
    """
    plan, node = dissected(A, places)
    by_degree, order = _trial(plan.graph, "MMD_AT_PLUS_A"), plan.order
    by_places = _trial(csr_matrix(plan.graph[order][:, order]), "NATURAL")
    return _spread(order if by_places.nnz <= by_degree.nnz else np.argsort(by_degree.perm_c), node)


def dissect(A: csr_matrix, places: Array) -> Indices:
    """Return the order of the unknowns by nested dissection of their places."""
    plan, node = dissected(A, places)
    return _spread(plan.order, node)


def _spread(order: Indices, node: Indices) -> Indices:
    """Return the order of the unknowns that follows from an order of their nodes."""
    rank = np.empty(order.size, np.intp)
    rank[order] = np.arange(order.size)
    return np.argsort(rank[node], kind="stable")


def _trial(graph: csr_matrix, spec: Literal["MMD_AT_PLUS_A", "NATURAL"]) -> SuperLU:
    """Factorise a positive definite matrix with the pattern of `graph`."""
    laplacian = csc_matrix((-np.ones(graph.nnz), graph.indices, graph.indptr), shape=graph.shape)
    laplacian.setdiag(np.diff(graph.indptr) + 1.0)
    return splu(laplacian, permc_spec=spec, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def cholmod(A: csr_matrix, places: Array | None, pattern: Pattern) -> BackSubstitution:
    """Factorise by CHOLMOD's supernodal Cholesky.

    The ordering is approximate minimum degree, or dissection for a large matrix.

    `places` None means minimum degree. Raises `FactorError`.
    """
    from cvxopt import cholmod as library
    from cvxopt import matrix, spmatrix

    columns = triu(A, format="csr")  # the rows of the upper triangle are the columns of the lower one
    columns.sort_indices()

    def pack() -> tuple[Any, list[Any]]:
        entries = columns.tocoo()
        return spmatrix(entries.data, entries.col.astype(np.int64), entries.row.astype(np.int64), A.shape), []

    packed, unused = pattern.once("packed", columns, pack)  # packing takes longer than factorising
    packed.V = matrix(columns.data)
    if unused:  # a factor in its memory saves the symbolic part, and the system's time for new memory
        factor = unused.pop()
    elif places is None or A.shape[0] < DISSECT_BEYOND:
        factor = library.symbolic(packed)
    else:
        order = pattern.once("order", columns, lambda: matrix(dissect(A, places).tolist(), tc="i"))
        factor = library.symbolic(packed, order)
    try:
        library.numeric(packed, factor)
    except ArithmeticError as error:
        unused.append(factor)
        raise FactorError(f"the matrix is not positive definite or singular: pivot {error} is not positive") from error

    def back_substitute(b: Array) -> Array:
        if b.ndim > 1 and b.any():
            blocks = [csr_matrix(b[:, k : k + COLUMNS].T) for k in range(0, b.shape[1], COLUMNS)]
            return np.hstack([np.array(matrix(library.spsolve(factor, _columns(block)))) for block in blocks])
        x = matrix(np.asarray(b, dtype=float))
        library.solve(factor, x)
        return np.array(x).reshape(b.shape)

    weakref.finalize(back_substitute, unused.append, factor).atexit = False
    return back_substitute


def _columns(rows: csr_matrix) -> Any:
    """Return rows `(k, n)` as a matrix `(n, k)` of cvxopt.

    cvxopt packs long columns slowly but transposes a matrix fast.
    """
    from cvxopt import spmatrix

    entries = rows.tocoo()
    return spmatrix(entries.data, entries.row.astype(np.int64), entries.col.astype(np.int64), rows.shape).T


def pardiso(A: csr_matrix, places: Array | None, pattern: Pattern) -> BackSubstitution:
    """Factorise by the Cholesky of MKL's Pardiso, ordered by METIS. Raises `FactorError`."""
    from pypardiso.pardiso_wrapper import PyPardisoError

    upper = triu(A, format="csr")
    upper.sort_indices()
    idle = pattern.once("analysed", upper, Idle)
    library, phase = (idle.pop(), FACTORISE) if idle else (_pardiso(), ANALYSE_AND_FACTORISE)
    library.set_phase(phase)
    # Pardiso's public calls store a copy of the matrix, and compare it at every solve.
    try:
        library._call_pardiso(upper, np.zeros((A.shape[0], 1)))
    except PyPardisoError as error:
        library.free_memory(everything=True)
        if error.value == NOT_DEFINITE:
            raise FactorError("the matrix is not positive definite or singular: a pivot is not positive") from error
        raise FactorError(f"Pardiso failed: {error}") from error
    library.set_phase(SOLVE)

    def back_substitute(b: Array) -> Array:
        return np.asarray(library._call_pardiso(upper, np.asfortranarray(b, dtype=float)))

    weakref.finalize(back_substitute, idle.append, library)
    return back_substitute


def _pardiso() -> Any:
    """Return a new solver of Pardiso, without an analysed matrix."""
    from pypardiso import PyPardisoSolver, ps

    # Without this path, every solver searches all folders of the environment for the library.
    os.environ.setdefault("PYPARDISO_MKL_RT", ps.libmkl._name)
    library = PyPardisoSolver(mtype=PARDISO_SPD)
    library.set_iparm(1, 1)  # no defaults: the default of two refinement steps costs a second solve
    library.set_iparm(2, METIS)
    return library


class Idle(list[Any]):
    """Solvers of Pardiso whose factor is no longer used; their analysis serves the next one."""

    def __del__(self) -> None:
        if sys.is_finalizing():  # the system takes the memory back, and the library is partly gone
            return
        for library in self:
            library.free_memory(everything=True)
