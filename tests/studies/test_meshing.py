"""Meshes of scenarios: every kind, regions with their materials, and bad geometry in one sentence before any solve."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshio
import numpy as np
import pytest
import skfem

from meshes.checks import volumes
from meshes.errors import MeshError
from meshes.gmsh_session import session
from studies.command import command
from studies.pictures.mesh_report import scene_of
from studies.pictures.section import draw_mesh
from studies.scenario import Scenario, ScenarioError, load, parse
from studies.simulation import meshing, prepare
from studies.simulation.meshing import material_of, organ_mesh
from tests.bounds import IDENTITY
from tests.meshes.samples import NEEDS_GMSH
from tests.meshes.test_skin import cuboid
from tissue.elasticity import elasticity
from tissue.errors import TissueError

BLOCK = {"kind": "block", "size": [0.06, 0.04, 0.02], "h": 5e-3, "accuracy": "given"}
SLIT = {**BLOCK, "kind": "wound", "length": 0.02, "depth": 8e-3}
ELLIPSE = {**SLIT, "shape": "ellipse", "width": 4e-3}
TUBE = {"kind": "tube", "radius": 0.01, "wall": 4e-3, "length": 0.04, "h": 3e-3, "accuracy": "given"}
CYLINDER = {"kind": "cylinder", "radius": 0.01, "length": 0.04, "h": 3e-3, "accuracy": "given"}
ENTRY = {"name": "entry", "at": [-0.005, 0.0, 0.0], "footprint": 1e-3, "direction": "normal"}
EXIT = {**ENTRY, "name": "exit", "at": [0.005, 0.0, 0.0]}
PATH = [
    [-0.02, 0, 0.02],
    [-0.005, 0, 0.01],
    [-0.005, 0, -0.0055],
    [0.005, 0, -0.0055],
    [0.005, 0, 0.01],
    [0.02, 0, 0.02],
]


def scenario(mesh: dict[str, Any], holes: tuple[dict[str, Any], ...] = (), **tissue: Any) -> Scenario:
    organ = {"youngs_modulus": 1e5, "poisson_ratio": 0.45, "density": 1070.0, "mesh": mesh, **tissue}
    thread = {"suture": "2-0 polypropylene", "control_points": 60, "path": PATH}
    return parse({"tissue": organ, "thread": thread, "piercing": list(holes)})


def content(mesh: skfem.MeshTet, cells: np.ndarray) -> float:
    return float(volumes(mesh.p.T, mesh.t.T)[cells].sum())


# -- kinds -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "boundaries"),
    [
        (BLOCK, "left right front back bottom top"),
        (SLIT, "left right front back bottom top lip_left lip_right"),
        pytest.param(
            {**SLIT, "generator": "gmsh"}, "left right front back bottom top lip_left lip_right", marks=NEEDS_GMSH
        ),
        pytest.param(ELLIPSE, "left right front back bottom top lip_left lip_right wound_floor", marks=NEEDS_GMSH),
        pytest.param(CYLINDER, "left right side", marks=NEEDS_GMSH),
        pytest.param(TUBE, "left right inner outer", marks=NEEDS_GMSH),
        pytest.param({**TUBE, "gap": 1e-3}, "left right inner outer stump_left stump_right", marks=NEEDS_GMSH),
    ],
    ids=["block", "slit", "slit by gmsh", "ellipse", "cylinder", "tube", "stumps"],
)
def test_every_kind_names_the_boundaries_that_a_clamp_may_name(table: dict[str, Any], boundaries: str) -> None:
    made = organ_mesh(scenario(table, clamp=boundaries.split()))
    assert set(made.boundaries) == set(boundaries.split())
    with pytest.raises(ScenarioError, match="there is no such boundary"):
        scenario(table, clamp=["elsewhere"])


@NEEDS_GMSH
def test_a_surface_file_is_filled_in_its_unit(tmp_path: Path) -> None:
    points, triangles = cuboid()
    meshio.Mesh(points, {"triangle": triangles}).write(tmp_path / "organ.ply")
    table = {
        "kind": "file",
        "path": str(tmp_path / "organ.ply"),
        "unit": "mm",
        "h": 6e-3,
        "h_site": 2e-3,
        "accuracy": "given",
    }
    made = organ_mesh(scenario(table, ({**ENTRY, "at": [0.02, 0.015, 0.02]},)))
    assert content(made, np.arange(made.nelements)) == pytest.approx(24e-6, rel=1e-6)
    assert set(made.boundaries) == {"surface"}


def test_growth_reaches_the_mesh() -> None:
    sizes = [
        organ_mesh(scenario({**BLOCK, "h_site": 1e-3, "growth": growth, "generator": "structured"}, (ENTRY,))).nvertices
        for growth in (1.2, 2.0)
    ]
    assert sizes[0] > 1.5 * sizes[1]


# -- regions ---------------------------------------------------------------------------------------------------------


LAYERS = [
    {"name": "skin", "depth": [0.0, 2.3e-3], "youngs_modulus": 4e5},
    {"name": "fat", "depth": [2.3e-3, 7e-3], "youngs_modulus": 2e4, "poisson_ratio": 0.3, "density": 900.0},
]


@pytest.mark.parametrize(
    "table",
    [BLOCK, pytest.param({**BLOCK, "generator": "gmsh"}, marks=NEEDS_GMSH), SLIT],
    ids=["structured", "gmsh", "slit"],
)
def test_layers_fill_their_depth_exactly(table: dict[str, Any]) -> None:
    """Independent check: area times thickness, for the grid's or gmsh's planes lie on the borders."""
    made = organ_mesh(scenario(table, region=LAYERS))
    for name, thickness in (("skin", 2.3e-3), ("fat", 4.7e-3)):
        assert content(made, made.subdomains[name]) == pytest.approx(0.06 * 0.04 * thickness, rel=1e-9)


@pytest.mark.parametrize("generator", ["structured", pytest.param("gmsh", marks=NEEDS_GMSH)])
def test_a_box_is_filled_exactly_and_the_later_region_wins(generator: str) -> None:
    lump = {"name": "lump", "box": [[0.0, -0.01, -0.01], [0.013, 0.01, -0.001]], "youngs_modulus": 1e6}
    case = scenario({**BLOCK, "generator": generator}, region=[*LAYERS, lump])
    assert case.tissue is not None
    made = organ_mesh(case)
    assert content(made, made.subdomains["lump"]) == pytest.approx(0.013 * 0.02 * 0.009, rel=1e-9)
    material = material_of(case.tissue, made)
    assert isinstance(material.youngs_modulus, np.ndarray) and isinstance(material.density, np.ndarray)
    assert np.all(material.youngs_modulus[made.subdomains["lump"]] == 1e6)
    assert np.all(material.density[np.setdiff1d(made.subdomains["fat"], made.subdomains["lump"])] == 900.0)


def test_each_region_bears_with_its_own_modulus_and_weighs_by_its_own_density() -> None:
    """Independent check: under a uniform strain ε and ν = 0 the energy is ½ Σ E_i ε² V_i; the mass is Σ ρ_i V_i."""
    layers = [{**layer, "poisson_ratio": 0.0} for layer in LAYERS]
    case = scenario(BLOCK, region=layers, poisson_ratio=0.0)
    assert case.tissue is not None
    made = organ_mesh(case)
    body = elasticity(made, material_of(case.tissue, made))
    strain, area = 1e-3, 0.06 * 0.04
    U = body.flat(np.column_stack([0 * body.points[:, :2], strain * body.points[:, 2]]))
    expected = 0.5 * strain**2 * area * (4e5 * 2.3e-3 + 2e4 * 4.7e-3 + 1e5 * 0.013)
    assert pytest.approx(expected, rel=IDENTITY) == 0.5 * U @ (body.K @ U)
    ones = body.flat(np.column_stack([np.ones(len(body.points)), 0 * body.points[:, :2]]))
    assert ones @ (body.M @ ones) == pytest.approx(area * (1070 * 2.3e-3 + 900 * 4.7e-3 + 1070 * 0.013), rel=IDENTITY)


@pytest.fixture
def two_volumes(tmp_path: Path) -> str:
    """A gmsh file of two named boxes, one upon the other, 2 × 1 × 1 each [mm]."""
    with session() as gmsh:
        boxes = [gmsh.model.occ.addBox(0, 0, z, 2, 1, 1) for z in (0, 1)]
        gmsh.model.occ.fragment([(3, boxes[0])], [(3, boxes[1])])
        gmsh.model.occ.synchronize()
        for name, volume in zip(("dermis", "epidermis"), gmsh.model.getEntities(3), strict=True):
            gmsh.model.addPhysicalGroup(3, [volume[1]], name=name)
        gmsh.model.addPhysicalGroup(2, [1], name="bed")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.6)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(tmp_path / "skin.msh"))
    return str(tmp_path / "skin.msh")


@NEEDS_GMSH
def test_regions_of_a_gmsh_file_go_by_their_names(two_volumes: str) -> None:
    """Independent check: the volumes of the named boxes; names of gmsh's own are not kept."""
    table = {"kind": "file", "path": two_volumes, "unit": "mm", "accuracy": "given"}
    case = scenario(table, clamp=["bed"], region=[{"name": "dermis", "youngs_modulus": 5e4}])
    assert case.tissue is not None
    made = organ_mesh(case)
    assert set(made.subdomains) == {"dermis", "epidermis"} and set(made.boundaries) == {"bed", "surface"}
    assert content(made, made.subdomains["dermis"]) == pytest.approx(2e-9, rel=1e-9)
    material = material_of(case.tissue, made)
    assert isinstance(material.youngs_modulus, np.ndarray)
    assert np.all(material.youngs_modulus[made.subdomains["dermis"]] == 5e4)
    assert np.all(material.youngs_modulus[made.subdomains["epidermis"]] == 1e5)
    with pytest.raises(ScenarioError, match=r"no such region; its regions are dermis, epidermis"):
        organ_mesh(scenario(table, region=[{"name": "derma"}]))


