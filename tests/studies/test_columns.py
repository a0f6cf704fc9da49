"""The quantities of a results folder: each is named once, with a unit and a meaning, and every output follows."""

import csv
import io
import json
import re
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from coupling.reports.audit import Energies
from coupling.reports.observation import PiercingObservation
from coupling.run.events import Event
from coupling.run.tying import TieObservation
from studies.manual import with_blocks
from studies.output.columns import (
    CONTACT,
    ENERGY,
    GAP_PROFILE,
    HOLE_RANGE,
    HOLE_SUMMARY,
    MANUAL,
    ORGAN_ARRAYS,
    ORGAN_CELLS,
    PIERCING_ARRAYS,
    RANGE,
    RUN,
    STATE_CODES,
    TABLES,
    THREAD_ARRAYS,
    Column,
    Layout,
    headings,
    manual_tables,
    quantities,
    state_summary,
    values,
)
from studies.output.fields import ThreadRecord
from studies.output.files import write_json
from studies.output.records import (
    LoadRecord,
    StepRecord,
    StitchRecord,
    TractRecord,
)
from studies.output.tables import CsvFile
from tests.studies.samples import contact, frame, step

UNITS = {"-", "s", "m", "m/s", "1/m", "rad", "N", "N m", "N/m", "N s", "J", "Pa", "m²", "m³"}
PARTS = ("organ", "thread", "piercings")
GROUPS: dict[str, Sequence[Column[Any]]] = {
    **{layout.name: layout.columns for layout in TABLES},
    **dict(zip(PARTS, (ORGAN_ARRAYS, THREAD_ARRAYS, PIERCING_ARRAYS), strict=True)),
    "summary": RUN,
    "range": RANGE,
    "range of a piercing": HOLE_RANGE,
    "cells": ORGAN_CELLS,
    "gap profile": GAP_PROFILE,
}
BEGINS = Event(0.1, "begins", 'a "b", c', 0.02, 1e-4, 0.1, 2e-6, 1e-6, (0.0, 1 / 3, -0.0))
STITCHED = StitchRecord(stitch="knot", pair="a - b", left_force=1 / 3, right_force=0.25, load_share=None)
ONE_ROW = ("contact", "stitches", "ties", "tracts")
FULL = replace(
    step(1),
    events=(BEGINS, Event(0.05, "halved"), Event(0.1, "cut", control_points=31)),
    ties=(TieObservation("knot", 0.01, 0.03, 0.02, 1.0, np.ones(3), 0.0, 1e-3, "tied"),),
    loads=(
        LoadRecord(boundary="top", share=0.5, area=1e-4, force=np.array([0.0, 1 / 3, -1.0])),
        LoadRecord(boundary="left", share=1.0, area=2e-4, force=np.ones(3)),
    ),
    contact=(contact("a - b", -0.0, 1 / 3, (STITCHED,)),),
    tracts=(TractRecord("a-b", tuple(replace(hole, tract="a-b", bearing=1e-3) for hole in step(1).piercings)),),
    torques=(1e-6, -2e-6),
)


@pytest.mark.parametrize("group", GROUPS)
def test_columns_have_known_units_and_names_of_their_own(group: str) -> None:
    """Independent check: numbers have a unit of the list or "-", text has none; no heading stands twice."""
    columns = GROUPS[group]
    for column in columns:
        assert column.unit in UNITS if column.kind != "text" else column.unit == ""
        assert column.meaning and "|" not in column.meaning and "\n" not in column.meaning
        assert all(re.fullmatch(r"[a-z]+(_[a-z]+)*", name) for name in (column.name, *column.parts))
    for names in ([column.name for column in columns], headings(columns)):
        assert len(set(names)) == len(names)


