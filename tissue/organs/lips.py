"""Gaps between surfaces that may touch: nodes of one, the left, against facets of the other, the right, g ≥ 0.

g is the distance of the right surface from a left node along the right one's normal n, averaged over the facets around
each vertex: g = d·(Σ w_a x_a − x_left) over the nodes a of the facet that the left node faces. Which that is, and d, is
found where a step begins (`Gaps.facing`), and stays during the step. A force p on the pair acts along d, so lips that
ride over one another do work along their slope.

The lips of a wound match: at first each node faces one of its own, its pair, with P2 the middles of the edges too,
along the normal e of the wound's plane, so that no node of one lip enters the other. What slides faces what lies in
front of it along e, and d = n/(n·e), so that g and p are always those along e, and p over areas as seen along e is the
pressure. Of other surfaces (`surface_gaps`) a node faces the nearest point, and d = n. A node that both sides share has
no pair. While nothing has slid by more than SLID of a facet, the pairs are those of the reference, to the last bit.

A pair of surfaces with friction has two slips besides, how far what a node faces has moved past it along two unit
vectors across d since the step began (`Gaps.slip_sums`), and forces conjugate to them. Nothing else is remembered of
what sticks: what faces what anew is where it is.

The forces p on the pairs are those of a pressure against the P1 functions ψ of the left side's vertices: P_a = Σ
ψ_a(x_k) p_k / ∫ψ_a dA. With P1 that is force over area; with P2, whose vertices carry no force under a uniform
pressure, it gathers those of the edges.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, csr_matrix
from scipy.spatial import cKDTree

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.errors import TissueError
from tissue.organs.facing import Mask, face, facet_normals, open_sides, triangle_sizes
from tissue.organs.rim import Rim, rim_of
from tissue.supports import facets_of

SLID = 0.01  # of the smallest facet of the right side: nearer, what lies in front of a node is its pair
TURNED = 0.01  # of a unit normal: turned by less, what a node faces at finite strain lies along its first normal
CLOSED = 1e-12  # over the lips' extent: a gap this far below zero is that of a closed slit
SUNK = 0.1  # of a facet: surfaces made of facets that touch overlap by less
LIPS = ("lip_left", "lip_right")
EXACT = 9  # digits in which the sizes of facets are compared
MIDDLES = np.array([[0, 1], [1, 2], [0, 2]])  # of a facet's sides, as they come behind its corners


@dataclass(frozen=True)
class Part:
    """The pairs of two surfaces, `between` them by name.

    The vertices of the left side's `triangles` `(t, 3)` and the nodes on it that can meet, `left` `(k,)`, the right
    side's `facets` `(m, 3)`, with P2 `(m, 6)`, which turn so that their normals point away from the left one, and their
    open sides, the `ends`; `along` as in `tissue.organs.facing.face`. `start` `(k, 7)` is what each node faces in the
    reference shape, and `sunk` `(k,)` [m] how far beyond it is, which counts as touching. `hats` `(v, k)` are the P1
    functions of the left vertices at the pairs, `areas` `(v,)` [m²] their integrals. `friction` is Coulomb's
    coefficient [-].
    """

    between: tuple[str, str]
    triangles: Indices
    left: Indices
    facets: Indices
    ends: Mask
    along: Array | None
    start: Array
    sunk: Array
    hats: csr_array
    areas: Array
    friction: float = 0.0

    @property
    def name(self) -> str:
        """The names of both surfaces."""
        return " - ".join(self.between)

    @cached_property
    def pair_areas(self) -> Array:
        """The area that each pair stands for, shape `(k,)` [m²]: its shares of those of the vertices."""
        return np.asarray(self.hats.T @ (self.areas / np.asarray(self.hats.sum(axis=1)).ravel()))

    def faced(self, points: Array, turns: bool = False) -> Array:
        """Return what each left node faces with all nodes at `points` `(n, 3)` [m], shape `(k, 7)`: along `along`, or
        the nearest point where the surface `turns`."""
        return face(points[self.left], points, self.facets[:, :3], self.ends, None if turns else self.along)

    def vertex_pressure(self, p: Array) -> Array:
        """Return the pressure at the left vertices under the forces `p` `(k,)` [N], shape `(v,)` [Pa]."""
        return np.asarray((self.hats @ p) / self.areas)


@dataclass(frozen=True)
class Gaps:
    """The `k` pairs of all `parts` of a `body` in turn: g = `g0` + `G` U over its free unknowns while nothing slides.

    Made by `build_gaps` for a wound's lips, by `surface_gaps` for surfaces by name.
    """

    body: Elasticity
    parts: tuple[Part, ...]

    @cached_property
    def left(self) -> Indices:
        """Left node of each pair, shape `(k,)`."""
        return np.concatenate([part.left for part in self.parts])

    @cached_property
    def facets(self) -> Indices:
        """Nodes of all the right sides' facets, `(m, 3)` or `(m, 6)`, corners first."""
        return np.vstack([part.facets for part in self.parts])

    @cached_property
    def friction(self) -> Array:
        """Coefficient of friction of each pair, shape `(k,)` [-]."""
        return np.concatenate([np.full(len(part.left), part.friction) for part in self.parts])

    @cached_property
    def rough(self) -> Indices:
        """Pairs with friction, shape `(m,)`."""
        return np.flatnonzero(self.friction)

    @cached_property
    def start(self) -> Array:
        """The pairing of each left node in the reference shape, shape `(k, 7)`."""
        return self._stacked([part.start for part in self.parts])

    @cached_property
    def nodes(self) -> Indices:
        """Left node of each pair, and the node nearest to its facing point in the reference shape, shape `(k, 2)`."""
        nodes, weights = self.weights(self.start)
        return np.column_stack([self.left, nodes[np.arange(len(nodes)), weights.argmax(axis=1)]])

    @cached_property
    def lip_nodes(self) -> Indices:
        """All nodes of both sides, shape `(r,)`."""
        return np.union1d(self.left, self.facets)

    @cached_property
    def areas(self) -> Array:
        """Areas of the left vertices, shape `(v,)` [m²]."""
        return np.concatenate([part.areas for part in self.parts])

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Slices of the pairs of each part."""
        ends = np.cumsum([0, *(len(part.left) for part in self.parts)]).tolist()
        return tuple(slice(first, last) for first, last in pairwise(ends))

    @cached_property
    def rims(self) -> tuple[tuple[Rim, Rim], ...]:
        """Rims of the left and the right side of each part on the outer surface of the organ."""
        each = [(part.triangles, part.facets[:, :3]) for part in self.parts]
        return tuple((rim_of(self.body.mesh, *sides), rim_of(self.body.mesh, *sides[::-1])) for sides in each)

    def nearest(self, points: Array) -> tuple[Indices, Array]:
        """Return the pair of which a node is nearest to each of the `points` `(m, 3)` [m] in the reference shape, and
        how far it is [m], `(m,)` each."""
        away, node = self._tree.query(points)
        return np.asarray(node % len(self.left), dtype=np.intp), np.asarray(away)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.body.points[self.nodes.T.ravel()])

    @cached_property
    def extent(self) -> float:
        """Length of the sides [m], which is the gap of a node that faces nothing."""
        return float(np.ptp(self.body.points[self.lip_nodes], axis=0).max())

    @cached_property
    def rows(self) -> csr_matrix:
        """R, the displacement of all nodes of both sides over the free unknowns, shape `(3r, N)`."""
        return self.body.rows_of(self.lip_nodes)

    @cached_property
    def G(self) -> csr_matrix:
        """Gaps of the pairs of the reference over the free unknowns, shape `(k, N)`."""
        return csr_matrix(self.sums(self.start) @ self.rows)

    @cached_property
    def g0(self) -> Array:
        """Gaps of the reference shape, shape `(k,)` [m]."""
        return self.rest(self.start)

    def pressure(self, p: Array) -> Array:
        """Return the pressure at the pairs under the forces `p` `(k,)` [N], shape `(k,)` [Pa]."""
        own = zip(self.parts, self.slices, strict=True)
        return np.concatenate([part.hats.T @ part.vertex_pressure(p[pairs]) for part, pairs in own])

    def slides(self, displacement: Array) -> Array:
        """Return the sliding distance of each pair along the surface since the reference, shape `(k,)` [m], from the
        `displacement` of all nodes `(n, 3)` [m]."""
        nodes, weights = self.weights(self.start)
        past = np.sum(weights[..., None] * displacement[nodes], axis=1) - displacement[self.left]
        d = self.start[:, 4:]
        tangential = past - (np.vecdot(past, d) / np.vecdot(d, d))[:, None] * d
        return np.asarray(np.linalg.norm(tangential, axis=1) * (self.start[:, 0] >= 0.0))

    def facing(self, points: Array, displacement: Array, turns: bool = False) -> Array | None:
        """Return the pairing of each left node, shape `(k, 7)`: facet (−1: none), barycentric coordinates in it, and d.
        None if no pair has slid, so that the reference pairing is valid.

        `points` `(n, 3)` [m] are all nodes of the reference, `displacement` as for `slides`. Surfaces that turn, each
        of which faces the nearest point, have none of the reference where a normal has turned by more than TURNED.
        """
        sizes, faced = triangle_sizes(points[self.facets[:, :3]]), self.start[:, 0] >= 0.0
        still = faced.all() and self.slides(displacement).max(initial=0.0) <= SLID * sizes.min()
        if still and not (turns and self._turn(points, displacement) > TURNED):
            return None
        return self._stacked([part.faced(points + displacement, turns) for part in self.parts])

    def _turn(self, points: Array, displacement: Array) -> float:
        """Return how far a facet's normal has turned at most, as the distance of the unit normals [-]."""
        before, now = (facet_normals(x[self.facets[:, :3]]) for x in (points, points + displacement))
        return float(np.linalg.norm(now - before, axis=1).max(initial=0.0))

    def crossed(self, U: Array) -> float:
        """Return the largest overlap of nodes under a displacement of all unknowns (N,) [m], over the extent of the
        surfaces [-]."""
        gaps = self.apart(self.body.nodal(U), turns=True)
        return max(0.0, -float(gaps.min(initial=0.0))) / self.extent

    def apart(self, displacement: Array, turns: bool = False) -> Array:
        """Return the gaps of the pairs under a `displacement` of all nodes `(n, 3)` [m], shape `(k,)` [m], along
        `along`, or to the nearest point if surfaces turn."""
        facing = self.facing(self.body.points, displacement, turns)
        at = self.start if facing is None else facing
        return np.asarray(self.rest(at) + self.sums(at) @ displacement[self.lip_nodes].ravel())

    def weights(self, facing: Array) -> tuple[Indices, Array]:
        """Return the nodes that make the point each left node faces, and their weights, shape `(k, 3)`, with P2
        `(k, 6)`; weights of zero where it faces none."""
        return weights_on(self.facets, facing)

    def sums(self, facing: Array) -> csr_matrix:
        """Return S, the gaps by the displacement of all nodes of both sides, shape `(k, 3r)`."""
        return self._sums(self.left, facing, facing[:, 4:])

    def slip_sums(self, facing: Array) -> csr_matrix:
        """Return the slips of the rough pairs by the displacement of all nodes of both sides, along both of `tangents`
        of each pair in turn, shape `(2m, 3r)`."""
        twice = np.repeat(self.rough, 2)
        return self._sums(self.left[twice], facing[twice], tangents(facing[self.rough, 4:]).reshape(-1, 3))

    def _sums(self, left: Indices, facing: Array, along: Array) -> csr_matrix:
        """Return how far what nodes `left` `(j,)` face moves past them `along` `(j, 3)` by the displacement of all
        nodes of both sides, shape `(j, 3r)`."""
        right, weights = self.weights(facing)
        nodes, w = np.hstack([right, left[:, None]]), np.hstack([weights, -weights.sum(axis=1, keepdims=True)])
        columns = 3 * np.searchsorted(self.lip_nodes, nodes)[..., None] + np.arange(3)
        values, at = w[..., None] * along[:, None], np.repeat(np.arange(len(nodes)), columns[0].size)
        S = csr_matrix((values.ravel(), (at, columns.ravel())), (len(nodes), 3 * len(self.lip_nodes)))
        S.eliminate_zeros()
        return S

    def rest(self, facing: Array) -> Array:
        """Return the gaps of the pairs in the reference shape, shape `(k,)` [m]."""
        gaps = self.sums(facing) @ self.body.points[self.lip_nodes].ravel()
        sunk = np.concatenate([part.sunk for part in self.parts])
        return np.where(facing[:, 0] < 0.0, self.extent, gaps + sunk)

    def _stacked(self, each: Sequence[Array]) -> Array:
        """Return what the nodes of all parts face, with their facets numbered among all."""
        first = np.cumsum([0, *(len(part.facets) for part in self.parts)])[: len(each)]
        counts = np.repeat(first, [len(facing) for facing in each])
        facing = np.vstack(each)
        return np.column_stack([np.where(facing[:, 0] < 0.0, -1.0, facing[:, 0] + counts), facing[:, 1:]])


