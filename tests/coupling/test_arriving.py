"""Steps that arrive or end in words: a thread pulled taut, parts of a step, and loads that nothing balances."""

import logging
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from coupling.errors import EquilibriumError, InversionError, SpentError, StepError, TogetherError
from coupling.integrators import BackwardEuler
from coupling.rest import branch, equilibrium
from coupling.run.run import begin
from coupling.step.descent import descend
from coupling.step.motion import what_it_does
from coupling.step.newton import solve
from coupling.step.stepping import (
    HALVINGS,
    MOST_TRIES,
    Step,
    advance,
    bdf2_step,
    dynamic_problem,
    organ_answer,
    predict,
    try_step,
    where_it_is,
)
from coupling.system import Friction, Piercing, State, System
from studies.scenario import parse
from studies.simulation import prepare
from tests.bounds import ADAPTED, FIRST_ORDER, IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.thread.threads import LENGTH, ORIGIN, PP, Array, X, Z, laid, line, load_step, uniform, without_organ
from thread.ends import Driven, End, Fixed, Free, Pulled

MASS, SPEED = 0.02, 1.0  # [kg], [m/s]
RUBBED = 0.03  # of the friction: what is asked of a hole on long spans (coupling/README.md)


def bow(length: float, chord: float) -> tuple[float, Array]:
    """Return the radius of an arc of a `length` over a `chord`, and its middle."""
    half = brentq(lambda angle: np.sin(angle) / angle - chord / length, 1e-3, 3.0)
    radius = 0.5 * length / half
    return radius, 0.5 * chord * X - radius * np.cos(half) * Z


def test_a_slack_thread_pulled_taut_bounces() -> None:
    """Independent check: a mass of 20 g that flies off at 1 m/s on a slack thread of 7 mg is caught with the force at
    which the thread's energy EA L (λ² − 1)²/8 is that of its motion, and flies back as fast. (At twice the step the
    straight thread is compressed by 1.7 N before it buckles, and the mass loses 5 % of its speed to that.)"""
    chord = 0.95 * LENGTH
    radius, middle = bow(LENGTH, chord)
    thread = uniform(LENGTH, 24, point_masses=(0.0, MASS))
    system = without_organ(thread, (Fixed(ORIGIN), Free()))

    def arc(s: Array) -> Array:
        angle = (s - 0.5 * LENGTH) / radius
        return middle + radius * (np.sin(angle)[..., None] * X + np.cos(angle)[..., None] * Z)

    state = laid(system, [], arc)
    state = replace(state, v=SPEED * state.q[:, :1] / state.q[-1, 0] * X)
    run, force, worst = begin(system, state, bdf2_step), 0.0, 0.0
    while run.state.time < 0.0125:
        before, run = run.energies, run.step(5e-5)
        force = max(force, float(np.linalg.norm(run.state.reaction[0])))
        worst = max(worst, before.numerical_dissipation - run.energies.numerical_dissipation)
    square = np.sqrt(4.0 * MASS * SPEED**2 / (PP.EA * LENGTH))
    expected = 0.5 * PP.EA * square * np.sqrt(1.0 + square)
    assert abs(force / expected - 1.0) <= FIRST_ORDER
    assert abs(run.state.v[-1, 0] / -SPEED - 1.0) <= FIRST_ORDER
    assert worst <= 1e-5 * run.energies.at_stake


@pytest.mark.parametrize("compiled", [False, True])
def test_a_thread_that_nothing_holds_flies_off_in_one_step(compiled: bool) -> None:
    """Independent check: a dead load on a thread that nothing holds gives it the momentum F Δt, in a whole step, though
    it takes the thread ten of its lengths away."""
    dt, mass = 1e-3, PP.rhoA * LENGTH
    force = 10.0 * LENGTH * mass / dt**2
    system = without_organ(uniform(LENGTH, 24), (Free(), Pulled(force * X)), compiled=compiled)
    (step,) = advance(system, laid(system, [], line(ORIGIN, X)), dt)
    momentum = system.thread.momentum(step.new.v).sum(axis=0)
    assert np.abs(momentum - force * dt * X).max() <= RESIDUAL * force * dt
    assert step.new.q[:, 0].min() > 9.0 * LENGTH


