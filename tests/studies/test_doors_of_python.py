"""What `suturefem` offers: runs into folders, folders opened, meshes handed over."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import pyvista as pv
from scipy.sparse import eye_array

import suturefem
from meshes.block import block
from meshes.errors import MeshError
from meshes.given import given_mesh
from studies.output.columns import quantities
from studies.output.reading import ResultsError
from studies.output.records import StepRecord
from studies.scenario import ScenarioError, dump, parse
from studies.scenario.toml import changed, load
from studies.sweeps.sweep import sweep
from tests.studies.test_given import BARE
from tests.studies.test_sweep import ORGAN
from thread.catalogue import suture
from thread.errors import ThreadError

GIVEN = changed(BARE, {"tissue.mesh": {"kind": "given", "accuracy": "given"}, "tissue.boundary": [
    {"name": "bed", "box": [[-0.1, -0.1, -0.011], [0.1, 0.1, -0.009]]}], "tissue.clamp": ["bed"]})  # fmt: skip


def meshes() -> list[Any]:
    """The block of the scenario as each library has it, pyvista's with its tetrahedra turned, and with a second one
    away from it."""
    made = block((0.02, 0.02, 0.01), 5e-3)
    points, tets = made.p.T, made.t.T
    turned = np.column_stack([np.full(len(tets), 4), tets[:, [1, 0, 2, 3]]]).ravel()
    grid = pv.UnstructuredGrid(turned, np.full(len(tets), pv.CellType.TETRA), points)
    two = np.vstack([points, points + np.array([0.05, 0.0, 0.0])]), np.vstack([tets, tets + len(points)])
    return [made, meshio.Mesh(points, [("tetra", tets)]), grid, meshio.Mesh(two[0], [("tetra", two[1])])]


@pytest.mark.parametrize("mesh", meshes(), ids=lambda mesh: type(mesh).__module__.partition(".")[0])
def test_a_mesh_is_handed_over(mesh: Any) -> None:
    """Consistency check: the run is that of the same block made by the scenario, as far as round-off of the order of
    its nodes."""
    made = [*suturefem.prepare(parse(BARE)).advance()][-1][0]
    assert np.linalg.norm(made.piercings[0].force) > 1e-3  # N: the thread presses on its hole
    given = [*suturefem.prepare(parse(GIVEN), mesh=mesh).advance()][-1][0]
    assert given.piercings[0].force == pytest.approx(made.piercings[0].force, rel=1e-6, abs=1e-9)
    assert given.piercings[0].displacement == pytest.approx(made.piercings[0].displacement, rel=1e-6, abs=1e-12)


def test_a_mesh_that_is_none_is_refused() -> None:
    """Independent check: another object, other cells, no organ, another mesh than the digest says, and none at all."""
    made = block((0.02, 0.02, 0.01), 5e-3)
    with pytest.raises(MeshError, match="a str is not a known kind of mesh; give skfem"):
        given_mesh("organ.vtu")
    with pytest.raises(MeshError, match="cells of the kind hexahedron"):
        given_mesh(meshio.Mesh(np.zeros((8, 3)), [("hexahedron", np.arange(8)[None])]))
    with pytest.raises(MeshError, match="boundary 'lost' of the mesh has no facets"):
        given_mesh(made.with_boundaries({"lost": lambda x: x[2] > 1.0}))
    with pytest.raises(ScenarioError, match="has no organ"):
        suturefem.prepare(
            parse({key: value for key, value in ORGAN.items() if key not in ("tissue", "piercing")}), mesh=made
        )
    with pytest.raises(ScenarioError, match=r"prepare\(scenario, mesh=…\)"):
        suturefem.prepare(parse(GIVEN))
    kept = suturefem.prepare(parse(GIVEN), mesh=made).scenario
    assert kept.tissue is not None
    with pytest.raises(ScenarioError, match=r"tissue\.mesh\.sha256"):
        suturefem.prepare(kept, mesh=block((0.02, 0.02, 0.01), 4e-3))
    assert suturefem.prepare(kept, mesh=made).scenario == kept


def test_a_name_in_the_place_of_a_scenario_is_refused(tmp_path: Path) -> None:
    for door in (suturefem.prepare, partial(suturefem.run, folder=tmp_path / "run")):
        with pytest.raises(ScenarioError, match=r"'skin' is refused: it is no scenario; load a file or a scene"):
            door("skin")  # type: ignore[arg-type]
    assert not (tmp_path / "run").exists()


MADE = block((0.02, 0.02, 0.01), 5e-3)
INNER = np.setdiff1d(np.arange(MADE.nfacets), MADE.boundary_facets())
UNKNOWNS = 3 * MADE.nvertices


def named(facets: Any) -> Any:
    """The block with a boundary of these facets, whatever they are."""
    mesh = block((0.02, 0.02, 0.01), 5e-3)
    mesh._boundaries = {"bed": facets}
    return mesh


HELD = changed(BARE, {"tissue.mesh": {"kind": "given", "accuracy": "given"}, "tissue.clamp": ["bed"]})
DOORS: dict[str, tuple[Callable[[], object], str]] = {
    "tables None": (lambda: parse(None), "None is refused: it is no scenario; give its tables"),  # type: ignore[arg-type]
    "a key that is a number": (
        lambda: parse(changed(BARE, {"thread": {1: 2}})),
        r"thread\.1 = 2 is refused: there is no",
    ),
    "a number for a name": (lambda: load(5), "5 is refused: it is no path"),  # type: ignore[arg-type]
    "a number for a folder": (lambda: suturefem.open_run(5), "5 is refused: it is no path"),  # type: ignore[arg-type]
    "a number for a suture": (lambda: suture(5), "suture = 5 is not a name"),  # type: ignore[arg-type]
    **{
        f"friction {law!r}": (
            lambda law=law: suturefem.prepare(parse(BARE), friction=law),
            "give a dict of laws by piercing",
        )
        for law in (0.1, [0.1], "x", {"ring": 0.1}, {"ring": None}, {3: None})
    },
    "points in a plane": (
        lambda: given_mesh(meshio.Mesh(MADE.p.T[:, :2], [("tetra", MADE.t.T)])),
        r"give numbers, \(n, 3\)",
    ),
    "complex points": (
        lambda: given_mesh(meshio.Mesh(MADE.p.T + 0j, [("tetra", MADE.t.T)])),
        "points of .* complex128",
    ),
    "cells of floats": (lambda: given_mesh(meshio.Mesh(MADE.p.T, [("tetra", MADE.t.T * 1.0)])), "give whole numbers"),
    **{
        f"facets {facets}": (
            lambda facets=facets: given_mesh(named(facets)),
            "boundary 'bed' .* whole numbers from 0 to",
        )
        for facets in (np.array([-1]), np.array([10**6]), np.array([0.5]), 5, None)
    },
    "a clamp inside": (
        lambda: suturefem.prepare(parse(HELD), mesh=named(INNER)),
        r"tissue\.clamp = .* lie inside the organ",
    ),
    "complex stiffness": (
        lambda: suturefem.prepare(parse(BARE), stiffness=lambda basis: 1j * eye_array(UNKNOWNS, format="csr")),
        "its numbers are complex128; give real numbers",
    ),
    **{
        f"{key} 5": (lambda key=key: suturefem.prepare(parse(BARE), **{key: 5}), f"{key} = 5 is refused; give a")
        for key in ("stiffness", "energy", "store", "on_step")
    },
    **{
        f"settings {wrong!r}": (lambda wrong=wrong: load("two_piercings", wrong), said)
        for wrong, said in (
            (5, "overrides = 5 is refused: give a list"),
            ("solve.dt=1e-3", "overrides = 'solve.dt=1e-3' is refused: give a list"),
            ([5], "--set 5 is refused: write a dotted key"),
        )
    },
    **{
        f"a refinement with {key} = {wrong!r}": (
            lambda key=key, wrong=wrong: suturefem.refine(BARE, "energy.kinetic", "none", **{key: wrong}),
            f"--{key} .* is refused",
        )
        for key, wrong in (("over", ["h"]), ("levels", None), ("levels", "x"), ("ratio", "x"))
    },
    "a number for workers": (
        lambda: sweep(BARE, {"solve.dt": [1e-3]}, "none", workers=2),  # type: ignore[arg-type]
        "workers = 2 is refused: give studies.workers",
    ),
    "a sweep over a number": (lambda: sweep(BARE, {"solve.dt": 5}, "none"), "give a list of values"),  # type: ignore[dict-item]
    "a sweep of nothing": (lambda: sweep(None, {"solve.dt": [1e-3]}, "none"), "None is refused"),  # type: ignore[arg-type]
    "no direction": (
        lambda: parse(changed(BARE, {"piercing.0.direction": [0, 0, -1e-300]})),
        r"direction = \[0, 0, -1e-300\] is refused: it must not be zero, or too short",
    ),
    "a footprint of a nanometre": (
        lambda: parse(changed(BARE, {"piercing.0.footprint": 1e-9})),
        "below a micrometre",
    ),
    "five times the path": (
        lambda: suturefem.prepare(parse(changed(BARE, {"thread.length": 1.0}))),
        r"thread\.length = 1\.0 is refused: the path is .* lengthen the path by the slack",
    ),
}


@pytest.mark.parametrize("door", DOORS)
def test_what_is_no_thing_of_its_kind_is_refused_in_a_sentence(door: str) -> None:
    """Independent check: what Python lets through the doors is refused with what is to be given."""
    ask, said = DOORS[door]
    with pytest.raises((ScenarioError, MeshError, ResultsError, ThreadError), match=said):
        ask()


def test_a_run_is_opened(tmp_path: Path) -> None:
    """Consistency check: the steps that the callback saw are the rows of the tables, the frames have named blocks with
    the units of their arrays, and the numbers are those of the summary."""
    seen: list[StepRecord] = []
    run = suturefem.run(parse(ORGAN), tmp_path / "run", on_step=seen.append)
    assert repr(run) == f"OpenRun({str(tmp_path / 'run')!r}, completed, 3 frames)"
    assert run.times == pytest.approx([0.0, 6e-3, 8e-3], rel=1e-12)
    assert run.quantities == quantities(run.summary)
    assert dump(run.scenario) == dump(suturefem.open_run(tmp_path / "run").scenario)
    frame = run.frame()
    assert frame.keys() == ["organ", "thread", "piercings"]
    assert frame["thread"].user_dict["units"]["tension"] == "N"
    assert frame["organ"].user_dict["units"]["displacement"] == "m"
    assert frame["piercings"]["force"][0] == pytest.approx(seen[-1].piercings[0].force, rel=1e-6)
    pandas = pytest.importorskip("pandas")
    table = run.table("piercings")
    assert isinstance(table, pandas.DataFrame)
    assert table.attrs["units"]["force_x"] == "N"
    assert table["force_x"].tolist() == [step.piercings[0].force[0] for step in seen]
    assert run.table("events")["event"].tolist() == [event.kind for step in seen for event in step.events]
    with pytest.raises(ResultsError, match="the nearest is piercings"):
        run.table("piercing")
    with pytest.raises(ResultsError, match="table 5 is not in"):
        run.table(5)  # type: ignore[arg-type]
    with pytest.raises(ResultsError, match="frame 'last' is refused: give a whole number"):
        run.frame("last")  # type: ignore[arg-type]
    with pytest.raises(ResultsError, match="holds no run"):
        suturefem.open_run(tmp_path)
    with pytest.raises(ScenarioError, match="already holds a run"):
        suturefem.run(parse(ORGAN), tmp_path / "run")
    assert suturefem.run(parse(ORGAN), tmp_path / "run", resume=True).summary == run.summary


def test_an_exception_of_a_callback_ends_the_run(tmp_path: Path) -> None:
    """Independent check: it is raised, and the folder says so."""

    def stop(step: StepRecord) -> None:
        if step.step == 2:
            raise RuntimeError("far enough")

    with pytest.raises(RuntimeError, match="far enough"):
        suturefem.run(parse(ORGAN), tmp_path, on_step=stop)
    ended = suturefem.open_run(tmp_path)
    assert (ended.summary["status"], ended.summary["error"], ended.summary["steps"]) == ("failed", "far enough", 2)


def test_what_is_offered_stays_what_it_is() -> None:
    """Independent check: a module of a package does not take the place of a function that is called like it, and each
    tells of itself in one line."""
    for _ in range(2):
        for name in set(suturefem.__all__) - {"__version__"}:
            assert callable(getattr(suturefem, name))
    simulation = suturefem.prepare(parse(ORGAN))
    assert repr(simulation) == "Simulation('a ring', 1 piercings, 150 tissue unknowns, 4 steps)"
    shown = repr(next(simulation.advance())[0])
    assert shown.startswith("StepRecord(time=0.0, ") and len(shown) < 5000 and "System(" not in shown
    with pytest.raises(AttributeError, match="no attribute 'fly'"):
        _ = suturefem.fly


@pytest.mark.parametrize("wrong", [None, 5, ["a", 5], []])
def test_names_of_folders_and_numbers_are_text(tmp_path: Path, wrong: Any) -> None:
    """Independent check: other objects are refused in words, before anything is run."""
    for ask in (suturefem.run, partial(suturefem.sweep, over={"thread.damping": [1.0]})):
        with pytest.raises(ScenarioError, match=r"folder = .* is refused: it is no path; give the path"):
            ask(parse(BARE), folder=wrong)
    with pytest.raises(ScenarioError, match=r"quantity = .* is refused; give the name of a number"):
        suturefem.refine(parse(BARE), wrong, tmp_path)
