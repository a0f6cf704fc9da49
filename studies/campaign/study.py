"""The campaign: random realistic scenarios, how many complete, and the causes that end the others.

Scenarios are drawn at random from a seed (`studies.campaign.generator`) and run at default settings. Each ends in one
of five ways: it completes, is refused before its first step, or stops at a step, at a flip of the thread through a
hole, or at the bound on the corrections that a case may take. What stops is counted by its cause, which is read from
the error and from the state that it stopped in.

The first `quarter` cases are run again in steps a quarter as long where they complete, and the forces at their holes
and the lengths drawn through them are compared at the end. If they differ, the run should have a remark on its steps.

The energy that a step creates is reported for backward Euler and for BDF2 separately. Backward Euler creates none where
it goes downhill. The energy of BDF2 falls in a norm over two steps: a step may borrow energy and the next give it back.
Reported is what it creates beyond that loan (`coupling.run.watch`).

A case is gentle where its loads grow and a linear estimate moves its holes by less than three footprints. Those are
what a user expects to arrive; a hole that moves further is beyond a linear organ.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from coupling.errors import CouplingError, InversionError, StepError, TogetherError, TurnedHoleError, UphillError
from coupling.reports.audit import audit_step, is_of_bdf2
from coupling.reports.observation import span_ratio
from coupling.run.watch import CREATED, CREATED_BDF2, given_back
from coupling.step.diagnosis import frame_areas
from studies.campaign.asks import ASKS, asked
from studies.campaign.generator import KINDS, Case
from studies.campaign.quarter import PARTS, forces_apart, lengths_apart, with_shorter_steps
from studies.figure import COLOURS, Item, draw, panel, series
from studies.output.records import Ending, Extremes, nothing_met
from studies.scenario import ScenarioError, parse
from studies.simulation import prepare
from studies.simulation.memory import OrganRun
from studies.simulation.recording import step_record
from studies.study import Columns, Table, described, each, measure, measured, unit_field

ASKED = 0.97  # of the gentle cases to complete
ASKED_SUDDEN = 0.9  # of the sudden dead loads
TELLING = {"forces-swing", "numerical-dissipation", "energy-created"}  # of what the steps in time do
MOVING = "not-at-rest"  # of what moves still: its numbers are of a moment, and of any steps
LAYER = 2.0  # spans over √(EI/T) beyond which a flip is put down to spans that are too long
AGREED = 0.02  # of the largest force or length: a step over the shortest time in which a load grows, the first order
ALIKE = 0.002  # of the largest force or length: a tenth of that; a remark on the steps of such a run is a false alarm
TURNED = 0.8  # |u × v| of a hole below which a linear organ has turned it by more than 30°
COMPLETED = "completed"
CAUSES = (
    COMPLETED,
    "refused",
    "flip: spans longer than the bending layer",
    "flip: hole turned beyond a linear organ",
    "flip",
    "hole turned beyond a linear organ",
    "no step found",
    "another branch",
    "holes drawn together",
    "constraints",
    "corrections spent",
)


@dataclass(frozen=True, kw_only=True)
class Row:
    """How one case ended. `median` and `high` count Newton's corrections of accepted steps. `created` and
    `created_bdf2` are the largest energy that a step of each integrator created, over the energy in the system.
    `span_ratio` is that of the last state, `said` the codes of the run's remarks. `forces_apart` and `lengths_apart`
    compare with the same case in steps a quarter as long: NaN if that was not run, infinite if it did not complete."""

    number: int = measured("", lambda at: at.case.number)
    kind: str = measured("", lambda at: at.case.kind)
    ask: str = measured("", lambda at: at.case.ask)
    suture: str = measured("", lambda at: at.case.tables["thread"]["suture"])
    holes: int = measured("", lambda at: len(at.case.tables["piercing"]))
    youngs_modulus: float = measured("Pa", lambda at: at.case.tables["tissue"]["youngs_modulus"])
    demand: float = measured("footprints", lambda at: at.case.demand)
    gentle: bool = measured("", lambda at: at.case.gentle)
    cause: str = measured("", lambda at: at.end.cause)
    words: str = measured("", lambda at: at.end.words)
    time: float = measured("s", lambda at: at.tally.now.state.time if at.tally else 0.0)
    duration: float = measured("s", lambda at: at.case.tables["solve"]["duration"])
    steps: int = measured("", lambda at: len(at.taken))
    halved: int = measured("", lambda at: at.tally.halved if at.tally else 0)
    median: float = measured("corrections", lambda at: np.median(at.taken) if at.taken else np.nan)
    high: float = measured(
        "corrections, 99th percentile", lambda at: np.percentile(at.taken, 99) if at.taken else np.nan
    )
    created: float = measured("-", lambda at: at.tally.created if at.tally else 0.0)
    created_bdf2: float = measured("-", lambda at: at.tally.created_bdf2 if at.tally else 0.0)
    span_ratio: float = measured("-", lambda at: spans_of(at.tally.now) if at.tally else np.nan)
    said: str = measured("", lambda at: " ".join(at.end.said))
    forces_apart: float = unit_field("-", default=float("nan"))
    lengths_apart: float = unit_field("-", default=float("nan"))

    @property
    def completed(self) -> bool:
        """Whether the case arrived at its end."""
        return self.cause == COMPLETED

    @property
    def apart(self) -> float:
        """The larger of both distances [-]."""
        return max(self.forces_apart, self.lengths_apart)


@dataclass
class Tally:
    """Counts of a run during its steps."""

    now: OrganRun
    extremes: Extremes
    corrections: list[int] = field(default_factory=list)
    halved: int = 0
    created: float = 0.0
    created_bdf2: float = 0.0

    def follow(self, new: OrganRun) -> None:
        """Count a step."""
        if all(event.kind in ("taut", "slack") for event in new.events):  # others change what there is between steps
            for second, share in made_by(self.now, new):
                if second:
                    self.created_bdf2 = max(self.created_bdf2, share)
                else:
                    self.created = max(self.created, share)
        self.corrections.append(new.iterations)
        self.halved += len(new.taken) > 1
        self.extremes = self.extremes.after_step(step_record(new))
        self.now = new


@dataclass(frozen=True)
class End:
    """The end of a scenario: its `cause`, with the `words` of an error, the counts until then, None if it was refused,
    and the codes of its remarks, `said`."""

    cause: str
    words: str = ""
    tally: Tally | None = None
    said: tuple[str, ...] = ()


def made_by(now: OrganRun, new: OrganRun) -> Iterator[tuple[bool, float]]:
    """Yield for each accepted step between two runs, parts of steps included, whether it is of BDF2, and the relative
    energy that it created beyond what the previous step took [-]."""
    energies = now.energies
    for step in new.taken:
        after = audit_step(now.system, energies, step)
        made = energies.numerical_dissipation - after.numerical_dissipation - given_back(step, energies)
        yield is_of_bdf2(step), made / max(after.at_stake, np.finfo(float).tiny)
        energies = after


def main(seed: int = 1, first: int = 0, count: int = 300, most: int = 20_000, quarter: int = 11) -> Iterator[Row]:
    """Run the cases of a seed, each until it ends or has taken `most` corrections; the first `quarter` of those again
    in steps a quarter as long where they complete."""
    given = enumerate(asked(seed, count, first))
    yield from each([partial(run, case, most, number < quarter) for number, case in given])


def run(case: Case, most: int, quarter: bool = False) -> Row:
    """Run one case; `quarter`: again in steps a quarter as long, if it completes."""
    end = followed(case.tables, most)
    found = row(case, end)
    return compared(case, found, end, most) if quarter and found.completed else found


def followed(tables: dict[str, Any], most: int) -> End:
    """Run a scenario until it ends or has taken `most` corrections."""
    try:
        simulation = prepare(parse(tables))
    except (ScenarioError, ValueError) as error:
        return End("refused", str(error))
    scenario = simulation.scenario
    met = nothing_met(len(scenario.piercing), len(scenario.tie))
    tally, cause, words = Tally(simulation.beginning(), met), COMPLETED, ""
    try:
        while tally.now.number < simulation.steps:
            if sum(tally.corrections) > most:
                cause = "corrections spent"
                break
            tally.follow(simulation.next(tally.now))
    except CouplingError as error:
        cause, words = cause_of(error, tally.now), str(error)
    ending = Ending(step_record(tally.now), tally.extremes)
    return End(cause, words, tally, tuple(dict.fromkeys(each.code for each in simulation.remarks(ending))))


def compared(case: Case, found: Row, end: End, most: int) -> Row:
    """Return the row of a case with how far it is from the same case in steps a quarter as long."""
    other = followed(with_shorter_steps(case.tables), PARTS * most)
    if end.tally is None or other.tally is None or other.cause != COMPLETED:
        return replace(found, words=other.words, forces_apart=np.inf, lengths_apart=np.inf)
    pair = end.tally.now, other.tally.now
    return replace(found, forces_apart=forces_apart(*pair), lengths_apart=lengths_apart(*pair))


def spans_of(run: OrganRun) -> float:
    """Return the spans at the holes of a run over √(EI/T) [-]."""
    return span_ratio(run.system, run.state)


def cause_of(error: CouplingError, now: OrganRun) -> str:
    """Return the cause of an error, from its type and the state before it."""
    if isinstance(error, InversionError):
        if spans_of(now) > LAYER:
            return "flip: spans longer than the bending layer"
        smallest = frame_areas(now.state.y)[now.state.present].min(initial=1.0)
        return "flip: hole turned beyond a linear organ" if smallest < TURNED else "flip"
    if isinstance(error, TurnedHoleError):
        return "hole turned beyond a linear organ"
    if isinstance(error, TogetherError):
        return "holes drawn together"
    if isinstance(error, UphillError):
        return "another branch"
    return "no step found" if isinstance(error, StepError) else "constraints"


def row(case: Case, end: End) -> Row:
    """Return the row of a case."""
    taken = end.tally.corrections if end.tally else []
    return measure(Row, SimpleNamespace(case=case, end=end, tally=end.tally, taken=taken))


def share(rows: Sequence[Row]) -> str:
    """Write how many of the rows completed."""
    return f"{sum(row.completed for row in rows)} of {len(rows)}"


def count(cause: str) -> Callable[[tuple[str, list[Row]]], str]:
    """Return the writer of the number of a group's rows that ended by a cause."""
    return lambda group: str(sum(row.cause == cause for row in group[1]))


