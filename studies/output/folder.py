"""The results folder, whose files are complete or absent.

``Recorder`` takes the plain arrays of ``studies.output.records`` and writes

- before the first step: ``provenance.json``, ``scenario.toml`` and ``mesh/``, a copy of a mesh
  file,
- after every step, in whole lines: ``piercings.csv``, ``energy.csv``, ``steps.csv``,
  ``events.csv``; for wounds and contact surfaces ``contact.csv`` and ``stitches.csv``; for loads
  ``loads.csv``; for tracts ``tracts.csv``; for ties ``ties.csv``,
- every ``output.every`` steps, first and last: ``results.pvd`` and ``frames/``,
- after every frame that was due: ``checkpoint.npz``, from which ``--resume`` continues,
- at the end, also of a failed or interrupted run: ``summary.json``, and for wounds
  ``gap_profile.csv``.

Files are written under a temporary name and renamed, so a killed run leaves every finished frame
readable.
"""

import hashlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from studies.output import manifest
from studies.output.checkpoint import ANEW, changes, first_in_words, write_checkpoint
from studies.output.columns import GAP_PROFILE, Layout
from studies.output.fields import OrganTopology
from studies.output.files import read_json, write_bytes, write_json, write_text
from studies.output.lock import LOCK, foreign_file, refused
from studies.output.provenance import provenance
from studies.output.records import Snapshot, StepRecord
from studies.output.remarks import Remark, remark
from studies.output.series import Series, named_files, step_of
from studies.output.tables import CsvFile, head_of, rows_until, tables_of, whole_table
from studies.output.tally import NEVER, Status, Tally
from studies.scenario import Scenario, ScenarioError, because, dump, mesh_file, with_mesh_copy

DURATION = "solve.duration"
SHOWN = 3  # number of names of missing files in a message


class Recorder:
    """Writes a run into a folder; leaving the ``with`` block writes the summary.

    The last frame is written even if it is not due, so a frame is passed as a function that makes
    it. A tally from the folder's checkpoint resumes a run. Rows and frames after the checkpoint are
    removed. The first recorded step must be the step of the checkpoint.
    """

    def __init__(
        self,
        folder: Path | str,
        tally: Tally,
        topology: OrganTopology | None = None,
        methods: Mapping[str, str | None] | None = None,
    ) -> None:
        scenario = tally.scenario
        self.folder = Path(folder)
        self._outcome: tuple[Status, str] | None = None
        self.last_frame: Snapshot | None = None
        self._every = scenario.output.every
        self._pending: Callable[[], Snapshot] | None = None
        self.tally, self._recorded = tally, tally.begun  # last step in the tables
        if tally.begun == NEVER:
            manifest.refuse_foreign(self.folder, scenario)
            manifest.clear(self.folder)
            self.provenance = _write_beginning(self.folder, scenario, methods or {})
        else:
            _refuse_lost_rows(self.folder, self._recorded, tables_of(scenario))
            _refuse_torn_index(self.folder, range(0, self._recorded, self._every))
            self.provenance = _write_continuation(self.folder, scenario)
        self._series = Series(self.folder, topology, before=max(self._recorded, 0))
        if self._series.missing:
            gone = ", ".join(self._series.missing[:SHOWN]) + ", …" * (len(self._series.missing) > SHOWN)
            self.remark(remark("frames-missing", "results.pvd", count=len(self._series.missing), gone=gone))
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
            self.finish("interrupted", "interrupted by the user or the system")
        else:
            self.finish("failed", str(error) or type(error).__name__)

    def record(self, step: StepRecord, frame: Callable[[], Snapshot]) -> None:
        """Write the rows of an accepted step, and its frame and a checkpoint if they are due."""
        if step.step > self._recorded:
            for layout, table in self._tables:
                table.append(layout.rows(step))
            self.tally.count(step)
            self._recorded = step.step
        self.tally.last_step = step
        self._pending = frame
        if step.step % self._every == 0:
            self._write_frame()
            if (memory := step.memory) is not None:
                write_checkpoint(self.folder, {**memory, **self.tally.memory()})

    def finish(self, status: Status, error: str = "") -> None:
        """Write the last frame and the summary."""
        try:
            self._write_frame()
        finally:
            for _, table in self._tables:
                table.close()
            self._outcome = status, error
            write_json(self.folder / "summary.json", self.summary(status, error))
            write_json(self.folder / manifest.MARK, self._origin())
            if self.tally.scenario.wounds and self.tally.last_step is not None:
                write_bytes(self.folder / manifest.PROFILE, whole_table(GAP_PROFILE, self.tally.last_step.profile()))

    def remark(self, remark: Remark) -> None:
        """Add a remark on the files; an existing summary is updated."""
        self.tally.own.append(remark)
        if self._outcome is not None:
            write_json(self.folder / "summary.json", self.summary(*self._outcome))

    def summary(self, status: Status, error: str = "") -> dict[str, Any]:
        """Return the contents of ``summary.json`` after the last recorded step."""
        return self.tally.summary(status, error) | {"provenance": self._origin()}

    def _origin(self) -> dict[str, Any]:
        """Return the origin of the run, with its methods up to the last recorded step."""
        methods, step = dict(self.provenance.get("methods", {})), self.tally.whole_from
        if methods.get("organ") is not None:
            begun = methods["organ"].partition(",")[0]
            methods["organ"] = begun if step is None else f"{begun}, whole from step {step}"
        return self.provenance | {"methods": methods}

    def _write_frame(self) -> None:
        if self._pending is not None and self.tally.last_step is not None:
            self.last_frame = self._pending()
            self._pending = None
            self.tally.see(self.last_frame.organ)
            self._series.write(self.tally.last_step.step, self.last_frame)


