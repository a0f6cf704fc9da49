"""Stiffness and mass of straight tetrahedra, summed over the cells in one compiled pass.

In a cell, ∇φ_i = Σ_c s_ic g_c. The gradients g_0 to g_3 of its barycentric coordinates are constant
in the cell. Every integral is then a sum of products of the g_c, weighted by means over the
reference cell. These means come from scikit-fem's shape functions and quadrature
(`ReferenceMeans`). Numba compiles the loops at their first call and caches them on disk.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from skfem import Element
from skfem.quadrature import get_quadrature

from tissue.arrays import Array
from tissue.loops import compiled
from tissue.shapes import shapes

Whole = NDArray[Any]  # integers of 4 or 8 bytes

LARGEST_INT32 = np.iinfo(np.int32).max
NONE = 1e-12  # of a slope in the reference cell with edges of length one: smaller values are round-off


@dataclass(frozen=True)
class ReferenceMeans:
    """Means over a cell of products of its n shape functions φ, and of their slopes.

    ∇φ_i = Σ_c s_ic g_c. `slopes` `(n, n, 4, 4)` are the means of s_ic s_jd. `shapes` `(n, n)` are
    the means of φ_i φ_j.
    """

    slopes: Array
    shapes: Array


def reference_means(element: Element) -> ReferenceMeans:
    """Return the means of a scalar Lagrange element of the tetrahedron."""
    X, W = get_quadrature(element, 2 * element.maxdeg)
    phi, slopes = shapes(element, X.T)
    slope, mean = np.array([_shortest(each) for each in slopes]), W / W.sum()
    return ReferenceMeans(
        np.einsum("icx,jdx,x->ijcd", slope, slope, mean, optimize=True),
        np.einsum("ix,jx,x->ij", phi, phi, mean),
    )


def _shortest(slope: Array) -> Array:
    """Return slopes along all four barycentric coordinates from slopes along three of them `(3,
    x)`.

    The four gradients sum to zero, so that a common value can be added to all slopes. The value
    that gives the most zeros is chosen.
    """
    four = np.vstack([np.zeros_like(slope[:1]), slope])
    ways = [np.where(np.abs(way) > NONE, way, 0.0) for way in (four - corner for corner in four)]
    return min(ways, key=np.count_nonzero)


class CellGraph(NamedTuple):
    """The cells `(c, n)` over m nodes, the cells around each node and the neighbours of each node.

    The four vertices of a cell come first. The cells around node a are in `around` from `begin[a]`
    on. The nodes of these cells are in `neighbours` from `first[a]` on, sorted and including a
    itself.
    """

    cells: Whole
    begin: Whole
    around: Whole
    first: Whole
    neighbours: Whole

    @property
    def nodes(self) -> int:
        """Number of nodes m."""
        return len(self.first) - 1


def cell_graph(cells: Whole, nodes: int) -> CellGraph:
    """Return the graph of cells `(c, n)` over a number of `nodes`."""
    cells = np.ascontiguousarray(cells, dtype=np.int32)
    begin, around = _cells_around(cells, nodes)
    return CellGraph(cells, begin, around, *_neighbours(cells, begin, around))


def barycentric_gradients(points: Array, graph: CellGraph) -> tuple[Array, Array]:
    """Return g_0 to g_3 of every cell, `(c, 12)` [1/m], and its volume, `(c,)` [m³].

    The nodes are at `points` `(m, 3)` [m].
    """
    return _gradients(np.ascontiguousarray(points), graph.cells)


def stiffness_and_mass(
    graph: CellGraph, means: ReferenceMeans, gradients: Array, lam: Array, mu: Array, weight: Array
) -> tuple[csr_matrix, csr_matrix]:
    """Return K [N/m] and M [kg], shape `(3m, 3m)` each.

    `lam` and `mu` are λ and μ times the volumes of the cells [N m], `weight` the masses of the
    cells [kg], `(c,)` each.
    """
    n = graph.cells.shape[1]
    K, M, mass = _zeros(graph, 3), _zeros(graph, 1), np.zeros(len(graph.neighbours))
    slopes = means.slopes.reshape(n * n, 16)
    pair, term = np.nonzero(slopes)
    sums = np.searchsorted(pair, np.arange(n * n + 1)), term, slopes[pair, term]
    _add_rows(*graph, gradients, *sums, means.shapes, lam, mu, weight, K.data, mass)
    _spread(graph.first, mass, M.data)
    return K, M


def _zeros(graph: CellGraph, width: int) -> csr_matrix:
    """Return a matrix of zeros with three rows for each node.

    A row has entries for all three unknowns of each neighbour. With `width` 1 it has entries only
    for the component of the row.
    """
    entries, size = 3 * width * len(graph.neighbours), 3 * graph.nodes
    whole: type[np.integer] = np.int32 if max(entries, size) <= LARGEST_INT32 else np.int64
    indptr, indices = np.zeros(size + 1, whole), np.empty(entries, whole)
    _number(graph.first, graph.neighbours, width, indptr, indices)
    return csr_matrix((np.zeros(entries), indices, indptr), shape=(size, size))


@compiled
def _cells_around(cells: Whole, nodes: int) -> tuple[Whole, Whole]:
    """Return the start index of the cells around each node, `(m + 1,)`, and the list of these
    cells.
    """
    begin = np.zeros(nodes + 1, np.int64)
    for e in range(len(cells)):
        for i in range(cells.shape[1]):
            begin[cells[e, i] + 1] += 1
    begin = np.cumsum(begin)
    around, end = np.empty(begin[nodes], np.int32), begin[:-1].copy()
    for e in range(len(cells)):
        for i in range(cells.shape[1]):
            a = cells[e, i]
            around[end[a]] = e
            end[a] += 1
    return begin, around


@compiled
def _neighbours(cells: Whole, begin: Whole, around: Whole) -> tuple[Whole, Whole]:
    """Return the start index of the neighbours of each node, `(m + 1,)`, and the list of
    neighbours.

    The neighbours of a node are the nodes that share a cell with it, sorted.
    """
    nodes, count = len(begin) - 1, 0
    first, found = np.zeros(nodes + 1, np.int64), np.empty(len(around) * cells.shape[1], np.int32)
    seen = np.full(nodes, -1)
    for a in range(nodes):
        for k in range(begin[a], begin[a + 1]):
            for j in range(cells.shape[1]):
                b = cells[around[k], j]
                if seen[b] != a:
                    seen[b], found[count], count = a, b, count + 1
        first[a + 1] = count
        found[first[a] : count].sort()
    return first, found[:count].copy()


@compiled
def _number(first: Whole, neighbours: Whole, width: int, indptr: Whole, indices: Whole) -> None:
    """Write the row starts and the columns of the matrix of `_zeros`."""
    at = 0
    for a in range(len(first) - 1):
        for p in range(3):
            for k in range(first[a], first[a + 1]):
                for q in range(width):
                    indices[at] = 3 * neighbours[k] + (q if width == 3 else p)
                    at += 1
            indptr[3 * a + p + 1] = at


@compiled
def _gradients(points: Array, cells: Whole) -> tuple[Array, Array]:
    """Return the gradients of the barycentric coordinates, and the volumes."""
    g, volumes = np.empty((len(cells), 12)), np.empty(len(cells))
    for e in range(len(cells)):
        o, determinant = cells[e, 0], 0.0
        for c in range(3):
            i, j = cells[e, 1 + (c + 1) % 3], cells[e, 1 + (c + 2) % 3]
            for p in range(3):
                k, m = (p + 1) % 3, (p + 2) % 3
                u, v = points[i, k] - points[o, k], points[i, m] - points[o, m]
                g[e, 3 * c + 3 + p] = u * (points[j, m] - points[o, m]) - v * (points[j, k] - points[o, k])
        for p in range(3):
            determinant += g[e, 3 + p] * (points[cells[e, 1], p] - points[o, p])
        for k in range(3, 12):
            g[e, k] /= determinant
        for p in range(3):
            g[e, p] = -(g[e, 3 + p] + g[e, 6 + p] + g[e, 9 + p])
        volumes[e] = abs(determinant) / 6.0
    return g, volumes


@compiled
def _add_rows(
    cells: Whole,
    begin: Whole,
    around: Whole,
    first: Whole,
    neighbours: Whole,
    g: Array,
    sums: Whole,
    terms: Whole,
    weights: Array,
    shapes: Array,
    lam: Array,
    mu: Array,
    rho: Array,
    K: Array,
    mass: Array,
) -> None:
    """Add up the rows of K and of the nodal mass, node by node.

    The rows of a node then stay in the processor's cache.

    For the nodes i and j of a cell, B = ⟨∇φ_i ⊗ ∇φ_j⟩ is a sum of products g_c ⊗ g_d with
    `weights`. The `terms` 4 c + d of this sum begin at `sums[n i + j]`. B adds λ B + μ Bᵀ + μ tr B
    I to K, with λ and μ times the volume.
    """
    n, place, B = cells.shape[1], np.zeros(len(first) - 1, np.int64), np.empty(9)
    for a in range(len(first) - 1):
        low, width = first[a], 3 * (first[a + 1] - first[a])
        for k in range(low, first[a + 1]):
            place[neighbours[k]] = k
        for z in range(begin[a], begin[a + 1]):
            e, i = around[z], 0
            while cells[e, i] != a:
                i += 1
            for j in range(n):
                at = place[cells[e, j]]
                mass[at] += rho[e] * shapes[i, j]
                B[:] = 0.0
                for t in range(sums[n * i + j], sums[n * i + j + 1]):
                    c, d = 3 * (terms[t] // 4), 3 * (terms[t] % 4)
                    for p in range(3):
                        for q in range(3):
                            B[3 * p + q] += weights[t] * g[e, c + p] * g[e, d + q]
                row, trace = 6 * low + 3 * at, mu[e] * (B[0] + B[4] + B[8])
                for p in range(3):
                    for q in range(3):
                        K[row + q] += lam[e] * B[3 * p + q] + mu[e] * B[3 * q + p]
                    K[row + p] += trace
                    row += width


@compiled
def _spread(first: Whole, mass: Array, M: Array) -> None:
    """Copy each node's row to its three unknowns."""
    at = 0
    for a in range(len(first) - 1):
        for _ in range(3):
            for k in range(first[a], first[a + 1]):
                M[at] = mass[k]
                at += 1
