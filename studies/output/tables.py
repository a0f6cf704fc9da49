"""CSV tables that grow by whole lines after each step, so a killed run leaves whole rows."""

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Generic

import numpy as np

from studies.output.columns import TABLES, Column, Layout, Row, Value, headings
from studies.scenario import Scenario

SPECIAL = re.compile(r'[",\r\n]')  # text with one of these is quoted


class CsvFile(Generic[Row]):
    """A CSV file that grows by whole lines."""

    def __init__(self, path: Path, columns: Sequence[Column[Row]], last_step: int = -1) -> None:
        """``last_step``: rows up to this step are kept, for a resumed run."""
        self._line = line_writer(columns)
        self._end = len(b"".join(rows_until(path, last_step))) if last_step >= 0 else 0
        self._file = path.open("r+b" if self._end else "wb", buffering=0)
        self._file.truncate(self._end)
        self._file.seek(self._end)
        if not self._end:
            self._write(head_of(columns))

    def append(self, rows: Iterable[Row]) -> None:
        """Append rows in one write; on a full disk, append none."""
        data = "".join([self._line(row) for row in rows]).encode()
        if data:
            self._write(data)

    def close(self) -> None:
        self._file.close()

    def _write(self, data: bytes) -> None:
        try:
            if self._file.write(data) != len(data):
                raise OSError(f"{self._file.name} cannot grow: the disk is full; free disk space")
        except OSError:
            self._file.truncate(self._end)
            self._file.seek(self._end)
            raise
        self._end += len(data)


def line_writer(columns: Sequence[Column[Row]]) -> Callable[[Row], str]:
    """Return a function that makes a line of a row."""
    cells = [(column.of, writer_of(column)) for column in columns]
    return lambda row: ",".join([write(of(row)) for of, write in cells]) + "\n"


def whole_table(columns: Sequence[Column[Row]], rows: Iterable[Row]) -> bytes:
    """Return a complete table as bytes."""
    return head_of(columns) + "".join(map(line_writer(columns), rows)).encode()


def writer_of(column: Column[Any]) -> Callable[[Any], str]:
    """Return the function that writes a value as the cells of a row.

    A number that is None gives an empty cell.
    """
    if column.parts:
        return _numbers
    return {"number": _number, "whole": _whole, "text": _quoted}[column.kind]


def _number(value: Value) -> str:
    """Return a number with all its digits, so that reading gives the same bits."""
    return "" if value is None else repr(float(value))  # type: ignore[arg-type]


def _numbers(value: Value) -> str:
    """Return the components of a vector; `tolist` gives Python floats, which are fast to write."""
    return ",".join(map(repr, np.asarray(value, dtype=np.float64).tolist()))


def _whole(value: Value) -> str:
    return "" if value is None else str(value)


def _quoted(value: str) -> str:
    return '"' + value.replace('"', '""') + '"' if SPECIAL.search(value) else value


def head_of(columns: Iterable[Column[Any]]) -> bytes:
    """Return the first line of a table."""
    return (",".join(headings(columns)) + "\n").encode()


def rows_until(path: Path, step: int) -> list[bytes]:
    """Read a table's head and its rows up to a step, as whole lines.

    The step is the second column of every table.

    Raises `ValueError` for a row without a step there, and `IndexError` for a row without a second
    column.
    """
    head, *rows = path.read_bytes().splitlines(keepends=True)
    return [head, *(row for row in rows if row.endswith(b"\n") and int(row.split(b",")[1]) <= step)]


def tables_of(scenario: Scenario) -> list[Layout[Any]]:
    """List the tables that a run of the scenario writes."""
    organ = scenario.tissue
    absent = {"ties": not scenario.tie, "loads": organ is None or not organ.load, "tracts": not scenario.tract}
    absent |= dict.fromkeys(("contact", "stitches"), not scenario.wounds)
    return [layout for layout in TABLES if not absent.get(layout.name)]
