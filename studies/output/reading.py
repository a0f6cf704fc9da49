"""Reading a results folder back: its summary, its tables with their units, and its frames.

A running or killed run is read up to its last complete file.
"""

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from studies.arrays import Array
from studies.output.columns import TABLES, headed
from studies.output.fields import OrganTopology
from studies.output.files import read_json
from studies.output.series import is_whole, named_files, part_of, step_of

HEADING = re.compile(r"(?P<name>.*?)(?: \[(?P<unit>[^\]]*)\])?")
ITEM = {  # the column with the name of the piercing, pair or boundary of a row
    layout.name: next(column.name for column in layout.columns if column.kind == "text")
    for layout in TABLES
    if not layout.every_step
}
TEXTS = {column.name for layout in TABLES for column in layout.columns if column.kind == "text"}


TORN = (ArithmeticError, AttributeError, LookupError, OSError, RuntimeError, TypeError, ValueError, csv.Error)


class ResultsError(ValueError):
    """An error: the results folder cannot be read, or lacks the requested data."""


class Summary(BaseModel):
    """The parts of `summary.json` that are checked; the file has more."""

    remarks: list[dict[str, Any]]
    piercings: dict[str, dict[str, Any]] = {}
    energy: dict[str, Any] = {}


@contextmanager
def refused_if_torn(path: Path | str) -> Iterator[None]:
    """Raise `ResultsError` if a file has not the content of a run."""
    try:
        yield
    except ResultsError:
        raise
    except TORN as error:
        raise ResultsError(f"{path} is damaged ({error or type(error).__name__}); run the scenario again") from error


@dataclass(frozen=True)
class Table:
    """Columns of a table by name, each shape `(rows,)`, and the units of the columns with a unit.

    A column is numeric if every cell is a number or empty (then not a number), else text.
    """

    columns: Mapping[str, NDArray[Any]]
    units: Mapping[str, str]

    @property
    def numeric(self) -> list[str]:
        """The names of the columns that hold numbers."""
        return [name for name, values in self.columns.items() if values.dtype.kind == "f"]

    def heading(self, name: str) -> str:
        """Return a column's name with its unit: `slip [m]`."""
        return headed(name, self.units.get(name, ""))

    def rows(self, chosen: NDArray[Any]) -> "Table":
        """Return the rows chosen by their numbers or by a mask."""
        return Table({key: values[chosen] for key, values in self.columns.items()}, self.units)


@dataclass(frozen=True)
class FrameFiles:
    """The files of one time by their part: organ, thread, piercings."""

    time: float  # [s]
    step: int
    parts: Mapping[str, Path]

    def read(self, part: str) -> Any:
        """Read a part as an object of pyvista; None if the frame has no such part.

        Raises `ResultsError` for a damaged or missing file.
        """
        import pyvista as pv

        path = self.parts.get(part)
        if path is None:
            return None
        if not path.is_file():
            raise ResultsError(f"{path} is missing, though results.pvd names it; run the scenario again")
        with refused_if_torn(path), pv.vtk_verbosity("off"):
            if not is_whole(path.read_bytes()):
                raise ValueError("its checksum differs")
            return pv.read(path)


def read_summary(folder: Path) -> dict[str, Any]:
    """Read the summary of a run; empty if it is missing, damaged or incomplete."""
    found = read_json(folder / "summary.json")
    try:
        Summary.model_validate(found)
    except ValidationError:
        return {}
    return found


def read_run_table(path: Path) -> Table:
    """Read a table of a run. Raises `ResultsError` if its rows have no time or no name."""
    table = read_table(path)
    wanted = {"time": "f", "step": "f"} | ({ITEM[path.stem]: "U"} if path.stem in ITEM else {})
    for name, kind in wanted.items():
        if name not in table.columns or table.columns[name].dtype.kind != kind:
            raise ResultsError(f"{path} is damaged (its column {name} is missing); run the scenario again")
    return table


def read_table(path: Path) -> Table:
    """Read a CSV table whose headings have units.

    Raises `ResultsError` for a damaged or empty file.
    """
    with refused_if_torn(path), path.open(encoding="utf-8", newline="") as file:
        head, *rows = list(csv.reader(file)) or [[]]
    if not head:
        raise ResultsError(f"{path} is empty; run the scenario again")
    whole = [row for row in rows if len(row) == len(head)]  # the last row can be incomplete
    matches = [cast(re.Match[str], HEADING.fullmatch(text)) for text in head]
    cells = zip(*whole, strict=True) if whole else [()] * len(head)
    columns = {
        match["name"]: np.array(values, dtype=np.str_) if match["name"] in TEXTS else column_of(values)
        for match, values in zip(matches, cells, strict=True)
    }
    return Table(columns, {match["name"]: match["unit"] for match in matches if match["unit"]})


def column_of(cells: Sequence[str]) -> NDArray[Any]:
    """Return cells as numbers, with NaN for an empty cell; as text if a cell is no number."""
    try:
        return np.array([float(cell) if cell else np.nan for cell in cells], dtype=np.float64)
    except ValueError:
        return np.array(cells, dtype=np.str_)


def read_frames(index: Path) -> tuple[FrameFiles, ...]:
    """Return the files that a `.pvd` file names, frame by frame.

    Empty if the file is missing or damaged.
    """
    try:
        listed = named_files(index)
    except (OSError, ValueError):
        return ()
    frames: dict[int, tuple[float, dict[str, Path]]] = {}
    with refused_if_torn(index):
        for time, file in listed:
            _, files = frames.setdefault(step_of(file), (float(time), {}))
            files[part_of(file)] = index.parent / file
    return tuple(FrameFiles(time, step, files) for step, (time, files) in sorted(frames.items()))


def arrays_of(data: Any) -> dict[str, Array]:
    """Return the arrays of points or of cells by their names, in double precision."""
    return {name: np.asarray(values, dtype=np.float64) for name, values in data.items()}


def evenly_spaced(count: int, most: int) -> NDArray[np.int64]:
    """Return at most `most` of the numbers below `count`, evenly spaced.

    The first and the last number are included.
    """
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def topology_of(frame: FrameFiles) -> OrganTopology | None:
    """Return the organ's mesh of a frame, None without an organ."""
    organ = frame.read("organ")
    if organ is None:
        return None
    with refused_if_torn(f"the frame at {frame.time:g} s"):
        [cells] = organ.cells_dict.values()
        return OrganTopology(np.asarray(organ.points, dtype=np.float64), np.asarray(cells, dtype=np.int64))


def nodal(values: Array, cells: NDArray[np.int64], nodes: int) -> Array:
    """Return values of cells `(cells,)`, averaged over the cells at each node, shape `(nodes,)`."""
    flat = cells.ravel()
    total = np.bincount(flat, np.repeat(values, cells.shape[1]), minlength=nodes)
    return np.asarray(total / np.maximum(np.bincount(flat, minlength=nodes), 1))


def pieces(thread: Any) -> list[NDArray[np.int64]]:
    """Return the numbers of the points of each piece of a thread, in order."""
    return [np.array(cell.point_ids, dtype=np.int64) for cell in thread.cell]
