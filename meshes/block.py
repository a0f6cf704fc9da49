"""Rectangular blocks, centred in x and y, with the top face at z = 0.

The boundaries are left, right, front, back, bottom and top. The structured blocks need only numpy.
Each cell of a tensor grid is cut into five tetrahedra: one on four alternate corners, and one at
each of the other four corners. The pattern is mirrored from cell to cell, so that faces match and
no diagonal direction is preferred. Cell counts are even. Therefore the mesh is mirror symmetric if
its grid lines are, and every grid line through a site has the same pattern.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import skfem
from numpy.typing import ArrayLike, NDArray

from meshes.errors import MeshError
from meshes.gmsh_session import generate, in_unit, session
from meshes.grading import Grading, Gradings, require_positive, site_points
from meshes.named import bare_mesh, with_boundaries

Array = NDArray[np.float64]

# Five tetrahedra of a cell with an even corner at (0, 0, 0), given by corners (x, y, z), with
# positive volumes.
EVEN_SPLIT = (
    ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 0)),
    ((1, 0, 0), (0, 0, 0), (1, 0, 1), (1, 1, 0)),
    ((0, 1, 0), (1, 1, 0), (0, 1, 1), (0, 0, 0)),
    ((0, 0, 1), (1, 0, 1), (0, 0, 0), (0, 1, 1)),
    ((1, 1, 1), (0, 1, 1), (1, 1, 0), (1, 0, 1)),
)
# The tetrahedra of a cell with an odd corner at (0, 0, 0): the mirror image.
ODD_SPLIT = (
    ((1, 1, 1), (1, 0, 0), (0, 0, 1), (0, 1, 0)),
    ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((1, 1, 0), (0, 1, 0), (1, 0, 0), (1, 1, 1)),
    ((1, 0, 1), (0, 0, 1), (1, 1, 1), (1, 0, 0)),
    ((0, 1, 1), (1, 1, 1), (0, 0, 1), (0, 1, 0)),
)
# Boundary name → (axis, whether at the upper end).
FACES = {
    "left": (0, False),
    "right": (0, True),
    "front": (1, False),
    "back": (1, True),
    "bottom": (2, False),
    "top": (2, True),
}

Planes = tuple[Sequence[float], Sequence[float], Sequence[float]]  # coordinates of planes with facets, by axis [m]
NO_PLANES: Planes = ((), (), ())
COUNTABLE = 1e9  # tetrahedra: an organ with more does not fit into memory, and even its grid lines could fill it
ON_PLANE = 1e-9  # of the block's size: a node nearer to a plane lies in it; gmsh places nodes to 1e-16


def block(size: Sequence[float], h: float, planes: Planes = NO_PLANES) -> skfem.MeshTet:
    """Return a uniform structured mesh of a block of size `(3,)` [m].

    The edges of cells along the axes are at most `h` [m]. Cell counts are even, so that a side has
    at least two cells. Raises `MeshError` if a size or `h` is not positive and finite.
    """
    return graded_block_structured(size, Grading(h, h), planes=planes)


def graded_block_structured(
    size: Sequence[float], grading: Grading, sites: ArrayLike = (), planes: Planes = NO_PLANES
) -> skfem.MeshTet:
    """Return a structured mesh of a block with grid lines through the sites and along the planes.

    Sites have shape `(p, 3)` [m]. `grading` gives the spacing in each coordinate. At a site between
    two intervals the spacing is a little larger. Between planes it is smaller, because at least two
    cells lie there. The mesh is a tensor grid and is therefore fine along the whole planes through
    a site. Coordinates of sites share a line if they are closer than `h_site`/2 to each other or to
    a face. The same input gives the same arrays.

    Raises `MeshError` for impossible numbers and for a site outside the block.
    """
    lower, upper = extent(size)
    lines = block_lines(size, grading, sites, planes)
    return with_faces(bare_mesh(grid_points(lines), split(lines)), lower, upper)


def block_lines(size: Sequence[float], grading: Grading, sites: ArrayLike, planes: Planes) -> list[Array]:
    """Return the grid coordinates along x, y and z of the structured block [m]."""
    lower, upper = extent(size)
    points = require_sites_within(sites, lower, upper)
    return [graded_lines(lower[k], upper[k], points[:, k], grading, planes[k]) for k in range(3)]


def structured_tets(size: Sequence[float], grading: Grading, sites: ArrayLike, planes: Planes = NO_PLANES) -> float:
    """Return the number of tetrahedra of the structured block without making them.

    A very large number is replaced by a lower bound.
    """
    least = _least_tets(size, grading, sites)
    if least > COUNTABLE:
        return least
    return 5 * float(np.prod([float(len(line) - 1) for line in block_lines(size, grading, sites, planes)]))


def _least_tets(size: Sequence[float], grading: Grading, sites: ArrayLike) -> float:
    """Return a lower bound of the number of tetrahedra.

    It is computed from the sizes far from the sites and at the sites.
    """
    lower, upper = extent(size)
    fine = min(grading.flat, float(np.min(upper - lower))) / grading.h_site if np.size(sites) else 0.0
    with np.errstate(over="ignore"):
        return 5 * float(np.prod(np.maximum((upper - lower) / grading.h, max(fine, 2.0))))


def graded_block_gmsh(
    size: Sequence[float], grading: Gradings, sites: ArrayLike = (), planes: Planes = NO_PLANES
) -> skfem.MeshTet:
    """Return an unstructured mesh of a block by gmsh, with facets along the planes.

    The size of elements depends on the distance to the nearest site, shape `(p, 3)` [m]. Raises
    `MeshError` for impossible numbers, for a site outside the block, and if gmsh cannot load.
    """
    lower, upper = extent(size)
    points, unit = require_sites_within(sites, lower, upper), max(size)
    with session() as gmsh:
        add_box(gmsh, lower, upper, planes, unit)
        gmsh.model.occ.synchronize()
        return with_faces(generate(gmsh, grading, points, unit), lower, upper)


def extent(size: Sequence[float]) -> tuple[Array, Array]:
    """Return the lower and upper corner of the block of a size, shapes `(3,)` [m].

    Raises `MeshError` for impossible sizes.
    """
    if len(size) != 3:
        raise MeshError(f"size = {list(size)!r} must have three lengths, x, y and z")
    x, y, z = (require_positive(f"size[{k}]", length) for k, length in enumerate(size))
    return np.array([-x / 2, -y / 2, -z]), np.array([x / 2, y / 2, 0.0])


def require_sites_within(sites: ArrayLike, lower: Array, upper: Array) -> Array:
    """Return the sites, shape `(p, 3)` [m].

    Raises `MeshError` for a site outside the box by more than round-off.
    """
    points = site_points(sites)
    slack = 1e-9 * float(np.max(upper - lower))
    for site in points[((points < lower - slack) | (points > upper + slack)).any(axis=1)]:
        raise MeshError(f"site {site.tolist()} is outside the block from {lower.tolist()} to {upper.tolist()} [m]")
    return np.clip(points, lower, upper)


def even_count(cells: float) -> int:
    """Return the smallest even number of cells, at least 2, that is not below `cells`.

    Round-off above an even number is ignored.
    """
    return 2 * max(1, int(np.ceil(cells / 2 - 1e-9)))


def graded_lines(lower: float, upper: float, sites: Array, grading: Grading, planes: Sequence[float] = ()) -> Array:
    """Return grid coordinates from `lower` to `upper` [m] with the planes, graded toward the sites.

    Sites are coordinates, shape `(p,)`. The number of cells between planes and sites is even.
    """
    fixed = np.unique([lower, *planes_between(planes, lower, upper), upper])
    stations = _stations(fixed, sites, grading.h_site)
    stops = np.union1d(fixed, stations)
    return np.concatenate([*(_spaced(a, b, stations, grading)[:-1] for a, b in pairwise(stops)), [upper]])


def planes_between(planes: Sequence[float], lower: float, upper: float) -> Array:
    """Return the sorted coordinates [m] of planes between two ends.

    Planes within round-off of an end are left out.
    """
    places = np.unique(np.asarray(planes, dtype=float))
    slack = ON_PLANE * (upper - lower)
    return places[(places > lower + slack) & (places < upper - slack)]


def _stations(fixed: Array, sites: Array, h_site: float) -> Array:
    """Return the coordinates of the sites, with near ones merged.

    Sites within h_site/2 of one another or of a `fixed` line are merged.
    """
    groups: list[list[float]] = []
    for x in np.unique(sites):
        if groups and x - groups[-1][0] <= h_site / 2:
            groups[-1].append(float(x))
        else:
            groups.append([float(x)])
    middles = np.array([(group[0] + group[-1]) / 2 for group in groups])
    nearest = fixed[np.abs(middles[:, None] - fixed).argmin(axis=1)] if len(middles) else middles
    return np.unique(np.where(np.abs(middles - nearest) <= h_site / 2, nearest, middles))


def _spaced(a: float, b: float, stations: Array, grading: Grading) -> Array:
    """Return the coordinates from `a` to `b` [m].

    The spacing depends on the distance to the nearest station. There is no station between `a` and
    `b`.
    """
    if not len(stations):
        return np.linspace(a, b, 1 + even_count((b - a) / grading.h))
    left = max(stations[stations <= a], default=-np.inf)
    right = min(stations[stations >= b], default=np.inf)
    middle = float(np.clip((left + right) / 2, a, b)) if np.isfinite(left + right) else (b if right == np.inf else a)
    begun, ended = (float(grading.cells(d)) if np.isfinite(d) else 0.0 for d in (a - left, right - b))
    from_left = float(grading.cells(middle - left)) - begun if middle > a else 0.0
    from_right = float(grading.cells(right - middle)) - ended if middle < b else 0.0
    n = np.linspace(0.0, from_left + from_right, 1 + even_count(from_left + from_right))
    rising = left + grading.distance(begun + n) if from_left else np.full(len(n), a)
    falling = right - grading.distance(ended + n[::-1]) if from_right else np.full(len(n), b)
    lines = np.where(n <= from_left, rising, falling)
    lines[0], lines[-1] = a, b
    return lines


def grid_points(lines: list[Array]) -> Array:
    """Return the nodes of the tensor grid of three coordinate lists, `(nx ny nz, 3)` [m].

    z varies fastest.
    """
    return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)


def split(lines: list[Array], mirrored: bool = False) -> NDArray[np.int64]:
    """Return five tetrahedra for each cell of a tensor grid, shape `(5 cells, 4)`."""
    strides = np.array([len(lines[1]) * len(lines[2]), len(lines[2]), 1])  # of the nodes; z varies fastest
    x, y, z = np.ix_(*(np.arange(len(line) - 1) for line in lines))
    first = (x * strides[0] + y * strides[1] + z).ravel()
    odd = ((x + y + z + mirrored) % 2 == 1).ravel()
    steps = np.array([EVEN_SPLIT, ODD_SPLIT]) @ strides
    return np.asarray(first[:, None, None] + steps[odd.astype(np.intp)], dtype=np.int64).reshape(-1, 4)


def with_faces(mesh: skfem.MeshTet, lower: Array, upper: Array) -> skfem.MeshTet:
    """Return the mesh with a named boundary on each of the block's faces."""
    facets = mesh.boundary_facets()
    corners = mesh.p[:, mesh.facets[:, facets]]
    slack = ON_PLANE * float(np.max(upper - lower))
    named = {
        name: facets[(np.abs(corners[axis] - (upper if at_upper else lower)[axis]) <= slack).all(axis=0)]
        for name, (axis, at_upper) in FACES.items()
    }
    return with_boundaries(mesh, named)


