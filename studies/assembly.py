"""From a scenario to the coupled system: mesh, organ, thread, piercings and a consistent start."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import skfem
from numpy.typing import NDArray

import tissue
from coupling.start import start
from coupling.system import Friction, Piercing, State, System
from meshes.block import block, graded_block_gmsh, graded_block_structured
from meshes.cylinder import cylinder
from meshes.file import read
from meshes.units import metres_per_unit
from studies import scenario as model
from studies.refusal import dotted, refused
from studies.scenario import Scenario, ScenarioError
from thread.catalogue import Section, suture
from thread.ends import Clamped, Driven, End, Fixed, Free, Pulled
from thread.path import RoundedPath, rounded
from thread.spline import Spline, graded_knots
from thread.thread import MASS_POINTS, Thread, gauss_rule

Array = NDArray[np.float64]

REACH = 0.1  # of the thread's length: how far from a piercing its spans are fine


@dataclass(frozen=True)
class Assembly:
    """A scenario made ready: the scenario with every default known, the system, and what lays the thread."""

    scenario: Scenario
    system: System
    path: RoundedPath
    s: Array
    body: tissue.Elasticity | None

    @property
    def given(self) -> Array:
        """Abscissa at which each piercing begins, `(p,)` [m]; NaN where the thread is nearest to it then."""
        return np.array([np.nan if hole.s is None else hole.s for hole in self.scenario.piercing])

    def start(self) -> State:
        """The consistent start (Φ = 0, thread as near the path as that allows)."""
        thread = self.system.thread
        stretch = self.path.length / thread.spline.end
        points = self.path.position(gauss_rule(thread.spline, MASS_POINTS).s * stretch)
        return start(self.system, self.s, points, stretch)


def assemble(scenario: Scenario) -> Assembly:
    """Build everything that is known before the first step.

    Raises `ScenarioError`, `MeshError`, `TissueError`, `ThreadError` for input that cannot be run.
    """
    path = rounded(scenario.thread.path)
    length = scenario.thread.length or path.length
    body = body_of(scenario)
    organ = organ_of(scenario, body)
    s = abscissae(scenario, path, length)
    known = [(hole.name, value) for hole, value in zip(scenario.piercing, s, strict=True) if is_known(hole)]
    model.check_order([name for name, _ in known], [value for _, value in known], length)
    system = System(
        thread=thread_of(scenario.thread, length, s),
        ends=(end_of(scenario.thread.start, path, 0.0), end_of(scenario.thread.end, path, path.length)),
        organ=organ,
        piercings=tuple(piercing_of(hole) for hole in scenario.piercing),
        gravity=np.array(scenario.solve.gravity),
        epsilon=scenario.solve.epsilon,
    )
    return Assembly(model.resolved(scenario, length, s), system, path, np.array(s), body)


def is_known(hole: model.Piercing) -> bool:
    """Whether the abscissa of a piercing is known before the first step."""
    return hole.s is not None or hole.from_ == 0.0


def abscissae(scenario: Scenario, path: RoundedPath, length: float) -> list[float]:
    """Abscissa of every piercing at the start [m]: given, or where the path is nearest after the piercing before it."""
    s: list[float] = []
    for hole in scenario.piercing:
        s.append(hole.s if hole.s is not None else passing(path, hole.at, after=s[-1:]) * length / path.length)
    return s


def passing(path: RoundedPath, point: Sequence[float], after: Sequence[float]) -> float:
    """Abscissa on the path [m] of its nearest pass by a point; of passes as near, the first `after` an abscissa."""
    places, distances = path.passes(point)
    near = places[distances <= distances.min() + 1e-9 * path.length]
    later = near[near > after[0]] if after else near
    return float(later[0] if later.size else near[0])


def thread_of(table: model.Thread, length: float, s: Sequence[float]) -> Thread:
    """The thread, its knots graded towards the piercings."""
    return Thread(
        spline=Spline(graded_knots(length, table.control_points, s, table.graded, REACH * length)),
        section=section_of(table),
        bending=table.bending,
        damping=table.damping,
        point_masses=(table.start.mass, table.end.mass),
    )


def section_of(table: model.Thread) -> Section:
    """The section named, or the one described."""
    if table.suture is not None:
        return suture(table.suture)
    given = (table.diameter, table.density, table.youngs_modulus, table.poisson_ratio)
    return Section(*(value for value in given if value is not None))


def end_of(table: model.End, path: RoundedPath, at: float) -> End:
    """What holds the end of the thread that lies at the abscissa `at` of the path."""
    match table:
        case model.FixedEnd():
            return Fixed(path.position(at))
        case model.ClampedEnd():
            return Clamped(path.position(at), path.tangent(at))
        case model.PulledEnd():
            return Pulled(np.array(table.force), table.ramp)
        case model.DrivenEnd():
            return Driven(np.array(table.waypoints))
    return Free()


def piercing_of(hole: model.Piercing) -> Piercing:
    """The constraint of a hole."""
    given = hole.friction
    friction = None if given is None else Friction(given.static, given.kinetic, given.grip, hole.channel)
    until = np.inf if hole.until is None else hole.until
    return Piercing(hole.name, hole.kind == "sliding", hole.direction != "free", friction, hole.from_, until)


def site_of(hole: model.Piercing) -> tissue.Site:
    """The place of a hole on the organ."""
    direction = None if hole.direction == "free" else hole.direction
    return tissue.Site(hole.at, hole.footprint, hole.weight, direction, f'piercing "{hole.name}"')


def body_of(scenario: Scenario) -> tissue.Elasticity | None:
    """The organ's discrete elasticity, None without an organ."""
    table = scenario.tissue
    if table is None:
        return None
    mesh = with_boxes(mesh_of(table.mesh, scenario.piercing), table.boundary)
    model.check_clamp(table.clamp, sorted(mesh.boundaries or {}))
    material = tissue.Material(table.youngs_modulus, table.poisson_ratio, table.density)
    return tissue.elasticity(mesh, material, table.element, table.clamp)


