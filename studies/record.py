"""The results folder: what a run leaves behind, complete or absent.

``Recorder`` takes the plain arrays of ``studies.observables`` and writes

- ``provenance.json``, ``scenario.toml`` (and ``mesh/``, a copy of the mesh file) before the first step,
- ``piercings.csv``, ``energy.csv``, ``steps.csv``, ``events.csv``, and ``contact.csv`` of a wound whose lips may touch:
  whole lines, after every step,
- ``results.pvd`` and ``frames/``: every ``output.every`` steps, the first and the last,
- ``checkpoint.npz`` after every frame that was due, from which ``--resume`` goes on,
- ``summary.json`` at the end, also of a failed or an interrupted run.

Files are written under a temporary name and renamed: a killed run leaves every finished frame readable.
"""

import csv
import hashlib
import io
import json
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np

from coupling.events import Event
from studies.checkpoint import Arrays, difference, write_checkpoint
from studies.files import write_bytes, write_json, write_text
from studies.observables import ContactRecord, EnergyRecord, Frame, OrganTopology, PiercingRecord, StepRecord
from studies.provenance import provenance
from studies.scenario import Scenario, ScenarioError, dump, mesh_file, with_mesh_file
from studies.series import Series

Status = Literal["completed", "failed", "interrupted"]

MARK = "provenance.json"  # the first file written: a folder that holds it is a results folder
FILES = (
    "summary.json",
    "piercings.csv",
    "energy.csv",
    "steps.csv",
    "events.csv",
    "contact.csv",
    "checkpoint.npz",
    "results.pvd",
    "scenario.toml",
    "picture.png",
)
FOLDERS = ("frames", "mesh")


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
    ) -> None:
        self.folder = Path(folder)
        self.last_frame: Frame | None = None
        self.last_step: StepRecord | None = None
        self._tissue_dofs = tissue_dofs
        self.subgrid = subgrid or {}
        self._every = scenario.output.every
        self._pending: Callable[[], Frame] | None = None
        counters = checkpoint or {}
        self._newton_iterations = int(counters.get("newton_iterations", 0))
        self._constraint_max = float(counters.get("constraint_max", 0.0))
        self._constraint_residual = float(counters.get("constraint_residual", 0.0))
        self._seconds = float(counters.get("seconds", 0.0))
        self._recorded = -1 if checkpoint is None else int(checkpoint["step"])  # last step in the tables
        if checkpoint is None:
            _clear(self.folder)
            self.provenance = _write_beginning(self.folder, scenario)
        else:
            _refuse_lost_rows(self.folder, self._recorded, tables_of(scenario))
            self.provenance = _write_continuation(self.folder)
        self._series = Series(self.folder, topology, before=max(self._recorded, 0))
        self._tables = {
            name: Table(self.folder / f"{name}.csv", COLUMNS[name], self._recorded) for name in tables_of(scenario)
        }

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

    def record(self, step: StepRecord, frame: Callable[[], Frame]) -> None:
        """Write the rows of an accepted step, and its frame and a checkpoint if they are due."""
        if step.step > self._recorded:
            self._write_rows(step)
        self.last_step = step
        self._pending = frame
        if step.step % self._every == 0:
            self._write_frame()
            self._write_checkpoint(step)

    def _write_rows(self, step: StepRecord) -> None:
        self._tables["piercings"].append(_piercing_row(step, piercing) for piercing in step.piercings)
        self._tables["events"].append(_event_row(step, event) for event in step.events)
        self._tables["energy"].append([_energy_row(step)])
        self._tables["steps"].append([_step_row(step)])
        if step.contact is not None:
            self._tables["contact"].append([_contact_row(step, step.contact)])
        self._newton_iterations += step.newton_iterations
        self._constraint_max = max(self._constraint_max, step.constraint_max)
        self._constraint_residual = max(self._constraint_residual, step.constraint_residual)
        self._seconds += step.seconds if step.step else 0.0
        self._recorded = step.step

    def _write_checkpoint(self, step: StepRecord) -> None:
        if step.memory is None:
            return
        counters = {
            "newton_iterations": np.array(self._newton_iterations),
            "constraint_max": np.array(self._constraint_max),
            "constraint_residual": np.array(self._constraint_residual),
            "seconds": np.array(self._seconds),
        }
        write_checkpoint(self.folder, {**step.memory, **counters})

    def finish(self, status: Status, error: str = "") -> None:
        """Write the last frame and the summary."""
        try:
            self._write_frame()
        finally:
            for table in self._tables.values():
                table.close()
            write_json(self.folder / "summary.json", self.summary(status, error))

    def summary(self, status: Status, error: str = "") -> dict[str, Any]:
        """The contents of ``summary.json`` as of the last recorded step."""
        step = self.last_step
        head = {
            "status": status,
            "error": error,
            "time": step.time if step else 0.0,
            "steps": step.step if step else 0,
            "newton_iterations": self._newton_iterations,
            "constraint_max": self._constraint_max,
            "constraint_residual": self._constraint_residual,
            "seconds_per_step": self._seconds / step.step if step and step.step else None,
            "tissue_dofs": self._tissue_dofs,
            "subgrid": self.subgrid,
        }
        return head | (_state_summary(step) if step else {}) | {"provenance": self.provenance}

    def _write_frame(self) -> None:
        if self._pending is not None and self.last_step is not None:
            self.last_frame = self._pending()
            self._pending = None
            self._series.write(self.last_step.step, self.last_frame)


