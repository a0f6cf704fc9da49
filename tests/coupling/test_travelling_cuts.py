"""A thread that is cut, from the start or during the run, on knots that travel with its holes."""

from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coupling.errors import CouplingError
from coupling.reports.audit import audit_step, initial_energies
from coupling.run import begin
from coupling.run.cutting import cut_thread
from coupling.run.run import Run
from coupling.step.stepping import try_step
from coupling.system import Friction, Piercing, State, System
from studies.scenario import Scenario, ScenarioError
from studies.simulation import prepare
from studies.simulation.assembly import assemble
from studies.simulation.recording import thread_record
from tests.bounds import RESIDUAL, TWO_SOLVERS
from tests.coupling.test_cutting import STITCH, STRING
from tests.thread.threads import X, Z, laid, line, without_organ
from thread.catalogue import suture
from thread.ends import Driven, End, Free
from thread.packets import Hold, travelling
from thread.placed import Placed
from thread.thread import Thread

LENGTH, CUT = 0.06, 0.0351
HOLES, SITES = (0.014, 0.048), (0.014 * X, 0.048 * X)
ENDS: tuple[End, End] = (
    Driven(np.array([[0.0, 0.0, 0.0, 0.0], [0.02, -2e-3, 0.0, 5e-4]])),
    Driven(np.array([[0.0, LENGTH, 0.0, 0.0], [0.02, LENGTH + 4e-3, 1e-3, 1e-3]])),
)
SWUNG = 5e-3  # of the weight of an end that hangs: at each load step it is tied to where it lay
STRAIN, GRIP, GRIPPED = 0.01, 0.1, 1e-5  # -, N, of GRIP: (T/EA)² and more than Newton's method leaves


def system_of(low: float, high: float, ends: tuple[End, End], cuts: tuple[float, ...] = ()) -> System:
    """The holes between two abscissae, rough and of which the first imposes a direction, of a thread of its own."""
    numbers = [k for k, s in enumerate(HOLES) if low < s < high]
    s = np.array([HOLES[k] - low for k in numbers])
    holds = [Hold(k, at, number == 0, 5e-4) for k, (number, at) in enumerate(zip(numbers, s, strict=True))]
    travel = travelling(high - low, holds, len(holds), 2e-3, (None, None), cuts=cuts)
    spline = Placed(travel.knots, travel.places(s), travel)
    thread = Thread(spline, suture("2-0 polypropylene"), damping=20.0)
    holes = [Piercing(f"h{k}", directed=k == 0, friction=Friction(0.2, 0.1, channel=2e-3)) for k in numbers]
    tilted = np.array([0.9, 0.0, -np.sqrt(0.19)])
    sites = [(SITES[k], tilted if k == 0 else None) for k in numbers]
    return without_organ(thread, ends, tuple(holes), sites, gravity=-9.81 * Z)


def cut_system() -> tuple[System, State]:
    """The thread in two pieces, laid straight."""
    system = system_of(0.0, LENGTH, ENDS, (CUT,))
    return system, laid(system, HOLES, line(np.zeros(3), X))


def piece_of(state: State, piece: int, low: float, high: float, ends: tuple[End, End]) -> tuple[System, State]:
    """A piece as a thread of its own, where it is in a state."""
    system, one = system_of(low, high, ends), slice(piece, piece + 1)
    spline = system.thread.placed(state.s[one] - low).spline
    points = slice(0, spline.n) if piece == 0 else slice(len(state.q) - spline.n, None)
    spans = slice(0, len(spline.first)) if piece == 0 else slice(len(state.N) - len(spline.first), None)
    by_hold = {name: getattr(state, name)[one] for name in ("s_dot", "lam", "y", "sigma", "present", "sense")}
    return system, replace(
        state, q=state.q[points], v=state.v[points], N=state.N[spans], organ=system.organ.start(),
        s=state.s[one] - low, spline=spline, **by_hold,
    )  # fmt: skip


def test_two_pieces_move_as_two_threads() -> None:
    """Independent check: the same steps of two systems that know nothing of one another, from the same start, through
    slip and stick, under gravity, and with packets that move."""
    system, state = cut_system()
    one, other = (
        piece_of(state, 0, 0.0, CUT, (ENDS[0], Free())),
        piece_of(state, 1, CUT, LENGTH, (Free(), ENDS[1])),
    )
    for _ in range(8):
        state = try_step(system, state, 2e-3).new
        one, other = ((own, try_step(own, was, 2e-3).new) for own, was in (one, other))
        parts = one[1], other[1]
        for name in ("q", "v", "lam", "y"):
            alone = np.concatenate([getattr(part, name) for part in parts])
            assert np.abs(getattr(state, name) - alone).max() < TWO_SOLVERS * np.abs(alone).max(), name
        s = np.array([parts[0].s[0], CUT + parts[1].s[0]])
        assert np.abs(state.s - s).max() < TWO_SOLVERS * LENGTH
        assert np.array_equal(state.sigma, np.concatenate([part.sigma for part in parts]))
    assert abs(state.s - HOLES).max() > 1e-3


