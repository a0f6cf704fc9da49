"""Stiffness, mass and dilatation of straight tetrahedra, summed over the cells in one compiled pass.

In a cell ∇φ_i = Σ_c s_ic g_c with the gradients g_0 to g_3 of its barycentric coordinates, which are constant there. So
every integral is a sum of products of the g_c, weighted by means over the reference cell, which scikit-fem's shape
functions and quadrature give (`ReferenceMeans`). The loops are compiled by Numba when they are first
called and kept on disk.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from skfem import Element, ElementTetP1
from skfem.quadrature import get_quadrature

from tissue.arrays import Array
from tissue.loops import compiled

Whole = NDArray[Any]  # of whole numbers, 4 or 8 bytes each

LARGEST_INT32 = np.iinfo(np.int32).max
NONE = 1e-12  # of a slope in the reference cell, whose edges are one long: round-off


@dataclass(frozen=True)
class ReferenceMeans:
    """Means over a cell of products of its n shape functions φ, of their slopes and of the four linear functions ψ.

    ∇φ_i = Σ_c s_ic g_c: `slopes` `(n, n, 4, 4)` are the means of s_ic s_jd, `shapes` `(n, n)` of φ_i φ_j, and `fluxes`
    `(4, n, 4)` of ψ_a s_jc.
    """

    slopes: Array
    shapes: Array
    fluxes: Array

    @property
    def apart(self) -> "ReferenceMeans":
        """The same with `slopes` of the means of s_ic times those of s_jd, for terms of the mean slope of a cell."""
        mean = self.fluxes.sum(axis=0)  # of the four linear functions, which sum to one
        mean[np.abs(mean) <= NONE] = 0.0
        return replace(self, slopes=np.einsum("ic,jd->ijcd", mean, mean))


def reference_means(element: Element) -> ReferenceMeans:
    """Return the means of a scalar Lagrange element of the tetrahedron."""
    X, W = get_quadrature(element, 2 * element.maxdeg)
    (phi, slope), (psi, _) = _shapes(element, X), _shapes(ElementTetP1(), X)
    mean = W / W.sum()
    return ReferenceMeans(
        np.einsum("icx,jdx,x->ijcd", slope, slope, mean, optimize=True),
        np.einsum("ix,jx,x->ij", phi, phi, mean),
        np.einsum("ax,jcx,x->ajc", psi, slope, mean),
    )


def _shapes(element: Element, X: Array) -> tuple[Array, Array]:
    """Return the shape functions `(n, x)` at points of the reference cell, and their slopes `(n, 4, x)`."""
    values = [element.lbasis(X, i) for i in range(len(element.doflocs))]
    return np.array([phi for phi, _ in values]), np.array([_shortest(slope) for _, slope in values])


def _shortest(slope: Array) -> Array:
    """Return slopes along three barycentric coordinates `(3, x)` as those along all four with the most zeros: their
    gradients sum to zero, so the same may be added to all."""
    four = np.vstack([np.zeros_like(slope[:1]), slope])
    ways = [np.where(np.abs(way) > NONE, way, 0.0) for way in (four - corner for corner in four)]
    return min(ways, key=np.count_nonzero)


@dataclass(frozen=True)
class CellGraph:
    """The cells `(c, n)` over m nodes, four vertices first; those around node a, `around` from `begin[a]` on; and the
    nodes in them, `neighbours` from `first[a]` on, sorted, a itself included.
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
    """Return the graph of cells `(c, n)` over so many nodes."""
    cells = np.ascontiguousarray(cells, dtype=np.int32)
    begin, around = _cells_around(cells, nodes)
    return CellGraph(cells, begin, around, *_neighbours(cells, begin, around))


def barycentric_gradients(points: Array, graph: CellGraph) -> tuple[Array, Array]:
    """Return g_0 to g_3 of every cell, `(c, 12)` [1/m], and its volume, `(c,)` [m³], from the nodes' `points`
    `(m, 3)` [m]."""
    return _gradients(np.ascontiguousarray(points), graph.cells)


