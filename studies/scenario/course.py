"""The course of a load over time: keys `course`, `from` and `until` of a load.

The load is on the organ or on an end of the thread. A course is rows of time [s] and factor [-],
linear in between. A named course is converted into rows; a wave has WAVE rows in each period.
"""

from itertools import pairwise
from math import ceil, cos, floor, inf, pi
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from studies.scenario.refusal import as_toml
from studies.scenario.table import ScenarioTable, check_ending, check_rising
from studies.scenario.values import From, NotNegative, Number, Positive, Turn, one_sentence

WAVE = 32  # rows per period: with linear interpolation the error is 0.25 % of the wave's height
JUMP = 1e-9  # of a time: duration of a sudden change of a load, longer than the round-off of a step's end
STEPS = 4  # per wave: fewer steps can miss its height by more than a seventh
MISSED = 1.0 / 7.0  # of the range of a load: the same limit at its other turns
COUGH = 0.4  # s, from the rise of the abdominal pressure to its end


class Ramp(ScenarioTable):
    """Linear growth from zero, and the whole load from then on."""

    kind: Literal["ramp"]
    over: Positive

    def rows(self, end: float) -> list[Turn]:
        """Return the rows of the course until `end` [s]."""
        return [(0.0, 0.0), (self.over, 1.0)]


class Hold(ScenarioTable):
    """Linear growth from zero, the whole load for some time, and linear decay to zero."""

    kind: Literal["hold"]
    rise: Positive
    hold: Positive
    fall: Positive

    def rows(self, end: float) -> list[Turn]:
        """Return the rows of the course until `end` [s]."""
        top = self.rise + self.hold
        return [(0.0, 0.0), (self.rise, 1.0), (top, 1.0), (top + self.fall, 0.0)]


class Cycle(ScenarioTable):
    """Cosine wave that starts at a low factor and rises to the whole load."""

    kind: Literal["cycle"]
    period: Positive
    low: Number = 0.0

    def rows(self, end: float) -> list[Turn]:
        """Return the rows of the course until `end` [s]."""
        times = (self.period * k / WAVE for k in range(WAVE * ceil(end / self.period) + 1))
        return [(time, self.low + (1.0 - self.low) * rise(time / self.period)) for time in times]


class Cough(ScenarioTable):
    """One cosine wave from zero to the whole load and back."""

    kind: Literal["cough"]
    at: NotNegative = 0.0
    duration: Positive = COUGH

    def rows(self, end: float) -> list[Turn]:
        """Return the rows of the course until `end` [s]."""
        waves = [(self.at + self.duration * k / WAVE, rise(k / WAVE)) for k in range(WAVE + 1)]
        return [(0.0, 0.0), *waves] if self.at else waves


def rise(share: float) -> float:
    """Return the height of a wave at a share of its period, from 0 to 1."""
    return 0.5 - 0.5 * cos(2.0 * pi * share)


NamedCourse = Annotated[Ramp | Hold | Cycle | Cough, Field(discriminator="kind")]
Rows = Annotated[tuple[Turn, ...], Field(min_length=1)]
Course = Annotated[Rows | NamedCourse, one_sentence("allowed-course")]


class Timed(ScenarioTable):
    """A load that can change over time."""

    course: Course | None = None
    from_: From = 0.0
    until: Positive | None = None

    def _check_course(self) -> None:
        check_ending(self.from_, self.until)
        self._refuse(self.course is not None and getattr(self, "ramp", None), "ramp.course")
        rows = self.course if isinstance(self.course, tuple) else ()
        check_rising("course", rows)
        if rows and rows[0][0] < 0.0:
            raise ValueError(f".course.0 = {as_toml(rows[0])} is refused: a run begins at 0 s; begin there")

    def rows(self, end: float, ramp: float = 0.0) -> tuple[Turn, ...] | None:
        """Return rows of time [s] and factor [-] of the load in a run until `end` [s].

        They are None if the whole load acts from 0 s to the end, however it is written: in statics
        such a load grows with the load steps. Without a course the load grows over `ramp` [s].
        """
        if self.course is None:
            own: list[Turn] = [(0.0, 0.0), (ramp, 1.0)] if ramp else [(0.0, 1.0)]
        elif isinstance(self.course, tuple):
            own = list(self.course)
        else:
            own = self.course.rows(max(min(end, self.until or inf) - self.from_, 0.0))
        # A step that ends at `from` has no load, and one that ends at `until` has it.
        begin = self.from_ * (1.0 + JUMP)
        rows = [(begin + time, factor) for time, factor in own]
        if self.from_:
            rows = [(self.from_, 0.0), *rows]
        if self.until is not None:
            rows = ended(rows, self.until)
        return None if is_whole(rows, end) else tuple(rows)

    def last_change(self, duration: float, ramp: float | None) -> tuple[str, float]:
        """Return the key and the time [s] of the last change of the load, except its end at `until`.

        A load after a `duration` [s] has its beginning instead. A load without a course grows over
        `ramp` [s], at once if it is None, and a cycle has no last change.
        """
        if self.from_ and self.from_ >= duration:
            return "from", self.from_ * (1.0 + 2.0 * JUMP)
        course = self.course.rows(0.0) if isinstance(self.course, ScenarioTable) else self.course
        changes = [later for (_, before), (later, now) in pairwise(course or ()) if now != before]
        last = self.from_ + (max(changes, default=0.0) if course else ramp or 0.0)
        return "course" if course else "ramp", min(last, self.until or inf) * (1.0 - JUMP)  # sums have round-off

    def short_wave(self, shortest: float) -> tuple[str, float] | None:
        """Return key and length [s] of a wave below the `shortest` length [s].

        It is None if there is no such wave.
        """
        match self.course:
            case Cycle(period=length) if length < shortest:
                return "course.period", length
            case Cough(duration=length) if length < shortest:
                return "course.duration", length
        return None

    def missed_turn(self, step: float, end: float) -> tuple[float, float] | None:
        """Return the time [s] of a turn of the load that steps miss, and the missed share of its range.

        The turn is before `end` [s], and steps have the length `step` [s]. None if there is none, or
        for a wave.
        """
        rows = None if isinstance(self.course, Cycle | Cough) else self.rows(end)
        time, factor = np.array(rows or [(0.0, 0.0)]).T
        way = np.sign(np.diff(factor))
        moving = np.flatnonzero(way)
        for one, other in pairwise(moving.tolist()):
            first, last = time[one + 1], time[other]  # it may stay there for a while
            if way[one] == way[other] or first >= end:
                continue
            steps = np.minimum([floor(last / step + JUMP) * step, ceil(first / step - JUMP) * step], end)
            share = np.abs(np.interp(steps, time, factor) - factor[other]).min() / np.ptp(factor)
            if share > MISSED:
                return float(first), float(share)
        return None


def is_whole(rows: list[Turn], end: float) -> bool:
    """Return whether the factor is 1 at all times from 0 to `end` [s]."""
    times, factors = np.array(rows).T
    return bool((np.interp([0.0, *times[times < end], end], times, factors) == 1.0).all())


def ended(rows: list[Turn], until: float) -> list[Turn]:
    """Return the rows of a load that is zero after `until` [s]."""
    before = [row for row in rows if row[0] < until]
    later = next((row for row in rows if row[0] >= until), None)
    last = before[-1][1] if before else 0.0
    if later is not None and before:
        (low, start), (high, stop) = before[-1], later
        last = start + (stop - start) * (until - low) / (high - low)
    return [*before, (until, last), (until * (1.0 + JUMP), last), (until * (1.0 + 2.0 * JUMP), 0.0)]