def test_a_thread_far_from_the_origin_is_solved_as_one_that_is_near() -> None:
    """Independent check: what a bent thread does does not depend on where it is. A strain has three digits less where
    the thread is a thousand lengths away, and no more is asked of its force than these."""
    system, radius, taken = without_organ(uniform(LENGTH, 24)), bow(LENGTH, 0.8 * LENGTH)[0], []
    for away in (0.0, 1e3 * LENGTH):

        def arc(s: Array, middle: Array = away * X) -> Array:
            return middle + radius * (np.sin(s / radius)[..., None] * X - np.cos(s / radius)[..., None] * Z)

        (step,) = advance(system, laid(system, [], arc), 1e-3)
        taken.append(step.solution.iterations)
    assert taken[1] <= taken[0]


def through_a_hole(ends: tuple[End, End], friction: Friction | None = None, gap: float = 0.5) -> tuple[System, State]:
    """A straight thread through a hole."""
    hole = ((gap * LENGTH * X, X),)
    system = without_organ(uniform(LENGTH, 24), ends, (Piercing("hole", friction=friction),), hole)
    return system, laid(system, [gap * LENGTH], line(ORIGIN, X))


def test_a_step_that_goes_on_for_ever_ends_in_words() -> None:
    """Independent check: where the last steps alone succeed the tries are counted, and the error names the piercing and
    what the thread does there."""
    system, state = through_a_hole((Free(), Driven(np.array([[0.0, *(LENGTH * X)]]))))
    tries = 0

    def short(system: System, state: State, dt: float) -> Step:
        nonlocal tries
        tries += 1
        if dt > 1e-3 * 0.5**HALVINGS:
            raise StepError(state.time, dt, "too long")
        return try_step(system, state, dt)

    with pytest.raises(StepError, match=r"256 parts of a step were tried and .* s of it are left; .*'hole'"):
        advance(system, state, 1e-3, short)
    assert tries == MOST_TRIES


def test_parts_of_a_step_look_back_at_nothing() -> None:
    """Independent check: a step that is halved is one of backward Euler, and so is the one after it."""
    system, state = through_a_hole(
        (Pulled(-0.1 * X), Driven(np.array([[0.0, *(LENGTH * X)], [1.0, *(2 * LENGTH * X)]])))
    )
    state = advance(system, state, 1e-3, bdf2_step)[-1].new
    assert state.before is not None

    def halving(system: System, state: State, dt: float) -> Step:
        if dt > 0.6e-3:
            raise StepError(state.time, dt, "too long")
        assert state.before is None
        return bdf2_step(system, state, dt)

    taken = advance(system, state, 1e-3, halving)
    assert len(taken) == 2 and taken[-1].new.before is None and taken[-1].new.dt_before is None


def test_a_thread_that_runs_through_a_hole_says_so() -> None:
    """Independent check: the error of a thread that runs through names its speed, and the hole."""
    system, state = through_a_hole((Free(), Free()))
    words, piercing = what_it_does(system, replace(state, s_dot=np.array([2.0])))
    assert "snaps through it at 2 m/s" in words and piercing == "hole"


def test_a_step_downhill_ends_where_newton_does() -> None:
    """Consistency check: of a step in which a part of a span runs through a hole, the way downhill from where the
    thread is leads to what Newton's method finds from where its motion would bring it."""
    hand = Driven(np.array([[0.0, *(LENGTH * X)], [1.0, *(2.0 * LENGTH * X)]]))
    system, state = through_a_hole((Pulled(-0.1 * X), hand))
    dt = 1e-2
    problem = dynamic_problem(system, state, dt, organ_answer(system, BackwardEuler(dt), state))
    plain, led = solve(problem, predict(problem, state)).iterate, descend(problem, where_it_is(problem, state)).iterate
    moved = plain.s - state.s
    assert abs(moved[0]) > 0.1 * LENGTH / 21
    assert np.abs(led.s - plain.s).max() <= TWO_SOLVERS * np.abs(moved).max()
    assert np.abs(led.q - plain.q).max() <= TWO_SOLVERS * np.abs(moved).max()


COUPLED = brentq(lambda T: T - 0.2 - 0.2 * (T + 2.0 * 2.0 * (PP.EI * T) ** 0.5 / 2e-3), 0.2, 2.0)  # [N], of one strand


