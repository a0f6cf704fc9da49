"""The results folder: what a run leaves behind, complete or absent.

``Recorder`` takes the plain arrays of ``studies.output.records`` and writes

- ``provenance.json``, ``scenario.toml`` (and ``mesh/``, a copy of the mesh file) before the first step,
- ``piercings.csv``, ``energy.csv``, ``steps.csv``, ``events.csv``, and ``contact.csv`` of a wound whose lips may touch:
  whole lines, after every step,
- ``results.pvd`` and ``frames/``: every ``output.every`` steps, the first and the last,
- ``checkpoint.npz`` after every frame that was due, from which ``--resume`` goes on,
- ``summary.json`` at the end, also of a failed or an interrupted run.

Files are written under a temporary name and renamed: a killed run leaves every finished frame readable.
"""

import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np

from studies.output.checkpoint import Arrays, difference, pack, unpack, write_checkpoint
from studies.output.columns import RUN, TABLES, Layout, range_summary, state_summary, values
from studies.output.files import write_bytes, write_json, write_text
from studies.output.provenance import provenance
from studies.output.records import Ending, OrganTopology, RunRecord, Snapshot, StepRecord, nothing_met
from studies.output.remarks import Remark, remark
from studies.output.series import Series
from studies.output.tables import CsvFile, head_of, rows_until, tables_of
from studies.scenario import Scenario, ScenarioError, dump
from studies.scenario.toml import mesh_file, with_mesh_file

Status = Literal["completed", "failed", "interrupted"]
Judge = Callable[[Ending | None], Sequence[Remark]]  # what is to be said of a run, before its start and at its end

MARK = "provenance.json"  # the first file written: a folder that holds it is a results folder
FILES = (
    "summary.json",
    *(f"{layout.name}.csv" for layout in TABLES),
    "checkpoint.npz",
    "results.pvd",
    "scenario.toml",
    "picture.png",
)
FOLDERS = ("frames", "mesh")
SHOWN = 3  # names of missing files in a message


def nothing_to_say(ending: Ending | None) -> list[Remark]:
    """Return no remark."""
    return []


