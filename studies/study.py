"""A study: one question, answered by its own runs, with a table and a figure.

A study is a package with a module `study` and these parts:

- `study.toml`: its question, its checks, the arguments of the preset "quick", published numbers,
  the columns of its table, the sentences of its remarks, and the labels of the panels of its
  figure (`studies.lists`),
- a `scene`: a scenario in TOML; the runs change some of its keys,
- `main`: the cases. Its typed defaults are the preset "full"; it yields the rows of its jobs
  (`each`),
- a row: a frozen dataclass. A field has its unit, and a function that measures it at the end of a
  run (`measured`),
- `table`: the columns of its table (`Table.of`, `columns_of`),
- `figure`: the items of the panels of its figure (`studies.figure`),
- `remarks`: findings, and numbers that a row does not support (`studies.verdicts`). They are
  printed with the table.

`carry_out` runs any study into a folder.
"""

import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from functools import partial
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast, get_type_hints

import numpy as np
from pydantic import ConfigDict, TypeAdapter, ValidationError
from threadpoolctl import threadpool_limits

from studies.arrays import UNITS
from studies.lists import study_list
from studies.output.files import comma_separated, read_json, unfinished, write_json, write_text
from studies.output.lock import locked, refuse_foreign_files, refused
from studies.output.provenance import provenance
from studies.scenario import Scenario, as_toml, changed, hint_at, parse, read, refusal
from studies.workers import Workers, in_order

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = tuple(sorted(path.parent.name for path in Path(__file__).parent.glob("*/study.toml")))
R = TypeVar("R")
K = TypeVar("K")
PRESETS = ("quick", "full")
WRITTEN = ("study.json", "table.md", "table.csv", "runs.csv", "figure.png", "figure.svg")


class StudyError(ValueError):
    """A study that is refused before the computation."""


Columns = Sequence[tuple[str, Callable[[Any], str]]]


@dataclass(frozen=True)
class Table:
    """A table: `head` has the headings with units, and `lines` have as many cells."""

    head: Sequence[str]
    lines: Sequence[Sequence[str]]

    @classmethod
    def of(cls, columns: Columns, items: Iterable[Any]) -> "Table":
        """Return the table with a line for each item.

        A column is its heading and the function that writes its cell.
        """
        return cls([head for head, _ in columns], [[cell(item) for _, cell in columns] for item in items])

    @property
    def markdown(self) -> str:
        """The table in Markdown."""
        return "\n".join("| " + " | ".join(x) + " |" for x in (self.head, ["---"] * len(self.head), *self.lines)) + "\n"

    @property
    def csv(self) -> str:
        """The table in CSV."""
        return comma_separated([self.head, *self.lines])


@dataclass(frozen=True)
class Study:
    """A study: its cases, question, checks, table, figure and remarks.

    `quick` are the arguments of the preset "quick".
    """

    main: Callable[..., Iterator[Any]]
    question: str
    independent: str
    consistency: str
    table: Callable[[Sequence[Any]], Table]
    figure: Callable[[Sequence[Any]], "Figure"]
    remarks: Callable[[Sequence[Any]], Iterable[str]]
    quick: Mapping[str, Any]


def columns_of(name: str, **own: Callable[[Any], str]) -> Columns:
    """Return the columns of a study's table, which its `study.toml` lists.

    The list has the heading of each, and its `cell`, or the name of one of its `own` functions.
    """
    return [(head, own.get(of) or partial(cell, of)) for head, of in study_list(name)["columns"]]


def cell(of: str, line: Any) -> str:
    """Return a value of a row as text, empty for None; the row is the last of a line of several.

    `of` is the name of the value, its unit in brackets if this is not the SI unit, and its format,
    for example "opened [mm]:.2f".
    """
    name, _, style = of.partition(":")
    name, _, unit = name.rstrip("]").partition(" [")
    value = attrgetter(name)(line[-1] if isinstance(line, list) else line)
    return "" if value is None else format(value / UNITS[unit] if unit else value, style)


