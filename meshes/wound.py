"""A block with a wound cut down from the middle of its top.

The wound is a closed slit, or an opening with an elliptical outline. gmsh meshes one half of the
block, and its mirror image is the rest, so that the two lips match node by node and facet by facet.
If sites and planes are symmetric along the wound too, gmsh meshes one quarter. Holes that are images
of one another then have images of the same cells. A closed slit has two coincident nodes at each
place, one for each lip.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import skfem
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from meshes.block import (
    NO_PLANES,
    ON_PLANE,
    Planes,
    add_box,
    add_polygon,
    extent,
    graded_lines,
    grid_points,
    require_sites_within,
    split,
    with_faces,
)
from meshes.errors import MeshError
from meshes.gmsh_session import generate, in_unit, session
from meshes.grading import Grading, Gradings, grading_at, require_positive
from meshes.named import checked_mesh

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

LIPS = ("lip_left", "lip_right")
FLOOR = "wound_floor"
NARROWEST = 1e-5  # of the block's longest side: gmsh does not finish with cuts near its tolerance of 1e-7


@dataclass(frozen=True)
class Wound:
    """A cut from the top down to `depth`, centred at x = y = 0 [m].

    It has a `length` along the axis `along`. `width` is zero for a closed slit; otherwise it is the
    widest opening of an ellipse with vertical walls. The left lip is at lower x (wound along y) or
    lower y (wound along x). Raises `MeshError` unless lengths are positive and finite.
    """

    length: float
    depth: float
    width: float = 0.0
    along: Literal["x", "y"] = "y"

    def __post_init__(self) -> None:
        require_positive("length", self.length)
        require_positive("depth", self.depth)
        if self.width != 0.0:
            require_positive("width", self.width)
        if self.along not in ("x", "y"):
            raise MeshError(f"along = {self.along!r}: allowed are 'x' and 'y'")

    @property
    def normal_axis(self) -> int:
        """Axis normal to the lips."""
        return 0 if self.along == "y" else 1

    def check_fits(self, size: Sequence[float]) -> None:
        """Raise `MeshError` for a wound that is larger than the block of a size `(3,)` [m]."""
        extent(size)
        side = size[1 - self.normal_axis]
        if self.depth > size[2] * (1 + ON_PLANE):
            raise MeshError(f"depth = {self.depth} of the wound exceeds the block's height of {size[2]} m")
        if self.length > side * (1 + ON_PLANE):
            raise MeshError(f"length = {self.length} of the wound exceeds the block's {side} m along {self.along}")
        if self.width and self.length >= side * (1 - ON_PLANE):
            raise MeshError(
                f"length = {self.length} of an open wound must be below the block's {side} m along {self.along}: "
                "shorten it, or cut a closed slit"
            )
        if 0.0 < self.width < NARROWEST * max(size):
            least = NARROWEST * max(size)
            raise MeshError(f"width = {self.width} of the wound must be at least {least:g} m, or 0 for a closed slit")
        if self.width >= size[self.normal_axis] * (1 - ON_PLANE):
            raise MeshError(f"width = {self.width} of the wound must be below the block's {size[self.normal_axis]} m")


@dataclass(frozen=True)
class Lips:
    """Matching nodes `(k, 2)` and facets `(m, 2)` of the left and the right lip.

    Each pair is mirrored in the wound's plane; in a closed slit its two parts coincide. A node at
    the end of the wound is its own partner.
    """

    nodes: Indices
    facets: Indices


def wounded_block_structured(
    size: Sequence[float], wound: Wound, grading: Grading, sites: ArrayLike = (), planes: Planes = NO_PLANES
) -> skfem.MeshTet:
    """Return a structured mesh of a block with a closed slit.

    Sizes, sites and planes are as in `graded_block_structured`. Boundaries are the boundaries of
    the block, lip_left and lip_right. Raises `MeshError` as `graded_block_structured` does, for a
    wound that does not fit, and for an open wound.
    """
    wound.check_fits(size)
    if wound.width:
        raise MeshError(f"width = {wound.width}: an open wound needs gmsh; a structured one is a slit of width 0")
    frame = _Frame(size, wound, planes)
    points = frame.local(require_sites_within(sites, *extent(size)))
    length, depth = wound.length / 2, wound.depth
    cuts = ((*frame.planes[0], 0.0), (*frame.planes[1], -length, length), (*frame.planes[2], -depth))
    lines = [graded_lines(frame.lower[k], frame.upper[k], points[:, k], grading, cuts[k]) for k in range(3)]
    # A diagonal must start at the slit's lower corners: with the other diagonal a facet would not
    # be cut.
    corner = [np.abs(lines[k] - place).argmin() for k, place in enumerate((0.0, length, -depth))]
    tets = split(lines, mirrored=bool(sum(corner) % 2))
    return frame.finish(*_slit(grid_points(lines), tets, frame))


def wounded_block_gmsh(
    size: Sequence[float], wound: Wound, grading: Gradings, sites: ArrayLike = (), planes: Planes = NO_PLANES
) -> skfem.MeshTet:
    """Return a mesh of the wounded block by gmsh.

    The mesh is graded toward the sites and their mirror images across the wound, and has facets along
    the `planes` and their images. Sites have shape `(p, 3)` [m]. Boundaries are the boundaries of
    the block, lip_left, lip_right and, in an open wound with a floor, wound_floor. Raises
    `MeshError` for impossible numbers, a wound that does not fit, a site outside the block, and if
    gmsh cannot load.
    """
    wound.check_fits(size)
    frame = _Frame(size, wound, planes)
    points = frame.local(require_sites_within(sites, *extent(size)))
    points[:, 0] = np.abs(points[:, 0])
    across, along, depths = frame.planes
    planes = sorted({abs(x) for x in across}), along, depths
    sizes = [(each.h_site, each.flat) for each in grading_at(grading, len(points))]
    by_y = np.column_stack([points[:, [1, 0, 2]], np.reshape(sizes, (-1, 2))])
    quarter = _is_symmetric(by_y, frame) and _is_symmetric(np.reshape(along, (-1, 1)), frame)
    with session() as gmsh:
        lower = np.array([0.0, 0.0 if quarter else frame.lower[1], frame.lower[2]])
        add_box(gmsh, lower, frame.upper, planes, frame.unit)
        _cut_ellipse(gmsh, wound, frame) if wound.width else _draw_slit(gmsh, wound, frame, quarter)
        gmsh.model.occ.synchronize()
        part = generate(gmsh, grading, points, frame.unit)
    whole = _mirrored(part.p.T, part.t.T, 0, frame.slack)
    if quarter:
        whole = _mirrored(*whole, 1, frame.slack)
    if wound.width:
        return frame.finish(*whole, np.empty((0, 2), dtype=np.int64))
    return frame.finish(*_slit(*whole, frame))


def lips(mesh: skfem.MeshTet, wound: Wound) -> Lips:
    """Return the matching nodes and facets of the two lips of a wounded block from this module.

    Raises `MeshError` for any other mesh.
    """
    left, right = (np.asarray(mesh.boundaries[name], dtype=np.int64) for name in LIPS)
    nodes = [np.unique(mesh.facets[:, facets]) for facets in (left, right)]
    mirror = np.ones(3)
    mirror[wound.normal_axis] = -1.0
    partner = np.arange(mesh.nvertices)
    away, place = cKDTree(mesh.p.T[nodes[1]]).query(mesh.p.T[nodes[0]] * mirror)
    if nodes[0].size != nodes[1].size or np.max(away) > 0.0:
        raise MeshError("the lips are not mirror images of one another: only blocks made by this module have pairs")
    partner[nodes[0]] = nodes[1][place]
    by_nodes = {frozenset(triangle): facet for facet, triangle in zip(right, mesh.facets[:, right].T, strict=True)}
    matching = [by_nodes[frozenset(triangle)] for triangle in partner[mesh.facets[:, left]].T]
    return Lips(np.column_stack([nodes[0], partner[nodes[0]]]), np.column_stack([left, matching]))


@dataclass(frozen=True)
class _Frame:
    """A wounded block of a size `(3,)` [m] in the wound's axes.

    x is normal to the wound, and y is along the wound.
    """

    size: Sequence[float]
    wound: Wound
    block_planes: Planes

    @property
    def order(self) -> list[int]:
        """The block's axes in the order of the wound's axes."""
        return [0, 1, 2] if self.wound.normal_axis == 0 else [1, 0, 2]

    @property
    def lower(self) -> Array:
        """Lower corner (3,) [m]."""
        return self.local(extent(self.size)[0])

    @property
    def upper(self) -> Array:
        """Upper corner (3,) [m]."""
        return self.local(extent(self.size)[1])

    @property
    def planes(self) -> Planes:
        """Coordinates of planes with facets, by axis [m]."""
        x, y, z = (self.block_planes[k] for k in self.order)
        return x, y, z

    @property
    def unit(self) -> float:
        """Unit of length in gmsh's model [m]."""
        return float(max(self.size))

    @property
    def slack(self) -> float:
        """Largest distance of a node in a plane from the plane [m]."""
        return ON_PLANE * self.unit

    @property
    def ends(self) -> bool:
        """Whether the wound cuts the block's sides, so that it has no ends inside the block."""
        return self.wound.length >= (self.upper - self.lower)[1] * (1 - ON_PLANE)

    @property
    def through(self) -> bool:
        """Whether the wound cuts the bottom."""
        return self.wound.depth >= -self.lower[2] * (1 - ON_PLANE)

    def local(self, points: Array) -> Array:
        """Return points of the block, shape `(…, 3)`, in the wound's axes.

        The map is its own inverse.
        """
        return np.array(points[..., self.order])

    def finish(self, points: Array, tets: Indices, twins: Indices) -> skfem.MeshTet:
        """Return the checked mesh in the block's axes, with all boundaries named."""
        if self.wound.normal_axis == 1:
            tets = tets[:, [1, 0, 2, 3]]  # exchanging x and y inverts the tetrahedra
        parts = 2 if self.ends and self.through else 1
        mesh = with_faces(checked_mesh(self.local(points), tets, twins, parts), *extent(self.size))
        return mesh.with_boundaries(self._wound_facets(mesh))

    def _wound_facets(self, mesh: skfem.MeshTet) -> dict[str, Indices]:
        """Return the boundary facets that are not on a face of the block: floor and lips."""
        named = np.concatenate(list((mesh.boundaries or {}).values()))
        facets = np.setdiff1d(mesh.boundary_facets(), named)
        floor = (np.abs(mesh.p[2, mesh.facets[:, facets]] + self.wound.depth) <= self.slack).all(axis=0)
        wall = facets[~floor]
        if not wall.size:
            raise MeshError(
                f"width = {self.wound.width} m of the wound: gmsh loses a cut as narrow as this if it crosses planes "
                "inside the block; widen it, cut a closed slit, or leave out the regions' borders"
            )
        # The cell behind a facet determines its side, even if both lips lie in one plane.
        side = mesh.p[self.wound.normal_axis][mesh.t[:, mesh.f2t[0, wall]]].mean(axis=0)
        found = {LIPS[0]: wall[side < 0], LIPS[1]: wall[side > 0]}
        return found | ({FLOOR: facets[floor]} if floor.any() else {})


