"""Files that are complete or absent: written under a temporary name in their folder, then renamed.

A file that is damaged nevertheless is read as empty.
"""

import csv
import io
import json
import math
import os
import re
from collections.abc import Container, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

UNFINISHED = re.compile(r"\.(.+)\.\d+")  # a file before its renaming: its later name and the process that writes it


def unfinished(folder: Path, names: Container[str] | None = None) -> list[Path]:
    """List the temporary files of a killed process for the given names; None for any name."""
    here = folder.iterdir() if folder.is_dir() else ()
    found = ((path, UNFINISHED.fullmatch(path.name)) for path in here)
    return [path for path, match in found if match and (names is None or match[1] in names)]


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, complete or not at all."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Write a text file, complete or not at all."""
    write_bytes(path, text.encode())


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write JSON, with null for numbers that are not finite."""
    write_text(path, as_json(value))


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object; empty if the file is missing or damaged."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def as_json(value: Mapping[str, Any]) -> str:
    """Return JSON, with null for numbers that are not finite."""
    return json.dumps(_plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def comma_separated(lines: Iterable[Iterable[Any]]) -> str:
    """Return lines of cells in CSV; a cell that is None is empty."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue()


def _plain(value: Any) -> Any:
    """Return the value with plain lists and numbers, and None for a number that is not finite."""
    match value:
        case Mapping():
            return {str(key): _plain(item) for key, item in value.items()}
        case np.ndarray() | list() | tuple():
            return [_plain(item) for item in value]
        case np.generic():
            return _plain(value.item())
        case float():
            return value if math.isfinite(value) else None
        case _:
            return value
