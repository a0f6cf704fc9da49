"""Smoothed-aggregation multigrid (Vaněk, Mandel and Brezina, Computing 56, 1996) as a
preconditioner.

PyAMG aggregates the nodes. The coarse spaces contain the six rigid motions. The work per unknown
therefore does not grow with the mesh. The motions of the groups are smoothed in this module,
because PyAMG would need two more matrices of the organ's size for the smoothing.

The V-cycle acts on several columns at once, in single precision, because it need not be exact. Its
time is the time of its memory access. Matrices are therefore stored and multiplied in blocks: a row
of a field is read once for nine numbers. On the mesh, two fifths of these numbers are zero. Fields
are reused, because filling new memory from the system costs as much as a pass over it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix

from tissue.arrays import Array, Single
from tissue.errors import FactorError

COARSEST = 100  # nodes with six unknowns each: their dense inverse costs as much as smoothing on the finest level
STRENGTH = 0.04  # least ratio of ‖A_ij‖ to √(‖A_ii‖‖A_jj‖) of two aggregated nodes
DEGREE = 2  # degree of the Chebyshev smoother
SMOOTHED_RANGE = 12.0  # ratio of the highest to the lowest eigenvalue that the smoother damps
LANCZOS = 12  # steps: the highest eigenvalue to a few per cent
MARGIN = 1.1
SMOOTHING = 1.5  # step of the smoothing of motions, in 1/ρ: 26 iterations at 320 000 unknowns; 4/3 gives 28
RANK_TOLERANCE = 1e-10  # of the highest eigenvalue of the coarsest matrix
BLOCK = (3, 3)


@dataclass(frozen=True)
class Blocks:
    """A matrix `(m, n)` in blocks for products with several columns.

    A side of a block has the three or six unknowns of a node.
    """

    matrix: bsr_matrix

    def __matmul__(self, x: Single) -> Single:
        """Return the product with columns `(n, k)`."""
        out = np.empty((self.matrix.shape[0], x.shape[1]), dtype=np.float32)
        self.multiply(x, out)
        return out

    def multiply(self, x: Single, out: Single) -> None:
        """Write the product with columns `(n, k)` into `out`, `(m, k)`."""
        from tissue.solvers.passes import product, product_of_one

        multiply = product_of_one if x.shape[1] == 1 else product
        multiply(self.matrix.indptr, self.matrix.indices, self.matrix.data, x, out)


@dataclass(frozen=True)
class Level:
    """A level of multigrid: the matrix A, its scaling and highest eigenvalue, prolongation P and
    restriction R.

    `scaling` is the inverse of the diagonal, `(n,)`. `highest` is the highest eigenvalue of the
    scaled matrix.
    """

    A: Blocks
    scaling: Single
    highest: float
    P: Blocks
    R: Blocks


@dataclass(frozen=True)
class Fields:
    """Work arrays of a cycle on a level.

    These are the right-hand side `b`, the last correction `d` of the smoother, and the `product`
    with the matrix, `(n, k)` each. `coarse` `(m, k)` holds first the right-hand side of the next
    coarser level and then its solution.
    """

    b: Single
    d: Single
    product: Single
    coarse: Single

    @classmethod
    def of(cls, level: Level, columns: int) -> "Fields":
        """Return uninitialised fields of a level."""
        n, coarse = level.P.matrix.shape
        return cls(*(np.empty((size, columns), dtype=np.float32) for size in (n, n, n, coarse)))


@dataclass(frozen=True)
class Multigrid:
    """One symmetric V-cycle, B ≈ A⁻¹. Made by `multigrid`."""

    levels: tuple[Level, ...]
    coarsest: Single

    def __call__(self, residual: Array) -> Single:
        """Return B r for r of shape `(n,)` or `(n, k)`."""
        columns = residual.reshape(len(residual), -1)
        x = np.empty(columns.shape, dtype=np.float32)
        self._cycle(0, columns, x)
        return x.reshape(residual.shape)

    @cached_property
    def _used(self) -> dict[int, tuple[Fields, ...]]:
        """The cached fields of the last cycle, keyed by its number of columns."""
        return {}

    def _fields(self, columns: int) -> tuple[Fields, ...]:
        if columns not in self._used:
            self._used.clear()
            self._used[columns] = tuple(Fields.of(level, columns) for level in self.levels)
        return self._used[columns]

    def _cycle(self, depth: int, b: Array | Single, x: Single) -> None:
        """Write the result of a cycle on level `depth` and all coarser ones for the right-hand side
        `b` into `x`.
        """
        if depth == len(self.levels):
            np.matmul(self.coarsest, b, out=x)
            return
        level, own = self.levels[depth], self._fields(x.shape[1])[depth]
        own.b[...] = b
        _smooth(level, own, x, is_zero=True)
        level.A.multiply(x, own.product)
        np.subtract(own.b, own.product, out=own.product)
        level.R.multiply(own.product, own.coarse)
        self._cycle(depth + 1, own.coarse, own.coarse)
        level.P.multiply(own.coarse, own.product)
        x += own.product
        _smooth(level, own, x, is_zero=False)


def is_by_nodes(places: Array) -> bool:
    """Return whether unknowns at `places` `(n, 3)` are three per node, in sequence.

    The result is False with rollers.
    """
    return len(places) % 3 == 0 and all(np.array_equal(places[::3], places[i::3]) for i in (1, 2))


def rigid_motions(places: Array) -> Array:
    """Return three translations and three rotations of nodes with three unknowns each, scaled to
    one, shape `(n, 6)`.

    Raises `FactorError` if there are not three unknowns per node.
    """
    nodes = places[::3]
    if not is_by_nodes(places):
        raise FactorError("multigrid needs three unknowns per node, in sequence; take another solver")
    x = nodes - nodes.mean(axis=0)
    x /= np.abs(x).max()
    motions = np.zeros((len(nodes), 3, 6))
    motions[:, range(3), range(3)] = 1.0
    for k, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        motions[:, i, 3 + k], motions[:, j, 3 + k] = -x[:, j], x[:, i]
    return motions.reshape(-1, 6)


def multigrid(A: csr_matrix, places: Array) -> Multigrid:
    """Return the V-cycle for a stiffness matrix over unknowns at `places` `(n, 3)`."""
    levels: list[Level] = []
    motions = rigid_motions(places)
    coarser = A.tobsr(BLOCK)
    while coarser.shape[0] > COARSEST * coarser.blocksize[0]:
        level, P, motions = _level(coarser, motions)
        levels.append(level)
        coarser = coarser @ P  # in two steps, so that the finer matrix is freed after the first
        coarser = P.T @ coarser
    # A group of one or two nodes has fewer than six motions, so that some coarse unknowns have zero rows.
    inverse = np.linalg.pinv(coarser.toarray(), rcond=RANK_TOLERANCE, hermitian=True).astype(np.float32)
    return Multigrid(tuple(levels), inverse)


def _level(A: bsr_matrix, motions: Array) -> tuple[Level, bsr_matrix, Array]:
    """Return the level of a matrix, its P in double precision, and the motions of the next coarser
    level.

    P = (I − ω D⁻¹A / ρ) T smooths the motions T of the groups. D is the diagonal. Therefore ρ is
    the same highest eigenvalue as in the smoother, and no further matrix of the size of A is
    needed.
    """
    from pyamg.aggregation.aggregate import standard_aggregation
    from pyamg.aggregation.tentative import fit_candidates
    from pyamg.strength import symmetric_strength_of_connection

    groups, _ = standard_aggregation(symmetric_strength_of_connection(A, STRENGTH))
    T, coarse_motions = fit_candidates(groups, motions)
    own, diagonal = _single(A), A.diagonal()
    scaling = np.divide(1.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0)
    highest = _highest(own, scaling)
    change = A @ bsr_matrix(T)
    rows = np.repeat(np.arange(len(change.indptr) - 1), np.diff(change.indptr))
    change.data *= ((SMOOTHING / highest) * scaling.reshape(-1, A.blocksize[0]))[rows, :, None]
    P = bsr_matrix(T) - change
    up = _single(P)
    level = Level(own, scaling.astype(np.float32), MARGIN * highest, up, Blocks(up.matrix.T))
    return level, P, coarse_motions


def _single(matrix: bsr_matrix) -> Blocks:
    """Return a block matrix in single precision with the same, sorted, indices."""
    matrix.sort_indices()
    return Blocks(bsr_matrix((matrix.data.astype(np.float32), matrix.indices, matrix.indptr), shape=matrix.shape))


def _highest(A: Blocks, scaling: Array) -> float:
    """Return the highest eigenvalue of D⁻¹A by Lanczos' method from a fixed start."""
    half = np.sqrt(scaling)
    v = np.random.default_rng(0).standard_normal(len(half))
    v /= np.linalg.norm(v)
    before, beta = np.zeros_like(v), 0.0
    diagonal, off = [], []
    for _ in range(LANCZOS):
        w = half * (A @ (half * v).astype(np.float32)[:, None])[:, 0] - beta * before
        diagonal.append(v @ w)
        w -= diagonal[-1] * v
        beta = float(np.linalg.norm(w))
        off.append(beta)
        before, v = v, w / beta
    T = np.diag(diagonal) + np.diag(off[:-1], 1) + np.diag(off[:-1], -1)
    return float(np.linalg.eigvalsh(T)[-1])


