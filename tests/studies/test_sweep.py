"""Sweeps: what scenarios share, the table of all cases, its bytes whoever runs it, and what refinement says."""

import ast
import io
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
import psutil
import pytest
from matplotlib import rc_context

from coupling.step import tables as loops
from coupling.system import State
from studies.command.command import main
from studies.figure import COLOURS, PANEL, STYLE, render_figure
from studies.output.columns import quantities, state_summary
from studies.output.provenance import ROOT
from studies.output.remarks import CATALOGUE
from studies.refinement.ladder import ladder
from studies.refinement.refine import in_words, markdown, refine, refined, too_few
from studies.report.report import write_report
from studies.scenario import Scenario, ScenarioError, dump, parse
from studies.scenario.toml import changed, parsed
from studies.simulation import assembly, prepare
from studies.simulation.sharing import Shared
from studies.simulation.simulation import Simulation
from studies.sweeps import sweep as sweeps
from studies.sweeps.case import MODULES, PACKAGES, ROOMS, Result, run_case, source_files
from studies.sweeps.figure import DASHES
from studies.sweeps.figure import figure as drawn_figure
from studies.sweeps.sweep import SweepProgress, paired, parse_over, read_table, sweep
from studies.sweeps.table import Column, SweepTable, drawn_columns, table_of
from studies.workers import Workers, WorkersError, in_order, in_processes, in_turn, on_cluster, workers_of
from tests.bounds import IDENTITY
from tests.studies.samples import contact, step
from thread.catalogue import suture
from tissue.organs import quasi_static
from tissue.solvers import choice

DONE = {"exit_status": 0, "summary": {"status": "completed"}}
RING: dict[str, Any] = {  # a thread drawn through one point in space
    "title": "a ring",
    "thread": {
        "suture": "2-0 polypropylene",
        "control_points": 12,
        "damping": 20.0,
        "path": [[-0.02, 0.0, 0.0], [0.02, 0.0, 0.0]],
        "start": {"kind": "pulled", "force": [-0.1, 0.0, 0.0]},
        "end": {"kind": "driven", "waypoints": [[0.0, 0.02, 0.0, 0.0], [0.1, 0.021, 0.0, 0.0]]},
    },
    "piercing": [{"name": "ring", "at": [0.0, 0.0, 0.0], "direction": "free"}],
    "solve": {"dt": 2e-3, "duration": 8e-3},
    "output": {"every": 3},
}
ORGAN: dict[str, Any] = RING | {
    "tissue": {
        "youngs_modulus": 1e5,
        "poisson_ratio": 0.3,
        "density": 1070.0,
        "inertia": False,
        "clamp": ["bottom"],
        "mesh": {"kind": "block", "size": [0.02, 0.02, 0.01], "h": 5e-3, "accuracy": "given"},
    },
    "piercing": [{"name": "ring", "at": [0.0, 0.0, 0.0], "direction": "free", "footprint": 2e-3}],
}
ONE_STEP = {"kind": "static", "duration": 0.1, "load_steps": 1}
PULLS = {"thread.start.force.0": [-0.1, -0.2], "thread.damping": [20.0, -1.0, 40.0]}


def organ_of(store: Shared, **values: Any) -> Any:
    return prepare(parse(changed(ORGAN, values)), store).assembly


def test_scenarios_share_what_they_do_not_differ_in() -> None:
    """Consistency check: another pull has the same organ and factor, another stiffness the same mesh, another place of
    the hole neither."""
    store = Shared()
    first = organ_of(store)
    pulled = organ_of(store, **{"thread.start.force": [-0.3, 0, 0], "solve.dt": 1e-3, "title": "b"})
    assert pulled.organ is first.organ
    assert pulled.recovery() is first.recovery()
    stiffer = organ_of(store, **{"tissue.youngs_modulus": 2e5})
    assert stiffer.organ is not first.organ
    assert stiffer.body.mesh is first.body.mesh
    assert np.allclose(stiffer.body.K.data, 2.0 * first.body.K.data, rtol=1e-12)
    assert organ_of(store, **{"piercing.ring.at": [1e-3, 0, 0]}).body.mesh is not first.body.mesh


def test_scenarios_that_pull_otherwise_are_laid_once() -> None:
    """Consistency check: another force and another duration begin with the very start and thread; another path, another
    place of the hand and another organ with their own start, which is not the first one's."""
    store = Shared()

    def start(**values: Any) -> State:
        return prepare(parse(changed(ORGAN, values)), store).start

    first = start()
    assert start(**{"thread.start.force": [-0.3, 0, 0], "solve.duration": 4e-3}) is first
    for other in (
        {"thread.end.waypoints": [[0.0, 0.02, 0.0, 0.0], [0.1, 0.022, 0.0, 0.0]]},
        {"thread.path": [[-0.02, 0, 0], [0.0, 1e-4, 0], [0.02, 0, 0]]},
        {"tissue.youngs_modulus": 2e5},
    ):
        assert start() is not start(**other)
        assert np.array_equal(start().q, first.q)
    thread = organ_of(store).system.thread
    assert organ_of(store, **{"thread.start.force": [-0.3, 0, 0]}).system.thread is thread
    assert organ_of(store, **{"thread.damping": 3.0}).system.thread.damping == 3.0