def middle(key: str) -> Callable[[tuple[str, list[Row]]], str]:
    """Return the writer of the median of a group's numbers of corrections."""
    return lambda group: f"{np.median(n):.3g}" if (n := [getattr(r, key) for r in group[1] if r.steps]) else "-"


COLUMNS: Columns = (
    ("kind", lambda group: group[0]),
    ("completed", lambda group: share(group[1])),
    *((cause, count(cause)) for cause in CAUSES[1:]),
    ("corrections, median", middle("median")),
    ("99th percentile", middle("high")),
)


def table(rows: Sequence[Row]) -> Table:
    """Make one line a kind of scenario and one for what else it asks for, then the gentle ones and all of them."""
    groups = {kind: [row for row in rows if row.kind == kind] for kind in KINDS}
    groups |= {ask: [row for row in rows if row.ask == ask] for ask in ASKS}
    return Table.of(COLUMNS, [*groups.items(), ("gentle", [row for row in rows if row.gentle]), ("all", rows)])


def remarks(rows: Sequence[Row]) -> list[str]:
    """Return remarks on completion and on steps that created energy, and list every case that did not complete."""
    gentle, sudden = [row for row in rows if row.gentle], [row for row in rows if row.kind == "sudden"]
    asked = (("gentle cases", gentle, ASKED), ("sudden dead loads", sudden, ASKED_SUDDEN))
    out = [arrived(name, group, share_asked) for name, group, share_asked in asked if group]
    out.append(makes("backward Euler", rows, [row.created for row in rows], CREATED))
    out.append(makes("BDF2", rows, [row.created_bdf2 for row in rows], CREATED_BDF2))
    return [*out, *agreement(rows)] + [
        f"case {row.number} ({row.kind}, {row.ask}, {row.suture}, demand {row.demand:.2g}): {row.cause} at "
        f"{row.time:.4g} of {row.duration:.4g} s, spans over layer {row.span_ratio:.2g}"
        for row in rows
        if not row.completed
    ]


