"""Marking of too large cells.

At first the distance of a cell from the holes decides, and then its contribution to the error.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from skfem import MeshTet

from tissue.arrays import Array, Indices
from tissue.sites.site import Site
from tissue.sites.surface import ON_SURFACE, Surface, closest_on_triangles, outer_surface

ORDER = {"P1": 2.0, "P2": 4.0}  # of the compliance error in the size of cells
REACHED = 0.03  # error of a compliance at the sizes of `Sizes`
THINNEST = 0.4  # of the radius: thinner layers are refined by the estimate only
BULK = 0.7  # largest share of the marked cells in the sum of the indicators (Dörfler, SIAM J. Numer. Anal. 33, 1996)
SAFETY = 0.95  # of the error asked: a further round is expensive, and the errors of all holes do not decrease alike
ALIKE = 1e-6  # of an indicator: cells that differ by less are mirror images and are marked together


class Sizes(NamedTuple):
    """Sizes of cells at which the compliance of a hole has the error REACHED.

    They are those of cells over the footprint's radius: on a half-space, `on_surface`; at a ball
    `inside`, whose force is distributed over a volume; and at a ball `in_line` with others, where
    several have the same cells. The size grows with the distance by `growth`. Below REACHED the error
    has the `order` in the size.
    """

    on_surface: float
    inside: float
    in_line: float
    growth: float
    order: float


# Bisected cells are between half the wanted size and the whole, and need up to twice as many unknowns
# for the same error as generated ones, whose edges have the wanted size. P1 comes near to REACHED in
# two rounds. Below REACHED generated cells need a smaller growth too. Bisected cells do not, because
# their neighbours are cut as well.
BISECTED = {"P1": Sizes(0.2, 0.2, 0.2, 0.4, 2.0), "P2": Sizes(0.6, 1.05, 1.05, 0.8, 4.0)}
GENERATED = {"P1": Sizes(0.15, 0.15, 0.15, 0.3, 2.0), "P2": Sizes(0.4, 0.45, 0.7, 0.7, 2.6)}


@dataclass(frozen=True)
class Zone:
    """Cells of a `size` [m] within a `radius` [m] of a `centre` (3,) [m], and a `growth` of the size with the distance.

    `axis` (3,) is the normal of a disc on the surface. It is NaN for a ball inside.
    """

    centre: Array
    axis: Array
    radius: float
    size: float
    growth: float


def zones(
    mesh: MeshTet, element: str, accuracy: float, sites: Sequence[Site], sizes: Mapping[str, Sizes] = GENERATED
) -> list[Zone]:
    """Return the zones of small cells around the holes at `sites`; bare points have none.

    They are used before an error is known. The compliance of the holes is to have a relative
    `accuracy` [-]. `sizes` depend on how the cells are made.

    A region of the mesh that begins or ends within the radius of a surface hole is a thin layer
    there. Such a layer needs proportionally smaller cells.
    """
    over = sizes[element]
    looser = (accuracy / REACHED) ** (1.0 / (ORDER[element] if accuracy > REACHED else over.order))
    surface = outer_surface(mesh)
    out, layers = [], borders(mesh)
    for site in (site for site in sites if site.radius > 0.0):
        point, axis = place(surface, site)
        if np.isfinite(axis).all():
            depth = np.linalg.norm(closest_on_triangles(point, layers) - point, axis=1).min(initial=site.radius)
            least = over.on_surface * max(depth, THINNEST * site.radius)
        else:
            least = (over.in_line if site.line else over.inside) * site.radius
        out.append(Zone(point, axis, site.radius, looser * least, min(looser, 1.0) * over.growth))
    return out


def wanted(mesh: MeshTet, element: str, accuracy: float, sites: Sequence[Site]) -> Callable[[Array], Array]:
    """Return a function that returns the largest allowed size [m] of bisected cells.

    The cells have corners `(c, 4, 3)`. Arguments are as in `zones`.
    """
    around, growth = zones(mesh, element, accuracy, sites, BISECTED), BISECTED[element].growth

    def size(corners: Array) -> Array:
        middle, own = corners.mean(axis=1), 0.5 * np.cbrt(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])))
        each = [z.size + growth * np.maximum(away(middle, z) - own, 0.0) for z in around]
        return np.asarray(np.min(each, axis=0, initial=np.inf))

    return size


def borders(mesh: MeshTet) -> Array:
    """Return the facets between regions of a mesh, shape `(b, 3, 3)` [m]."""
    part = np.zeros(mesh.nelements, np.intp)
    for number, cells in enumerate((mesh.subdomains or {}).values(), start=1):
        part[cells] = number
    inner = np.flatnonzero(mesh.f2t[1] >= 0)
    between = inner[part[mesh.f2t[0, inner]] != part[mesh.f2t[1, inner]]]
    return np.asarray(mesh.p.T[mesh.facets[:, between].T])


def place(surface: Surface, site: Site) -> tuple[Array, Array]:
    """Return the located point (3,) [m] of a site, and the outward normal there.

    The normal is NaN for a site inside the body.
    """
    point = np.asarray(site.point, float)
    distance, nearest, facets = surface.nearest(point)
    if distance > ON_SURFACE * surface.diagonal:
        return point, np.full(3, np.nan)
    normal = surface.normals[facets].mean(axis=0)
    return nearest, normal / np.linalg.norm(normal)


def away(points: Array, zone: Zone) -> Array:
    """Return the distance of points `(k, 3)` from the disc or the ball of a zone, `(k,)` [m]."""
    offset = points - zone.centre
    height = offset @ zone.axis if np.isfinite(zone.axis).all() else np.zeros(len(points))
    across = np.sqrt(np.maximum(np.sum(offset**2, axis=1) - height**2, 0.0))
    return np.asarray(np.hypot(height, np.maximum(across - zone.radius, 0.0)))


def share_to_mark(element: str, excess: float) -> float:
    """Return the share of the marked cells in the sum of the indicators, at most BULK.

    The errors are larger than asked by the factor `excess` (> 1). A bisection halves the volume of
    a cell, so that an indicator of order p in the size becomes smaller by the factor 2^(p/3).
    """
    return min(BULK, (1.0 - SAFETY / excess) / (1.0 - 2.0 ** (-ORDER[element] / 3.0)))


def marked(mesh: MeshTet, indicators: Array, share: float = BULK, mirror: int | None = None) -> Indices:
    """Return the cells with the largest `indicators` `(c,)`.

    Together they have the given `share` of the sum of the indicators. Cells with an equal indicator
    are included. The mirror images of all these cells about the plane normal to the axis `mirror`
    are included too. `mirror` is None if the mesh need not stay symmetric.
    """
    falling = np.sort(indicators)[::-1]
    least = falling[np.searchsorted(np.cumsum(falling), share * falling.sum())]
    cells = np.flatnonzero(indicators >= (1.0 - ALIKE) * least)
    if mirror is None:
        return cells
    middles, signs = mesh.p[:, mesh.t].mean(axis=1).T, np.ones(3)
    signs[mirror] = -1.0
    return np.union1d(cells, cKDTree(middles).query(middles[cells] * signs)[1])