def summary_of(data: dict[str, Any]) -> dict[str, Any]:
    """The summary of a case as its file has it."""
    summary: dict[str, Any] = sweeps.record(run_case(data))["summary"]
    return summary


@pytest.mark.parametrize("material", ["linear", "neo-hookean"])
def test_a_shared_organ_gives_the_same_bits(material: str) -> None:
    """Consistency check: three cases after one another on one organ, and each on its own."""
    organ = changed(ORGAN, {"tissue.material": material})
    summaries = [summary_of(changed(organ, {"thread.start.force.0": pull})) for pull in (-0.1, -0.2, -0.3)]
    alone = changed(organ, {"thread.start.force.0": -0.3})
    run_case(changed(organ, {"tissue.youngs_modulus": 3e5}))  # takes the place of the organ that was kept
    assert quantities(summary_of(alone)) == quantities(summaries[-1])
    assert quantities(summaries[0]) != quantities(summaries[1])


def test_a_case_has_the_summary_of_a_run(tmp_path: Path) -> None:
    """Consistency check: to the bit, all but wall-clock time and where it was run."""
    (tmp_path / "organ.toml").write_text(dump(parse(ORGAN)), encoding="utf-8")
    assert main(["run", str(tmp_path / "organ.toml"), "--out", str(tmp_path / "run"), "--quiet", "--no-picture"]) == 0
    run = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    case = summary_of(ORGAN)
    for summary in (run, case):
        del summary["seconds_per_step"]
    assert run.pop("provenance")
    assert case == run


def test_every_quantity_has_its_unit() -> None:
    """Independent check: forces in newton, lengths in metre, words without; a vector by its components, a load by its
    number."""
    summary = summary_of(changed(ORGAN, {"tissue.load": [{"boundary": "top", "traction": [0.0, 0.0, 10.0]}]}))
    lips = contact("lip_a - lip_b", 0.0)
    summary |= {"contact": state_summary(replace(step(0), contact=(lips,)))["contact"]}
    found = quantities(summary)
    units = {
        "time": "s",
        "piercings.ring.force_x": "N",
        "piercings.ring.slip": "m",
        "piercings.ring.x": "m",
        "piercings.ring.state": "",
        "energy.kinetic": "J",
        "thread.start.reaction_x": "N",
        "thread.start.grows_within": "s",
        "range.largest_rotation": "rad",
        "range.strained_share": "-",
        "range.piercings.ring.turn": "rad",
        "loads.0.share": "-",
        "loads.0.area": "m²",
        "contact.lip_a - lip_b.smallest_gap": "m",
        "contact.lip_a - lip_b.force": "N",
        "loads.0.force_z": "N",
    }
    assert {name: found[name].unit for name in units} == units
    assert found["piercings.ring.force_x"].value == summary["piercings"]["ring"]["force"][0]
    words = {name for name, quantity in found.items() if not quantity.unit}
    assert words == {
        "status",
        "error",
        "piercings.ring.state",
        "loads.0.boundary",
    }


def test_the_digest_of_a_case_has_the_source_that_it_hangs_on() -> None:
    """Independent check: what the rooms of a case import of the studies is in them, or named, or makes manuals alone;
    what they import from elsewhere at their top is of a package that is named, or holds no numbers."""
    own, foreign = set(), set()
    for path in source_files():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("studies."):
                own.add("/".join(str(node.module).split(".")[:2]))
            elif isinstance(node, ast.ImportFrom | ast.Import):
                foreign |= {str(getattr(node, "module", None) or node.names[0].name).split(".")[0]}
    assert own <= {*ROOMS, *(module.removesuffix(".py") for module in MODULES), "studies/manual"}
    plain = {"pydantic", "pydantic_core", "pyvista", "pandas", "psutil", "threadpoolctl", "filelock", "tomli_w"}
    named = {name.replace("scikit-fem", "skfem") for name in PACKAGES}
    inside = {"meshes", "thread", "tissue", "coupling", "studies", *sys.stdlib_module_names}
    assert foreign <= inside | plain | named


