"""The organ's mesh of a scenario, generated or read, with its boundaries and regions.

Impossible meshes are refused before they are made.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import psutil
import skfem
from numpy.typing import NDArray

import tissue
from meshes.block import Planes, extent, graded_block_gmsh, graded_block_structured, structured_tets
from meshes.budget import budget, expected_tets
from meshes.checks import parts
from meshes.cylinder import cylinder, stumps, tube
from meshes.facets import sharp_edges
from meshes.file import ENDINGS, read
from meshes.grading import Grading, Gradings
from meshes.named import with_boundaries
from meshes.skin import fill, read_surface
from meshes.units import metres_per_unit
from meshes.wound import Wound, wounded_block_gmsh, wounded_block_structured
from studies import scenario as model
from studies.arrays import GIGA, Array
from studies.scenario import Scenario, ScenarioError, as_toml, because, refuse, refused
from studies.scenario.organ import SURFACES, Boundary, Region, idle_load, unknown_clamp
from studies.scenario.piercing import place_refused
from studies.scenario.scenario import check_apart
from studies.scenario.values import Vector
from studies.simulation.sharing import Shared, places_key
from tissue.refinement.mark import BISECTED
from tissue.sites.surface import ON_SURFACE

log = logging.getLogger(__name__)

Cells = NDArray[np.integer]
Holes = tuple[model.Piercing, ...]
SitesOn = Callable[[skfem.MeshTet], Sequence[tissue.Site]]
Make = Callable[[Gradings, Array], skfem.MeshTet]
Generated = model.BlockMesh | model.WoundMesh | model.CylinderMesh | model.TubeMesh | model.FileMesh

SHARP = 45.0  # degrees between facets above which their common edge belongs to the organ and not only to the mesh
ON_EDGE = 1e-9  # of the organ's diagonal: a hole this near to an edge is on the edge


@dataclass(frozen=True)
class Body:
    """The shape of a mesh before it is generated: volume [m³], extent, and nearest points.

    `make` returns its mesh from gradings and their places (k, 3) [m].
    """

    volume: float
    make: Make
    inside: Callable[[Array], NDArray[np.bool_]]
    nearest: Callable[[Array], Array]


def organ_mesh(scenario: Scenario, given: skfem.MeshTet | None = None, sites: SitesOn | None = None) -> skfem.MeshTet:
    """Return the mesh with the additional boundaries and regions of the scenario.

    `given` is a mesh from Python. `sites` returns the sites of the holes on a mesh; a mesh by gmsh
    is then made again with small cells there. Raises `ScenarioError` or `MeshError` for a mesh that
    cannot be made or used.
    """
    table = scenario.tissue
    if table is None:
        raise ScenarioError("tissue is missing: without an organ there is no mesh; add [tissue] and [tissue.mesh]")
    log.info("making the mesh: a %s", table.mesh.kind)
    mesh = named_mesh(scenario, table, mesh_of(table, scenario.piercing) if given is None else given)
    accuracy = table.mesh.accuracy
    if sites is not None and accuracy != "given" and is_sized(scenario):
        around = tissue.zones(mesh, table.element, accuracy, sites(mesh))
        return named_mesh(scenario, table, mesh_of(table, scenario.piercing, around)) if around else mesh
    return mesh


def is_sized(scenario: Scenario) -> bool:
    """Return whether gmsh makes the small cells at the holes, so that cells are not bisected there.

    A hole with `near`, or on a surface from a file, lies on a facet of the first mesh, which a new
    mesh does not have.
    """
    shape = None if scenario.tissue is None else scenario.tissue.mesh
    if shape is None or isinstance(shape, model.GivenMesh | model.FileMesh) or shape.h_site is not None:
        return False
    found = any(hole.near is not None for hole in scenario.piercing)
    return not found and getattr(shape, "generator", "gmsh") == "gmsh"


def named_mesh(scenario: Scenario, table: model.Tissue, mesh: skfem.MeshTet) -> skfem.MeshTet:
    """Return a checked mesh with the additional boundaries and regions of the scenario."""
    mesh = with_boxes(mesh, table.boundary)
    for key, names in (("clamp", table.clamp), ("roller", table.roller)):
        report(unknown_clamp(names, sorted(mesh.boundaries or {}), key))
        check_outer(mesh, names, key)
    if not scenario.floats:
        check_held(mesh, table.clamp, table.roller)
    check_smooth(mesh, scenario.piercing)
    return with_regions(mesh, table.region)


def mesh_of(table: model.Tissue, holes: Sequence[model.Piercing], around: Sequence[tissue.Zone] = ()) -> skfem.MeshTet:
    """Return the mesh from its generator or file.

    It is graded towards the holes if a mesh size is given there, or towards the zones `around` them.
    """
    shape, planes = table.mesh, planes_of(table)
    if isinstance(shape, model.GivenMesh):
        raise refused("tissue.mesh.kind", shape.kind, "mesh-given")
    if isinstance(shape, model.FileMesh) and not shape.is_surface:
        return _from_file(shape, table.element)
    body = body_of(shape, planes)
    grading, sites = sizes_of(table, holes, around, body)
    check_memory(table, grading, sites, body, planes)
    if isinstance(shape, model.WoundMesh):
        check_clear(shape, holes)
    return body.make(grading, sites)


def _block(shape: model.BlockMesh | model.WoundMesh, planes: Planes, grading: Gradings, sites: Array) -> skfem.MeshTet:
    """Return the mesh of a block or of a block with a wound."""
    structured = isinstance(grading, Grading) and shape.generator == "structured"
    if isinstance(shape, model.WoundMesh):
        wounded: Callable[..., skfem.MeshTet] = wounded_block_structured if structured else wounded_block_gmsh
        return wounded(shape.size, wound_of(shape), grading, sites, planes)
    graded: Callable[..., skfem.MeshTet] = graded_block_structured if structured else graded_block_gmsh
    return graded(shape.size, grading, sites, planes)


def _from_file(shape: model.FileMesh, element: str) -> skfem.MeshTet:
    """Return the tetrahedra of a file."""
    unknown, allowed = not shape.path.lower().endswith(ENDINGS), ", ".join((*ENDINGS, *SURFACES))
    refuse(unknown, "tissue.mesh.path", shape.path, "mesh-ending", endings=allowed)
    mesh = read(shape.path, metres_per_unit(shape.unit))
    if size := too_large(mesh.nelements, element):
        raise refused("tissue.mesh.path", shape.path, "file-large", size=size)
    return mesh


def report(fault: str | None) -> None:
    """Refuse the organ if a fault was found, None without a fault. Raises `ScenarioError`."""
    if fault:
        raise ScenarioError(f"tissue.{fault}")


def check_outer(mesh: skfem.MeshTet, names: Sequence[str], key: str) -> None:
    """Refuse a held boundary with facets inside the organ. Raises `ScenarioError`."""
    for name in names:
        inside = np.setdiff1d((mesh.boundaries or {})[name], mesh.boundary_facets()).size
        refuse(inside > 0, f"tissue.{key}", list(names), "facets-inside", count=inside, name=name)


def places(holes: Sequence[model.Piercing]) -> Array:
    """Return the places of the holes, shape `(p, 3)` [m]."""
    return np.reshape([hole.place for hole in holes], (-1, 3)).astype(float)


def sizes_of(
    table: model.Tissue, holes: Sequence[model.Piercing], around: Sequence[tissue.Zone], body: Body
) -> tuple[Gradings, Array]:
    """Return the gradings of a generated mesh and their places (k, 3) [m].

    They are one for all holes, or one for each zone and bare point.
    """
    whole = grading_of(table, holes)
    if not around:
        return whole, body.nearest(places(holes))
    bare = [hole for hole in holes if not hole.footprint]
    each = [Grading(whole.h, min(zone.size, whole.h), float(np.exp(zone.growth)), zone.radius) for zone in around]
    centres = np.array([zone.centre for zone in around])
    return [*each, *[whole] * len(bare)], body.nearest(np.vstack([centres, places(bare)]))


def grading_of(table: model.Tissue, holes: Sequence[model.Piercing]) -> Grading:
    """Return the sizes of a generated mesh; `h_site` reaches to the largest footprint.

    Flat facets of a size h leave a round wall by h²/8R, and bisection does not change that. Cells
    that are refined later therefore begin at a round wall with the size of the smallest footprint.
    They grow as the refined cells do.
    """
    shape = table.mesh
    assert not isinstance(shape, model.GivenMesh) and shape.h is not None
    footprints = [hole.footprint for hole in holes if hole.footprint]
    radius = max(footprints, default=0.0)
    is_round = isinstance(shape, model.CylinderMesh | model.TubeMesh)
    if shape.h_site is None and is_round and shape.accuracy != "given":
        least, growth = min([shape.h, *footprints]), float(np.exp(BISECTED[table.element].growth))
        return Grading(shape.h, least, growth, least)
    return Grading(shape.h, shape.h_site or shape.h, shape.growth, radius)


def wound_of(shape: model.WoundMesh) -> Wound:
    """Return the wound in the block."""
    return Wound(shape.length, shape.depth, shape.width, shape.along)


def planes_of(table: model.Tissue) -> Planes:
    """Return the coordinates of the regions' borders, by axis [m]."""
    corners = [np.array(region.box) for region in table.region if region.box is not None]
    layers = [-z for region in table.region if region.depth is not None for z in region.depth]
    x, y, z = ([float(box[end, axis]) for box in corners for end in (0, 1)] for axis in range(3))
    return x, y, z + layers