def unit_field(text: str, **default: Any) -> Any:
    """Return a field of a row, with its unit."""
    return field(metadata={"unit": text}, **default)


def measured(text: str, of: Callable[[Any], Any]) -> Any:
    """Return a field of a row, with its unit and the function that measures it.

    The function is called at the end of a run. The unit is "" without a unit.
    """
    return field(metadata=({"unit": text} if text else {}) | {"of": of})


def measure(kind: Callable[..., R], end: Any, /, **known: Any) -> R:
    """Return a row of the known values and the fields that are `measured` at the end of a run."""
    found = {f.name: f.metadata["of"](end) for f in fields(cast(Any, kind)) if "of" in f.metadata}
    return kind(**known, **{name: plain(value) for name, value in found.items()})


def plain(value: Any) -> Any:
    """Return a number or an array of numpy as a number or a tuple of Python."""
    if isinstance(value, np.ndarray):
        return tuple(value.tolist())
    return value.item() if isinstance(value, np.generic) else value


def scene(name: str, values: Mapping[str, Any]) -> Scenario:
    """Return the scenario of a study, with changed values of dotted keys.

    It is read from `scene.toml` in the folder of the study.
    """
    return parse(changed(read(Path(__file__).parent / name / "scene.toml"), values))


def require(allowed: bool, given: str, remedy: str) -> None:
    """Raise `StudyError` for arguments of a study that are not allowed."""
    if not allowed:
        raise StudyError(f"{given} is refused: {remedy}")


def require_known(name: str, words: Sequence[str], known: Iterable[str]) -> None:
    """Raise `StudyError` for an unknown word in an argument of a study."""
    for word in words:
        require(word in known, f"{name}: {word!r}", f"allowed are {'; '.join(known)}")