# -- refused ---------------------------------------------------------------------------------------------------------


def refusal(case: Callable[[], Scenario]) -> str:
    with pytest.raises((ScenarioError, MeshError, TissueError)) as caught:
        prepare(case())
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("says", "case"),
    [
        ("a sharp edge of the organ is 0.0005 m", lambda: scenario(BLOCK, ({**EXIT, "at": [0.0295, 0, 0]},))),
        (
            "a sharp edge of the organ is 0 m",
            lambda: scenario(BLOCK, ({**EXIT, "at": [0.03, 0.01, 0], "footprint": 0.0},)),
        ),
        ("touches a clamped", lambda: scenario(BLOCK, (ENTRY, EXIT), clamp=["top"])),
        ("less than both footprints", lambda: scenario(BLOCK, (ENTRY, {**EXIT, "at": [-0.0035, 0, 0]}))),
        ("across the slit", lambda: scenario(SLIT, (ENTRY, {**EXIT, "at": [0.0008, 0, 0]}), clamp=["bottom"])),
        ("across the slit", lambda: scenario(SLIT, (ENTRY, {**EXIT, "at": [0.0, 0.0105, 0]}), clamp=["bottom"])),
        (
            "can still move along x, y, z and turn",
            lambda: scenario({**SLIT, "length": 0.04, "depth": 0.02}, clamp=["left"]),
        ),
        (
            "has 2 parts, and the part at",
            lambda: scenario({**SLIT, "length": 0.04, "depth": 0.02}, roller=["left", "bottom"]),
        ),
        (
            "no cell has its centre in it; the organ spans [-0.03, -0.02, -0.02] to [0.03, 0.02, 0.0] m",
            lambda: scenario(BLOCK, region=[{"name": "a", "box": [[1, 1, 1], [2, 2, 2]]}]),
        ),
    ],
)
def test_bad_geometry_is_refused_in_one_sentence(says: str, case: Callable[[], Scenario]) -> None:
    assert says in refusal(case)