def body_of(shape: Generated, planes: Planes) -> Body:
    """Return the shape of a mesh before it is generated; the facets of a block keep to `planes`."""
    match shape:
        case model.CylinderMesh():
            return _round(partial(cylinder, shape.radius, shape.length), 0.0, shape.radius, shape.length)
        case model.TubeMesh():
            sizes, inner = (shape.radius, shape.wall, shape.length), shape.radius - shape.wall
            make = partial(tube, *sizes) if shape.gap is None else partial(stumps, *sizes, shape.gap)
            return _round(make, inner, shape.radius, shape.length, shape.gap or 0.0)
        case model.FileMesh():
            skin = read_surface(shape.path, metres_per_unit(shape.unit))
            return _box(partial(fill, skin), skin.points.min(axis=0), skin.points.max(axis=0), skin.volume)
    return _box(partial(_block, shape, planes), *extent(shape.size), float(np.prod(shape.size)))


def _box(make: Make, lower: Array, upper: Array, volume: float) -> Body:
    return Body(
        volume,
        make,
        lambda points: np.asarray(((points >= lower) & (points <= upper)).all(axis=1)),
        lambda points: np.clip(points, lower, upper),
    )


def _round(make: Make, inner: float, radius: float, length: float, gap: float = 0.0) -> Body:
    """Return a bar or a tube along x, or its two stumps with a `gap` between them."""

    def inside(points: Array) -> NDArray[np.bool_]:
        across, along = np.hypot(points[:, 1], points[:, 2]), np.abs(points[:, 0])
        return np.asarray((across >= inner) & (across <= radius) & (along <= length / 2) & (along >= gap / 2))

    def nearest(points: Array) -> Array:
        across = np.hypot(points[:, 1], points[:, 2])
        share = np.clip(across, inner, radius) / np.where(across > 0, across, 1.0)
        x = np.copysign(np.clip(np.abs(points[:, 0]), gap / 2, length / 2), points[:, 0])
        return np.column_stack([x, share * points[:, 1], share * points[:, 2]])

    return Body(np.pi * (radius**2 - inner**2) * (length - gap), make, inside, nearest)


