"""What a mesh does not see of a hole: the missing local compliance of a site's nine numbers.

A mesh coarser than the footprint makes the tissue around a hole too stiff. The rest of the field is smooth, so what is
missing is local. ΔC = B Bᵀ acts as springs between the site and the mesh, without mass, which is right while a wave
crosses the hole in less than a step. There are two ways to it.

In one material, with a cell or more to whatever is around the hole, the footprint's exact field in an unbounded body
(`tissue.sites.unbounded`) is prescribed on the rim of a patch of the organ's own mesh and matrix, the mesh answers
inside, and

    ΔC = C_unbounded − Y u_mesh.

Had the mesh resolved the footprint, u_mesh would be the exact field and ΔC zero. Everywhere else (layers, edges, thin
and curved walls, other holes) patches of the organ's cells (`tissue.sites.patch`), held where they are cut out, are
solved with the true materials:

    ΔC = (C_finer − C_second) on the hole's own patch + (C_second − C_mesh) on a wider one.

Cells of second order, as they are, come between: what they owe to the size of the cells is as local as the footprint,
what linear cells owe to their order is not, a stiff skin on soft tissue least of all. So the second patch grows until
its part is settled, or is the whole body, which all holes there share. Where it does not settle, the mesh is too coarse
all around the hole, and no springs are added. The cross compliance of holes that share a patch comes with it.

A couple in a normal frame has no limit with a uniform weight (`tissue.sites.site`); there forces alone are made up for.
A bare point has none at all.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, vstack
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.refinement.refine import PAIRS
from tissue.sites.closed_form import Footprint, answer, foreign, is_endless, moduli, unbounded
from tissue.sites.line import FORCES, line_gap, rows_of
from tissue.sites.patch import Patch
from tissue.sites.surface import Surface, closest_on_triangles
from tissue.supports import holds_still

RINGS = 2.0  # cells between what the footprint touches and the rim of the closed form's patch, at least
RADII = {"P1": 6.0, "P2": 2.5}  # of the footprint from its centre to that rim, at least: P1 errs further out
NEAR = 1.0  # cells from the rim of a hole to what is around it: from there on the closed form is within 3 %
EVEN = 0.03  # spread of E, and of ν, up to which the tissue around a hole is one material
NEGLIGIBLE = 1e-6  # of the site's compliance
SAME = 1e-9  # of a cell: places nearer than this are one
FINEST = {"disc": 0.15, "half ball": 0.15, "ball": 0.4}  # size of cells over the radius: forces to 1 %, couples to 3 %
THIN = 2.0 / 3.0  # of that where stiffer tissue begins within a radius: couples in so thin a layer to 4 %, else to 6 %
SLOPE = 0.6  # growth of that size with the distance from disc or ball
REACH, CELLS = 1.0, 1.5  # radii, and longest edges, from the rim of a hole to that of its patch, whichever is more
WIDER = 1.5  # of the reach, each time that the second patch grows
MOSTLY = 0.5  # of the bodies' cells: a patch that would hold more of them is all of them, once for all holes there
FEW = 6  # holes that are solved finer on one patch however far apart; of more those within `APART`
APART = 1.0  # of both radii together, rim to rim: beyond, finer cells change forces by 0.5 %, couples by 2 %
MOST = 4000  # cells in a patch, for each of its holes: some 20,000 unknowns, a second
LEAST = 0.75  # of the reach that the most cells must allow: below, the mesh is as fine as the patch would be
SMALL, TO_COME = 0.012, 0.025  # change of the compliance by the last growth, and sum of those to come, that are allowed
SPREAD = 1.8  # lengths over which a stiff skin spreads a force, that the patch of linear cells must reach at least
RESOLVED = 0.03  # share below which a mesh needs nothing made up


@dataclass(frozen=True)
class Hole:
    """A site's footprint, its variables' `rows` `(9, N)` over all unknowns, and what makes the same rows `on` another
    mesh of the body."""

    seen: Footprint
    rows: csr_matrix
    on: Callable[[Elasticity, Surface], csr_matrix]


@dataclass(frozen=True)
class Missing:
    """What a mesh misses of a site: B `(9, m)` of ΔC = B Bᵀ, its columns those of all sites of one `group`; `share`,
    the largest part of the hole's compliance to a force that it makes up; `size` [m], that of the cells around; `clear`
    [m], from the hole's rim to the nearest clamped node, surface other than the site's own, or rim of another hole;
    `by`, "unbounded body", "line", "patch" or "nothing"; and whether the answer `holds`. There are no springs where
    not."""

    springs: Array
    share: float
    size: float
    clear: float
    by: str = "unbounded body"
    holds: bool = True
    group: int = 0

    def record(self) -> dict[str, float | bool | str]:
        """The numbers to be written down: `share` [-], `size` and `clear` [m], `by` what, and whether that holds."""
        return {"share": self.share, "size": self.size, "clear": self.clear, "by": self.by, "holds": self.holds}


@dataclass(frozen=True)
class Around:
    """What is around a hole: `size` [m] of the cells that its footprint touches, `longest` [m], the mean of their
    longest edges, `clear` [m] (`Missing`), and whether the tissue is one material as far as the closed form goes
    (`even`); the nodes `touched` by the footprint, and those `inside` the closed form's patch, both `(m,)`."""

    size: float
    longest: float
    clear: float
    even: bool
    touched: NDArray[np.bool_]
    inside: NDArray[np.bool_]

    @property
    def unbounded(self) -> bool:
        """Whether the body looks unbounded from the hole."""
        return self.even and self.clear >= NEAR * self.size