class Table:
    """A CSV file that grows by whole lines."""

    def __init__(self, path: Path, columns: Iterable[str], last_step: int = -1) -> None:
        """``last_step``: rows up to this step are kept, as a run that is resumed wants it."""
        kept = len(b"".join(_rows_until(path, last_step))) if last_step >= 0 else 0
        self._file = path.open("r+b" if kept else "wb", buffering=0)
        self._file.truncate(kept)
        self._file.seek(kept)
        if not kept:
            self.append([list(columns)])

    def append(self, rows: Iterable[Iterable[object]]) -> None:
        """Append rows in one write; on a full disk none of them."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        data = text.getvalue().encode()
        end = self._file.tell()
        try:
            if self._file.write(data) != len(data):
                raise OSError(f"{self._file.name} cannot grow: the disk is full; free some space")
        except OSError:
            self._file.truncate(end)
            self._file.seek(end)
            raise

    def close(self) -> None:
        self._file.close()


def _rows_until(path: Path, step: int) -> list[bytes]:
    """A table's head and its rows up to a step, each a whole line; the step is the second column of every table."""
    head, *rows = path.read_bytes().splitlines(keepends=True)
    return [head, *(row for row in rows if row.endswith(b"\n") and int(row.split(b",")[1]) <= step)]


def tables_of(scenario: Scenario) -> list[str]:
    """Names of the tables that a run of the scenario writes."""
    touching = scenario.tissue is not None and scenario.tissue.contact
    return [name for name in COLUMNS if name != "contact" or touching]


def _refuse_lost_rows(folder: Path, step: int, tables: Iterable[str]) -> None:
    """Raise `ScenarioError` where the tables do not reach the step of the checkpoint."""
    for name in tables:
        path = folder / f"{name}.csv"
        try:
            rows = len(_rows_until(path, step)) - 1
        except (OSError, ValueError, IndexError) as error:
            raise ScenarioError(f"{path} cannot be read ({error}); run without --resume to begin anew") from None
        if name in ("energy", "steps", "contact") and rows != step + 1:
            reason = f"{path} lacks rows before step {step}, that of the checkpoint"
            raise ScenarioError(f"--resume is refused: {reason}; run without --resume to begin anew")


def resumable(folder: Path | str, scenario: Scenario) -> bool:
    """Whether there is something to go on with in a folder; False also where the run never got as far as its scenario.

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
    """The summary of a folder's run if it was completed."""
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
    """Files that a killed run was about to rename."""
    return [path for name in (MARK, *FILES) for path in folder.glob(f".{name}.*")]


def _write_beginning(folder: Path, scenario: Scenario) -> dict[str, Any]:
    """Write provenance and scenario, with a copy of the mesh file so that the folder stands alone."""
    mesh = mesh_file(scenario)
    text, digests = _scenario_text(scenario)
    origin = provenance() | digests
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
    """The scenario as it is written beside its results, and digests of it and of its mesh file."""
    digests, mesh = {}, mesh_file(scenario)
    if mesh is not None:
        scenario = with_mesh_file(scenario, f"mesh/{mesh.name}")
        digests["mesh_sha256"] = hashlib.sha256(mesh.read_bytes()).hexdigest()
    text = dump(scenario)
    return text, digests | {"scenario_sha256": hashlib.sha256(text.encode()).hexdigest()}


