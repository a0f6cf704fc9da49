"""Seeded mutations of text and of tables, the same for the same random numbers."""

import re
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from functools import partial
from random import Random
from typing import Any

NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?(?![\w.])")
NUMBERS = [b"0", b"-1", b"1", b"7", b"99999", b"1e308", b"-1e308", b"1e-308", b"nan", b"inf", b"2147483648", b"1e19"]
VALUES: list[Any] = [
    *(0, -1, 1, 2, 3, 10**9, 10**30, -(10**400), 0.0, -0.0, 1e-9, 1e-3, 0.5, 1.0, 1e3, 1e9, 1e308, 5e-324, -1e308),
    *(float("nan"), float("inf"), float("-inf"), True, False, "", "x", "normal", "free", "é" * 40, "y" * 2000),
    *([], {}, [[]], [0.0], [0.0, 0.0, 0.0], [1e308] * 3, [[0, 0], [1, 1]], {"kind": "free"}, {"kind": "x"}, ["bottom"]),
]
SCALES = [1e-12, 1e-6, 1e-3, 0.1, 0.5, 0.9, 1.1, 2.0, 10.0, 1e3, 1e6, 1e12, -1.0]


def mutated_bytes(data: bytes, random: Random) -> bytes:
    """Change one to three places of a file."""
    for _ in range(random.choice((1, 1, 2, 3))):
        data = random.choice((_flipped, _renumbered, _renumbered, _line_lost, _line_twice, _cut, _spliced))(
            data, random
        )
    return data


def _flipped(data: bytes, random: Random) -> bytes:
    place = random.randrange(max(len(data), 1))
    return data[:place] + bytes([data[place] ^ 1 << random.randrange(8)]) + data[place + 1 :] if data else data


def _renumbered(data: bytes, random: Random) -> bytes:
    found = list(NUMBER.finditer(data))
    if not found:
        return _flipped(data, random)
    chosen = random.choice(found)
    other = random.choice(found)[0] if random.random() < 0.5 else random.choice(NUMBERS)
    return data[: chosen.start()] + other + data[chosen.end() :]


def _line_lost(data: bytes, random: Random) -> bytes:
    lines = data.splitlines(keepends=True)
    place = random.randrange(max(len(lines), 1))
    return b"".join(lines[:place] + lines[place + 1 :])


def _line_twice(data: bytes, random: Random) -> bytes:
    lines = data.splitlines(keepends=True)
    place = random.randrange(max(len(lines), 1))
    return b"".join(lines[: place + 1] + lines[place:])


def _cut(data: bytes, random: Random) -> bytes:
    return data[: random.randrange(max(len(data), 1))]


def _spliced(data: bytes, random: Random) -> bytes:
    start, end = sorted(random.randrange(max(len(data), 1)) for _ in range(2))
    place = random.randrange(max(len(data), 1))
    return data[:place] + data[start : min(end, start + 200)] + data[place:]


def mutated_tables(data: dict[str, Any], random: Random, keys: Sequence[str] = ()) -> dict[str, Any]:
    """Change one to three values of nested tables, or their keys, or add one of the `keys`."""
    data, added = deepcopy(data), [partial(_add, keys=keys)] if keys else []
    for _ in range(random.choice((1, 1, 2, 3))):
        places = list(_places(data))
        holder, key = random.choice(places)
        change: Callable[..., None] = random.choice(
            (_replace, _scale, _scale, _copy, _remove, _rename, _repeat, *added)
        )
        change(holder, key, random, places)
    return data


def _places(table: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every value of nested tables and lists by what holds it and its key."""
    for key in list(table) if isinstance(table, dict) else range(len(table)):
        yield table, key
        if isinstance(table[key], dict | list):
            yield from _places(table[key])


def _replace(holder: Any, key: Any, random: Random, places: list[tuple[Any, Any]]) -> None:
    holder[key] = deepcopy(random.choice(VALUES))


def _scale(holder: Any, key: Any, random: Random, places: list[tuple[Any, Any]]) -> None:
    value = holder[key]
    if isinstance(value, int | float) and not isinstance(value, bool):
        scaled = value * random.choice(SCALES)
        holder[key] = int(scaled) if isinstance(value, int) and abs(scaled) < 1e18 else scaled


def _copy(holder: Any, key: Any, random: Random, places: list[tuple[Any, Any]]) -> None:
    other, place = random.choice(places)
    if place in other if isinstance(other, dict) else place < len(other):
        holder[key] = deepcopy(other[place])


def _remove(holder: Any, key: Any, random: Random, places: list[tuple[Any, Any]]) -> None:
    del holder[key]


def _rename(holder: Any, key: Any, random: Random, places: list[tuple[Any, Any]]) -> None:
    if isinstance(holder, dict):
        place = random.randrange(len(key)) if key else 0
        holder[key[:place] + random.choice("aeiosx_ ") + key[place + 1 :]] = holder.pop(key)


def _add(holder: Any, key: Any, random: Random, places: list[tuple[Any, Any]], keys: Sequence[str]) -> None:
    """Give a table a key with a value that another one has, or with any."""
    if isinstance(holder, dict):
        added = random.choice(keys)
        same = [other[place] for other, place in places if place == added] or VALUES
        holder[added] = deepcopy(random.choice(same))


def _repeat(holder: Any, key: Any, random: Random, places: list[tuple[Any, Any]]) -> None:
    if isinstance(holder, list):
        holder.insert(key, deepcopy(holder[key]))
