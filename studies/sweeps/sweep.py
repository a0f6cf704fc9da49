"""A sweep into a folder: every case once, and the table of all cases.

A case is stored under the digest of all its inputs. ``cases/DIGEST.json`` is complete or absent. A
killed or enlarged sweep runs only the missing cases.
"""

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, cast

import numpy as np

from studies.output.files import as_json, read_json, unfinished, write_json
from studies.output.lock import folder_of, locked, refuse_foreign_files
from studies.output.manifest import refuse_links
from studies.output.provenance import provenance
from studies.scenario import Scenario, ScenarioError, because, changed, parsed, plain_values, read, tables
from studies.scenario.toml import override_key
from studies.simulation.sharing import organ_key
from studies.status import COMPLETED, REFUSED
from studies.study import value_of
from studies.sweeps.case import Result, case_digest, code_version, make_ready, run_case, run_start
from studies.sweeps.table import Case, SweepTable, table_of, write_tables
from studies.workers import Workers, in_turn, nothing

MARK = "sweep.json"
CASES = "cases"
MADE = ("table.csv", "table.parquet", "figure.png", "figure.svg", "verdict.md", "verdict.json")  # made from all cases
OWN = (MARK, CASES, *MADE)

MOST_CASES = 100_000  # with one file each

Settings = dict[str, Any]  # by dotted key
Base = Path | str | Mapping[str, Any] | Scenario
Tell = Callable[["SweepProgress"], None]
Check = Callable[[SweepTable], object]

STARTS = 3  # cases whose start is tried to find the names of columns


@dataclass(frozen=True)
class SweepProgress:
    """Progress of a sweep.

    It has `done` of `count` cases, `settings` and `exit_status` of the last case, and its `error`,
    empty if it was completed. The first one, with zero `done`, is that before the first case.
    """

    done: int
    count: int
    settings: Settings
    exit_status: int
    error: str


@dataclass(frozen=True)
class Planned:
    """A planned case.

    It has its tables, its digest and the digest of its organ, or the reason of its refusal.
    """

    settings: Settings
    data: dict[str, Any]
    digest: str = ""
    organ: str = ""
    refused: str = ""


def sweep(
    base: Base,
    over: Mapping[str, Sequence[Any]] | Sequence[Settings],
    folder: Path | str,
    workers: Workers | None = None,
    tell: Tell = nothing,
    kind: str = "sweep",
    check: Check | None = None,
) -> SweepTable:
    """Run a scenario for many values of its keys into a folder, and return the table of all cases.

    - `base`: a file, a shipped scene by its name, tables, or a scenario.
    - `over`: lists of values by dotted key, whose combinations are all run, or the settings of each
      case.
    - `workers`: the processes that run the cases (`studies.workers`); None means this process.
    - `kind`: the kind of the folder in messages.
    - `check`: called before the first case with a table of known values, at least from a case's
      start, to refuse names of columns that it lacks.

    A failed or refused case is a row; the sweep is refused if all cases are refused. Cases in the
    folder are not run again. Raises `ScenarioError`, and `studies.workers.WorkersError`.
    """
    check_over(over)
    if workers is not None and not callable(workers):
        raise ScenarioError(f"workers = {workers!r} is refused: give studies.workers.workers_of(jobs), or leave it out")
    cases = plain_values(grid(over) if isinstance(over, Mapping) else list(over))
    check_count(cases)
    plain = base_tables(base)
    folder = folder_of(folder)
    planned = plan(plain, cases)
    check_folder(folder, kind)
    with locked(folder):
        if check is not None and (known := known_table(planned, folder / CASES)) is not None:
            check(known)
        return _sweep(kind, plain, planned, folder, workers or in_turn, tell)


def check_over(over: object) -> None:
    """Refuse any argument except lists of values by key or a list of settings.

    Raises `ScenarioError`.
    """
    lists = over.values() if isinstance(over, Mapping) else [over]
    if any(isinstance(values, str) or not isinstance(values, Sequence | np.ndarray) for values in lists):
        raise ScenarioError(f"over = {over!r} is refused: {because('over-lists')}")
    if not isinstance(over, Mapping) and not all(isinstance(case, Mapping) for case in cast(Sequence, over)):
        raise ScenarioError(f"over = {over!r} is refused: a case is a dict of values by key, {{'solve.dt': 1e-3}}")


