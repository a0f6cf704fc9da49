"""``suture mesh``: the organ's mesh as a file for ParaView, with its quality and a picture."""

from pathlib import Path

import meshio
import numpy as np
import skfem
from numpy.typing import NDArray

import tissue
from meshes.checks import volumes
from meshes.quality import quality, radius_ratios, size_at
from studies.arrays import MILLI, Array
from studies.lists import list_of, sentences
from studies.output.files import write_bytes
from studies.pictures.picture import draw_scene
from studies.pictures.scene import MeshScene
from studies.scenario import Scenario, ScenarioError
from studies.simulation.assembly import assemble
from studies.simulation.meshing import organ_mesh, with_places
from studies.simulation.sharing import Shared

Indices = NDArray[np.integer]

say = sentences(list_of(__file__, "mesh.toml"))
NO_REGION, NO_CELL = 0, -1  # values of the array `region` in addition to the regions' numbers


def write_report(scenario: Scenario, path: Path) -> list[str]:
    """Make the mesh and write it to `path` (.vtu); return the lines for a person.

    A picture is written next to it.

    Raises `ScenarioError` or `MeshError` for a mesh that cannot be made or used.
    """
    if path.suffix.lower() != ".vtu":
        raise ScenarioError(f"--out {path} is refused: the mesh is a ParaView file; name it {path.stem}.vtu")
    scenario = with_places(scenario, Shared())
    refined = scenario.tissue is not None and scenario.tissue.mesh.accuracy != "given"
    fit = assemble(scenario).fit if refined else None
    mesh = organ_mesh(scenario) if fit is None else fit.body.mesh
    scratch = path.with_name(f".{path.stem}.part.vtu")
    paraview(mesh, None if fit is None else fit.indicators).write(scratch, file_format="vtu")
    write_bytes(path, scratch.read_bytes())
    scratch.unlink()
    line, _ = draw_scene(scene_of(mesh, scenario), path.with_suffix(".png"))
    return [*lines(mesh, scenario), *round_lines(fit), "", f"ParaView   {path}", f"picture    {line}"]


def round_lines(fit: tissue.Fitted | None) -> list[str]:
    """Return the lines on the rounds of refinement."""
    rounds = () if fit is None else fit.rounds
    return [
        f"round {number}    {one.unknowns} unknowns, largest error of a hole's compliance {100.0 * one.error:.2g} %"
        for number, one in enumerate(rounds, start=1)
    ]


def lines(mesh: skfem.MeshTet, scenario: Scenario) -> list[str]:
    """Return the lines on size, quality, boundaries and regions, and on cells at each piercing."""
    found, content = quality(mesh), volumes(mesh.p.T, mesh.t.T)
    sizes = {"volume": content.sum() / MILLI**3, "least": found.edge_min / MILLI, "most": found.edge_max / MILLI}
    unknowns = 3 * mesh.nvertices, 3 * (mesh.nvertices + mesh.nedges)
    out = say("mesh", mesh=mesh, found=found, unknowns=unknowns, **sizes).splitlines()
    for hole in scenario.piercing:
        out.append(say("site", hole=hole, edge=size_at(mesh, np.array(hole.place)) / MILLI, a=hole.footprint / MILLI))
    for name, facets in (mesh.boundaries or {}).items():
        out.append(say("boundary", name=name, count=len(facets), area=areas(mesh, facets).sum() / MILLI**2))
    for number, (name, cells) in enumerate((mesh.subdomains or {}).items(), start=NO_REGION + 1):
        volume = content[cells].sum() / MILLI**3
        out.append(say("region", name=name, number=number, count=len(cells), volume=volume))
    return out


def areas(mesh: skfem.MeshTet, facets: Indices) -> Array:
    """Return the areas of facets by their numbers [m²]."""
    a, b, c = np.moveaxis(mesh.p.T[mesh.facets[:, facets].T], 1, 0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def region_numbers(mesh: skfem.MeshTet) -> Indices:
    """Return the number of the region of each cell.

    Regions are numbered from 1 in the order of their names. Cells outside all regions have 0.
    """
    numbers = np.full(mesh.nelements, NO_REGION)
    for number, cells in enumerate((mesh.subdomains or {}).values(), start=NO_REGION + 1):
        numbers[cells] = number
    return numbers


def paraview(mesh: skfem.MeshTet, indicators: Array | None = None) -> meshio.Mesh:
    """Return tetrahedra and surface triangles with cell arrays.

    - `region`: number of the region, −1 on triangles,
    - `radius_ratio`: quality, 0 on triangles,
    - `indicator`: with `indicators`, the cells' shares of the holes' relative errors,
    - `boundary_…`: for each boundary, 1 on its triangles,
    - `region_…`: for each region, 1 in its cells.
    """
    named = mesh.boundaries or {}
    facets = np.unique(np.concatenate([mesh.boundary_facets(), *named.values()]))
    m, k = mesh.nelements, len(facets)
    data = {"region": [region_numbers(mesh), np.full(k, NO_CELL)]}
    data["radius_ratio"] = [radius_ratios(mesh.p.T[mesh.t.T]), np.zeros(k)]
    if indicators is not None:
        data["indicator"] = [indicators, np.zeros(k)]
    for name, chosen in named.items():
        data[f"boundary_{name}"] = [np.zeros(m, dtype=np.int8), np.isin(facets, chosen).astype(np.int8)]
    for name, cells in (mesh.subdomains or {}).items():
        data[f"region_{name}"] = [np.isin(np.arange(m), cells).astype(np.int8), np.zeros(k, dtype=np.int8)]
    return meshio.Mesh(mesh.p.T, [("tetra", mesh.t.T), ("triangle", mesh.facets[:, facets].T)], cell_data=data)


def scene_of(mesh: skfem.MeshTet, scenario: Scenario) -> MeshScene:
    """Return the scene of a mesh."""
    lips = [mesh.facets[:, facets].T for name, facets in (mesh.boundaries or {}).items() if name.startswith("lip_")]
    sites = np.reshape([hole.place for hole in scenario.piercing], (-1, 3))
    facets = np.concatenate([np.empty((0, 3), dtype=np.int64), *lips])
    return MeshScene(mesh.p.T, mesh.t.T, region_numbers(mesh), facets, sites, scenario.title)
