"""Charts of a report over time: the tables of runs as series, and the series of each chart."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from studies.arrays import Array
from studies.lists import list_of
from studies.output.reading import OpenRun, Table, evenly_spaced

MOST_ROWS = 1000  # of a series: more points than a screen can show
SHOWN = {"m": (1e3, "mm"), "Pa": (1e-3, "kPa"), "J": (1e3, "mJ")}  # SI units that are easier to read in another unit
FIRST = 3  # number of charts next to the result
UNENDED, SUMMARY, CHARTS = (list_of(__file__, "charts.toml")[key] for key in ("unended", "summary", "chart"))
CLOCKS = ("time", "step")  # columns that are not quantities
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Series:
    """A quantity of a run over time, each shape `(n,)`.

    `item` is its piercing, pair of surfaces or boundary; empty for a quantity of the whole run.
    """

    run: str
    table: str
    column: str
    item: str
    unit: str
    time: Array  # [s]
    values: Array

    @property
    def name(self) -> str:
        """Name of the quantity for `suture plot`, like `piercings.exit.slip`."""
        return ".".join(filter(None, (self.table, self.item, self.column)))

    @property
    def label(self) -> str:
        """Name of the quantity in a legend, without the run."""
        return f"{self.item}: {self.column}" if self.item else self.column

    @property
    def key(self) -> str:
        """Unique name of the quantity in a report, without the run."""
        return f"{self.table}: {self.label}"

    def record(self) -> dict[str, Any]:
        """Return the series for the script of the page."""
        return {
            "run": self.run, "key": self.key, "label": self.label, "unit": self.unit,
            "x": plain(self.time), "y": plain(self.values),
        }  # fmt: skip


def series_of(run: OpenRun, name: str, most: int | None = MOST_ROWS) -> list[Series]:
    """Return every quantity of a run's tables with one row per step, except its events.

    The length of every vector is included. A series has at most `most` points; None means all.
    """
    parts = [(table, *part) for table in run.tables if table != "events" for part in run.parts(table).items()]
    return [one for part in parts for one in quantities(name, *part, most)]


def quantities(run: str, table: str, item: str, rows: Table, most: int | None) -> Iterator[Series]:
    """Yield the quantities of a table's rows, with fewer points and in the units of the charts."""
    count = len(rows.columns["time"])
    chosen = evenly_spaced(count, most or count)
    scalars = [(name, rows.units.get(name, ""), rows.columns[name]) for name in rows.numeric if name not in CLOCKS]
    time = rows.columns["time"][chosen]
    for name, unit, values in [*scalars, *lengths(rows)]:
        factor, shown = SHOWN.get(unit, (1.0, unit))
        yield Series(run, table, name, item, shown, time, factor * values[chosen])


def lengths(rows: Table) -> list[tuple[str, str, Array]]:
    """Return the length of every vector in three columns, except places and unit vectors."""
    names = [name[:-2] for name in rows.numeric if {f"{name[:-2]}_{axis}" for axis in AXES} <= set(rows.numeric)]
    return [
        (name, unit, np.linalg.norm([rows.columns[f"{name}_{axis}"] for axis in AXES], axis=0))
        for name in dict.fromkeys(names)
        if (unit := rows.units.get(f"{name}_x", "")) != "-"
    ]


def plain(values: Array) -> list[float | None]:
    """Return numbers with six digits for JSON, None for numbers that are not finite."""
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values.tolist()]


def chart_records(series: Iterable[Series]) -> list[dict[str, Any]]:
    """Return the charts with data, each with the keys of its series."""
    every = list(series)
    charts = []
    for chart in CHARTS:
        shown = [one for one in every if f"{one.table}.{one.column}" in chart["columns"]]
        if shown:
            keys = list(dict.fromkeys(one.key for one in shown))
            charts.append({"title": chart["title"], "unit": shown[0].unit, "keys": keys})
    return charts
