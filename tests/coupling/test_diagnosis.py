"""Constraints that cannot be met are named, at set-up and during a run."""

import json
import tomllib
import tracemalloc
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from coupling.errors import ConstraintError, StepError, TogetherError
from coupling.kernels.constraints import phi
from coupling.rest.equilibrium import refuse_flown, remedy_for
from coupling.step import stepping
from coupling.step.diagnosis import (
    DEPENDENT,
    NO_TANGENT,
    dependence_faults,
    diagnose,
    faults,
    refuse_crossing,
    refuse_turning,
    scaled_rows,
)
from coupling.step.stepping import advance
from coupling.system import Piercing, State, System
from studies.command import command
from studies.scenario import Scenario, ScenarioError, load, parse
from studies.simulation import prepare
from studies.simulation.assembly import assemble
from tests.bounds import RESIDUAL
from tests.thread.threads import (
    FREE,
    LENGTH,
    Array,
    X,
    Z,
    bent,
    greville,
    laid,
    line,
    thread_on,
    uniform,
    without_organ,
)
from thread.ends import Clamped, End, Free
from thread.knots import clamped_knots
from thread.spline import Spline

SCENES = Path(command.__file__).parents[1] / "scenario" / "scenes"
N = 20
SPAN = LENGTH / (N - 3)


@pytest.mark.parametrize("at", [0.0, 0.05, None])
@pytest.mark.parametrize("kind", ["dynamic", "static"])
def test_a_thread_held_at_its_very_end_or_in_no_hole(at: float | None, kind: str) -> None:
    """Independent check: an anchor at an end holds the thread there against what pulls the other end; a thread in no
    hole hangs between its ends alone."""
    near, far = ("start", "end") if at != 0.05 else ("end", "start")
    table: dict[str, Any] = {
        "thread": {"suture": "2-0 polypropylene", "control_points": 20, "path": [[0, 0, 0], [0.05, 0, 0]]},
        "piercing": [] if at is None else [{"name": "a", "at": [at, 0, 0], "kind": "anchored", "s": at}],
        "solve": {"kind": kind, "load_steps": 2, "dt": 1e-3, "duration": 0.005},
    }
    table["thread"][far] = {"kind": "pulled", "force": [0.05 if far == "end" else -0.05, 0.0, 0.001], "ramp": 1e-3}
    if at is None:
        table["thread"][near] = {"kind": "fixed"}
    record = [record for record, _ in prepare(Scenario.model_validate(table)).advance()][-1]
    force = record.start_reaction if at is None else record.piercings[0].force
    assert record.constraint_max < 1e-12
    assert abs(force[0] / (-0.05 if far == "end" else 0.05) - 1.0) < (1e-2 if kind == "static" else 0.5)


def straight(
    s: list[float], directed: bool = True, ends: tuple[End, End] = FREE, n: int = N, at: Any = None
) -> tuple[System, State]:
    """A straight thread along x with holes fixed in space where it passes them."""
    names = ["first", "second", "third"][: len(s)]
    holes = tuple(Piercing(name, directed=directed) for name in names)
    direction = X if directed else None
    sites = [(place * X, direction) for place in (at or s)]
    system = without_organ(uniform(LENGTH, n), ends, holes, sites)
    return system, laid(system, s, line(0.0 * X, X))


# -- the rows --------------------------------------------------------------------------------------------------------


def test_scaled_rows_are_those_of_the_constraints() -> None:
    """Independent check: central differences of Φ by the control points, each row divided by its length."""
    thread = uniform(LENGTH, N)
    holes = (Piercing("first"), Piercing("second", directed=False))
    system = without_organ(thread, FREE, holes, [(X, Z), (Z, None)])
    q, s = bent(thread.spline), np.array([0.3, 0.7]) * LENGTH
    state = laid(straight([0.3 * LENGTH, 0.7 * LENGTH])[0], s, line(0.0 * X, X))
    y = np.random.default_rng(0).standard_normal((2, 9))
    state = replace(state, q=q, y=y)
    rows, owner = scaled_rows(system, state, system.passage(q, s))
    assert list(owner) == [0] * 5 + [1] * 3

    def shifted(h: Array) -> Array:
        return phi(system.passage(q + h, s), np.zeros((len(s), 5)), y)[system.rows]

    for unknown in range(3 * N):
        h = np.zeros((N, 3))
        h.flat[unknown] = 1e-3
        column = (shifted(h) - shifted(-h)) / 2e-3  # Φ is linear in q
        unscaled = np.linalg.norm(numeric(shifted), axis=1)
        assert np.abs(rows[:, unknown] - column / unscaled).max() <= RESIDUAL