def missing(
    body: Elasticity,
    surface: Surface,
    holes: Sequence[Hole | None],
    points: Array,
    radii: Array,
    lines: Sequence[str],
) -> tuple[Missing | None, ...]:
    """What the mesh misses of each hole; None where nothing is asked for. All sites are at `points` `(p, 3)` [m] with
    footprints of `radii` `(p,)` [m], and belong to `lines` (p,) of balls, empty for none."""
    found: dict[int, Missing] = {}
    for line in dict.fromkeys(filter(None, lines)):
        members = [k for k, own in enumerate(lines) if own == line and holes[k] is not None]
        balls = [hole for hole in (holes[k] for k in members) if hole is not None]
        gaps = by_line(body, surface, balls) if balls else []
        found |= {k: replace(gap, group=members[0]) for k, gap in zip(members, gaps, strict=True)}
    single = [k for k, line in enumerate(lines) if not line]
    own = missing_of_each(body, surface, [holes[k] for k in single], points[single], radii[single])
    found |= {k: replace(gap, group=single[gap.group]) for k, gap in zip(single, own, strict=True) if gap is not None}
    return tuple(found.get(k) for k in range(len(holes)))


def missing_of_each(
    body: Elasticity, surface: Surface, holes: Sequence[Hole | None], points: Array, radii: Array
) -> tuple[Missing | None, ...]:
    """`missing` of sites that belong to no line."""
    asked = {k: hole for k, hole in enumerate(holes) if hole is not None}
    around = {k: look(body, surface, hole) for k, hole in asked.items()}
    sizes = np.array([around[k].size if k in around else 0.0 for k in range(len(holes))])
    coarser, apart = np.maximum(sizes[:, None], sizes), np.linalg.norm(points[:, None] - points, axis=2)
    same, between = apart <= SAME * coarser, apart - radii[:, None] - radii
    between[same] = np.inf  # the same hole at another time
    around = {k: replace(here, clear=min(here.clear, float(between[k].min()))) for k, here in around.items()}
    near = between < NEAR * coarser
    patched = np.array([k for k in asked if near[k].any() or not around[k].unbounded], np.intp)
    found = {k: replace(by_closed_form(body, asked[k], around[k]), group=k) for k in asked if k not in patched}
    patches = patches_of(body, [asked[k] for k in patched], [around[k] for k in patched])
    count, label = connected_components(csr_matrix((near | same)[np.ix_(patched, patched)]), directed=False)
    groups = [np.flatnonzero(label == group) for group in range(count)]
    bodies = [tuple(np.unique(patches.bodies[group])) for group in groups]
    for one in dict.fromkeys(bodies):
        alike = [group for group, own in zip(groups, bodies, strict=True) if own == one]
        every = patches.among(np.concatenate(alike))
        for group in alike:
            members = patched[group].tolist()
            gaps = by_patch(patches.among(group, every), [around[k] for k in members])
            found |= {k: replace(gap, group=members[0]) for k, gap in zip(members, gaps, strict=True)}
    return tuple(found.get(k) for k in range(len(holes)))


