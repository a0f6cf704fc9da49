"""The commands ``suture sweep`` and ``suture refine``."""

import argparse
import json
import sys
from functools import partial
from pathlib import Path
from time import monotonic

from studies.command.lines import complain, print_lines
from studies.command.progress import LOOP_LOGGERS, duration, stages
from studies.extras import installation
from studies.output.files import as_json
from studies.refinement.ladder import Refined
from studies.refinement.refine import in_words, refine
from studies.scenario import ScenarioError, read
from studies.status import COMPLETED, FAILED, INTERRUPTED, REFUSED, UNSUPPORTED
from studies.sweeps.sweep import Settings, SweepProgress, Tell, grid, paired, parse_over, read_table, sweep
from studies.sweeps.table import SweepTable, counted, drawn_columns, plain
from studies.workers import nothing, workers_of

STATUSES = {"completed": COMPLETED, "failed": FAILED, "refused": REFUSED}


def run_sweep(options: argparse.Namespace) -> int:
    """``suture sweep``: run a scenario for many values of its keys.

    A failed case is a row of the table; the exit status is still 0.
    """
    cases, wanted = cases_of(options), options.plot or []
    if len(wanted) not in (0, 2, 3):
        raise ScenarioError(f"--plot needs two columns, x and y, or three, x, y and by; got {len(wanted)}")
    base = read(options.file, options.set)
    tell = teller(options.json)
    try:
        workers = workers_of(options.jobs, options.dask)
        if wanted:
            from studies.figure import write_figure  # refused before the runs if matplotlib is missing
            from studies.sweeps.figure import figure
        with stages(options.json, LOOP_LOGGERS):
            check = partial(drawn_columns, names=wanted) if wanted else None
            table = sweep(base, cases, options.out, workers, tell, check=check)
        if wanted:
            write_figure(figure, drawn_columns(table, wanted), "sweep", options.out)
    except KeyboardInterrupt:
        return complain("interrupted; the same command continues", INTERRUPTED)
    if options.json:
        print(as_json({"columns": table.names, "cases": rows(table)}), end="")
    else:
        print_lines(report(table, options.out))
    return 0


def cases_of(options: argparse.Namespace) -> list[Settings]:
    """Return the cases of a command line: a table, or lists of values.

    With both, all lists are run for each row of the table.
    """
    over = parse_over(options.over)
    lists = paired(over) if options.paired and over else grid(over)
    given = read_table(options.table) if options.table else [{}]
    return [one | other for one in given for other in lists] if over or options.table else []


def report(table: SweepTable, folder: Path) -> list[str]:
    """Return the result of a sweep in lines for a person."""
    statuses, unsupported = table["exit_status"].values, table["unsupported"].values
    count = {word: sum(status == number for status in statuses) for word, number in STATUSES.items()}
    results = ", ".join(f"{number} {word}" for word, number in count.items() if number)
    doubted = sum(bool(number) for number in unsupported)
    lines = [f"{counted(len(table))}: {results}"]
    lines += [f"remarks    {counted(doubted)} with numbers that are not supported: column remarks"] if doubted else []
    lines += [f"table      {folder / 'table.csv'}" + _parquet(folder)]
    drawn = folder / "figure.png"
    return [*lines, *([f"figure     {drawn}"] if drawn.is_file() else [])]


def _parquet(folder: Path) -> str:
    """Return the place of the table in Parquet, or how to install its package."""
    path = folder / "table.parquet"
    return f", {path.name}" if path.is_file() else f" (table.parquet needs pyarrow: {installation('pyarrow')})"


def rows(table: SweepTable) -> list[dict[str, object]]:
    """Return the rows of a table by the headings of its columns."""
    columns = [(column.heading, column.converted) for column in table.columns]
    return [{heading: values[k] for heading, values in columns} for k in range(len(table))]


def verdict_lines(one: Refined) -> list[str]:
    """Return the verdict on a quantity in lines for a person."""
    texts = {name.partition(",")[0]: text for name, text in in_words(one).items() if name not in ("quantity", "unit")}
    return [f"{one.quantity} [{one.unit}]", *(f"  {name:9}  {text}" for name, text in texts.items() if text)]


def teller(quiet: bool = False) -> Tell:
    """Return the function that writes the number of cases on standard error, and a line per completed case.

    A line has the remaining time, from the pace since the first case that was run. Cases refused
    before the run do not count for it.
    """
    began, ran = monotonic(), list[int]()

    def tell(progress: SweepProgress) -> None:
        if not progress.done:
            print_lines([f"{counted(progress.count)}, with one line per completed case"], sys.stderr)
            return
        if progress.exit_status != REFUSED:
            ran.append(progress.done)
        remaining = (monotonic() - began) * (progress.count - progress.done)
        left = f", {duration(remaining / (progress.done - ran[0] + 1))} left" if ran else ""
        settings = ", ".join(f"{key} = {plain(value)}" for key, value in progress.settings.items()) or "unchanged"
        what = next((word for word, number in STATUSES.items() if number == progress.exit_status), "failed")
        why = f": {'; '.join(progress.error.splitlines())}" if progress.error else ""
        print_lines([f"{progress.done}/{progress.count}{left}: {what}: {settings}{why}"], sys.stderr)

    return nothing if quiet else tell


def run_refinement(options: argparse.Namespace) -> int:
    """``suture refine``: write the convergence of numbers of a scenario in words."""
    asked = {key: getattr(options, key) for key in ("quantity", "over", "levels", "ratio", "adaptive")}
    try:
        with stages(options.json, LOOP_LOGGERS):
            where = {"folder": options.out, "workers": workers_of(options.jobs, options.dask)}
            found = refine(read(options.file, options.set), **asked, **where, tell=teller(options.json))
    except KeyboardInterrupt:
        return complain("interrupted; the same command continues", INTERRUPTED)
    if options.json:
        print(json.dumps(json.loads((options.out / "verdict.json").read_text(encoding="utf-8"))))
    else:
        verdicts = [line for one in found for line in verdict_lines(one)]
        print_lines([*verdicts, *found[0].notes, "", f"all results in {options.out}"])
    if any(one.verdict is None for one in found):
        return FAILED
    return UNSUPPORTED if options.strict and not all(one.converged for one in found) else 0