def numeric(shifted: Any) -> Array:
    """The Jacobian by differences."""
    units = 1e-3 * np.eye(3 * N).reshape(-1, N, 3)
    return np.array([(shifted(h) - shifted(-h)) / 2e-3 for h in units]).T


def test_sound_constraints_have_no_faults() -> None:
    """Independent check: what the repository ships, and a thread with a hole in every other span."""
    for name in ("two_piercings.toml", "paper_figure_1.toml"):
        simulation = prepare(
            load(SCENES / name, ["tissue.mesh.h_site=4e-3", "tissue.mesh.accuracy=given"] if name[0] == "t" else [])
        )
        assert faults(simulation.assembly.system, simulation.start) == []
    system, state = straight([2.5 * SPAN, 4.5 * SPAN, 6.5 * SPAN])
    assert faults(system, state) == []


# -- dependent -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("directed", [False, True])
def test_two_holes_at_one_place_depend_on_one_another(directed: bool) -> None:
    """Independent check: 2 nm apart, across a knot so that they lie in two spans; both are named, a third is not."""
    s = [5 * SPAN - 1e-9, 5 * SPAN + 1e-9, 9.3 * SPAN]
    system, state = straight([2.5 * SPAN, 5.5 * SPAN, 9.3 * SPAN], directed)
    state = replace(state, s=np.array(s), y=at_its_holes(system, state, s))
    (message,) = faults(system, state)
    assert "piercing 'first'" in message and "piercing 'second'" in message and "'third'" not in message
    assert "depend on one another" in message
    apart = [5 * SPAN - 1e-3, 5 * SPAN + 1e-3, 9.3 * SPAN]
    assert faults(system, replace(state, s=np.array(apart))) == []


def at_its_holes(system: System, state: State, s: list[float]) -> Array:
    """Site variables with every point on the thread."""
    y = state.y.copy()
    y[:, :3] = system.passage(state.q, np.array(s)).P
    return y


def test_a_diagnosis_is_no_larger_than_its_rows() -> None:
    """Independent check: of 200 control points, whose square would be 60 times the rows."""
    s = [0.03, 0.06]
    system, state = straight(s, n=200)
    rows, at = scaled_rows(system, state, system.passage_of(state))[0], system.passage_of(state)
    tracemalloc.start()
    assert dependence_faults(system, state, at) == []
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 * rows.nbytes


def test_a_direction_imposed_twice_on_a_straight_thread() -> None:
    """Independent check: at the clamped end and in a hole 10 nm from it; with a free end it is imposed once."""
    near = [1e-8]
    system, state = straight([0.5 * SPAN], ends=(Clamped(0.0 * X, X), Free()))
    state = replace(state, s=np.array([near[0], *state.s[1:]]))
    at = system.passage_of(state)
    (message,) = dependence_faults(system, state, at)
    assert "piercing 'first'" in message and "the clamped start of the thread" in message
    system, state = straight([0.5 * SPAN])
    assert faults(system, replace(state, s=np.array(near))) == []


def test_the_size_of_the_weakest_combination_decides() -> None:
    """Independent check: two points a distance d apart on a span h differ by a row of length of order d/h; just one
    side of the limit is refused."""
    system, state = straight([2.5 * SPAN, 5.5 * SPAN], directed=False)
    for factor, count in ((0.1, 1), (10.0, 0)):
        d = factor * DEPENDENT * SPAN
        s = np.array([5 * SPAN - 0.5 * d, 5 * SPAN + 0.5 * d])
        assert len(faults(system, replace(state, s=s))) == count


# -- too few control points ------------------------------------------------------------------------------------------


