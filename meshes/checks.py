"""The checks that a volume mesh must pass; each fault is reported with its numbers."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from meshes.errors import MeshError
from meshes.facets import six_volumes, tet_facet_keys
from meshes.quality import edge_lengths

Array = NDArray[np.float64]
Tets = NDArray[np.integer]

# A tetrahedron with a smaller ratio of volume to (longest edge)³ counts as flat. A right-angled
# tetrahedron has 0.06, one with edges 1 : 1000 : 1000 has 6e-5, and one with edges 1 : 1 : 1000 has
# 2e-7; round-off of coordinates gives 1e-16.
FLAT = 1e-9
# Two nodes with a smaller distance over the mesh's diagonal count as one. Files of single precision
# resolve 1e-7.
COINCIDENT = 1e-9
FARTHEST, NEAREST = 1e15, 1e-15  # m: a size outside this range is a mistake, and far outside volumes overflow or vanish

NO_TWINS = np.empty((0, 2), dtype=np.int64)


def check(points: Array, tets: Tets, twins: Tets = NO_TWINS, parts: int | None = 1) -> None:
    """Raise `MeshError` unless points `(n, 3)` and tets `(m, 4)` are a valid volume mesh.

    `twins` `(k, 2)` are pairs of nodes that are meant to coincide, on the two lips of a closed cut.
    `parts` is the number of separate bodies. It is None if any number of bodies is allowed; they
    can touch but share no node.

    The error names the fault. For nodes: coordinates that are not finite, indices out of range,
    unused or duplicate nodes. For tetrahedra: none, degenerate, inverted or overlapping ones, and
    parts without a common facet.
    """
    _check_volume(points, tets)
    _check_finite(points)
    check_span(points)
    _check_indices(points, tets)
    _check_used(points, tets)
    _check_distinct(points, twins, None if parts else _bodies_of_nodes(points, tets))
    _check_orientation(points, tets)
    _check_facets(points, tets)
    if parts is None:
        _check_apart(points, tets)
    else:
        _check_connected(points, tets, parts)


def volumes(points: Array, tets: Tets) -> Array:
    """Return the signed volumes of the tetrahedra, shape `(m,)`."""
    return six_volumes(*(points[nodes] for nodes in tets.T)) / 6.0


def _few(indices: NDArray[np.integer]) -> str:
    return ", ".join(str(i) for i in indices[:3]) + (", …" if len(indices) > 3 else "")


def _check_volume(points: Array, tets: Tets) -> None:
    if points.ndim != 2 or points.shape[1] != 3 or tets.ndim != 2 or tets.shape[1] != 4:
        raise MeshError(f"points have shape {points.shape} and tets {tets.shape}: (n, 3) and (m, 4) are needed")
    if len(tets) == 0:
        raise MeshError("it holds no tetrahedra: mesh the volume")


def _check_finite(points: Array) -> None:
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise MeshError(f"{bad.size} of {len(points)} nodes have coordinates that are not finite (index {_few(bad)})")


def check_span(points: Array) -> None:
    """Raise `MeshError` if points are so large or so close that volumes overflow or vanish.

    Points have shape `(n, 3)` [m].
    """
    if not len(points):
        return
    with np.errstate(over="ignore"):
        span = float(np.max(np.abs(points))), float(np.max(np.ptp(points, axis=0)))
    if max(span) > FARTHEST or 0.0 < span[1] < NEAREST:
        raise MeshError(
            f"its nodes lie up to {span[0]:.3g} m from the origin and span {span[1]:.3g} m, allowed are at most "
            f"{FARTHEST:g} m and at least {NEAREST:g} m: correct the unit, or the coordinates"
        )


def _check_indices(points: Array, tets: Tets) -> None:
    bad = np.flatnonzero(((tets < 0) | (tets >= len(points))).any(axis=1))
    if bad.size:
        raise MeshError(f"{bad.size} tetrahedra name nodes outside 0 … {len(points) - 1} (index {_few(bad)})")


def _check_used(points: Array, tets: Tets) -> None:
    unused = np.setdiff1d(np.arange(len(points)), tets)
    if unused.size:
        raise MeshError(
            f"{unused.size} of {len(points)} nodes belong to no tetrahedron (index {_few(unused)}): "
            "they would move freely; delete them"
        )


def _check_distinct(points: Array, twins: Tets, bodies: NDArray[np.integer] | None) -> None:
    """Raise `MeshError` for coincident nodes.

    The `twins` and nodes of different `bodies` `(n,)` may coincide.
    """
    reach = COINCIDENT * float(np.linalg.norm(np.ptp(points, axis=0)))
    pairs = cKDTree(points).query_pairs(reach)
    pairs -= {(int(min(pair)), int(max(pair))) for pair in twins}
    if bodies is not None:
        pairs = {(a, b) for a, b in pairs if bodies[a] == bodies[b]}
    if pairs:
        first = min(pairs)
        raise MeshError(
            f"{len(pairs)} pairs of nodes lie at the same place (the first: {first[0]} and {first[1]}): merge them"
        )


def _check_orientation(points: Array, tets: Tets) -> None:
    relative = volumes(points, tets) / edge_lengths(points[tets]).max(axis=1) ** 3
    flat = np.flatnonzero(np.abs(relative) <= FLAT)
    if flat.size:
        raise MeshError(
            f"{flat.size} of {len(tets)} tetrahedra are degenerate, with no volume (index {_few(flat)}): "
            "remesh, or optimise the mesh"
        )
    inverted = np.flatnonzero(relative < 0)
    if len(inverted) == len(tets):
        raise MeshError(
            f"all {len(tets)} tetrahedra are inverted (negative volume): swap two nodes of every tetrahedron"
        )
    if inverted.size:
        raise MeshError(
            f"{inverted.size} of {len(tets)} tetrahedra are inverted (negative volume, "
            f"index {_few(inverted)}): remesh, or put their nodes in the order of the other tetrahedra"
        )


def _check_facets(points: Array, tets: Tets) -> None:
    keys = tet_facet_keys(tets, len(points)).ravel()
    shared, counts = np.unique(keys, return_counts=True)
    if counts.max() > 2:
        owner = int(np.flatnonzero(keys == shared[counts > 2][0])[0] // 4)
        raise MeshError(
            f"{int((counts > 2).sum())} facets belong to more than two tetrahedra (the first: of "
            f"tetrahedron {owner}): tetrahedra overlap or are listed twice; delete the copies"
        )


def _check_connected(points: Array, tets: Tets, meant: int) -> None:
    labels = parts(points, tets)
    found = int(labels.max()) + 1
    if found > meant:
        sizes = np.sort(np.bincount(labels))[::-1]
        raise MeshError(
            f"it has {found} parts that share no facet, of {_few(sizes)} tetrahedra: keep one part, or join them"
        )


def _bodies_of_nodes(points: Array, tets: Tets) -> NDArray[np.integer]:
    """Return for each node the number of a body that contains it, shape `(n,)`."""
    bodies = np.zeros(len(points), dtype=np.intp)
    bodies[tets] = parts(points, tets)[:, None]
    return bodies


def _check_apart(points: Array, tets: Tets) -> None:
    """Raise `MeshError` for bodies that are joined only at a node or an edge."""
    shared = tets[_bodies_of_nodes(points, tets)[tets] != parts(points, tets)[:, None]]
    if shared.size:
        nodes = np.unique(shared)
        raise MeshError(
            f"{nodes.size} nodes belong to bodies that share no facet (index {_few(nodes)}): join the bodies, or give "
            "each body separate nodes"
        )


def parts(points: Array, tets: Tets) -> NDArray[np.integer]:
    """Return the number of the body of each tetrahedron, from 0, shape `(m,)`.

    Bodies share no facet.
    """
    return np.asarray(connected_components(_neighbours(points, tets), directed=False)[1])


def _neighbours(points: Array, tets: Tets) -> coo_array:
    """Return the adjacency of tetrahedra through a common facet, shape `(m, m)`."""
    keys = tet_facet_keys(tets, len(points)).ravel()
    order = np.argsort(keys, kind="stable")
    twins = np.flatnonzero(keys[order[:-1]] == keys[order[1:]])
    pair = order[twins] // 4, order[twins + 1] // 4
    return coo_array((np.ones(len(twins)), pair), shape=(len(tets), len(tets)))
