"""The numbers and words of a run's summary by their dotted names, each with its unit.

``piercings.exit.tension_after`` is in newton. A vector has a name for each component, as in the
tables: ``piercings.exit.force_x``. Wall-clock time differs between runs of a scenario and is not
included.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from studies.output.columns import ANY, SUMMARY, Column

LEFT_OUT = ("seconds_per_step", "provenance", "mesh", "remarks")  # wall-clock time, origin, and a list of sentences


@dataclass(frozen=True)
class Quantity:
    """A number, a word or None, with its `unit`.

    The unit is "-" for a number without unit, and empty for a word.
    """

    name: str
    unit: str
    value: float | int | str | bool | None


def quantities(summary: Mapping[str, Any]) -> dict[str, Quantity]:
    """Return all numbers and words of a summary by name, in its order."""
    kept = {key: value for key, value in summary.items() if key not in LEFT_OUT}
    return {found.name: found for found in leaves(kept, ())}


def leaves(table: Any, place: tuple[str, ...]) -> Iterator[Quantity]:
    """Yield the numbers and words below a place in a summary."""
    if isinstance(table, list | tuple) and any(isinstance(item, Mapping) for item in table):
        table = dict(enumerate(table))
    if isinstance(table, Mapping):
        for key, value in table.items():
            yield from leaves(value, (*place, str(key)))
        return
    column = column_at(place)
    unit = column.unit if column else ""
    if isinstance(table, Sequence) and not isinstance(table, str):
        parts = column.parts if column and column.parts else [f"{place[-1]}_{k}" for k in range(len(table))]
        for part, value in zip(parts, table, strict=False):
            yield Quantity(".".join([*place[:-1], part]), unit, value)
    else:
        yield Quantity(".".join(place), unit, table)


def column_at(place: tuple[str, ...]) -> Column[Any] | None:
    """Return the column of a summary's key, None if the key has no column."""
    for above, columns in SUMMARY.items():
        fits = len(above) + 1 == len(place) and all(a in (ANY, b) for a, b in zip(above, place, strict=False))
        found = next((column for column in columns if fits and column.name == place[-1]), None)
        if found is not None:
            return found
    return None
