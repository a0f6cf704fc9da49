"""The words of a scenario: meanings of its keys and examples of their values, and reasons for refusals."""

from typing import Any, NamedTuple

from studies.lists import list_of

KEYS, REASONS = list_of(__file__, "keys.toml"), list_of(__file__, "refusals.toml")


class Meaning(NamedTuple):
    """The meaning of a key with its unit in brackets, and examples of its value."""

    text: str = ""
    examples: tuple[Any, ...] = ()

    def added_to(self, field: dict[str, Any]) -> dict[str, Any]:
        """Return the JSON schema of a key with its meaning and its examples."""
        words = {"description": self.text, "examples": list(self.examples)}
        return field | {name: value for name, value in words.items() if value}


def meaning_of(table: type, key: str) -> Meaning:
    """Return the meaning of a key of a table, which a base class of the table can have."""
    entry = next((KEYS[kind.__name__][key] for kind in table.__mro__ if key in KEYS.get(kind.__name__, ())), "")
    return Meaning(entry) if isinstance(entry, str) else Meaning(entry[0], tuple(entry[1:]))


def reason_of(table: type, name: str) -> str:
    """Return the reason for a refusal by a table, which a base class of the table can have."""
    return next(REASONS[kind.__name__][name] for kind in table.__mro__ if name in REASONS.get(kind.__name__, ()))


def because(name: str, /, **values: object) -> str:
    """Return the reason of this name for a refusal by a function, with the values that the reason names."""
    return str(REASONS["functions"][name].format(**values))
