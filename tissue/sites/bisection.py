"""Tetrahedra cut finer where that is wanted: bisection of the longest edge (Rivara, Int. J. Numer. Meth. Eng. 20,
1984).

A cut edge hangs in the cells around it, which are bisected too, each by its own longest edge, until no edge hangs. Of
edges of one length the one between the higher numbers goes first, so neighbours agree, and every run gives the same
cells.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue.arrays import Array, Indices

PAIRS = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
BITS = 32  # of the number of a point in the key of an edge

Keys = NDArray[np.int64]


@dataclass(frozen=True)
class Bisected:
    """Points `(n, 3)` [m], those that were given first, cells `(c, 4)`, and the cell `(c,)` that each is a part of."""

    points: Array
    cells: Indices
    parents: Indices


def bisect(points: Array, cells: Indices, size: Callable[[Array], Array]) -> Bisected:
    """Bisect cells until none is larger than the `size` [m] wanted for its corners `(c, 4, 3)`.

    A cell is as large as the edge of a cube of six such cells.
    """
    parents, cut, middles = np.arange(len(cells)), np.zeros(0, np.int64), np.zeros(0, np.intp)
    (keys, longest), split = _edges(points, cells), cell_sizes(points[cells]) > size(points[cells])
    while split.any():
        own = keys[np.arange(len(cells)), longest][split]
        fresh = np.setdiff1d(own, cut)
        ends = np.stack([fresh >> BITS, fresh & ((1 << BITS) - 1)])
        order = np.argsort(np.concatenate([cut, fresh]))
        middles = np.concatenate([middles, len(points) + np.arange(fresh.size)])[order]
        cut = np.concatenate([cut, fresh])[order]
        points = np.vstack([points, points[ends].mean(axis=0)])
        halves = np.repeat(cells[split][None], 2, axis=0)
        for half, end in zip(halves, PAIRS[longest[split]].T, strict=True):
            half[np.arange(len(half)), end] = middles[np.searchsorted(cut, own)]
        whole, parts = ~split, np.concatenate(halves)
        parents = np.concatenate([parents[whole], parents[split], parents[split]])
        edges = _edges(points, parts)
        # A cell that was left whole is small enough, and of the edges cut before none is its own.
        too_large = cell_sizes(points[parts]) > size(points[parts])
        hanging = np.isin(keys[whole], fresh).any(axis=1)
        split = np.concatenate([hanging, too_large | np.isin(edges[0], cut).any(axis=1)])
        cells = np.concatenate([cells[whole], parts])
        keys, longest = (np.concatenate([old[whole], new]) for old, new in zip((keys, longest), edges, strict=True))
    return Bisected(points, cells, parents)


def cell_sizes(corners: Array) -> Array:
    """Return the edge of a cube of six cells like each of the corners `(c, 4, 3)`, shape `(c,)` [m]."""
    return np.asarray(np.cbrt(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))))


def _edges(points: Array, cells: Indices) -> tuple[Keys, Indices]:
    """Return the keys of the edges `(c, 6)`, and which of them is the longest `(c,)`."""
    ends = np.sort(cells[:, PAIRS], axis=2).astype(np.int64)
    keys = (ends[..., 0] << BITS) + ends[..., 1]
    lengths = np.linalg.norm(points[ends[..., 1]] - points[ends[..., 0]], axis=2)
    longest = lengths == lengths.max(axis=1)[:, None]
    return keys, np.argmax(np.where(longest, keys, -1), axis=1)
