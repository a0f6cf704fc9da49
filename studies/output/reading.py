"""Reading a results folder back: its summary, its tables with their units, and its frames.

A running or killed run is read up to its last complete file.
"""

import csv
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from studies.arrays import Array
from studies.extras import installation
from studies.output.columns import TABLES, UNITS, Quantity, headed, quantities
from studies.output.fields import OrganTopology
from studies.output.files import read_json
from studies.output.manifest import MARK, SCENARIO, holds_run
from studies.output.series import is_whole, named_files, part_of, step_of
from studies.scenario import Scenario, hint_at, load

if TYPE_CHECKING:
    import pandas as pd
    import pyvista as pv

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


WHOLE = {column.name for layout in TABLES for column in layout.columns if column.kind == "whole"}


@dataclass(frozen=True)
class OpenRun:
    """A run in its folder. Made by `open_run`.

    `summary` is the content of ``summary.json``, empty for a run that has not ended, and
    `provenance` is the manifest. `rows` are the tables by name, `frames` in the order of time.
    """

    folder: Path
    summary: dict[str, Any]
    provenance: dict[str, Any]
    scenario_text: str
    rows: Mapping[str, Table]
    frames: tuple[FrameFiles, ...]

    def __repr__(self) -> str:
        title = f"{self.summary['title']!r}, " if self.summary.get("title") else ""
        status = self.summary.get("status", "not ended")
        return f"OpenRun({str(self.folder)!r}, {title}{status}, {len(self.times)} frames)"

    @property
    def name(self) -> str:
        """The folder's own name."""
        return self.folder.resolve().name

    @property
    def title(self) -> str:
        """The title of the scenario.

        It is the folder's name without a title or with a damaged file.
        """
        try:
            return str(tomllib.loads(self.scenario_text).get("title", "")) or self.name
        except (tomllib.TOMLDecodeError, RecursionError):
            return self.name

    @property
    def piercings(self) -> list[str]:
        """The names of the piercings, in the order of the scenario."""
        table = self.rows.get("piercings")
        return [] if table is None else list(dict.fromkeys(table.columns["piercing"].tolist()))

    def parts(self, name: str) -> dict[str, Table]:
        """Return a table in parts with one row per step, by the name of the part.

        This is the name of a piercing, a pair of surfaces, or a boundary. A second load on a
        boundary is `top (2)`. A table without such names is one part with an empty name.
        """
        table = self.rows[name]
        if name not in ITEM:
            return {"": table}
        met: Counter[tuple[float, str]] = Counter()
        rows: dict[str, list[int]] = {}
        for row, of in enumerate(zip(table.columns["step"].tolist(), table.columns[ITEM[name]].tolist(), strict=True)):
            met[of] += 1
            rows.setdefault(of[1] if met[of] == 1 else f"{of[1]} ({met[of]})", []).append(row)
        return {item: table.rows(np.array(chosen)) for item, chosen in rows.items()}

    @property
    def quantities(self) -> dict[str, Quantity]:
        """The numbers and words of the summary by their dotted names, each with its unit."""
        return quantities(self.summary)

    @property
    def remarks(self) -> list[dict[str, Any]]:
        """The remarks on the run: `code`, `severity`, `message` and `where` of each."""
        return self.summary.get("remarks", [])

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario of the run, with every default."""
        return load(self.folder / SCENARIO)

    @property
    def tables(self) -> list[str]:
        """The names of the tables."""
        return list(self.rows)

    def table(self, name: str) -> "pd.DataFrame":
        """Return a table as a pandas data frame.

        Columns have their names, and their units are in ``attrs["units"]``.

        Raises `ResultsError` if there is no table of this name, and `ImportError` without pandas.
        """
        if name not in self.tables:
            hint = hint_at(str(name), self.tables)
            raise ResultsError(f"table {name} is not in {self.folder}: there are {', '.join(self.tables)}{hint}")
        try:
            import pandas as pd
        except ImportError as error:
            raise ImportError(f"tables as data frames need pandas: {installation('pandas')}") from error
        found = self.rows[name]
        frame = pd.DataFrame({key: values.tolist() for key, values in found.columns.items()})
        whole = [key for key in frame if key in WHOLE and not np.isnan(found.columns[key]).any()]
        frame = frame.astype(dict.fromkeys(whole, "int64"))
        frame.attrs["units"] = {key: found.units.get(key, "") for key in found.columns}
        return frame

    @property
    def times(self) -> list[float]:
        """The times of the frames [s]."""
        return [frame.time for frame in self.frames]

    def frame(self, number: int = -1) -> "pv.MultiBlock":
        """Return a frame by its number; the default is the last frame.

        Its blocks are "organ" (absent without an organ), "thread" and "piercings", with the units
        of their arrays in ``user_dict["units"]``. The organ's points are in the reference shape:
        use ``frame["organ"].warp_by_vector("displacement")``. Raises `IndexError`, and
        `ResultsError` for a missing file.
        """
        import pyvista as pv

        if not isinstance(number, int | np.integer):
            raise ResultsError(f"frame {number!r} is refused: give a whole number; there are {len(self.times)} frames")
        blocks, files = pv.MultiBlock(), self.frames[number]
        for name in files.parts:
            block = files.read(name)
            block.user_dict["units"] = {key: UNITS[key] for key in block.array_names if key in UNITS}
            blocks[name] = block
        return blocks


def open_run(folder: Path | str) -> OpenRun:
    """Open the folder of a run, ended or not.

    Raises `ResultsError` if it holds no run.
    """
    if not isinstance(folder, str | PathLike):
        raise ResultsError(f"{folder!r} is refused: it is no path; give a folder that suture run --out wrote")
    folder = Path(folder)
    if not holds_run(folder):
        raise ResultsError(f"{folder} is refused: it holds no run; give a folder that suture run --out wrote")
    found = {layout.name: folder / f"{layout.name}.csv" for layout in TABLES}
    return OpenRun(
        folder,
        read_summary(folder),
        read_json(folder / MARK),
        (folder / SCENARIO).read_text(encoding="utf-8", errors="replace"),
        {name: read_run_table(path) for name, path in found.items() if path.is_file()},
        read_frames(folder / "results.pvd"),
    )
