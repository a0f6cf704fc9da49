"""The quantities of a results folder, each defined once: name, unit, meaning and source.

A `Column` gives the heading of a CSV table, the name of an array in a frame, a key of
``summary.json`` and a line of the manual. ``python -m studies.output.columns`` updates those lines
of the manual. To add a quantity, add a line with its name, unit and meaning to
``columns.toml``, and its field to a record of ``studies.output.records`` that is not made from it.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from studies.manual import with_blocks
from studies.output import remarks
from studies.output.records import APART, LIST, Extremes, StepRecord
from studies.scenario import Scenario

Row = TypeVar("Row")
Value = float | int | str | Sequence[float] | NDArray[np.float64] | None

STATE_CODES = {"stick": 0, "slip": 1, "anchored": 2, "left": 3}  # of `state` in the frames, which cannot hold text
TIE_CODES = {"open": 0, "drawn": 1, "tied": 2, "slips": 3, "held": 4}  # codes of the `state` of a tie in the frames
KINDS = {"whole": "-", "text": ""}  # units of the kinds that the list names in place of a unit
MANUAL = Path(__file__).with_name("README.md")


@dataclass(frozen=True)
class Column(Generic[Row]):
    """A quantity of a table, a frame or the summary.

    It has a `name` (lower_snake_case), a `unit` ("-" for a number without unit, empty for text),
    and a `meaning` for the manual. `source` is a function that returns the value of a row's record,
    or None for the field `name`. `kind` is "number", "whole" or "text". `parts` are the names of a
    vector's components in a table; none for a scalar.
    """

    name: str
    unit: str
    meaning: str
    source: Callable[[Row], Value] | None = None
    kind: str = "number"
    parts: tuple[str, ...] = ()

    def of(self, record: Row) -> Value:
        """Return the value of a row's record."""
        return getattr(record, self.name) if self.source is None else self.source(record)

    @property
    def headings(self) -> list[str]:
        """Headings in a CSV table, with the unit: `force_x [N]`."""
        return [headed(name, self.unit) for name in self.parts or (self.name,)]


def headed(name: str, unit: str) -> str:
    """Return the heading of a column, with its unit in brackets if there is one."""
    return f"{name} [{unit}]" if unit else name


def columns_of(group: str, **sources: Callable[[Any], Value]) -> list[Column[Any]]:
    """Return the columns of a group of the list.

    `sources` are the functions for values that are not a field of the same name.
    """
    return [column_of(name, entry, sources.get(name)) for name, entry in LIST[group].items()]


def column_of(name: str, entry: Sequence[Any], source: Callable[[Any], Value] | None) -> Column[Any]:
    """Return the column of an entry of the list: its unit, its meaning and its parts, if any."""
    unit, meaning, parts = [*entry, ()][:3]
    kind = unit if unit in KINDS else "number"
    named = (f"{name}_{axis}" for axis in parts) if parts == "xyz" else parts
    return Column(name, KINDS.get(unit, unit), meaning.format(**NUMBERS), source, kind, tuple(named))


def coded(codes: Mapping[str, int]) -> str:
    """Return the codes of words as text for the manual."""
    return ", ".join(f"{code} {word}" for word, code in codes.items())


def headings(columns: Iterable[Column[Any]]) -> list[str]:
    """Return the headings of a CSV table."""
    return [heading for column in columns for heading in column.headings]


def values(columns: Iterable[Column[Row]], record: Row) -> dict[str, Value]:
    """Return the quantities of a record by name."""
    return {column.name: column.of(record) for column in columns}


# -- the quantities --------------------------------------------------------------------------------------------------


NUMBERS = {"APART": APART, "STATE_CODES": coded(STATE_CODES), "TIE_CODES": coded(TIE_CODES)} | remarks.BOUNDS