@pytest.mark.parametrize("layout", TABLES, ids=lambda layout: layout.name)
def test_a_row_has_a_cell_for_every_heading(tmp_path: Path, layout: Layout[Any]) -> None:
    """Independent check: a csv reader finds as many cells in each row as headings, in steps with everything and in
    steps with nothing, and the second of them is the number of the step."""
    table = CsvFile(tmp_path / "table.csv", layout.columns)
    for record in (replace(step(0), piercings=()), step(0), FULL):
        table.append(layout.rows(record))
    table.close()
    head, *rows = csv.reader(io.StringIO((tmp_path / "table.csv").read_text()))
    assert head == headings(layout.columns)
    assert head[:2] == ["time [s]", "step [-]"]
    expected = {"piercings": [0, 0, 1, 1], "events": [1, 1, 1], "loads": [1, 1]} | {key: [1] for key in ONE_ROW}
    assert [int(row[1]) for row in rows] == expected.get(layout.name, [0, 0, 1])
    assert {len(row) for row in rows} == {len(head)}


def test_cells_are_what_the_records_say(tmp_path: Path) -> None:
    """Independent check: every number reads back to the same bits, text as it was, and what is not there is empty."""
    cells = {}
    for layout in TABLES:
        table = CsvFile(tmp_path / f"{layout.name}.csv", layout.columns)
        table.append(layout.rows(FULL))
        table.close()
        with (tmp_path / f"{layout.name}.csv").open(newline="") as file:
            cells[layout.name] = list(csv.DictReader(file))
    begins, halved, knots = cells["events"]
    assert (begins["piercing"], begins["control_points [-]"]) == (BEGINS.piercing, "")
    assert [begins[f"impulse_{axis} [N s]"] for axis in "xyz"] == ["0.0", repr(1 / 3), "-0.0"]
    assert (float(begins["time [s]"]), float(begins["energy [J]"])) == (0.1, 2e-6 - 1e-6)
    assert (halved["time [s]"], halved["s [m]"], halved["step [-]"]) == ("0.05", "nan", "1")
    assert knots["control_points [-]"] == "31"
    entry, steps, lips = cells["piercings"][0], cells["steps"][0], cells["contact"][0]
    hole = FULL.piercings[0]
    assert [float(entry[f"tangent_{axis} [-]"]) for axis in "xyz"] == hole.tangent.tolist()
    assert (entry["piercing"], entry["state"], entry["slip [m]"]) == ("entry", "slip", repr(hole.slip))
    assert (steps["start_torque [N m]"], steps["end_torque [N m]"]) == ("1e-06", "-2e-06")
    assert (steps["newton_iterations [-]"], steps["end_reaction_z [N]"]) == ("3", "0.1")
    assert (lips["pairs [-]"], lips["smallest_gap [m]"], lips["force [N]"]) == ("6", "-0.0", repr(1 / 3))


@pytest.mark.parametrize(
    ("columns", "record", "elsewhere"),
    [
        (ENERGY, Energies, {"loan"}),
        (PIERCING_ARRAYS, PiercingObservation, {"name", "x", "channel", "tract", "bearing"}),
        (HOLE_SUMMARY, PiercingObservation, {"name", "u", "v", "tract", "bearing"}),
        (THREAD_ARRAYS, ThreadRecord, {"points", "pieces"}),
    ],
)
def test_no_field_of_a_record_is_forgotten(columns: Sequence[Column[Any]], record: Any, elsewhere: set[str]) -> None:
    """Independent check: the fields of a record, but for those that are written in another way, each have a column."""
    assert {column.name for column in columns} == {field.name for field in fields(record)} - elsewhere


