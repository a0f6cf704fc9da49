"""Smoothed-aggregation multigrid (Vaněk, Mandel and Brezina, Computing 56, 1996) as a preconditioner.

PyAMG aggregates; the coarse spaces hold the six rigid motions, so that the work per unknown does not grow with the
mesh. The V-cycle here acts on several columns at once, in single precision: it only has to point the right way, and a
cycle is as long as the memory it reads. So all matrices but that of the mesh, two fifths of which are zeros, are kept
and multiplied in blocks of 3 × 3, which read a row of a field once for nine numbers.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix

from tissue.arrays import Array, Single
from tissue.errors import FactorError

COARSEST = 100  # nodes with six unknowns each: a dense inverse of so many is as cheap as smoothing on the finest level
STRENGTH = 0.04  # of ‖A_ij‖ to √(‖A_ii‖‖A_jj‖) below which two nodes are not aggregated
DEGREE = 2  # of the Chebyshev smoother
SMOOTHED_RANGE = 12.0  # ratio of the highest to the lowest eigenvalue that the smoother damps
LANCZOS = 12  # steps: the highest eigenvalue to a few per cent
MARGIN = 1.1
RANK_TOLERANCE = 1e-10  # of the highest eigenvalue of the coarsest matrix
BLOCK = (3, 3)


@dataclass(frozen=True)
class Blocks:
    """A matrix `(m, n)` in blocks of 3 × 3 as one factor of products with several columns."""

    matrix: bsr_matrix

    def __matmul__(self, x: Single) -> Single:
        """Return the product with columns `(n, k)`."""
        from tissue.solvers.passes import product, product_of_one

        out = np.empty((self.matrix.shape[0], x.shape[1]), dtype=np.float32)
        multiply = product_of_one if x.shape[1] == 1 else product
        multiply(self.matrix.indptr, self.matrix.indices, self.matrix.data, x, out)
        return out


@dataclass(frozen=True)
class Level:
    """A matrix, the inverse of its diagonal `(n,)`, its highest eigenvalue scaled by that, and the way up and down."""

    A: csr_matrix | Blocks
    scaling: Single
    highest: float
    P: Blocks
    R: Blocks

    @property
    def bytes(self) -> int:
        """Memory of the matrices."""
        parts = (part.matrix if isinstance(part, Blocks) else part for part in (self.A, self.P, self.R))
        return sum(part.data.nbytes + part.indices.nbytes for part in parts)


@dataclass(frozen=True)
class Multigrid:
    """One symmetric V-cycle, B ≈ A⁻¹. Made by `multigrid`."""

    levels: tuple[Level, ...]
    coarsest: Single

    def __call__(self, residual: Array) -> Single:
        """Return B r for r of shape `(n,)` or `(n, k)`."""
        columns = residual.reshape(len(residual), -1).astype(np.float32)
        return self._cycle(0, columns).reshape(residual.shape)

    @property
    def bytes(self) -> int:
        """Memory of the levels."""
        return sum(level.bytes for level in self.levels)

    def _cycle(self, depth: int, b: Single) -> Single:
        if depth == len(self.levels):
            return np.asarray(self.coarsest @ b)
        level = self.levels[depth]
        x = _smoothed(level, b, None)
        left = level.A @ x
        np.subtract(b, left, out=left)
        x += level.P @ self._cycle(depth + 1, level.R @ left)
        return _smoothed(level, b, x)


def is_by_nodes(places: Array) -> bool:
    """Return whether unknowns at `places` `(n, 3)` are three a node, one after the other; not so on rollers."""
    return len(places) % 3 == 0 and all(np.array_equal(places[::3], places[i::3]) for i in (1, 2))


def rigid_motions(places: Array) -> Array:
    """Return three translations and three rotations of nodes with three unknowns each, shape `(n, 6)`, of size one.

    Raises `FactorError` for unknowns that are not three a node.
    """
    nodes = places[::3]
    if not is_by_nodes(places):
        raise FactorError("multigrid needs three unknowns a node, one after the other; take another solver")
    x = nodes - nodes.mean(axis=0)
    x /= np.abs(x).max()
    motions = np.zeros((len(nodes), 3, 6))
    motions[:, range(3), range(3)] = 1.0
    for k, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        motions[:, i, 3 + k], motions[:, j, 3 + k] = -x[:, j], x[:, i]
    return motions.reshape(-1, 6)


def multigrid(A: csr_matrix, places: Array) -> Multigrid:
    """Return the V-cycle for a stiffness matrix over nodes at `places` `(n, 3)` of its unknowns."""
    from pyamg import smoothed_aggregation_solver

    with _same_numbers():
        hierarchy = smoothed_aggregation_solver(
            A.tobsr((3, 3)),
            B=rigid_motions(places),
            strength=("symmetric", {"theta": STRENGTH}),
            smooth=("jacobi", {"weighting": "block"}),
            improve_candidates=None,
            presmoother=None,
            postsmoother=None,
            max_coarse=COARSEST,
            coarse_solver=None,
            keep=False,
        )
    levels: list[Level] = []
    for level in hierarchy.levels[:-1]:
        levels.append(_level(level.A.astype(np.float32), level.P.astype(np.float32), finest=not levels))
        level.A = level.P = level.R = None
    # A group of one or two nodes has fewer than six motions: some coarse unknowns are nothing.
    inverse = np.linalg.pinv(hierarchy.levels[-1].A.toarray(), rcond=RANK_TOLERANCE, hermitian=True).astype(np.float32)
    return Multigrid(tuple(levels), inverse)


@contextmanager
def _same_numbers() -> Iterator[None]:
    """Seed numpy's global random numbers and restore them afterwards.

    PyAMG estimates eigenvalues from them: so the estimates are the same each time, and nobody else's numbers
    change.
    """
    before = np.random.get_state()
    np.random.seed(0)
    try:
        yield
    finally:
        np.random.set_state(before)


def _level(A: bsr_matrix, P: bsr_matrix, finest: bool) -> Level:
    """Return a level of matrices that are its own; on the finest the zeros in the blocks, two fifths of K, are left
    out."""
    own = csr_matrix(A) if finest else bsr_matrix(A, blocksize=BLOCK)
    if isinstance(own, csr_matrix):
        own.eliminate_zeros()
    diagonal, up = own.diagonal(), bsr_matrix(P, blocksize=BLOCK)
    scaling = np.divide(1.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0)
    down = Blocks(bsr_matrix(up.T, blocksize=BLOCK))
    kept = own if isinstance(own, csr_matrix) else Blocks(own)
    return Level(kept, scaling, MARGIN * _highest(own, scaling), Blocks(up), down)


def _highest(A: csr_matrix | bsr_matrix, scaling: Single) -> float:
    """Return the highest eigenvalue of D⁻¹A by Lanczos' method from a fixed start."""
    half = np.sqrt(scaling.astype(float))
    v = np.random.default_rng(0).standard_normal(A.shape[0])
    v /= np.linalg.norm(v)
    before, beta = np.zeros_like(v), 0.0
    diagonal, off = [], []
    for _ in range(LANCZOS):
        w = half * (A @ (half * v)) - beta * before
        diagonal.append(v @ w)
        w -= diagonal[-1] * v
        beta = float(np.linalg.norm(w))
        off.append(beta)
        before, v = v, w / beta
    T = np.diag(diagonal) + np.diag(off[:-1], 1) + np.diag(off[:-1], -1)
    return float(np.linalg.eigvalsh(T)[-1])


def _smoothed(level: Level, b: Single, x: Single | None) -> Single:
    """Return x after Chebyshev iteration on the upper part of the spectrum of D⁻¹A (Saad, Iterative Methods,
    alg. 12.1), None: from zero.
    """
    from tissue.solvers.passes import relax

    theta = np.float32(0.5 * level.highest * (1.0 + 1.0 / SMOOTHED_RANGE))
    delta = np.float32(0.5 * level.highest * (1.0 - 1.0 / SMOOTHED_RANGE))
    sigma = theta / delta
    rho = np.float32(1.0 / sigma)
    d, out = np.zeros_like(b), np.zeros_like(b) if x is None else x.copy()
    relax(np.float32(0.0), np.float32(1.0 / theta), level.scaling, b, out if x is None else level.A @ out, d, out)
    for _ in range(DEGREE - 1):
        after = np.float32(1.0 / (2.0 * sigma - rho))
        relax(np.float32(after * rho), np.float32(2.0 * after / delta), level.scaling, b, level.A @ out, d, out)
        rho = after
    return out
