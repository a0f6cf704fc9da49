"""When within a step its events happened: against closed forms, and against a finer run."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coupling.run import begin
from coupling.run.events import Event
from coupling.run.location import share_until_zero
from coupling.step.stepping import Take, bdf2_step, try_step
from coupling.system import Friction, Piercing, State, System
from studies.scenario import parse
from studies.simulation import prepare
from tests.bounds import LOCATED, SAME_TIME
from tests.thread.threads import FREE, ORIGIN, Strand, X, laid, line, uniform, without_organ
from thread.ends import End, Free, Pulled

MASS, SPEED, GRIP, DT, LENGTH = 0.01, 0.1, 0.012, 1e-3, 0.04
HALF = 0.5 * MASS


def gliding(speed: float, grip: float, ends: tuple[End, End] = FREE, at: float = 0.5) -> tuple[System, State]:
    """A stiff thread with half the mass on either end in a sleeve, at the part `at` of its length, that glides along x
    at a `speed` [m/s]."""
    friction = Friction(grip=grip) if grip else None
    thread = uniform(LENGTH, 8, Strand(EA=1e5, EI=1.0, rhoA=1e-6), point_masses=(HALF, HALF))
    system = without_organ(thread, ends, (Piercing("sleeve", friction=friction),), ((ORIGIN, X),))
    state = laid(system, [at * LENGTH], line(-at * LENGTH * X, X))
    v = np.outer(np.ones(thread.n), speed * X)
    return system, replace(state, v=v, s_dot=-speed * np.ones(1), sigma=-np.sign(speed) * np.ones(1))


def events_of(system: System, state: State, take: Take, steps: int, dt: float = DT) -> list[Event]:
    """The events of so many steps."""
    run, out = begin(system, state, take), list[Event]()
    for _ in range(steps):
        run = run.step(dt)
        out += [event for event in run.events if event.kind != "halved"]
    return out


@pytest.mark.parametrize("take", [try_step, bdf2_step])
def test_what_slides_to_rest_sticks_as_its_speed_is_zero(take: Take) -> None:
    """Independent check: against a constant grip F a mass stops after m v/F, 83.34 ms here: both
    integrators are exact there."""
    events = events_of(*gliding(SPEED, GRIP), take, 100)
    exact = (MASS + 1e-6 * LENGTH) * SPEED / GRIP
    assert [event.kind for event in events] == ["sticks"]
    assert abs(events[0].time - exact) < LOCATED * DT


@pytest.mark.parametrize("take", [try_step, bdf2_step])
def test_what_is_drawn_ever_harder_slips_as_the_force_reaches_its_bound(take: Take) -> None:
    """Independent check: both ends of a thread at rest are pulled apart, the one by a force that grows, 0.04 N in
    0.1 s: it slips after 30 ms by the grip of 0.012 N, which the sleeve bears until then. It stretches by nothing."""
    ends = Free(), Pulled(0.04 * X, np.array([[0.0, 0.0], [0.1, 1.0]]))
    system, state = gliding(0.0, GRIP, ends)
    shifted = replace(state, time=-0.4e-3)  # no step ends there
    events = events_of(system, shifted, take, 34)
    assert [event.kind for event in events] == ["slips"]
    assert abs(events[0].time - 0.03) < LOCATED * DT


@pytest.mark.parametrize("take", [try_step, bdf2_step])
def test_what_turns_back_within_a_step_sticks_and_slips_in_it(take: Take) -> None:
    """Independent check: a force back that exceeds the grip turns a mass back without a rest, after m v/(F + grip):
    both events stand within that step, in their order."""
    back = 0.05
    system, state = gliding(SPEED, GRIP, (Free(), Pulled(-back * X)))
    events = events_of(system, state, take, 40)
    exact = (MASS + 1e-6 * LENGTH) * SPEED / (back + GRIP)
    assert [event.kind for event in events] == ["sticks", "slips"]
    assert abs(events[0].time - exact) < LOCATED * DT
    assert events[0].time <= events[1].time <= exact + 1.5 * DT


@pytest.mark.parametrize("force", [0.0, 0.04])
def test_a_hole_is_left_as_the_end_of_the_thread_passes_it(force: float) -> None:
    """Independent check: a thread of mass m glides out of an ideal sleeve, at a constant speed or drawn by a constant
    force too: v t + F t²/2m is what there was of it before the sleeve."""
    way = 0.10625 * LENGTH
    events = events_of(*gliding(SPEED, 0.0, (Free(), Pulled(force * X)), at=0.10625), bdf2_step, 60)
    a = force / (MASS + 1e-6 * LENGTH)
    exact = 2.0 * way / (SPEED + np.sqrt(SPEED**2 + 2.0 * a * way))
    assert [event.kind for event in events] == ["leaves"]
    assert abs(events[0].time - exact) < LOCATED * DT


def switches_after(scene: dict[str, Any], time: float) -> dict[str, list[tuple[str, float]]]:
    """By hole, the kinds and times of slips and sticks after a `time` [s]."""
    out: dict[str, list[tuple[str, float]]] = {hole["name"]: [] for hole in scene["piercing"]}
    for record, _ in prepare(parse(scene)).advance():
        for event in record.events:
            if event.kind in ("slips", "sticks") and event.time > time:
                out[event.piercing].append((event.kind, event.time))
    return out


def test_a_finer_run_has_its_events_at_the_same_times() -> None:
    """Consistency check: a thread is drawn through two rough holes, let back and drawn again; slips and turns stand
    within 2 % of their times, as a quarter of the step has them. While the slack is taken up,
    until 25 ms, it sticks and slips within single steps, and only finer ones tell when."""
    up, down = [-0.005, 0, 0.02], [0.005, 0, 0.02]
    rough = {"static": 0.1, "kinetic": 0.1}
    hand = [[0, *down], [0.06, 0.005, 0, 0.024], [0.09, 0.005, 0, 0.0225]]
    scene: dict[str, Any] = {
        "thread": {
            "suture": "2-0 polypropylene",
            "control_points": 60,
            "path": [up, [-0.005, 0, -0.0055], [0.005, 0, -0.0055], down],
            "damping": 20.0,
            "start": {"kind": "pulled", "force": [0, 0, 0.1], "ramp": 0.02},
            "end": {"kind": "driven", "waypoints": hand},
        },
        "piercing": [
            {"name": "entry", "at": [-0.005, 0, 0], "direction": [0, 0, -1], "friction": rough},
            {"name": "exit", "at": [0.005, 0, 0], "direction": [0, 0, 1], "friction": rough},
        ],
        "solve": {"dt": 1e-3, "duration": 0.09},
    }
    coarse = switches_after(scene, 0.025)
    scene["solve"]["dt"] = 0.25e-3
    fine = switches_after(scene, 0.025)
    assert [kind for kind, _ in coarse["entry"]] == ["slips", "sticks", "slips"]
    assert [kind for kind, _ in coarse["exit"]] == ["sticks", "slips"]
    for name, events in coarse.items():
        assert [kind for kind, _ in events] == [kind for kind, _ in fine[name]]
        assert [time for _, time in events] == pytest.approx([time for _, time in fine[name]], rel=SAME_TIME)


def test_the_share_of_a_way_at_which_zero_is_passed() -> None:
    """Independent check: of an even course; none of one that is past zero, all of one that does not reach it, or that
    begins infinitely far below it."""
    before = np.array([-1.0, -1.0, 0.0, 1.0, -1.0, -2.0, 0.0, -np.inf])
    after = np.array([3.0, 0.0, 1.0, 2.0, -0.5, -3.0, 0.0, 1.0])
    assert share_until_zero(before, after).tolist() == [0.25, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0]
