"""The reference of the scenario file: made from the schema, complete, and standing in the manual."""

import re
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from studies.command import command
from studies.manual import with_blocks
from studies.scenario import load, scenes
from studies.scenario.reference import MANUAL, key_of, reference, rewritten
from studies.scenario.toml import tables


def written_keys(table: Mapping[str, Any], name: str = "") -> Iterator[str]:
    """Find the full names of the keys of a scenario in TOML, those of the tables in it too."""
    for key, value in table.items():
        yield f"{name}{key}"
        for inner in value if isinstance(value, list) else [value]:
            if isinstance(inner, Mapping):
                yield from written_keys(inner, f"{name}{key}.")


def test_the_manual_has_the_keys_of_today() -> None:
    """Independent check: each table stands in the manual between its marks, as the schema makes it."""
    manual = MANUAL.read_text(encoding="utf-8")
    assert sorted(re.findall(r"<!-- keys of (\S+) -->", manual)) == sorted(reference())
    assert rewritten(manual) == manual, "run `python -m studies.scenario.reference` to write the tables anew"
    for name, table in reference().items():
        assert f"<!-- keys of {name} -->\n{table}<!-- end -->" in manual


def test_the_reference_has_every_key_that_a_scene_writes() -> None:
    """Independent check: the scenes with all their defaults, as TOML names them."""
    cells = re.findall(r"^- `([^(]+)` \(", "".join(reference().values()), re.MULTILINE)
    listed = {name for cell in cells for name in cell.split("`, `")}
    for name in scenes():
        assert set(written_keys(tables(load(name)))) <= listed
    assert {"tissue.mesh.wall", "thread.end.turn", "piercing.channel", "tissue.region.depth"} <= listed


@pytest.mark.parametrize("name", scenes())
def test_the_manual_lists_every_scene(name: str) -> None:
    listed = re.search(rf"\[`{name}`\]\(scenes/{name}\.toml\): (.*) \((.*)\)\n", MANUAL.read_text(encoding="utf-8"))
    assert listed is not None and listed[1] == load(name).title
    assert re.fullmatch(r"\d+ (s|min), \d+(\.\d+)? GB", listed[2])


def test_a_key_in_words() -> None:
    """Independent check: lines written by hand; unit, default and bounds are taken from where the schema has them."""
    told = {"anyOf": [{"exclusiveMinimum": 0, "type": "number"}, {"type": "null"}], "default": None}
    key = key_of("thread.length", told | {"description": "rest length [m]; default: that of the path"}, False, {})
    assert key.line == "- `thread.length` (number [m], > 0; default that of the path): rest length"
    row = {"type": "array", "prefixItems": [{"type": "number"}, {"type": "number"}]}
    key = key_of("draw", {"type": "array", "items": row, "minItems": 1, "description": "t [s], length [m]"}, True, {})
    assert key.line == "- `draw` (rows of 2 numbers [s, m], 1 or more; required): t [s], length [m]"
    key = key_of("kind", {"enum": ["a", "b"], "default": "a", "type": "string", "description": "a | b"}, False, {})
    assert key.line == '- `kind` (`"a"`, `"b"`; default `"a"`): a | b'


def test_blocks_of_other_marks_stay() -> None:
    text = "<!-- keys of a -->\nold\n<!-- end -->\n<!-- rows of a -->\nkept\n<!-- end -->\n"
    assert with_blocks(text, "keys of", {"a": "new\n"}) == text.replace("old", "new")


def test_the_schema_as_tables(capsys: pytest.CaptureFixture[str]) -> None:
    """Consistency check: the command prints what the manual has."""
    assert command.main(["schema", "--table"]) == 0
    printed = capsys.readouterr().out
    assert all(f"## {name}\n\n{table}" in printed for name, table in reference().items())
