"""The reference of the scenario file: a list of keys for each table, from the schema.

``python -m studies.scenario.reference`` updates the lists of keys and of scenes in ``README.md``.
To add a key, add its field, and its meaning with its unit in `keys.toml`. This file needs no
change.
"""

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from studies.manual import with_blocks
from studies.scenario.refusal import as_toml
from studies.scenario.scenario import schema
from studies.scenario.toml import SCENES, scenes

Node = Mapping[str, Any]  # of a JSON schema

MANUAL = Path(__file__).with_name("README.md")
UNIT = re.compile(r" ?\[(-|m|s|rad|kg|N|Pa|1/s|m/s|m/s²|kg/m³)\]")
DEFAULT = re.compile(r"[;,] default:? (?!with )([^;]+)")
TYPES = {"string": "text", "integer": "integer", "number": "number", "boolean": "true/false", "object": "table"}
BOUNDS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}


@dataclass(frozen=True)
class Key:
    """A key of the scenario file in the words of the manual.

    `kinds` are the kinds of table with this key, empty if all kinds have it.
    """

    name: str
    type: str
    unit: str
    default: str
    allowed: str
    meaning: str
    kinds: tuple[str, ...] = ()

    @property
    def line(self) -> str:
        """Return the item of the key in Markdown."""
        value = f"{self.type} [{self.unit}]" if self.unit else self.type
        if self.allowed:
            value = self.allowed if value == "text" else f"{value}, {self.allowed}"
        words = {"required": "required", "none": "optional", "`[]`": "optional"}
        needed = words.get(self.default, f"default {self.default}")
        meaning = f"{', '.join(self.kinds)}: {self.meaning}" if self.kinds else self.meaning
        return f"- `{self.name}` ({value}; {needed}): {meaning}"


def reference() -> dict[str, str]:
    """Return the lists of keys in Markdown, by the name of the file's table.

    "scenario" is the top of the file. Equal tables appear once, under the first of their names.
    """
    whole, equal = schema(), dict[tuple[Key, ...], list[str]]()
    for name, tables in key_tables(whole):
        prefix = "" if name == "scenario" else f"{name}."
        keys = tuple(replace(key, name=key.name.removeprefix(prefix)) for key in table_keys(name, tables, whole))
        equal.setdefault(keys, []).append(prefix)
    return {
        prefixes[0].removesuffix(".") or "scenario": markdown(
            replace(key, name="`, `".join(prefix + key.name for prefix in prefixes)) for key in keys
        )
        for keys, prefixes in equal.items()
    }


def unit_of(key: str) -> str:
    """Return the unit of a dotted key in the notation of a sweep; empty for a key without unit.

    Entries of lists are included: ``piercing.exit.footprint``, ``thread.end.force.2``.
    """
    parts = key.split(".")
    fitting = [each for each in known_keys() if _is_within(each.name.split("."), parts)]
    return max(fitting, key=lambda each: len(each.name)).unit if fitting else ""


@cache
def known_keys() -> tuple[Key, ...]:
    """Return the keys of all tables, cached because the schema takes a second."""
    whole = schema()
    return tuple(each for name, tables in key_tables(whole) for each in table_keys(name, tables, whole))


def _is_within(some: list[str], parts: list[str]) -> bool:
    """Return whether `parts` contain all words of `some` in the same order.

    The first words must be equal.
    """
    rest = iter(parts)
    return some[0] == parts[0] and all(part in rest for part in some)


def markdown(keys: Iterable[Key]) -> str:
    """Return a list of keys in Markdown."""
    return "\n".join(["", *(key.line for key in keys), "", ""])


def key_tables(whole: Node) -> list[tuple[str, list[Node]]]:
    """List the tables of the file with their schemas, one schema per kind.

    A table comes before its inner tables.
    """
    return [("scenario", [whole]), *tables_below("", whole, whole)]


def tables_below(name: str, table: Node, whole: Node) -> Iterator[tuple[str, list[Node]]]:
    """Yield the tables inside a table, by their full names, like `key_tables`."""
    for key, field in table["properties"].items():
        inner = list(inner_tables(field, whole))
        if inner:
            yield f"{name}{key}", inner
        for kind in inner:
            yield from tables_below(f"{name}{key}.", kind, whole)


def inner_tables(field: Node, whole: Node) -> Iterator[Node]:
    """Yield the schemas of the tables of a key, one for each kind."""
    if "$ref" in field:
        yield whole["$defs"][field["$ref"].rpartition("/")[2]]
    for part in (*field.get("anyOf", ()), *field.get("oneOf", ()), *([field["items"]] if "items" in field else ())):
        yield from inner_tables(part, whole)