def look(body: Elasticity, surface: Surface, hole: Hole) -> Around:
    """What is around a hole, other holes left out."""
    site, elsewhere = hole.seen, foreign(body, surface, hole.seen)
    distance = np.linalg.norm(body.points - site.centre, axis=1)
    touched = np.asarray(np.isin(body.nodes, hole.rows.indices).any(axis=1))
    size = float(distance[touched].max() - site.radius)
    inside = distance <= max(RADII[body.element] * site.radius, site.radius + (1.0 + RINGS) * size)
    inside[elsewhere] = False
    alien = np.asarray(np.isin(body.nodes, body.clamped).any(axis=1))
    alien[elsewhere] = True
    clear = float(np.min(distance[alien], initial=np.inf) - site.radius)
    own, within = (mask(touched[body.cells], axis=1) for mask, touched in ((np.all, touched), (np.any, inside)))
    corners = body.mesh.p.T[body.mesh.t[:, own].T]
    edges = np.linalg.norm(corners[:, PAIRS[:, 1]] - corners[:, PAIRS[:, 0]], axis=2)
    E, nu = (
        np.broadcast_to(m, within.shape)[within] for m in (body.material.youngs_modulus, body.material.poisson_ratio)
    )
    even = np.ptp(E) <= EVEN * E.min() and np.ptp(nu) <= EVEN
    return Around(size, float(edges.max(axis=1).mean()), clear, bool(even), touched, inside)


def by_closed_form(body: Elasticity, hole: Hole, here: Around) -> Missing:
    """What the mesh misses of a hole in a body that looks unbounded from there."""
    modulus = moduli(body, here.touched)
    exact = unbounded(hole.seen, *modulus)
    gap = exact - answer(body, hole.seen, hole.rows, np.sort(body.nodes[here.inside].ravel()), modulus)
    gap[~np.isfinite(exact)] = 0.0
    B = springs(0.5 * (gap + gap.T), exact, np.repeat([1.0, hole.seen.radius], [3, 6]))
    return Missing(B, share(B, exact), here.size, here.clear)


def by_line(body: Elasticity, surface: Surface, balls: Sequence[Hole]) -> list[Missing]:
    """What the mesh misses of a line of balls, by the unbounded body's fields (`tissue.sites.line`)."""
    seen = [ball.seen for ball in balls]
    touched = [np.asarray(np.isin(body.nodes, ball.rows.indices).any(axis=1)) for ball in balls]
    modulus = np.array([moduli(body, near) for near in touched])
    away = [np.linalg.norm(body.points - ball.centre, axis=1) for ball in seen]
    radii = np.array([ball.radius for ball in seen])
    sizes = np.array([far[near].max() for far, near in zip(away, touched, strict=True)]) - radii
    alien = np.asarray(np.isin(body.nodes, body.clamped).any(axis=1))
    alien[foreign(body, surface, seen[0])] = True
    clear = np.array([far[alien].min(initial=np.inf) for far in away]) - radii
    reach = np.maximum(RADII[body.element] * radii, radii + (1.0 + RINGS) * sizes)
    rows = rows_of([ball.rows for ball in balls])
    gap, whole = line_gap(body, surface, seen, rows, reach, modulus[:, 0], float(modulus[:, 1].mean()))
    B = springs(gap, whole, np.ones(len(gap)))
    return [
        Missing(
            np.vstack([own := B[FORCES * k : FORCES * (k + 1)], np.zeros((6, B.shape[1]))]),
            share(own, whole[FORCES * k :, FORCES * k :]),
            float(sizes[k]),
            float(clear[k]),
            "line",
        )
        for k in range(len(balls))
    ]