def check_memory(table: model.Tissue, grading: Gradings, sites: Array, body: Body, planes: Planes) -> None:
    """Refuse a mesh whose organ needs more than the available memory, before the mesh is made."""
    shape = table.mesh
    if isinstance(shape, model.BlockMesh | model.WoundMesh) and shape.generator == "structured":
        assert isinstance(grading, Grading)  # cells of a structured mesh are bisected
        tets = structured_tets(shape.size, grading, sites, planes)
    else:
        tets = expected_tets(body.volume, grading, sites, body.inside)
    if size := too_large(tets, table.element):
        if not isinstance(grading, Grading):
            raise refused("tissue.mesh.accuracy", shape.accuracy, "cells-many", holes=len(grading), size=size)
        key = "h" if grading.h_site == grading.h else "h_site"
        raise refused(f"tissue.mesh.{key}", getattr(grading, key), "mesh-large", h=grading.h, size=size)


def too_large(tets: float, element: str) -> str | None:
    """Return the memory for this number of tetrahedra in words if it is not available.

    It is None if enough memory is available.
    """
    need, there = budget(tets, element), psutil.virtual_memory().available
    if need.memory <= there:
        return None
    return because("memory", need=need, element=element, memory=need.memory / GIGA, there=there / GIGA)


def check_clear(shape: model.WoundMesh, holes: Sequence[model.Piercing]) -> None:
    """Refuse a footprint that reaches across a closed slit, whose lips lie at the same place."""
    for hole in holes if shape.shape == "slit" else ():
        x, y, z = hole.place
        across, along = (x, y) if shape.along == "y" else (y, x)
        past_end, below = max(abs(along) - shape.length / 2, 0.0), max(-z - shape.depth, 0.0)
        away = float(np.linalg.norm([across, past_end, below]))
        if away <= hole.footprint:
            raise place_refused(hole, "across-slit", away=away, reach=hole.footprint)