def test_two_directions_in_one_span() -> None:
    """Independent check: two directed holes in one span are refused with its length, one of them free is not."""
    system, state = straight([2.5 * SPAN, 5.5 * SPAN])
    state = replace(state, s=np.array([5.2, 5.8]) * SPAN)
    (message,) = faults(system, state)
    assert "'first'" in message and "'second'" in message
    assert f"{SPAN:.3g} m long: there are too few control points between them" in message
    loose = replace(system, piercings=(system.piercings[0], Piercing("second", directed=False)))
    assert faults(loose, state) == []
    gone = replace(state, present=np.array([True, False]))
    assert faults(system, gone) == []


# -- no tangent ------------------------------------------------------------------------------------------------------


def test_a_tangent_without_length() -> None:
    """Independent check: a thread laid together at one place has none; one just above the limit has."""
    system, state = straight([5.5 * SPAN])
    (message,) = faults(system, replace(state, q=0.5 * NO_TANGENT * state.q))
    assert message.startswith("the thread's tangent has no length at piercing 'first' (|dP/ds| = 0.005")
    assert faults(system, replace(state, q=2.0 * NO_TANGENT * state.q)) == []


# -- turning ---------------------------------------------------------------------------------------------------------


def test_a_hole_that_turns_far_at_once_is_refused() -> None:
    """Independent check: a directed hole whose frame turns by 46° from one equilibrium to the next, though this shrinks
    as it does, is refused by name; one that turns by 44° is not, nor a free one, nor one that is not there."""
    system, old = straight([5.5 * SPAN, 8.5 * SPAN])

    def turned(angle: float) -> State:
        y = old.y.copy()
        u, normal = y[1, 3:6].copy(), np.cross(y[1, 3:6], y[1, 6:])
        y[1, 3:6] = 0.3 * (np.cos(angle) * u - np.sin(angle) * normal)
        return replace(old, y=y)

    refuse_turning(system, old, turned(np.radians(44.0)))
    with pytest.raises(StepError, match=r"turned the hole by 46° in one step.*'second'") as caught:
        refuse_turning(system, old, turned(np.radians(46.0)))
    assert caught.value.piercing == "second"
    refuse_turning(system, old, replace(turned(1.5), present=np.array([True, False])))
    free = replace(system, piercings=tuple(replace(hole, directed=False) for hole in system.piercings))
    refuse_turning(free, old, turned(1.5))


# -- order -----------------------------------------------------------------------------------------------------------


def test_piercings_do_not_pass_one_another() -> None:
    """Independent check: crossing and meeting are refused with both names, coming near is not; nor is a hole that has
    been left, or is being left."""
    system, old = straight([5.5 * SPAN, 8.5 * SPAN])

    def at(first: float, second: float, **changes: Any) -> State:
        return replace(old, s=np.array([first, second]), time=1e-3, **changes)

    refuse_crossing(system, old, at(8.4 * SPAN, 8.5 * SPAN))
    for first, second in ((8.6 * SPAN, 8.5 * SPAN), (8.0 * SPAN, 8.0 * SPAN)):
        with pytest.raises(StepError, match=r"'first' .* came past piercing 'second'") as caught:
            refuse_crossing(system, old, at(first, second))
        assert caught.value.piercing == "second"
    refuse_crossing(system, old, at(8.6 * SPAN, 8.5 * SPAN, present=np.array([True, False])))
    refuse_crossing(system, old, at(1.01 * LENGTH, 8.5 * SPAN))
    knots = system.thread.spline.knots
    cut = Spline(np.sort(np.append(knots, np.full(3, knots[10]))))
    severed = replace(system, thread=replace(system.thread, spline=cut))
    assert old.s[0] < cut.cuts[0] < old.s[1]
    refuse_crossing(severed, old, at(8.6 * SPAN, 8.5 * SPAN))


