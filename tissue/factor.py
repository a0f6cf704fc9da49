"""Factorisation of symmetric positive definite matrices, and its residual contract.

The default is SuperLU in symmetric mode (no pivoting off the diagonal). Given the places of the unknowns it is
ordered by nested dissection (George, SIAM J. Numer. Anal. 10, 1973), which leaves fewer entries on a block, or by
minimum degree, which leaves fewer on a strongly graded mesh: whichever does.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.linalg import SuperLU, splu

from tissue.errors import FactorError

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

METHODS = ("superlu", "cholmod")
RESIDUAL = 1e-10  # ‖Ax − b‖ / (‖A‖‖x‖ + ‖b‖): the bound on every solver here
SINGULAR = 1e13  # ‖A‖‖A⁻¹‖ beyond which no digit of a solution to RESIDUAL is left
LEAF = 20  # nodes below which dissection stops: smaller leaves measured the same


@dataclass(frozen=True)
class Factor:
    """A factorised symmetric positive definite matrix `A`, shape `(n, n)`. Made by `factorize`."""

    A: csr_matrix
    norm: float
    entries: int
    back_substitute: Callable[[Array], Array]

    def solve(self, b: Array) -> Array:
        """A⁻¹ b for b of shape `(n,)` or `(n, k)`; `FactorError` when the residual exceeds its bound."""
        x = self.back_substitute(b)
        residual = np.linalg.norm(self.A @ x - b, axis=0)
        scale = self.norm * np.linalg.norm(x, axis=0) + np.linalg.norm(b, axis=0)
        if not np.all(residual <= RESIDUAL * scale):  # also catches what is not a number
            worst = float(np.max(residual / np.maximum(scale, np.finfo(float).tiny)))
            raise FactorError(f"‖Ax − b‖ = {worst:.1e} (‖A‖‖x‖ + ‖b‖), allowed is {RESIDUAL:g}")
        return x


def factorize(A: csr_matrix, places: Array | None = None, method: str = "superlu") -> Factor:
    """Factorise `A`; `places` `(n, 3)` of its unknowns allow a better ordering.

    `method` "cholmod" needs scikit-sparse. Raises `FactorError` when A is not symmetric, singular or not
    definite.
    """
    if method not in METHODS:
        raise FactorError(f"method = {method!r}: allowed are 'superlu' and 'cholmod'")
    A = csr_matrix(A)
    if A.shape[0] != A.shape[1]:
        raise FactorError(f"the matrix has shape {A.shape}; only a square one can be factorised")
    norm = float(np.max(abs(A) @ np.ones(A.shape[0]), initial=0.0))
    _check_symmetric(A, norm)
    back_substitute, entries = (_superlu if method == "superlu" else _cholmod)(A, places)
    factor = Factor(A, norm, entries, back_substitute)
    if A.shape[0]:
        _check_definite(factor)
    return factor


def ordering(A: csr_matrix, places: Array) -> Indices:
    """The better of nested dissection and minimum degree, tried on the graph of the nodes.

    Unknowns at the same place are one node. With three unknowns a node, a trial costs 1/27 of the factorisation.
    """
    _, first, node = np.unique(places, axis=0, return_index=True, return_inverse=True)
    node, count = node.ravel(), first.size
    lump = csr_matrix((np.ones(node.size), (np.arange(node.size), node)), shape=(node.size, count))
    graph = csr_matrix(lump.T @ (abs(A) @ lump))
    dissected, entries = dissection(graph, places[first]), []
    by_degree = np.argsort(_trial(graph, "MMD_AT_PLUS_A").perm_c)
    for order in (dissected, by_degree):
        entries.append(_trial(csr_matrix(graph[order][:, order]), "NATURAL").nnz)
    order = dissected if entries[0] <= entries[1] else by_degree
    rank = np.empty(count, np.intp)
    rank[order] = np.arange(count)
    return np.argsort(rank[node], kind="stable")


def _trial(graph: csr_matrix, spec: Literal["MMD_AT_PLUS_A", "NATURAL"]) -> SuperLU:
    """Factor of a positive definite matrix with the pattern of `graph`."""
    laplacian = csc_matrix((-np.ones(graph.nnz), graph.indices, graph.indptr), shape=graph.shape)
    laplacian.setdiag(np.diff(graph.indptr) + 1.0)
    return splu(laplacian, permc_spec=spec, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def dissection(graph: csr_matrix, places: Array) -> Indices:
    """Nested-dissection ordering of nodes: halve the body, number the separating nodes last, and so on in each half.

    Separators are those nodes of one half that `graph` joins to the other; of the three axes the one with the
    smallest separator is taken.
    """
    return np.concatenate(_dissect(abs(graph), places, np.arange(len(places))))


def _dissect(graph: csr_matrix, places: Array, nodes: Indices) -> list[Indices]:
    if nodes.size <= LEAF:
        return [nodes]
    left, right, separator = min(_cuts(graph, places, nodes), key=lambda cut: cut[2].size)
    return [*_dissect(graph, places, left), *_dissect(graph, places, right), separator]


def _cuts(graph: csr_matrix, places: Array, nodes: Indices) -> Iterator[tuple[Indices, Indices, Indices]]:
    """The halvings along x, y and z, the separator taken from the one half or the other: (left, right,
    separator).
    """
    half = nodes.size // 2
    for axis in range(3):
        ranked = nodes[np.argsort(places[nodes, axis], kind="stable")]
        for near, far in ((ranked[:half], ranked[half:]), (ranked[half:], ranked[:half])):
            side = np.zeros(graph.shape[0])
            side[far] = 1.0
            cut = (graph[near] @ side) > 0.0
            yield near[~cut], far, near[cut]


def _superlu(A: csr_matrix, places: Array | None) -> tuple[Callable[[Array], Array], int]:
    order = np.arange(A.shape[0]) if places is None else ordering(A, places)
    spec: Literal["MMD_AT_PLUS_A", "NATURAL"] = "MMD_AT_PLUS_A" if places is None else "NATURAL"
    if not A.shape[0]:
        return np.copy, 0
    try:
        lu = splu(
            csc_matrix(A[order][:, order]),
            permc_spec=spec,
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError as error:
        raise FactorError(f"the matrix is singular ({error}); hold the body or give it inertia") from error
    if not np.array_equal(lu.perm_r, lu.perm_c):
        raise FactorError("the matrix is not positive definite: a pivot had to be taken off the diagonal")

    def back_substitute(b: Array) -> Array:
        x = np.empty_like(b, dtype=float)
        x[order] = lu.solve(b[order])
        return x

    return back_substitute, int(lu.nnz) // 2


def _cholmod(A: csr_matrix, places: Array | None) -> tuple[Callable[[Array], Array], int]:
    try:
        from sksparse.cholmod import CholmodError, cholesky
    except ImportError as error:
        raise FactorError("method = 'cholmod' needs scikit-sparse; install it or take 'superlu'") from error
    try:
        factor = cholesky(csc_matrix(A))
    except CholmodError as error:
        raise FactorError(f"the matrix is not positive definite ({error})") from error
    return factor, int(factor.L().nnz)


def _check_symmetric(A: csr_matrix, norm: float) -> None:
    difference = abs(A - A.T).max() if A.nnz else 0.0
    if not difference <= 1e-12 * norm:
        raise FactorError(f"the matrix is not symmetric: |A − Aᵀ| = {difference:.1e}, |A| = {norm:.1e}")
    if A.shape[0] and not A.diagonal().min() > 0.0:
        raise FactorError(f"the matrix is not positive definite: its diagonal goes down to {A.diagonal().min():.1e}")


def _check_definite(factor: Factor) -> None:
    """Inverse iteration from three starts: the eigenvalue next to zero must be positive and not lost in
    round-off.
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