def base_tables(base: Base) -> dict[str, Any]:
    """Return the tables of the varied scenario."""
    return tables(base) if isinstance(base, Scenario) else read(base)


def plan(base: Mapping[str, Any], cases: Sequence[Settings]) -> list[Planned]:
    """Return the cases with their digests. Raises `ScenarioError` if all are refused."""
    planned = [planned_case(settings, changed(base, settings)) for settings in cases]
    if all(case.refused for case in planned):
        raise ScenarioError(planned[0].refused.splitlines())
    return planned


def planned_case(settings: Settings, data: dict[str, Any]) -> Planned:
    """Return a case with its digests, or with the reason why it is refused."""
    try:
        scenario = parsed(data)
    except ScenarioError as error:
        return Planned(settings, data, refused=str(error))
    return Planned(settings, data, case_digest(scenario), organ_key(scenario))


def check_folder(folder: Path, kind: str = "sweep") -> None:
    """Refuse a folder with files of another kind. Raises `ScenarioError`."""
    refuse_links(folder, [CASES])
    refuse_foreign_files(folder, OWN, holds_sweep(folder, kind), kind)


def holds_sweep(folder: Path, kind: str = "sweep") -> bool:
    """Return whether a folder holds a sweep, or a refinement, finished or not."""
    return read_json(folder / MARK).get("kind") == kind


def _sweep(
    kind: str, base: Mapping[str, Any], planned: list[Planned], folder: Path, workers: Workers, tell: Tell
) -> SweepTable:
    """Run the missing cases, and write the tables; first remove the tables of an earlier sweep."""
    kept = folder / CASES
    for path in (*(folder / name for name in MADE), *unfinished(folder, OWN), *unfinished(kept)):
        path.unlink(missing_ok=True)
    asked = {"kind": kind, "title": base.get("title", ""), "cases": len(planned)}
    varied = list(dict.fromkeys(key for case in planned for key in case.settings))
    where = {"code": code_version()[0], "provenance": provenance()}
    write_json(folder / MARK, {**asked, "over": varied, "base": base, **where})
    kept.mkdir(exist_ok=True)
    found = {case.digest: known for case in planned if case.digest and (known := known_case(kept, case.digest))}
    tell(SweepProgress(0, len(planned), {}, COMPLETED, ""))
    for number, case in enumerate((case for case in planned if case.refused), start=1):
        tell(SweepProgress(number, len(planned), case.settings, REFUSED, case.refused))
    missing = in_order_of_organs([case for case in planned if case.digest and case.digest not in found])
    done = len(planned) - len(missing)
    for number, result in workers(run_case, [case.data for case in missing], make_ready):
        case, done = missing[number], done + 1
        found[case.digest] = record(result)
        if result.lasting:
            write_json(kept / f"{case.digest}.json", found[case.digest])
        tell(SweepProgress(done, len(planned), case.settings, result.exit_status, result.summary.get("error", "")))
    table = table_of([row_of(case, found) for case in planned])
    write_tables(table, folder)
    return table


def in_order_of_organs(cases: Sequence[Planned]) -> list[Planned]:
    """Return cases, each once, sorted by organ so that each organ is made once."""
    once = {case.digest: case for case in cases}.values()
    first = {organ: number for number, organ in enumerate(dict.fromkeys(case.organ for case in once))}
    return sorted(once, key=lambda case: first[case.organ])


def known_table(planned: Sequence[Planned], kept: Path) -> SweepTable | None:
    """Return a table of completed cases, or of a start, or None.

    It has the cases that are already completed, or the first start that can be computed.
    """
    cases = [case for case in planned if case.digest]
    there = {case.digest: known for case in cases if (known := known_case(kept, case.digest))}
    rows = [row_of(case, there) for case in cases if case.digest in there]
    if done := [(settings, known) for settings, known in rows if known["exit_status"] == COMPLETED]:
        return table_of(done)
    for case in cases[:STARTS]:
        if (start := run_start(case.data)) is not None:
            return table_of([row_of(case, {case.digest: record(start)})])
    return None


