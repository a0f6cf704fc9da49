"""When strands become taut and slack: against the length that a hand takes up, and against Euler's load and weight."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from coupling.run.cutting import Cut
from coupling.run.events import Event, strand_changes
from coupling.run.location import times_at_end
from coupling.run.run import Run, begin
from coupling.run.tautness import carried_over, still_taut, taut_strands
from coupling.step.stepping import Take, bdf2_step, try_step
from coupling.system import Piercing, State, System
from studies.simulation.memory import memory_of, recall
from tests.bounds import SAME_TIME, TWO_SOLVERS
from tests.thread.threads import FREE, ORIGIN, PP, Array, Path, Strand, X, Z, laid, line, uniform, without_organ
from thread.ends import Driven, End, Fixed, Free, Pulled

TAIL, STRAND, EXTRA = 0.01, 0.04, 1e-3
TAKEN_UP = 0.01  # of a time: a strand of PP is straight to 5e-6 m when its inertia alone draws it as Euler's load does
EULER = PP.EI * (np.pi / STRAND) ** 2
ANCHOR = Piercing("anchor", slides=False, directed=False)
KINDS = ("taut", "slack")


def bow(extra: float) -> Path:
    """A tail of TAIL, straight to the origin, and from there an arc of the length STRAND that ends on the x axis,
    `extra` [m] nearer."""
    half = brentq(lambda angle: np.sin(angle) / angle - 1.0 + extra / STRAND, 1e-6, 3.0) if extra else 1e-6
    radius = 0.5 * STRAND / half

    def at(s: Array) -> Array:
        s = np.asarray(s, float) - TAIL
        angle, before = np.clip(s, 0.0, STRAND) / radius - half, np.minimum(s, 0.0)
        x = radius * (np.sin(angle) + np.sin(half)) + before * np.cos(half)
        z = radius * (np.cos(angle) - np.cos(half)) + before * np.sin(half)
        return np.stack([x, 0.0 * s, z], axis=-1)

    return at


def drawn(rows: Any, extra: float = EXTRA, start: End = FREE[0], **options: Any) -> tuple[System, State]:
    """A strand from an anchor to a hand, which moves along x by `rows` of time [s] and way [m] from where it is longer
    by `extra` [m] than its way."""
    hand = Driven(np.array([[time, STRAND - extra + way, 0.0, 0.0] for time, way in rows]))
    system = without_organ(uniform(TAIL + STRAND, 30), (start, hand), (ANCHOR,), ((ORIGIN, None),), **options)
    return system, laid(system, [TAIL], bow(extra))


def told(run: Run, dt: float, steps: int) -> list[Event]:
    """The strands that become taut and slack in so many steps."""
    out = list[Event]()
    for _ in range(steps):
        run = run.step(dt)
        out += [event for event in run.events if event.kind in KINDS]
    return out


@pytest.mark.parametrize("take", [try_step, bdf2_step])
def test_a_slack_strand_becomes_taut_as_its_extra_length_is_taken_up(take: Take) -> None:
    """Independent check: a hand that takes up 1 mm at 5 mm/s has the strand taut after 200 ms, and slack again as it
    comes back there: within 1 %, and within 2 % of the same in steps a quarter as long. The free tail is never
    taut."""
    speed, dt = 5e-3, 2e-3
    exact = EXTRA / speed
    rows = [[0.0, 0.0], [1.05 * exact, 1.05 * EXTRA], [2.1 * exact, 0.0]]
    run = begin(*drawn(rows), take)
    coarse, fine = (told(run, step, round(1.115 * exact / step)) for step in (dt, 0.25 * dt))
    for events in (coarse, fine):
        assert [(event.kind, event.piercing) for event in events] == [("taut", "anchor-end"), ("slack", "anchor-end")]
        assert [event.s for event in events] == pytest.approx([TAIL + 0.5 * STRAND] * 2, rel=TWO_SOLVERS)
        assert events[0].time == pytest.approx(exact, rel=TAKEN_UP)
        assert events[1].time == pytest.approx(1.1 * exact, rel=TAKEN_UP)
    assert [event.time for event in coarse] == pytest.approx([event.time for event in fine], rel=SAME_TIME)


def swinging(parts: list[float], taut: bool) -> Run:
    """A straight strand that a hand stretches to these parts of what makes it taut, one after the other in 10 ms each;
    `taut`: it was so."""
    enough = EULER + 1e-6 * PP.EA
    stretch = enough / PP.EA * STRAND
    system, state = drawn([[0.01 * k, stretch * part] for k, part in enumerate(parts)], extra=0.0)
    return replace(begin(system, state), taut=np.array([False, taut]))


@pytest.mark.parametrize(
    ("parts", "taut", "kinds"),
    [
        ([0.0, 0.9, 0.1, 0.9, 0.1], False, []),
        ([0.0, 1.2, 0.1, 1.2, 0.1], False, ["taut"]),
        ([1.2, 0.1, 1.2, 0.1], True, []),
        ([1.2, -0.1], True, ["slack"]),
    ],
)
def test_a_strand_that_swings_does_not_change_with_every_swing(
    parts: list[float], taut: bool, kinds: list[str]
) -> None:
    """Independent check: below Euler's load one that was slack stays so, above none one that was taut."""
    events = told(swinging(parts, taut), 1e-3, 10 * (len(parts) - 1))
    assert [event.kind for event in events] == kinds