TIME, STEP = columns_of("step")
NAME, *HOLE = columns_of("hole", piercing=lambda hole: hole.name)
CHANNEL, MOVED = columns_of("place")
HOLE_SUMMARY = (*HOLE, CHANNEL)
ACCURACY = columns_of("accuracy")
HOLE_ARRAYS = columns_of("hole_arrays", state=lambda hole: STATE_CODES[hole.state])
PIERCING_ARRAYS = (*(column for column in HOLE if column.name not in ("x", "state")), *HOLE_ARRAYS)
EVENT_TIME, *EVENT = columns_of(
    "event", event=lambda event: event.kind, control_points=lambda event: event.control_points or None
)
ENERGY = columns_of("energy")
SOLVED = columns_of(
    "solved",
    start_torque=lambda step: step.torques and step.torques[0],
    end_torque=lambda step: step.torques and step.torques[1],
)
MAX_STRAIN = next(column for column in SOLVED if column.name == "max_strain")
THREAD = (MAX_STRAIN, *columns_of("spans"))
STRANDS = columns_of("strands")
(GROWS,) = columns_of("growth", grows_within=lambda growth: growth)
PAIR, *CONTACT = columns_of("contact")
STITCH_NAME, STITCH_PAIR, *STITCH = columns_of("stitch")
GAP_PROFILE = columns_of("gap_profile")
TRACT_NAME, *TRACT = columns_of(
    "tract",
    balls=lambda tract: len(tract.balls),
    length=lambda tract: sum(ball.bearing or 0.0 for ball in tract.balls),
    force=lambda tract: np.sum([ball.force for ball in tract.balls], axis=0),
    normal_force=lambda tract: sum(ball.normal_force for ball in tract.balls),
    friction=lambda tract: sum(ball.tangential_force for ball in tract.balls),
    bearing=lambda tract: max(ball.normal_force / (ball.bearing or np.inf) for ball in tract.balls),
    bearing_pressure=lambda tract: max(ball.bearing_pressure for ball in tract.balls),
    displacement=lambda tract: max(float(norm(ball.displacement)) for ball in tract.balls),
    tension_before=lambda tract: tract.balls[0].tension_before,
    tension_after=lambda tract: tract.balls[-1].tension_after,
    slipping=lambda tract: sum(ball.state == "slip" for ball in tract.balls),
)
LOAD = columns_of("load")
TIE_NAME, *TIE = columns_of("tie", tie=lambda tie: tie.name)
TIE_ARRAYS = (*columns_of("tie_arrays", state=lambda tie: TIE_CODES[tie.state]), *TIE[1:-1])  # but state and place
ORGAN_ARRAYS, ORGAN_CELLS = columns_of("organ_arrays"), columns_of("organ_cells")
THREAD_ARRAYS = columns_of("thread_arrays", radius=lambda thread: np.full(len(thread.points), thread.radius))
ARRAYS: tuple[Column[Any], ...] = (*ORGAN_ARRAYS, *ORGAN_CELLS, *THREAD_ARRAYS, *PIERCING_ARRAYS, *TIE_ARRAYS)
UNITS = {column.name: column.unit for column in ARRAYS}  # of the arrays of a frame

RANGE = columns_of(
    "range",
    largest_strain=lambda met: met.strain,
    largest_rotation=lambda met: met.rotation,
    strained_share=lambda met: met.share(met.strained),
    rotated_share=lambda met: met.share(met.rotated),
)
HOLE_RANGE = columns_of("hole_range")
KRYLOV = columns_of("krylov")
RUN = columns_of("run", seconds_per_step=lambda run: run.seconds / run.steps if run.steps else None)


# -- the tables ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Layout(Generic[Row]):
    """The layout of a table: its columns and `rows`, a function that returns the rows of a step.

    The second column is the step. `every_step`: whether each step has exactly one row.
    """

    name: str
    columns: tuple[Column[Row], ...]
    rows: Callable[[StepRecord], Iterable[Row]]
    every_step: bool = True


def of_pair(place: int, column: Column[Any]) -> Column[Any]:
    """Return the column of a pair that takes its value from one of the two.

    The pair is a step and an item of the step.
    """
    return replace(column, source=lambda pair: column.of(pair[place]))


AT_STEP = of_pair(0, TIME)


def listed(
    name: str, columns: Iterable[Column[Any]], items: Callable[[StepRecord], Iterable[Any]], time: Column[Any] = AT_STEP
) -> Layout[tuple[StepRecord, Any]]:
    """Return the layout of a table with a row for each item of a step."""
    whole = (time, of_pair(0, STEP), *(of_pair(1, column) for column in columns))
    return Layout(name, whole, lambda step: [(step, item) for item in items(step)], every_step=False)