def _refuse_lost_rows(folder: Path, step: int, layouts: Iterable[Layout[Any]]) -> None:
    """Raise `ScenarioError` if a table does not fit the checkpoint.

    Its columns differ, or it ends before the step of the checkpoint.
    """
    for layout in layouts:
        path, reason = folder / f"{layout.name}.csv", ""
        try:
            head, *rows = rows_until(path, step)
        except (OSError, ValueError, IndexError) as error:
            raise ScenarioError(f"{path} cannot be read ({error}); {ANEW}") from None
        if head != head_of(layout.columns):
            reason = f"the columns of {path} are from another version of this code"
        elif layout.every_step and len(rows) != step + 1:
            reason = f"{path} lacks rows before the checkpoint's step {step}"
        if reason:
            raise ScenarioError(f"--resume is refused: {reason}; {ANEW}")


def _refuse_torn_index(folder: Path, steps: Iterable[int]) -> None:
    """Raise `ScenarioError` if ``results.pvd`` lacks a frame before the checkpoint.

    A damaged index is also refused.
    """
    index = folder / "results.pvd"
    try:
        named = {step_of(file) for _, file in named_files(index)}
    except (OSError, ValueError) as error:
        raise ScenarioError(f"{index} cannot be read ({error}); {ANEW}") from None
    for step in steps:
        if step not in named:
            raise ScenarioError(f"--resume is refused: {index} lacks the frame of step {step}; {ANEW}")


def can_resume(folder: Path | str, scenario: Scenario) -> bool:
    """Return whether a run in a folder can be continued.

    False if the run stopped before it wrote its scenario.

    Raises `ScenarioError` if the folder holds the run of another scenario. A dynamic scenario with
    only a longer duration counts as the same.
    """
    folder = Path(folder)
    before = manifest.read(folder)
    if before is None or not manifest.holds_run(folder):
        return False
    changed, (_, digests) = _changes(folder, scenario), _scenario_text(scenario)
    same_mesh = before.get("mesh_sha256") == digests.get("mesh_sha256")
    _refuse_another(folder, scenario, changed, "" if same_mesh else "the contents of tissue.mesh.path changed")
    return True


def _refuse_another(folder: Path, scenario: Scenario, changed: Mapping[str, tuple[Any, Any]], more: str = "") -> None:
    """Refuse to continue the run of another scenario.

    The reason is the first key in `changed`, or else `more`. A dynamic scenario can be longer.
    """
    was, now = changed.get(DURATION, (None, None))
    longer = scenario.solve.kind == "dynamic" and isinstance(was, float) and isinstance(now, float) and now > was
    left = {key: values for key, values in changed.items() if not (longer and key == DURATION)}
    if reason := first_in_words(left) or more:
        raise ScenarioError(f"--resume is refused: {because('resume-other', folder=folder, reason=reason, anew=ANEW)}")


def completed_run(folder: Path | str, scenario: Scenario) -> dict[str, Any] | None:
    """Read the summary of a completed run.

    None if the run is not completed, or if the scenario is longer now.
    """
    summary = read_json(Path(folder) / "summary.json")  # a damaged summary is written again at the end of the run
    ended = summary.get("status") == "completed"
    return summary if ended and not _changes(Path(folder), scenario) else None


