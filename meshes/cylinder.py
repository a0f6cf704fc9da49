"""Round bars and tubes along x, centred at the origin, and the two stumps of a tube.

They need gmsh.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import skfem
from numpy.typing import ArrayLike, NDArray

from meshes.errors import MeshError
from meshes.gmsh_session import generate, in_unit, session
from meshes.grading import Gradings, require_positive, site_points
from meshes.named import checked_mesh

Array = NDArray[np.float64]


def cylinder(radius: float, length: float, grading: Gradings, sites: ArrayLike = ()) -> skfem.MeshTet:
    """Return a mesh of the cylinder y² + z² ≤ radius², |x| ≤ length/2 [m].

    The mesh is graded toward sites `(p, 3)` [m]. Boundaries are left (x = −length/2), right (x =
    +length/2) and side. The side has flat facets with corners on the true surface. Their middles
    lie up to h²/(8 radius) inside the surface.

    Raises `MeshError` for impossible numbers, for a site outside the cylinder, and if gmsh cannot
    load.
    """
    require_positive("radius", radius)
    require_positive("length", length)
    points, unit = _sites_within(sites, 0.0, radius, length), max(radius, length)
    with session() as gmsh:
        add_bar(gmsh, radius, length, unit)
        gmsh.model.occ.synchronize()
        return _with_faces(generate(gmsh, grading, points, unit), length, {"side": radius})


def tube(radius: float, wall: float, length: float, grading: Gradings, sites: ArrayLike = ()) -> skfem.MeshTet:
    """Return a mesh of the tube (radius − wall)² ≤ y² + z² ≤ radius², |x| ≤ length/2 [m].

    The mesh is graded toward sites `(p, 3)` [m]. Boundaries are left, right, inner and outer. Both
    walls have flat facets with corners on the true surfaces. Raises `MeshError` as `cylinder` does,
    and for a wall that is not thinner than the radius.
    """
    require_positive("radius", radius)
    require_positive("length", length)
    if require_positive("wall", wall) >= radius:
        raise MeshError(f"wall = {wall!r} must be thinner than radius = {radius!r}: for a solid bar take the cylinder")
    points, unit = _sites_within(sites, radius - wall, radius, length), max(radius, length)
    with session() as gmsh:
        outer, bore = (add_bar(gmsh, r, length, unit) for r in (radius, radius - wall))
        gmsh.model.occ.cut([(3, outer)], [(3, bore)])
        gmsh.model.occ.synchronize()
        return _with_faces(generate(gmsh, grading, points, unit), length, {"inner": radius - wall, "outer": radius})


def add_bar(gmsh: Any, radius: float, length: float, unit: float) -> int:
    """Add a round bar along x [m] to the gmsh model of a `unit` [m], and return its tag."""
    start, along, across = in_unit([-length / 2, length, radius], unit)
    return int(gmsh.model.occ.addCylinder(start, 0.0, 0.0, along, 0.0, 0.0, across))


def stumps(
    radius: float, wall: float, length: float, gap: float, grading: Gradings, sites: ArrayLike = ()
) -> skfem.MeshTet:
    """Return a mesh of the `tube` cut in the middle, with two stumps `gap` [m] apart.

    The stumps are two bodies without common nodes. Boundaries are the boundaries of the tube, and
    stump_left and stump_right, the faces of the cut. The stumps are mirror images and are graded
    toward the sites of both, so that the nodes of the two faces match. Raises `MeshError` as `tube`
    does, and for a gap that is negative or leaves no stump.
    """
    if not 0.0 <= gap < length:
        raise MeshError(f"gap = {gap!r} must be at least 0 and less than length = {length!r}, with both stumps")
    half = 0.5 * (length - gap)
    middle = np.array([0.5 * (gap + half), 0.0, 0.0])
    mirrored = site_points(sites) * 1.0
    mirrored[:, 0] = np.abs(mirrored[:, 0])
    one = tube(radius, wall, half, grading, mirrored - middle)
    there = one.p.T + middle
    points = np.vstack([there * [-1.0, 1.0, 1.0], there])
    tets = np.vstack([one.t.T[:, [1, 0, 2, 3]], one.t.T + one.nvertices])
    return _with_faces(checked_mesh(points, tets, parts=None), length, {"inner": radius - wall, "outer": radius}, gap)


def _sites_within(sites: ArrayLike, inner: float, radius: float, length: float) -> Array:
    """Return the sites, shape `(p, 3)` [m].

    Raises `MeshError` for a site outside the body by more than round-off.
    """
    points = site_points(sites)
    slack = 1e-9 * max(radius, length)
    across = np.hypot(points[:, 1], points[:, 2])
    away = (np.abs(points[:, 0]) > length / 2 + slack) | (across > radius + slack) | (across < inner - slack)
    for site in points[away]:
        shape = f"tube of inner radius {inner:.6g}" if inner else "cylinder"
        raise MeshError(f"site {site.tolist()} is outside the {shape}, radius {radius} and length {length} [m]")
    return points


def _with_faces(
    mesh: skfem.MeshTet, length: float, walls: Mapping[str, float], gap: float | None = None
) -> skfem.MeshTet:
    """Return the mesh with named ends, left and right, and named round walls (name → radius).

    For two stumps, `gap` [m] apart, the faces of the cut are named too.
    """
    facets = mesh.boundary_facets()
    corners: Any = mesh.p[:, mesh.facets[:, facets]]
    planes = {"left": (-1.0, length), "right": (1.0, length)}
    if gap is not None:
        planes |= {"stump_left": (-1.0, gap), "stump_right": (1.0, gap)}
    behind = np.sign(mesh.p[0, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=0))
    ends = {
        name: (np.abs(corners[0] - 0.5 * side * x).max(axis=0) <= 1e-9 * length) & ((gap is None) | (behind == side))
        for name, (side, x) in planes.items()
    }
    across = np.hypot(corners[1], corners[2])
    wall = ~np.any(list(ends.values()), axis=0)
    nearest = np.abs(across.mean(axis=0) - np.array(list(walls.values()))[:, None]).argmin(axis=0)
    round_walls = {name: wall & (nearest == k) for k, name in enumerate(walls)}
    return mesh.with_boundaries({name: facets[chosen] for name, chosen in (ends | round_walls).items()})