def motions_left(mesh: skfem.MeshTet, clamp: Sequence[str], roller: Sequence[str]) -> tuple[Cells, list[Array]]:
    """Return the body of each cell, and for each body its remaining rigid motions.

    The shapes are `(cells,)` and `(d, 6)`. Clamps and rollers prevent all other motions.
    """
    part, held = parts(mesh.p.T, mesh.t.T), tissue.held_components(mesh, clamp, roller)
    nodes = [np.unique(mesh.t[:, part == k]) for k in range(part.max() + 1)]
    return part, [tissue.rigid_motions(mesh.p.T[those], held[those]) for those in nodes]


def check_held(mesh: skfem.MeshTet, clamp: Sequence[str], roller: Sequence[str]) -> None:
    """Refuse an organ of several bodies if clamps and rollers do not hold each of them."""
    part, left = motions_left(mesh, clamp, roller)
    unheld = [k for k, motions in enumerate(left) if motions.size]
    if unheld and len(left) > 1:
        centre = np.round(mesh.p[:, mesh.t[:, part == unheld[0]]].mean(axis=(1, 2)), 4) + 0.0  # no −0.0
        words = {"place": centre.tolist(), "motions": tissue.motions_in_words(left[unheld[0]])}
        raise refused("tissue.clamp", list(clamp), "part-loose", parts=len(left), **words)


def check_loaded(mesh: skfem.MeshTet, table: model.Tissue) -> None:
    """Refuse a load on a boundary that is unknown, inside the organ, or with all nodes held."""
    report(idle_load(table.load, sorted(mesh.boundaries or {}), table.clamp, table.roller))
    held = np.asarray(tissue.held_components(mesh, table.clamp, table.roller).all(axis=1))
    for number, load in enumerate(table.load):
        facets, key = (mesh.boundaries or {})[load.boundary], f"tissue.load.{number}.boundary"
        refuse(held[mesh.facets[:, facets]].all(), key, load.boundary, "load-held")
        refuse(np.any(mesh.f2t[1, facets] >= 0), key, load.boundary, "load-inside")


def check_smooth(mesh: skfem.MeshTet, holes: Sequence[model.Piercing]) -> None:
    """Refuse a footprint that reaches a sharp edge of the organ."""
    p, q = np.moveaxis(sharp_edges(mesh, SHARP), 1, 0)
    along, slack = q - p, ON_EDGE * float(np.linalg.norm(np.ptp(mesh.p, axis=1)))
    for hole in holes if len(p) else ():
        t = np.clip(np.sum((hole.place - p) * along, axis=1) / np.sum(along * along, axis=1), 0.0, 1.0)
        away = float(np.linalg.norm(p + t[:, None] * along - hole.place, axis=1).min())
        if away <= hole.footprint * (1 - ON_EDGE) + slack:
            raise place_refused(hole, "sharp-edge", away=away, reach=hole.footprint)