def arrived(name: str, rows: Sequence[Row], asked: float) -> str:
    """Say how many of the rows of a name completed, and whether as many as were asked."""
    word = "" if sum(row.completed for row in rows) >= asked * len(rows) else ", which is TOO FEW"
    return f"{name} that completed: {share(rows)}{word} (asked are {asked:.0%})"


def makes(scheme: str, rows: Sequence[Row], made: Sequence[float], bound: float) -> str:
    """Say in how many cases a step of a `scheme` made more than a `bound` of the energy there was, `made` being the
    most of each [-]."""
    beyond = sum(part > bound for part in made)
    more, worst = f"made more than {bound:g} of the energy there was", int(np.argmax(made))
    text = f"cases in which a step of {scheme} {more}: {beyond} of {len(rows)}"
    return f"{text}, at most {made[worst]:.2g} of it (case {rows[worst].number})" if beyond else text


def agreement(rows: Sequence[Row]) -> list[str]:
    """Return how many of the repeated cases agree with steps a quarter as long, and for each other case the difference
    and its remarks, in words."""
    again = [row for row in rows if not np.isnan(row.forces_apart)]
    if not again:
        return []
    apart, alike = [row for row in again if row.apart > AGREED], [row for row in again if row.apart <= ALIKE]
    silent = [row for row in apart if not is_told(row)]
    moving = sum(MOVING in row.said.split() for row in silent)
    word = f", {len(silent)} of the others WITHOUT A REMARK on the steps, {moving} of them not at rest" if apart else ""
    return [
        f"cases whose forces and drawn lengths are within {AGREED:.0%} of those in steps a quarter as long: "
        f"{len(again) - len(apart)} of {len(again)}{word}",
        f"cases that are remarked on that agree within {ALIKE:.1%} all the same: "
        f"{sum(map(is_told, alike))} of {len(alike)}",
    ] + [
        f"case {row.number} ({row.kind}): forces by {row.forces_apart:.2g}, drawn lengths by {row.lengths_apart:.2g} "
        f"of the largest from those in steps a quarter as long; it says {row.said or 'nothing'}"
        for row in apart
    ]