def test_the_tension_stands_where_it_reaches_euler_s_load() -> None:
    """Independent check: a straight strand that is stretched evenly reaches the load 5/6 of the way to 1.2 times it,
    wherever steps end."""
    run = swinging([0.0, 1.2], False)
    for dt in (1e-3, 0.9e-3, 0.37e-3):
        (event,) = told(run, dt, int(0.01 / dt))
        assert event.time == pytest.approx(0.01 / 1.2, rel=TAKEN_UP)


@pytest.mark.parametrize(("sag", "taut"), [(1.0 / 7.0, False), (1.0 / 9.0, True)])
def test_a_limp_strand_is_taut_that_hangs_by_less_than_an_eighth(sag: float, taut: bool) -> None:
    """Independent check: a parabola of sag f over the way c has the horizontal force w c²/8f, its weight where f is
    c/8; at rest between two fixed points."""
    c, g = 0.2, 9.81
    shape = c * (sag * np.linspace(0.0, 1.0, 2001) * np.linspace(1.0, 0.0, 2001) * 4.0)
    x = np.linspace(0.0, c, 2001)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(shape)))])
    thread = uniform(float(s[-1]), 40, Strand(EA=2.0, EI=1e-9))
    system = without_organ(thread, (Fixed(ORIGIN), Fixed(c * X)), gravity=-g * Z)
    state = laid(system, [], lambda at: np.stack([np.interp(at, s, x), 0 * at, -np.interp(at, s, shape)], axis=-1))
    run = begin(system, state).load(1.0, 1.0)
    assert run.taut.tolist() == [taut]
    assert [event.piercing for event in run.events if event.kind in KINDS] == ["start-end"] * taut


@pytest.mark.parametrize(("part", "taut"), [(0.1, False), (0.03, True)])
def test_a_skipping_rope_is_not_taut(part: float, taut: bool) -> None:
    """Independent check: a rope that is longer than its way by e turns in a bow of half a sine of amplitude a, e =
    π² a²/4ℓ, under T = ρA (ωℓ/π)²: that is ρA v² ℓ/2e with its mean speed v = ωa/√2, half of what counts as swinging of
    one that is longer by a tenth."""
    thread = uniform(STRAND, 40, Strand(EA=1.0, EI=1e-12))
    system = without_organ(thread, (Fixed(ORIGIN), Fixed(STRAND * X)))
    state, omega = laid(system, [], line(ORIGIN, X)), 300.0
    amplitude = 2.0 * STRAND / np.pi * np.sqrt(part)
    v = np.outer(omega * amplitude * np.sin(np.pi * thread.spline.greville / STRAND), [0.0, 1.0, 0.0])
    tension = thread.section.rhoA * (omega * STRAND / np.pi) ** 2
    turning = replace(state, v=v, N=np.full_like(state.N, tension))
    assert taut_strands(system, turning).tolist() == [taut]
    assert taut_strands(system, replace(turning, v=0.0 * v)).tolist() == [True]


