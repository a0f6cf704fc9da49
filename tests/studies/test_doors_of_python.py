"""What `studies` offers from Python: runs into folders, folders opened, meshes handed over."""

from functools import partial
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import pyvista as pv

import studies
from meshes.block import block
from meshes.errors import MeshError
from meshes.given import given_mesh
from studies.output.quantities import quantities
from studies.output.reading import ResultsError
from studies.output.records import StepRecord
from studies.scenario import ScenarioError, dump, parse
from studies.scenario.toml import changed
from tests.studies.test_given import BARE
from tests.studies.test_sweep import ORGAN

GIVEN = changed(BARE, {"tissue.mesh": {"kind": "given"}, "tissue.boundary": [
    {"name": "bed", "box": [[-0.1, -0.1, -0.011], [0.1, 0.1, -0.009]]}], "tissue.clamp": ["bed"]})  # fmt: skip


def meshes() -> list[Any]:
    """The block of the scenario as each library has it, pyvista's with its tetrahedra turned."""
    made = block((0.02, 0.02, 0.01), 5e-3)
    points, tets = made.p.T, made.t.T
    turned = np.column_stack([np.full(len(tets), 4), tets[:, [1, 0, 2, 3]]]).ravel()
    grid = pv.UnstructuredGrid(turned, np.full(len(tets), pv.CellType.TETRA), points)
    return [made, meshio.Mesh(points, [("tetra", tets)]), grid]


@pytest.mark.parametrize("mesh", meshes(), ids=lambda mesh: type(mesh).__module__.partition(".")[0])
def test_a_mesh_is_handed_over(mesh: Any) -> None:
    """Consistency check: the run is that of the same block made by the scenario, as far as round-off of the order of
    its nodes."""
    made = [*studies.prepare(parse(BARE)).advance()][-1][0]
    assert np.linalg.norm(made.piercings[0].force) > 1e-3  # N: the thread presses on its hole
    given = [*studies.prepare(parse(GIVEN), mesh=mesh).advance()][-1][0]
    assert given.piercings[0].force == pytest.approx(made.piercings[0].force, rel=1e-6, abs=1e-9)
    assert given.piercings[0].displacement == pytest.approx(made.piercings[0].displacement, rel=1e-6, abs=1e-12)


def test_a_mesh_that_is_none_is_refused() -> None:
    """Independent check: another object, other cells, no organ, another mesh than the digest says, and none at all."""
    made = block((0.02, 0.02, 0.01), 5e-3)
    with pytest.raises(MeshError, match="a str is no mesh that is known; give skfem"):
        given_mesh("organ.vtu")
    with pytest.raises(MeshError, match="cells of the kind hexahedron"):
        given_mesh(meshio.Mesh(np.zeros((8, 3)), [("hexahedron", np.arange(8)[None])]))
    with pytest.raises(MeshError, match="boundary 'lost' of the mesh has no facets"):
        given_mesh(made.with_boundaries({"lost": lambda x: x[2] > 1.0}))
    with pytest.raises(ScenarioError, match="has no organ"):
        studies.prepare(
            parse({key: value for key, value in ORGAN.items() if key not in ("tissue", "piercing")}), mesh=made
        )
    with pytest.raises(ScenarioError, match=r"prepare\(scenario, mesh=…\)"):
        studies.prepare(parse(GIVEN))
    kept = studies.prepare(parse(GIVEN), mesh=made).scenario
    assert kept.tissue is not None
    with pytest.raises(ScenarioError, match=r"tissue\.mesh\.sha256"):
        studies.prepare(kept, mesh=block((0.02, 0.02, 0.01), 4e-3))
    assert studies.prepare(kept, mesh=made).scenario == kept


def test_a_name_in_the_place_of_a_scenario_is_refused(tmp_path: Path) -> None:
    for door in (studies.prepare, partial(studies.run, folder=tmp_path / "run")):
        with pytest.raises(ScenarioError, match=r"'skin' is refused: it is no scenario; load a file or a scene"):
            door("skin")  # type: ignore[arg-type]
    assert not (tmp_path / "run").exists()


def test_a_run_is_opened(tmp_path: Path) -> None:
    """Consistency check: the steps that the callback saw are the rows of the tables, the frames have named blocks with
    the units of their arrays, and the numbers are those of the summary."""
    seen: list[StepRecord] = []
    run = studies.run(parse(ORGAN), tmp_path / "run", on_step=seen.append)
    assert repr(run) == f"OpenRun({str(tmp_path / 'run')!r}, completed, 3 frames)"
    assert run.times == pytest.approx([0.0, 6e-3, 8e-3], rel=1e-12)
    assert run.quantities == quantities(run.summary)
    assert dump(run.scenario) == dump(studies.open_run(tmp_path / "run").scenario)
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
    with pytest.raises(ResultsError, match="holds no run"):
        studies.open_run(tmp_path)
    with pytest.raises(ScenarioError, match="holds a run already"):
        studies.run(parse(ORGAN), tmp_path / "run")
    assert studies.run(parse(ORGAN), tmp_path / "run", resume=True).summary == run.summary


def test_an_exception_of_a_callback_ends_the_run(tmp_path: Path) -> None:
    """Independent check: it is raised, and the folder says so."""

    def stop(step: StepRecord) -> None:
        if step.step == 2:
            raise RuntimeError("far enough")

    with pytest.raises(RuntimeError, match="far enough"):
        studies.run(parse(ORGAN), tmp_path, on_step=stop)
    ended = studies.open_run(tmp_path)
    assert (ended.summary["status"], ended.summary["error"], ended.summary["steps"]) == ("failed", "far enough", 2)


def test_what_is_offered_stays_what_it_is() -> None:
    """Independent check: a module of a package does not take the place of a function that is called like it, and each
    tells of itself in one line."""
    for _ in range(2):
        for name in studies.__all__:
            assert callable(getattr(studies, name))
            assert name in dir(studies)
    assert repr(studies.prepare(parse(ORGAN))) == "Simulation('a ring', 1 piercings, 159 tissue unknowns, 4 steps)"
    with pytest.raises(AttributeError, match="no attribute 'fly'"):
        _ = studies.fly