def is_told(row: Row) -> bool:
    """Return whether a remark of the run is about its time steps."""
    return bool(set(row.said.split()) & TELLING)


def figure(rows: Sequence[Row]) -> Figure:
    """Draw how the cases of each kind ended, and where in demand and in spans over the layer."""
    shown = [row for row in rows if row.span_ratio > 0.0 and row.demand > 0.0]
    ended = {COMPLETED: [row for row in shown if row.completed], "not": [row for row in shown if not row.completed]}
    bars = [bar(k, rows) for k in range(len(CAUSES))]
    places = series(ended, "demand", "span_ratio", "", ["o", "x"])
    small = {"fontsize": 6}
    return draw(
        [
            panel("kind of scenario", "cases [-]", *bars, title="how they ended", legend=small),
            panel("demand [footprints]", "span over √(EI/T) [-]", places, log="x", title="where they ended"),
        ]
    )


def bar(k: int, rows: Sequence[Row]) -> Item:
    """Draw how many cases of each kind ended by the cause k, above those that ended by the causes before."""
    size, before = (
        np.array([sum(row.kind == kind and row.cause in causes for row in rows) for kind in KINDS])
        for causes in (CAUSES[k : k + 1], CAUSES[:k])
    )
    looks: dict[str, Any] = {
        "color": COLOURS[k % len(COLOURS)],
        "hatch": "//" if k >= len(COLOURS) else None,
        "label": CAUSES[k],
    }
    return lambda axes: size.any() and axes.bar(KINDS, size, bottom=before, **looks)


STUDY = described("campaign", main, table, figure, remarks)
