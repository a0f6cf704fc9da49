"""A scenario in TOML.

``load`` reads a file (with ``--set`` overrides), ``dump`` writes a scenario with every default.
"""

import hashlib
import re
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from os import PathLike
from pathlib import Path
from typing import Any, get_args

import tomli_w

from studies.scenario.organ import FileMesh
from studies.scenario.refusal import BARE, as_toml, because, dotted_key, hint_at, refusal
from studies.scenario.scenario import Scenario, parse
from studies.scenario.stitch import long_form
from studies.scenario.table import ScenarioError, plain_values

LIST = re.compile(r"\[\n((?:[^\[\]\n]+,\n)+) *\]")  # of numbers or words, in the format of tomli_w
SCENES = Path(__file__).parent / "scenes"  # scenarios shipped with the package


def load(source: Path | str | Mapping[str, Any], overrides: Sequence[str] = ()) -> Scenario:
    """Return a scenario from a file, from a shipped scene by its name, or from its tables.

    Each override is ``dotted.key=value`` with the value in TOML.
    """
    return parsed(read(source, overrides))


def read(source: Path | str | Mapping[str, Any], overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Return the tables of a scenario like `load`, without validation.

    The path of a mesh file is absolute.
    """
    if isinstance(source, Mapping):
        data, folder = deepcopy(dict(source)), Path()
    else:
        path = scenario_file(source)
        data, folder = _read(path), path.parent
    if isinstance(overrides, str) or not isinstance(overrides, Sequence):
        raise ScenarioError(f"overrides = {overrides!r} is refused: {because('overrides')}")
    for override in overrides:
        _set(data, override_key(override), _override_value(override), f"--set {override}")
    _make_paths_absolute(data, folder)
    return data


def written(path: Path | str, overrides: Sequence[str] = ()) -> str:
    """Return the scenario of a file in TOML, in the long form of its stitches.

    Defaults are left out.
    """
    data = read(path, overrides)
    parsed(data)
    return compact(tomli_w.dumps(long_form(data)))


def changed(data: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of a scenario's tables with keys set by their dotted names.

    Raises `ScenarioError`.
    """
    copy = deepcopy(dict(data))
    for key, value in plain_values(values).items():
        text = f"{key}={as_toml(value)}"
        _set(copy, override_key(text, text), value, text)
    return copy


def parsed(data: Mapping[str, Any]) -> Scenario:
    """Validate a scenario given as tables, and the existence of its mesh file.

    Raises `ScenarioError`.
    """
    tissue = data.get("tissue")
    mesh = tissue.get("mesh") if isinstance(tissue, dict) else None
    faults = file_faults(mesh.get("path")) if isinstance(mesh, dict) and mesh.get("kind") == "file" else []
    try:
        scenario = parse(data)
    except ScenarioError as error:
        raise ScenarioError([*error.problems, *faults]) from None
    if faults:
        raise ScenarioError(faults)
    return scenario


def scenes() -> list[str]:
    """List the names of the shipped scenes."""
    return sorted(path.stem for path in SCENES.glob("*.toml"))


def scenario_file(path: Path | str) -> Path:
    """Return the file of a scenario: `path` if it is a file, else the shipped scene of this name.

    Raises `ScenarioError` for any other argument.
    """
    if not isinstance(path, str | PathLike):
        raise ScenarioError(f"{path!r} is refused: it is no path; give the path of a file, or a shipped scene")
    path = Path(path)
    return SCENES / f"{path}.toml" if str(path) in scenes() and not path.is_file() else path


def tables(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario as plain tables with every default; keys that are None are left out."""
    plain = scenario.model_dump(mode="json", by_alias=True, exclude_none=True)
    return {key: _kind_first(value) for key, value in plain.items()}


def _kind_first(value: Any) -> Any:
    """Return the same tables with ``kind`` as the first key, for readability."""
    match value:
        case dict():
            first = {"kind": value["kind"]} if "kind" in value and "name" not in value else {}
            return first | {key: _kind_first(item) for key, item in value.items()}
        case list():
            return [_kind_first(item) for item in value]
        case _:
            return value


def dump(scenario: Scenario) -> str:
    """Return the scenario in TOML with every default; the text reads back to an equal scenario."""
    return compact(tomli_w.dumps(tables(scenario)))


def compact(text: str) -> str:
    """Return TOML of tomli_w with each list of numbers or words on one line."""
    return LIST.sub(
        lambda found: f"[{', '.join(line.strip().removesuffix(',') for line in found[1].splitlines())}]", text
    )


def mesh_file(scenario: Scenario) -> Path | None:
    """Return the mesh file of the scenario, None without a mesh file."""
    if scenario.tissue is None or not isinstance(scenario.tissue.mesh, FileMesh):
        return None
    return Path(scenario.tissue.mesh.path)


def with_mesh_copy(scenario: Scenario) -> tuple[Scenario, str]:
    """Return the scenario with the copy of its mesh file, and the SHA-256 of the file.

    The copy is in the folder `mesh` of a results folder. Without a mesh file the scenario is
    unchanged, and the digest is empty.
    """
    file = mesh_file(scenario)
    if file is None or scenario.tissue is None:
        return scenario, ""
    mesh = scenario.tissue.mesh.model_copy(update={"path": f"mesh/{file.name}"})
    copied = scenario.model_copy(update={"tissue": scenario.tissue.model_copy(update={"mesh": mesh})})
    return copied, hashlib.sha256(file.read_bytes()).hexdigest()


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))  # Windows editors can write a byte-order mark
    except FileNotFoundError:
        hint = hint_at(path.name, scenes(), "the scene with the nearest name is {}; ")
        remedy = because("file-missing", hint=hint, scenes=", ".join(scenes()))
        raise ScenarioError(f"{path} does not exist; {remedy}") from None
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path} is not UTF-8 text {because('file-bytes', at=error.start)}") from None
    except OSError as error:
        raise ScenarioError(f"{path} cannot be read ({error.strerror}); give a readable scenario file") from None
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{path} is not valid TOML: {error}; correct that line") from None
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, or tables with hundreds of levels
        raise ScenarioError(f"{path} cannot be read as TOML: {error}; no scenario needs that") from None


def _set(table: Any, parts: Sequence[str], value: Any, text: str, parents: tuple[str, ...] = ()) -> None:
    """Set one key of a table in place; without an entry's name, in every entry of a list of tables.

    `text` is the override, `parents` are the parts of the table's name.
    """
    part, *rest = parts
    if isinstance(table, list):
        if part in keys_of_entries(parents) and part not in map(_name, table):
            for entry in [each for each in table if isinstance(each, dict)]:
                _set(entry, parts, value, text, parents)
            return
        key: Any = _index(table, part, dotted_key(parents), text)
    else:
        key = part
    if not rest:
        table[key] = value
        return
    inner = table[key] if isinstance(table, list) else table.setdefault(key, {})
    if not isinstance(inner, dict | list):
        where = dotted_key([*parents, part])
        raise ScenarioError(f"{text} is refused: {where} is a value, not a table; set {where} itself")
    _set(inner, rest, value, text, (*parents, part))


def keys_of_entries(parents: Sequence[str]) -> set[str]:
    """Return the keys of the tables in a list of the scenario; empty for other places."""
    field = Scenario.model_fields.get(parents[0]) if len(parents) == 1 else None
    entry = next(iter(get_args(field.annotation)), None) if field else None
    fields = getattr(entry, "model_fields", {})
    return {info.alias or name for name, info in fields.items()}


def _name(entry: Any) -> Any:
    """Return the name of an entry of a list, None without a name."""
    return entry.get("name") if isinstance(entry, dict) else None


def override_key(text: str, given: str = "") -> list[str]:
    """Return the parts of the dotted key in ``key=value``.

    `given` is how the user wrote it, ``--set key=value`` if empty. Raises `ScenarioError`.
    """
    key, equals, _ = text.partition("=") if isinstance(text, str) else ("", "", "")
    try:
        table = tomllib.loads(f"{key}=0") if equals else {}
    except tomllib.TOMLDecodeError:
        table = {}
    if not table:
        names = [name.strip() for name in key.split(".")]
        odd = all(names) and '"' not in key and not all(map(BARE.fullmatch, names))
        hint = f"; quote a name with other letters: {dotted_key(names)}" if odd else ""
        raise ScenarioError(f"{given or f'--set {text}'} is refused: {because('override-key')}{hint}")
    parts: list[str] = []
    while isinstance(table, dict):
        ((part, table),) = table.items()
        parts.append(part)
    return parts


def _override_value(text: str) -> Any:
    """Return the value from TOML; bare words are a string, because a shell removes quotes."""
    key, _, value = text.partition("=")
    try:
        return tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError as error:
        if all(BARE.fullmatch(word) for word in value.strip().split(" ")):
            return value.strip()
        reason = because("override-value", reason=str(error).partition(" (at")[0])
        raise ScenarioError(f"--set {key}={value} is refused: {reason}") from None


def _index(entries: list[Any], part: str, parent: str, text: str) -> int:
    names = [_name(entry) for entry in entries]
    if part in names:
        return names.index(part)
    if part.isdecimal() and int(part) < len(entries):
        return int(part)
    there = [str(index) if name is None else str(name) for index, name in enumerate(names)]
    raise ScenarioError(f"{text} is refused: {parent} has no entry {part}; its entries are {', '.join(there)}")


def _make_paths_absolute(data: dict[str, Any], folder: Path) -> None:
    tissue = data.get("tissue")
    mesh = tissue.get("mesh") if isinstance(tissue, dict) else None
    if isinstance(mesh, dict) and isinstance(path := mesh.get("path"), str) and path:
        with suppress(OSError, ValueError, RuntimeError):  # an impossible or circular path is refused later
            mesh["path"] = str((folder / path).resolve())


def file_faults(path: Any) -> list[str]:
    """Return the reasons why a path has no readable mesh."""
    if not isinstance(path, str) or not path:
        return []
    reason, file = "", Path(path)
    try:
        if not file.is_file():
            reason = because("mesh-missing")
        elif not file.stat().st_size:
            reason = because("mesh-empty")
    except (OSError, ValueError) as error:  # a name that is too long, or contains a null
        reason = because("mesh-unreadable", error=error)
    return [refusal("tissue.mesh.path", path, reason)] if reason else []