@pytest.mark.parametrize("compiled", [False, True])
def test_weight_and_speed_count_with_euler_s_load(compiled: bool) -> None:
    """Independent check: a straight strand hangs from a hand that flies aside at 5 m/s, under a weight as large as
    Euler's load, half of which is in its tension, and a pull that grows; step by step, and in compiled loops."""
    g, speed, pull, ramp = EULER / (PP.rhoA * STRAND), 5.0, 0.04, 0.012
    enough = 2.0 * EULER + 1e-6 * PP.EA + 10.0 * PP.rhoA * speed**2
    hand = Driven(np.array([[0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, speed]]))
    thread = uniform(STRAND, 30)
    system = without_organ(
        thread, (hand, Pulled(pull * X, np.array([[0.0, 0.0], [ramp, 1.0]]))), gravity=g * X, compiled=compiled
    )
    state = laid(system, [], line(ORIGIN, X))
    run = begin(system, replace(state, v=np.tile(speed * Z, (thread.n, 1))))
    run = run.step(0.37e-3).steps(0.37e-3, 30)
    (event,) = [event for event in run.events if event.kind in KINDS]
    assert event.time == pytest.approx((enough - 0.5 * EULER) / pull * ramp, rel=TAKEN_UP)


@pytest.mark.parametrize(("end", "mass", "taut"), [(Free(), 0.0, False), (Free(), 1e-3, True), (Pulled(X), 0.0, True)])
def test_a_strand_whose_end_nothing_holds_is_never_taut(end: End, mass: float, taut: bool) -> None:
    """Independent check: whatever its tension is; a mass or a pull at the end holds it."""
    for turned in (1, -1):
        thread = uniform(STRAND, 20, point_masses=(0.0, mass)[::turned])
        system = without_organ(thread, (Fixed(ORIGIN), end)[::turned])
        state = laid(system, [], line(min(0.0, turned * STRAND) * X, X))
        assert taut_strands(system, replace(state, N=np.full_like(state.N, 1.0))).tolist() == [taut]


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("off", [-1e-27, 0.0, 1e-27])
def test_an_anchor_at_an_end_holds_it(off: float, compiled: bool) -> None:
    """Independent check: whether its abscissa is at the end, past it or short of it by round-off, the thread is one
    strand, which becomes taut as it is pulled at the other end, and an anchor that is gone holds nothing."""
    for place, ends in ((off, (Free(), Pulled(X))), (STRAND + off, (Pulled(-X), Free()))):
        system, state = through([place], ends)
        system = replace(system, compiled=compiled)
        state = replace(state, s=np.array([place]), N=np.zeros_like(state.N))
        run = begin(system, state).steps(1e-4, 3)
        assert [(e.kind, e.piercing) for e in run.events if e.kind in KINDS] == [("taut", "start-end")]
        assert run.taut.tolist() == [True] and bool(run.taken) is not compiled
        gone = replace(state, present=np.array([False]), N=np.ones_like(state.N))
        assert taut_strands(system, gone).tolist() == [False]


def test_what_is_taut_at_the_start_is_no_event_and_what_is_cut_goes_slack() -> None:
    """Independent check: a strand laid under strain; both of its parts let go where it is cut, not the tail on the
    other side of the hole."""
    way = 1e-3
    system, state = drawn([[0.0, way * STRAND]], extra=0.0, start=Pulled(-way * PP.EA * X))
    state = replace(state, N=np.full_like(state.N, way * PP.EA))
    system = replace(system, thread=replace(system.thread, damping=100.0))
    run = begin(system, state, cuts=(Cut(TAIL + 0.5 * STRAND, 5.5e-3),))
    assert run.taut.tolist() == [True, True]
    events = told(run, 1e-3, 10)
    assert {(event.kind, event.piercing) for event in events} == {("slack", "anchor-cut"), ("slack", "cut-end")}
    assert all(6e-3 <= event.time <= 8e-3 for event in events)


def through(places: list[float], ends: tuple[End, End] = FREE) -> tuple[System, State]:
    """A straight thread through holes at these abscissae [m]."""
    holes = tuple(replace(ANCHOR, name=str(place)) for place in places)
    system = without_organ(uniform(STRAND, 10), ends, holes, tuple((place * X, None) for place in places))
    return system, laid(system, places, line(ORIGIN, X))


