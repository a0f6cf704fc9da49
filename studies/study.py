"""A study: one question, answered by runs of its own, with a table and a figure.

A study is a package whose module `study` ends in `STUDY`. It is made of

- `study.toml`: its question, its checks, and the arguments of the preset "quick" (`described`),
- a `scene`: a scenario in TOML, of which the runs change some keys,
- `main`: the cases that are run. Its typed defaults are the preset "full"; it yields the rows of its jobs (`each`),
- a row: a frozen dataclass. A field has its unit, and the function that measures it on the end of a run (`measured`),
- the columns of its table (`Table.of`) and the panels of its figure (`studies.figure`),
- remarks: what was found, and what a row does not support (`studies.verdicts`). They are printed with the table.

`carry_out` runs any study into a folder.
"""

import csv
import io
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast, get_type_hints

import numpy as np
from pydantic import ConfigDict, TypeAdapter, ValidationError
from threadpoolctl import threadpool_limits

from studies.output.files import read_json, unfinished, write_bytes, write_json, write_text
from studies.output.lock import LOCK, locked
from studies.output.provenance import provenance
from studies.scenario.refusal import as_toml, nearest, refusal
from studies.scenario.scenario import Scenario, parse
from studies.scenario.toml import changed, read
from studies.workers import Workers, in_order

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = (
    "adaptive_refinement",
    "campaign",
    "coupling_variants",
    "friction",
    "mesh_refinement",
    "running_suture",
    "stitch_patterns",
    "suture_retention",
    "suture_tension",
    "taut_skin",
    "wound_closure",
)
R = TypeVar("R")
K = TypeVar("K")
PRESETS = ("quick", "full")
WRITTEN = ("study.json", "table.md", "table.csv", "runs.csv", "figure.png", "figure.svg")


class StudyError(ValueError):
    """A study that is refused before anything is computed."""


Columns = Sequence[tuple[str, Callable[[Any], str]]]


@dataclass(frozen=True)
class Table:
    """`head`, each with its unit, and `lines` of as many cells."""

    head: Sequence[str]
    lines: Sequence[Sequence[str]]

    @classmethod
    def of(cls, columns: Columns, items: Iterable[Any]) -> "Table":
        """Make a line for each item: a column is its head, and the function that writes its cell."""
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
    """The cases of a study, its question, its independent and its consistency checks, how its rows are shown, its
    remarks, and the arguments of the preset "quick"."""

    main: Callable[..., Iterator[Any]]
    question: str
    independent: str
    consistency: str
    table: Callable[[Sequence[Any]], Table]
    figure: Callable[[Sequence[Any]], "Figure"]
    remarks: Callable[[Sequence[Any]], list[str]]
    quick: Mapping[str, Any]


def described(
    name: str,
    main: Callable[..., Iterator[Any]],
    table: Callable[[Sequence[Any]], Table],
    figure: Callable[[Sequence[Any]], "Figure"],
    remarks: Callable[[Sequence[Any]], list[str]],
) -> Study:
    """Return the study of a name, which `study.toml` in its folder describes."""
    told = tomllib.loads((Path(__file__).parent / name / "study.toml").read_text(encoding="utf-8"))
    return Study(main=main, table=table, figure=figure, remarks=remarks, **told)


def unit_field(text: str, **default: Any) -> Any:
    """Declare a field of a row, with its unit."""
    return field(metadata={"unit": text}, **default)


def measured(text: str, of: Callable[[Any], Any]) -> Any:
    """Declare a field of a row, with its unit, "" if it has none, and the function that measures it at the end of a
    run."""
    return field(metadata=({"unit": text} if text else {}) | {"of": of})


def measure(kind: Callable[..., R], end: Any, /, **known: Any) -> R:
    """Return a row of the known values and the fields that are `measured` at the end of a run."""
    found = {f.name: f.metadata["of"](end) for f in fields(cast(Any, kind)) if "of" in f.metadata}
    return kind(**known, **{name: plain(value) for name, value in found.items()})