def by_patch(patches: "Patches", around: Sequence[Around]) -> list[Missing]:
    """What the mesh misses of holes on one patch, by cells that are finer and of second order.

    Nothing is added where the mesh is too fine for that, which holds where it needs nothing, or where the part of the
    linear cells does not settle.
    """
    body, holes = patches.body, patches.holes
    if patches.widest < LEAST:
        small = [by_closed_form(body, hole, here).share <= RESOLVED for hole, here in zip(holes, around, strict=True)]
        return [nothing(here, good) for here, good in zip(around, small, strict=True)]
    gap, whole, settled = patches.gap()
    if not settled:
        return [nothing(here, False) for here in around]
    endless = np.concatenate([np.repeat([False, is_endless(hole.seen)], [3, 6]) for hole in holes])
    gap[endless] = gap[:, endless] = 0.0
    scale = np.concatenate([np.repeat([1.0, hole.seen.radius], [3, 6]) for hole in holes])
    B = springs(gap, whole, scale)
    parts = [slice(9 * k, 9 * k + 9) for k in range(len(holes))]
    return [
        Missing(B[part], share(B[part], whole[part, part]), here.size, here.clear, "patch")
        for part, here in zip(parts, around, strict=True)
    ]


def nothing(here: Around, holds: bool) -> Missing:
    """No springs."""
    return Missing(np.zeros((9, 0)), 0.0, here.size, here.clear, "nothing", holds)


def patches_of(body: Elasticity, holes: Sequence[Hole], around: Sequence[Around]) -> "Patches":
    """The patches of all holes at once."""
    reach = [max(REACH * hole.seen.radius, CELLS * here.longest) for hole, here in zip(holes, around, strict=True)]
    stiff = [moduli(body, here.touched)[0] for here in around]
    return Patches(body, holes, np.array(reach), np.array(stiff))