def test_a_step_in_which_piercings_cross_is_halved_and_then_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: a method of stepping that makes them cross above 0.3 ms is halved; one that always does
    ends in the error."""
    system, state = straight([5.5 * SPAN, 8.5 * SPAN])

    def crossing(largest: float) -> Any:
        def take(system: System, state: State, dt: float) -> Any:
            step = stepping.try_step(system, state, dt)
            s = step.new.s[::-1] if dt > largest else step.new.s
            return replace(step, new=replace(step.new, s=s))

        return take

    assert [step.dt for step in advance(system, state, 1e-3, crossing(0.3e-3))] == [0.25e-3] * 4
    with pytest.raises(StepError, match="came past"):
        advance(system, state, 1e-3, crossing(0.0))


def test_holes_that_come_to_one_place_are_told_from_a_want_of_control_points() -> None:
    """Independent check: a step that fails with half a diameter of thread between two holes says so, with two of it it
    does not, nor where the holes begin so near."""
    system, state = straight([2.5 * SPAN, 5.5 * SPAN])
    error = StepError(0.0, 1e-3, "no convergence")
    for diameters, together in ((0.5, True), (2.0, False)):
        near = replace(state, s=5.2 * SPAN + np.array([0.0, diameters]) * system.thread.section.diameter)
        found = diagnose(system, near, error)
        assert isinstance(found, TogetherError) == together
        assert ("drawn to nothing" in str(found)) == together
        assert all("too few control points" in each for each in faults(system, near))


# -- where it is told ------------------------------------------------------------------------------------------------


def test_a_step_that_fails_for_its_constraints_says_so() -> None:
    """Independent check: the same failing method of stepping is a step error with sound constraints, and names the
    piercings with dependent ones."""

    def failing(system: System, state: State, dt: float) -> Any:
        raise StepError(state.time, dt, "the holds' matrix is singular")

    system, state = straight([2.5 * SPAN, 5.5 * SPAN])
    with pytest.raises(StepError, match="singular"):
        advance(system, state, 1e-3, failing)
    with pytest.raises(ConstraintError, match=r"'first'.*'second'.*too few control points") as caught:
        advance(system, replace(state, s=np.array([5.2, 5.8]) * SPAN), 1e-3, failing)
    assert isinstance(caught.value.__cause__, StepError)


def test_a_step_that_fails_in_a_collapsed_frame_says_so() -> None:
    """Independent check: a frame turned by 85° as a linear organ turns it, u to cos 85° of its length, is named where a
    step fails; one turned by 60° is not, nor that of a hole that asks for no direction."""

    def failing(system: System, state: State, dt: float) -> Any:
        raise StepError(state.time, dt, "no convergence")

    for degrees, directed, named in ((85.0, True, True), (60.0, True, False), (85.0, False, False)):
        system, state = straight([2.5 * SPAN, 6.5 * SPAN], directed)
        y = state.y.copy()
        y[1, 3:6] *= np.cos(np.radians(degrees))
        with pytest.raises(StepError, match="no convergence") as caught:
            advance(system, replace(state, y=y), 1e-3, failing)
        assert ("'second' has shrunk to 0.087 of its area" in str(caught.value)) == named
        assert "'first' has shrunk" not in str(caught.value)


CLOSE = """
[thread]
suture = "2-0 polypropylene"
control_points = 20
knots = "fixed"
path = [[-0.03, 0, 0], [0.03, 0, 0]]
[[piercing]]
name = "one"
at = [-0.0005, 0, 0]
direction = [1, 0, 0]
[[piercing]]
name = "two"
at = [0.0005, 0, 0]
direction = [1, 0, 0]
[solve]
duration = 0.003
"""


def test_the_command_line_refuses_at_set_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: `suture check` and `suture run` end with status 2, a sentence, and nothing written; a finer
    thread is accepted."""
    file, out = tmp_path / "close.toml", tmp_path / "out"
    file.write_text(CLOSE, encoding="utf-8")
    for arguments in (["check", str(file)], ["run", str(file), "--out", str(out)]):
        assert command.main(arguments) == command.REFUSED
        message = capsys.readouterr().err
        assert "\nsuture: piercing 'one' (s = 0.0295 m) and piercing 'two' (s = 0.0305 m)" in f"\n{message}"
        assert "raise thread.control_points" in message
    assert list(out.iterdir()) == []
    assert command.main(["check", str(file), "--set", "thread.control_points=160"]) == 0


