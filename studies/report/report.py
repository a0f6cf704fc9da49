"""``suture report``: runs, studies and sweeps in one HTML page that needs no network."""

import base64
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from studies.figure import COLOURS
from studies.output.columns import HOLE_SUMMARY, headed
from studies.output.files import as_json, read_json, unfinished, write_text
from studies.output.manifest import holds_run
from studies.output.reading import OpenRun, ResultsError, Table, open_run, read_table
from studies.pictures.view import ARROW, MARKER, PRESSURE, TENSION, TISSUE
from studies.report import page
from studies.report.charts import FIRST, SHOWN, SUMMARY, UNENDED, chart_records, plain, series_of
from studies.report.space import BYTES, view_record
from studies.study import holds_study
from studies.sweeps.sweep import MARK, holds_sweep
from studies.sweeps.table import counted

ORIGIN = ("over", "base", "code", "preset", "arguments", "provenance")  # of a sweep or a study
MOST_ROWS = 200  # of a table; more rows are left out
HOLE_LINES = ("state", "slip", "force", "normal_force", "tangential_force", "tension_before", "tension_after")
LINES = [*COLOURS, "#444444", "#8a6d5c"]  # a chart over time has more lines than a figure
VIEW = {"tissue": TISSUE, "tension": TENSION, "pressure": PRESSURE, "marker": MARKER, "arrow": ARROW}  # colours
HOLE_UNITS = {column.name: column.unit for column in HOLE_SUMMARY}


@dataclass(frozen=True)
class Rows:
    """A study, a sweep or a refinement.

    It has its question, remarks, rows, figure in base64, and origin.
    """

    name: str
    question: str
    remarks: tuple[str, ...]
    table: Table
    shown: Table
    figure: str
    provenance: Mapping[str, Any]


