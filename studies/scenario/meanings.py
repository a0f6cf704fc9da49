"""The words of a scenario: meanings of its keys, and reasons for refusals."""

from typing import Any

from studies.lists import list_of

KEYS, REASONS = list_of(__file__, "keys.toml"), list_of(__file__, "refusals.toml")
FORMER = REASONS.pop("former")  # keys of earlier versions, by the class of their table


def meaning_of(table: type, key: str) -> tuple[str, list[Any]]:
    """Return the meaning of a key of a table with its unit in brackets, and examples of its value.

    A base class of the table can have the meaning. Without a meaning the text is empty.
    """
    entry = next((KEYS[kind.__name__][key] for kind in table.__mro__ if key in KEYS.get(kind.__name__, ())), "")
    return (entry, []) if isinstance(entry, str) else (entry[0], entry[1:])


def reason_of(table: type, name: str) -> str:
    """Return the reason for a refusal by a table, which a base class of the table can have."""
    return next(REASONS[kind.__name__][name] for kind in table.__mro__ if name in REASONS.get(kind.__name__, ()))


def because(name: str, /, **values: object) -> str:
    """Return the reason of this name for a refusal by a function, with its values."""
    return str(REASONS["functions"][name].format(**values))
