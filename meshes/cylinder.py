"""Solid round bars along x, centred at the origin, boundaries left right side. Needs gmsh."""

from typing import Any

import skfem
from numpy.typing import ArrayLike

from meshes.errors import MeshError
from meshes.gmsh_session import generate, session
from meshes.grading import Grading, positive, site_points


def cylinder(
    radius: float,
    length: float,
    h: float,
    h_site: float | None = None,
    sites: ArrayLike = (),
    growth: float = 1.3,
    site_radius: float = 0.0,
) -> skfem.MeshTet:
    """Cylinder y² + z² ≤ radius², |x| ≤ length/2 [m], element size `h`, and `h_site` within `site_radius`
    of each site, shape `(p, 3)` [m].

    left is x = −length/2, right x = +length/2. The side is made of flat facets whose corners lie on the
    true surface: their middles lie up to h²/(8 radius) inside it.

    Raises `MeshError` for impossible numbers, for a site outside the cylinder, and where gmsh cannot load.
    """
    positive("radius", radius)
    positive("length", length)
    grading = Grading(h, h if h_site is None else h_site, growth, site_radius)
    points = site_points(sites)
    for site in points:
        _check_inside(site, radius, length)
    with session() as gmsh:
        gmsh.model.occ.addCylinder(-length / 2, 0.0, 0.0, length, 0.0, 0.0, radius)
        gmsh.model.occ.synchronize()
        _name_faces(gmsh, length)
        return generate(gmsh, grading, points)


def _check_inside(site: Any, radius: float, length: float) -> None:
    slack = 1e-9 * max(radius, length)
    x, y, z = site
    if abs(x) > length / 2 + slack or (y * y + z * z) ** 0.5 > radius + slack:
        raise MeshError(f"site {site.tolist()} is outside the cylinder of radius {radius} and length {length} [m]")


def _name_faces(gmsh: Any, length: float) -> None:
    """Physical groups for the three faces of the only cylinder in the gmsh model, by their centres."""
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], name="cylinder")
    centres = {tag: gmsh.model.occ.getCenterOfMass(2, tag)[0] / length for _, tag in gmsh.model.getEntities(2)}
    for name, place in (("left", -0.5), ("side", 0.0), ("right", 0.5)):
        tag = min(centres, key=lambda t: abs(centres[t] - place))
        gmsh.model.addPhysicalGroup(2, [tag], name=name)