class Recorder:
    """Writes a run into a folder; leaving the ``with`` block writes the summary.

    The last frame is written even when it is not due, so a frame is handed over as a function that makes it. With the
    ``checkpoint`` of the folder a run is taken up again: what was written after it is taken out, and the first step
    that is recorded must be that of the checkpoint.
    """

    def __init__(
        self,
        folder: Path | str,
        scenario: Scenario,
        topology: OrganTopology | None = None,
        tissue_dofs: int = 0,
        checkpoint: Arrays | None = None,
        subgrid: Mapping[str, Mapping[str, Any]] | None = None,
        judge: Judge = nothing_to_say,
        methods: Mapping[str, str | None] | None = None,
    ) -> None:
        self.folder = Path(folder)
        self._judge = judge
        self._own: list[Remark] = []
        self._outcome: tuple[Status, str] | None = None
        self._names = [hole.name for hole in scenario.piercing]
        self._has_organ = scenario.tissue is not None
        self.last_frame: Snapshot | None = None
        self.last_step: StepRecord | None = None
        self._tissue_dofs = tissue_dofs
        self.subgrid = subgrid or {}
        self._every = scenario.output.every
        self._pending: Callable[[], Snapshot] | None = None
        counters = checkpoint or {}
        self._newton_iterations = int(counters.get("newton_iterations", 0))
        self._constraint_max = float(counters.get("constraint_max", 0.0))
        self._constraint_residual = float(counters.get("constraint_residual", 0.0))
        self._seconds = float(counters.get("seconds", 0.0))
        self._extremes = nothing_met(len(self._names))
        self._recorded = -1 if checkpoint is None else int(checkpoint["step"])  # last step in the tables
        if checkpoint is None:
            _clear(self.folder)
            self.provenance = _write_beginning(self.folder, scenario, methods or {})
        else:
            _refuse_lost_rows(self.folder, self._recorded, tables_of(scenario))
            self._extremes = unpack(self._extremes, checkpoint, "extremes")
            self.provenance = _write_continuation(self.folder)
        self._series = Series(self.folder, topology, before=max(self._recorded, 0))
        if self._series.missing:
            gone = ", ".join(self._series.missing[:SHOWN]) + ", …" * (len(self._series.missing) > SHOWN)
            text = f"{len(self._series.missing)} files of earlier frames are not there ({gone}); they are left out"
            self.remark(remark("frames-missing", "results.pvd", text))
        self._tables = [
            (layout, CsvFile(self.folder / f"{layout.name}.csv", layout.columns, self._recorded))
            for layout in tables_of(scenario)
        ]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.finish("completed")
        elif isinstance(error, KeyboardInterrupt | GeneratorExit):
            self.finish("interrupted", "interrupted by the user")
        else:
            self.finish("failed", str(error) or type(error).__name__)

    def record(self, step: StepRecord, frame: Callable[[], Snapshot]) -> None:
        """Write the rows of an accepted step, and its frame and a checkpoint if they are due."""
        if step.step > self._recorded:
            self._write_rows(step)
        self.last_step = step
        self._pending = frame
        if step.step % self._every == 0:
            self._write_frame()
            self._write_checkpoint(step)

    def _write_rows(self, step: StepRecord) -> None:
        for layout, table in self._tables:
            table.append(layout.rows(step))
        self._newton_iterations += step.newton_iterations
        self._constraint_max = max(self._constraint_max, step.constraint_max)
        self._constraint_residual = max(self._constraint_residual, step.constraint_residual)
        self._seconds += step.seconds if step.step else 0.0
        self._extremes = self._extremes.after_step(step)
        self._recorded = step.step

    def _write_checkpoint(self, step: StepRecord) -> None:
        memory = step.memory
        if memory is None:
            return
        counters = {
            "newton_iterations": np.array(self._newton_iterations),
            "constraint_max": np.array(self._constraint_max),
            "constraint_residual": np.array(self._constraint_residual),
            "seconds": np.array(self._seconds),
        }
        write_checkpoint(self.folder, {**memory, **counters, **pack(self._extremes, "extremes")})

    def finish(self, status: Status, error: str = "") -> None:
        """Write the last frame and the summary."""
        try:
            self._write_frame()
        finally:
            for _, table in self._tables:
                table.close()
            self._outcome = status, error
            write_json(self.folder / "summary.json", self.summary(status, error))

    @property
    def remarks(self) -> list[Remark]:
        """What is to be said of the run as of the last recorded step."""
        ending = None if self.last_step is None else Ending(self.last_step, self._extremes)
        return [*self._judge(ending), *self._own]

    def remark(self, remark: Remark) -> None:
        """Add a remark of what became of the files; a summary that is there already is written anew."""
        self._own.append(remark)
        if self._outcome is not None:
            write_json(self.folder / "summary.json", self.summary(*self._outcome))

    def summary(self, status: Status, error: str = "") -> dict[str, Any]:
        """Make the contents of ``summary.json`` as of the last recorded step."""
        step = self.last_step
        totals = self._newton_iterations, self._constraint_max, self._constraint_residual, self._seconds
        head = values(RUN, RunRecord(status, error, step, *totals, self._tissue_dofs)) | {"subgrid": self.subgrid}
        said: dict[str, Any] = {"remarks": [remark.record() for remark in self.remarks]}
        if self._has_organ:
            said["range"] = range_summary(self._names, self._extremes)
        return head | said | (state_summary(step) if step else {}) | {"provenance": self.provenance}

    def _write_frame(self) -> None:
        if self._pending is not None and self.last_step is not None:
            self.last_frame = self._pending()
            self._pending = None
            self._extremes = self._extremes.after_frame(self.last_frame.organ)
            self._series.write(self.last_step.step, self.last_frame)


def _refuse_lost_rows(folder: Path, step: int, layouts: Iterable[Layout[Any]]) -> None:
    """Raise `ScenarioError` where a table has other columns, or does not reach the step of the checkpoint."""
    for layout in layouts:
        path, reason = folder / f"{layout.name}.csv", ""
        try:
            head, *rows = rows_until(path, step)
        except (OSError, ValueError, IndexError) as error:
            raise ScenarioError(f"{path} cannot be read ({error}); run without --resume to begin anew") from None
        if head != head_of(layout.columns):
            reason = f"the columns of {path} are those of another version of this code"
        elif layout.every_step and len(rows) != step + 1:
            reason = f"{path} lacks rows before step {step}, that of the checkpoint"
        if reason:
            raise ScenarioError(f"--resume is refused: {reason}; run without --resume to begin anew")