def test_each_column_takes_its_own_field() -> None:
    """Independent check: a column gives the field of its name, whichever record it is asked for."""
    hole, energy, thread = FULL.piercings[0], Energies(*np.arange(8.0)), frame(0.3).thread
    for columns, record in ((HOLE_SUMMARY, hole), (ENERGY, energy), (CONTACT, FULL.contact[0])):
        for name, value in values(columns, record).items():
            assert value is getattr(record, name)
    codes = {state: values(PIERCING_ARRAYS, replace(hole, state=state))["state"] for state in STATE_CODES}
    assert codes == STATE_CODES
    arrays = values(THREAD_ARRAYS, thread)
    assert all(arrays[name] is getattr(thread, name) for name in ("s", "tension", "curvature", "torque"))
    assert np.array_equal(np.asarray(arrays["radius"]), np.full(len(thread.points), thread.radius))


def summary(record: StepRecord, folder: Path) -> dict[str, Any]:
    """The summary of a run that ended with a step, as it reads back."""
    totals = {"newton_iterations": 12, "constraint_max": 1e-6, "seconds": 2.0, "tissue_dofs": 100}
    run = SimpleNamespace(status="completed", error="", time=record.time, steps=record.step, **totals)
    write_json(folder / "summary.json", values(RUN, run) | state_summary(record))
    found: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return found


def test_each_number_of_a_summary_has_a_unit(tmp_path: Path) -> None:
    """Independent check: the last step of a run with every table gives no number without its unit."""
    found = quantities(summary(FULL, tmp_path)).values()
    numbers = [one for one in found if isinstance(one.value, float)]
    assert {one.name.partition(".")[0] for one in numbers} >= {"thread", "piercings", "contact", "ties", "tracts"}
    assert [one.name for one in numbers if not one.unit] == []


def test_the_summary_has_the_names_users_rely_on(tmp_path: Path) -> None:
    """Independent check: names that scripts of users read stay; vectors are lists of three."""
    found = summary(FULL, tmp_path)
    run = {"status", "error", "time", "steps", "newton_iterations", "constraint_max", "seconds_per_step", "tissue_dofs"}
    assert found.keys() >= run | {"energy", "thread", "piercings", "contact"}
    assert found["energy"].keys() >= {
        *("kinetic", "elastic_thread", "elastic_tissue", "external_work", "friction_dissipation"),
        *("viscous_dissipation", "numerical_dissipation", "balance_error"),
    }
    assert found["thread"].keys() >= {"start", "end", "max_strain"}
    assert found["thread"]["end"] == {"reaction": [0.0, 0.0, 0.1], "torque": -2e-6}
    entry = found["piercings"]["entry"]
    assert entry.keys() >= {
        *("s", "slip", "x", "displacement", "force", "normal_force", "tangential_force", "couple"),
        *("tension_before", "tension_after", "state", "tangent"),
    }
    assert all(len(entry[name]) == 3 for name in ("x", "displacement", "force", "couple", "tangent"))
    assert found["contact"]["a - b"]["stitches"] == {
        "knot": {"left_force": 1 / 3, "right_force": 0.25, "load_share": None}
    }
    assert (found["seconds_per_step"], found["contact"]["a - b"]["pressed"]) == (2.0, 2)


def test_the_summary_is_silent_of_what_is_not_there(tmp_path: Path) -> None:
    """Independent check: no torque without twist, no lips without contact, no pace before the first step."""
    found = summary(step(0), tmp_path)
    assert found["thread"]["start"].keys() == {"reaction"}
    assert "contact" not in found
    assert found["seconds_per_step"] is None


def test_the_manual_has_the_columns_of_today() -> None:
    """Independent check: each table of the manual stands in it between its marks, as the columns make it."""
    manual, tables = MANUAL.read_text(encoding="utf-8"), manual_tables()
    assert re.findall(r"<!-- columns of (\S+) -->", manual) == list(tables)
    assert with_blocks(manual, "columns of", tables) == manual, (
        "the tables are of other columns: run python -m studies.output.columns"
    )
    for name, table in tables.items():
        assert f"<!-- columns of {name} -->\n{table}<!-- end -->" in manual
    assert with_blocks(manual, "columns of", tables | {"thread": "none\n"}) == manual.replace(
        tables["thread"], "none\n"
    )