def known_case(kept: Path, digest: str) -> dict[str, Any]:
    """Read a case that was run before; empty if it was not, or if its file is damaged."""
    known = read_json(kept / f"{digest}.json")
    return known if {"exit_status", "summary"} <= known.keys() else {}


def record(result: Result) -> dict[str, Any]:
    """Return a result as if read from its file: numbers that are not finite are None."""
    return json.loads(as_json(result.record()))


def row_of(case: Planned, found: Mapping[str, Mapping[str, Any]]) -> Case:
    """Return the settings of a case and its result."""
    if case.refused:
        return case.settings, {"exit_status": REFUSED, "summary": {"status": "refused", "error": case.refused}}
    return case.settings, found[case.digest]


# --- the cases ----------------------------------------------------------------------------------------------


def grid(over: Mapping[str, Sequence[Any]]) -> list[Settings]:
    """Return every combination of the values of keys, the last key varying fastest."""
    return [dict(zip(over, values, strict=True)) for values in product(*over.values())]


def paired(over: Mapping[str, Sequence[Any]]) -> list[Settings]:
    """Return the first values of all keys together, then the second values, and so on.

    Raises `ScenarioError`.
    """
    lengths = {key: len(values) for key, values in over.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{key} has {length}" for key, length in lengths.items())
        raise ScenarioError(f"--paired is refused: the lists differ in length ({shown}); give lists of equal length")
    return [dict(zip(over, values, strict=True)) for values in zip(*over.values(), strict=True)]


def parse_over(texts: Sequence[str]) -> dict[str, list[Any]]:
    """Return the lists of values in texts ``KEY=[…]`` in TOML, one text per key.

    Raises `ScenarioError`.
    """
    over: dict[str, list[Any]] = {}
    for text in texts:
        key, _, value = text.partition("=")
        override_key(f"{key}=0", f"--over {text}")
        values = value_of(value)
        if not isinstance(values, list) or not values:
            raise ScenarioError(f"--over {text} is refused: {because('over-value')}")
        if key.strip() in over:
            raise ScenarioError(f"--over {text} is refused: {key} is already varied; give all its values in one list")
        over[key.strip()] = values
    return over


def read_table(path: Path) -> list[Settings]:
    """Read cases from a CSV file.

    Each column has a key as its head, with values in TOML. An empty cell leaves the key unchanged.

    Raises `ScenarioError`.
    """
    try:
        head, *lines = [line for line in csv.reader(path.read_text(encoding="utf-8").splitlines()) if any(line)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ScenarioError(f"--table {path} cannot be read ({error}); give a CSV file") from None
    except ValueError:
        raise ScenarioError(f"--table {path} is empty; give a line of keys, and a line for each case") from None
    keys = [key.strip() for key in head]
    for key in keys:
        override_key(f"{key}=0", f"--table {path}: the column {key}")
    for number, line in enumerate(lines, 2):
        if len(line) != len(keys):
            raise ScenarioError(f"--table {path}: line {number} has {len(line)} cells, not {len(keys)}; correct it")
    return [{key: cell(text) for key, text in zip(keys, line, strict=True) if text.strip()} for line in lines]


def cell(text: str) -> Any:
    """Return a value from TOML; a bare word is a string."""
    value = value_of(text)
    if value == text.strip() and value.startswith(("[", "{", '"')):  # as it was: it is no TOML
        raise ScenarioError(f"{text} is refused: the value is not TOML; write for example 5e-4 or [0, 0, 1]")
    return value


def check_count(cases: Sequence[Settings]) -> None:
    """Refuse a sweep without cases, or with more than a folder can hold."""
    if not cases:
        raise ScenarioError("there is nothing to sweep; give --over KEY=[…], or --table FILE.csv")
    if len(cases) > MOST_CASES:
        raise ScenarioError(f"the sweep has {len(cases)} cases, but a folder holds at most {MOST_CASES}; use fewer")