def test_energy_is_balanced_at_every_step() -> None:
    """Identity: the audit of each step of a thread in two pieces closes, to what the forces are solved to, along the
    way of the thread."""
    system, state = cut_system()
    energies, owed = initial_energies(system, state), 0.0
    for _ in range(6):
        step = try_step(system, state, 2e-3)
        energies, state = audit_step(system, energies, step), step.new
        owed += RESIDUAL * step.solution.residual.force_scale * np.abs(step.new.q - step.old.q).max()
        assert abs(energies.balance_error) < owed < 1e-7 * energies.at_stake


def test_loops_and_python_make_the_same_steps_of_pieces() -> None:
    """Consistency check: steps made in the compiled loops and one by one, with packets made anew between them."""
    system, state = cut_system()
    system = replace(system, compiled=True)
    one = other = begin(system, state, try_step)
    one = one.steps(1e-3, 12)
    for _ in range(12):
        step = replace(other, system=replace(other.system, compiled=False)).step(1e-3)
        other = replace(step, system=replace(step.system, compiled=True))
    for name in ("q", "v", "s", "y", "lam", "reaction", "drive"):
        x, y = getattr(one.state, name), getattr(other.state, name)
        assert np.abs(x - y).max() < 10.0 * TWO_SOLVERS * np.abs(x).max(), name
    assert one.energies.external_work == pytest.approx(other.energies.external_work, rel=1e-6)
    assert abs(one.energies.balance_error) < RESIDUAL * one.energies.at_stake


def turned(name: str, x: float, **more: Any) -> dict[str, Any]:
    """An anchored hole on the x axis that imposes a direction across the pull."""
    return {"name": name, "at": [x, 0, 0], "kind": "anchored", "direction": [0.6, 0.0, 0.8]} | more


def resting(path: list[list[float]], points: int, holes: list[dict[str, Any]], ends: dict[str, Any]) -> Any:
    """The last record of a thread at rest."""
    thread = {"suture": "4-0 nylon", "knots": "travelling", "control_points": points, "path": path} | ends
    table = {"thread": thread, "piercing": holes, "solve": {"kind": "static", "load_steps": 4}}
    *_, (last, _) = prepare(Scenario.model_validate(table)).advance()
    return last


def test_pieces_at_rest_have_each_the_answer_of_a_thread_of_its_own() -> None:
    """Consistency check: two pieces with a hole and a pull each against two threads alone: what bends, what is pulled,
    and the free ends, which bear nothing."""
    pulls = {"kind": "pulled", "force": [-0.3, 0, 0]}, {"kind": "pulled", "force": [0.2, 0, -0.1]}
    both = resting(
        [[0, 0, 0], [0.06, 0, 0]],
        33,
        [turned("a", 0.02), turned("b", 0.04)],
        {"cuts": [0.03], "start": pulls[0], "end": pulls[1]},
    )
    one = resting([[0, 0, 0], [0.03, 0, 0]], 18, [turned("a", 0.02)], {"start": pulls[0]})
    other = resting([[0.03, 0, 0], [0.06, 0, 0]], 18, [turned("b", 0.04)], {"end": pulls[1]})
    for hole, alone in zip(both.piercings, (one.piercings[0], other.piercings[0]), strict=True):
        assert np.linalg.norm(alone.force) > 0.2
        assert hole.force == pytest.approx(alone.force, abs=1e-7)
        assert hole.couple == pytest.approx(alone.couple, abs=1e-6 * float(np.linalg.norm(alone.couple)))
        assert hole.tension_before == pytest.approx(alone.tension_before, abs=1e-7)
        assert hole.tension_after == pytest.approx(alone.tension_after, abs=1e-7)


def test_what_nothing_holds_at_rest_has_no_weight() -> None:
    """Independent check: under gravity the piece in the middle, in no hole, stays where it is as it is cut free, and
    the other two hang on their ends and holes."""
    table = deepcopy(string())
    table["thread"]["end"] = {"kind": "fixed"}
    table["piercing"] = [{"name": "hole", "at": [0.01, 0, 0], "kind": "anchored"}]
    table["cut"] = [{"s": s, "time": 0.4} for s in (0.015, 0.024)]
    table["solve"] = {"kind": "static", "load_steps": 4, "gravity": [0, 0, -9.81]}
    now = states(table)[-1]
    spline = now.system.thread.spline
    _, middle, end = np.split(now.state.q, spline.piece_starts[1:])
    assert np.abs(middle[:, 2]).max() < 1e-4 * (LENGTH_OF_STRING - 0.024)
    weight = suture("2-0 polypropylene").rhoA * 9.81 * (LENGTH_OF_STRING - 0.024)
    assert now.state.reaction[1, 2] == pytest.approx(weight, rel=SWUNG)
    assert end[:, 2].min() == pytest.approx(0.024 - LENGTH_OF_STRING, rel=SWUNG)
    assert abs(now.energies.balance_error) < RESIDUAL * now.energies.at_stake


