"""Rectangular blocks, centred in x and y, the top face at z = 0, boundaries left right front back bottom top.

The structured ones need numpy alone. Each cell of a tensor grid is cut into five tetrahedra, one on four
alternate corners and one at each of the other four, mirrored from cell to cell: faces match, and no
diagonal direction is preferred. Cell counts are even, so that the mesh is mirror symmetric where its lines
are, and every line through a site sees the same pattern.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import skfem
from numpy.typing import ArrayLike, NDArray

from meshes.errors import MeshError
from meshes.gmsh_session import generate, session
from meshes.grading import Grading, positive, site_points
from meshes.named import bare_mesh

Array = NDArray[np.float64]

# Five tetrahedra of a cell with an even corner at (0, 0, 0), as corners (x, y, z); positive volumes.
EVEN_SPLIT = (
    ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 0)),
    ((1, 0, 0), (0, 0, 0), (1, 0, 1), (1, 1, 0)),
    ((0, 1, 0), (1, 1, 0), (0, 1, 1), (0, 0, 0)),
    ((0, 0, 1), (1, 0, 1), (0, 0, 0), (0, 1, 1)),
    ((1, 1, 1), (0, 1, 1), (1, 1, 0), (1, 0, 1)),
)
# The same for a cell with an odd corner at (0, 0, 0): its mirror image.
ODD_SPLIT = (
    ((1, 1, 1), (1, 0, 0), (0, 0, 1), (0, 1, 0)),
    ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((1, 1, 0), (0, 1, 0), (1, 0, 0), (1, 1, 1)),
    ((1, 0, 1), (0, 0, 1), (1, 1, 1), (1, 0, 0)),
    ((0, 1, 1), (1, 1, 1), (0, 0, 1), (0, 1, 0)),
)
# Boundary name → (axis, at the upper end?).
FACES = {
    "left": (0, False),
    "right": (0, True),
    "front": (1, False),
    "back": (1, True),
    "bottom": (2, False),
    "top": (2, True),
}


def block(size: Sequence[float], h: float) -> skfem.MeshTet:
    """Uniform structured block: size `(3,)` [m], cell edges at most `h` [m]; even counts, so at least two
    cells a side.

    Raises `MeshError` when a size or `h` is not positive and finite.
    """
    lower, upper = extent(size)
    positive("h", h)
    return _tensor_mesh([np.linspace(a, b, 1 + even((b - a) / h)) for a, b in zip(lower, upper, strict=True)])


def graded_block_structured(
    size: Sequence[float],
    h: float,
    h_site: float,
    sites: ArrayLike,
    growth: float = 1.3,
    radius: float = 0.0,
) -> skfem.MeshTet:
    """Structured block whose grid lines pass through the sites, shape `(p, 3)` [m], spaced `h_site` there
    and `h` far off [m].

    Spacing is `h_site` within `radius` [m] of a site's coordinate and grows by at most `growth` from line
    to line (a little more across a site, where two intervals meet). Being a tensor grid it is fine along
    the whole planes through a site, not near it alone. Coordinates of sites closer than `h_site`/2 to each
    other or to a face share a line. Same input, same arrays.

    Raises `MeshError` for impossible numbers and for a site outside the block.
    """
    grading = Grading(h, h_site, growth, radius)
    lower, upper = extent(size)
    points = sites_within(sites, lower, upper)
    return _tensor_mesh([graded_lines(lower[k], upper[k], points[:, k], grading) for k in range(3)])


def graded_block_gmsh(
    size: Sequence[float],
    h: float,
    h_site: float,
    sites: ArrayLike,
    growth: float = 1.3,
    radius: float = 0.0,
) -> skfem.MeshTet:
    """Unstructured block by gmsh, element size `h_site` within `radius` [m] of each site, shape `(p, 3)`
    [m], and `h` far off [m].

    The size grows linearly with the distance, by ln(growth) per metre, that is by about `growth` from
    element to element.

    Raises `MeshError` for impossible numbers, for a site outside the block, and where gmsh cannot load.
    """
    grading = Grading(h, h_site, growth, radius)
    lower, upper = extent(size)
    points = sites_within(sites, lower, upper)
    with session() as gmsh:
        gmsh.model.occ.addBox(*lower, *(upper - lower))
        gmsh.model.occ.synchronize()
        _name_faces(gmsh, lower, upper)
        return generate(gmsh, grading, points)


def extent(size: Sequence[float]) -> tuple[Array, Array]:
    """Lower and upper corner of the block of a size, shapes `(3,)` [m]."""
    if len(size) != 3:
        raise MeshError(f"size = {list(size)!r} must have three lengths, x, y and z")
    x, y, z = (positive(f"size[{k}]", length) for k, length in enumerate(size))
    return np.array([-x / 2, -y / 2, -z]), np.array([x / 2, y / 2, 0.0])


def sites_within(sites: ArrayLike, lower: Array, upper: Array) -> Array:
    """Sites, shape `(p, 3)` [m], or `MeshError` for one outside the box by more than round-off."""
    points = site_points(sites)
    slack = 1e-9 * float(np.max(upper - lower))
    for site in points[((points < lower - slack) | (points > upper + slack)).any(axis=1)]:
        raise MeshError(f"site {site.tolist()} is outside the block from {lower.tolist()} to {upper.tolist()} [m]")
    return np.clip(points, lower, upper)


def even(cells: float) -> int:
    """Smallest even number of cells that is not below `cells`, at least 2; a surplus of round-off is no
    cell.
    """
    return 2 * max(1, int(np.ceil(cells / 2 - 1e-9)))


def graded_lines(lower: float, upper: float, sites: Array, grading: Grading) -> Array:
    """Grid coordinates from `lower` to `upper` [m], graded toward the sites' coordinates, shape `(p,)`."""
    stations = _stations(lower, upper, sites, grading.h_site)
    if not len(stations):
        return np.linspace(lower, upper, 1 + even((upper - lower) / grading.h))
    pieces = [
        *([stations[0] - _outward(stations[0] - lower, grading)[::-1]] if stations[0] > lower else []),
        *(a + _between(b - a, grading) for a, b in pairwise(stations)),
        *([stations[-1] + _outward(upper - stations[-1], grading)] if stations[-1] < upper else []),
    ]
    return np.concatenate([*(piece[:-1] for piece in pieces), [upper]])