def _smooth(level: Level, own: Fields, x: Single, is_zero: bool) -> None:
    """Write the result of a Chebyshev iteration into `x`.

    The iteration starts from `x`, or from zero if `is_zero`.

    It acts on the upper part of the spectrum of D⁻¹A (Saad, Iterative Methods, alg. 12.1).
    """
    from tissue.solvers.passes import relax, relax_zero

    theta = np.float32(0.5 * level.highest * (1.0 + 1.0 / SMOOTHED_RANGE))
    delta = np.float32(0.5 * level.highest * (1.0 - 1.0 / SMOOTHED_RANGE))
    sigma = theta / delta
    rho = np.float32(1.0 / sigma)
    if is_zero:
        relax_zero(np.float32(1.0 / theta), level.scaling, own.b, own.d, x)
    else:
        level.A.multiply(x, own.product)
        relax(np.float32(0.0), np.float32(1.0 / theta), level.scaling, own.b, own.product, own.d, x)
    for _ in range(DEGREE - 1):
        after = np.float32(1.0 / (2.0 * sigma - rho))
        level.A.multiply(x, own.product)
        keep, pull = np.float32(after * rho), np.float32(2.0 * after / delta)
        relax(keep, pull, level.scaling, own.b, own.product, own.d, x)
        rho = after