def test_many_tensions_pay_for_one_organ(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: a sweep over the pull makes one mesh, factorises its stiffness once, asks for the answers of
    its holes once, makes and lays the thread once and draws its start once, however many cases there are; only their
    ends are drawn for each."""
    counts: dict[str, int] = {}

    def count(where: Any, name: str) -> None:
        made = getattr(where, name)

        def counted(*given: Any, **named: Any) -> Any:
            counts[name] = counts.get(name, 0) + 1
            return made(*given, **named)

        monkeypatch.setattr(where, name, counted)

    for where, name in (
        (assembly, "organ_mesh"),
        (assembly, "start"),
        (assembly, "thread_of"),
        (choice, "factorize"),
        (quasi_static, "compliance"),
        (Simulation, "organ_record"),
    ):
        count(where, name)
    monkeypatch.setattr("studies.sweeps.case.KEPT", Shared())
    table = sweep(changed(ORGAN, {"solve": ONE_STEP}), {"thread.start.force.0": [-0.1, -0.15, -0.2]}, tmp_path)
    assert table["exit_status"].values == (0, 0, 0)
    once = dict.fromkeys(("organ_mesh", "start", "thread_of", "compliance"), 1)
    assert counts == once | {"factorize": 1, "organ_record": 1 + 3}


def test_failures_are_rows(tmp_path: Path) -> None:
    """Independent check: what is refused has its exit status and its sentence, and the others are run; a sweep is
    refused where all of it is."""
    lines: list[SweepProgress] = []
    table = sweep(RING, PULLS, tmp_path / "out", tell=lines.append)
    assert table["exit_status"].values == (0, 2, 0, 0, 2, 0)
    assert [told.done for told in lines] == [0, 1, 2, 3, 4, 5, 6]
    assert ["thread.damping = -1.0 is refused" in told.error for told in lines] == [False] + [True] * 2 + [False] * 4
    assert table["thread.start.force.0"].heading == "thread.start.force.0 [N]"
    assert "thread.damping = -1.0 is refused" in str(table["error"].values[1])
    slip, pulls = table["piercings.ring.slip"], table["thread.damping"]
    assert [value is None for value in slip.values] == [value == -1.0 for value in pulls.values]
    assert repr(table).startswith("SweepTable(6 cases, 2 not completed")
    assert list(table) == table.names and "exit_status" in table and "magic" not in table
    with pytest.raises(ScenarioError, match=r"thread\.dampin = 1\.0 is refused: there is no such key"):
        sweep(RING, {"thread.dampin": [1.0]}, tmp_path / "none")
    with pytest.raises(ScenarioError, match=r"piercing has no entry rung"):
        sweep(RING, {"piercing.rung.footprint": [1.0]}, tmp_path / "none")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").touch()
    with pytest.raises(ScenarioError, match=r"files that no sweep wrote \(notes.txt\)"):
        sweep(RING, PULLS, tmp_path / "mine")


class Killed(BaseException):
    """What a process that is killed does not live to see."""


def test_a_sweep_that_was_killed_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: it runs what is missing alone, and its table is that of a whole sweep to the byte."""
    sweep(RING, PULLS, tmp_path / "whole")

    def kill(progress: SweepProgress) -> None:
        if progress.done == 4:  # two were refused beforehand
            raise Killed

    with pytest.raises(Killed):
        sweep(RING, PULLS, tmp_path / "killed", tell=kill)
    assert not (tmp_path / "killed" / "table.csv").exists()
    (tmp_path / "killed" / "cases" / ("f" * 64 + ".json")).write_text("{")  # torn, as no file of ours is
    ran: list[Any] = []
    monkeypatch.setattr(sweeps, "run_case", lambda data: ran.append(data) or run_case(data))
    sweep(RING, PULLS, tmp_path / "killed")
    assert len(ran) == 2
    whole, resumed = ((tmp_path / name / "table.csv").read_bytes() for name in ("whole", "killed"))
    assert resumed == whole
    sweep(changed(RING, {"title": "another"}), PULLS, tmp_path / "killed")
    assert len(ran) == 6  # of another scenario none is known


def test_what_a_killed_sweep_was_writing_is_its_own(tmp_path: Path) -> None:
    """Independent check: killed while it wrote its mark, a case or a table, it begins or goes on, and leaves none of
    that; another's unfinished file is refused."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".sweep.json.4711").write_text("{")
    sweep(RING, {"thread.damping": [20.0]}, tmp_path / "out")
    for name in (".sweep.json.4711", ".table.csv.4711", f"cases/.{'f' * 64}.json.4711", ".suture.lock"):
        (tmp_path / "out" / name).write_text("{")
    (tmp_path / "out" / "table.csv").unlink()
    sweep(RING, {"thread.damping": [20.0]}, tmp_path / "out")
    assert (tmp_path / "out" / "table.csv").is_file()
    assert [path for path in (tmp_path / "out").rglob(".*")] == []
    (tmp_path / "out" / ".letter.txt.4711").touch()
    with pytest.raises(ScenarioError, match=r"files that no sweep wrote \(\.letter\.txt\.4711\)"):
        sweep(RING, {"thread.damping": [20.0]}, tmp_path / "out")


def test_the_mark_of_a_sweep_is_written_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: killed as it makes its first folder, it has one file that says whose the folder is."""

    def killed(path: Path, *_: Any, **__: Any) -> None:
        if path.name == "cases":
            raise Killed
        os.makedirs(path, exist_ok=True)

    monkeypatch.setattr(Path, "mkdir", killed)
    with pytest.raises(Killed):
        sweep(RING, {"thread.damping": [20.0]}, tmp_path / "out")
    monkeypatch.undo()
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["sweep.json"]
    assert len(sweep(RING, {"thread.damping": [20.0]}, tmp_path / "out")) == 1


def test_numbers_of_numpy_are_numbers(tmp_path: Path) -> None:
    """Independent check: the table is that of Python's numbers, to the byte, and its settings are written as they are;
    a scenario takes them too."""
    listed = {"thread.damping": [20.0, 40.0], "thread.control_points": [16]}
    arrays = {"thread.damping": np.array([20.0, 40.0]), "thread.control_points": np.array([16])}
    one, other = sweep(RING, listed, tmp_path / "a"), sweep(RING, arrays, tmp_path / "b")
    assert one.csv == other.csv and "np." not in other.csv
    assert other["thread.control_points"].values == (16, 16)
    assert parse(changed(RING, arrays | {"thread.damping": np.float32(20.0), "thread.control_points": np.int64(16)}))


def test_what_the_cases_wait_for_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Independent check: that loops are compiled in the first case is a line of the console."""
    failed = Result(1, {"status": "failed", "error": "none"}, 0.0)
    monkeypatch.setattr(sweeps, "run_case", lambda data: loops.log.info("compiling the step") or failed)
    assert main(["sweep", "paper_figure_1", "--over", "thread.damping=[5.0]", "--out", str(tmp_path / "out")]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["1 case, with one line per completed case", "compiling the step"]


def test_a_shortage_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: what failed for want of memory is a row, and is tried again."""
    short = Result(1, {"status": "failed", "error": "no memory"}, 0.0, lasting=False)
    monkeypatch.setattr(sweeps, "run_case", lambda data: short)
    over = {"thread.damping": [20.0]}
    assert sweep(RING, over, tmp_path)["exit_status"].values == (1,)
    monkeypatch.undo()
    assert sweep(RING, over, tmp_path)["exit_status"].values == (0,)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Workers]:
    """Two worker processes of Dask on this machine."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(2, processes=True, threads_per_worker=1, dashboard_address=None) as local:
        yield workers_of(address=local.scheduler_address)


IMPORTED_IN = os.getpid()


def imported_and_working_in(item: int) -> tuple[int, int]:
    """Return the processes that imported this module, and that work on an item."""
    return IMPORTED_IN, os.getpid()


@pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux alone")
def test_processes_share_what_is_imported() -> None:
    """Independent check: one process has imported the module of the work for all, and does none of the work."""
    found = [result for _, result in in_processes(2, imported_and_working_in, range(4))]
    [server], workers = {server for server, _ in found}, {worker for _, worker in found}
    assert server not in workers


MADE: list[int] = []


def make_once(item: int) -> None:
    """Note the process that makes what is shared."""
    MADE.append(os.getpid())


def maker_and_working_in(item: int) -> tuple[list[int], int]:
    """Return the processes that made what this one has, and this one."""
    return MADE, os.getpid()


def ended_from_outside(item: int) -> None:
    """End as one that takes too much memory does."""
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux alone")
def test_processes_share_what_is_made_first() -> None:
    """Independent check: once, in none of those that work, all of which have it; and none is left afterwards, however
    that ends."""
    found = [result for _, result in in_processes(2, maker_and_working_in, range(4), make_once)]
    [leader], workers = {*found[0][0]}, {worker for _, worker in found}
    assert all(made == [leader] for made, _ in found) and leader not in workers | {os.getpid()}
    left = next(in_processes(2, maker_and_working_in, range(4), make_once))
    with pytest.raises(WorkersError, match="ended from outside"):
        list(in_processes(2, ended_from_outside, range(4), make_once))
    deadline = monotonic() + 30.0
    while any(psutil.pid_exists(pid) for pid in (leader, *workers, *left[1][0], left[1][1])):
        assert monotonic() < deadline
        sleep(0.05)


METHODS = """
import threading
from studies.workers import context_of
print(context_of("math").get_start_method())
threading.Thread(target=threading.Event().wait, daemon=True).start()
print(context_of("math").get_start_method())
"""
KILLED = """
import os, pathlib, sys, time
from studies.workers import in_processes, nothing
def first(item):
    pathlib.Path(sys.argv[1]).write_text(str(os.getpid()))
    time.sleep(600)