LENGTH_OF_STRING = 0.03 / (1.0 + STRAIN)


def string() -> dict[str, Any]:
    """A thread under tension between two holders, cut after a microsecond."""
    thread = {name: value for name, value in STRING["thread"].items() if name != "graded"}
    return STRING | {"thread": thread | {"knots": "travelling"}}


def stitch(**solve: Any) -> dict[str, Any]:
    """A stitch under tension through an anchored hole and a rough one, cut between them."""
    thread, solve = STITCH["thread"] | {"knots": "travelling"}, STITCH["solve"] | solve
    return STITCH | {"thread": thread, "solve": solve, "output": {"every": 1}}


def states(table: dict[str, Any]) -> list[Run[Any]]:
    """The run after every step."""
    simulation = prepare(Scenario.model_validate(table))
    runs = [simulation.beginning()]
    while runs[-1].number < simulation.steps:
        runs.append(simulation.next(runs[-1]))
    return runs


def test_a_string_that_is_cut_recoils_with_the_wave() -> None:
    """Independent check: the cut keeps momentum and energy. From then on each holder goes on with the tension T until
    the wave c = √(E/ρ) reaches it, so that the pieces gain −T t and T t, and the new ends go apart at 2 T/(ρAc); the
    balance of energy closes."""
    runs, section = states(string()), suture("2-0 polypropylene")
    (number, event), *_ = [(run.number, event) for run in runs for event in run.events]
    assert (number, event.kind, event.s) == (10, "cut", 0.0121)
    assert abs(event.loss) <= 1e-9 * runs[9].energies.elastic
    now = runs[-1]
    T, t, split = (
        float(runs[9].state.reaction[1, 0]),
        now.state.time - event.time,
        now.system.thread.spline.piece_starts[1],
    )
    assert pytest.approx(section.EA * STRAIN, rel=0.02) == T
    p = now.system.thread.momentum(now.state.v)[:, 0]
    assert p[:split].sum() == pytest.approx(-T * t, rel=0.01) and p[split:].sum() == pytest.approx(T * t, rel=0.01)
    apart = now.state.v[split, 0] - now.state.v[split - 1, 0]
    assert apart == pytest.approx(2.0 * T / (section.rhoA * np.sqrt(section.EA / section.rhoA)), rel=0.1)
    assert now.energies.kinetic > 0.1 * runs[9].energies.elastic
    for run in runs[1:]:
        assert abs(run.energies.balance_error) <= RESIDUAL * run.energies.at_stake


@pytest.mark.parametrize("integrator", ["euler", "bdf2"])
def test_a_stitch_that_is_cut_lets_its_hole_go(integrator: str) -> None:
    """Independent check: behind the cut nothing bears, the strand at the anchor is slack, and the balance closes at
    every step, also over the cut, whose new knots store what the curve stored within a thousandth. Identity: a run that
    is resumed just before the cut, after it, or later makes the same bits."""
    simulation = prepare(Scenario.model_validate(stitch(integrator=integrator)))
    whole = [record for record, _ in simulation.advance()]
    tension = whole[3].piercings[0].tension_after
    assert abs(whole[-1].piercings[0].tension_after) < 0.1 * tension
    (cut,) = [event for record in whole for event in record.events if event.kind == "cut"]
    assert abs(cut.loss) < 1e-3 * (whole[2].energy.elastic_thread + whole[2].energy.kinetic)
    for record in whole[1:]:
        energy = record.energy
        assert abs(energy.balance_error) < RESIDUAL * energy.at_stake
    for at in (2, 3, 7):
        again = [
            record
            for record, _ in prepare(Scenario.model_validate(stitch(integrator=integrator))).advance(whole[at].memory)
        ]
        assert len(again) == len(whole) - at
        for one, other in zip(whole[at:], again, strict=True):
            assert one.energy == other.energy
            assert [hole.s for hole in one.piercings] == [hole.s for hole in other.piercings]


