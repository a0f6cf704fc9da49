"""The campaign: random realistic scenarios, how many complete, and the causes of the other ends.

Scenarios are drawn at random from a seed (`studies.campaign.generator`) and run at default
settings, like the cases of a sweep. Each completes, is refused before its first step, or stops at a
step; the class of the error is its cause.

The first `quarter` cases that complete are run again with a quarter of the step. The forces at
their holes and the lengths drawn through them are compared at the end. If they differ, the run
should have a remark on its steps.

A case is gentle if its loads grow and a linear estimate moves its holes by less than three
footprints. Users expect these cases to complete; a hole that moves further is beyond a linear
organ.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure

from studies.campaign.generator import ASKS, KINDS, Case, asked
from studies.figure import draw, panel, series
from studies.study import Table, each, grouped, measure, measured, unit_field
from studies.sweeps.case import Result, run_case
from thread.catalogue import suture

TELLING = {"forces-swing", "numerical-dissipation", "energy-created"}  # codes of remarks on the effects of time steps
AGREED = 0.02  # of the largest force or length: the step over the shortest growth of a load, the first-order error
ALIKE = 0.002  # of the largest force or length: a tenth of AGREED, at which a remark on the steps is a false alarm
PARTS = 4  # number of parts of a step in the repeated run
COMPLETED = "completed"


@dataclass(frozen=True, kw_only=True)
class Row:
    """The end of one case.

    `cause` is the class of the error, `said` are the codes of the run's remarks. `apart` is the
    difference of forces and drawn lengths to the same case with a quarter of the step, over the
    largest. NaN means no second run, and infinity a second run that did not complete.
    """

    number: int = measured("", lambda at: at.case.number)
    kind: str = measured("", lambda at: at.case.kind)
    ask: str = measured("", lambda at: at.case.ask)
    suture: str = measured("", lambda at: at.case.tables["thread"]["suture"])
    demand: float = measured("footprints", lambda at: at.case.demand)
    gentle: bool = measured("", lambda at: at.case.gentle)
    cause: str = measured("", lambda at: at.result.failure or COMPLETED)
    time: float = measured("s", lambda at: at.found.get("time", 0.0))
    span_ratio: float = measured("-", lambda at: at.found.get("thread", {}).get("span_ratio", np.nan))
    said: str = measured("", lambda at: " ".join(dict.fromkeys(each["code"] for each in at.found.get("remarks", ()))))
    apart: float = unit_field("-", default=float("nan"))


def main(seed: int = 1, first: int = 0, count: int = 300, quarter: int = 11) -> Iterator[Row]:
    """Yield the cases of a seed.

    The first `quarter` cases that complete are repeated with a quarter of the step.
    """
    yield from each([partial(run, case, number < quarter) for number, case in enumerate(asked(seed, count, first))])


def run(case: Case, quarter: bool = False) -> Row:
    """Return the row of one case.

    With `quarter` the case is repeated with a quarter of the step, if it completes.
    """
    result = run_case(case.tables)
    found = measure(Row, SimpleNamespace(case=case, result=result, found=result.summary))
    if not quarter or found.cause != COMPLETED:
        return found
    solve = case.tables["solve"]
    finer = {"dt": solve["dt"] / PARTS} if "dt" in solve else {"load_steps": PARTS * solve["load_steps"]}
    other = run_case(case.tables | {"solve": solve | finer})
    return replace(found, apart=np.inf if other.failure else apart(result, other, found.suture))


def apart(one: Result, other: Result, thread: str) -> float:
    """Return the largest difference of forces or drawn lengths at a hole [-].

    It is relative to the largest force or length. Lengths are compared with the thread's diameter
    if it is larger.
    """
    far = []
    for key, scale in (("force", np.finfo(float).tiny), ("slip", suture(thread).diameter)):
        values, others = (np.array([hole[key] for hole in run.summary["piercings"].values()]) for run in (one, other))
        away, largest = (np.linalg.norm(x.reshape(len(x), -1), axis=1).max() for x in (values - others, others))
        far.append(float(away / max(largest, scale)))
    return max(far)


def share(rows: Sequence[Row]) -> str:
    """Return the number of completed rows in words."""
    return f"{sum(row.cause == COMPLETED for row in rows)} of {len(rows)}"


def table(rows: Sequence[Row]) -> Table:
    """Return the table with a line for each kind and each request.

    The last lines are for the gentle cases and for all cases. Each cause has a column.
    """
    groups = {name: [row for row in rows if name in (row.kind, row.ask)] for name in (*KINDS, *ASKS)}
    groups |= {"gentle": [row for row in rows if row.gentle], "all": list(rows)}
    causes = sorted({row.cause for row in rows} - {COMPLETED})
    counts = {name: [str(sum(row.cause == cause for row in of)) for cause in causes] for name, of in groups.items()}
    return Table(["kind", COMPLETED, *causes], [[name, share(of), *counts[name]] for name, of in groups.items()])


def remarks(rows: Sequence[Row]) -> Iterator[str]:
    """Yield remarks on completion, on created energy, and on every case that did not complete."""
    created = [str(row.number) for row in rows if "energy-created" in row.said.split()]
    gentle, sudden = [row for row in rows if row.gentle], [row for row in rows if row.kind == "sudden"]
    yield arrived("gentle cases", gentle, 0.97)
    yield arrived("sudden dead loads", sudden, 0.9)
    yield f"cases whose steps created energy: {len(created)} of {len(rows)} {', '.join(created)}".strip()
    yield from agreement(rows)
    for row in (row for row in rows if row.cause != COMPLETED):
        yield f"case {row.number} ({row.kind}, {row.ask}): {row.cause} at {row.time:.4g} s"


def arrived(name: str, rows: Sequence[Row], asked: float) -> str:
    """Return the number of completed rows in words, and whether this reaches the share `asked`."""
    word = "" if sum(row.cause == COMPLETED for row in rows) >= asked * len(rows) else ", which is TOO FEW"
    return f"{name} that completed: {share(rows)}{word} (required: {asked:.0%})"


def agreement(rows: Sequence[Row]) -> list[str]:
    """Return in words how many repeated cases agree with their first run.

    Each other case is listed with its difference and its remarks.
    """
    again = [row for row in rows if not np.isnan(row.apart)]
    far, alike = [row for row in again if row.apart > AGREED], [row for row in again if row.apart <= ALIKE]
    remarked = [row for row in again if set(row.said.split()) & TELLING]
    return [
        f"cases within {AGREED:.0%} of their repetition with a quarter of the step: {len(again) - len(far)} of "
        f"{len(again)}, {sum(row not in remarked for row in far)} of the others WITHOUT A REMARK on the steps",
        f"cases with a remark, but within {ALIKE:.1%}: {sum(row in remarked for row in alike)} of {len(alike)}",
        *(f"case {row.number} ({row.kind}): difference {row.apart:.2g}; remarks: {row.said or 'none'}" for row in far),
    ]


def figure(rows: Sequence[Row]) -> Figure:
    """Return the figure of the ends of the cases over demand and span ratio, by cause."""
    ended = series(grouped(rows, lambda row: row.cause), "demand", "span_ratio", "", markersize=4)
    return draw([panel("demand [footprints]", "span over √(EI/T) [-]", ended, log="x", title="where they ended")], 1)