def _slit(points: Array, tets: Indices, frame: _Frame) -> tuple[Array, Indices, Indices]:
    """Return points, tetrahedra and coincident pairs of nodes of the block with its slit opened.

    Each node inside the slit gets a twin for the right lip. The plane of the slit must consist of
    facets.
    """
    slack, wound = frame.slack, frame.wound
    x, y, z = points.T
    within = np.abs(x) <= slack
    within &= True if frame.ends else np.abs(y) < wound.length / 2 - slack
    within &= True if frame.through else z > -wound.depth + slack
    inside = np.flatnonzero(within)
    if not inside.size:
        raise MeshError("the mesh is too coarse for the wound: h must be at most half its length, and its depth")
    twin = np.arange(len(points))
    twin[inside] = len(points) + np.arange(inside.size)
    right = x[tets].mean(axis=1) > 0
    tets = np.where(right[:, None], twin[tets], tets)
    return np.vstack([points, points[inside]]), tets, np.column_stack([inside, twin[inside]])


def _mirrored(points: Array, tets: Indices, axis: int, slack: float) -> tuple[Array, Indices]:
    """Return a mesh on the upper side of the plane normal to an `axis` and its mirror image, joined there."""
    points = points.copy()
    joined = np.abs(points[:, axis]) <= slack
    points[joined, axis] = 0.0
    image = np.arange(len(points))
    image[~joined] = len(points) + np.arange(np.count_nonzero(~joined))
    mirrored = points[~joined]
    mirrored[:, axis] *= -1.0
    return np.vstack([points, mirrored]), np.vstack([tets, image[tets[:, [1, 0, 2, 3]]]])