def test_a_frame_shows_the_pieces_apart() -> None:
    """Identity: samples of each piece from end to end, and no tension at the ends that are cut."""
    table = deepcopy(stitch())
    table["cut"], table["thread"]["cuts"] = [], [0.0113]
    thread = thread_record(states(table)[-1])
    pieces, bounds = thread.split(thread.points), thread.split(thread.s)
    assert len(pieces) == 2
    assert bounds[0][-1] == bounds[1][0] == 0.0113 and bounds[1][-1] == pytest.approx(0.0222)
    tension = thread.split(thread.tension)
    assert abs(tension[0][-1]) < 0.1 * np.abs(thread.tension).max()
    assert np.linalg.norm(pieces[0][-1] - pieces[1][0]) > 1e-5


@pytest.mark.parametrize("end", [{"kind": "pulled", "force": [1.0, 0, 0]}, {"kind": "fixed"}])
def test_at_rest_the_holes_keep_what_they_grip(end: dict[str, Any]) -> None:
    """Independent check: behind the cut nothing draws, and every hole from there on holds back F₀ of what the thread
    was under; a dead load on a piece that nothing holds draws nothing. The balance closes."""
    table, grip = deepcopy(string()), {"static": 0.0, "kinetic": 0.0, "grip": GRIP}
    table["thread"] |= {"path": [[0, 0, 0], [0.06, 0, 0]], "length": 0.06 / (1.0 + STRAIN), "end": end}
    table["piercing"] = [{"name": name, "at": [x, 0, 0], "friction": grip} for name, x in (("a", 0.02), ("b", 0.04))]
    table |= {"cut": [{"s": 0.05, "time": 0.7}], "solve": {"kind": "static", "load_steps": 4}}
    *_, before, now, _ = states(table)
    assert ["cut" in {event.kind for event in run.events} for run in (before, now)] == [False, True]
    tensions = [now.piercings[0].tension_before, *(hole.tension_after for hole in now.piercings)]
    assert before.piercings[1].tension_after > 0.4
    assert tensions == pytest.approx([2.0 * GRIP, GRIP, 0.0], abs=2.0 * GRIPPED * GRIP)
    assert abs(now.energies.balance_error) <= RESIDUAL * before.energies.at_stake


def test_a_piece_that_nothing_holds_back_runs_out_of_its_hole() -> None:
    """Independent check: a piece that is drawn out over the end that is cut leaves its hole there, and the other one
    stays in its own."""
    table = deepcopy(string())
    table["thread"] |= {"end": {"kind": "pulled", "force": [0.05, 0, 0], "ramp": 1e-3}, "damping": 50.0, "length": 0.03}
    table["piercing"] = [
        {"name": name, "at": [x, 0, 0], "direction": "free"} for name, x in (("in", 0.008), ("out", 0.02))
    ]
    table["thread"]["end"]["ramp"] = 1e-4
    table["cut"] = [{"s": 0.015, "time": 2e-4}]
    table["solve"] = {"dt": 2e-5, "duration": 1e-3}
    runs = states(table)
    events = [(event.kind, event.piercing) for run in runs for event in run.events]
    assert ("leaves", "out") in events and ("leaves", "in") not in events
    now = runs[-1]
    assert [hole.state == "left" for hole in now.piercings] == [False, True]
    assert now.state.q[-1, 0] > 0.035
    assert abs(now.energies.balance_error) <= RESIDUAL * now.energies.at_stake


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"cut": [{"s": 1e-4, "time": 1e-6}]}, r"cut.s = 0.0001 is refused: .* nearer than the diameter"),
        ({"cut": [{"s": s, "time": 1e-6} for s in (0.01, 0.0101)]}, r"cut.s = 0.0101 is refused: .* is nearer"),
        ({"thread": {"cuts": [1e-4]}}, r"thread.cuts = 0.0001 is refused: .* nearer than the diameter"),
        ({"thread": {"cuts": [0.02]}, "piercing": [{"name": "a", "at": [0, 0, 0], "s": 0.02}]}, "cut next to it"),
    ],
)
def test_refusals(change: dict[str, Any], words: str) -> None:
    """Independent check: what cannot be cut is refused by its key before anything is solved."""
    table = deepcopy(string())
    for key, value in change.items():
        table[key] = table.get(key, {}) | value if isinstance(value, dict) else value
    with pytest.raises(ScenarioError, match=words):
        assemble(Scenario.model_validate(table))


def test_what_is_cut_already_is_refused() -> None:
    """Independent check: from Python, at a cut, at an end and at a hole."""
    system, state = cut_system()
    for place in (CUT, CUT + 1e-4, 0.0, 1e-6, 1.0):
        with pytest.raises(CouplingError, match=r"cut at .* diameter"):
            cut_thread(system, state, place)
    with pytest.raises(CouplingError, match=r"cut at .* put them apart"):
        cut_thread(system, state, float(state.s[0]))
