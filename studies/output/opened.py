"""A results folder, opened: its summary, tables and frames as Python holds them."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from studies.output.columns import ORGAN_ARRAYS, ORGAN_CELLS, PIERCING_ARRAYS, TABLES, THREAD_ARRAYS, Column
from studies.output.manifest import SCENARIO, holds_run
from studies.output.quantities import Quantity, quantities
from studies.scenario import Scenario, ScenarioError
from studies.scenario.refusal import nearest
from studies.scenario.toml import load

if TYPE_CHECKING:
    import pandas as pd
    import pyvista as pv

PANDAS = "pip install 'suturefem[tables]'"
BLOCKS: dict[str, tuple[Column[Any], ...]] = {
    "organ": (*ORGAN_ARRAYS, *ORGAN_CELLS),
    "thread": THREAD_ARRAYS,
    "piercings": PIERCING_ARRAYS,
}


@dataclass(frozen=True)
class OpenRun:
    """A run in its folder. Made by `open_run`."""

    folder: Path

    def __repr__(self) -> str:
        title = f"{self.summary['title']!r}, " if self.summary.get("title") else ""
        status = self.summary.get("status", "not ended")
        return f"OpenRun({str(self.folder)!r}, {title}{status}, {len(self.times)} frames)"

    @cached_property
    def summary(self) -> dict[str, Any]:
        """What ``summary.json`` says; empty of a run that has not ended."""
        path = self.folder / "summary.json"
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        return found

    @property
    def quantities(self) -> dict[str, Quantity]:
        """The numbers and words of the summary by their dotted names, each with its unit."""
        return quantities(self.summary)

    @property
    def remarks(self) -> list[dict[str, str]]:
        """What is said of the run: `code`, `severity`, `message` and `where` of each."""
        found: list[dict[str, str]] = self.summary.get("remarks", [])
        return found

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario as run, with every default."""
        return load(self.folder / SCENARIO)

    @property
    def tables(self) -> list[str]:
        """The names of the tables."""
        return [layout.name for layout in TABLES if (self.folder / f"{layout.name}.csv").is_file()]

    def table(self, name: str) -> "pd.DataFrame":
        """Return a table as a frame of pandas: columns by their names, their units in ``attrs["units"]``.

        Raises `ScenarioError` for a table that there is none of, and `ImportError` without pandas.
        """
        if name not in self.tables:
            near = nearest(name, self.tables)
            hint = f"; the nearest is {near}" if near else ""
            raise ScenarioError(f"table {name} is not in {self.folder}: there are {', '.join(self.tables)}{hint}")
        try:
            import pandas as pd
        except ImportError as error:
            raise ImportError(f"tables as data frames need pandas: {PANDAS}") from error
        frame = pd.read_csv(self.folder / f"{name}.csv")
        units = dict(map(parted, frame.columns))
        frame.columns = list(units)
        for word in (name for name, unit in units.items() if not unit):
            frame[word] = frame[word].fillna("")
        frame.attrs["units"] = units
        return frame

    @cached_property
    def _files(self) -> dict[float, dict[str, Path]]:
        """The files of each frame by the names of their blocks, by time [s]."""
        index = self.folder / "results.pvd"
        files: dict[float, dict[str, Path]] = {}
        for part in ElementTree.fromstring(index.read_text(encoding="utf-8")).iter("DataSet"):
            files.setdefault(float(part.attrib["timestep"]), {})[part.attrib["name"]] = (
                self.folder / part.attrib["file"]
            )
        return files

    @property
    def times(self) -> list[float]:
        """The times of the frames [s]."""
        return sorted(self._files) if (self.folder / "results.pvd").is_file() else []

    def frame(self, number: int = -1) -> "pv.MultiBlock":
        """Return a frame by its number, the last unless given: the blocks "organ" (without one: none), "thread" and
        "piercings", the units of the arrays of each in ``user_dict["units"]``. The organ's points are those of the
        reference shape: ``frame["organ"].warp_by_vector("displacement")``. Raises `IndexError`.
        """
        import pyvista as pv

        blocks = pv.MultiBlock()
        for name, path in self._files[self.times[number]].items():
            block: Any = pv.read(path)
            block.user_dict["units"] = {
                column.name: column.unit for column in BLOCKS[name] if column.name in block.array_names
            }
            blocks[name] = block
        return blocks


def parted(heading: str) -> tuple[str, str]:
    """Return the name and the unit of a column, whose unit is empty where it has none."""
    name, _, unit = heading.partition(" [")
    return name, unit.removesuffix("]")


def open_run(folder: Path | str) -> OpenRun:
    """Open the folder of a run, ended or not. Raises `ScenarioError` for one that holds none."""
    if not holds_run(Path(folder)):
        raise ScenarioError(f"{folder} holds no run; give the folder that `suture run` wrote")
    return OpenRun(Path(folder))