def _stations(lower: float, upper: float, sites: Array, h_site: float) -> Array:
    """Coordinates a grid line must pass through: sites, those within h_site/2 of one another or of an end
    merged.
    """
    groups: list[list[float]] = []
    for x in np.unique(sites):
        if groups and x - groups[-1][0] <= h_site / 2:
            groups[-1].append(float(x))
        else:
            groups.append([float(x)])
    middles = np.array([(group[0] + group[-1]) / 2 for group in groups])
    middles[middles - lower <= h_site / 2] = lower
    middles[upper - middles <= h_site / 2] = upper
    return np.unique(middles)


def _outward(length: float, grading: Grading) -> Array:
    """Distances from a site to an end, from 0 to `length` [m]."""
    total = float(grading.cells(length))
    distances = grading.distance(np.linspace(0.0, total, 1 + even(total)))
    distances[-1] = length
    return distances


def _between(length: float, grading: Grading) -> Array:
    """Distances from one site to the next, from 0 to `length` [m], symmetric about the middle."""
    half = _half(length / 2, grading)
    return np.concatenate([half, length - half[-2::-1]])


def _half(length: float, grading: Grading) -> Array:
    total = float(grading.cells(length))
    distances = grading.distance(np.linspace(0.0, total, 1 + even(2 * total) // 2))
    distances[-1] = length
    return distances


def _tensor_mesh(lines: list[Array]) -> skfem.MeshTet:
    """Mesh of the tensor grid of three coordinate lists, its six faces named."""
    points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    mesh = bare_mesh(points, _split([len(line) for line in lines]))
    return mesh.with_boundaries(_faces(mesh, [(line[0], line[-1]) for line in lines]))


def _split(nodes: list[int]) -> NDArray[np.int64]:
    """Five tetrahedra per cell of a grid of `(nx, ny, nz)` nodes, shape `(5 cells, 4)`."""
    cells = np.stack(np.meshgrid(*(np.arange(n - 1) for n in nodes), indexing="ij"), axis=-1).reshape(-1, 1, 1, 3)
    odd = cells.sum(axis=-1, keepdims=True) % 2 == 1
    corners = cells + np.where(odd, np.array(ODD_SPLIT), np.array(EVEN_SPLIT))
    tets = np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), tuple(nodes))
    return np.asarray(tets, dtype=np.int64).reshape(-1, 4)


def _faces(mesh: skfem.MeshTet, ends: list[tuple[float, float]]) -> dict[str, NDArray[np.integer]]:
    """Boundary facets on each face of the grid; end coordinates are exact, so equality is meant."""
    facets = mesh.boundary_facets()
    corners = mesh.p[:, mesh.facets[:, facets]]
    return {name: facets[(corners[axis] == ends[axis][upper]).all(axis=0)] for name, (axis, upper) in FACES.items()}


def _name_faces(gmsh: Any, lower: Array, upper: Array) -> None:
    """Physical groups for the six faces of the only box in the gmsh model, by their centres."""
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], name="block")
    centres = {tag: np.array(gmsh.model.occ.getCenterOfMass(2, tag)) for _, tag in gmsh.model.getEntities(2)}
    for name, (axis, at_upper) in FACES.items():
        target = (upper if at_upper else lower)[axis]
        tag = min(centres, key=lambda t: abs(centres[t][axis] - target))
        gmsh.model.addPhysicalGroup(2, [tag], name=name)
