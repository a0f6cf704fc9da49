"""The grid of a sweep: the values of keys of a scenario, case by case."""

import csv
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from studies.scenario.table import ScenarioError
from studies.scenario.toml import override_key
from studies.study import value_of

MOST_CASES = 100_000  # with one file each

Settings = dict[str, Any]  # by dotted key


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
        override_key(f"{key}=0")
        values = value_of(value)
        if not isinstance(values, list) or not values:
            raise ScenarioError(
                f"--over {text} is refused: write a key, = and a list of values in TOML, for example "
                "--over 'tissue.youngs_modulus=[1e5, 2e5]'"
            )
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
        override_key(f"{key}=0")
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