def plain(value: Any) -> Any:
    """Return a number or an array of numpy as Python's own number or a tuple."""
    if isinstance(value, np.ndarray):
        return tuple(value.tolist())
    return value.item() if isinstance(value, np.generic) else value


def scene(name: str, values: Mapping[str, Any]) -> Scenario:
    """Return the scenario of a study, `scene.toml` in its folder, with the values of some dotted keys."""
    return parse(changed(read(Path(__file__).parent / name / "scene.toml"), values))


def require(allowed: bool, given: str, remedy: str) -> None:
    """Raise `StudyError` for arguments of a study that are not allowed."""
    if not allowed:
        raise StudyError(f"{given} is refused: {remedy}")


def require_known(name: str, words: Sequence[str], known: Iterable[str]) -> None:
    """Raise `StudyError` for a word that an argument of a study does not know."""
    for word in words:
        require(word in known, f"{name}: {word!r}", f"those known are {'; '.join(known)}")


def grouped(rows: Iterable[R], key: Callable[[R], K]) -> dict[K, list[R]]:
    """Return rows by a key, in the order of their first one."""
    groups: dict[K, list[R]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


Job = Callable[[], Any]  # gives a row, or several; what goes to another process is a partial of a module's function
AT_WORK: ContextVar[Workers | None] = ContextVar("AT_WORK", default=None)  # None: this process


def each(jobs: Sequence[Job]) -> Iterator[Any]:
    """Yield the rows of jobs in their order, which the workers of `carry_out` do; a row as soon as it and all before it
    are done."""
    workers = AT_WORK.get()
    if workers is None:
        for job in jobs:
            yield from rows_of(job)
    else:
        for outcome in in_order(workers.done(outcome_of, jobs)):
            if isinstance(outcome, Exception):
                raise outcome
            yield from outcome


def rows_of(job: Job) -> Iterator[Any]:
    """Yield the rows of a job as they are done, with one thread of BLAS."""
    with threadpool_limits(limits=1, user_api="blas"):
        given = job()
        yield from ([given] if is_dataclass(given) else given)


def outcome_of(job: Job) -> list[Any] | Exception:
    """Return the rows of a job, or the error that it ends with: one raised where it is met would come before the rows
    of jobs ahead of it that take longer."""
    try:
        return list(rows_of(job))
    except Exception as error:
        return error


def study(name: str) -> Study:
    """Import the study of a name. Raises `StudyError`."""
    if name not in NAMES:
        near = nearest(name, NAMES)
        hint = f"; the nearest is {near}" if near else ""
        raise StudyError(refusal("study", name, f"the studies are {', '.join(NAMES)}{hint}"))
    found: Study = import_module(f"studies.{name}.study").STUDY
    return found


def arguments(found: Study, preset: str, settings: Sequence[str] = ()) -> dict[str, Any]:
    """Gather the arguments of a study's `main`: those of the preset, and each `settings` `name=value` with the value in
    TOML.

    Raises `StudyError`.
    """
    kinds = {name: kind for name, kind in get_type_hints(found.main).items() if name != "return"}
    quick = found.quick if preset == "quick" else {}
    given = {name: convert(f"{name}=…", kinds[name], value) for name, value in quick.items()}
    for setting in settings:
        name, equals, text = setting.partition("=")
        if name not in kinds or not equals:
            near = nearest(name, kinds)
            hint = f"; the nearest is {near}" if near and near != name else ""
            raise StudyError(f"--set {setting} is refused: write NAME=VALUE with a name of {', '.join(kinds)}{hint}")
        given[name] = convert(setting, kinds[name], value_of(text))
    return given


def value_of(text: str) -> Any:
    """Read a value in TOML; a bare word is a string, because a shell takes the quotes away."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text.strip()


def convert(setting: str, kind: Any, value: Any) -> Any:
    """Convert a value to the type that the study's argument has."""
    if value == []:
        raise StudyError(f"--set {setting} is refused: the list is empty; give at least one")
    try:
        return TypeAdapter(kind, config=ConfigDict(allow_inf_nan=False)).validate_python(value)
    except ValidationError as error:
        detail = error.errors(include_url=False)[0]
        reason = detail["msg"].replace("Input should be", "it must be")
        raise StudyError(f"--set {setting} is refused: {reason}, and not {as_toml(detail['input'])}") from None


def check_folder(folder: Path, overwrite: bool = False) -> None:
    """Refuse a folder that holds other files than an earlier study, or that one and no leave to replace it. Raises
    `StudyError`."""
    if folder.exists() and not folder.is_dir():
        raise StudyError(f"--out {folder} is refused: it is a file; give a folder")
    there = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    begun = {LOCK, *(path.name for path in unfinished(folder, WRITTEN))}
    others = [name for name in there if name not in begun and (name not in WRITTEN or not holds_study(folder))]
    if others:
        reason = f"it holds other files than a study's ({others[0]}); give a new or empty folder"
        raise StudyError(f"--out {folder} is refused: {reason}")
    if set(there) - begun and not overwrite:
        raise StudyError(
            f"--out {folder} is refused: it holds a study already; add --overwrite to replace it, or give another "
            "folder"
        )


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
    """Run a study into a folder: write and pass to `tell` every row as soon as it is done, then write table, figure,
    arguments and checks. `workers` do its jobs; None is this process. A study that fails leaves its rows.

    Raises what its `main` raises, `studies.workers.WorkersError`, and `ScenarioError` if another run is at work there.
    """
    token = AT_WORK.set(workers)
    try:
        with locked(folder):
            _carry_out(name, preset, given, folder, tell)
    finally:
        AT_WORK.reset(token)


def _carry_out(
    name: str, preset: str, given: Mapping[str, Any], folder: Path, tell: Callable[[Sequence[Any]], None]
) -> None:
    found, asked = study(name), {"preset": preset, "arguments": dict(given), "provenance": provenance()}
    rows: list[Any] = []
    text = ""
    for row in found.main(**given):
        if not rows:
            empty_folder(folder)
            write_json(folder / "study.json", {"study": name, "question": found.question, **asked})
        rows.append(row)
        text += numbers([row]) if len(rows) == 1 else comma_separated([cells(row)])
        write_text(folder / "runs.csv", text)
        tell(rows)
    write(name, asked, rows, folder)


def empty_folder(folder: Path) -> None:
    """Remove an earlier study from a folder, finished or not."""
    for path in (*(folder / name for name in WRITTEN), *unfinished(folder, WRITTEN)):
        path.unlink(missing_ok=True)


def write(name: str, asked: Mapping[str, Any], rows: Sequence[Any], folder: Path) -> None:
    """Write table, figure, arguments and checks into a folder."""
    from studies.figure import render_figure

    found = study(name)
    remarks, shown = found.remarks(rows), found.table(rows)
    checks = {"independent": found.independent, "consistency": found.consistency, "remarks": remarks}
    write_json(folder / "study.json", {"study": name, "question": found.question, **asked, **checks})
    write_text(folder / "table.md", shown.markdown + "".join(f"\n* {remark}\n" for remark in remarks))
    write_text(folder / "table.csv", shown.csv)
    for kind, picture in render_figure(found.figure, rows, name).items():
        write_bytes(folder / f"figure.{kind}", picture)


def numbers(rows: Sequence[Any]) -> str:
    """Write every row in SI units, which the header names."""
    head = [f"{f.name} [{f.metadata['unit']}]" if "unit" in f.metadata else f.name for f in fields(rows[0])]
    return comma_separated([head, *map(cells, rows)])


def cells(row: Any) -> list[str]:
    """Return the cells of a row, field by field."""
    return [str(value) for value in asdict(row).values()]


def comma_separated(lines: Sequence[Sequence[str]]) -> str:
    """Write lines of CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue()