def _changes(folder: Path, scenario: Scenario) -> dict[str, tuple[Any, Any]]:
    """Return the keys that differ from the scenario of a folder, with both values.

    Raises `ScenarioError`.
    """
    path = folder / manifest.SCENARIO
    try:
        return changes(path.read_text(encoding="utf-8"), _scenario_text(scenario)[0])
    except (OSError, ValueError, RecursionError) as error:
        raise ScenarioError(f"--resume is refused: {path} cannot be read ({error}); {ANEW}") from None


def check_folder(
    folder: Path | str,
    scenario: Scenario | None = None,
    file: Path | str | None = None,
    resume: bool = False,
    overwrite: bool = False,
) -> None:
    """Refuse a folder with files other than earlier results, or results that may not be replaced.

    `overwrite` allows to replace earlier results, and `resume` to continue them. A folder that
    cannot be written is refused by `studies.output.lock.locked`. Earlier results are replaced after
    the new run is prepared. The `file` of the `scenario` must lie in another folder, because it
    would be replaced too. To continue a run, the keys that the scenario gives must have their
    earlier values.
    """
    folder = Path(folder)
    if manifest.read(folder) is None:
        _refuse_others(folder)
    if manifest.holds_run(folder) and not resume:
        _refuse_replacing(folder, [file, mesh_file(scenario) if scenario else None], overwrite)
    if scenario is not None:
        manifest.refuse_foreign(folder, scenario)
        if resume and manifest.holds_run(folder):
            given = {key: values for key, values in _changes(folder, scenario).items() if values[1] is not None}
            _refuse_another(folder, scenario, given)


def _refuse_others(folder: Path) -> None:
    """Refuse a folder that holds files but no manifest of this code."""
    if other := foreign_file(folder, [manifest.MARK], known=False):
        torn = (folder / manifest.MARK).exists()
        also = f", and {manifest.MARK} is damaged or not from a run" if torn else ""
        raise refused(folder, f"it holds files that no run wrote ({other}{also}); give a new or empty folder")


def _refuse_replacing(folder: Path, read: Iterable[Path | str | None], overwrite: bool) -> None:
    """Refuse to replace a run without permission.

    A folder with the scenario or the mesh that the run reads is also refused.
    """
    if not overwrite:
        remedy = "add --overwrite to replace it, --resume to continue it, or give another folder"
        raise refused(folder, f"it already holds a run; {remedy}")
    inside = [path for path in read if path is not None and folder.resolve() in Path(path).resolve().parents]
    if inside:
        raise refused(folder, f"it holds {inside[0]}, which this run reads and replaces; give another folder")


def _write_beginning(folder: Path, scenario: Scenario, methods: Mapping[str, str | None]) -> dict[str, Any]:
    """Write provenance and scenario.

    A copy of the mesh file makes the folder complete.
    """
    folder.mkdir(parents=True, exist_ok=True)
    mesh = mesh_file(scenario)
    text, digests = _scenario_text(scenario)
    origin = provenance() | {"methods": dict(methods)} | digests | {"files": manifest.files_of(scenario)}
    _take_out(manifest.unfinished(folder, origin["files"]))
    write_json(folder / manifest.MARK, origin)
    if mesh is not None:
        (folder / "mesh").mkdir(exist_ok=True)
        write_bytes(folder / "mesh" / mesh.name, mesh.read_bytes())
    write_text(folder / manifest.SCENARIO, text)
    return origin


def _take_out(paths: Iterable[Path]) -> None:
    """Remove files of an earlier run, except the lock of this run."""
    for path in paths:
        if path.name != LOCK:
            path.unlink(missing_ok=True)


def _write_continuation(folder: Path, scenario: Scenario) -> dict[str, Any]:
    """Remove an earlier end of the run, and note that the run continues."""
    origin = manifest.read(folder) or {}
    _take_out([folder / "summary.json", *manifest.unfinished(folder, origin.get("files", ()))])
    text, digests = _scenario_text(scenario)
    origin |= digests | {"resumed": [*origin.get("resumed", []), provenance()]}
    write_json(folder / manifest.MARK, origin)
    write_text(folder / manifest.SCENARIO, text)
    return origin


def _scenario_text(scenario: Scenario) -> tuple[str, dict[str, str]]:
    """Return the scenario's text for the results folder, with digests.

    The digests are of the text and of the mesh file.
    """
    copied, mesh = with_mesh_copy(scenario)
    text, digests = dump(copied), {"mesh_sha256": mesh} if mesh else {}
    return text, digests | {"scenario_sha256": hashlib.sha256(text.encode()).hexdigest()}
