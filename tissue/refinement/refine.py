"""Refinement of tetrahedra by bisection of the longest edge.

The method is Rivara's (Int. J. Numer. Meth. Eng. 20, 1984). Marked cells are cut, and all names of
the mesh are kept. A cut edge hangs in the cells around it. These cells are bisected too, each at
its own longest edge, until no edge hangs. Among edges of equal length the place decides. The
decision is the same in a mesh and in its mirror images about the coordinate planes, so that
symmetric marks give a symmetric mesh. If two edges of one cell are mirror images of one another,
their sides decide, and not round-off.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from skfem import MeshTet

from tissue.arrays import Array, Indices

PAIRS = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
BITS = 32  # bits of the number of a point in the key of an edge
EQUAL = 1e-7  # of a length: edges that differ by less count as equal
TIED = 1e-11  # of a length: weight of the side, which decides between edges of one cell that are mirror images
SAME = 1e-8  # of the mesh's span: coordinates that differ by less count as equal
LOTS = np.array(
    [0.8191725134, 0.6710436067, 0.5497004779]
)  # Roberts' sequence in three dimensions: uniform and not periodic
OPPOSITE = (3, 2, 1, 0)  # corner opposite to each facet of a cell, in scikit-fem's order of the facets
WITHIN = -1  # for a facet inside a cell of the mesh before refinement

Mask = NDArray[np.bool_]
Keys = NDArray[np.int64]


@dataclass(frozen=True)
class Refined:
    """A refined `mesh` with the names of the mesh before refinement.

    `parents` `(c,)` are the earlier cells that contain each cell. `sides` `(f,)` are the earlier
    facets that contain each facet, or WITHIN (−1) for a facet inside an earlier cell.
    """

    mesh: MeshTet
    parents: Indices
    sides: Indices


def refine(mesh: MeshTet, marked: Indices) -> Refined:
    """Return the mesh with the `marked` cells bisected.

    All cells around them in which edges would hang are bisected too.
    """
    split = np.zeros(mesh.nelements, dtype=bool)
    split[marked] = True
    return _refined(mesh, split, lambda corners: np.zeros(len(corners), dtype=bool))


def refine_to(mesh: MeshTet, size: Callable[[Array], Array]) -> Refined:
    """Return the mesh, bisected until no cell is larger than its wanted size.

    `size` returns the wanted sizes [m] of cells with corners `(c, 4, 3)`.
    """

    def too_large(corners: Array) -> Mask:
        return np.asarray(cell_sizes(corners) > size(corners))

    return _refined(mesh, too_large(mesh.p.T[mesh.t.T]), too_large)


def _refined(mesh: MeshTet, split: Mask, too_large: Callable[[Array], Mask]) -> Refined:
    """Return the mesh with the cells `split` `(c,)` bisected, and their parts while `too_large`.

    Boundaries and subdomains keep their names. A double node on both lips of a slit stays double.
    """
    if not split.any():
        return Refined(mesh, np.arange(mesh.nelements), np.arange(mesh.nfacets))
    one = _joined(mesh)
    points, cells, parents, sides = _bisected(mesh, one[mesh.t.T], split, too_large)
    if np.any(one != np.arange(mesh.nvertices)):
        points, cells = _parted(points, cells, (sides >= 0) & (mesh.f2t[1, sides] < 0))
    fine = MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
    of = np.full(fine.nfacets, WITHIN, np.intp)
    of[fine.t2f] = sides.T[list(OPPOSITE)]
    fine._boundaries = {name: np.flatnonzero(np.isin(of, old)) for name, old in (mesh.boundaries or {}).items()}
    fine._subdomains = {name: np.flatnonzero(np.isin(parents, old)) for name, old in (mesh.subdomains or {}).items()}
    return Refined(fine, parents, of)


def _joined(mesh: MeshTet) -> Indices:
    """Return for each node the first node at the same place of the surface, `(n,)`.

    Lips that coincide are cut in the same way while their nodes are joined.
    """
    one, surface = np.arange(mesh.nvertices), np.unique(mesh.facets[:, mesh.boundary_facets()])
    _, first, place = np.unique(mesh.p[:, surface].T, axis=0, return_index=True, return_inverse=True)
    one[surface] = surface[first[place.ravel()]]
    return one


def _parted(points: Array, cells: Indices, outer: Mask) -> tuple[Array, Indices]:
    """Return points and cells with a separate node for each connected group of cells.

    The groups are those around one place. Cells are connected by common facets, except facets of
    the surface. `outer` `(c, 4)` marks such facets opposite to each corner.
    """
    whole = MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
    closed = np.zeros(whole.nfacets, dtype=bool)
    closed[whole.t2f[list(OPPOSITE)].T[outer]] = True
    inner = np.flatnonzero((whole.f2t[1] >= 0) & ~closed)
    corners = [4 * own + (cells[own] == whole.facets[:, inner, None]).argmax(axis=2) for own in whole.f2t[:, inner]]
    links = csr_matrix((np.ones(corners[0].size), [end.ravel() for end in corners]), shape=(cells.size, cells.size))
    count, node = connected_components(links, directed=False)
    places = np.empty((count, 3))
    places[node] = points[cells.ravel()]
    return places, node.reshape(cells.shape).astype(np.intp)


def _bisected(
    mesh: MeshTet, cells: Indices, split: Mask, too_large: Callable[[Array], Mask]
) -> tuple[Array, Indices, Indices, Indices]:
    """Return points, cells, their parents `(c,)` and their sides `(c, 4)`.

    A side is the mesh facet that contains the facet opposite to a corner, or WITHIN for a facet
    inside a cell of the mesh.
    """
    points = mesh.p.T
    parents, sides = np.arange(len(cells)), mesh.t2f[list(OPPOSITE)].T.astype(np.intp)
    span = float(np.linalg.norm(np.ptp(points, axis=0)))
    cut, middles = np.zeros(0, np.int64), np.zeros(0, np.intp)
    keys, longest = _edges(points, cells, span)
    while split.any():
        own = keys[np.arange(len(cells)), longest][split]
        fresh = np.setdiff1d(own, cut)
        order = np.argsort(np.concatenate([cut, fresh]))
        middles = np.concatenate([middles, len(points) + np.arange(fresh.size)])[order]
        cut = np.concatenate([cut, fresh])[order]
        points = np.vstack([points, points[_ends(fresh)].mean(axis=0)])
        parts, inner = _halves(cells[split], sides[split], longest[split], middles[np.searchsorted(cut, own)])
        edges, whole = _edges(points, parts, span), ~split
        # A cell that was not split is small enough, and none of its edges was cut before.
        hanging = np.isin(keys[whole], fresh).any(axis=1)
        split = np.concatenate([hanging, too_large(points[parts]) | np.isin(edges[0], cut).any(axis=1)])
        cells, sides = np.concatenate([cells[whole], parts]), np.concatenate([sides[whole], inner])
        parents = np.concatenate([parents[whole], parents[~whole], parents[~whole]])
        keys, longest = (np.concatenate([old[whole], new]) for old, new in zip((keys, longest), edges, strict=True))
    return points, cells, parents, sides


def _halves(cells: Indices, sides: Indices, longest: Indices, middles: Indices) -> tuple[Indices, Indices]:
    """Return the two parts of each of the `cells` `(k, 4)`, and the `sides` of these parts.

    All first parts come before all second parts. In each part, one end of the longest edge becomes
    the middle of this edge. The facet opposite to the other end lies inside the cell.
    """
    rows, parts, inner = np.arange(len(cells)), [], []
    for end, other in (PAIRS[longest].T, PAIRS[longest].T[::-1]):
        part, side = cells.copy(), sides.copy()
        part[rows, end], side[rows, other] = middles, WITHIN
        parts.append(part)
        inner.append(side)
    return np.concatenate(parts), np.concatenate(inner)


def _edges(points: Array, cells: Indices, span: float) -> tuple[Keys, Indices]:
    """Return the keys of the edges `(c, 6)` and the longest edge of each cell `(c,)`.

    The mesh has the given `span` [m].
    """
    ends = np.sort(cells[:, PAIRS], axis=2).astype(np.int64)
    keys, (low, high) = (ends[..., 0] << BITS) + ends[..., 1], np.moveaxis(points[ends], 2, 0)
    # A pseudo-random number computed from the place prevents a preferred direction of the choice
    # in the mesh.
    place = (low + high) / span
    lot = EQUAL * (np.round(np.abs(place) / SAME) @ LOTS % 1.0) + TIED * (place @ LOTS)
    return keys, np.argmax(np.linalg.norm(high - low, axis=2) * (1.0 + lot), axis=1)


def _ends(keys: Keys) -> Indices:
    """Return the two ends of edges by their keys, shape `(2, k)`."""
    return np.stack([keys >> BITS, keys & ((1 << BITS) - 1)])


def cell_sizes(corners: Array) -> Array:
    """Return the size of cells with corners `(c, 4, 3)`, shape `(c,)` [m].

    The size is the edge of a cube that consists of six such cells.
    """
    return np.asarray(np.cbrt(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))))
