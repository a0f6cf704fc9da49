"""CSV tables that grow by whole lines after each step, so a killed run leaves whole rows."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Generic

import numpy as np

from studies.output.columns import TABLES, Column, Layout, Row, headings
from studies.output.files import comma_separated
from studies.scenario import Scenario


class CsvFile(Generic[Row]):
    """A CSV file that grows by whole lines."""

    def __init__(self, path: Path, columns: Sequence[Column[Row]], last_step: int = -1) -> None:
        """``last_step``: rows up to this step are kept, for a resumed run."""
        self._columns = columns
        self._end = len(b"".join(rows_until(path, last_step))) if last_step >= 0 else 0
        self._file = path.open("r+b" if self._end else "wb", buffering=0)
        self._file.truncate(self._end)
        self._file.seek(self._end)
        if not self._end:
            self._write(head_of(columns))

    def append(self, rows: Iterable[Row]) -> None:
        """Append rows in one write; on a full disk, append none."""
        if data := lines_of(self._columns, rows):
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


def lines_of(columns: Sequence[Column[Row]], rows: Iterable[Row]) -> bytes:
    """Return the lines of rows.

    Numbers have all their digits, so that reading gives the same bits.
    """
    return comma_separated([cell for column in columns for cell in cells_of(column, row)] for row in rows).encode()


def cells_of(column: Column[Row], row: Row) -> list[Any]:
    """Return the cells of a column in a row, for a vector one for each component."""
    value: Any = column.of(row)
    if column.parts:
        return np.asarray(value, dtype=np.float64).tolist()
    return [float(value) if column.kind == "number" and value is not None else value]


def whole_table(columns: Sequence[Column[Row]], rows: Iterable[Row]) -> bytes:
    """Return a complete table as bytes."""
    return head_of(columns) + lines_of(columns, rows)


def head_of(columns: Iterable[Column[Any]]) -> bytes:
    """Return the first line of a table."""
    return comma_separated([headings(columns)]).encode()


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
