"""Gaps g ≥ 0 between surfaces that can touch: nodes of the left one and facets of the right one.

g is the distance of the right surface from a left node. It is measured along the right surface's
normal n, averaged over the facets around each vertex: g = d·(Σ w_a x_a − x_left) over the nodes a
of the facet that the left node faces. This facet and d are determined at the start of a step
(`Gaps.facing`) and are constant during the step. A force p on the pair acts along d, so that lips
that slide over one another do work along their slope.

The lips of a wound match. In the reference each node faces its partner, a node of the other lip,
along the normal e of the wound's plane. With P2 this also holds for the middles of the edges. No
node of one lip then penetrates the other. After sliding, a node faces the point in front of it
along e, and d = n/(n·e). g and p are therefore always measured along e, and the pressure is p
divided by the area projected along e.

For other surfaces (`surface_gaps`) a node faces the nearest point, and d = n. A node that belongs
to both sides has no pair. While no pair has slid by more than SLID of a facet, the pairs are
exactly those of the reference.

A pair with friction also has two slips: the displacements of the faced point relative to the node
along the two vectors of `Gaps.tangents` since the start of the step (`Gaps.slip_sums`). Two forces
are conjugate to the slips. A sticking pair has no other memory: a newly faced point starts with zero
slip.

The pressure follows from the forces p by the P1 functions ψ of the left side's vertices: P_a =
Σ ψ_a(x_k) p_k / ∫ψ_a dA. With P1 this is force over area. With P2 the vertices carry no force under
a uniform pressure, and P_a collects the forces of the edges.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, csr_matrix
from scipy.spatial import cKDTree

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity, with_normals_along
from tissue.errors import TissueError
from tissue.organs.facing import Mask, face, facet_normals, open_sides, triangle_sizes
from tissue.organs.rim import Rim, rim_of
from tissue.supports import outer_facets_of

SLID = 0.01  # of the right side's smallest facet: after less sliding, the reference pairs are used
TURNED = 0.01  # of a unit normal: after a smaller turn at finite strain, reference pairs are used
CLOSED = 1e-12  # of the lips' extent: a smaller overlap is round-off of a closed slit
SUNK = 0.1  # of a facet: largest initial overlap; touching surfaces of flat facets overlap by less
LIPS = ("lip_left", "lip_right")
ON_EDGE = 0.05  # weight of a node: with less, a point next to an edge of its facet counts as on the edge
FAINT = 1e-30  # of a component of d: decides only if there is no other
EXACT = 9  # digits for the comparison of facet sizes
MIDDLES = np.array([[0, 1], [1, 2], [0, 2]])  # of a facet's sides, in the order after its corners


@dataclass(frozen=True)
class Part:
    """The pairs of two surfaces.

    - `between`: the names of the surfaces.
    - `triangles` `(t, 3)`: the vertices of the left side.
    - `left` `(k,)`: the nodes of the left side that can meet the right side.
    - `facets` `(m, 3)`, with P2 `(m, 6)`: the nodes of the right side's facets, with normals that
      point away from the left side.
    - `ends`: the open sides of these facets.
    - `along`: as in `tissue.organs.facing.face`.
    - `start` `(k, 7)`: the facing of each left node in the reference shape.
    - `sunk` `(k,)` [m]: the initial overlap, which counts as touching.
    - `hats` `(v, k)`: the P1 functions of the left vertices at the pairs.
    - `areas` `(v,)` [m²]: the integrals of these functions.
    - `friction`: Coulomb's coefficient [-].
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
        """The area of each pair, shape `(k,)` [m²].

        It is the sum of the pair's shares of the areas of the vertices.
        """
        return np.asarray(self.hats.T @ (self.areas / np.asarray(self.hats.sum(axis=1)).ravel()))

    def faced(self, points: Array, turns: bool = False) -> Array:
        """Return the facing of each left node, shape `(k, 7)`.

        All nodes are at `points` `(n, 3)` [m]. A node faces the point in the direction `along`, or
        the nearest point if the surface `turns`.
        """
        return face(points[self.left], points, self.facets[:, :3], self.ends, None if turns else self.along)

    def vertex_pressure(self, p: Array) -> Array:
        """Return the pressure at the left vertices, `(v,)` [Pa], under forces `p` `(k,)` [N]."""
        return np.asarray((self.hats @ p) / self.areas)


