"""Printing and storage of the benchmarks' measurements, row by row, and the clock."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from time import process_time
from typing import Any

from threadpoolctl import threadpool_limits

from studies.lists import list_of
from studies.output.files import read_json, write_json
from studies.output.provenance import provenance

Numbers = dict[str, Any]  # the numbers of a case by name; None for a number that does not apply
COLUMNS, EVERY_CASE = list_of(__file__, "columns.toml"), list_of(__file__, "cases.toml")


def printed(table: str, rows: Iterable[Numbers]) -> list[Numbers]:
    """Print the rows of a table while they are measured, and return the rows.

    The measurement uses one thread of BLAS.
    """
    out, columns = [], COLUMNS[table]
    with threadpool_limits(limits=1, user_api="blas"):
        print(" ".join(aligned(head, width) for head, width, _ in columns))
        for row in rows:
            out.append(row)
            print(" ".join(aligned(cell(row, of), width) for _, width, of in columns), flush=True)
    return out


def aligned(text: str, width: int) -> str:
    """Return text aligned to the right in a width, or to the left for a negative width."""
    return text.ljust(-width) if width < 0 else text.rjust(width)


def cell(row: Numbers, of: str) -> str:
    """Return a number of a row as text, empty for None; `of` is its name and its format."""
    name, _, style = of.partition(":")
    value = row[name]
    return "" if value is None else format(value, style)


def time_call(call: Callable[[], object]) -> float:
    """Return the processor time of a call [s]."""
    began = process_time()
    call()
    return process_time() - began


def keep(path: Path | None, found: Mapping[str, Any]) -> int:
    """Add numbers to a JSON file, if given; return the exit status."""
    if path is not None:
        write_json(path, {**read_json(path), **found, "provenance": provenance()})
    return 0
