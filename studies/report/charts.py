"""What a report draws over time: the tables of runs as series, and which of them a chart shows."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.arrays import Array
from studies.output.reading import RunResults, Table

MOST_ROWS = 1000  # of a series: more are finer than a screen
SHOWN = {"m": (1e3, "mm"), "Pa": (1e-3, "kPa"), "J": (1e3, "mJ")}  # SI units that read better by another name
PER_PIERCING = "piercings"  # the table with rows for each of them
CHARTS = (  # title, and the columns that it shows
    ("Tension of the thread at each hole", (("piercings", "tension_before"), ("piercings", "tension_after"))),
    ("Thread drawn through each hole", (("piercings", "slip"),)),
    ("Force of each hole on the thread", (("piercings", "force"),)),
    ("Smallest gap between the lips", (("contact", "smallest_gap"),)),
    ("Force of the holders on the thread", (("steps", "start_reaction"), ("steps", "end_reaction"))),
    ("Energy", (("energy", "kinetic"), ("energy", "elastic_thread"), ("energy", "elastic_tissue"))),
)
LOOSE = ("time", "step")  # columns that are no quantity of their own
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Series:
    """A quantity of a run over time, each shape `(n,)`; `piercing` is empty for one of the whole run."""

    run: str
    table: str
    column: str
    piercing: str
    unit: str
    time: Array  # [s]
    values: Array

    @property
    def label(self) -> str:
        """What a legend calls the quantity, without the run."""
        return f"{self.piercing}: {self.column}" if self.piercing else self.column

    @property
    def key(self) -> str:
        """What the quantity is called among all of a report, without the run."""
        return f"{self.table}: {self.label}"

    def record(self) -> dict[str, Any]:
        """Return the series as the page reads it."""
        return {
            "run": self.run, "key": self.key, "label": self.label, "unit": self.unit,
            "x": plain(self.time), "y": plain(self.values),
        }  # fmt: skip


def series_of(run: RunResults, name: str) -> list[Series]:
    """Return every quantity of a run's tables that has a row for every step, and the length of every vector."""
    return [
        one
        for table, whole in run.tables.items()
        if table != "events"
        for piercing, rows in parts_of(table, whole, run.piercings)
        for one in quantities(name, table, piercing, rows)
    ]


def parts_of(name: str, table: Table, piercings: Sequence[str]) -> list[tuple[str, Table]]:
    """Return the rows of a table piercing by piercing, where it has them so."""
    if name != PER_PIERCING:
        return [("", table)]
    return [(piercing, table.where("piercing", piercing)) for piercing in piercings]


def quantities(run: str, table: str, piercing: str, rows: Table) -> Iterator[Series]:
    """Yield the quantities of a table's rows, thinned out and in the units of the charts."""
    chosen = thinned(len(rows.columns["time"]))
    time = rows.columns["time"][chosen]
    for name, unit, values in [*plain_columns(rows), *lengths(rows)]:
        factor, shown = SHOWN.get(unit, (1.0, unit))
        yield Series(run, table, name, piercing, shown, time, factor * values[chosen])


def plain_columns(rows: Table) -> list[tuple[str, str, Array]]:
    """Return the columns of numbers with unit and values."""
    return [(name, rows.units.get(name, ""), rows.columns[name]) for name in rows.numeric if name not in LOOSE]


def lengths(rows: Table) -> list[tuple[str, str, Array]]:
    """Return the length of every vector that stands in three columns, but for a place and a unit vector."""
    names = [name.removesuffix("_x") for name in rows.numeric if name.endswith("_x")]
    return [
        (name, rows.units[f"{name}_x"], np.linalg.norm([rows.columns[f"{name}_{axis}"] for axis in AXES], axis=0))
        for name in names
        if rows.units.get(f"{name}_x") != "-"
    ]


def thinned(rows: int) -> NDArray[np.int64]:
    """Choose at most `MOST_ROWS` rows, evenly, the first and the last among them."""
    if rows <= MOST_ROWS:
        return np.arange(rows, dtype=np.int64)
    return np.unique(np.linspace(0, rows - 1, MOST_ROWS).round().astype(np.int64))


def plain(values: Array) -> list[float | None]:
    """Return numbers of six digits for JSON, None for what is not finite."""
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values.tolist()]


def chart_records(series: Iterable[Series]) -> list[dict[str, Any]]:
    """Return the charts that have something to show, each with the keys of what it shows."""
    told = list(series)
    charts = []
    for title, columns in CHARTS:
        shown = [one for one in told if (one.table, one.column) in columns]
        if shown:
            keys = list(dict.fromkeys(one.key for one in shown))
            charts.append({"title": title, "unit": shown[0].unit, "keys": keys})
    return charts