def table_keys(name: str, tables: list[Node], whole: Node) -> list[Key]:
    """List the keys of a table, each once, with the kinds that have it."""
    owners: dict[Key, list[str]] = {}
    for table in tables:
        kind = table["properties"].get("kind", {}).get("const", "")
        for key, field in table["properties"].items():
            full = key if name == "scenario" else f"{name}.{key}"
            owners.setdefault(key_of(full, field, key in table.get("required", ()), whole), []).append(kind)
    kinds = [key for key in owners if key.name.endswith(".kind") and len(tables) > 1]
    allowed = ", ".join(key.allowed for key in kinds)
    merged = [replace(key, allowed=allowed, meaning="kind of the table") for key in kinds[:1]]
    rest = [
        replace(key, kinds=() if len(owner) == len(tables) else tuple(owner))
        for key, owner in owners.items()
        if key not in kinds
    ]
    return [*merged, *rest]


def key_of(name: str, field: Node, required: bool, whole: Node) -> Key:
    """Return a key from its schema.

    The description in the schema has the unit, and the default if it is computed later.
    """
    text = field.get("description", "")
    units, found = UNIT.findall(text), DEFAULT.search(text)
    if found and field.get("default") is None:
        text = text.replace(found[0], "")
    default = "required" if required else default_of(field, found[1] if found else "none")
    meaning = UNIT.sub("", text) if len(units) == 1 else text
    return Key(name, type_of(field, whole), ", ".join(units), default, allowed_in(field), meaning)


def default_of(field: Node, words: str) -> str:
    """Return the default of a key in TOML, or these `words` if the schema has no default."""
    value = field.get("default")
    if value is None:
        return UNIT.sub("", words)
    if isinstance(value, Mapping):
        return f"`{as_toml({'kind': value['kind']})}`" if "kind" in value and len(value) <= 3 else "that of its keys"
    return f"`{as_toml(value)}`"


def type_of(field: Node, whole: Node) -> str:
    """Return the name of the type of a key's value."""
    if "anyOf" in field:
        return " or ".join(dict.fromkeys(type_of(part, whole) for part in field["anyOf"] if part.get("type") != "null"))
    if any(inner_tables(field, whole)):
        return "tables" if field.get("type") == "array" else "table"
    if "const" in field or "enum" in field:
        return "text"
    if field["type"] != "array":
        return TYPES[field["type"]]
    parts = field.get("prefixItems")
    inner = type_of(field["items"] if parts is None else parts[0], whole)
    several = f"rows of {inner}" if inner[0].isdigit() else f"{inner}s"
    if parts is not None:
        return f"{len(parts)} {several if len(parts) > 1 else inner}"
    return several


def allowed_in(field: Node) -> str:
    """Return the allowed values of a key beyond their type."""
    if "anyOf" in field:
        return ", ".join(filter(None, map(allowed_in, field["anyOf"])))
    if "const" in field or "enum" in field:
        return ", ".join(f"`{as_toml(word)}`" for word in field.get("enum", [field.get("const")]))
    bounds = [f"{sign} {field[word]:g}" for word, sign in BOUNDS.items() if word in field]
    if field.get("type") == "array":
        least = field.get("minItems", 0) if "items" in field else 0
        inner = allowed_in(field["items"] if "items" in field else field["prefixItems"][0])
        bounds = ([f"{least} or more"] if least else []) + ([f"each {inner.removeprefix('each ')}"] if inner else [])
    return ", ".join(bounds)


def title_of(name: str) -> str:
    """Return the title of a shipped scene."""
    return str(tomllib.loads(scene_text(name))["title"])


def cost_of(name: str) -> str:
    """Return the time and memory of a run of a shipped scene on one processor.

    They stand in the second line of the scene.
    """
    return scene_text(name).splitlines()[1].removeprefix("# about ")


def scene_text(name: str) -> str:
    """Read a shipped scene."""
    return (SCENES / f"{name}.toml").read_text(encoding="utf-8")


def rewritten(manual: str) -> str:
    """Return the manual with its lists of keys and of scenes updated; a scene has its title and cost."""
    listed = "".join(f"* [`{name}`](scenes/{name}.toml): {title_of(name)} ({cost_of(name)})\n" for name in scenes())
    return with_blocks(with_blocks(manual, "keys of", reference()), "list of", {"scenes": listed})


if __name__ == "__main__":
    MANUAL.write_text(rewritten(MANUAL.read_text(encoding="utf-8")), encoding="utf-8")
