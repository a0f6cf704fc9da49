"""An opened results folder: its summary, tables and frames as Python objects."""

import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studies.extras import installation
from studies.output.columns import TABLES, UNITS
from studies.output.files import read_json
from studies.output.manifest import MARK, SCENARIO, holds_run
from studies.output.quantities import Quantity, quantities
from studies.output.reading import (
    ITEM,
    FrameFiles,
    ResultsError,
    Table,
    read_frames,
    read_run_table,
    read_summary,
)
from studies.scenario import Scenario
from studies.scenario.refusal import nearest
from studies.scenario.toml import load

if TYPE_CHECKING:
    import pandas as pd
    import pyvista as pv

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
        found: list[dict[str, str]] = self.summary.get("remarks", [])
        return found

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
            suggestion = nearest(str(name), self.tables)
            hint = f"; the nearest is {suggestion}" if suggestion else ""
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

    Raises `studies.output.reading.ResultsError` if it holds no run.
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
