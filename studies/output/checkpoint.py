"""Checkpoints: everything that the next step depends on, in one file, complete or absent.

``checkpoint.npz`` holds one record with every array of a run's memory in full precision, under the
name of its field. Eighty files, one per array, took five times as long. A resumed run computes the
same numbers, bit by bit, as a run that was never interrupted.
"""

import hashlib
import io
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from studies.output.files import write_bytes
from studies.scenario import ScenarioError

CHECKPOINT = "checkpoint.npz"
CHECKSUM_LENGTH = 64  # hexadecimal digits of SHA-256
ANEW = "run with --overwrite to start again"

Arrays = Mapping[str, NDArray[Any]]
Record = TypeVar("Record")


def pack(record: Any, name: str) -> dict[str, NDArray[Any]]:
    """Return the fields of a dataclass as arrays.

    A nested dataclass has names ``name.field``. A field that is None is left out.
    """
    out: dict[str, NDArray[Any]] = {}
    for field in fields(record):
        value, key = getattr(record, field.name), f"{name}.{field.name}"
        if is_dataclass(value):
            out |= pack(value, key)
        elif value is not None:
            out[key] = np.asarray(value)
    return out


def unpack(like: Record, arrays: Arrays, name: str, nested: Mapping[str, Any] = MappingProxyType({})) -> Record:
    """Build a dataclass of the type of ``like`` from its arrays.

    If a field of ``like`` is None, ``nested`` gives a model of the dataclass in this field. Raises
    ``KeyError`` if an array is missing for a field that is not None in ``like``.
    """
    values: dict[str, Any] = {}
    for field in fields(like):  # type: ignore[arg-type]
        model, key = getattr(like, field.name), f"{name}.{field.name}"
        if key in arrays:
            values[field.name] = float(arrays[key]) if arrays[key].ndim == 0 else np.array(arrays[key])
        elif any(other.startswith(f"{key}.") for other in arrays):
            values[field.name] = unpack(nested[field.name] if model is None else model, arrays, key, nested)
        elif model is None:
            values[field.name] = None
        else:
            raise KeyError(key)
    return replace(like, **values)  # type: ignore[type-var]


def write_checkpoint(folder: Path, arrays: Arrays) -> None:
    """Replace the folder's checkpoint."""
    given = {name: np.asarray(array) for name, array in arrays.items()}
    record = np.empty((), dtype=[(name, array.dtype, array.shape) for name, array in given.items()])
    for name, array in given.items():
        record[name] = array
    data = io.BytesIO()
    np.savez(data, record=record)
    write_bytes(folder / CHECKPOINT, sealed(data.getvalue()))


def read_checkpoint(folder: Path) -> dict[str, NDArray[Any]] | None:
    """Read the folder's checkpoint; None if the run was stopped before its first checkpoint.

    Raises `ScenarioError` if the file differs from the written one in any bit, or was written by
    another version.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        return None
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ScenarioError(f"{path} cannot be read ({error.strerror}); {ANEW}") from None
    if not is_sealed(data):
        raise ScenarioError(f"{path} is damaged: its checksum differs; {ANEW}")
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        found = dict(file)
    if found.keys() != {"record"}:
        raise ScenarioError(f"{path} is of another version of this code; {ANEW}")
    return {name: found["record"][name].copy() for name in found["record"].dtype.names or ()}


def sealed(archive: bytes) -> bytes:
    """Return a zip archive with the checksum of its content as its comment.

    The given archive has no comment. The last two bytes of an archive are the length of its comment
    (PKWARE, .ZIP File Format Specification, 4.3.16).
    """
    body = archive[:-2] + CHECKSUM_LENGTH.to_bytes(2, "little")
    return body + hashlib.sha256(body).hexdigest().encode()


def is_sealed(data: bytes) -> bool:
    """Return whether an archive ends with the checksum of its content."""
    body, checksum = data[:-CHECKSUM_LENGTH], data[-CHECKSUM_LENGTH:]
    return hashlib.sha256(body).hexdigest().encode() == checksum


def first_in_words(changed: Mapping[str, tuple[Any, Any]]) -> str | None:
    """Return in words the old and new value of the first key found by `changes`, or None."""
    for key, values in changed.items():
        was, now = ("not given" if value is None else repr(value) for value in values)
        return f"{key} was {was} and is {now}"
    return None


def changes(before: str, now: str) -> dict[str, tuple[Any, Any]]:
    """Return the keys that differ between two scenarios in TOML, in order, with both values.

    None for a missing value.
    """
    old, new = (dict(leaves(tomllib.loads(text))) for text in (before, now))
    keys = sorted(key for key in old.keys() | new.keys() if old.get(key) != new.get(key))
    return {key: (old.get(key), new.get(key)) for key in keys}


def leaves(table: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted keys of nested tables with their values, in the order of the keys."""
    match table:
        case dict():
            for name in sorted(table):
                yield from leaves(table[name], f"{key}.{name}" if key else name)
        case list() if table and all(isinstance(item, dict) for item in table):
            for index, item in enumerate(table):
                yield from leaves(item, f"{key}.{item.get('name', index)}")
        case _:
            yield key, table
