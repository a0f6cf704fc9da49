"""Nested dissection (George, SIAM J. Numer. Anal. 10, 1973) by the places of the nodes, and the fill it leaves.

A plane across x, y or z parts the nodes; those of one side that the matrix joins to the other are the separator, which
is numbered after both sides, and so on in each of them. All planes are looked at at once: a node of rank r whose
farthest neighbour has rank m is in the separator of every cut between r and m.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from tissue.arrays import Array, Indices

LEAF = 20  # nodes below which dissection stops: smaller leaves measured the same
LOPSIDED = 0.4  # smallest share of the nodes on one side of a cut: room to find the planes of quadratic elements
OUTSIDE = -1


@dataclass(frozen=True, eq=False)
class Dissection:
    """An elimination order of the nodes of a `graph` (m, m): the `pieces` one after the other, each behind the pieces
    `below` it, which it parts."""

    graph: csr_matrix
    pieces: tuple[Indices, ...]
    below: tuple[tuple[int, ...], ...]

    @cached_property
    def order(self) -> Indices:
        """The nodes in their order, shape `(m,)`."""
        return np.concatenate(self.pieces)

    @cached_property
    def entries(self) -> int:
        """The entries of the Cholesky factor of the graph, close to those that the best orderings known leave."""
        return _entries(self.graph, self.order, self.pieces, self.below)


@dataclass(frozen=True)
class _Cut:
    """Nodes on two sides, and those that part them."""

    left: Indices
    right: Indices
    separator: Indices


def node_graph(A: csr_matrix, places: Array) -> tuple[csr_matrix, Array, Indices]:
    """Return the graph `(m, m)` of the places that the matrix joins, those places `(m, 3)`, and the node of
    every unknown `(n,)`.
    """
    _, first, node = np.unique(places, axis=0, return_index=True, return_inverse=True)
    node = node.ravel().astype(np.intp)
    shape = (node.size, first.size)
    lump = csr_matrix((np.ones(node.size, np.float32), (np.arange(node.size), node)), shape=shape)
    pattern = csr_matrix((np.ones(A.nnz, np.float32), A.indices, A.indptr), shape=A.shape)
    return csr_matrix(lump.T @ (pattern @ lump)), places[first], node


def dissection(graph: csr_matrix, places: Array) -> Dissection:
    """Dissect the nodes of a symmetric graph with a full diagonal by their places `(m, 3)`."""
    pieces: list[Indices] = []
    children: list[tuple[int, ...]] = []
    _dissect(graph, places, np.arange(len(places)), pieces, children)
    return Dissection(graph, tuple(pieces), tuple(children))


def _dissect(
    graph: csr_matrix, places: Array, nodes: Indices, pieces: list[Indices], children: list[tuple[int, ...]]
) -> int:
    """Append separators and leaves, each after its children; the index of the last one."""
    below: tuple[int, ...] = ()
    if nodes.size > LEAF:
        cut = min(_cuts(graph, places, nodes), key=lambda cut: cut.separator.size)
        sides = [side for side in (cut.left, cut.right) if side.size]
        below, nodes = tuple(_dissect(graph, places, side, pieces, children) for side in sides), cut.separator
    pieces.append(nodes)
    children.append(below)
    return len(pieces) - 1


def _cuts(graph: csr_matrix, places: Array, nodes: Indices) -> Iterator[_Cut]:
    """Return, of each axis, the cuts with the fewest nodes in the separator, which is taken from one side or
    the other.
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
            yield _Cut(nodes[(own < at) & ~cut], nodes[(own >= at) & ~cut], nodes[cut])


def _neighbours(graph: csr_matrix, nodes: Indices) -> tuple[Indices, Indices]:
    """Return the nodes that some `nodes` (k,) are joined with, one node's after the other's, and where those of each
    begin `(k,)`; by a matrix of these rows it takes four times as long."""
    first, count = graph.indptr[nodes], np.diff(graph.indptr)[nodes]
    begins = np.cumsum(count) - count
    return graph.indices[np.repeat(first - begins, count) + np.arange(count.sum())], begins


def _narrowest(first: Indices, last: Indices, size: int) -> int:
    """Return the cut with the fewest nodes in its separator, of several the most even.

    Each node is in the separators of the cuts from `first` until before `last`.
    """
    count = np.cumsum(np.bincount(first, minlength=size + 2) - np.bincount(last, minlength=size + 2))
    low, high = int(LOPSIDED * size), int((1.0 - LOPSIDED) * size) + 1
    narrowest = low + np.flatnonzero(count[low:high] == count[low:high].min())
    return int(narrowest[np.argmin(abs(2 * narrowest - size))])


def _entries(graph: csr_matrix, order: Indices, pieces: Sequence[Indices], children: Sequence[tuple[int, ...]]) -> int:
    """Return the entries of the factor: each piece is joined with itself and with all later nodes that its
    subtree touches.
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
