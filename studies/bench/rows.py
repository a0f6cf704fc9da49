"""Printing and storage of the benchmarks' measurements, row by row, and the clock."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from time import process_time
from types import SimpleNamespace
from typing import Any

from threadpoolctl import threadpool_limits

from studies.lists import list_of
from studies.output.files import read_json, write_json
from studies.output.provenance import provenance
from studies.simulation.memory import OrganRun
from studies.study import cell

Numbers = dict[str, Any]  # the numbers of a case by name; None for a number that does not apply
COLUMNS, EVERY_CASE = list_of(__file__, "columns.toml"), list_of(__file__, "cases.toml")


def printed(table: str, rows: Iterable[Numbers]) -> list[Numbers]:
    """Print the rows of a table in Markdown while they are measured, and return the rows.

    The measurement uses one thread of BLAS.
    """
    heads, cells = zip(*COLUMNS[table], strict=True)
    out = []
    with threadpool_limits(limits=1, user_api="blas"):
        print(f"| {' | '.join(heads)} |\n|" + "---|" * len(heads))
        for row in rows:
            out.append(row)
            print(f"| {' | '.join(cell(of, SimpleNamespace(**row)) for of in cells)} |", flush=True)
    return out


def time_call(call: Callable[[], object]) -> float:
    """Return the processor time of a call [s]."""
    began = process_time()
    call()
    return process_time() - began


def steps_in_turn(
    runs: Sequence[OrganRun], take: Callable[[OrganRun], OrganRun], count: int
) -> Iterator[tuple[list[OrganRun], list[float]]]:
    """Yield runs after each of a number of steps, which they `take` in turn.

    The processor times of the steps are given too [s].
    """
    now = list(runs)
    for _ in range(count):
        times = []
        for k, run in enumerate(now):
            began = process_time()
            now[k] = take(run)
            times.append(process_time() - began)
        yield list(now), times


def keep(path: Path | None, found: Mapping[str, Any]) -> int:
    """Add numbers to a JSON file, if given; return the exit status."""
    if path is not None:
        write_json(path, {**read_json(path), **found, "provenance": provenance()})
    return 0
