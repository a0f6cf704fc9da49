"""An opened results folder: its summary, tables and frames as Python objects."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studies.extras import installation
from studies.output.columns import TABLES, UNITS
from studies.output.manifest import SCENARIO
from studies.output.quantities import Quantity, quantities
from studies.output.reading import ResultsError, RunResults, read_run
from studies.scenario import Scenario
from studies.scenario.refusal import nearest
from studies.scenario.toml import load

if TYPE_CHECKING:
    import pandas as pd
    import pyvista as pv

WHOLE = {column.name for layout in TABLES for column in layout.columns if column.kind == "whole"}


@dataclass(frozen=True)
class OpenRun:
    """A run in its folder. Made by `open_run`."""

    results: RunResults

    def __repr__(self) -> str:
        title = f"{self.summary['title']!r}, " if self.summary.get("title") else ""
        status = self.summary.get("status", "not ended")
        return f"OpenRun({str(self.folder)!r}, {title}{status}, {len(self.times)} frames)"

    @property
    def folder(self) -> Path:
        """The folder of the run."""
        return self.results.folder

    @property
    def summary(self) -> dict[str, Any]:
        """The content of ``summary.json``; empty for a run that has not ended."""
        return dict(self.results.summary)

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
        return list(self.results.tables)

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
        found = self.results.tables[name]
        frame = pd.DataFrame({key: values.tolist() for key, values in found.columns.items()})
        whole = [key for key in frame if key in WHOLE and not np.isnan(found.columns[key]).any()]
        frame = frame.astype(dict.fromkeys(whole, "int64"))
        frame.attrs["units"] = {key: found.units.get(key, "") for key in found.columns}
        return frame

    @property
    def times(self) -> list[float]:
        """The times of the frames [s]."""
        return [frame.time for frame in self.results.frames]

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
        blocks, files = pv.MultiBlock(), self.results.frames[number]
        for name in files.parts:
            block = files.read(name)
            block.user_dict["units"] = {key: UNITS[key] for key in block.array_names if key in UNITS}
            blocks[name] = block
        return blocks


def open_run(folder: Path | str) -> OpenRun:
    """Open the folder of a run, ended or not.

    Raises `studies.output.reading.ResultsError` if it holds no run.
    """
    return OpenRun(read_run(folder))