def _state_summary(step: StepRecord) -> dict[str, Any]:
    hidden = ("name", "u", "v")
    piercings = {
        piercing.name: {key: value for key, value in _shallow(piercing).items() if key not in hidden}
        for piercing in step.piercings
    }
    ends: dict[str, dict[str, object]] = {
        "start": {"reaction": step.start_reaction},
        "end": {"reaction": step.end_reaction},
    }
    for end, torque in zip(ends.values(), step.torques or (), strict=False):
        end["torque"] = torque
    thread = ends | {"max_strain": step.max_strain, "span_ratio": step.span_ratio}
    contact = {} if step.contact is None else {"contact": asdict(step.contact)}
    return {"energy": asdict(step.energy), "thread": thread, "piercings": piercings} | contact


def _shallow(record: PiercingRecord) -> dict[str, Any]:
    return {field.name: getattr(record, field.name) for field in fields(record)}


def _xyz(name: str) -> list[str]:
    return [f"{name}_x", f"{name}_y", f"{name}_z"]


COLUMNS: dict[str, list[str]] = {
    "piercings": [
        *("time", "step", "piercing", "s", "slip", "x", "y", "z"),  # s, -, -, m ...
        *_xyz("displacement"),  # m
        *_xyz("force"),  # N
        *("normal_force", "tangential_force"),  # N
        *_xyz("couple"),  # N m
        *("tension_before", "tension_after", "state"),  # N, N, -
        *_xyz("tangent"),
        "cone_residual",  # N, by how much friction breaks Coulomb's law
    ],
    "energy": ["time", "step", *(field.name for field in fields(EnergyRecord))],  # s, -, J ...
    "events": [
        *("time", "step", "event", "piercing", "s"),  # s, -, begins ends leaves slips sticks halved knots, -, m
        *("energy", "work", "loss"),  # J: energy = work - loss
        *("gap", "angle"),  # m, rad: closed when a piercing begins
        *_xyz("impulse"),  # N s, of the hole on the thread; of other knots the change of the thread's momentum
        "control_points",  # -, after a change of the knots
    ],
    "steps": [
        *("time", "step", "newton_iterations", "constraint_max", "max_strain"),  # s, -, -, m, -
        *_xyz("start_reaction"),  # N
        *_xyz("end_reaction"),  # N
        *("start_torque", "end_torque"),  # N m, about the tangent; empty without twist
        "seconds",  # s of wall-clock time
    ],
    "contact": ["time", "step", *(field.name for field in fields(ContactRecord))],  # s, -, -, -, m, Pa, N, J
}


def _piercing_row(step: StepRecord, piercing: PiercingRecord) -> list[object]:
    return [
        *_numbers(step.time),
        step.step,
        piercing.name,
        *_numbers(piercing.s, piercing.slip, *piercing.x, *piercing.displacement, *piercing.force),
        *_numbers(piercing.normal_force, piercing.tangential_force, *piercing.couple),
        *_numbers(piercing.tension_before, piercing.tension_after),
        piercing.state,
        *_numbers(*piercing.tangent, piercing.cone_residual),
    ]


def _energy_row(step: StepRecord) -> list[object]:
    return [*_numbers(step.time), step.step, *_numbers(*asdict(step.energy).values())]


def _event_row(step: StepRecord, event: Event) -> list[object]:
    return [
        *_numbers(event.time),
        step.step,
        event.kind,
        event.piercing,
        *_numbers(event.s, event.energy, event.work, event.loss, event.gap, event.angle, *event.impulse),
        event.control_points or "",
    ]


def _step_row(step: StepRecord) -> list[object]:
    return [
        *_numbers(step.time),
        step.step,
        step.newton_iterations,
        *_numbers(step.constraint_max, step.max_strain, *step.start_reaction, *step.end_reaction),
        *(("", "") if step.torques is None else _numbers(*step.torques)),
        *_numbers(step.seconds),
    ]


def _contact_row(step: StepRecord, contact: ContactRecord) -> list[object]:
    numbers = (contact.smallest_gap, contact.largest_pressure, contact.force, contact.complementarity)
    return [*_numbers(step.time), step.step, contact.pairs, contact.pressed, *_numbers(*numbers)]


def _numbers(*values: float) -> list[str]:
    """Numbers with all their digits: they read back to the same bits."""
    return [repr(float(value)) for value in values]