@dataclass(frozen=True)
class Gaps:
    """The k pairs of all `parts` of a `body`, part by part.

    While no pair slides, g = `g0` + `G` U over the free unknowns of the body. `build_gaps` makes
    the gaps of a wound's lips, and `surface_gaps` those of named surfaces.
    """

    body: Elasticity
    parts: tuple[Part, ...]

    @cached_property
    def left(self) -> Indices:
        """Left node of each pair, shape `(k,)`."""
        return np.concatenate([part.left for part in self.parts])

    @cached_property
    def facets(self) -> Indices:
        """Nodes of the facets of all right sides, `(m, 3)` or `(m, 6)`, corners first."""
        return np.vstack([part.facets for part in self.parts])

    @cached_property
    def friction(self) -> Array:
        """Coefficient of friction of each pair, shape `(k,)` [-]."""
        return np.concatenate([np.full(len(part.left), part.friction) for part in self.parts])

    @cached_property
    def rough(self) -> Indices:
        """Numbers of the pairs with friction, shape `(m,)`."""
        return np.flatnonzero(self.friction)

    @cached_property
    def start(self) -> Array:
        """The facing of each left node in the reference shape, shape `(k, 7)`."""
        return self._stacked([part.start for part in self.parts])

    @cached_property
    def nodes(self) -> Indices:
        """Left and right node of each pair in the reference shape, shape `(k, 2)`.

        The right node is the one nearest to the faced point.
        """
        nodes, weights = self.weights(self.start)
        return np.column_stack([self.left, nodes[np.arange(len(nodes)), weights.argmax(axis=1)]])

    @cached_property
    def lip_nodes(self) -> Indices:
        """All nodes of both sides, shape `(r,)`."""
        return np.union1d(self.left, self.facets)

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
        """Return the pair nearest to each of the `points` `(m, 3)` [m], and its distance [m].

        Both have shape `(m,)`. The distance is that to the nearest node of the pair in the
        reference shape.
        """
        away, node = self._tree.query(points)
        return np.asarray(node % len(self.left), dtype=np.intp), np.asarray(away)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.body.points[self.nodes.T.ravel()])

    @cached_property
    def extent(self) -> float:
        """Length of the sides [m]; it is used as the gap of a node that faces no facet."""
        return float(np.ptp(self.body.points[self.lip_nodes], axis=0).max())

    @cached_property
    def rows(self) -> csr_matrix:
        """R, the displacement over the free unknowns of both sides' nodes, shape `(3r, N)`."""
        return self.body.rows_of(self.lip_nodes)

    @cached_property
    def g0(self) -> Array:
        """Gaps of the reference shape, shape `(k,)` [m]."""
        return self.rest(self.start)

    def pressure(self, p: Array) -> Array:
        """Return the pressure at the pairs under the forces `p` `(k,)` [N], shape `(k,)` [Pa]."""
        own = zip(self.parts, self.slices, strict=True)
        return np.concatenate([part.hats.T @ part.vertex_pressure(p[pairs]) for part, pairs in own])

    def slides(self, displacement: Array) -> Array:
        """Return the sliding distance of each pair along the surface, shape `(k,)` [m].

        The distance is that since the reference. `displacement` `(n, 3)` [m] is the displacement of
        all nodes.
        """
        nodes, weights = self.weights(self.start)
        past = np.sum(weights[..., None] * displacement[nodes], axis=1) - displacement[self.left]
        d = self.start[:, 4:]
        tangential = past - (np.vecdot(past, d) / np.vecdot(d, d))[:, None] * d
        return np.asarray(np.linalg.norm(tangential, axis=1) * (self.start[:, 0] >= 0.0))

    def facing(self, points: Array, displacement: Array, turns: bool = False) -> Array | None:
        """Return the facing of each left node, shape `(k, 7)`; None if no pair has slid.

        The columns are the facet, the barycentric coordinates in it, and d. The facet is −1 if the
        node faces no facet. If no pair has slid, the pairing of the reference is valid.

        `points` `(n, 3)` [m] are all nodes of the reference, and `displacement` is as for `slides`.
        If a surface `turns`, each node faces the nearest point. The pairing of the reference is
        then also invalid after a normal has turned by more than TURNED.
        """
        sizes, faced = triangle_sizes(points[self.facets[:, :3]]), self.start[:, 0] >= 0.0
        still = faced.all() and self.slides(displacement).max(initial=0.0) <= SLID * sizes.min()
        if still and not (turns and self._turn(points, displacement) > TURNED):
            return None
        return self._stacked([part.faced(points + displacement, turns) for part in self.parts])

    def _turn(self, points: Array, displacement: Array) -> float:
        """Return the largest turn of a facet's normal, as distance of the unit normals [-]."""
        before, now = (facet_normals(x[self.facets[:, :3]]) for x in (points, points + displacement))
        return float(np.linalg.norm(now - before, axis=1).max(initial=0.0))

    def crossed(self, U: Array) -> float:
        """Return the largest overlap of the surfaces, relative to their extent [-].

        `U` (N,) [m] is the displacement of all unknowns.
        """
        gaps = self.apart(self.body.nodal(U), turns=True)
        return max(0.0, -float(gaps.min(initial=0.0))) / self.extent

    def apart(self, displacement: Array, turns: bool = False) -> Array:
        """Return the gaps of the pairs under a displacement, shape `(k,)` [m].

        `displacement` `(n, 3)` [m] is that of all nodes. The gaps are measured in the direction
        `along` of each part, or to the nearest point if a surface `turns`.
        """
        facing = self.facing(self.body.points, displacement, turns)
        at = self.start if facing is None else facing
        return np.asarray(self.rest(at) + self.sums(at) @ displacement[self.lip_nodes].ravel())

    def weights(self, facing: Array) -> tuple[Indices, Array]:
        """Return the nodes and weights of the points that left nodes face, shape `(k, 3)` each.

        With P2 the shape is `(k, 6)`. The weights are zero if a node faces no facet.
        """
        return weights_on(self.facets, facing)

    def sums(self, facing: Array) -> csr_matrix:
        """Return the matrix S from the displacement of all nodes of both sides to the gaps.

        Its shape is `(k, 3r)`.
        """
        return self._sums(self.left, facing, facing[:, 4:])

    def slip_sums(self, facing: Array) -> csr_matrix:
        """Return the matrix from the displacement of all nodes of both sides to the slips.

        Its shape is `(2m, 3r)`. Each pair with friction has two slips, along its two `tangents`.
        """
        twice = np.repeat(self.rough, 2)
        return self._sums(self.left[twice], facing[twice], self.tangents(facing).reshape(-1, 3))

    def tangents(self, facing: Array) -> Array:
        """Return the two vectors along which each pair with friction slips, shape `(m, 2, 3)`.

        They have no component along an axis in which rollers hold both sides, and are normal to d
        without this component. Gap and slips would otherwise depend on one another, and their
        forces would not be unique.
        """
        nodes, weights = self.weights(facing[self.rough])
        moves, d = ~self.body.held, facing[self.rough, 4:]
        right = np.any(moves[nodes] & (np.abs(weights) > ON_EDGE)[..., None], axis=1)
        free = np.asarray(moves[self.left[self.rough]] | right)
        return tangents(np.where(free, d, FAINT * d)) * free[:, None]

    def _sums(self, left: Indices, facing: Array, along: Array) -> csr_matrix:
        """Return the matrix from the displacement of all nodes to the relative one of pairs.

        Its shape is `(j, 3r)`. The relative displacement is that of the faced points minus that of
        the nodes `left` `(j,)`, in the directions `along` `(j, 3)`.
        """
        right, weights = self.weights(facing)
        nodes, w = np.hstack([right, left[:, None]]), np.hstack([weights, -weights.sum(axis=1, keepdims=True)])
        return sums_of(self.lip_nodes, nodes, w, along)

    def rest(self, facing: Array) -> Array:
        """Return the gaps of the pairs in the reference shape, shape `(k,)` [m]."""
        gaps = self.sums(facing) @ self.body.points[self.lip_nodes].ravel()
        sunk = np.concatenate([part.sunk for part in self.parts])
        return np.where(facing[:, 0] < 0.0, self.extent, gaps + sunk)

    def _stacked(self, each: Sequence[Array]) -> Array:
        """Return the facings of the nodes of all parts, with facets numbered over all parts."""
        first = np.cumsum([0, *(len(part.facets) for part in self.parts)])[: len(each)]
        counts = np.repeat(first, [len(facing) for facing in each])
        facing = np.vstack(each)
        return np.column_stack([np.where(facing[:, 0] < 0.0, -1.0, facing[:, 0] + counts), facing[:, 1:]])