@dataclass(frozen=True)
class Patches:
    """Patches of a body around `holes` that share them; `reach` `(p,)` [m] from the rims is that of the first, `stiff`
    `(p,)` [Pa] is E at the holes. These may be some of `every` hole in the same bodies."""

    body: Elasticity
    holes: Sequence[Hole]
    reach: Array
    stiff: Array
    every: "Patches | None" = None

    def among(self, members: Indices, every: "Patches | None" = None) -> "Patches":
        """The patches around those of the holes that are `members` `(k,)`, which are among `every` one in the same
        bodies."""
        return Patches(self.body, [self.holes[k] for k in members], self.reach[members], self.stiff[members], every)

    @cached_property
    def whole(self) -> tuple[Array, Array]:
        """The compliances in the whole of their bodies, as `compliances`; once for `every` hole in the same ones."""
        if self.every is None:
            patch = self.patch(np.inf)
            return patch.compliance(self.rows), patch.refined_compliance(unlimited, self.on)
        own, second = self.every.whole
        rows = of_holes(np.array([k for hole in self.holes for k, one in enumerate(self.every.holes) if one is hole]))
        return own[np.ix_(rows, rows)], second[np.ix_(rows, rows)]

    @cached_property
    def label(self) -> Indices:
        """The body that each cell belongs to, `(c,)`: cells of one body hang together."""
        return self.labels(np.ones(self.body.mesh.nelements, dtype=bool))

    @cached_property
    def bodies(self) -> Indices:
        """The body that each hole is in, `(p,)`."""
        return np.array([self.label[self.beside(hole)][0] for hole in self.holes], np.intp)

    @cached_property
    def distances(self) -> Array:
        """Distance of each cell from the rim of the nearest hole, over its reach, `(c,)`."""
        vertices = self.body.mesh.p.T
        each = [
            (np.linalg.norm(vertices - hole.seen.centre, axis=1) - hole.seen.radius) / reach
            for hole, reach in zip(self.holes, self.reach, strict=True)
        ]
        return np.asarray(np.min(each, axis=0)[self.body.mesh.t].min(axis=0))

    @property
    def widest(self) -> float:
        """The reach, over that of the first patch, within which there are no more than the most cells."""
        most = MOST * len(self.holes)
        return float(np.sort(self.distances)[most]) if self.distances.size > most else np.inf

    @property
    def spread(self) -> float:
        """The reach, over that of the first patch, that skins ask for in which holes are; 0 without any.

        A plate of thickness t and κ times as stiff as the half-space below spreads a force over t (κ/6)^⅓ (Hogg, Phil.
        Mag. 25, 1938), and there linear cells stiffen it.
        """
        E, vertices = np.broadcast_to(self.body.material.youngs_modulus, self.distances.shape), self.body.mesh.p.T
        asked = [0.0]
        for hole, own, reach in zip(self.holes, self.stiff, self.reach, strict=True):
            softer = own > E * (1.0 + EVEN)
            if softer.any():
                corners = vertices[np.unique(self.body.mesh.t[:, softer])]
                t = float(np.linalg.norm(corners - hole.seen.centre, axis=1).min())
                asked.append(SPREAD * t * float(np.cbrt(own / E[softer].min() / 6.0)) / reach)
        return max(asked)

    def labels(self, chosen: NDArray[np.bool_]) -> Indices:
        """Of all cells `(c,)` the number of the part that each belongs to, where the `chosen` ones hang together."""
        beside = self.body.mesh.f2t
        left, right = beside[:, (beside[1] >= 0) & chosen[beside].all(axis=0)]
        links = csr_matrix((np.ones(left.size), (left, right)), shape=(chosen.size, chosen.size))
        return np.asarray(connected_components(links, directed=False)[1], np.intp)

    def patch(self, factor: float) -> Patch:
        """The cells within `factor` of the reach that hang together with the holes; of bodies that nothing holds
        `held`."""
        body, chosen = self.body, self.distances <= factor
        label = self.labels(chosen)
        parts = np.unique(np.concatenate([label[self.beside(hole) & chosen] for hole in self.holes]))
        cells = [self.held(np.flatnonzero(chosen & (label == one))) for one in parts]
        return Patch(body, np.sort(np.concatenate(cells)))

    def beside(self, hole: Hole) -> NDArray[np.bool_]:
        """Tell of each cell whether a hole acts on all of its nodes, `(c,)`."""
        touched = np.asarray(np.isin(self.body.nodes, hole.rows.indices).any(axis=1))
        return np.asarray(touched[self.body.cells].all(axis=1))

    def held(self, cells: Indices) -> Indices:
        """Return `cells` that hang together, without the corner farthest from the holes where they are a whole body
        that nothing holds."""
        body, own = self.body, np.zeros(self.body.mesh.nelements, dtype=bool)
        own[cells] = True
        nodes, beside = np.unique(body.cells[cells]), body.mesh.f2t[:, body.mesh.f2t[1] >= 0]
        is_cut = bool((own[beside[0]] != own[beside[1]]).any())
        if is_cut or holds_still(body.points[nodes], np.isin(body.nodes[nodes], body.clamped)):
            return cells
        corners = np.unique(body.mesh.t[:, cells])
        away = corners[cdist(body.mesh.p.T[corners], self.centres).min(axis=1).argmax()]
        return cells[(body.mesh.t[:, cells] != away).all(axis=0)]

    def gap(self) -> tuple[Array, Array, bool]:
        """ΔC `(9p, 9p)`, the compliance with it in the widest patch, and whether what linear cells owe is settled."""
        local, second = self.local, self.second
        if self.body.element == "P2":
            return local, second + local, True
        return self.widened(local, second - self.first.compliance(self.rows), second + local)

    @cached_property
    def first(self) -> Patch:
        """The patch within the reach, or within as much of it as the most cells allow."""
        return self.patch(min(1.0, self.widest))

    @cached_property
    def second(self) -> Array:
        """The compliance in the first patch by its cells as they are, of second order, `(9p, 9p)`."""
        quadratic = self.body.element == "P2"
        return self.first.compliance(self.rows) if quadratic else self.first.refined_compliance(unlimited, self.on)

    @cached_property
    def local(self) -> Array:
        """What cells of second order owe to their size, `(9p, 9p)`; between holes of different clusters nothing."""
        gap, clusters = np.zeros((9 * len(self.holes),) * 2), self.clusters
        for members in clusters:
            own, rows = self if len(clusters) == 1 else self.among(members), of_holes(members)
            gap[np.ix_(rows, rows)] = own.first.refined_compliance(own.size, own.on) - own.second
        return gap

    @property
    def clusters(self) -> list[Indices]:
        """The holes that are solved finer on one patch: all, but of more than a few those that are near enough."""
        radii, centres = np.array([hole.seen.radius for hole in self.holes]), self.centres
        near = cdist(centres, centres) <= (1.0 + APART) * (radii[:, None] + radii)
        count, label = connected_components(csr_matrix(near | (radii.size <= FEW)), directed=False)
        return [np.flatnonzero(label == cluster) for cluster in range(count)]

    @property
    def centres(self) -> Array:
        """Where the holes are, `(p, 3)` [m]."""
        return np.array([hole.seen.centre for hole in self.holes])

    def widened(self, local: Array, order: Array, whole: Array) -> tuple[Array, Array, bool]:
        """`gap` from the part of the size of cells, and that of their order on the first patch."""
        inside = np.isin(self.label, self.bodies)
        factor, end = min(1.0, self.widest), float(self.distances[inside].max())
        changes: list[float] = []
        while factor < end and not (factor >= self.spread and is_settled(changes)):
            factor *= WIDER
            if factor > self.widest:
                return local + order, whole, False
            if np.mean(self.distances[inside] <= factor) > MOSTLY:
                factor = np.inf
            own, second = self.compliances(factor)
            whole = local + second
            changes.append(float(np.max(np.abs(np.diag(second - own - order)) / np.diag(whole))))
            order = second - own
        return local + order, whole, True

    def compliances(self, factor: float) -> tuple[Array, Array]:
        """Those of the cells within `factor` of the reach, as they are and quadratic, `(9p, 9p)` each."""
        if factor == np.inf:
            return self.whole
        patch = self.patch(factor)
        return patch.compliance(self.rows), patch.refined_compliance(unlimited, self.on)

    def size(self, corners: Array) -> Array:
        """Size wanted of cells with these corners `(c, 4, 3)`, shape `(c,)` [m]."""
        middles = corners.mean(axis=1)
        wanted = [
            finest + SLOPE * hole.seen.distance(middles) for finest, hole in zip(self.finest, self.holes, strict=True)
        ]
        return np.asarray(np.min(wanted, axis=0))

    @cached_property
    def finest(self) -> list[float]:
        """Size wanted of the cells at each hole [m]."""
        mesh, E = self.body.mesh, np.broadcast_to(self.body.material.youngs_modulus, self.distances.shape)
        inner = np.flatnonzero(mesh.f2t[1] >= 0)
        stiffer = E[mesh.f2t[:, inner]].max(axis=0)
        sizes = []
        for hole, own in zip(self.holes, self.stiff, strict=True):
            border = inner[stiffer > own * (1.0 + EVEN)]
            nearest = closest_on_triangles(hole.seen.centre, mesh.p.T[mesh.facets[:, border].T])
            depth = float(np.linalg.norm(nearest - hole.seen.centre, axis=1).min(initial=np.inf))
            sizes.append(FINEST[hole.seen.kind] * hole.seen.radius * (THIN if depth < hole.seen.radius else 1.0))
        return sizes

    @property
    def rows(self) -> csr_matrix:
        """The variables of all the holes over the organ's unknowns, `(9p, N)`."""
        return csr_matrix(vstack([hole.rows for hole in self.holes]))

    def on(self, body: Elasticity, surface: Surface) -> csr_matrix:
        """The same over those of another mesh."""
        return csr_matrix(vstack([hole.on(body, surface) for hole in self.holes]))