def test_a_strand_is_what_that_was_in_which_its_middle_lies() -> None:
    """Independent check: a hole that begins parts a strand in two alike; where one ends, the longer part counts."""
    system, two = through([0.02, 0.028])
    one = replace(two, present=np.array([True, False]))
    for before, after, was, now in (
        (one, two, [False, True], [False, True, True]),
        (two, one, [False, True, False], [False, False]),
        (two, two, [False, True, True], [False, True, True]),
    ):
        assert carried_over(system, np.array(was), before, system, after).tolist() == now


def test_a_hole_that_is_past_the_end_for_a_step_parts_no_strand_then() -> None:
    """Independent check: between a step that ends with a hole past the thread's start, in force still, and one that
    ends with it on the thread again, the strand beyond the other hole becomes taut half way."""
    system, new = through([0.02, 0.028], (Fixed(ORIGIN), Fixed(STRAND * X)))
    old = replace(new, s=np.array([-1e-5, 0.028]), N=np.zeros_like(new.N), time=-1e-3)
    enough = PP.EI * (np.pi / (STRAND - 0.028)) ** 2 + 1e-6 * PP.EA
    new = replace(new, N=np.full_like(new.N, 2.0 * enough), time=0.0)
    events, taut = strand_changes(system, old, new, np.array([False, False]), times_at_end(old, new))
    assert taut.tolist()[-1] and [event.piercing for event in events][-1] == "0.028-end"
    assert events[-1].time == pytest.approx(-0.5e-3, rel=TWO_SOLVERS)


def test_a_hole_that_is_left_leaves_one_strand() -> None:
    """Independent check: a thread is drawn out of a hole by its taut end; the strand that is left has a free end and
    no word is lost."""
    system = without_organ(
        uniform(STRAND, 20), (Free(), Pulled(0.02 * X)), (Piercing("hole", directed=False),), ((ORIGIN, None),)
    )
    run = begin(system, laid(system, [0.2e-3], line(-0.2e-3 * X, X)))
    run = replace(run, taut=np.array([False, True]))
    while run.state.present[0]:
        run = run.step(1e-3)
    assert run.taut.shape == (1,)


def test_a_checkpoint_keeps_which_strands_are_taut() -> None:
    """Independent check: between the bounds that is known from the past alone."""
    run = swinging([1.2, 0.5], True)
    for _ in range(10):
        run = run.step(1e-3)
    assert run.taut.tolist() == [False, True] and taut_strands(run.system, run.state).tolist() == [False, False]
    beginning = replace(run, number=0, taut=np.array([False, False]))
    assert recall(beginning, memory_of(run)).taut.tolist() == [False, True]


def test_a_strand_of_which_no_tension_is_known_stays_what_it_was() -> None:
    """Independent check: between two holes nearer than the points of the axial force."""
    system, state = through([0.02, 0.02001])
    for was in (True, False):
        taut = still_taut(system, state, np.array([True, was, True]))
        assert taut.tolist() == [False, was, False]


@pytest.mark.parametrize("take", [try_step, bdf2_step])
def test_compiled_steps_stop_where_a_strand_changes(take: Take) -> None:
    """Consistency check: steps made at once, in stretches cut in two ways, tell of the same strands at the same times
    as steps one by one in numpy, and the loops make nearly all of them."""
    speed, dt, count = 5e-3, 1e-3, 215
    rows = [[0.0, 0.0], [0.21, 0.21 * speed], [0.42, 0.0]]
    system, state = drawn(rows, start=Pulled(-1e-3 * X))
    expected = told(begin(system, state, take), dt, count)
    assert [event.kind for event in expected if event.piercing == "anchor-end"] == ["taut"]
    for stretches in ([count], [7] * 30 + [5]):
        run, found = begin(replace(system, compiled=True), state, take), list[Event]()
        for number in stretches:
            run = run.steps(dt, number)
            found += [event for event in run.events if event.kind in KINDS]
        assert [(e.kind, e.piercing) for e in found] == [(e.kind, e.piercing) for e in expected]
        assert [e.time for e in found] == pytest.approx([e.time for e in expected], rel=TWO_SOLVERS)
