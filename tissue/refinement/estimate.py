"""Estimate of the error of each hole's compliance, cell by cell.

The estimate uses the columns K⁻¹Yᵀ of the condensation. The compliance is C = Y K⁻¹ Yᵀ. By Galerkin
orthogonality, C_kk − C_kk,h is the energy of the error of column k. An estimate of this energy is
therefore an estimate of the error of the compliance (Becker and Rannacher, Acta Numerica 10, 2001).
The exact stress is replaced by the stress of the column, averaged at the nodes. At the surface,
this averaged stress is changed so that it balances the traction (Zienkiewicz and Zhu, Int. J.
Numer. Meth. Eng. 24, 1987):

    η_T² = ∫_T (σ* − σ_h) : D⁻¹ (σ* − σ_h) dx,      C_kk − C_kk,h ≈ Σ_T η_T².

σ* has the order of the element. It is averaged only within one material, because stress jumps
between two materials. A pressure that is averaged at the vertices (`tissue.elasticity`) is the same
in σ* and in σ_h, and is left out of both. With averages Galerkin orthogonality holds only nearly.

At the edges of a clamp the stress is singular, and σ* misses most of the error. η_T² of the cells
with a held node is therefore multiplied by SINGULAR.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from tissue.arrays import Array, Indices
from tissue.assembly import reference_means
from tissue.elasticity import Elasticity, cellwise_lambda
from tissue.shapes import shapes
from tissue.sites.footprint import density
from tissue.sites.site import Site, Sites
from tissue.sites.surface import outer_surface
from tissue.solvers.choice import solver_of_columns
from tissue.supports import holds_still

CELLS = 4096  # processed together: about ten megabytes per column
TOGETHER = 4  # goals whose columns are solved and stored together
OWN = 4.0  # radii of a goal: within this distance every cell is used for its column
THEIRS, NEARER = 8.0, 0.5  # radii of another goal, and ratio of distances: cells within both are fine due to that goal
SMOOTH = np.cos(np.radians(30.0))  # least cosine between normals of facet and node; below it the node is on an edge
AXES = 3
# Times η² of a cell at a clamp, as measured on sheets in bending (ν = 0.3 to 0.49, cells of 0.4 to 2.5 heights).
SINGULAR = 4.0
SOFT = 1.0  # of E/ρL²: springs that hold a free body; they are as soft as the body itself


@dataclass(frozen=True)
class Estimate:
    """The compliance of goals and its estimated error.

    The `goals` `(g,)` are the sites with a footprint. Their `compliance` along x, y and z and its
    estimated error `missed` have shape `(g, 3)` each [m/N]. The `indicators` `(c,)` [-] are the
    errors from each cell, divided by the compliance of the goal and direction and summed over all
    goals and directions.
    """

    goals: Indices
    compliance: Array
    missed: Array
    indicators: Array

    @cached_property
    def errors(self) -> Array:
        """Largest relative error of the compliance of each goal over the directions, `(g,)` [-]."""
        return np.asarray(np.max(self.missed / (self.compliance + self.missed), axis=1))


def estimate(body: Elasticity, sites: Sequence[Site], placed: Sites) -> Estimate:
    """Return the estimated errors of the compliance of sites to forces.

    A bare point is no goal, because its compliance has no limit under refinement.

    The error of a goal's column is computed in all cells except the fine cells at other, distant
    goals. The cost of a goal then does not grow with the number of goals.
    """
    goals = np.array([k for k, site in enumerate(sites) if site.radius > 0.0], np.intp)
    compliance, missed = np.empty((2, goals.size, AXES))
    indicators, recovery = np.zeros(body.mesh.nelements), Recovery(body)
    factor = solver_of_columns(held(body), body.places)
    at_clamp = np.where(np.any(np.all(body.held, axis=1)[body.cells], axis=1), SINGULAR, 1.0)
    seen = seen_cells(body, [sites[goal].radius for goal in goals], placed.points[goals])
    for first in range(0, goals.size, TOGETHER):
        some = np.arange(first, min(first + TOGETHER, goals.size))
        rows = csr_matrix(placed.Y[(9 * goals[some, None] + np.arange(AXES)).ravel()])
        W = np.zeros((body.N, rows.shape[0]))
        W[body.free] = factor.solve(rows.T.toarray())
        compliance[some] = np.reshape(np.sum(rows.multiply((W[body.free]).T), axis=1), (-1, AXES))
        for column, row in enumerate(some.tolist()):
            own = W[:, AXES * column : AXES * column + AXES]
            cells = seen(row)
            each = recovery.missed(own, tractions(body, recovery, sites, placed, int(goals[row])), cells)
            each *= at_clamp[cells]
            missed[row] = each.sum(axis=1)
            indicators[cells] += np.sum(each / compliance[row, :, None], axis=0)
    return Estimate(goals, compliance, missed, indicators)


def seen_cells(body: Elasticity, radii: Sequence[float], centres: Array) -> Callable[[int], Indices]:
    """Return a function that returns the cells in which the error of a goal's column is computed.

    Goals have footprints of `radii` (g,) [m] at `centres` `(g, 3)` [m]. Cells that are fine because
    of another, much nearer goal are left out.
    """
    middles = body.mesh.p[:, body.mesh.t].mean(axis=1).T
    nearest, reach = np.full(len(middles), np.inf), np.zeros(len(middles))
    for centre, radius in zip(centres, radii, strict=True):
        away = np.linalg.norm(middles - centre, axis=1)
        nearer = away < nearest
        nearest[nearer], reach[nearer] = away[nearer], THEIRS * radius

    def seen(goal: int) -> Indices:
        away = np.linalg.norm(middles - centres[goal], axis=1)
        others = (away > OWN * radii[goal]) & (nearest < NEARER * away) & (nearest < reach)
        return np.flatnonzero(~others)

    return seen


def held(body: Elasticity) -> csr_matrix:
    """Return the stiffness over the free unknowns.

    If a part of the body can move freely, soft springs are added everywhere.
    """
    if is_held(body):
        return body.free_stiffness
    span = float(np.linalg.norm(np.ptp(body.points, axis=0)))
    firm = SOFT * np.max(body.material.youngs_modulus / body.material.density) / span**2
    return csr_matrix(body.free_stiffness + firm * body.M[body.free][:, body.free])


def is_held(body: Elasticity) -> bool:
    """Return whether no part of a body is free to move."""
    vertices = body.mesh.nvertices
    links = csr_matrix((np.ones(body.mesh.nedges), body.mesh.edges), shape=(vertices, vertices))
    count, label = connected_components(links, directed=False)
    return all(
        holds_still(body.points[own], body.held[own]) for own in (np.flatnonzero(label == k) for k in range(count))
    )


def tractions(body: Elasticity, recovery: "Recovery", sites: Sequence[Site], placed: Sites, goal: int) -> Array:
    """Return the traction of a unit force on a goal's footprint, `(r,)` [Pa/N].

    The traction is given at the nodes of the surface. It is zero for a force inside the body.
    """
    site, axis = sites[goal], placed.normals[goal]
    if not np.isfinite(axis).all():
        return np.zeros(recovery.rim.size)
    offset, facing = body.points[recovery.rim] - placed.points[goal], recovery.normals @ axis
    height = offset @ axis
    across = np.linalg.norm(offset - height[:, None] * axis, axis=1) / site.radius
    struck = (facing > 0.0) & (np.abs(height) <= site.radius)
    return np.asarray(np.where(struck, facing * density(site.weight, across), 0.0) / site.radius**2)


@dataclass(frozen=True)
class Recovery:
    """Recovery of the stress of columns on a `body`, cell by cell."""

    body: Elasticity

    @cached_property
    def material(self) -> tuple[Array, Array]:
        """The λ and μ of the estimated stress in each cell, `(c,)` each [Pa]."""
        given, count = self.body.material, self.body.mesh.nelements
        spread = cellwise_lambda(given, "nodal") if self.body.dilatation == "nodal" else given.lame_lambda
        return np.broadcast_to(spread, count), np.broadcast_to(given.lame_mu, count)

    @cached_property
    def _spread(self) -> Array:
        """The λ that acts at each point of the cells, `(c,)` [Pa]."""
        spread = cellwise_lambda(self.body.material, self.body.dilatation)
        return np.broadcast_to(spread, self.body.mesh.nelements)

    @cached_property
    def copies(self) -> tuple[Indices, Indices]:
        """Key indices of the nodes of each cell, `(c, n)`, and the node of each key, `(m,)`."""
        return np.searchsorted(self.keys, self._cell_keys), self.keys % len(self.body.nodes)

    @cached_property
    def groups(self) -> Indices:
        """Number of the material of each cell, `(c,)`."""
        return np.asarray(np.unique(np.stack(self.material), axis=1, return_inverse=True)[1]).ravel()

    @property
    def _cell_keys(self) -> Indices:
        """Key of each node of each cell, `(c, n)`.

        The key is the material's number times the number of nodes, plus the node's number.
        """
        return np.asarray(self.groups[:, None] * len(self.body.nodes) + self.body.cells)

    @cached_property
    def keys(self) -> Indices:
        """The sorted keys, `(m,)`.

        A node on a border between materials has one key in each material.
        """
        return np.unique(self._cell_keys)

    @cached_property
    def _surface(self) -> tuple[Indices, Array]:
        """Nodes of the surface with a known traction, and the normals there."""
        surface = outer_surface(self.body.mesh)
        nodes = self.body.facet_nodes(surface.vertices)
        rim, place = np.unique(nodes, return_inverse=True)
        place, normals = place.reshape(nodes.shape), np.zeros((rim.size, 3))
        for axis in range(AXES):
            each = np.repeat(surface.normals[:, axis], nodes.shape[1])
            normals[:, axis] = np.bincount(place.ravel(), each, rim.size)
        normals /= np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]
        tilt = np.ones(rim.size)
        np.minimum.at(tilt, place, np.einsum("fi,fni->fn", surface.normals, normals[place]))
        free = (tilt >= SMOOTH) & ~self.body.held[rim].any(axis=1)
        return rim[free], normals[free]

    @property
    def rim(self) -> Indices:
        """Nodes of the surface with a known traction, `(r,)`: free, and not on an edge."""
        return self._surface[0]

    @property
    def normals(self) -> Array:
        """Outward unit normals at `rim`, `(r, 3)`."""
        return self._surface[1]

    def missed(self, W: Array, traction: Array, cells: Indices) -> Array:
        """Return η² of `cells` `(k,)` for three columns W `(N, 3)` [m/N], shape `(3, k)` [m/N].

        The columns belong to unit forces along x, y and z with a `traction` `(r,)` [Pa/N] at the
        nodes of the surface.
        """
        nodal, numbers = self._nodal(W, traction, cells)
        out = np.empty((AXES, cells.size))
        for part in chunks(cells.size):
            some = cells[part]
            off = nodal[numbers[part]] - self._stress(some, W).reshape(some.size, -1, AXES, AXES, AXES)
            off = (self._products @ off.reshape(*off.shape[:2], -1)).reshape(off.shape)
            lam, mu = (m[some, None, None] for m in self.material)
            trace = np.einsum("caiik->cak", off)
            energy = 0.5 / mu * (np.einsum("caijk,caijk->cak", off, off) - lam / (3.0 * lam + 2.0 * mu) * trace**2)
            out[:, part] = (self.body.six_volumes[some, None] * energy.sum(axis=1)).T
        return out

    @cached_property
    def _products(self) -> Array:
        """Lᵀ `(n, n)` with L Lᵀ = ∫ φ_m φ_n over the reference cell, so that ∫ σ² is the sum of (Lᵀσ)²."""
        return np.asarray(np.linalg.cholesky(reference_means(self.body.cell).shapes / 6.0).T)

    def _stress(self, cells: Indices, W: Array) -> Array:
        """Return the stress at the nodes of `cells` `(c,)`, shape `(c, n, 27)`; it is linear in each cell."""
        nodes = np.asarray(self.body.cell.doflocs)
        (_, slopes), own = shapes(self.body.cell, nodes[:4]), W[self.body.nodes[self.body.cells[cells]]]
        inner = np.tensordot(own, slopes, axes=([1], [0]))  # cell, component, column, reference axis, corner
        H = np.einsum("cikla,clj->caijk", inner, self.body.inverse_edges[cells], optimize=True)
        stress = self.material[1][cells, None, None, None, None] * (H + H.swapaxes(2, 3))
        pressure = self._spread[cells, None, None] * np.einsum("caiik->cak", H)
        if self.body.pressure is not None and self.body.dilatation == "mean":
            pressure += (self.body.pressure[cells] @ W)[:, None]
        for axis in range(AXES):
            stress[:, :, axis, axis] += pressure
        from_corners = np.column_stack([1.0 - nodes.sum(axis=1), nodes])
        return np.asarray(from_corners @ stress.reshape(len(cells), 4, -1))

    def _nodal(self, W: Array, traction: Array, cells: Indices) -> tuple[Array, Indices]:
        """Return σ* at the nodes of cells, and the indices of each cell's nodes in σ*.

        σ* has shape `(m, 3, 3, k)`, and the indices have shape `(c, n)` for `cells` `(c,)`. A node
        on a border between materials has one σ* in each material.
        """
        copies, node = self.copies
        touched = np.zeros(node.size, dtype=bool)
        touched[copies[cells]] = True
        around = np.flatnonzero(touched[copies].any(axis=1))
        known = np.unique(copies[around])
        numbers = np.searchsorted(known, copies[around])
        volume = np.bincount(numbers.ravel(), np.repeat(self.body.six_volumes[around], numbers.shape[1]))
        total = np.zeros((known.size, 27))
        for part in chunks(around.size):
            some = around[part]
            each = (self._stress(some, W) * self.body.six_volumes[some, None, None]).reshape(-1, 27)
            rows, place = np.unique(numbers[part], return_inverse=True)
            spread = csr_matrix(
                (np.ones(len(each)), (place.ravel(), np.arange(len(each)))), shape=(rows.size, len(each))
            )
            total[rows] += np.asarray(spread @ each)
        stress = self._continuous((total / volume[:, None]).reshape(-1, 3, 3, AXES), known)
        return self._balanced(stress, node[known], W, traction), numbers[np.searchsorted(around, cells)]

    @cached_property
    def _borders(self) -> tuple[Indices, Array]:
        """Key indices of the nodes on borders between materials, `(b, 2)`, and normals, `(b, 3)`.

        Each of these nodes has two key indices, one in each material.
        """
        mesh, groups = self.body.mesh, self.groups
        inner = np.flatnonzero(mesh.f2t[1] >= 0)
        facets = inner[groups[mesh.f2t[0, inner]] != groups[mesh.f2t[1, inner]]]
        beside = np.sort(groups[mesh.f2t[:, facets]], axis=0)
        nodes = self.body.facet_nodes(mesh.facets[:, facets].T)
        a, b, c = np.moveaxis(mesh.p.T[mesh.facets[:, facets].T], 1, 0)
        normals = np.cross(b - a, c - a)
        first = groups[mesh.f2t[0, facets]] == beside[0]
        outward = mesh.p.T[mesh.t[:, mesh.f2t[0, facets]]].mean(axis=0) - a
        normals *= np.where((np.sum(normals * outward, axis=1) < 0.0) == first, 1.0, -1.0)[:, None]
        keys = beside[..., None] * len(self.body.nodes) + nodes
        numbers = np.searchsorted(self.keys, keys).reshape(2, -1).T
        pairs, place = np.unique(numbers, axis=0, return_inverse=True)
        each = np.repeat(normals, nodes.shape[1], axis=0)
        sums = np.stack([np.bincount(place.ravel(), each[:, axis], len(pairs)) for axis in range(AXES)], axis=1)
        return pairs, sums / np.linalg.norm(sums, axis=1)[:, None]

    def _continuous(self, stress: Array, known: Indices) -> Array:
        """Return σ* `(m, 3, 3, k)` with continuous traction at borders between materials.

        σ* belongs to the `known` key indices `(m,)`. The change of σ* is the smallest one. It is
        weighted by softness, so that the softer side changes less.
        """
        pairs, n = self._borders
        both = np.isin(pairs, known).all(axis=1)
        pairs, n = pairs[both], n[both]
        if not len(pairs):
            return stress
        soft = 1.0 / np.array([np.min(self.material[1][self.groups == g]) for g in range(self.groups.max() + 1)])
        weights = soft[self.keys[pairs] // len(self.body.nodes)]
        pairs = np.searchsorted(known, pairs)
        weights /= weights.sum(axis=1)[:, None]
        sides = np.einsum("bsijk,bj->bsik", stress[pairs], n)
        common = np.einsum("bsik,bs->bik", sides, weights)
        for side in range(2):
            np.add.at(stress, pairs[:, side], turned(common - sides[:, side], n))
        return stress

    @cached_property
    def _places(self) -> Indices:
        """The index of each node in `rim`, `(m,)`; −1 if the node is not in `rim`."""
        place = np.full(len(self.body.nodes), -1, np.intp)
        place[self.rim] = np.arange(self.rim.size)
        return place

    def _balanced(self, stress: Array, node: Indices, W: Array, traction: Array) -> Array:
        """Return σ* at nodes `(m,)`, changed such that σ*n is the traction at the surface.

        The change is the smallest one.
        """
        at = np.flatnonzero(self._places[node] >= 0)
        row = self._places[node[at]]
        n = self.normals[row]
        gap = traction[row, None, None] * np.eye(AXES) - np.einsum("mijk,mj->mik", stress[at], n)
        gap -= n[:, :, None] * self._pressure(W, node[at])[:, None]
        stress[at] += turned(gap, n)
        return stress

    def _pressure(self, W: Array, nodes: Indices) -> Array:
        """Return the part of λ div U that is averaged at the vertices, shape `(m, k)`.

        The values are at `nodes` `(m,)`.
        """
        body = self.body
        if body.pressure is None or body.dilatation != "nodal":
            return np.zeros((nodes.size, W.shape[1]))
        corner = nodes < body.mesh.nvertices
        ends = np.where(corner, nodes, body.mesh.edges[:, np.where(corner, 0, nodes - body.mesh.nvertices)])
        return np.asarray(0.5 * sum(body.pressure[end] @ W for end in ends))


def chunks(count: int) -> list[slice]:
    """Return slices of a number of cells that are small enough to be processed together."""
    return [slice(first, first + CELLS) for first in range(0, count, CELLS)]


def turned(traction: Array, n: Array) -> Array:
    """Return the smallest symmetric stresses `(m, 3, 3, k)` with a given `traction`.

    The traction `(m, 3, k)` acts on planes with unit normals `n` `(m, 3)`.
    """
    along = np.einsum("mik,mi->mk", traction, n)
    both = np.einsum("mik,mj->mijk", traction, n)
    return np.asarray(both + both.swapaxes(1, 2) - np.einsum("mk,mi,mj->mijk", along, n, n))
