"""Holes sought on the organ's surface: where they come to lie, what is said of it, and what is refused."""

import json
import tomllib
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import skfem

import tissue
from studies.command import command
from studies.command.summary import place_lines
from studies.scenario import Piercing, Scenario, ScenarioError, load, parse
from studies.scenario.scenario import check_apart
from studies.scenario.toml import dump
from studies.simulation import prepare
from studies.simulation.assembly import assemble
from studies.simulation.meshing import with_places
from studies.simulation.sharing import Shared
from tests.bounds import IDENTITY
from tests.meshes.samples import NEEDS_GMSH
from tests.meshes.test_skin import sphere
from tests.studies.samples import ANCHORED

BLOCK = {"kind": "block", "size": [0.06, 0.04, 0.02], "h": 5e-3, "generator": "structured", "accuracy": "given"}
RADIUS, LONG = 0.01, 0.04
CYLINDER = {"kind": "cylinder", "radius": RADIUS, "length": LONG, "h": 4e-3, "h_site": 1e-3, "accuracy": "given"}
ABOVE = {"name": "entry", "at": "surface", "near": [-0.005, 0.001, 0.003], "footprint": 1e-3}


def scenario(mesh: dict[str, Any] | None, *holes: dict[str, Any]) -> Scenario:
    organ = {"youngs_modulus": 1e5, "poisson_ratio": 0.45, "density": 1070.0, "clamp": [], "mesh": mesh}
    thread = {"suture": "2-0 polypropylene", "control_points": 40, "path": [[-0.005, 0, -0.01], [-0.005, 0, 0.03]]}
    return parse({"thread": thread, "piercing": list(holes)} | ({"tissue": organ} if mesh else {}))


def place(mesh: dict[str, Any], **keys: Any) -> np.ndarray:
    return np.array(with_places(scenario(mesh, {**ABOVE, **keys}), Shared()).piercing[0].place)


# -- where a line meets a surface ------------------------------------------------------------------------------------


def test_a_line_meets_a_ball_on_a_facet_nearest_to_the_point() -> None:
    """Independent check: in the plane of a facet and on the line to round-off, off the sphere by less than an edge of
    the mesh is; the way in from either side, and what is nearest from inside and outside. A line that passes by meets
    nothing."""
    mesh = skfem.MeshTet.init_ball(3)
    corners = mesh.p.T[mesh.facets[:, mesh.boundary_facets()].T]
    chord = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    find, along = tissue.landing(mesh), np.array([0.1, 0.2, -2.0])
    for sign in (1.0, -1.0):
        start = np.array([0.1, 0.2, 0.3]) - 2.0 * sign * along
        found = find(start, along)
        assert found is not None and np.linalg.norm(np.cross(found - start, along)) < IDENTITY
        assert 1.0 - 0.5 * chord**2 < np.linalg.norm(found) <= 1.0 + IDENTITY
        assert np.abs(np.sum((found - corners[:, 0]) * normals, axis=1)).min() < IDENTITY
        assert (found - start) @ along * sign > 0.0 and found @ along * sign < 0.0
    assert np.allclose(find([0.0, 0.0, 3.0], None), [0, 0, 1], atol=IDENTITY)  # the sphere's pole, and a vertex
    inside = find([0.0, 0.0, 0.7], None)
    assert inside is not None and 0.3 - 0.5 * chord**2 < np.linalg.norm(inside - [0.0, 0.0, 0.7]) <= 0.3
    assert find(np.array([0.0, 1.1, 5.0]), along * [0, 0, 1]) is None


@pytest.mark.parametrize(
    ("keys", "there"),
    [
        ({}, [-0.005, 0.001, 0.0]),
        ({"along": [1.0, 0.0, -1.0]}, [-0.002, 0.001, 0.0]),
        ({"along": [-10.0, 0.0, 10.0]}, [-0.002, 0.001, 0.0]),
        ({"direction": [1.0, 0.0, -1.0]}, [-0.002, 0.001, 0.0]),
        ({"direction": [1.0, 0.0, -1.0], "along": [0.0, 0.0, 1.0]}, [-0.005, 0.001, 0.0]),
        ({"near": [-0.005, 0.001, -0.004]}, [-0.005, 0.001, 0.0]),
        ({"near": [0.0, 0.0, -0.018], "along": [0, 0, 1]}, [0.0, 0.0, -0.02]),
        ({"near": [0.05, 0.003, -0.01], "direction": "normal"}, [0.03, 0.003, -0.01]),
    ],
)
def test_a_place_on_a_block_is_the_known_one(keys: dict[str, Any], there: list[float]) -> None:
    """Independent check: from above, along a slanted line in either sense, along the needle, from below and inside."""
    found = place(BLOCK, **{key: np.array(v, float).tolist() if key != "direction" else v for key, v in keys.items()})
    assert np.allclose(found, there, atol=IDENTITY)