list(in_processes(2, nothing, range(4), first))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux alone")
def test_a_process_without_threads_is_forked_and_takes_the_fork_along(tmp_path: Path) -> None:
    """Independent check: nothing is imported again; one with a thread is not forked; and what makes the shared parts
    ends with a process that is killed meanwhile, as else it would keep the folder's lock."""
    alone = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    told = subprocess.run([sys.executable, "-c", METHODS], env=alone, capture_output=True, text=True, check=True)
    assert told.stdout.split() == ["fork", "forkserver"]
    script, found = tmp_path / "killed.py", tmp_path / "pid"
    script.write_text(KILLED, encoding="utf-8")
    with subprocess.Popen([sys.executable, str(script), str(found)], env=alone | {"PYTHONPATH": str(ROOT)}) as killed:
        deadline = monotonic() + 60.0
        while not found.exists() or not found.read_text(encoding="utf-8"):
            assert monotonic() < deadline
            sleep(0.05)
        killed.kill()
    while is_running(int(found.read_text(encoding="utf-8"))):
        assert monotonic() < deadline
        sleep(0.05)


def is_running(pid: int) -> bool:
    """Return whether there is such a process, and not one that waits for its parent."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def same_table(workers: Workers, folder: Path) -> None:
    """Refuse a table that is not that of one process to the byte."""
    sweep(RING, PULLS, folder / "one")
    sweep(RING, PULLS, folder / "other", workers)
    one, other = (
        {path.name: path.read_bytes() for path in (folder / name).glob("table.*")} for name in ("one", "other")
    )
    assert "table.csv" in one
    assert other == one


def test_two_processes_give_the_same_table(tmp_path: Path) -> None:
    """Consistency check: to the byte that of one process."""
    same_table(workers_of(2), tmp_path)


def test_a_cluster_gives_the_same_table(tmp_path: Path, cluster: Workers) -> None:
    """Consistency check: to the byte that of one process, by two workers of Dask."""
    same_table(cluster, tmp_path)


def test_results_come_back_in_their_order() -> None:
    """Independent check: whatever is done first; and nobody at an address is said in words."""
    assert list(in_order([(2, "c"), (0, "a"), (1, "b")])) == ["a", "b", "c"]
    assert list(in_turn(str, [1, 2])) == [(0, "1"), (1, "2")]


def test_without_dask_the_remedy_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: a missing extra is named."""
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(WorkersError, match=r"suturefem\[cluster\]"):
        list(on_cluster("tcp://127.0.0.1:1", str, [1]))