def build_gaps(body: Elasticity, vertices: ArrayLike, facets: ArrayLike, normal: ArrayLike) -> Gaps:
    """Return the gaps between the left lip, whose `facets` `(m,)` are numbered as in the mesh, and the right one.

    `vertices` `(v, 2)`: each vertex of the left lip and its partner, itself where the lips meet. `normal` (3,)
    points from the left lip to the right one. Raises `TissueError` if the lips cross, or no pair can move.
    """
    n, pairs = _unit(normal), np.asarray(vertices, dtype=np.intp)
    partner = np.arange(body.mesh.nvertices)
    partner[pairs[:, 0]] = pairs[:, 1]
    triangles = body.mesh.facets[:, np.asarray(facets)].T.astype(np.intp)
    right = body.facet_nodes(with_normals_along(body.points, partner[triangles], np.broadcast_to(n, triangles.shape)))
    nodes, corners = _paired(body, triangles, partner)
    start = _at_partners(right, nodes[:, 1], n)
    part, sunk = _part(body, LIPS, (triangles, nodes[:, 0], corners), right, n, start)
    if sunk.max() > CLOSED * np.ptp(body.points[nodes[:, 0]], axis=0).max():
        raise TissueError(f"the lips overlap by {sunk.max():.3g} m before they are loaded; the normal may be reversed")
    return Gaps(body, (part,))


