"""Graded tetrahedra in closed triangulated surfaces (STL, OBJ, PLY, VTK PolyData), by gmsh.

gmsh does not finish on some surfaces that cross themselves. Each surface is therefore checked here
first.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import skfem
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from meshes.checks import check_span
from meshes.child import call_in_child
from meshes.errors import MeshError
from meshes.facets import six_volumes
from meshes.file import meshio_data, scaled
from meshes.gmsh_session import generate, in_unit, session
from meshes.grading import Grading, site_points
from meshes.groups import cells_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FORMATS = (".stl", ".obj", ".ply", ".vtp")  # and .vtk with PolyData
POLYDATA = (".vtp", ".vtk")  # read by VTK, because meshio only reads volume meshes of these formats
WELD = 1e-7  # of the surface's diagonal: nodes closer than this are merged; STL repeats corners in single precision
SHARP = 40.0  # degrees between facets: with a larger angle their common edge stays an edge of the organ
BLOCK = 2_000_000  # pairs of triangles that are tested together, to limit memory


@dataclass(frozen=True)
class Skin:
    """A closed surface that does not cross itself, as made by `read_surface`.

    It has points `(n, 3)` [m] and triangles `(m, 3)`.
    """

    points: Array
    triangles: Indices

    @property
    def volume(self) -> float:
        """Volume inside [m³], Σ ± a·(b × c)/6.

        The signs make the orientation of all triangles equal.
        """
        a, b, c = np.moveaxis(self.points[self.triangles], 1, 0)
        return abs(float(_turns(self.triangles) @ np.einsum("ij,ij->i", a, np.cross(b, c)))) / 6


def read_surface(path: str | Path, metres_per_unit: float) -> Skin:
    """Return the surface of a file; `metres_per_unit` is the length of one file unit [m].

    Raises `MeshError` with the name of the file if the file cannot be read, or if the surface is
    open, is not a manifold, has several pieces or crosses itself.
    """
    try:
        points, triangles = welded(*_triangles(Path(path)))
        check_closed(points, triangles)
        check_simple(points, triangles)
        check_span(points := scaled(points, metres_per_unit))
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from error
    return Skin(points, triangles)


def fill(skin: Skin, grading: Grading, sites: ArrayLike = ()) -> skfem.MeshTet:
    """Return a mesh of the inside of a surface by gmsh, graded toward sites `(p, 3)` [m].

    The mesh has the boundary "surface". The surface is cut into patches at its sharp edges. Each
    patch is triangulated again with nodes on the given facets. Raises `MeshError` if gmsh fails.
    """
    unit = float(np.ptp(skin.points, axis=0).max())
    with session() as gmsh:
        tag = gmsh.model.addDiscreteEntity(2)
        gmsh.model.mesh.addNodes(2, tag, np.arange(1, len(skin.points) + 1), in_unit(skin.points, unit).ravel())
        gmsh.model.mesh.addElementsByType(tag, 2, [], (skin.triangles + 1).ravel())
        try:
            gmsh.model.mesh.classifySurfaces(np.radians(SHARP), True, True, np.pi)
            gmsh.model.mesh.createGeometry()
        except Exception as error:  # gmsh raises no more specific error
            raise MeshError(f"gmsh finds no geometry in the surface: {error}; remesh it more evenly") from error
        loop = gmsh.model.geo.addSurfaceLoop([entity for _, entity in gmsh.model.getEntities(2)])
        gmsh.model.geo.addVolume([loop])
        gmsh.model.geo.synchronize()
        mesh = generate(gmsh, grading, site_points(sites), unit)
    return mesh.with_boundaries({"surface": mesh.boundary_facets()})


def welded(points: Array, triangles: Indices) -> tuple[Array, Indices]:
    """Return points and triangles with coincident nodes merged.

    Triangles that lose a corner are left out.
    """
    reach = WELD * float(np.linalg.norm(np.ptp(points, axis=0)))
    pairs = cKDTree(points).query_pairs(reach, output_type="ndarray")
    same = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    label = np.asarray(connected_components(same, directed=False)[1], dtype=np.int64)
    joined = label[triangles]
    whole = (joined != np.roll(joined, 1, axis=1)).all(axis=1)
    used, renumbered = np.unique(joined[whole], return_inverse=True)
    _, first = np.unique(label, return_index=True)
    return points[first[used]], np.asarray(renumbered, dtype=np.int64).reshape(-1, 3)


def check_closed(points: Array, triangles: Indices) -> None:
    """Raise `MeshError` for a surface that is not closed, not a manifold or in several pieces.

    In a closed manifold each edge belongs to two triangles. Points have shape `(n, 3)`, triangles
    `(m, 3)`.
    """
    if not len(triangles):
        raise MeshError("it has no triangle with three distinct corners: give a closed surface")
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    if (count > 2).any():
        where = points[unique[count > 2][0]].mean(axis=0)
        raise MeshError(
            f"its surface is not a manifold, {int((count > 2).sum())} edges belong to more than two triangles (the "
            f"first at {_show(where)}): delete inner walls and doubled facets"
        )
    if (count < 2).any():
        where = points[unique[count < 2][0]].mean(axis=0)
        raise MeshError(
            f"its surface is open, {int((count < 2).sum())} edges belong to one triangle only (the first at "
            f"{_show(where)}): close the holes"
        )
    joins = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(points),) * 2)
    pieces = connected_components(joins, directed=False)[0]
    if pieces > 1:
        raise MeshError(f"its surface has {pieces} separate pieces: keep the outer piece, one organ per file")


def check_simple(points: Array, triangles: Indices) -> None:
    """Raise `MeshError` for a surface that crosses or folds onto itself.

    Points have shape `(n, 3)`, triangles `(m, 3)`. Two triangles cross if an edge of one pierces
    the other. Neighbours fold if they lie on the same side of their common edge.
    """
    crossing = _crossing(points, triangles, _near_pairs(points, triangles))
    if len(crossing):
        where = points[triangles[crossing[0, 0]]].mean(axis=0)
        raise MeshError(
            f"its surface intersects itself in {len(crossing)} pairs of triangles (the first at {_show(where)}): "
            "repair it, for example by a union or a remesh in the program that made it"
        )


def _triangles(path: Path) -> tuple[Array, Indices]:
    """Return points `(n, 3)` and triangles `(m, 3)` of a surface file.

    Polygons with more corners are refused.
    """
    if path.suffix.lower() == ".ply" and path.is_file():
        _check_ply_header(path)
    if path.suffix.lower() in POLYDATA:
        points, triangles = call_in_child(polydata_arrays, path, reader="VTK")
    else:
        points, triangles = _meshio_arrays(path)
    if points.ndim != 2 or points.shape[1] != 3:
        raise MeshError(f"its points have shape {points.shape}: each point needs three coordinates")
    if not np.isfinite(points).all():
        raise MeshError("some of its nodes have coordinates that are not finite")
    if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(points)):
        raise MeshError(f"some of its triangles name nodes outside the {len(points)} nodes of the file: correct them")
    check_span(points)
    return points, np.asarray(triangles, dtype=np.int64)


def _meshio_arrays(path: Path) -> tuple[Array, Indices]:
    data = meshio_data(path)
    kinds = sorted({block.type for block in data.cells} - {"vertex", "line"})
    if kinds != ["triangle"]:
        held = f"{', '.join(kinds)} elements" if kinds else "no elements"
        raise MeshError(f"it has {held}: give a surface of triangles")
    return np.asarray(data.points, dtype=float), cells_of(data, "triangle")


def polydata_arrays(path: Path) -> tuple[Array, Indices]:
    """Return points and triangles of VTK PolyData.

    Strips are split into triangles. Call this function in a separate process, because VTK does not
    finish on some damaged files. Raises `MeshError` for other contents.
    """
    try:
        import pyvista as pv
    except ModuleNotFoundError:
        raise MeshError("VTK PolyData is read by pyvista: pip install 'suturefem[pictures]', or save as .stl") from None
    found = pv.read(path)
    if not isinstance(found, pv.PolyData):
        raise MeshError(f"it is a {type(found).__name__}: give a surface as PolyData")
    surface = found.triangulate() if found.n_strips else found
    if not surface.is_all_triangles:
        raise MeshError("it has polygons with more than three corners: give a surface of triangles")
    return np.asarray(surface.points, dtype=float), np.asarray(surface.regular_faces, dtype=np.int64)


def _check_ply_header(path: Path) -> None:
    """Raise `MeshError` if a PLY header does not end or declares more elements than possible.

    At most one element per byte of the file is possible. meshio would read such a file for hours or
    without end (meshio 5.3).
    """
    header, size = [], path.stat().st_size
    with path.open("rb") as file:
        for line in file:
            if line.strip() == b"end_header":
                break
            header.append(line.strip())
        else:
            raise MeshError("its header does not end, no line reads end_header: the file is cut short or damaged")
    told = [int(found[1]) for line in header if (found := re.match(rb"element +\w+ +(\d{1,100})", line))]
    if max(told, default=0) > size:  # each element needs at least one byte
        raise MeshError(f"its header declares {max(told)} elements, and the file has {size} bytes: it is damaged")


def _near_pairs(points: Array, triangles: Indices) -> Indices:
    """Return the pairs of triangles whose boxes touch, shape `(k, 2)`.

    Each triangle is only compared with triangles that are not larger, so that the search is local
    on graded surfaces too.
    """
    corners = points[triangles]
    centres = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    found = cKDTree(centres).query_ball_point(centres, 2.0 * radius * (1 + 1e-9))
    first = np.repeat(np.arange(len(triangles)), [len(near) for near in found])
    second = np.concatenate([np.asarray(near, dtype=np.int64) for near in found])
    smaller = (radius[second] < radius[first]) | ((radius[second] == radius[first]) & (second < first))
    first, second = first[smaller], second[smaller]
    low, high = corners.min(axis=1), corners.max(axis=1)
    touch = ((low[first] <= high[second]) & (low[second] <= high[first])).all(axis=1)
    return np.column_stack([first[touch], second[touch]])


def _crossing(points: Array, triangles: Indices, pairs: Indices) -> Indices:
    """Return the pairs of triangles that cross or fold onto one another."""
    parts = [pairs[k : k + BLOCK] for k in range(0, len(pairs), BLOCK)]
    chosen = [part[_cross(points, triangles[part[:, 0]], triangles[part[:, 1]])] for part in parts]
    return np.concatenate([np.empty((0, 2), dtype=np.int64), *chosen])


def _cross(points: Array, first: Indices, second: Indices) -> NDArray[np.bool_]:
    """Return whether each pair of triangles has common points other than common nodes.

    The triangles of all pairs have shape `(k, 3)` each.
    """
    common = (first[:, :, None] == second[:, None, :]).any(axis=2).sum(axis=1)
    crossed = np.asarray(common == 3)
    neighbours = common == 2
    crossed[neighbours] = _folded(points, first[neighbours], second[neighbours])
    through = np.flatnonzero(_straddles(points, first, second) & _straddles(points, second, first))
    for one, other in ((first[through], second[through]), (second[through], first[through])):
        for a, b in ((0, 1), (1, 2), (2, 0)):
            edge = one[:, [a, b]]
            apart = ~(edge[:, :, None] == other[:, None, :]).any(axis=(1, 2))
            crossed[through] |= apart & _pierces(points[edge], points[other])
    return crossed


def _straddles(points: Array, triangles: Indices, others: Indices) -> NDArray[np.bool_]:
    """Return whether each triangle has nodes on both sides of its partner's plane.

    The partners are the `others`.
    """
    a, b, c = np.moveaxis(points[others], 1, 0)
    height = np.stack([six_volumes(a, b, c, points[node]) for node in triangles.T], axis=1)
    height[(triangles[:, :, None] == others[:, None, :]).any(axis=2)] = 0.0
    return np.asarray((height.min(axis=1) < 0) & (height.max(axis=1) > 0))


def _pierces(segments: Array, triangles: Array) -> NDArray[np.bool_]:
    """Return whether segments `(k, 2, 3)` pass through triangles `(k, 3, 3)`.

    The signs of five volumes decide.
    """
    p, q = segments[:, 0], segments[:, 1]
    a, b, c = np.moveaxis(triangles, 1, 0)
    sides = six_volumes(a, b, c, p) * six_volumes(a, b, c, q) < 0
    turns = np.stack([six_volumes(p, q, a, b), six_volumes(p, q, b, c), six_volumes(p, q, c, a)])
    return np.asarray(sides & ((turns > 0).all(axis=0) | (turns < 0).all(axis=0)))


def _folded(points: Array, first: Indices, second: Indices) -> NDArray[np.bool_]:
    """Return whether triangles that share an edge lie on each other, within 0.1°."""
    common = (first[:, :, None] == second[:, None, :]).any(axis=2)
    opposite = first[~common]
    other = second[~(second[:, :, None] == first[:, None, :]).any(axis=2)]
    ends = points[first[common].reshape(-1, 2)]
    along = ends[:, 1] - ends[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    heights = []
    for node in (opposite, other):
        arm = points[node] - ends[:, 0]
        height = arm - np.sum(arm * along, axis=1, keepdims=True) * along
        heights.append(height / np.maximum(np.linalg.norm(height, axis=1, keepdims=True), np.finfo(float).tiny))
    return np.asarray(np.sum(heights[0] * heights[1], axis=1) > np.cos(np.radians(0.1)))


def _turns(triangles: Indices) -> Array:
    """Return signs `(m,)` that make the orientations of a closed manifold's triangles equal.

    The signs are propagated over edges from the first triangle.
    """
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    order = np.lexsort(np.sort(edges, axis=1).T)
    one, other = order[::2], order[1::2]
    alike = np.where((edges[one] == edges[other]).all(axis=1), -1.0, 1.0)  # −1 if the two turns differ
    shape = (len(triangles),) * 2
    graph = coo_array((np.tile(alike, 2), (np.r_[one, other] // 3, np.r_[other, one] // 3)), shape=shape).tocsr()
    walk, before = breadth_first_order(abs(graph), 0, directed=False)
    signs = np.ones(len(triangles))
    steps = np.sign(np.asarray(graph[before[walk[1:]], walk[1:]]).ravel())
    for triangle, step in zip(walk[1:], steps, strict=True):
        signs[triangle] = step * signs[before[triangle]]
    return signs


def _show(point: Sequence[float] | Array) -> str:
    return "[" + ", ".join(f"{x:.4g}" for x in point) + "] in the file's unit"