def with_boxes(mesh: skfem.MeshTet, boxes: Sequence[Boundary]) -> skfem.MeshTet:
    """Return the mesh with the scenario's boundaries: surface facets whose centre lies in a box.

    Without boxes this is the same mesh, because a copy would renumber its facets.
    """
    if not boxes:
        return mesh
    named = dict(mesh.boundaries or {})
    surface = mesh.boundary_facets()
    centres = mesh.p[:, mesh.facets[:, surface]].mean(axis=1)
    for box in boxes:
        key = "tissue", "boundary", box.name
        refuse(box.name in named, key, box.name, "boundary-twice")
        named[box.name] = surface[is_inside(centres, np.array(box.box))]
        if named[box.name].size == 0:
            raise empty_place(mesh, (*key, "box"), box.box, "surface facet")
    return with_boundaries(mesh, named)


def with_regions(mesh: skfem.MeshTet, regions: Sequence[Region]) -> skfem.MeshTet:
    """Return the mesh with the regions of the scenario as subdomains.

    Without regions it is the same mesh.
    """
    if not regions:
        return mesh
    return mesh.with_subdomains(dict(mesh.subdomains or {}) | {r.name: region_cells(mesh, r) for r in regions})


def region_cells(mesh: skfem.MeshTet, region: Region) -> Cells:
    """Return the cells of a region.

    The mesh file names them, or their centre lies in the region's box or layer.
    """
    centres, key = mesh.p[:, mesh.t].mean(axis=1), ("tissue", "region", region.name)
    if region.box is not None:
        inside = is_inside(centres, np.array(region.box))
    elif region.depth is not None:
        inside = (-centres[2] > region.depth[0]) & (-centres[2] < region.depth[1])
    elif region.name in (mesh.subdomains or {}):
        return np.asarray(mesh.subdomains[region.name])
    else:
        known = ", ".join(sorted(mesh.subdomains or {})) or "none"
        raise refused((*key, "name"), region.name, "region-unknown", known=known)
    if not inside.any():
        place = "depth" if region.box is None else "box"
        raise empty_place(mesh, (*key, place), getattr(region, place), "cell")
    return np.flatnonzero(inside)


def empty_place(mesh: skfem.MeshTet, key: Sequence[str], value: object, what: str) -> ScenarioError:
    """Return the error for a place of this key without the centre of a cell or facet."""
    low, high = (np.round(x, 6).tolist() for x in (mesh.p.min(axis=1), mesh.p.max(axis=1)))
    return refused(key, value, "place-empty", what=what, low=low, high=high)


def is_inside(points: Array, corners: Array) -> NDArray[np.bool_]:
    """Return which columns of `points` (3, k) lie in the box of two corners (2, 3)."""
    low, high = corners.min(axis=0)[:, None], corners.max(axis=0)[:, None]
    return np.asarray(np.all((points >= low) & (points <= high), axis=0))


def strength_at(table: model.Tissue, mesh: skfem.MeshTet, point: Sequence[float]) -> float:
    """Return the strength of the tissue at a point, from the nearest cell [Pa].

    It is infinite without a value.
    """
    owner, every = owned(table, mesh, "strength")
    if not any(every):
        return np.inf
    nearest = int(np.argmin(np.linalg.norm(mesh.p[:, mesh.t].mean(axis=1).T - point, axis=1)))
    return every[owner[nearest]] or np.inf


def owned(table: model.Tissue, mesh: skfem.MeshTet, key: str) -> tuple[Cells, list[Any]]:
    """Return the values of a key, and for each cell the number of its value.

    The numbers come first, shape `(cells,)`. The values are the organ's value, then the values of
    regions that have their own.
    """
    owner, every = np.zeros(mesh.nelements, dtype=np.intp), [getattr(table, key)]
    for region in table.region:
        if (own := getattr(region, key)) is not None:
            owner[mesh.subdomains[region.name]] = len(every)
            every.append(own)
    return owner, every