def test_a_path_that_cannot_be_laid_is_refused() -> None:
    """Independent check: a hole far from the path, its abscissa given at the other end of the thread."""
    data = tomllib.loads(CLOSE)
    data["piercing"] = [
        {"name": "far", "at": [0.0, 0.5, 0.0], "s": 0.03},
        {"name": "two", "at": [0.0, -0.5, 0.0], "s": 0.04},
    ]
    with pytest.raises(ScenarioError, match=r"thread\.path is refused: the thread cannot be laid"):
        prepare(parse(data))


@pytest.mark.parametrize(("share", "refused"), [(0.5, True), (0.9, False), (1.5, False)])
def test_a_thread_too_short_for_its_path_is_refused(share: float, refused: bool) -> None:
    """Independent check: no suture doubles its length; one that is slack, or a little stretched, may be asked for."""
    data = tomllib.loads(CLOSE)
    data["piercing"] = []
    path = assemble(parse(data)).path.length
    data["thread"]["length"] = share * path
    if not refused:
        assert assemble(parse(data)).system.thread.spline.end == share * path
        return
    with pytest.raises(ScenarioError, match=r"thread\.length = .* is refused: the path is .* increase it"):
        assemble(parse(data))


def test_a_fault_that_a_piercing_brings_is_told_when_it_begins(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Independent check: the second of two holes in a span begins at 1 ms; the run fails there with both names."""
    file, out = tmp_path / "late.toml", tmp_path / "out"
    file.write_text(CLOSE.replace('name = "two"', 'name = "two"\nfrom = 0.001'), encoding="utf-8")
    assert command.main(["run", str(file), "--out", str(out), "--quiet", "--no-picture"]) == command.FAILED
    message = capsys.readouterr().err
    assert "piercing 'one'" in message and "piercing 'two'" in message and "t = 0.001 s" in message
    summary = json.loads((out / "summary.json").read_text())
    assert summary["status"] == "failed" and "too few control points" in summary["error"]


def test_a_failure_on_other_knots_than_at_the_start_is_explained() -> None:
    """Consistency check: a step is explained on the knots of its state, which may be more than those of the run."""
    system, state = straight([2.5 * SPAN, 5.5 * SPAN])
    finer = Spline(clamped_knots(np.linspace(0.0, LENGTH, 2 * N)))
    error = StepError(0.0, 1e-3, "no convergence")
    other = replace(state, q=greville(finer)[:, None] * X, spline=finer, s=np.array([0.5, 0.9]) * LENGTH)
    assert diagnose(system, other, error) is error


def test_a_knot_between_two_holes_takes_the_fault_away() -> None:
    """Independent check: the remedy that is named, one control point more between them."""
    breaks = np.linspace(0.0, LENGTH, N - 2)
    system, state = straight([2.5 * SPAN, 5.5 * SPAN])
    state = replace(state, s=np.array([5.2, 5.8]) * SPAN)
    finer = thread_on(clamped_knots(np.sort(np.append(breaks, 5.5 * SPAN))))
    between = replace(system, thread=finer)
    assert len(faults(system, state)) == 1
    assert faults(between, replace(state, q=greville(finer.spline)[:, None] * X)) == []


@pytest.mark.parametrize(("organ", "held"), [({}, "hold an end"), ({"dragged": abs}, "hold a body")])
def test_what_flies_away_is_named_with_what_could_hold_it(organ: dict[str, Any], held: str) -> None:
    """Behaviour: slack strands do not hold a body without a clamp, and the ends of the thread are not at fault."""
    none = np.zeros(0, dtype=bool)
    holds = {"rows": np.zeros((0, 5), dtype=bool), "may_slide": none, "by_hand": none}
    system: Any = SimpleNamespace(organ=SimpleNamespace(**organ), piercings=(1,), ends=(), ties=(1,), **holds)
    old, new = (SimpleNamespace(q=far * np.eye(4, 3), time=0.0) for far in (1.0, 1e5))
    with pytest.raises(StepError, match=f"the thread flies away: nothing balances its loads.*; {held}"):
        refuse_flown(system, old, new)
    assert ("clamp the body" in remedy_for(system, SimpleNamespace(present=none))) == bool(organ)