def stiffness_and_mass(
    graph: CellGraph, means: ReferenceMeans, gradients: Array, lam: Array, mu: Array, weight: Array
) -> tuple[csr_matrix, csr_matrix]:
    """Return K [N/m] and M [kg], `(3m, 3m)`, of λ and μ times the cells' volumes [N m] and of their `weight` [kg],
    `(c,)` each."""
    n = graph.cells.shape[1]
    K, M, mass = _zeros(graph, graph.nodes, 3, 3), _zeros(graph, graph.nodes, 3, 1), np.zeros(len(graph.neighbours))
    slopes = means.slopes.reshape(n * n, 16)
    pair, term = np.nonzero(slopes)
    sums = np.searchsorted(pair, np.arange(n * n + 1)), term, slopes[pair, term]
    _add_rows(*_arrays(graph), gradients, *sums, means.shapes, lam, mu, weight, K.data, mass)
    _spread(graph.first, mass, M.data)
    return K, M


def fluxes(graph: CellGraph, means: ReferenceMeans, gradients: Array, vertices: int, volumes: Array) -> csr_matrix:
    """Return D_aj = ∫ ψ_a div φ_j dx, `(vertices, 3m)` [m²]; cells whose volume is given as zero are left out."""
    D = _zeros(graph, vertices, 1, 3)
    _add_fluxes(*_arrays(graph), gradients, means.fluxes, volumes, vertices, D.data)
    return D


def _arrays(graph: CellGraph) -> tuple[Whole, Whole, Whole, Whole, Whole]:
    return graph.cells, graph.begin, graph.around, graph.first, graph.neighbours


def _zeros(graph: CellGraph, nodes: int, rows: int, width: int) -> csr_matrix:
    """Return a matrix of zeros with `rows` rows for each of the first `nodes` nodes.

    A row has entries for the three unknowns of each neighbour, or with a `width` of 1 for its own of the three.
    """
    first, neighbours = graph.first[: nodes + 1], graph.neighbours[: graph.first[nodes]]
    entries, columns = rows * width * len(neighbours), 3 * graph.nodes
    whole: type[np.integer] = np.int32 if max(entries, columns) <= LARGEST_INT32 else np.int64
    indptr, indices = np.zeros(rows * nodes + 1, whole), np.empty(entries, whole)
    _number(first, neighbours, rows, width, indptr, indices)
    return csr_matrix((np.zeros(entries), indices, indptr), shape=(rows * nodes, columns))


@compiled
def _cells_around(cells: Whole, nodes: int) -> tuple[Whole, Whole]:
    """Return where the cells around each node begin, `(m + 1,)`, and these."""
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
    """Return where the nodes that share a cell with each node begin, `(m + 1,)`, and these, sorted."""
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
def _number(first: Whole, neighbours: Whole, rows: int, width: int, indptr: Whole, indices: Whole) -> None:
    """Fill in where the rows of a matrix begin, and its columns, as `_zeros` says."""
    at = 0
    for a in range(len(first) - 1):
        for p in range(rows):
            for k in range(first[a], first[a + 1]):
                for q in range(width):
                    indices[at] = 3 * neighbours[k] + (q if width == 3 else p)
                    at += 1
            indptr[rows * a + p + 1] = at


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
    """Add up the rows of K, and those of the mass over the nodes, one node after the other: these stay in the cache.

    Of the nodes i and j of a cell V⟨∇φ_i ⊗ ∇φ_j⟩ = B is the sum of the `terms` 4 c + d, g_c ⊗ g_d, from `sums[n i + j]`
    on by their `weights`. It gives λ B + μ Bᵀ + μ tr B I.
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
    """Give each node's row to its three unknowns."""
    at = 0
    for a in range(len(first) - 1):
        for _ in range(3):
            for k in range(first[a], first[a + 1]):
                M[at] = mass[k]
                at += 1


@compiled
def _add_fluxes(
    cells: Whole,
    begin: Whole,
    around: Whole,
    first: Whole,
    neighbours: Whole,
    g: Array,
    means: Array,
    volumes: Array,
    vertices: int,
    D: Array,
) -> None:
    """Add up the rows of D, one vertex after the other."""
    place = np.zeros(len(first) - 1, np.int64)
    for a in range(vertices):
        for k in range(first[a], first[a + 1]):
            place[neighbours[k]] = k
        for z in range(begin[a], begin[a + 1]):
            e, i = around[z], 0
            while cells[e, i] != a:
                i += 1
            for j in range(cells.shape[1]):
                for c in range(4):
                    for q in range(3):
                        D[3 * place[cells[e, j]] + q] += volumes[e] * means[i, j, c] * g[e, 3 * c + q]