PIERCINGS = listed("piercings", (NAME, *HOLE), lambda step: step.piercings)
EVENTS = listed("events", EVENT, lambda step: step.events, of_pair(1, EVENT_TIME))
ENERGIES = replace(listed("energy", ENERGY, lambda step: [step.energy]), every_step=True)
STEPS: Layout[StepRecord] = Layout("steps", (TIME, STEP, *SOLVED), lambda step: [step])
CONTACTS = listed("contact", (PAIR, *CONTACT), lambda step: step.contact)
LOADS = listed("loads", LOAD, lambda step: step.loads)
TRACTS = listed("tracts", (TRACT_NAME, *TRACT), lambda step: step.tracts)
TIES = listed("ties", (TIE_NAME, *TIE), lambda step: step.ties)
STITCHES = listed(
    "stitches",
    (STITCH_NAME, STITCH_PAIR, *STITCH),
    lambda step: [stitch for pair in step.contact for stitch in pair.stitches],
)
# The order of writing: if a table with one row per step has a step, the tables before it have this
# step too.
TABLES: tuple[Layout[Any], ...] = (PIERCINGS, EVENTS, LOADS, TRACTS, ENERGIES, STEPS, CONTACTS, STITCHES, TIES)


# -- the summary -----------------------------------------------------------------------------------------------------


def state_summary(step: StepRecord, scenario: Scenario | None = None) -> dict[str, Any]:
    """Return energy, thread, piercings, contact and ties of a step for ``summary.json``.

    The `scenario` gives the distances of holes moved to the surface, and how loads grow.
    """
    holes, growth = (scenario.piercing, scenario.growth) if scenario else ((), {})
    moved = {hole.name: values((MOVED,), hole) for hole in holes if hole.moved is not None}
    grown = {key.removeprefix("thread."): values((GROWS,), time) for key, time in growth.items()}
    ends = {end: _end_summary(end, step) | grown.get(end, {}) for end in ENDS}
    strands = {} if step.strands is None else {"contact": values(STRANDS, step.strands)}
    parts: dict[str, Any] = {
        "energy": values(ENERGY, step.energy),
        "thread": ends | values(THREAD, step) | strands,
        "piercings": {hole.name: values(HOLE_SUMMARY, hole) | moved.get(hole.name, {}) for hole in step.piercings},
        "contact": {
            pair.pair: {**values(CONTACT, pair), "stitches": {one.stitch: values(STITCH, one) for one in pair.stitches}}
            for pair in step.contact
        },
        "ties": {tie.name: values(TIE, tie) for tie in step.ties},
        "loads": [values(LOAD, load) for load in step.loads],
        "tracts": {tract.tract: values(TRACT, tract) for tract in step.tracts},
    }
    return {key: value for key, value in parts.items() if value or key == "piercings"}


def range_summary(names: Iterable[str], extremes: Extremes) -> dict[str, Any]:
    """Return the largest strains and rotations of the tissue for ``summary.json``."""
    holes = {
        name: {column.name: float(getattr(extremes, column.name)[k]) for column in HOLE_RANGE}
        for k, name in enumerate(names)
    }
    return {**values(RANGE, extremes), "piercings": holes}


def of_end(end: str, column: Column[Any]) -> Column[Any]:
    """Return a column of an end of the thread by the name that the summary gives it."""
    name, *parts = (each.removeprefix(f"{end}_") for each in (column.name, *column.parts))
    return replace(column, name=name, parts=tuple(parts), source=column.of)


ENDS = {
    end: [of_end(end, column) for column in SOLVED if column.name.startswith(f"{end}_")] for end in ("start", "end")
}
ANY = "*"  # for the name of a piercing, a pair, a tie …
SUMMARY: dict[tuple[str, ...], Sequence[Column[Any]]] = {  # by the place in ``summary.json``
    (): RUN,
    ("energy",): ENERGY,
    **{("thread", end): (*columns, GROWS) for end, columns in ENDS.items()},
    ("thread",): THREAD,
    ("thread", "contact"): STRANDS,
    ("piercings", ANY): (*HOLE_SUMMARY, MOVED, *ACCURACY),
    ("contact", ANY): CONTACT,
    ("contact", ANY, "stitches", ANY): STITCH,
    ("ties", ANY): TIE,
    ("tracts", ANY): TRACT,
    ("loads", ANY): LOAD,
    ("range",): RANGE,
    ("range", "piercings", ANY): HOLE_RANGE,
    ("krylov",): KRYLOV,
}