def tangents(normals: Array) -> Array:
    """Return two unit vectors across each of the `normals` `(m, 3)`, and across one another, shape `(m, 2, 3)`: the
    first lies nearest to the axis that is most across the normal, so that a roller along an axis holds one alone."""
    n = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    first = np.eye(3)[np.abs(n).argmin(axis=1)]
    first = first - np.vecdot(first, n)[:, None] * n
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(n, first)], axis=1)


def surface_gaps(body: Elasticity, between: Sequence[tuple[str, str]], friction: Sequence[float] = ()) -> Gaps:
    """Return the gaps between pairs of boundaries of the mesh by name, with a coefficient of `friction` for each pair,
    0 by default.

    The left of two is that with the smaller facets, or the only one that is not held: nodes that are farther apart than
    those they press on leave some of these without a force. Raises `TissueError` if they overlap by more than SUNK
    of a facet, or nothing of them can move.
    """
    parts = [_between(body, names) for names in between]
    coefficients = [*friction, *[0.0] * (len(parts) - len(friction))]
    return Gaps(body, tuple(replace(part, friction=mu) for part, mu in zip(parts, coefficients, strict=True)))


def _between(body: Elasticity, between: tuple[str, str]) -> Part:
    """Return the pairs of two boundaries by name."""
    sides = [facets_of(body.mesh, "contact", name) for name in between]
    for name, facets in zip(between, sides, strict=True):
        if (body.mesh.f2t[1, facets] >= 0).any():
            raise TissueError(f"contact: the boundary {name!r} has facets inside the organ; name one on its surface")
    first, second = sorted(sides, key=lambda facets: _rank(body, facets))
    triangles, right = (body.mesh.facets[:, facets].T.astype(np.intp) for facets in (first, second))
    behind = body.points[body.mesh.t[:, body.mesh.f2t[0, second]].T].mean(axis=1)
    right = body.facet_nodes(with_normals_along(body.points, right, behind - body.points[right].mean(axis=1)))
    nodes, corners = _paired(body, triangles, np.arange(body.mesh.nvertices))
    start = face(body.points[nodes[:, 0]], body.points, right[:, :3], open_sides(right[:, :3]), None)
    part, sunk = _part(body, between, (triangles, nodes[:, 0], corners), right, None, start)
    size = float(triangle_sizes(body.points[right[:, :3]]).mean())
    if sunk.max() > SUNK * size:
        raise TissueError(
            f"contact between {between[0]!r} and {between[1]!r}: they overlap by {sunk.max():.3g} m before they are "
            f"loaded, which is more than {SUNK:g} of a facet of {size:.3g} m; move them apart, or name those that meet"
        )
    return part