def add_box(gmsh: Any, lower: Array, upper: Array, planes: Planes, unit: float) -> None:
    """Add a box to the gmsh model, cut along planes so that facets follow the planes.

    `unit` is the unit of length of the model [m].
    """
    box = gmsh.model.occ.addBox(*in_unit([*lower, *(upper - lower)], unit))
    cuts = [
        add_polygon(gmsh, _rectangle(lower, upper, axis, place), unit)
        for axis in range(3)
        for place in planes_between(planes[axis], lower[axis], upper[axis])
    ]
    if cuts:
        gmsh.model.occ.fragment([(3, box)], [(2, cut) for cut in cuts])


def add_polygon(gmsh: Any, corners: ArrayLike, unit: float) -> int:
    """Add a plane polygon to the gmsh model of a `unit` [m], and return its tag.

    The `corners` `(k, 3)` [m] are in order.
    """
    points = [gmsh.model.occ.addPoint(*corner) for corner in in_unit(corners, unit)]
    lines = [gmsh.model.occ.addLine(a, b) for a, b in pairwise([*points, points[0]])]
    return int(gmsh.model.occ.addPlaneSurface([gmsh.model.occ.addCurveLoop(lines)]))


def _rectangle(lower: Array, upper: Array, axis: int, place: float) -> Array:
    """Return the section of the box normal to an axis at a coordinate, four corners in order, `(4, 3)`."""
    first, second = (k for k in range(3) if k != axis)
    corners = np.full((4, 3), place)
    corners[:, first] = lower[first], upper[first], upper[first], lower[first]
    corners[:, second] = lower[second], lower[second], upper[second], upper[second]
    return corners