def _is_symmetric(places: Array, frame: _Frame) -> bool:
    """Return whether places `(k, …)` [m] are their own image under a change of sign of their first coordinate."""
    image = places.copy()
    image[:, :1] *= -1.0
    return not len(places) or bool(np.max(cKDTree(places).query(image)[0]) <= frame.slack)


def _draw_slit(gmsh: Any, wound: Wound, frame: _Frame, quarter: bool) -> None:
    """Cut the face x = 0 along the slit's outline and along lines in the slit.

    These lines go from the slit's lower corners to the top. A triangle with two sides on the
    outline would have no inner node and could not open. With these lines every triangle has at most
    one side on the outline.
    """
    length, depth = wound.length / 2, wound.depth
    foot = length - depth if depth < 0.9 * length else 0.0
    corners = [(0.0, 0.0), (0.0, -depth), (length, -depth), (length, 0.0), (foot, 0.0)]
    top, low, corner, end, inner = ((0.0, y, z) for y, z in corners)
    pieces = [[top, low, corner, end]]
    if not (frame.ends or frame.through):
        pieces = [[top, low, corner, inner] if foot else [top, low, corner], [corner, end, inner]]
    if not quarter:
        pieces += [[(x, -y, z) for x, y, z in piece] for piece in pieces]
    volumes = gmsh.model.occ.getEntities(3)
    gmsh.model.occ.fragment(volumes, [(2, add_polygon(gmsh, piece, frame.unit)) for piece in pieces])


def _cut_ellipse(gmsh: Any, wound: Wound, frame: _Frame) -> None:
    """Remove the elliptical prism of the wound from the part of the block."""
    along, across, depth = in_unit([wound.length / 2, wound.width / 2, wound.depth], frame.unit).tolist()
    disk = gmsh.model.occ.addDisk(0.0, 0.0, 0.0, max(along, across), min(along, across))
    if along > across:
        gmsh.model.occ.rotate([(2, disk)], 0, 0, 0, 0, 0, 1, np.pi / 2)
    below = -1.5 * depth if frame.through else -depth
    prism = [entity for entity in gmsh.model.occ.extrude([(2, disk)], 0, 0, below) if entity[0] == 3]
    gmsh.model.occ.cut([v for v in gmsh.model.occ.getEntities(3) if v not in prism], prism)