def organ_of(
    scenario: Scenario, body: tissue.Elasticity | None
) -> tissue.FixedSites | tissue.QuasiStaticOrgan | tissue.DynamicOrgan:
    """The organ as the coupling sees it: with inertia, without, or points fixed in space."""
    sites = [site_of(hole) for hole in scenario.piercing]
    if body is None or scenario.tissue is None:
        return tissue.fixed_sites(sites)
    placed = tissue.build_sites(body, sites)
    if scenario.tissue.inertia and scenario.solve.kind == "dynamic":
        rayleigh = scenario.tissue.rayleigh
        return tissue.DynamicOrgan(body, placed, scenario.solve.gravity, scenario.tissue.solver, rayleigh=rayleigh)
    return tissue.QuasiStaticOrgan(body, placed, scenario.solve.gravity, scenario.tissue.solver)


def mesh_of(table: model.Mesh, holes: Sequence[model.Piercing]) -> skfem.MeshTet:
    """The organ's mesh, graded towards the holes where a size is given for them."""
    if isinstance(table, model.FileMesh):
        return read(table.path, metres_per_unit(table.unit))
    sites = [hole.at for hole in holes]
    radius = max((hole.footprint for hole in holes), default=0.0)
    if isinstance(table, model.CylinderMesh):
        near = [inside_cylinder(site, table.radius, table.length) for site in sites]
        return cylinder(table.radius, table.length, table.h, table.h_site, near, site_radius=radius)
    if table.h_site is None and table.generator == "structured":
        return block(table.size, table.h)
    graded = graded_block_structured if table.generator == "structured" else graded_block_gmsh
    return graded(table.size, table.h, table.h_site or table.h, inside_block(sites, table.size), radius=radius)


def inside_block(sites: Sequence[Sequence[float]], size: Sequence[float]) -> Array:
    """The nearest points of the block: a site off the organ is refused later, with its distance."""
    x, y, z = size
    return np.clip(np.reshape(sites, (-1, 3)), (-x / 2, -y / 2, -z), (x / 2, y / 2, 0.0))


def inside_cylinder(site: Sequence[float], radius: float, length: float) -> Array:
    """The nearest point of the cylinder, as for the block."""
    x, y, z = site
    share = min(1.0, radius / max(float(np.hypot(y, z)), radius))
    return np.array([np.clip(x, -length / 2, length / 2), share * y, share * z])


def with_boxes(mesh: skfem.MeshTet, boxes: Sequence[model.Boundary]) -> skfem.MeshTet:
    """The mesh with the boundaries that the scenario adds: surface facets whose centre lies in a box."""
    named = dict(mesh.boundaries or {})
    surface = mesh.boundary_facets()
    centres = mesh.p[:, mesh.facets[:, surface]].mean(axis=1)
    for box in boxes:
        if box.name in named:
            raise ScenarioError(
                refused(
                    dotted(["tissue", "boundary", box.name]),
                    box.name,
                    "the mesh has one of that name; rename it",
                )
            )
        named[box.name] = surface[inside(centres, np.array(box.box))]
        if named[box.name].size == 0:
            low, high = mesh.p.min(axis=1), mesh.p.max(axis=1)
            problem = f"no surface facet has its centre in it; the organ spans {low} to {high} m"
            raise ScenarioError(refused(dotted(["tissue", "boundary", box.name, "box"]), box.box, problem))
    return mesh.with_boundaries(named)


def inside(points: Array, corners: Array) -> NDArray[np.bool_]:
    """Which columns of `points` (3, k) lie in the box of two corners (2, 3)."""
    low, high = corners.min(axis=0)[:, None], corners.max(axis=0)[:, None]
    return np.asarray(np.all((points >= low) & (points <= high), axis=0))