def is_settled(changes: Sequence[float]) -> bool:
    """Whether a part of the compliance that changed so much each time that the patch grew leaves little to come.

    The last of two changes is small itself, or small is the sum of those to come, were each as much less as it was.
    """
    if len(changes) < 2:
        return False
    before, last = changes[-2:]
    return last <= SMALL or (last < before and last**2 / (before - last) <= TO_COME)


def of_holes(members: Indices) -> Indices:
    """The rows of the variables of those of the holes that are `members` `(k,)`, `(9k,)`."""
    return np.asarray((9 * members[:, None] + np.arange(9)).ravel(), np.intp)


def unlimited(corners: Array) -> Array:
    """Cells may be as large as they are."""
    return np.full(len(corners), np.inf)


def springs(gap: Array, exact: Array, scale: Array) -> Array:
    """B `(k, m)` with ΔC = B Bᵀ; `scale` `(k,)` brings couples to the size of forces. A mesh is too stiff: what looks
    too soft is the error of ΔC and left out."""
    values, vectors = np.linalg.eigh(scale[:, None] * gap * scale)
    keep = values > NEGLIGIBLE * np.max(np.diag(exact)[:3])
    return np.asarray(vectors[:, keep] * np.sqrt(values[keep]) / scale[:, None])


def share(B: Array, whole: Array) -> float:
    """The largest part of the compliance to a force that springs make up."""
    return float(np.max(np.sum(B[:3] ** 2, axis=1) / np.diag(whole)[:3]))