@pytest.mark.parametrize(
    ("ends", "friction", "refused"),
    [
        ((Pulled(-1.0 * X), Pulled(2.0 * X)), None, True),
        ((Free(), Pulled(2.0 * X)), None, True),
        ((Pulled(-2.0 * X), Pulled(2.0 * X)), None, False),
        ((Pulled(-0.01 * X), Pulled(0.02 * X)), None, False),
        ((Fixed(ORIGIN), Pulled(2.0 * X)), None, False),
        ((Pulled(-1.0 * X), Pulled(1.49 * X)), Friction(0.2, 0.2), False),
        ((Pulled(-1.51 * X), Pulled(1.0 * X)), Friction(0.2, 0.2), True),
        ((Pulled(-1.0 * X), Pulled(1.99 * X)), Friction(0.2, 0.2, grip=0.4), False),
        ((Pulled(-1.0 * X), Pulled(2.01 * X)), Friction(0.2, 0.2, grip=0.4), True),
        ((Free(), Pulled(0.99 * COUPLED * X)), Friction(0.2, 0.2, grip=0.2, channel=2e-3), False),
        ((Free(), Pulled(1.01 * COUPLED * X)), Friction(0.2, 0.2, grip=0.2, channel=2e-3), True),
        ((Free(), Pulled(0.5 * X)), Friction(0.0, 0.0, grip=0.6), False),
        ((Free(), Pulled(0.5 * X)), Friction(0.0, 0.0, grip=0.4), True),
    ],
    ids=[
        "different", "a free end", "equal", "too short to tell", "held", "rough", "too little friction", "gripped",
        "too little grip", "pressed by its couple", "too small a couple", "gripped alone", "too little grip alone",
    ],
)  # fmt: skip
def test_unbalanced_dead_loads_are_recognised_before_the_first_step(
    monkeypatch: pytest.MonkeyPatch, ends: tuple[End, End], friction: Friction | None, refused: bool
) -> None:
    """Independent check: without friction the tension is the same on both sides of a hole, so different dead loads have
    no equilibrium; where an end is held they may have one. A hole that the thread goes back through is pressed on by
    T₁ + T₂, and T₂ − T₁ = F₀ + μ (T₁ + T₂) is the most that it bears; a couple, 2 √(EI T) of a strand at
    most, presses on both ends of a channel ℓ by M/ℓ."""
    system, state = through_a_hole(ends, friction)
    run = begin(system, state)

    def tried(*given: Any) -> Any:
        raise StepError(0.0, 0.0, "tried")

    monkeypatch.setattr("coupling.run.run.reach", tried)
    if refused:
        with pytest.raises(EquilibriumError, match="unbalanced"):
            run.load(1.0, 1.0)
    else:
        with pytest.raises(StepError, match="tried"):
            run.load(1.0, 1.0)


@pytest.mark.parametrize(("force", "refused"), [(2.74, False), (2.76, True)])
def test_what_two_rough_holes_bear_is_told_before_the_first_step(force: float, refused: bool) -> None:
    """Independent check: each bears (1 + μ) T + F₀ over 1 − μ with T behind it, from the smaller load on: for μ = 0.2,
    and a grip of 0.4 N in the second on that way, 1.5 N and 2.75 N."""
    loads = Pulled(-force * X), Pulled(1.0 * X)
    holes = Piercing("first", friction=Friction(0.2, 0.2, grip=0.4)), Piercing("last", friction=Friction(0.2, 0.2))
    sites = tuple((share * LENGTH * X, X) for share in (0.3, 0.7))
    system = without_organ(uniform(LENGTH, 24), loads, holes, sites)
    state = laid(system, [0.3 * LENGTH, 0.7 * LENGTH], line(ORIGIN, X))
    if not refused:
        return equilibrium.refuse_unbalanced(system, state, 1.0)
    with pytest.raises(EquilibriumError, match=r"whose friction bears at most 2\.75 N against the smaller load"):
        equilibrium.refuse_unbalanced(system, state, 1.0)