def _rank(body: Elasticity, facets: Indices) -> tuple[bool, float]:
    """Return whether a surface is held, and the mean size of its facets [m]: the lower is on the left."""
    corners = body.mesh.facets[:, facets].T
    size = float(triangle_sizes(body.points[corners]).mean())
    return not _movable(body)[corners].any(), round(size, EXACT - math.floor(math.log10(size)))


def _part(
    body: Elasticity,
    between: tuple[str, str],
    side: tuple[Indices, Indices, Indices],
    right: Indices,
    along: Array | None,
    start: Array,
) -> tuple[Part, Array]:
    """Return the pairs that can move, and how far each overlaps at first [m].

    The left `side` is its triangles, its nodes, and the two vertices whose middle each is.
    """
    triangles, left, corners = side
    nodes, weights = weights_on(right, start)
    free = _movable(body)
    kept = ~np.isin(left, right) & (free[left] | (free[nodes] & (weights != 0.0)).any(axis=1))
    if not kept.any():
        names = " and ".join(map(repr, between))
        raise TissueError(
            f"contact between {names}: the lips have no pair of nodes that can move; take a finer mesh, or leave out "
            "contact"
        )
    across = np.sum(weights[..., None] * body.points[nodes], axis=1) - body.points[left]
    gap = np.where(start[:, 0] < 0.0, 0.0, np.vecdot(across, start[:, 4:]))[kept]
    hats, areas = _hats(body, triangles, corners[kept], along)
    sunk = np.maximum(-gap, 0.0)
    ends = open_sides(right[:, :3])
    return Part(between, triangles, left[kept], right, ends, along, start[kept], sunk, hats, areas), sunk


