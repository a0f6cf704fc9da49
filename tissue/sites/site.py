"""Piercing sites: nine numbers y = (x, u, v) per piercing.

The numbers are linear in the organ's unknowns, y = y0 + Y U:

    x = X + ⟨N⟩ U                      the point, averaged over the footprint of the hole
    u = u₀ + ⟨∇U⟩ u₀,  v likewise      normal frame: material tangents convect,
                                       T ⟂ u, v is the normal
    u = u₀ − ⟨∇U⟩ᵀ u₀, v likewise      fibre frame: T ⟂ u, v stays along the convected
                                       cut of the needle

with (∇U)_ij = ∂U_i/∂x_j. The footprint is a disc on the surface and a ball inside the organ. On the
surface, the fibre frame needs the derivative along the normal. The average of this derivative over
a surface patch is not bounded by the elastic energy; the average grows without limit under
refinement. The gradient is therefore averaged over the part of the ball inside the body. With a
parabolic weight, the tangential derivatives of the normal frame are bounded on the surface. With a
uniform weight these derivatives depend on the circle alone, and their compliance grows like
log(radius/h).
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix, vstack

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.errors import TissueError
from tissue.shapes import shapes
from tissue.sites import footprint
from tissue.sites.rows import (
    NO_SLOPE,
    Average,
    AverageSlope,
    fibre_rows,
    gradient_rows,
    normal_rows,
    value_rows,
)
from tissue.sites.surface import INSIDE, ON_SURFACE, Surface, outer_surface

log = logging.getLogger(__name__)

Direction = Literal["normal"] | ArrayLike | None

AXIS = np.array([0.0, 0.0, 1.0])  # frame axis of an interior site without a direction; any axis can be used
OF_A_FACE = 3  # nodes of a face
WEIGHTLESS = 1e-9  # of the largest weight in an average: round-off
EDGE_ON = 1e-3  # least cosine between the normals of facet and disc: with a smaller one the facet is seen edge-on
COVERED = 1e-9  # of a disc: a smaller error of the covered area is round-off


@dataclass(frozen=True)
class Site:
    """A piercing with its `point` (3,) [m] and the footprint around it.

    `radius` [m] is the footprint's radius (0: the bare point) and `weight` its weight. `direction`
    is None, "normal" (the organ's outward normal) or the vector (3,), of any length, along which
    the needle cuts. `line` names the line of balls inside the organ to which the site belongs;
    empty if the site is on no line. A site of a line has a moving point but no moving frame.
    """

    point: ArrayLike
    radius: float = 0.0
    weight: str = "parabolic"
    direction: Direction = None
    name: str = "site"
    line: str = ""

    def __post_init__(self) -> None:
        point = np.asarray(self.point, float)
        if point.shape != (3,) or not np.all(np.isfinite(point)):
            raise TissueError(f"{self.name}: point = {self.point!r}; allowed are three finite numbers [m]")
        if not 0.0 <= self.radius < np.inf:
            raise TissueError(f"{self.name}: radius = {self.radius} m; allowed is 0 (the bare point) or more")
        if self.weight not in footprint.WEIGHTS:
            raise TissueError(f"{self.name}: weight = {self.weight!r}; allowed are 'uniform' and 'parabolic'")
        if isinstance(self.direction, str) and self.direction != "normal":
            raise TissueError(f"{self.name}: direction = {self.direction!r}; allowed are None, 'normal' and a vector")
        if self.line and (self.direction is not None or self.radius == 0.0):
            raise TissueError(f"{self.name}: a site of a line has no direction, and a radius above 0")
        if self.direction is not None and not isinstance(self.direction, str):
            vector = np.asarray(self.direction, float)
            if vector.shape != (3,) or not np.all(np.isfinite(vector)) or not np.any(vector):
                raise TissueError(f"{self.name}: direction = {self.direction!r}; allowed is a vector other than zero")

    @property
    def fibre(self) -> Array | None:
        """Unit vector along the cut of the needle, or None without a vector."""
        if self.direction is None or isinstance(self.direction, str):
            return None
        vector = np.asarray(self.direction, float)
        return vector / np.linalg.norm(vector)


@dataclass(frozen=True)
class Sites:
    """Site variables y = y0 + Y U over the free unknowns: `y0` `(9p,)`, `Y` `(9p, N)`.

    `points` `(p, 3)` [m] are the located sites, and `directions` `(p, 3)` are the t₀ of their
    frames. `normals` `(p, 3)` are the outward normals, NaN for interior sites. Frames are
    orthonormal and right-handed. `directed` says for each site whether a direction was given; empty
    if unknown. `slopes` has the rows of ⟨∂U_i/∂x_j⟩, `(9, N)` [1/m], for each site with a fibre
    frame, or None for other sites. A site has a fibre frame if its direction is a vector, or if it
    is inside the organ and on no line.
    """

    y0: Array
    Y: csr_matrix
    points: Array
    directions: Array
    normals: Array
    directed: tuple[bool, ...] = ()
    slopes: tuple[csr_matrix | None, ...] = ()


def frame(t0: Array) -> tuple[Array, Array]:
    """Return u₀, v₀ with u₀ × v₀ = t₀.

    They are the axes x and y, turned by the smallest rotation from z to the unit vector t₀. The
    rule is continuous except at t₀ = −z, where no rule is continuous. (u, v) is free up to a
    rotation about t₀. The clamped end of a thread uses the same rule (`coupling.system`).
    """
    x, y, z = t0
    across = np.hypot(x, y)
    if across == 0.0:
        return np.array([1.0, 0.0, 0.0]), np.array([0.0, np.sign(z), 0.0])
    c, s = x / across, y / across
    u = np.array([1.0 - c * c * (1.0 - z), -c * s * (1.0 - z), -x])
    u -= (u @ t0) * t0
    u /= np.linalg.norm(u)
    return u, np.cross(t0, u)


def build_sites(elasticity: Elasticity, sites: Sequence[Site]) -> Sites:
    """Return all sites, located and with nine rows each over the free unknowns.

    Raises `TissueError` for an impossible site.
    """
    log.info("finding %d holes in the organ", len(sites))
    surface = outer_surface(elasticity.mesh)
    built = [_build(elasticity, surface, site) for site in sites]
    rows = [csr_matrix(rows) for _, rows, *_ in built]
    Y = csr_matrix(vstack(rows)) if rows else csr_matrix((0, elasticity.free.size))
    y0 = np.concatenate([np.zeros(0), *(y for y, *_ in built)])
    points, directions, normals = (np.array([b[k] for b in built]).reshape(-1, 3) for k in (2, 3, 4))
    directed = tuple(site.direction is not None for site in sites)
    return Sites(y0, Y, points, directions, normals, directed, tuple(b[5] for b in built))


@dataclass(frozen=True)
class Load:
    """A unit force on a footprint: a traction on facets of a `surface`.

    The load has `points` `(k, 3)` [m], the facet of each point `(k,)`, weights `(k,)`, and the
    tractions at the points, `densities` `(k,)` [1/m²]. The weights integrate polynomials up to
    degree six over each facet. A point can lie outside its facet, in the plane of the facet.
    """

    surface: Surface
    points: Array
    facets: Indices
    weights: Array
    densities: Array


def load_of(surface: Surface, site: Site) -> Load:
    """Return the load of a unit force on the footprint of a site.

    Raises `TissueError` for a site inside the body, and for a footprint that the facets do not
    cover exactly once.
    """
    distance, nearest, facets = surface.nearest(np.asarray(site.point, float))
    if distance > ON_SURFACE * surface.diagonal:
        raise TissueError(
            f"{site.name}: {_show(np.asarray(site.point, float))} is inside the organ, and bounds need a "
            "footprint on its surface; move the site to the surface, or leave tissue.mesh.bound out"
        )
    X, normal, _, patch = _surface_footprint(surface, site, nearest, facets)
    covered = _cover(surface, site, X, normal, patch)
    if covered is None:
        raise TissueError(
            f"{site.name}: the facets do not cover the footprint at {_show(X)} exactly once, so that bounds cannot "
            "be computed; move the site, or leave tissue.mesh.bound out"
        )
    points, cover = covered
    across = np.linalg.norm(cover.points, axis=1)
    facing = surface.normals[cover.triangles] @ normal
    densities = facing * footprint.density(site.weight, across) / site.radius**2
    return Load(surface, points, cover.triangles, cover.weights(site.weight), densities)


def cells_at(elasticity: Elasticity, sites: Sites) -> tuple[Indices, ...]:
    """Return the cells that carry the force of each site.

    Each of these cells has at least three nodes whose displacement the site averages.
    """
    number = np.empty(elasticity.N, dtype=np.intp)
    number[elasticity.nodes] = np.arange(len(elasticity.nodes))[:, None]
    averages = [sites.Y[9 * k : 9 * k + 3] for k in range(len(sites.points))]
    bearing = [abs(rows) > WEIGHTLESS * abs(rows).max() for rows in averages]
    nodes = [number[elasticity.free[rows.indices]] for rows in bearing]
    return tuple(np.flatnonzero(np.isin(elasticity.cells, own).sum(axis=1) >= OF_A_FACE) for own in nodes)


def space_frames(sites: Sequence[Site]) -> Array:
    """Return y0 `(9p,)` of sites fixed in space.

    Raises `TissueError` for the direction 'normal', because there is no organ.
    """
    for site in sites:
        if isinstance(site.direction, str):
            raise TissueError(f"{site.name}: direction = 'normal' without an organ; give a vector or None")
    parts = [(np.asarray(s.point, float), *frame(AXIS if s.fibre is None else s.fibre)) for s in sites]
    return np.concatenate([np.zeros(0), *(a for part in parts for a in part)])


def _build(
    elasticity: Elasticity, surface: Surface, site: Site
) -> tuple[Array, csr_matrix, Array, Array, Array, csr_matrix | None]:
    """Return y0 (9,), rows `(9, N)`, point, direction, outward normal and rows of ⟨∇U⟩ of a site.

    The rows of ⟨∇U⟩ are None if the site has no fibre frame.
    """
    X, normal, values, gradient = _averages(elasticity, surface, site)
    if site.line and np.isfinite(normal).all():
        raise TissueError(f"{site.name}: {_show(X)} is on the organ's surface, and a line lies inside")
    use_fibre = site.fibre is not None or bool(np.isnan(normal).any())
    t0 = site.fibre if site.fibre is not None else (AXIS if use_fibre else normal)
    u0, v0 = frame(t0)
    turn = fibre_rows if use_fibre else normal_rows
    frames = (csr_matrix((3, gradient.shape[1])),) * 2 if site.line else (turn(gradient, u0), turn(gradient, v0))
    rows = csr_matrix(vstack([values, *frames]))
    turns = use_fibre and (site.fibre is not None or not site.line)  # a fibre frame turns nonlinearly with ⟨∇U⟩
    cut = csr_matrix(gradient[:, elasticity.free]) if turns else None
    return np.concatenate([X, u0, v0]), csr_matrix(rows[:, elasticity.free]), X, t0, normal, cut


def _averages(elasticity: Elasticity, surface: Surface, site: Site) -> tuple[Array, Array, csr_matrix, csr_matrix]:
    """Return point, outward normal, and rows of the averages ⟨U⟩ and ⟨∂U_i/∂x_j⟩ of a site.

    The rows are over all unknowns.
    """
    distance, nearest, facets = surface.nearest(np.asarray(site.point, float))
    if distance <= ON_SURFACE * surface.diagonal:
        X, normal, average, patch = _surface_footprint(surface, site, nearest, facets)
        _check_free(elasticity, site, average)
        average = _over_facets(surface, site, X, normal, patch) or average
        slope = (_disc_slope if site.fibre is None else _half_ball_slope)(surface, site, X, normal, patch)
    else:
        X, normal = np.asarray(site.point, float), np.full(3, np.nan)
        average, slope = _ball_footprint(surface, site, X, distance, nearest)
        _check_free(elasticity, site, average)
    return X, normal, value_rows(elasticity, average), gradient_rows(elasticity, surface, average, slope)


def _surface_footprint(
    surface: Surface, site: Site, X: Array, facets: Indices
) -> tuple[Array, Array, Average, Indices]:
    """Return point, outward normal, averaging points and surrounding facets of a surface site."""
    normal = _mean_normal(site, surface.normals[facets], np.full(facets.size, 1.0 / facets.size))
    if site.radius == 0.0:
        cells = surface.behind[facets]
        reference = surface.reference(np.broadcast_to(X, (cells.size, 3)), cells)
        return X, normal, Average(reference, cells, np.full(cells.size, 1.0 / cells.size)), facets
    rule = footprint.disc(site.weight)
    for _ in range(3):  # the disc is projected along the normal, and the normal is its average over the disc
        patch = surface.patch(X, facets, normal, 2.0 * site.radius)
        hits, struck = _cast(surface, site, X, normal, patch, rule.points)
        normal = _normal_below(surface, site, X, normal, patch, struck)
    _cast(surface, site, X, normal, patch, footprint.disc_slope("uniform").points * (1.0 - INSIDE))
    cells = surface.behind[struck]
    return X, normal, Average(surface.reference(hits, cells), cells, rule.weights), patch


def _normal_below(surface: Surface, site: Site, X: Array, normal: Array, patch: Indices, struck: Indices) -> Array:
    """Return the average of the outward normal over the disc.

    The average is taken facet by facet, so that the normal turns smoothly when the site moves. If
    the facets do not cover the disc once, the average is taken over the facets `struck` by lines.
    """
    covered = _cover(surface, site, X, normal, patch)
    if covered is None:
        return _mean_normal(site, surface.normals[struck], footprint.disc(site.weight).weights)
    _, cover = covered
    return _mean_normal(site, surface.normals[cover.triangles], cover.weights(site.weight))


def _cast(surface: Surface, site: Site, X: Array, normal: Array, patch: Indices, unit: Array) -> tuple[Array, Indices]:
    """Return points of the unit disc, projected on the surface, and their facets.

    The disc is placed at X, normal to `normal`.
    """
    axes = np.stack([*frame(normal), normal])
    hits, struck = surface.project(X + site.radius * unit @ axes, normal, patch, site.radius)
    if np.any(struck < 0):
        share = np.mean(struck < 0)
        raise TissueError(
            f"{site.name}: the footprint of radius {site.radius:g} m at {_show(X)} overhangs an edge of "
            f"the surface ({share:.0%} of it has no surface below); move the site inwards or take a smaller footprint"
        )
    return hits, struck


def _cover(
    surface: Surface, site: Site, X: Array, normal: Array, patch: Indices
) -> tuple[Array, footprint.Cover] | None:
    """Return the disc cut into its facets, with points on the planes of the facets, or None.

    The result is None for a bare point, if facets cover the disc twice, or if a facet is seen
    edge-on. Only lines along the normal can separate two facets that cover the same point.
    """
    if site.radius == 0.0:
        return None
    axes = np.stack(frame(normal))
    cover = footprint.cover((surface.triangles[patch] - X) @ axes.T / site.radius)
    points, facets = X + site.radius * cover.points @ axes, patch[cover.triangles]
    across = surface.normals[facets]
    facing = across @ normal
    if abs(cover.flat.sum() - 1.0) > COVERED or facing.min() < EDGE_ON:
        return None
    height = np.sum((surface.triangles[facets, 0] - points) * across, axis=1) / facing
    return points + height[:, None] * normal, replace(cover, triangles=facets)


def _over_facets(surface: Surface, site: Site, X: Array, normal: Array, patch: Indices) -> Average | None:
    """Return the average over a disc, or None if the facets do not cover the disc once.

    The average is exact for functions that are polynomial on each facet.
    """
    covered = _cover(surface, site, X, normal, patch)
    if covered is None:
        return None
    points, cover = covered
    cells = surface.behind[cover.triangles]
    return Average(surface.reference(points, cells), cells, cover.weights(site.weight))


def _disc_slope(surface: Surface, site: Site, X: Array, normal: Array, patch: Indices) -> AverageSlope:
    """Return the tangential gradient over the disc; empty for a bare point."""
    if site.radius == 0.0:
        return NO_SLOPE
    covered = _cover(surface, site, X, normal, patch) if site.weight == "parabolic" else None
    if covered is not None:
        points, cover = covered
        vectors = 4.0 * cover.flat[:, None] * cover.points
        return AverageSlope(points, surface.behind[cover.triangles], vectors @ np.stack(frame(normal)) / site.radius)
    rule = footprint.disc_slope(site.weight)
    hits, struck = _cast(surface, site, X, normal, patch, rule.points * (1.0 - INSIDE))
    return AverageSlope(hits, surface.behind[struck], rule.vectors @ np.stack([*frame(normal), normal]) / site.radius)


def _half_ball_slope(surface: Surface, site: Site, X: Array, normal: Array, patch: Indices) -> AverageSlope:
    """Return the gradient over the part of the ball inside the body; empty for a bare point."""
    if site.radius == 0.0:
        return NO_SLOPE
    rule, axes = footprint.half_ball_slope(site.weight), np.stack([*frame(normal), normal])
    lid = rule.points[:, 2] == 0.0
    hits, struck = _cast(surface, site, X, normal, patch, rule.points[lid])
    inner = X + site.radius * (1.0 - INSIDE) * rule.points[~lid] @ axes
    cells = surface.containing(inner)
    held, vectors = cells >= 0, rule.vectors @ axes / site.radius
    points = np.vstack([hits, inner[held]])
    vectors = np.vstack([vectors[lid], vectors[~lid][held]])
    return AverageSlope(points, np.concatenate([surface.behind[struck], cells[held]]), _consistent(points, vectors))


def _consistent(points: Array, vectors: Array) -> Array:
    """Return the vectors with the smallest change such that Σ c = 0 and Σ x cᵀ = I.

    Linear fields are then exact. On a flat surface the vectors do not change. On a curved or thin
    body, part of the half ball is missing. The change then adds the slope of the linear field that
    fits best in the mean square.
    """
    vectors = vectors - vectors.mean(axis=0)
    offset = points - points.mean(axis=0)
    missing = np.eye(3) - offset.T @ vectors
    return vectors + offset @ np.linalg.solve(offset.T @ offset, missing)


def _ball_footprint(
    surface: Surface, site: Site, X: Array, distance: float, nearest: Array
) -> tuple[Average, AverageSlope]:
    """Return the points of the averages of value and gradient of a site inside the body."""
    sharing = surface.sharing(X)
    if sharing.size == 0:
        raise TissueError(
            f"{site.name}: {_show(X)} is outside the organ, {distance:.3g} m from its surface; "
            f"the nearest surface point is {_show(nearest)}"
        )
    if isinstance(site.direction, str):
        raise TissueError(
            f"{site.name}: direction = 'normal' at {_show(X)}, {distance:.3g} m inside the organ, "
            f"where there is no normal; give a vector, or move the site to the surface at {_show(nearest)}"
        )
    if site.radius == 0.0:
        reference = surface.reference(np.broadcast_to(X, (sharing.size, 3)), sharing)
        return Average(reference, sharing, np.full(sharing.size, 1.0 / sharing.size)), NO_SLOPE
    rule, slope = footprint.ball(site.weight), footprint.ball_slope(site.weight)
    points = X + site.radius * (1.0 - INSIDE) * np.vstack([rule.points, slope.points])
    cells = surface.containing(points)
    if site.radius * (1.0 - INSIDE) > distance or np.any(cells < 0):
        raise TissueError(
            f"{site.name}: the footprint of radius {site.radius:g} m at {_show(X)} reaches out of the "
            f"organ, whose surface is {distance:.3g} m away; take a smaller footprint or move the site to the "
            f"surface at {_show(nearest)}"
        )
    k, reference = rule.weights.size, surface.reference(points, cells)
    vectors = _consistent(points[k:], slope.vectors / site.radius)
    return Average(reference[:k], cells[:k], rule.weights), AverageSlope(points[k:], cells[k:], vectors)


def _mean_normal(site: Site, normals: Array, weights: Array) -> Array:
    mean = weights @ normals
    length = float(np.linalg.norm(mean))
    if length < 0.5:
        raise TissueError(
            f"{site.name}: the surface below the footprint turns by more than a right angle, so that its "
            "normal is not defined; move the site or take a smaller footprint"
        )
    return mean / length


def _check_free(elasticity: Elasticity, site: Site, average: Average) -> None:
    """Raise `TissueError` for a site that touches a clamped boundary.

    At a point on a clamped boundary, or in a cell with all nodes clamped, every unknown along an
    axis is clamped.
    """
    phi, _ = shapes(elasticity.cell, average.reference)
    held = np.isin(elasticity.basis.element_dofs[:, average.cells], elasticity.clamped).reshape(len(phi), 3, -1)
    if np.any(np.einsum("nk,nak->ak", phi, held.astype(float)) >= 1.0 - INSIDE):
        raise TissueError(
            f"{site.name}: the footprint at {_show(np.asarray(site.point, float))} touches a clamped "
            "boundary, which cannot move; move the site, take a smaller footprint or release the boundary"
        )


def _show(point: Array) -> str:
    return "[" + ", ".join(f"{x:.6g}" for x in point) + "]"