@NEEDS_GMSH
def test_facets_of_a_round_wall_are_no_edges() -> None:
    """An edge of the mesh is none of the organ; the rim of a cylinder is."""
    hole = {**ENTRY, "at": [0.0, 0.0, 0.01], "direction": "free"}
    assert organ_mesh(scenario(CYLINDER, (hole,))).nelements > 0
    assert "a sharp edge of the organ is 0.0005 m" in refusal(
        lambda: scenario(CYLINDER, ({**hole, "at": [0.0195, 0, 0.01]},))
    )


def test_two_halves_that_are_both_held_are_taken() -> None:
    assert organ_mesh(scenario({**SLIT, "length": 0.04, "depth": 0.02}, clamp=["bottom"])).nelements > 0


def test_holes_at_one_place_at_different_times_are_taken() -> None:
    first, second = {**ENTRY, "until": 0.5}, {**ENTRY, "name": "again", "from": 0.5}
    assert len(scenario(BLOCK, (first, second)).piercing) == 2


@pytest.mark.parametrize(
    "table",
    [BLOCK, {**BLOCK, "generator": "gmsh"}, {**ELLIPSE, "h_site": 2e-3}, CYLINDER, TUBE],
    ids=["structured", "gmsh", "wound", "cylinder", "tube"],
)
def test_a_mesh_too_large_for_the_memory_is_refused_before_it_is_made(
    table: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the estimate, the memory and the remedy; nothing is meshed."""
    monkeypatch.setattr(meshing.psutil, "virtual_memory", lambda: SimpleNamespace(available=1.5e6))
    for maker in ("graded_block_structured", "graded_block_gmsh", "wounded_block_gmsh", "cylinder", "tube"):
        monkeypatch.setattr(meshing, maker, lambda *given: pytest.fail("it was meshed"))
    message = refusal(lambda: scenario(table, (ENTRY,)))
    key = "h_site" if "h_site" in table else "h"
    assert f"tissue.mesh.{key} = " in message and "tetrahedra" in message and "unknowns (P1)" in message
    assert "0.0015 GB are available" in message and "use larger elements" in message


def test_a_file_too_large_for_the_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = organ_mesh(scenario(BLOCK))
    meshio.Mesh(made.p.T, {"tetra": made.t.T}).write(tmp_path / "block.vtu")
    monkeypatch.setattr(meshing.psutil, "virtual_memory", lambda: SimpleNamespace(available=1e6))
    message = refusal(lambda: scenario({"kind": "file", "path": str(tmp_path / "block.vtu")}))
    assert message.startswith("tissue.mesh.path") and "0.001 GB are available; use a coarser mesh" in message


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    """Independent check: the key, and the endings of volumes and of surfaces."""
    (tmp_path / "organ.py").write_text("1")
    message = refusal(lambda: organ_mesh(scenario({"kind": "file", "path": str(tmp_path / "organ.py")})))
    assert message.startswith("tissue.mesh.path = ") and ".msh, .vtk, " in message and ".stl, .obj, " in message


# -- the scenarios of this repository, and the command ---------------------------------------------------------------


@NEEDS_GMSH
@pytest.mark.parametrize(
    ("name", "counted"),
    [
        ("running_stitch", "6 piercings, "),
        ("interrupted_stitches", "6 piercings, 3 pieces of thread, "),
        ("mattress", "4 piercings, 2 tracts of 16 balls in total, 1 tie, "),
    ],
)
def test_the_stitched_wounds_can_be_run(name: str, counted: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["check", str(Path(command.__file__).parents[1] / "scenario" / "scenes" / f"{name}.toml")]) == 0
    assert f"can be run: {counted}" in capsys.readouterr().out


def test_suture_mesh_writes_the_mesh_its_quality_and_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file reads back to the same mesh, its arrays are those of regions and boundaries."""
    path, out = tmp_path / "wound.toml", tmp_path / "organ.vtu"
    path.write_text(
        """
        [tissue]
        youngs_modulus = 1e5
        poisson_ratio = 0.45
        density = 1070.0
        clamp = ["bottom"]
        mesh = { kind = "wound", size = [0.06, 0.04, 0.02], h = 5e-3, length = 0.02, depth = 8e-3, accuracy = "given" }
        region = [{ name = "skin", depth = [0, 2e-3], youngs_modulus = 4e5 }]
        [thread]
        suture = "2-0 polypropylene"
        path = [[-0.03, 0, 0.01], [-0.01, 0, 0], [0.01, 0, 0], [0.03, 0, 0.01]]
        [[piercing]]
        name = "entry"
        at = [-0.01, 0, 0]
        """
    )
    assert command.main(["mesh", str(path), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    made = organ_mesh(load(path))
    for words in (
        f"{made.nvertices} vertices, {made.nelements} tetrahedra, 48000 mm³",
        f"{3 * made.nvertices} with P1, {3 * (made.nvertices + made.nedges)} with P2",
        "dihedral angle",
        "radius ratio",
        "entry: edge length",
        "lip_left: ",
        "160 mm²",
        "skin: number 1",
        "4800 mm³",
        "organ.png",
    ):
        assert words in printed
    assert (tmp_path / "organ.png").stat().st_size > 10_000
    assert sorted(file.name for file in tmp_path.iterdir()) == ["organ.png", "organ.vtu", "wound.toml"]
    data = meshio.read(out)
    assert np.array_equal(data.points, made.p.T) and np.array_equal(data.cells_dict["tetra"], made.t.T)
    region, lip = data.cell_data_dict["region"], data.cell_data_dict["boundary_lip_left"]
    assert np.array_equal(np.flatnonzero(region["tetra"] == 1), np.sort(made.subdomains["skin"]))
    assert lip["triangle"].sum() == len(made.boundaries["lip_left"]) and not lip["tetra"].any()


def test_without_opengl_the_mesh_is_drawn_in_a_section(tmp_path: Path) -> None:
    """The plane lies beside the nodes of a regular mesh, and in the body where there are no piercings."""
    for holes in ((ENTRY, EXIT), ()):
        case = scenario(SLIT, holes)
        draw_mesh(scene_of(organ_mesh(case), case), tmp_path / "section.png")
        assert (tmp_path / "section.png").stat().st_size > 10_000


def test_suture_mesh_refuses_what_is_no_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figure = str(Path(command.__file__).parents[1] / "scenario" / "scenes" / "paper_figure_1.toml")
    assert command.main(["mesh", figure, "--out", str(tmp_path / "a.vtu")]) == 2
    assert "tissue is missing" in capsys.readouterr().err
    assert command.main(["mesh", figure, "--out", str(tmp_path / "a.stl")]) == 2
    assert "name it a.vtu" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
