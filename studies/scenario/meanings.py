"""The meanings of the keys of a scenario and examples of their values, from `keys.toml`."""

import tomllib
from pathlib import Path
from typing import Any, NamedTuple

KEYS = tomllib.loads(Path(__file__).with_name("keys.toml").read_text(encoding="utf-8"))


class Meaning(NamedTuple):
    """The meaning of a key with its unit in brackets, and examples of its value."""

    text: str = ""
    examples: tuple[Any, ...] = ()

    def added_to(self, field: dict[str, Any]) -> dict[str, Any]:
        """Return the JSON schema of a key with its meaning and its examples."""
        told = {"description": self.text, "examples": list(self.examples)}
        return field | {name: value for name, value in told.items() if value}


def meaning_of(table: type, key: str) -> Meaning:
    """Return the meaning of a key of a table, which a base class of the table can have."""
    entry = next((KEYS[kind.__name__][key] for kind in table.__mro__ if key in KEYS.get(kind.__name__, ())), "")
    return Meaning(entry) if isinstance(entry, str) else Meaning(entry[0], tuple(entry[1:]))
