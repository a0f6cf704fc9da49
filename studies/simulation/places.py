"""Places of holes on the organ's surface, found before the mesh is graded towards them."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import skfem

import tissue
from studies import scenario as model
from studies.scenario import Scenario
from studies.scenario.piercing import place_refused
from studies.scenario.refusal import as_toml
from studies.scenario.scenario import check_apart
from studies.scenario.table import refused
from studies.scenario.values import Vector
from studies.simulation.meshing import check_smooth, mesh_of
from studies.simulation.sharing import Shared, places_key
from tissue.sites.surface import ON_SURFACE

Holes = tuple[model.Piercing, ...]


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
    if given is None and getattr(table.mesh, "h_site", None) is not None:
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