def test_without_pyarrow_the_remedy_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Independent check: the table in CSV is there, and what Parquet needs is printed; the table is read from a file
    of cases, drawn, and printed as JSON. What an earlier sweep left is not passed off as this one's."""
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    (tmp_path / "ring.toml").write_text(dump(parse(RING)), encoding="utf-8")
    (tmp_path / "cases.csv").write_text('thread.damping,thread.start.force\n30.0,"[-0.2, 0, 0]"\n40.0,\n')
    words = ["sweep", str(tmp_path / "ring.toml"), "--table", str(tmp_path / "cases.csv")]
    words += ["--out", str(tmp_path / "out"), "--plot", "thread.damping", "energy.kinetic"]
    assert main(words) == 0
    printed = capsys.readouterr()
    assert "2 cases: 2 completed" in printed.out
    assert "suturefem[tables]" in printed.out
    assert "2/2, 0 s left: completed: thread.damping = 40.0" in printed.err
    assert not (tmp_path / "out" / "table.parquet").exists()
    assert (tmp_path / "out" / "figure.png").stat().st_size > 5000
    assert main([*words, "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert [case["thread.damping [1/s]"] for case in again["cases"]] == [30.0, 40.0]
    (tmp_path / "out" / "table.parquet").write_bytes(b"of an earlier sweep")
    assert main([*words[:6], "--paired"]) == 0
    assert "figure" not in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out").glob("*.*")} == {"sweep.json", "table.csv"}


def test_parquet_has_the_units(tmp_path: Path) -> None:
    """Consistency check: the same columns and numbers as the table in CSV, with the unit of each."""
    parquet = pytest.importorskip("pyarrow.parquet")
    table = sweep(RING, {"thread.damping": [20.0, -1.0]}, tmp_path)
    found = parquet.read_table(tmp_path / "table.parquet")
    assert found.column_names == [column.heading for column in table.columns]
    assert found.schema.field("piercings.ring.slip [m]").metadata[b"unit"] == b"m"
    assert found.column("piercings.ring.slip [m]").to_pylist() == list(table["piercings.ring.slip"].values)


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda: parse_over(["solve.dt=1e-3"]), "a list of values in TOML"),
        (lambda: parse_over(["solve dt=[1]"]), r"--over solve dt=\[1\] is refused: write a dotted key"),
        (
            lambda: changed(RING, {"piercing.縫合 - x.at": 1}),
            r'^piercing.縫合 - x.at=1 is .* piercing\."縫合 - x"\.at$',
        ),
        (lambda: parse_over(["a=[1]", "a=[2]"]), "already varied"),
        (lambda: paired({"a": [1], "b": [1, 2]}), "a has 1, b has 2"),
        (lambda: read_table(Path("nowhere.csv")), "cannot be read"),
        (
            lambda: drawn_columns(table_of([({"a.b": 1.0}, DONE)]), ["a.c", "a.b"]),
            "nearest is a.b",
        ),
        (
            lambda: drawn_columns(table_of([({"a": 1.0}, DONE)]), ["a", "status"]),
            "give a number's name",
        ),
        (lambda: ladder(parse(RING), levels=2), "needs 3 or more"),
        (lambda: ladder(parse(RING), ratio=1.0), "1.1 or more"),
        (lambda: ladder(parse(RING), "h"), "has no organ"),
        (lambda: ladder(parse(changed(RING, {"solve": ONE_STEP})), "dt", levels=3), "only 2 of 3 levels differ"),
        (lambda: ladder(parse(changed(RING, {"piercing": []})), "footprint"), "no piercing has a footprint"),
        (lambda: ladder(parse(RING), "accuracy"), "--adaptive, or --over accuracy, is refused: the scen"),
        (lambda: ladder(parse(ORGAN), "accuracy"), 'tissue.mesh.accuracy is "given"; set a number'),
        (lambda: ladder(parse(pulled_organ(**{"piercing.ring.footprint": 0.0})), "accuracy"), "has a footprint"),
        (lambda: refine(RING, "time", "nowhere", "dt", adaptive=True), "--over dt is refused: --adaptive refines"),
    ],
)
def test_what_cannot_be_swept_or_refined_is_refused(ask: Callable[[], Any], said: str) -> None:
    """Independent check: in a sentence."""
    with pytest.raises(ScenarioError, match=said):
        ask()