@NEEDS_GMSH
def test_a_place_on_a_cylinder_is_on_the_facets_that_are_fine_there() -> None:
    """Independent check: off the round wall by no more than the chord of an edge there, which is a sixteenth of that of
    an edge elsewhere."""
    found = place(CYLINDER, near=[0.003, 0.002, 0.02], along=[0.0, 0.0, -1.0])
    sagitta = CYLINDER["h_site"] ** 2 / (8.0 * RADIUS)
    assert found[:2].tolist() == [0.003, 0.002]
    assert -1.5 * sagitta < np.hypot(found[1], found[2]) - RADIUS <= IDENTITY


@NEEDS_GMSH
def test_a_place_on_a_surface_file_makes_a_hole(tmp_path: Path) -> None:
    """Independent check: a hole sought on a ball from a file of its surface lies on the ball's wall, and has the normal
    of the ball there."""
    points, triangles = sphere(RADIUS, 3)
    meshio.Mesh(points, {"triangle": triangles}).write(tmp_path / "ball.stl", file_format="stl")
    mesh = {"kind": "file", "path": str(tmp_path / "ball.stl"), "h": 3e-3, "accuracy": "given"}
    asked = scenario(mesh, {**ABOVE, "near": [0.002, 0.001, 0.02], "along": [0.0, 0.0, -1.0], "direction": "normal"})
    table = asked.model_copy(update={"piercing": (asked.piercing[0].model_copy(update={"s": 0.02}),)})
    simulation = prepare(table)
    sites = simulation.assembly.organ.sites
    outwards = sites.points[0] / np.linalg.norm(sites.points[0])
    assert abs(np.linalg.norm(sites.points[0]) - RADIUS) < 0.03 * RADIUS
    assert sites.normals[0] @ outwards > 0.99


# -- what is said of it ----------------------------------------------------------------------------------------------

RUN = ANCHORED.replace("h = 5.0e-3", "h = 5.0e-3\nh_site = 2.5e-3").replace(
    "at = [0, 0, 0]", 'at = "surface"\nnear = [0.0, 0.0, 0.006]'
)


@pytest.mark.parametrize(("off", "told"), [(6e-18, ""), (2e-5, ", moved by 0.02 mm")])
def test_a_hole_at_its_place_is_not_said_to_have_moved(off: float, told: str) -> None:
    """Independent check: what rounding leaves of a way is none; a fiftieth of a millimetre is said."""
    hole = Piercing(name="a", at=(0.0, 0.0, 0.0), near=(0.0, 0.0, off))
    assert list(place_lines([hole])) == [f"place      a: on the surface at [0.00, 0.00, 0.00] mm{told}"]


