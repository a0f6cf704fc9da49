"""What is recorded of steps that are made many at once: the rows of single steps, whatever the steps before were made
with, and whoever takes the run up again."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

import coupling.run.run
from coupling.run.course import Course
from coupling.run.march import march
from studies.output.records import StepRecord
from studies.scenario import Scenario, load
from studies.simulation import prepare, simulation
from studies.simulation.simulation import Simulation
from tests.bounds import AXIAL, RESIDUAL, TWO_SOLVERS
from tests.coupling.test_compiled import ROUGH, drawn
from tests.coupling.test_march import BDF2, EULER, GENTLE, figure_1, slow
from tests.studies.test_krylov import COARSE

STAYS = 'thread.knots="fixed"'  # on which a correction more or less at the tolerance does not come about
SCENES: dict[str, Callable[[], Scenario]] = {
    "rings": lambda: figure_1(EULER, "solve.duration=0.1"),
    "friction, BDF2": lambda: figure_1(
        BDF2, "solve.duration=0.1", *(f"piercing.{hole}.{ROUGH}" for hole in ("entry", "exit"))
    ),
    "stick and slip": lambda: slow(drawn({"channel": 5e-3}), 5e-4, duration=0.03),
    "organ without inertia": lambda: load("two_piercings", [*GENTLE, EULER, STAYS, "solve.duration=0.04"]),
    "organ in its Krylov space": lambda: load("two_piercings", [*COARSE, 'solve.organ="krylov"', BDF2, STAYS]),
}
FORCES = {"force", "normal_force", "tangential_force", "tension_before", "tension_after", "cone_residual"}
LENGTHS = {"s", "slip", "x", "displacement"}


def recorded(ready: Simulation) -> list[StepRecord]:
    """The records of a run."""
    return [record for record, _ in ready.advance()]


def one_by_one(ready: Simulation) -> list[StepRecord]:
    """The records of a run each of whose steps is made by itself."""
    now = ready.beginning()
    records = [ready.record(now)]
    while now.number < ready.steps:
        now = ready.next(now)
        records.append(ready.record(now))
    return records


def made_at_once(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A list of how many steps each call of the loops makes from now on."""
    made: list[int] = []

    def watched(*given: Any) -> Course | None:
        found = march(*given)
        made.append(found.made if found else 0)
        return found

    monkeypatch.setattr(coupling.run.run, "march", watched)
    return made


@pytest.mark.parametrize("name", SCENES)
def test_rows_of_steps_made_at_once_are_those_of_single_steps(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: every number of a piercing, of the energies and of the step, each to its scale, as
    `tests.coupling.test_march.agree` has them; iterations, events and states to the last bit."""
    ready, made = prepare(SCENES[name]()), made_at_once(monkeypatch)
    found, singly = recorded(ready), one_by_one(ready)
    assert sum(made) >= 0.5 * ready.steps and len(found) == len(singly) == ready.steps + 1
    thread, last = ready.assembly.system.thread, singly[-1]
    length, stake = thread.spline.end, max(record.energy.at_stake for record in singly)
    pulls = [np.abs(record.end_reaction).max() for record in singly]
    force = AXIAL / RESIDUAL * thread.EA + max(pulls)
    scales = dict.fromkeys(FORCES, force) | dict.fromkeys(LENGTHS, length) | {"couple": force * length}
    area = ready.assembly.system.bearing_areas
    scales["bearing_pressure"] = force / float(area.min())
    for one, other in zip(found, singly, strict=True):
        assert (one.time, one.step, one.newton_iterations) == (other.time, other.step, other.newton_iterations)
        assert [(e.kind, e.piercing) for e in one.events] == [(e.kind, e.piercing) for e in other.events]
        assert [e.time for e in one.events] == pytest.approx([e.time for e in other.events], rel=TWO_SOLVERS)
        for hole, alone in zip(one.piercings, other.piercings, strict=True):
            for each in fields(hole):
                here, there = getattr(hole, each.name), getattr(alone, each.name)
                if each.name in ("name", "state", "channel", "tract", "bearing"):
                    assert here == there, each.name
                else:
                    off = np.abs(np.subtract(here, there)).max()
                    assert off <= RESIDUAL * scales.get(each.name, 1.0), (one.step, each.name)
        for each in fields(one.energy):
            assert abs(getattr(one.energy, each.name) - getattr(other.energy, each.name)) <= RESIDUAL * stake
        for one_end, other_end in ((one.start_reaction, other.start_reaction), (one.end_reaction, other.end_reaction)):
            assert np.abs(one_end - other_end).max() <= RESIDUAL * force
        assert abs(one.constraint_max - other.constraint_max) <= RESIDUAL * length
        assert abs(one.max_strain - other.max_strain) <= RESIDUAL * force / thread.EA
        assert abs(one.slide_speed - other.slide_speed) <= RESIDUAL * max(1e-3, last.slide_speed, one.slide_speed)
        assert one.spans() == pytest.approx(other.spans(), rel=RESIDUAL)


@pytest.mark.parametrize("name", SCENES)
def test_numbers_do_not_depend_on_where_a_run_is_taken_up(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: to the last bit, with at most 7 steps at once in place of 50, and from the memory of a step
    in between."""
    ready = prepare(SCENES[name]())
    whole = recorded(ready)
    half = whole[ready.steps // 2]
    assert half.memory is not None
    again = [record for record, _ in ready.advance(half.memory)]
    monkeypatch.setattr(simulation, "AT_ONCE", 7)
    made = made_at_once(monkeypatch)
    shorter = recorded(ready)
    assert 2 <= max(made) <= 7
    for others in (again, shorter):
        for other in others:
            one = whole[other.step]
            assert one.memory is not None or one.step == ready.steps
            assert [hole.s for hole in one.piercings] == [hole.s for hole in other.piercings]
            if one.memory is not None and other.memory is not None:
                assert one.memory.keys() == other.memory.keys()
                assert all(np.array_equal(one.memory[key], other.memory[key], equal_nan=True) for key in one.memory)
