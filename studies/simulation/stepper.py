"""A run stepped by a host program, for example a haptic loop.

The host moves an end of the thread and receives the forces.

    stepper = prepare(scenario).stepper()
    while …:
        forces = stepper.step(1e-3, hand)
"""

from array import array
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Literal, TypeGuard

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import ThreadpoolController

from studies.arrays import Array
from studies.output.records import Snapshot, StepRecord
from studies.scenario import Scenario, because, refuse, refused
from studies.simulation.memory import OrganRun
from thread.ends import Clamped, Driven, End, Fixed

WhichEnd = Literal["start", "end"]
ENDS: tuple[WhichEnd, WhichEnd] = ("start", "end")
LATE = 99.0  # per cent of the steps


@dataclass(frozen=True)
class Forces:
    """Forces after a step [N].

    `hand` (3,) is the force of the thread on the hand. `other` (3,) is its force on the holder of
    the other end, zero without a holder. `piercings` (p, 3) are the forces of the holes on the
    thread, zero for a hole without thread.
    """

    hand: Array
    other: Array
    piercings: Array


@dataclass(frozen=True)
class Timing:
    """Wall-clock times of the steps so far [s], and the number of steps above their deadline."""

    steps: int
    median: float
    late: float  # 99 % of the steps took less
    worst: float
    missed: int

    def __str__(self) -> str:
        median, late, worst = (1e3 * seconds for seconds in (self.median, self.late, self.worst))
        times = f"median {median:.3g} ms, 99th percentile {late:.3g} ms, longest {worst:.3g} ms"
        return f"{self.steps} steps: {times}, {self.missed} late"


def is_led(end: End) -> TypeGuard[Driven | Fixed]:
    """Return whether an end is held by its place only, so that a hand can move it."""
    return isinstance(end, Driven | Fixed) and not isinstance(end, Clamped)


class Stepper:
    """A run stepped by a host program. Made by `Simulation.stepper`.

    `begin` returns the run of the `scenario` before its first step. `record` returns the record of
    a step that took some seconds, and `snapshot` its fields. `end` is the end of the thread that
    the host moves; the scenario must hold it by its place, driven or fixed. Other events of the
    scenario continue. `deadline` [s] is the longest time of a step; None is the simulated time of
    the step. Raises `ScenarioError` for statics, for an end without a prescribed place, for an
    unknown end, and for a deadline below 0 s.
    """

    def __init__(
        self,
        scenario: Scenario,
        begin: Callable[[], OrganRun],
        record: Callable[[OrganRun, float], StepRecord],
        snapshot: Callable[[OrganRun], Snapshot],
        end: WhichEnd,
        deadline: float | None,
    ) -> None:
        refuse(end not in ENDS, "end", end, "end-unknown")
        refuse(deadline is not None and not deadline >= 0.0, "deadline", deadline, "deadline")
        refuse(scenario.solve.kind == "static", "solve.kind", "static", "stepper-static")
        self._record, self._snapshot, self._side, self._deadline = record, snapshot, ENDS.index(end), deadline
        self._now = begin()
        if not is_led(self._now.system.ends[self._side]):
            raise refused(f"thread.{end}.kind", getattr(scenario.thread, end).kind, "end-free")
        self._seconds, self._missed = array("d"), 0
        self._threads = ThreadpoolController()

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return self._now.state.time

    @property
    def record(self) -> StepRecord:
        """The record of the last step."""
        return self._record(self._now, self._seconds[-1] if self._seconds else 0.0)

    def frame(self) -> Snapshot:
        """Return the snapshot of the state."""
        return self._snapshot(self._now)

    @property
    def forces(self) -> Forces:
        """The forces of the last step, zero before the first step."""
        state = self._now.state
        reaction = -state.reaction[:, :3]
        holes = len(self._now.system.piercings)
        return Forces(reaction[self._side], reaction[1 - self._side], state.lam[:holes, :3])

    @property
    def timing(self) -> Timing:
        """Times of the steps so far. Raises `ValueError` before the first step."""
        if not self._seconds:
            raise ValueError("no step was taken yet, so no times are known; take a step")
        seconds = np.frombuffer(self._seconds)
        median, late = np.percentile(seconds, [50.0, LATE])
        return Timing(len(seconds), float(median), float(late), float(seconds.max()), self._missed)

    def step(self, dt: float, end_position: ArrayLike) -> Forces:
        """Advance by `dt` [s], and return the forces.

        The hand moves at constant speed to `end_position` (3,) [m]. A failed step leaves the run
        unchanged, so that the host can try another. Raises `ValueError` for an invalid place or
        time, and `StepError`, `ConstraintError`, `InversionError`, `FormingError`.
        """
        began = perf_counter()
        try:
            place, length = np.asarray(end_position, dtype=float), float(dt)
        except (TypeError, ValueError):
            place, length = np.empty(0), 0.0
        if place.shape != (3,) or not np.all(np.isfinite(place)) or not 0.0 < length < np.inf:
            raise ValueError(f"dt = {dt!r} s, end_position = {end_position!r}: {because('hand-place')}")
        with self._threads.limit(limits=1, user_api="blas"):
            self._now = self._led(length, place).steps(length, 1)
        forces = self.forces
        seconds = perf_counter() - began
        self._seconds.append(seconds)
        self._missed += seconds > (length if self._deadline is None else self._deadline)
        return forces

    def _led(self, dt: float, place: Array) -> OrganRun:
        """Return the run with a hand that moves the end to `place` within `dt` [s]."""
        run, here = self._now, self._now.state.time
        held = run.system.ends[self._side]
        assert is_led(held)
        led = np.array([[here, *np.asarray(held.position(here))], [here + dt, *place]])
        return replace(run, system=run.system.led(self._side, Driven(led, turn=held.turn)))