def grouped(rows: Iterable[R], key: Callable[[R], K]) -> dict[K, list[R]]:
    """Return rows by a key, in the order of first rows."""
    groups: dict[K, list[R]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


Job = Callable[[], Any]  # returns a row, or several; a job for another process must be a partial of a module's function
AT_WORK: ContextVar[Workers | None] = ContextVar("AT_WORK", default=None)  # None: this process


def each(jobs: Sequence[Job]) -> Iterator[Any]:
    """Yield the rows of jobs in their order, computed by the workers of `carry_out`.

    A row is yielded when it and all rows before it are done.
    """
    workers = AT_WORK.get()
    if workers is None:
        for job in jobs:
            yield from rows_of(job)
    else:
        for outcome in in_order(workers(outcome_of, jobs)):
            if isinstance(outcome, Exception):
                raise outcome
            yield from outcome


def rows_of(job: Job) -> Iterator[Any]:
    """Yield the rows of a job when they are done, with one thread of BLAS."""
    with threadpool_limits(limits=1, user_api="blas"):
        given = job()
        yield from ([given] if is_dataclass(given) else given)


def outcome_of(job: Job) -> list[Any] | Exception:
    """Return the rows of a job, or its error.

    The error is not raised here, because it would come before the rows of earlier jobs that take
    longer.
    """
    try:
        return list(rows_of(job))
    except Exception as error:
        return error


def study(name: str) -> Study:
    """Return the study of this name. Raises `StudyError`."""
    if name not in NAMES:
        raise StudyError(refusal("study", name, f"the studies are {', '.join(NAMES)}{hint_at(name, NAMES)}"))
    module, texts = import_module(f"studies.{name}.study"), study_list(name)
    described = {key: texts[key] for key in ("question", "independent", "consistency", "quick")}
    functions = {part: getattr(module, part) for part in ("main", "table", "figure", "remarks")}
    return Study(**functions, **described)


def arguments(found: Study, preset: str, settings: Sequence[str] = ()) -> dict[str, Any]:
    """Return the arguments of a study's `main`.

    The arguments of the preset are changed by each of `settings`, `name=value` in TOML.

    Raises `StudyError`.
    """
    kinds = {name: kind for name, kind in get_type_hints(found.main).items() if name != "return"}
    quick = found.quick if preset == "quick" else {}
    given = {name: convert(f"{name}=…", kinds[name], value) for name, value in quick.items()}
    for setting in settings:
        name, equals, text = setting.partition("=")
        if name not in kinds or not equals:
            hint = "" if name in kinds else hint_at(name, kinds)
            raise StudyError(f"--set {setting} is refused: write NAME=VALUE with a name of {', '.join(kinds)}{hint}")
        given[name] = convert(setting, kinds[name], value_of(text))
    return given


def value_of(text: str) -> Any:
    """Return the value from TOML; a bare word is a string, because a shell removes quotes."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text.strip()


def convert(setting: str, kind: Any, value: Any) -> Any:
    """Return a value converted to the type of the study's argument."""
    if value == []:
        raise StudyError(f"--set {setting} is refused: the list is empty; give at least one value")
    try:
        return TypeAdapter(kind, config=ConfigDict(allow_inf_nan=False)).validate_python(value)
    except ValidationError as error:
        detail = error.errors(include_url=False)[0]
        reason = detail["msg"].replace("Input should be", "it must be")
        raise StudyError(f"--set {setting} is refused: {reason}, and not {as_toml(detail['input'])}") from None


def check_folder(folder: Path, overwrite: bool = False) -> None:
    """Refuse a folder that a study may not write.

    It holds other files, or an earlier study that may not be replaced.

    Raises `ScenarioError`.
    """
    refuse_foreign_files(folder, WRITTEN, holds_study(folder), "study")
    if holds_study(folder) and not overwrite:
        raise refused(folder, "it already holds a study; add --overwrite to replace it, or give another folder")


def holds_study(folder: Path) -> bool:
    """Return whether a folder has the `study.json` of a study."""
    return {"study", "preset", "provenance"} <= read_json(folder / "study.json").keys()


def carry_out(
    name: str,
    preset: str,
    given: Mapping[str, Any],
    folder: Path,
    tell: Callable[[Sequence[Any]], None],
    workers: Workers | None = None,
) -> None:
    """Run a study into a folder.

    Each row is written and passed to `tell` when it is done. Table, figure, arguments and checks
    follow. `workers` do the jobs; None means this process. A failed study leaves its rows. Raises
    the errors of its `main`, `studies.workers.WorkersError`, and `ScenarioError` if another run
    uses the folder.
    """
    found, rows = study(name), list[Any]()
    asked = {"study": name, "question": found.question, "preset": preset, "arguments": dict(given)}
    asked["provenance"] = provenance()
    token = AT_WORK.set(workers)
    try:
        with locked(folder):
            for row in found.main(**given):
                if not rows:
                    begin(asked, folder)
                rows.append(row)
                write_text(folder / "runs.csv", numbers(rows))
                tell(rows)
            write(found, asked, rows, folder)
    finally:
        AT_WORK.reset(token)


def begin(asked: Mapping[str, Any], folder: Path) -> None:
    """Write the arguments of a study, and remove an earlier study, finished or not."""
    for path in (*(folder / file for file in WRITTEN), *unfinished(folder, WRITTEN)):
        path.unlink(missing_ok=True)
    write_json(folder / "study.json", asked)


def write(found: Study, asked: Mapping[str, Any], rows: Sequence[Any], folder: Path) -> None:
    """Write table, figure, arguments and checks into a folder."""
    from studies.figure import write_figure

    remarks, shown = list(found.remarks(rows)), found.table(rows)
    checks = {"independent": found.independent, "consistency": found.consistency, "remarks": remarks}
    write_json(folder / "study.json", {**asked, **checks})
    write_text(folder / "table.md", shown.markdown + "".join(f"\n* {remark}\n" for remark in remarks))
    write_text(folder / "table.csv", shown.csv)
    write_figure(found.figure, rows, asked["study"], folder)


def numbers(rows: Sequence[Any]) -> str:
    """Return every row in SI units, which are in the header."""
    head = [f"{f.name} [{f.metadata['unit']}]" if "unit" in f.metadata else f.name for f in fields(rows[0])]
    cells = [[str(value) for value in asdict(row).values()] for row in rows]
    return comma_separated([head, *cells])