def test_a_name_that_is_none_is_refused_before_a_case_is_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Independent check: no case is run for a misspelt column or quantity, the names near it are told, and the table of
    an earlier sweep stays."""
    scenario = tmp_path / "ring.toml"
    scenario.write_text(dump(parse(RING)), encoding="utf-8")
    ran: list[Any] = []
    monkeypatch.setattr(sweeps, "run_case", lambda data: ran.append(data) or run_case(data))
    over = ["sweep", str(scenario), "--over", "thread.damping=[20.0, 40.0]", "--out", str(tmp_path / "out")]
    for words, said in (
        ([*over, "--plot", "thread.damping", "energy.kinetik"], "--plot energy.kinetik is refused.*energy.kinetic"),
        ([*over, "--plot", "thread.dampin", "energy.kinetic"], "--plot thread.dampin is refused.*thread.damping"),
        ([*over, "--plot", "thread.damping", "status"], "--plot status is refused: it is a word"),
        (["refine", str(scenario), "--quantity", "piercings.ring.slipp", "--over", "dt", "--out", str(tmp_path / "r")],
         "--quantity piercings.ring.slipp is refused.*the nearest are? .*piercings.ring.slip"),
    ):  # fmt: skip
        assert main(words) == 2
        printed = capsys.readouterr().err
        assert re.search(said, printed), words
        assert ran == [] and "per completed case" not in printed
    assert main(over) == 0
    assert len(ran) == 2
    assert main([*over, "--plot", "thread.damping", "energy.kinetik"]) == 2
    assert (tmp_path / "out" / "table.csv").is_file()


def test_cases_are_counted_and_paired() -> None:
    """Independent check: every combination, or one after another."""
    over = {"a": [1, 2], "b": [3, 4]}
    assert sweeps.grid(over) == [{"a": 1, "b": 3}, {"a": 1, "b": 4}, {"a": 2, "b": 3}, {"a": 2, "b": 4}]
    assert paired(over) == [{"a": 1, "b": 3}, {"a": 2, "b": 4}]


def test_the_levels_of_a_ladder() -> None:
    """Independent check: cells, steps and spans are finer level by level, frames as far apart, and the order of theory
    is the least of those refined; steps and spans by as much as whole numbers allow."""
    scenario: Scenario = parse(ORGAN)
    every = ladder(scenario, ratio=2.0, levels=3)
    assert every.kinds == ("h", "dt", "control_points")
    assert every.order == 2.0
    assert every.settings[0] == {}
    last = {key: value for key, value in every.settings[2].items()}
    assert last["tissue.mesh.h"] == 5e-3 / 4
    assert last["solve.dt"] == pytest.approx(5e-4, rel=1e-12)
    assert (last["thread.control_points"], last["output.every"]) == (39, 12)
    assert ladder(scenario, "control_points", ratio=1.5).factors == (1.0, 14 / 9, 20 / 9, 30 / 9)
    assert ladder(parse(changed(ORGAN, {"tissue.element": "P2"})), "h").order == 3.0
    assert ladder(scenario, "footprint", ratio=2.0).settings[1] == {"piercing.0.footprint": 1e-3}
    for settings in every.settings:
        parsed(changed(ORGAN, settings))
    assert ladder(parse(pulled_organ()), "accuracy", levels=3).settings[2] == {"tissue.mesh.accuracy": 0.075}


REMARKS = [
    {"code": code, "severity": CATALOGUE[code]["severity"], "where": "in"} for code in ("hole-left", "rest-unloaded")
]


def planted(numbers: list[float], statuses: list[int] | None = None) -> Any:
    """What refinement says of planted numbers on four levels, each twice as fine."""
    rungs = ladder(parse(ORGAN), "h", ratio=2.0)
    done = statuses or [0] * len(numbers)
    results = [
        {
            "exit_status": s,
            "summary": {"time": n, "status": "x", "error": "it broke\nhere" if s else "", "remarks": REMARKS},
        }
        for s, n in zip(done, numbers, strict=True)
    ]
    return refined("time", rungs, table_of([({}, result) for result in results]))


def test_planted_numbers_get_their_verdicts() -> None:
    """Independent check: a number with an error of second order converges to its limit at order two; one that grows
    like 1/h or like a logarithm is called diverging; one that did not come to three levels has no verdict."""
    h = 0.5 ** np.arange(4)
    fine = planted((1.0 + 0.1 * h**2).tolist())
    assert fine.converged
    assert fine.verdict.order == pytest.approx(2.0, abs=1e-6)
    assert fine.verdict.limit == pytest.approx(1.0, abs=1e-9)
    assert fine.interval[0] < 1.0 < fine.interval[1]
    assert planted((1.0 / h).tolist()).text == "DIVERGING, order -1.00"
    assert planted((1.0 - np.log(h)).tolist()).text == "DIVERGING like a logarithm"
    failed = planted([1.0, 1.1, 1.2, 1.3], [0, 1, 1, 0])
    assert failed.verdict is None
    assert failed.text == "no verdict: only 2 of 4 levels have the number, but 3 are needed"
    same = too_few([1.0, 1.0, 0.5], [1.0, 1.0, 1.1], ["h"])
    assert "only 2 distinct of 3 levels" in same and "levels 0 and 1 have the same mesh" in same and "--ratio" in same
    assert too_few([1.0, 0.7, 0.5, 0.5], [1.0] * 4, ["h"]) == ""
    assert not planted([1.0, 1.0, 1.0, 1.0], [0, 0, 0, 1]).interval[0] < 1.0
    assert "Refined(time [s]: converged" in repr(fine)


def test_a_refinement_tells_what_its_levels_lack() -> None:
    """Independent check: no convergence of zeros, no order where none is resolved, the unsupported remarks of all
    levels without their notes, and why a level failed."""
    zero, unresolved = planted([0.0] * 4, [0, 0, 0, 1]), planted([1.0, 1.0 + 1e-7, 1.0, 1.0 + 1e-3])
    assert not zero.converged and zero.interval is None and zero.text == "zero at every level, no verdict"
    assert in_words(zero)["order"] == in_words(unresolved)["order"] == ""
    assert "order not resolved" in unresolved.text
    assert unresolved.notes == ("not supported: hole-left (in) in case 0, 1, 2, 3",)
    lines = (unresolved.notes[0], "case 3 is not completed: it broke; here")
    assert zero.notes == lines
    assert all(line in markdown([zero], ladder(parse(ORGAN), "h", ratio=2.0)) for line in lines)


def test_a_scenario_is_refined(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: the slip of a ring through which a hand draws a thread is the way of the hand, and converges
    to it; what is no number is refused; the command says the same."""
    pulled = changed(RING, {"solve": ONE_STEP})
    [slip] = refine(pulled, "piercings.ring.slip", tmp_path / "a", "control_points", levels=3)
    assert slip.unit == "m"
    assert slip.converged
    stretched = 0.021 / (1.0 + 0.1 / suture("2-0 polypropylene").EA)  # rest length between ring and hand
    assert slip.finest == pytest.approx(stretched - 0.02, rel=1e-3)
    assert "converged to" in (tmp_path / "a" / "verdict.md").read_text(encoding="utf-8")
    assert (tmp_path / "a" / "figure.png").stat().st_size > 5000
    with pytest.raises(ScenarioError, match=r"the nearest are piercings\.ring\.slip, "):
        refine(pulled, "piercings.ring.slp", tmp_path / "a", "control_points", levels=3)
    (tmp_path / "ring.toml").write_text(dump(parse(pulled)), encoding="utf-8")
    words = ["refine", str(tmp_path / "ring.toml"), "--quantity", "piercings.ring.slip", "--levels", "3"]
    assert main([*words, "--over", "control_points", "--out", str(tmp_path / "b"), "--strict"]) == 0
    assert "converged to" in capsys.readouterr().out