@pytest.mark.parametrize(
    "failed",
    [InversionError(0.0, "hole"), TogetherError(0.0, "drawn to nothing")],
    ids=lambda error: type(error).__name__,
)
def test_a_static_load_step_that_fails_is_halved(failed: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: an equilibrium behind a flip, or behind corrections that drew two holes together, is looked
    for again in halves of the load step."""
    system, state = through_a_hole((Fixed(ORIGIN), Pulled(0.2 * X)))
    settle, shares = equilibrium.settle, []

    def flipping(system: System, state: State, share: float, duration: float, **ways: bool) -> Step:
        shares.append(share)
        if share - state.time / duration > 0.6:
            raise failed
        return settle(system, state, share, duration)

    monkeypatch.setattr(equilibrium, "settle", flipping)
    steps = load_step(system, state, 1.0, 1.0)
    assert shares == [1.0, 0.5, 1.0] and abs(steps[-1].new.reaction[0] @ X / -0.2 - 1.0) <= IDENTITY**0.5


@pytest.mark.parametrize("suture", ["7-0 nylon", "8-0 silk"])
def test_a_thin_suture_arrives_through_four_rough_holes(suture: str) -> None:
    """Independent check: drawn by 0.3 N in four load steps, it slides through all four. Straight strands leave each
    hole at 45° to either side and press it on the hole by (T₁ + T₂)/√2, so that T₂ − T₁ = μ (T₁ + T₂)/√2.
    Consistency check: resumed after the first load step, the same numbers bit by bit."""

    mu, force, corners = 0.15, 0.3, np.array([[6e-3 * k, 0.0, 3e-3 * (-1) ** k] for k in range(6)])
    strands = np.diff(corners, axis=0)
    lengths = np.linalg.norm(strands, axis=1)
    hole = {"direction": [1, 0, 0], "friction": {"static": mu, "kinetic": mu}}
    table = {
        "thread": {
            "suture": suture,
            "path": corners.tolist(),
            "length": float(lengths.sum()),
            "start": {"kind": "fixed"},
            "end": {"kind": "pulled", "force": (force * strands[-1] / lengths[-1]).tolist()},
        },
        "piercing": [{"name": f"hole {k}", "at": at} | hole for k, at in enumerate(corners[1:-1].tolist())],
        "solve": {"kind": "static", "load_steps": 4},
    }
    simulation = prepare(parse(table))
    records = [record for record, _ in simulation.advance()]
    holes = records[-1].piercings
    *_, resumed = (record for record, _ in simulation.advance(records[1].memory))
    assert [hole.tension_after for hole in resumed.piercings] == [hole.tension_after for hole in holes]
    T = np.array([holes[0].tension_before, *(hole.tension_after for hole in holes)])
    assert np.diff(T) == pytest.approx(mu * (T[1:] + T[:-1]) / np.sqrt(2.0), rel=RUBBED)
    assert T[-1] == pytest.approx(force, rel=ADAPTED)


def test_a_thread_that_nothing_holds_back_runs_out_at_rest() -> None:
    """Independent check: a dead load above what a hole grips has no equilibrium. The thread runs out of its last hole,
    and this ends the load step, not a search for what there is not."""
    system, state = through_a_hole((Free(), Pulled(0.2 * X)), Friction(0.0, 0.0, grip=0.1))
    assert abs(load_step(system, state, 0.45, 1.0)[-1].new.s[0] / state.s[0] - 1.0) < 0.01
    with pytest.raises(EquilibriumError, match=r"\(the thread runs out of its last hole\); "):
        branch.reach(system, state, 1.0, 1.0)


def test_a_load_step_that_comes_over_a_held_end_tells_its_loads() -> None:
    """Independent check: a load step lasts no time of its own, so that its error says under which loads it came to a
    held end, not from when and how long."""
    refused = StepError(0.5, 0.0, "the thread runs out: its start is held", "hole")
    error = equilibrium.without_equilibrium(refused, 0.5, "hold it")
    assert "no equilibrium was found under 50 % of the loads (the thread runs out" in str(error)
    assert "dt" not in str(error)


def test_a_load_step_that_goes_on_for_ever_ends_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: the corrections of all its parts are counted together, and the error says where the thread
    was and what to do."""
    system, state = through_a_hole((Fixed(ORIGIN), Pulled(0.2 * X)))
    monkeypatch.setattr(equilibrium, "MOST_CORRECTIONS", 1)
    with pytest.raises(SpentError, match=r"under 100 % of the loads in 1 corrections.*'hole'; .*solve.load_steps"):
        load_step(system, state, 1.0, 1.0)


def test_a_long_load_step_says_how_far_it_is(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: one line for every so many corrections, and none for a load step that takes fewer."""
    system, state = through_a_hole((Fixed(ORIGIN), Pulled(0.2 * X)))
    with caplog.at_level(logging.INFO, logger=equilibrium.__name__):
        load_step(system, state, 1.0, 1.0)
        assert "corrections so far" not in caplog.text
        monkeypatch.setattr(equilibrium, "REPORTED", 1)
        load_step(system, state, 1.0, 1.0)
    assert "1 of at most 4000 corrections so far to 100 % of the loads" in caplog.text