def weights_on(facets: Indices, facing: Array) -> tuple[Indices, Array]:
    """Return the nodes of `facets` that make the points faced, and their weights, as `Gaps.weights`."""
    nodes = facets[np.maximum(facing[:, 0], 0.0).astype(np.intp)]
    w = facing[:, 1:4]
    if facets.shape[1] > 3:
        w = np.hstack([w * (2.0 * w - 1.0), 4.0 * w[:, MIDDLES[:, 0]] * w[:, MIDDLES[:, 1]]])
    return nodes, w * (facing[:, :1] >= 0.0)


def _movable(body: Elasticity) -> Mask:
    """Return which nodes are not held in all directions, shape `(n,)`."""
    return np.asarray(np.isin(body.nodes, body.free).any(axis=1))


def with_normals_along(points: Array, triangles: Indices, towards: Array) -> Indices:
    """Return triangles `(m, 3)` that turn so that their normals point as `towards` `(m, 3)` does."""
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    away = np.vecdot(np.cross(b - a, c - a), towards) < 0.0
    return np.where(away[:, None], triangles[:, [0, 2, 1]], triangles)


def _at_partners(facets: Indices, nodes: Indices, n: Array) -> Array:
    """Return what is faced by who faces the `nodes` `(k,)` of `facets` along `n`, shape `(k, 7)`."""
    corners = np.vstack([np.eye(3), np.eye(3)[MIDDLES].mean(axis=1)])[: facets.shape[1]]
    order = np.argsort(facets, axis=None, kind="stable")
    facet, place = np.divmod(order[np.searchsorted(facets.ravel(), nodes, sorter=order)], facets.shape[1])
    return np.column_stack([facet, corners[place], np.broadcast_to(n, (len(nodes), 3))])


def _unit(normal: ArrayLike) -> Array:
    n = np.asarray(normal, dtype=float)
    if n.shape != (3,) or not np.all(np.isfinite(n)) or not n.any():
        raise TissueError(f"normal = {normal!r} of the lips: allowed is a vector other than zero")
    return n / np.linalg.norm(n)


def _paired(body: Elasticity, triangles: Indices, partner: Indices) -> tuple[Indices, Indices]:
    """Return the left and right node of every pair, `(k, 2)`, and the two vertices whose middle the left node is.

    A vertex is given as itself twice.
    """
    left = np.unique(triangles)
    ends = np.column_stack([left, left])
    nodes = np.column_stack([left, partner[left]])
    if body.element == "P1":
        return nodes, ends
    edges = np.unique(np.sort(triangles[:, MIDDLES].reshape(-1, 2), axis=1), axis=0)
    middles = body.mesh.nvertices + np.column_stack([body.edge_numbers(edges), body.edge_numbers(partner[edges])])
    return np.vstack([nodes, middles]), np.vstack([ends, edges])


def _hats(body: Elasticity, triangles: Indices, corners: Indices, n: Array | None) -> tuple[csr_array, Array]:
    """Return ψ_a of the left lip's vertices at the pairs, and ∫ψ_a dA, as seen along n where that is given.

    Vertices of no pair are left out.
    """
    vertices = np.unique(corners)
    k, v = len(corners), len(vertices)
    place = np.searchsorted(vertices, corners)
    hats = csr_array((np.full(2 * k, 0.5), (place.ravel(), np.repeat(np.arange(k), 2))), shape=(v, k))
    a, b, c = (body.mesh.p.T[triangles[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    thirds = (np.linalg.norm(normals, axis=1) if n is None else np.abs(normals @ n)) / 6.0
    areas = np.bincount(triangles.ravel(), np.repeat(thirds, 3), body.mesh.nvertices)[vertices]
    return hats, np.maximum(areas, np.finfo(float).tiny)
