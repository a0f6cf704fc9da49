"""Nested dissection (George, SIAM J. Numer. Anal. 10, 1973) by the places of the nodes, and the
resulting fill.

A plane normal to x, y or z divides the nodes. The nodes of one side that the matrix joins to the
other side are the separator. The separator is numbered after both sides, and each side is divided
again. All planes are examined at once: a node of rank r whose farthest neighbour has rank m is in
the separator of every cut between r and m.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from tissue.arrays import Array, Indices
from tissue.recent import Recent

LEAF = 20  # nodes; smaller sets are not dissected: smaller leaves gave the same measured fill
LOPSIDED = 0.4  # smallest share of the nodes on one side of a cut: wide enough to find the planes of quadratic elements
OUTSIDE = -1
LAST: "Recent[tuple[Dissection, Indices]]" = Recent(1)


@dataclass(frozen=True, eq=False)
class Dissection:
    """An elimination order of the nodes of a `graph` (m, m): the `pieces` in sequence.

    Each piece comes after the pieces `below` it, which it separates.
    """

    graph: csr_matrix
    pieces: tuple[Indices, ...]
    below: tuple[tuple[int, ...], ...]

    @cached_property
    def order(self) -> Indices:
        """The nodes in their order, shape `(m,)`."""
        return np.concatenate(self.pieces)

    @cached_property
    def entries(self) -> int:
        """Number of entries of the Cholesky factor of the graph, close to that of the best known
        orderings.
        """
        return _entries(self.graph, self.order, self.pieces, self.below)


def dissected(A: csr_matrix, places: Array) -> tuple[Dissection, Indices]:
    """Return the dissection of the nodes of a matrix, and the node `(n,)` of each unknown.

    The unknowns are at `places` `(n, 3)`. The last result is cached, because a solver is chosen by
    the fill before it orders the same matrix. A matrix with as many entries over the same places
    counts as the same: its fill is nearly equal, and the order is valid for any matrix.
    """

    def made() -> tuple[Dissection, Indices]:
        graph, points, node = node_graph(A, places)
        return dissection(graph, points), node

    return LAST.of((places,), made, (A.nnz,))


def node_graph(A: csr_matrix, places: Array) -> tuple[csr_matrix, Array, Indices]:
    """Return the graph `(m, m)` of the nodes, their places `(m, 3)` and the node `(n,)` of each
    unknown.

    The graph has an entry for each pair of nodes that the matrix joins.

    A node is a place with one or more unknowns.
    """
    _, first, node = np.unique(places, axis=0, return_index=True, return_inverse=True)
    node = node.ravel().astype(np.intp)
    shape = (node.size, first.size)
    lump = csr_matrix((np.ones(node.size, np.float32), (np.arange(node.size), node)), shape=shape)
    pattern = csr_matrix((np.ones(A.nnz, np.float32), A.indices, A.indptr), shape=A.shape)
    return csr_matrix(lump.T @ (pattern @ lump)), places[first], node


def dissection(graph: csr_matrix, places: Array) -> Dissection:
    """Return the dissection of a symmetric graph with a full diagonal by the places `(m, 3)` of its
    nodes.
    """
    pieces: list[Indices] = []
    children: list[tuple[int, ...]] = []
    _dissect(graph, places, np.arange(len(places)), pieces, children)
    return Dissection(graph, tuple(pieces), tuple(children))


def _dissect(
    graph: csr_matrix, places: Array, nodes: Indices, pieces: list[Indices], children: list[tuple[int, ...]]
) -> int:
    """Append separators and leaves, each after its children, and return the index of the last one."""
    below: tuple[int, ...] = ()
    if nodes.size > LEAF:
        *sides, nodes = min(_cuts(graph, places, nodes), key=lambda cut: cut[-1].size)
        below = tuple(_dissect(graph, places, side, pieces, children) for side in sides if side.size)
    pieces.append(nodes)
    children.append(below)
    return len(pieces) - 1


def _cuts(graph: csr_matrix, places: Array, nodes: Indices) -> Iterator[tuple[Indices, Indices, Indices]]:
    """Yield two cuts for each axis: the nodes on two sides, and the fewest that separate them.

    The nodes of the separator are from one side in the first cut, and from the other side in the
    second.
    """
    (joined, begins), rank = _neighbours(graph, nodes), np.full(graph.shape[0], OUTSIDE)
    for axis in range(3):
        rank[nodes[np.argsort(places[nodes, axis], kind="stable")]] = np.arange(nodes.size)
        own, reach = rank[nodes], rank[joined]
        far = np.maximum.reduceat(reach, begins)
        near = np.minimum.reduceat(np.where(reach == OUTSIDE, nodes.size, reach), begins)
        for first, last in ((own + 1, far + 1), (near + 1, own + 1)):
            at = _narrowest(first, last, nodes.size)
            cut = (first <= at) & (at < last)
            yield nodes[(own < at) & ~cut], nodes[(own >= at) & ~cut], nodes[cut]


def _neighbours(graph: csr_matrix, nodes: Indices) -> tuple[Indices, Indices]:
    """Return the neighbours of some `nodes` (k,), node by node, and the start index of each node's
    neighbours `(k,)`.

    Extracting these rows of the matrix would take four times as long.
    """
    first, count = graph.indptr[nodes], np.diff(graph.indptr)[nodes]
    begins = np.cumsum(count) - count
    return graph.indices[np.repeat(first - begins, count) + np.arange(count.sum())], begins


def _narrowest(first: Indices, last: Indices, size: int) -> int:
    """Return the cut with the fewest nodes in its separator; among equal cuts, the most balanced
    one.

    Each node is in the separators of the cuts from `first` up to, but not including, `last`.
    """
    count = np.cumsum(np.bincount(first, minlength=size + 2) - np.bincount(last, minlength=size + 2))
    low, high = int(LOPSIDED * size), int((1.0 - LOPSIDED) * size) + 1
    narrowest = low + np.flatnonzero(count[low:high] == count[low:high].min())
    return int(narrowest[np.argmin(abs(2 * narrowest - size))])


def _entries(graph: csr_matrix, order: Indices, pieces: Sequence[Indices], children: Sequence[tuple[int, ...]]) -> int:
    """Return the number of entries of the factor.

    Each piece is coupled with itself and with all later nodes that its subtree touches.
    """
    rank = np.empty(order.size, np.intp)
    rank[order] = np.arange(order.size)
    borders: list[Indices] = []
    stop = entries = 0
    for nodes, below in zip(pieces, children, strict=True):
        stop += nodes.size
        touched = np.unique(np.concatenate([rank[_neighbours(graph, nodes)[0]], *(borders[k] for k in below)]))
        borders.append(touched[touched >= stop])
        entries += nodes.size * (nodes.size + 1) // 2 + nodes.size * borders[-1].size
    return entries