def pulled_organ(**keys: Any) -> dict[str, Any]:
    """A hole that is pulled off an organ along its normal, at rest, on linear cells that are refined."""
    table = changed(
        ORGAN,
        {
            "thread.start": {"kind": "pulled", "force": [0.0, 0.0, 0.05]},
            "thread.end": {"kind": "free"},
            "solve": {"kind": "static", "load_steps": 1},
            "piercing.ring.kind": "anchored",
            "tissue.element": "P1",
            "tissue.mesh.accuracy": 0.3,
        },
    )
    return changed(table, keys)


def test_cells_at_the_holes_are_refined_step_by_step(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: quadratic cells have the number within the interval of the linear ones, whose estimates are
    the distances from it; the levels are those of the estimates, and the command, the table and the report say so."""
    [exact] = refine(
        pulled_organ(**{"tissue.element": "P2", "tissue.mesh.accuracy": 0.05}),
        "piercings.ring.displacement_z",
        tmp_path / "a",
        levels=3,
        ratio=3.0,
        over="accuracy",
    )
    assert exact.verdict is not None
    (tmp_path / "organ.toml").write_text(dump(parse(pulled_organ())), encoding="utf-8")
    words = [
        "refine",
        str(tmp_path / "organ.toml"),
        "--quantity",
        exact.quantity,
        "--levels",
        "3",
        "--adaptive",
    ]
    assert main([*words, "--out", str(tmp_path / "b"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    [said] = found["quantities"]
    limit, low, high = exact.finest, *said["interval"]
    assert min(low, high) < limit < max(low, high)
    distances = 1.0 - np.array(said["numbers"]) / limit
    assert np.all(np.abs(np.log(np.array(said["estimates"]) / distances)) < np.log(1.5))
    assert said["factors"] == pytest.approx([said["estimates"][0] / error for error in said["estimates"]], rel=IDENTITY)
    assert np.all(np.diff(found["unknowns"]) > 0)
    assert "Unknowns of the organ" in (tmp_path / "b" / "verdict.md").read_text(encoding="utf-8")
    write_report([tmp_path / "b"], tmp_path / "page.html")
    assert "estimated error of the holes" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_a_bare_point_is_called_diverging(tmp_path: Path) -> None:
    """Independent check: the displacement of a point pulled without a footprint grows like 1/h, and is called so."""
    bare = {"piercing.ring.footprint": 0.0, "thread.start": {"kind": "pulled", "force": [0.0, 0.0, 0.3]}}
    table = changed(ORGAN, bare | {"solve": {"kind": "static", "load_steps": 1}, "piercing.ring.kind": "anchored"})
    table["thread"]["end"] = {"kind": "free"}
    [moved] = refine(table, "piercings.ring.displacement_z", tmp_path, "h", levels=3, ratio=2.0)
    assert moved.text.startswith("DIVERGING, order -"), replace(moved)


@pytest.mark.parametrize(
    ("x", "keys", "lines", "joined"),
    [
        ("a", ("a", "b"), 2, True),  # a line for each value of the other key
        ("縫合", ("a", "b"), 2, True),
        ("a", ("a",), 1, True),
        ("a", ("a", "b", "c"), 1, False),  # the key of the lines is not decided
    ],
)
def test_a_line_of_a_figure_has_one_point_at_each_x(x: str, keys: tuple[str, ...], lines: int, joined: bool) -> None:
    """Independent check: of a sweep over all combinations, by values of which none is twice; of cases in pairs it is
    one line. Letters that the font lacks are drawn without a warning."""
    lists = {"a": [1, 2, 3], "b": [10, 20, 30], "c": [100, 200, 300]}
    grid = sweeps.grid({key: lists[key][: 3 - (key != "a")] for key in keys})
    for cases, drawn_lines, is_joined in ((grid, lines, joined), (paired(lists), 1, True)):
        summed = Column("縫合", "N", tuple(sum(case.values()) for case in cases))
        varied = [Column(key, "", tuple(case[key] for case in cases)) for key in keys]
        ends = Column("exit_status", "", (0,) * len(cases))
        table = SweepTable((Column("case", "", tuple(range(len(cases)))), *varied, ends, summed))
        drawn = drawn_columns(table, [x, "縫合"])
        assert render_figure(drawn_figure, drawn, "sweep")["png"]
        (axes,) = drawn_figure(drawn).axes
        assert len(axes.lines) == drawn_lines
        assert {line.get_linestyle() != "None" for line in axes.lines} == {is_joined}


@pytest.mark.parametrize("lines", [2, 12, 40])
def test_nothing_in_a_figure_lies_over_its_lines_or_other_words(lines: int) -> None:
    """Independent check: the legend is beside the axes, the numbers below these and its own words apart, and all of it
    on the figure, with many cases, tables for values and large numbers; no two of so few lines look alike."""
    many = [(k, x) for k in range(lines) for x in (300_000.0, 301_000.0, 302_500.0)]
    pull = '{{ kind = "pulled", force = [{0:.3f}, 0.0, {0:.3f}] }}'
    by = Column("thread.end", "", tuple(pull.format(k) for k, _ in many))
    y = Column("range.piercings.left_upper_corner.bearing_pressure", "Pa", tuple(x * (1.0 + k) for k, x in many))
    with rc_context(STYLE):
        drawing = drawn_figure([Column("tissue.youngs_modulus", "Pa", tuple(x for _, x in many)), y, by])
        drawing.savefig(io.BytesIO(), dpi=drawing.dpi)
    (axes,), (legend,) = drawing.axes, drawing.legends
    low, high = axes.get_xlim()
    numbers = [text for text in axes.get_xticklabels() if low <= text.get_position()[0] <= high]
    words = [*legend.get_texts(), *numbers, axes.xaxis.label, axes.yaxis.label]
    boxes = [text.get_window_extent() for text in words if text.get_text()]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    assert not legend.get_window_extent().overlaps(axes.get_tightbbox())
    assert all(drawing.bbox.containsx(x) and drawing.bbox.containsy(y) for box in boxes for x, y in box.corners())
    assert axes.get_window_extent().width > 0.5 * PANEL[0] * drawing.dpi
    looks = {(line.get_color(), line.get_marker(), line.get_linestyle()) for line in axes.lines}
    assert len(looks) == min(lines, len(COLOURS) * len(DASHES))