def write_report(folders: Sequence[Path], path: Path) -> list[str]:
    """Write the report of folders into a page; return the lines for a person.

    Raises `ResultsError` for a folder without a run, a study or a sweep, and for a page with
    another suffix than HTML.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise ResultsError(f"--out {path} is refused: a report is an HTML page; name it {path.stem}.html")
    page.plotly_script()
    runs = [open_run(folder) for folder in folders if holds_run(folder)]
    others = [read_rows(folder) for folder in folders if not holds_run(folder)]
    names = labels([run.folder for run in runs])
    text = report_text(dict(zip(names, runs, strict=True)), others)
    path.parent.mkdir(parents=True, exist_ok=True)
    killed = (left for left in unfinished(path.parent, {path.name}) if not psutil.pid_exists(int(left.suffix[1:])))
    for left in killed:
        left.unlink(missing_ok=True)
    write_text(path, text)
    return [f"report     {path}, {len(text.encode()) / 1e6:.3g} MB; open it in a browser; it needs no network"]


def labels(folders: Sequence[Path]) -> list[str]:
    """Return names of runs: the shortest parts of their paths that differ."""
    whole = [folder.resolve() for folder in folders]
    counts = Counter(folder.name for folder in whole)
    return [folder.name if counts[folder.name] == 1 else "/".join(folder.parts[-2:]) for folder in whole]


def read_rows(folder: Path) -> Rows:
    """Read a study, a sweep or a refinement.

    Raises `ResultsError` for another or an unfinished folder.
    """
    swept = holds_sweep(folder) or holds_sweep(folder, "refinement")
    if not swept and not holds_study(folder):
        raise ResultsError(f"{folder} is refused: it holds no run, study or sweep; give a folder with one of them")
    if not (folder / "table.csv").is_file():
        raise ResultsError(f"{folder} is refused: it has no table.csv yet; wait until its command ends, or continue it")
    asked, shown = read_json(folder / (MARK if swept else "study.json")), read_table(folder / "table.csv")
    if swept:
        name, table, remarks = folder.resolve().name, shown, sweep_remarks(folder, shown)
        title = asked["title"] or "a scenario without a title"
        question = f"A {asked['kind']} of {title}: {counted(asked['cases'])}"
    else:
        name, table, remarks = str(asked["study"]), read_table(folder / "runs.csv"), asked.get("remarks", ())
        question = str(asked.get("question", ""))
    origin = {key: asked[key] for key in ORIGIN if key in asked}
    return Rows(name, question, tuple(map(str, remarks)), table, shown, drawn(folder / "figure.png"), origin)


def sweep_remarks(folder: Path, table: Table) -> list[str]:
    """Return the verdicts of a refinement, and the number of cases with unsupported numbers."""
    found = read_json(folder / "verdict.json").get("quantities", ())
    remarks = [f"{headed(one['quantity'], one['unit'])}: {one['verdict']}{estimated(one)}" for one in found]
    doubted = int(np.count_nonzero(table.columns["unsupported"]))
    if doubted:
        remarks.append(f"{counted(doubted)} with unsupported numbers: see the column remarks")
    return remarks


def estimated(one: Mapping[str, Any]) -> str:
    """Return the estimated error of the finest level in words.

    Empty if no accuracy is refined.
    """
    known = [error for error in one.get("estimates", ()) if error is not None]
    return f"; estimated error of the holes' compliance {100.0 * known[-1]:.2g} %" if known else ""


def drawn(figure: Path) -> str:
    """Return a figure in base64; empty if there is no such file."""
    return base64.b64encode(figure.read_bytes()).decode() if figure.is_file() else ""


def report_text(runs: Mapping[str, OpenRun], others: Sequence[Rows]) -> str:
    """Return the page of runs by name, and of studies and sweeps."""
    series = [one for name, run in runs.items() for one in series_of(run, name)]
    charts = chart_records(series)
    views = [view_record(run, name, BYTES / len(runs)) for name, run in runs.items() if run.frames]
    grids, colours = [grid_record(rows) for rows in others], {"lines": LINES} | VIEW
    data = {"series": [one.record() for one in series], "charts": charts, "views": views, "grids": grids}
    title = ", ".join([*runs, *(rows.name for rows in others)])
    body = [f"<h1>{page.escaped(title)}</h1>"]
    body += run_sections(runs, [chart["title"] for chart in charts], bool(views)) if runs else []
    body += [line for number, rows in enumerate(others) for line in rows_sections(rows, number)]
    return page.whole_page(title, body, data | {"colours": colours})


def run_sections(runs: Mapping[str, OpenRun], charts: Sequence[str], has_views: bool) -> Iterator[str]:
    """Yield the sections of a report on runs, in order: the result first, notes below."""
    places = [page.chart(f"chart{k}") for k in range(len(charts))]
    yield page.heading("Result")
    for name, run in runs.items():
        yield f"<h3>{page.escaped(name)}</h3>" if len(runs) > 1 else page.paragraph(run.title)
        yield page.side_by_side(last_picture(run), doubts(run) + page.table(["quantity", ""], hole_rows([run])))
    yield f'<div class="charts">{"".join(places[:FIRST])}</div>'
    if has_views:
        yield (page.HERE / "view.html").read_text(encoding="utf-8")
    yield page.heading("Summary")
    yield page.table(["quantity", *runs], summary_rows(list(runs.values())))
    yield page.heading("Over time")
    yield f'<div class="charts">{"".join(places[FIRST:])}</div>'
    yield f'<div class="controls">{page.selection("quantity", "any quantity")}</div>{page.chart("chosen")}'
    yield page.heading("Notes and events")
    for name, run in runs.items():
        yield page.remark_list(remarks_of(run, "note"), f"{name}: no notes") if run.summary else ""
        yield from events_section(name, run)
    yield page.heading("Origin of the numbers")
    for name, run in runs.items():
        yield page.folded(f"{name}: versions, machine and digests", as_json(run.provenance))
        yield page.folded(f"{name}: the scenario as run", run.scenario_text)


def last_picture(run: OpenRun) -> str:
    """Return the picture in a run's folder, or a note on how to draw it."""
    if picture := drawn(run.folder / "picture.png"):
        return page.figure(picture, "the end of the run")
    return page.paragraph("There is no picture; draw it into the folder by suture view with --out picture.png.")


def doubts(run: OpenRun) -> str:
    """Return the remarks on unsupported numbers of a run."""
    if not run.summary:
        return page.paragraph(UNENDED)
    return page.remark_list(remarks_of(run, "unsupported"), "All numbers are supported.")


def remarks_of(run: OpenRun, severity: str) -> list[Mapping[str, str]]:
    """Return the remarks of a severity."""
    return [one for one in run.summary["remarks"] if one["severity"] == severity]