def _end_summary(end: str, step: StepRecord) -> dict[str, Value]:
    """Return the reaction at an end of the thread from a step, and the torque if there is one."""
    return {name: value for name, value in values(ENDS[end], step).items() if value is not None}


# -- the quantities of the summary, by their dotted names -------------------------------------------------------------


LEFT_OUT = ("seconds_per_step", "provenance", "mesh", "remarks")  # wall-clock time, origin, and a list of sentences


@dataclass(frozen=True)
class Quantity:
    """A number, a word or None, with its `unit`.

    The unit is "-" for a number without unit, and empty for a word.
    """

    name: str
    unit: str
    value: float | int | str | bool | None


def quantities(summary: Mapping[str, Any]) -> dict[str, Quantity]:
    """Return all numbers and words of a summary by name, in its order."""
    kept = {key: value for key, value in summary.items() if key not in LEFT_OUT}
    return {found.name: found for found in leaves(kept, ())}


def leaves(table: Any, place: tuple[str, ...]) -> Iterator[Quantity]:
    """Yield the numbers and words below a place in a summary."""
    if isinstance(table, list | tuple) and any(isinstance(item, Mapping) for item in table):
        table = dict(enumerate(table))
    if isinstance(table, Mapping):
        for key, value in table.items():
            yield from leaves(value, (*place, str(key)))
        return
    column = column_at(place)
    unit = column.unit if column else ""
    if isinstance(table, Sequence) and not isinstance(table, str):
        parts = column.parts if column and column.parts else [f"{place[-1]}_{k}" for k in range(len(table))]
        for part, value in zip(parts, table, strict=False):
            yield Quantity(".".join([*place[:-1], part]), unit, value)
    else:
        yield Quantity(".".join(place), unit, table)


def column_at(place: tuple[str, ...]) -> Column[Any] | None:
    """Return the column of a summary's key, None if the key has no column."""
    for above, columns in SUMMARY.items():
        fits = len(above) + 1 == len(place) and all(a in (ANY, b) for a, b in zip(above, place, strict=False))
        found = next((column for column in columns if fits and column.name == place[-1]), None)
        if found is not None:
            return found
    return None


# -- the manual ------------------------------------------------------------------------------------------------------


def markdown(columns: Iterable[Column[Any]], what: str) -> str:
    """Return a list of columns in Markdown.

    `what` is "column" for components by name, or "array" or "key" for whole vectors.
    """
    lines = []
    for column in columns:
        names = _in_short(column.parts) if what == "column" and column.parts else column.name
        unit = f" [{column.unit}]" if column.unit else ""
        lines.append(f"- `{names}`{unit}: {column.meaning}")
    return "\n".join(["", *lines, "", ""])


def _in_short(parts: tuple[str, ...]) -> str:
    """Return the names of components in short, as ``force_x/y/z``."""
    return "/".join((parts[0], *(part.rpartition("_")[2] for part in parts[1:])))


def manual_tables() -> dict[str, str]:
    """Return the tables of the manual by the name of their file."""
    tables = {*HOLE, *ENERGY, *CONTACT, *STITCH, *TIE, *LOAD, *TRACT}  # these have their own table
    keys = [
        replace(column, name=".".join(["NAME" if part == ANY else part for part in place] + [column.name]))
        for place, columns in SUMMARY.items()
        for column in columns
        if column not in tables
    ]
    return {
        "summary.json": markdown(keys, "key"),
        "remarks": remarks.markdown(),
        **{f"{layout.name}.csv": markdown(layout.columns[2:], "column") for layout in TABLES},
        "gap_profile.csv": markdown(GAP_PROFILE, "column"),
        "organ": markdown(ORGAN_ARRAYS, "array"),
        "organ_cells": markdown(ORGAN_CELLS, "array"),
        "thread": markdown(THREAD_ARRAYS, "array"),
        "piercings": markdown(HOLE_ARRAYS, "array"),
        "ties": markdown(TIE_ARRAYS[:1], "array"),
    }


if __name__ == "__main__":
    updated = with_blocks(MANUAL.read_text(encoding="utf-8"), "columns of", manual_tables())
    MANUAL.write_text(updated, encoding="utf-8")