def test_a_run_says_by_how_much_a_hole_was_moved_and_runs_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Independent check: 6 mm, in the summary, on the console, in a check and in a remark. The scenario that the run
    writes has the place, and gives the same numbers; so does the scenario of a hole that was put there."""
    (tmp_path / "a.toml").write_text(RUN, encoding="utf-8")
    assert command.main(["run", str(tmp_path / "a.toml"), "--out", str(tmp_path / "a"), "--no-picture"]) == 0
    told = "place      anchor: on the surface at [0.00, 0.00, 0.00] mm, moved by 6 mm"
    assert told in capsys.readouterr().out
    whole = tmp_path / "a" / "scenario.toml"
    assert load(whole).piercing[0].at == (0.0, 0.0, 0.0)
    assert command.main(["run", str(whole), "--out", str(tmp_path / "b"), "--no-picture", "--json"]) == 0
    capsys.readouterr()
    (tmp_path / "c.toml").write_text(RUN.replace('"surface"', "[0, 0, 0]").replace("near", "# near"), encoding="utf-8")
    assert command.main(["run", str(tmp_path / "c.toml"), "--out", str(tmp_path / "c"), "--no-picture", "--json"]) == 0
    capsys.readouterr()
    first, again, put = (json.loads((tmp_path / run / "summary.json").read_text()) for run in "abc")
    assert first["piercings"]["anchor"]["moved"] == 0.006
    assert [said["where"] for said in first["remarks"] if said["code"] == "moved"] == ["anchor"]
    assert first["piercings"] == again["piercings"] and first["remarks"] == again["remarks"]
    assert first["energy"] == again["energy"] == put["energy"]
    assert "moved" not in put["piercings"]["anchor"]
    assert command.main(["check", str(tmp_path / "a.toml")]) == 0
    assert told in capsys.readouterr().out
    assert command.main(["check", str(tmp_path / "a.toml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["moved"] == {"anchor": 0.006}


def test_places_are_found_once_for_cases_that_share_them() -> None:
    """Independent check: another thread does not look for them again; another point does."""
    store, first = Shared(), scenario(BLOCK, ABOVE)
    found = with_places(first, store)
    assert load_of(found) == (-0.005, 0.001, 0.0)
    other = first.model_copy(update={"thread": first.thread.model_copy(update={"control_points": 50})})
    again = with_places(other, store)
    assert again.piercing == found.piercing and again.thread.control_points == 50
    assert load_of(with_places(scenario(BLOCK, {**ABOVE, "near": [0.0, 0.0, 0.003]}), store)) == (0.0, 0.0, 0.0)
    assert parse(json.loads(json.dumps(found.model_dump(mode="json", by_alias=True, exclude_none=True)))) == found
    assert tomllib.loads(dump(found))["piercing"][0]["near"] == [-0.005, 0.001, 0.003]


def load_of(found: Scenario) -> object:
    return found.piercing[0].at


# -- refused ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("says", "mesh", "keys"),
    [
        (
            'piercing.entry.at = "surface" is refused: the line through near = [-0.005, 0.001, 0.003] along '
            "[1.0, 0.0, 0.0] does not meet the organ, which spans [-0.03, -0.02, -0.02] to [0.03, 0.02, 0.0] m",
            BLOCK,
            {"along": [1.0, 0.0, 0.0]},
        ),
        ("does not meet the organ", BLOCK, {"near": [0.1, 0.0, 0.003], "along": [0.0, 0.0, 1.0]}),
        (
            'piercing.entry.at = "surface" is refused: near gives [0.0295, 0.0, 0.0] m on the surface, and a sharp '
            "edge of the organ is 0.0005 m from it, within its footprint of 0.001 m",
            BLOCK,
            {"near": [0.0295, 0.0, 0.003]},
        ),
        ("near gives [0.03, 0.0, 0.0] m on the surface", BLOCK, {"near": [0.04, 0.0, 0.003]}),
        ("near is missing", BLOCK, {"near": None}),
        ('at = "skin" is refused', BLOCK, {"at": "skin"}),
        ("along = [0, 0, 0] is refused", BLOCK, {"along": [0.0, 0.0, 0.0]}),
        ("its line needs a point", BLOCK, {"at": [0, 0, 0], "near": None, "along": [1, 0, 0]}),
        ("without [tissue] there is no surface", None, {}),
    ],
)  # fmt: skip
def test_what_finds_no_place_is_refused_in_one_sentence(
    says: str, mesh: dict[str, Any] | None, keys: dict[str, Any]
) -> None:
    """Independent check: lines that pass by, a footprint that an edge cuts, keys that do not fit one another."""
    given = {key: value for key, value in {**ABOVE, **keys}.items() if value is not None}
    with pytest.raises(ScenarioError) as caught:
        prepare(scenario(mesh, given))
    assert says in str(caught.value) and "\n" not in str(caught.value)


def test_holes_that_land_on_one_another_are_refused() -> None:
    """Independent check: two that are far apart where they are asked for, and not on the surface."""
    exit_ = {**ABOVE, "name": "exit", "near": [-0.0035, 0.001, 0.02], "along": [0.0, 0.0, -1.0]}
    asked = scenario(BLOCK, ABOVE, exit_)
    check_apart([hole.model_copy(update={"at": hole.near}) for hole in asked.piercing])
    with pytest.raises(ScenarioError, match=r"near gives \[-0.0035, 0.001, 0.0\] m on the surface, and it is 0.0015 m"):
        with_places(asked, Shared())


@NEEDS_GMSH
def test_equal_holes_of_a_tube_are_equal() -> None:
    """Facets near a hole are as small as its footprint: holes lie on the wall, and their compliances are equal."""
    wall, footprint, angles = {"kind": "tube", "wall": 2e-3, "radius": RADIUS, "length": LONG, "h": 4e-3}, 0.6e-3, 4
    turns = np.pi / 180 * (20 + 90 * np.arange(angles))
    ways = np.stack([np.zeros(angles), -np.sin(turns), np.cos(turns)], axis=1)
    holes = [
        ABOVE
        | {"name": f"at {k}", "near": (RADIUS * way).tolist(), "along": way.tolist(), "s": 2e-3 * (k + 1)}
        | {"footprint": footprint}
        for k, way in enumerate(ways)
    ]
    tables = tomllib.loads(dump(scenario(wall, *holes)))
    tables["tissue"] |= {"clamp": ["left", "right"], "inertia": False}
    tables["solve"] = {"kind": "static"}
    run = assemble(parse(tables))
    places = np.array([hole.place for hole in run.holes])
    below = RADIUS - np.linalg.norm(places[:, 1:], axis=1)
    assert below.max() <= (1.5 * footprint) ** 2 / (8 * RADIUS)  # of an edge at most half again as long as asked
    C = np.array([np.diag(run.system.organ.operator(0.0, 0.0).C)[9 * k : 9 * k + 3].sum() for k in range(angles)])
    assert np.ptp(C) <= 0.02 * C.mean()