def summary_rows(runs: Sequence[OpenRun]) -> list[list[object]]:
    """Return the lines of the summary: a quantity, and its value in each run."""
    summaries = [run.summary for run in runs]
    rows: list[list[object]] = [[label, *(one.get(key) for one in summaries)] for label, key in SUMMARY.items()]
    rows.append(["largest strain of the thread", *(part(summary, "thread", "max_strain") for summary in summaries)])
    rows += hole_rows(runs) if len(runs) > 1 else []
    for key in dict.fromkeys(name for summary in summaries for name in summary.get("energy", {})):
        rows.append([f"energy: {key} [J]", *(part(summary, "energy", key) for summary in summaries)])
    return [row for row in rows if any(value is not None for value in row[1:])]


def hole_rows(runs: Sequence[OpenRun]) -> list[list[object]]:
    """Return the lines of each hole: a quantity, and its value in each run."""
    rows: list[list[object]] = [
        [headed(f"{hole}: {key}", HOLE_UNITS[key]), *(size(part(run.summary, "piercings", hole, key)) for run in runs)]
        for hole in dict.fromkeys(name for run in runs for name in run.piercings)
        for key in HOLE_LINES
    ]
    return [row for row in rows if any(value is not None for value in row[1:])]


def part(summary: Mapping[str, Any], *keys: str) -> Any:
    """Return the part of a summary below keys, or None."""
    found: Any = summary
    for key in keys:
        found = found.get(key) if isinstance(found, Mapping) else None
    return found


def size(value: Any) -> Any:
    """Return the length of a vector, and any other value unchanged."""
    return hypot(*value) if isinstance(value, list) and all(isinstance(each, float) for each in value) else value


def events_section(name: str, run: OpenRun) -> Iterator[str]:
    """Yield the events of a run as a table."""
    table = run.rows.get("events")
    if table is None or not len(table.columns["time"]):
        yield page.paragraph(f"{name}: none")
        return
    yield f"<h3>{page.escaped(name)}</h3>"
    names = ("time", "step", "event", "piercing", "s")
    yield whole_table(table, [name for name in names if name in table.columns])


def rows_sections(rows: Rows, number: int) -> Iterator[str]:
    """Yield the sections of a report on a study or a sweep, in order."""
    yield page.heading(rows.name)
    yield f"<p>{page.escaped(rows.question)}</p>"
    yield "<h3>Remarks</h3>"
    yield page.remark_list([{"message": text} for text in rows.remarks], "No remarks.")
    if rows.figure:
        yield page.figure(rows.figure, f"figure of {rows.name}")
    yield "<h3>Table</h3>"
    yield whole_table(rows.shown, tuple(rows.shown.columns))
    x, y = axes_of(rows.table)
    if x:
        names, numbers = list(rows.table.columns), rows.table.numeric
        choices = [page.selection(f"x{number}", "x", numbers, x), page.selection(f"y{number}", "y", numbers, y)]
        choices.append(page.selection(f"by{number}", "colour", ["", *names]))
        yield f'<h3>Rows</h3><div class="controls">{"".join(choices)}</div>{page.chart(f"grid{number}")}'
    yield page.folded("arguments, versions and machine", as_json(rows.provenance))


def axes_of(table: Table) -> tuple[str, str]:
    """Return the names of the first axes.

    They are the first and the last column of numbers that change, without the case number.
    """
    varied = [name for name in table.numeric if name != "case" and changes(table.columns[name])] or table.numeric
    return (varied[0], varied[-1]) if varied else ("", "")


def changes(numbers: NDArray[np.float64]) -> bool:
    """Return whether there are two different finite numbers."""
    return len(set(numbers[np.isfinite(numbers)].tolist())) > 1


def whole_table(table: Table, names: Sequence[str]) -> str:
    """Return columns of a table, with a note on the number of rows that are not shown."""
    count = min(MOST_ROWS, len(next(iter(table.columns.values()))))
    columns = [table.columns[name].tolist() for name in names]
    rows = list(zip(*columns, strict=True))[:count]
    more = len(columns[0]) - count
    note = page.paragraph(f"and {more} more rows in the folder's table") if more else ""
    return page.table([table.heading(name) for name in names], rows, words=0) + note


def grid_record(rows: Rows) -> dict[str, Any]:
    """Return the rows of a study or a sweep for the script of the page.

    They are in the units of the charts.
    """
    factors = {name: SHOWN.get(unit, (1.0, unit)) for name, unit in rows.table.units.items()}
    columns = {
        name: plain(factors.get(name, (1.0, ""))[0] * values) if values.dtype.kind == "f" else values.tolist()
        for name, values in rows.table.columns.items()
    }
    return {"columns": columns, "units": {name: unit for name, (_, unit) in factors.items() if unit != "-"}}