def can_resume(folder: Path | str, scenario: Scenario) -> bool:
    """Tell whether a run in a folder can go on; not where it never got as far as its scenario.

    Raises `ScenarioError` where the folder holds the run of another scenario.
    """
    folder = Path(folder)
    if not (folder / MARK).is_file() or not (folder / "scenario.toml").is_file():
        return False
    before = json.loads((folder / MARK).read_text(encoding="utf-8"))
    text, digests = _scenario_text(scenario)
    changed = difference((folder / "scenario.toml").read_text(encoding="utf-8"), text)
    if changed is None and before.get("mesh_sha256") != digests.get("mesh_sha256"):
        changed = "the contents of tissue.mesh.path changed"
    if changed is not None:
        raise ScenarioError(
            f"--resume is refused: {folder} holds the run of another scenario ({changed}); restore the scenario, "
            "give another folder, or run without --resume to begin anew"
        )
    return True


def completed_run(folder: Path | str) -> dict[str, Any] | None:
    """Read the summary of a folder's run; None where it was not completed."""
    path = Path(folder) / "summary.json"
    summary: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return summary if summary.get("status") == "completed" else None


def check_folder(folder: Path | str, scenario_file: Path | str | None = None) -> None:
    """Refuse a folder that cannot be written, or that holds anything but earlier results.

    Earlier results are replaced, but not before the new run has been prepared. The scenario that is run must
    lie elsewhere, since it would be replaced with them.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise ScenarioError(f"--out {folder} is refused: it is a file; give a folder")
    if folder.is_dir() and set(folder.iterdir()) - set(_unfinished(folder)) and not (folder / MARK).is_file():
        raise ScenarioError(f"--out {folder} is refused: it holds other files than results; give a new or empty folder")
    inside = scenario_file is not None and folder.resolve() in Path(scenario_file).resolve().parents
    if inside and (folder / MARK).is_file():
        raise ScenarioError(
            f"--out {folder} is refused: it holds the scenario {scenario_file}, which would be replaced; "
            "give another folder"
        )
    _check_writable(folder)


def _check_writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ScenarioError(
            f"--out {folder} is refused: it cannot be written ({error.strerror}); give another folder"
        ) from None


def _clear(folder: Path) -> None:
    """Make the folder, or take out of it what an earlier run wrote."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in (*(folder / name for name in FILES), *_unfinished(folder)):
        path.unlink(missing_ok=True)
    for name in FOLDERS:
        if (folder / name).is_dir():
            shutil.rmtree(folder / name)


def _unfinished(folder: Path) -> list[Path]:
    """Return the files that a killed run was about to rename."""
    return [path for name in (MARK, *FILES) for path in folder.glob(f".{name}.*")]


def _write_beginning(folder: Path, scenario: Scenario, methods: Mapping[str, str | None]) -> dict[str, Any]:
    """Write provenance and scenario, with a copy of the mesh file so that the folder stands alone."""
    mesh = mesh_file(scenario)
    text, digests = _scenario_text(scenario)
    origin = provenance() | {"methods": dict(methods)} | digests
    write_json(folder / MARK, origin)
    if mesh is not None:
        (folder / "mesh").mkdir(exist_ok=True)
        write_bytes(folder / "mesh" / mesh.name, mesh.read_bytes())
    write_text(folder / "scenario.toml", text)
    return origin


def _write_continuation(folder: Path) -> dict[str, Any]:
    """Take out an earlier end of the run, and note that it goes on."""
    for path in (folder / "summary.json", *_unfinished(folder)):
        path.unlink(missing_ok=True)
    origin: dict[str, Any] = json.loads((folder / MARK).read_text(encoding="utf-8"))
    origin["resumed"] = [*origin.get("resumed", []), provenance()]
    write_json(folder / MARK, origin)
    return origin


def _scenario_text(scenario: Scenario) -> tuple[str, dict[str, str]]:
    """Write the scenario as it stands next to its results, with digests of it and of its mesh file."""
    digests, mesh = {}, mesh_file(scenario)
    if mesh is not None:
        scenario = with_mesh_file(scenario, f"mesh/{mesh.name}")
        digests["mesh_sha256"] = hashlib.sha256(mesh.read_bytes()).hexdigest()
    text = dump(scenario)
    return text, digests | {"scenario_sha256": hashlib.sha256(text.encode()).hexdigest()}