def build_gaps(body: Elasticity, vertices: ArrayLike, facets: ArrayLike, normal: ArrayLike) -> Gaps:
    """Return the gaps between the left and the right lip of a wound.

    `facets` `(m,)` are the numbers in the mesh of the left lip's facets. `vertices` `(v, 2)` are
    each vertex of the left lip and its partner; a vertex common to both lips is its own partner.
    `normal` (3,) points from the left lip to the right one. Raises `TissueError` if the lips
    overlap, or if no pair can move.
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
        raise TissueError(f"tissue.contact: lips overlap by {sunk.max():.3g} m unloaded; the normal may be reversed")
    return Gaps(body, (part,))


def tangents(normals: Array) -> Array:
    """Return two perpendicular unit vectors normal to each of the `normals`, shape `(m, 2, 3)`.

    `normals` has shape `(m, 3)`. The first vector is nearest to the axis that is closest to
    perpendicular to the normal. A roller along an axis then holds only one of the vectors.
    """
    n = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    first = np.eye(3)[np.abs(n).argmin(axis=1)]
    first = first - np.vecdot(first, n)[:, None] * n
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(n, first)], axis=1)


def surface_gaps(body: Elasticity, between: Sequence[tuple[str, str]]) -> Gaps:
    """Return the gaps without friction between pairs of named boundaries of the mesh.

    The left one of two boundaries is the boundary with the smaller facets, or the only one that is
    not held. With larger facets on the left, some nodes on the right would get no force. Raises
    `TissueError` if two boundaries overlap by more than SUNK of a facet, or if no pair can move.
    """
    return Gaps(body, tuple(_between(body, names) for names in between))


def _between(body: Elasticity, between: tuple[str, str]) -> Part:
    """Return the pairs of two named boundaries."""
    sides = [outer_facets_of(body.mesh, "contact", name) for name in between]
    first, second = sorted(sides, key=lambda facets: _rank(body, facets))
    triangles = body.mesh.facets[:, first].T.astype(np.intp)
    right = body.surface_nodes(second, inwards=True)
    nodes, corners = _paired(body, triangles, np.arange(body.mesh.nvertices))
    start = face(body.points[nodes[:, 0]], body.points, right[:, :3], open_sides(right[:, :3]), None)
    part, sunk = _part(body, between, (triangles, nodes[:, 0], corners), right, None, start)
    size = float(triangle_sizes(body.points[right[:, :3]]).mean())
    if sunk.max() > SUNK * size:
        raise TissueError(
            f"contact.between = {list(between)}: the surfaces overlap by {sunk.max():.3g} m before they are "
            f"loaded, which is more than {SUNK:g} of a facet of {size:.3g} m; move them apart, or name other boundaries"
        )
    return part


def _rank(body: Elasticity, facets: Indices) -> tuple[bool, float]:
    """Return the rank of a surface: whether it is held, and the mean size of its facets [m].

    The surface with the lower rank is on the left.
    """
    corners = body.mesh.facets[:, facets].T
    size = float(triangle_sizes(body.points[corners]).mean())
    return bool(body.held[corners].all()), round(size, EXACT - math.floor(math.log10(size)))


def _part(
    body: Elasticity,
    between: tuple[str, str],
    side: tuple[Indices, Indices, Indices],
    right: Indices,
    along: Array | None,
    start: Array,
) -> tuple[Part, Array]:
    """Return the pairs that can move, and their initial overlaps [m].

    `side` are the triangles of the left side, its nodes, and two vertices for each node, which lies
    in their middle.
    """
    triangles, left, corners = side
    nodes, weights = weights_on(right, start)
    free = np.asarray(~body.held.all(axis=1))
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


def sums_of(known: Indices, nodes: Indices, weights: Array, along: Array) -> csr_matrix:
    """Return the matrix from the displacement of `known` nodes `(r,)` to weighted sums of it.

    Its shape is `(j, 3r)`. Each sum is over `nodes` `(j, i)` with `weights` `(j, i)`, of the
    displacement in the direction `along` `(j, 3)`.
    """
    columns = 3 * np.searchsorted(known, nodes)[..., None] + np.arange(3)
    values, at = weights[..., None] * along[:, None], np.repeat(np.arange(len(nodes)), 3 * nodes.shape[1])
    S = csr_matrix((values.ravel(), (at, columns.ravel())), (len(nodes), 3 * len(known)))
    S.eliminate_zeros()
    return S


def weights_on(facets: Indices, facing: Array) -> tuple[Indices, Array]:
    """Return the nodes and weights of faced points on `facets`, as `Gaps.weights` does."""
    nodes = facets[np.maximum(facing[:, 0], 0.0).astype(np.intp)]
    w = facing[:, 1:4]
    if facets.shape[1] > 3:
        w = np.hstack([w * (2.0 * w - 1.0), 4.0 * w[:, MIDDLES[:, 0]] * w[:, MIDDLES[:, 1]]])
    return nodes, w * (facing[:, :1] >= 0.0)


def _at_partners(facets: Indices, nodes: Indices, n: Array) -> Array:
    """Return the facing of points that face `nodes` `(k,)` of `facets` along `n`, `(k, 7)`."""
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
    """Return the left and right node of every pair, and two vertices, `(k, 2)` each.

    The left node lies in the middle of the two vertices. If the node is a vertex, both of them are
    that vertex.
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
    """Return ψ_a of the left side's vertices at the pairs, and ∫ψ_a dA, `(v, k)` and `(v,)` [m²].

    The area is projected along `n`; it is the true area if `n` is None. Vertices without a pair are
    left out.
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