def material_of(table: model.Tissue, mesh: skfem.MeshTet) -> tissue.Material:
    """Return the organ's material: numbers, or one per cell if regions differ."""
    keys = ("youngs_modulus", "poisson_ratio", "density")
    if not (table.region or table.relaxes):
        return tissue.Material(*(getattr(table, key) for key in keys))
    owner, every = owned(table, mesh, "relaxation")
    lasting = np.array([1.0 - sum(share for share, _ in series) for series in every])[owner]
    E, nu, rho = (np.array(every)[owner] for owner, every in (owned(table, mesh, key) for key in keys))
    return tissue.Material(E, nu, rho, lasting)


# --- places of holes on the surface, found before the mesh is graded towards them -------------------------


def with_places(scenario: Scenario, store: Shared, given: skfem.MeshTet | None = None) -> Scenario:
    """Return the scenario with coordinates instead of every `at = "surface"`.

    The mesh is the one `given`, or generated. Places in the `store` are reused. Raises
    `ScenarioError`, `MeshError`.
    """
    if scenario.tissue is None or all(hole.at != "surface" for hole in scenario.piercing):
        return scenario
    find = partial(holes_on_surface, scenario.tissue, scenario.piercing, given)
    found = store.take("places", places_key(scenario), find)
    holes = moved(scenario.piercing, [hole.place for hole in found])
    check_apart(holes)
    return scenario.model_copy(update={"piercing": holes})


def holes_on_surface(table: model.Tissue, holes: Holes, given: skfem.MeshTet | None) -> Holes:
    """Return the holes at the intersections of their lines with the organ's surface.

    If cells are smaller at holes, the search runs twice: on a mesh without holes, then on a mesh
    graded towards the places found first.
    """
    mesh = mesh_of(table, ()) if given is None else given
    found = landed(mesh, holes)
    size = getattr(table.mesh, "h", None)
    if given is None and size is not None and grading_of(table, found).h_site < size:
        mesh = mesh_of(table, found)
        found = landed(mesh, holes)
    check_smooth(mesh, found)
    return found


def landed(mesh: skfem.MeshTet, holes: Holes) -> Holes:
    """Return the holes at their places on the surface of a mesh.

    Raises `ScenarioError` for a line without intersection.
    """
    find = tissue.landing(mesh)
    places: list[Vector] = []
    for hole in holes:
        place = np.array(hole.place) if hole.at != "surface" else find(hole.place, hole.line)
        if place is None:
            low, high = (np.round(x, 6).tolist() for x in (mesh.p.min(axis=1), mesh.p.max(axis=1)))
            words = {"near": as_toml(hole.near), "line": as_toml(hole.line), "low": low, "high": high}
            raise refused(hole.key("at"), hole.at, "line-missing", **words)
        x, y, z = (place + 0.0).tolist()  # no −0.0
        places.append((x, y, z))
    return moved(holes, places)


def check_inside(holes: Holes, mesh: skfem.MeshTet) -> None:
    """Refuse a hole outside the organ, unless it is near enough to count as a hole on the surface."""
    places = np.array([hole.place for hole in holes]).reshape(-1, 3)
    limit = ON_SURFACE * float(np.linalg.norm(np.ptp(mesh.p, axis=1)))
    for hole, depth in zip(holes, tissue.depths(mesh)(places).tolist() if holes else (), strict=True):
        if depth < -limit:
            nearest = np.round(np.asarray(tissue.landing(mesh)(hole.place, None), float), 6) + 0.0
            raise place_refused(hole, "place-outside", away=-depth, nearest=as_toml(nearest.tolist()))


def moved(holes: Holes, places: Sequence[Vector]) -> Holes:
    """Return the holes at other places [m]."""
    return tuple(hole.model_copy(update={"at": place}) for hole, place in zip(holes, places, strict=True))
