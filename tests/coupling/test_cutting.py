"""A thread that is cut while it is under tension: what stays, what moves, and how a run goes on."""

from copy import deepcopy
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coupling.errors import CouplingError
from coupling.reports.audit import initial_energies
from coupling.run.cutting import Cut, cut_thread, momentum
from coupling.run.run import Run, begin
from coupling.step.stepping import try_step
from studies.command import command
from studies.scenario import ScenarioError, dump, parse
from studies.simulation import prepare
from studies.simulation.assembly import assemble
from tests.bounds import IDENTITY
from thread.catalogue import suture
from thread.cutting import cut
from thread.ends import Driven, Fixed
from thread.knots import uniform_knots
from thread.spline import Spline

AUDIT = 1e-9  # of the energy at stake
GRIP = 0.1  # of a hole [N]
GRIPPED = 1e-6  # of it: what keeps a piece that is cut where it lies pulls by a part in 1e12 of its stiffness
BACK = 1e-3  # of the way that a hole had been drawn: the stub still has some bend
LENGTH, STRAIN = 0.03, 0.01
STRING: dict[str, Any] = {
    "thread": {
        "suture": "2-0 polypropylene",
        "control_points": 43,
        "knots": "fixed",
        "length": LENGTH / (1.0 + STRAIN),
        "path": [[0, 0, 0], [LENGTH, 0, 0]],
        "start": {"kind": "fixed"},
        "end": {"kind": "driven", "waypoints": [[0.0, LENGTH, 0.0, 0.0]]},
    },
    "cut": [{"s": 0.0121, "time": 1e-6}],
    "solve": {"dt": 1e-7, "duration": 7e-6},
}
STITCH: dict[str, Any] = {
    "thread": {
        "suture": "2-0 polypropylene",
        "control_points": 40,
        "knots": "fixed",
        "damping": 20.0,
        "path": [[-0.01, 0, 0.004], [-0.004, 0, 0], [0.004, 0, 0], [0.01, 0, 0.004]],
        "length": 0.0222,
        "start": {"kind": "fixed"},
        "end": {"kind": "driven", "waypoints": [[0.0, 0.01, 0, 0.004]]},
    },
    "piercing": [
        {"name": "left", "at": [-0.004, 0, 0], "kind": "anchored"},
        {"name": "right", "at": [0.004, 0, 0], "friction": {"static": 0.1, "kinetic": 0.1}},
    ],
    "cut": [{"s": 0.0113, "time": 3e-5}],
    "solve": {"dt": 1e-5, "duration": 1.2e-4},
    "output": {"every": 3},
}


@pytest.mark.parametrize("s", [0.0121, 0.0125, 0.012501])
def test_a_cut_spline_holds_the_same_functions(s: float) -> None:
    """Independent check: on either side the curve is what it was, up to the cut; it stands at s, or at a knot nearer
    than a tenth of a span, and then no span is added."""
    spline = Spline(uniform_knots(LENGTH, 27))
    q = np.random.default_rng(0).standard_normal((spline.n, 3))
    other, place, (same,) = cut(spline, s, [q])
    assert other.pieces == 2 and np.array_equal(other.cuts, [place]) and abs(place - s) < 0.1 * LENGTH / 24
    at_knot = bool(np.any(spline.breaks == place))
    assert other.n == spline.n + (3 if at_knot else 4) and len(other.breaks) == len(spline.breaks) + (not at_knot)
    for low, high in ((0.0, place), (place, LENGTH)):
        there = np.linspace(low, high, 50)
        home = np.full(50, 0.5 * (low + high))
        was, now = spline.curve(q, there)[:, 0], other.curve(same, there, home)[:, 0]
        assert np.abs(was - now).max() <= IDENTITY * np.abs(q).max()


def states(table: dict[str, Any]) -> list[Run[Any]]:
    """The run after every step."""
    simulation = prepare(parse(table))
    runs = [simulation.beginning()]
    while runs[-1].number < simulation.steps:
        runs.append(simulation.next(runs[-1]))
    return runs


def test_a_string_that_is_cut_recoils_with_the_wave() -> None:
    """Independent check: the cut keeps momentum and energy. From then on each holder goes on with the tension T until
    the wave c = √(E/ρ) reaches it, so that the pieces gain −T t and T t, and the new ends go apart at 2 T/(ρAc); the
    balance of energy closes."""
    runs = states(STRING)
    section = suture("2-0 polypropylene")
    (number, event), *_ = [(run.number, event) for run in runs for event in run.events]
    assert (number, event.kind, event.piercing, event.control_points) == (10, "cut", "", 47)
    assert abs(event.loss) <= AUDIT * runs[9].energies.elastic and np.abs(event.impulse).max() <= 1e-15
    now = runs[-1]
    T, t = float(runs[9].state.reaction[1, 0]), now.state.time - event.time
    assert pytest.approx(section.EA * STRAIN, rel=0.02) == T
    split = int(np.searchsorted(now.system.thread.spline.knots, event.s))
    p = now.system.thread.momentum(now.state.v)[:, 0]
    assert p[:split].sum() == pytest.approx(-T * t, rel=0.01) and p[split:].sum() == pytest.approx(T * t, rel=0.01)
    apart = now.state.v[split, 0] - now.state.v[split - 1, 0]
    wave = np.sqrt(section.EA / section.rhoA)
    assert apart == pytest.approx(2.0 * T / (section.rhoA * wave), rel=0.1)
    assert abs(now.energies.balance_error) <= AUDIT * now.energies.at_stake
    assert now.energies.kinetic > 0.1 * runs[9].energies.elastic


def test_a_piece_that_nothing_holds_flies_under_its_load() -> None:
    """Independent check: from the cut on, the impulse of the dead load is the momentum of the piece, F t, by any scheme
    that is exact for a linear velocity. The thread goes hundreds of its lengths in a step, in few corrections; the
    piece at the holder stays within its length of it."""
    force, time, at = 2.0, 5e-3, 0.012
    thread = STRING["thread"] | {"knots": "travelling", "length": LENGTH, "control_points": 20}
    end = {"kind": "pulled", "force": [force, 0.1 * force, 0.0], "ramp": 2e-3}
    table = {"thread": thread | {"end": end}, "cut": [{"s": at, "time": time}], "solve": {"dt": 1e-3, "duration": 2e-2}}
    runs = [run for run in states(table) if run.state.time > 1.5 * time]
    impulse = np.array([force, 0.1 * force, 0.0])
    for before, after in pairwise(runs):
        first = after.system.thread.spline.piece_starts[1]
        P = [(run.system.thread.mass_matrix @ run.state.v)[first:].sum(axis=0) for run in (before, after)]
        assert np.abs(P[1] - P[0] - 1e-3 * impulse).max() <= AUDIT * 1e-3 * force
        assert sum(step.solution.iterations for step in after.taken) <= 20
        assert np.linalg.norm(after.state.q[:first], axis=1).max() <= at * (1.0 + STRAIN)
    assert runs[-1].state.q[-1, 0] > 1e3 * LENGTH


@pytest.mark.parametrize("energy", ["continuous", "springs"])
def test_a_twisted_thread_that_is_cut_spins_back_with_the_wave(energy: str) -> None:
    """Independent check: a thread under a uniform torque M = GJ φ/L. From the cut on each holder goes on with it until
    the wave c = √(GJ/ρJ) reaches it, so that the spins of the pieces gain −M t and M t, and the new ends turn apart at
    2 M/(ρJ c); the cut keeps momentum and energy, and the balance closes."""
    table = STRING | {"thread": STRING["thread"] | {"twist": True, "energy": energy}}
    simulation = prepare(parse(table))
    laid, section, state = simulation.assembly.system, suture("2-0 polypropylene"), simulation.start
    t, length = laid.thread.spline.knots, laid.thread.spline.end
    q = state.q.copy()
    q[:, 3] = (t[1:-3] + t[2:-2] + t[3:-1]) / (3.0 * length)  # the places of the points: θ rises evenly to 1
    left = Fixed(np.zeros(3), turn=np.array([[0.0, 0.0]]))
    right = Driven(np.array([[0.0, LENGTH, 0.0, 0.0]]), turn=np.array([[0.0, 0.0], [1e-12, 1.0]]))
    run = begin(replace(laid, ends=(left, right)), replace(state, q=q), try_step, cuts=(Cut(0.0121, 1e-6),))
    runs = [run]
    while run.number < 70:
        run = run.step(1e-7)
        runs.append(run)
    event, *_ = [event for run in runs for event in run.events]
    M = section.GJ / length
    assert runs[9].state.reaction[:, 3] == pytest.approx([-M, M], rel=1e-6)
    assert event.kind == "cut" and abs(event.loss) <= AUDIT * runs[9].energies.elastic
    split, lasted = int(run.system.thread.spline.piece_starts[1]), run.state.time - event.time
    spins = run.system.thread.momentum(run.state.v)[:, 3]
    gained = [spins[:split].sum(), spins[split:].sum()]
    assert gained == pytest.approx([-M * lasted, M * lasted], rel=1e-3)
    wave = np.sqrt(section.GJ / section.rhoJ)
    apart = run.state.v[split, 3] - run.state.v[split - 1, 3]
    assert apart == pytest.approx(2.0 * M / (section.rhoJ * wave), rel=0.02)
    assert abs(run.energies.balance_error) <= AUDIT * run.energies.at_stake
    assert run.energies.kinetic > 0.1 * runs[9].energies.elastic


@pytest.mark.parametrize("more", [{}, {"energy": "springs"}])
def test_a_twisted_thread_that_is_cut_at_rest_bears_no_torque(more: dict[str, Any]) -> None:
    """Independent check: before the cut the torque is GJ φ/L, after it neither holder bears any: the piece at the
    clamped one has turned back, that at the hand by the hand's whole angle; the balance closes."""
    hand = {"kind": "driven", "waypoints": [[0.0, LENGTH, 0, 0]], "turn": [[0.0, 0.0], [0.5, 2.0]]}
    thread = STRING["thread"] | {"twist": True, "start": {"kind": "clamped"}, "end": hand, **more}
    table = {
        "thread": thread,
        "cut": [{"s": 0.0121, "time": 0.9}],
        "solve": {"kind": "static", "load_steps": 2},
    }
    _, before, now = states(table)
    section = suture("2-0 polypropylene")
    M = section.GJ * 2.0 * (1.0 + STRAIN) / LENGTH
    assert before.state.reaction[:, 3] == pytest.approx([-M, M], rel=1e-6)
    assert np.abs(now.state.reaction[:, 3]).max() <= GRIPPED * M
    split = now.system.thread.spline.piece_starts[1]
    assert np.abs(now.state.q[:split, 3]).max() <= GRIPPED and np.ptp(now.state.q[split:, 3]) <= GRIPPED
    assert now.state.q[-1, 3] == 2.0
    assert abs(now.energies.balance_error) <= AUDIT * before.energies.elastic


def test_a_coil_that_is_cut_curls_up() -> None:
    """Independent check: a thread that remembers its coil is held straight between two clamps; cut, each piece lies
    along a circle of the coil's radius and stores nothing."""
    clamps = {"start": {"kind": "clamped"}, "end": {"kind": "clamped"}}
    coil = {"twist": True, "coil_radius": 0.02, "coil_towards": [0, 0, 1.0], "length": LENGTH}
    table = {
        "thread": STRING["thread"] | clamps | coil,
        "cut": [{"s": 0.0121, "time": 0.4}],
        "solve": {"kind": "static", "load_steps": 2},
    }
    _, _, now = states(table)
    spline = now.system.thread.spline
    for low, high in pairwise(spline.piece_ends):
        s = np.linspace(low, high, 22)[1:-1]
        _, T, K, _ = spline.curve(now.state.q[:, :3], s).swapaxes(0, 1)
        curvature = np.linalg.norm(np.cross(T, K), axis=1) / np.linalg.norm(T, axis=1) ** 3
        assert curvature == pytest.approx(1.0 / 0.02, rel=1e-3)
    straight = 0.5 * suture("2-0 polypropylene").EI * LENGTH / 0.02**2
    assert now.energies.elastic_thread <= 1e-6 * straight
    assert abs(now.energies.balance_error) <= AUDIT * straight


@pytest.mark.parametrize("more", [{}, {"energy": "springs"}, {"twist": True}])
def test_a_cut_stitch_lets_its_hole_go(tmp_path: Path, more: dict[str, Any]) -> None:
    """Independent check: behind the cut nothing bears, the strand at the anchor is slack, and the balance closes.
    Consistency check: a run that goes on before and one after the cut give the same numbers, bit by bit."""
    table = STITCH | {"thread": STITCH["thread"] | more}
    runs = states(table)
    assert runs[3].piercings[0].tension_after > 10.0 * abs(runs[-1].piercings[0].tension_after)
    energies = runs[-1].energies
    assert abs(energies.balance_error) <= AUDIT * energies.at_stake
    file, say = tmp_path / "scene.toml", ["--quiet", "--no-picture"]
    file.write_text(dump(parse(table)))
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert command.main(["run", str(file), "--out", str(whole), *say]) == 0
    for duration in ("2e-5", "6e-5"):
        resume = ["--resume"] if parts.exists() else []
        length = ["--set", f"solve.duration={duration}"]
        assert command.main(["run", str(file), "--out", str(parts), *length, *resume, *say]) == 0
    assert command.main(["run", str(file), "--out", str(parts), "--resume", *say]) == 0
    for name in ("piercings.csv", "energy.csv", "events.csv"):
        assert (whole / name).read_bytes() == (parts / name).read_bytes()
    assert ",cut,," in (whole / "events.csv").read_text()


@pytest.mark.parametrize("end", [{"kind": "pulled", "force": [1.0, 0, 0]}, {"kind": "fixed"}])
def test_at_rest_the_holes_keep_what_they_grip(end: dict[str, Any]) -> None:
    """Independent check: behind the cut nothing draws, and every hole from there on holds back F₀ of what the thread
    was under; a dead load on a piece that nothing holds draws nothing. What the rest of the tension stored is lost, and
    the balance closes. Consistency check: resumed, the same numbers bit by bit."""
    grip = {"static": 0.0, "kinetic": 0.0, "grip": GRIP}
    table = {
        "thread": STRING["thread"]
        | {"path": [[0, 0, 0], [0.06, 0, 0]], "length": 0.06 / (1.0 + STRAIN), "end": end, "start": {"kind": "fixed"}},
        "piercing": [{"name": name, "at": [x, 0, 0], "friction": grip} for name, x in (("a", 0.02), ("b", 0.04))],
        "cut": [{"s": 0.05, "time": 0.7}],
        "solve": {"kind": "static", "load_steps": 4},
        "output": {"every": 1},
    }
    _, _, before, now, _ = states(table)
    assert ["cut" in {event.kind for event in run.events} for run in (before, now)] == [False, True]
    assert before.piercings[1].tension_after > 0.4
    tensions = [now.piercings[0].tension_before, *(hole.tension_after for hole in now.piercings)]
    assert tensions == pytest.approx([2.0 * GRIP, GRIP, 0.0], abs=GRIPPED * GRIP)
    if end["kind"] == "pulled":
        stored = 0.02 * ((2.0 * GRIP) ** 2 + GRIP**2) / (2.0 * suture("2-0 polypropylene").EA)  # strands of 20 mm
        assert now.energies.elastic_thread == pytest.approx(stored, rel=0.01)
        assert np.abs(now.state.reaction[1]).max() <= GRIPPED * GRIP
    energies = now.energies
    assert energies.numerical_dissipation > 0.0
    assert abs(energies.balance_error) <= AUDIT * energies.at_stake
    simulation = prepare(parse(table))
    whole = [record for record, _ in simulation.advance()]
    _, last = (record for record, _ in simulation.advance(whole[3].memory))
    assert [hole.tension_before for hole in last.piercings] == [hole.tension_before for hole in whole[4].piercings]


@pytest.mark.parametrize("time", [0.3, 0.1 + 0.2, 0.3 + 1e-10])
def test_a_cut_at_the_time_of_another_change_is_made_once(time: float) -> None:
    """Independent check: at rest a cut and the end of a piercing that differ by round-off are one change."""
    table = {
        "thread": STRING["thread"]
        | {"path": [[0, 0, 0], [0.06, 0, 0]], "length": 0.06, "end": {"kind": "fixed"}, "start": {"kind": "fixed"}},
        "piercing": [{"name": "a", "at": [0.02, 0, 0], "until": 0.3}, {"name": "b", "at": [0.04, 0, 0]}],
        "cut": [{"s": 0.03, "time": time}],
        "solve": {"kind": "static", "load_steps": 1},
    }
    _, last = states(table)
    assert [event.kind for event in last.events if event.kind in ("cut", "ends")] in (["cut"], ["cut", "ends"])


def test_a_piece_that_nothing_holds_back_runs_out_of_its_hole() -> None:
    """Independent check: once the thread is cut at its holder, a dead load of five times the grip draws the piece out
    of its hole. It has left it then, nothing bears the load, and the balance closes."""
    table = {
        "thread": STRING["thread"]
        | {"path": [[0, 0, 0], [0.03, 0, 0]], "control_points": 20, "end": {"kind": "pulled", "force": [0.5, 0, 0]}}
        | {"length": 0.03},
        "piercing": [
            {"name": "hole", "at": [0.02, 0, 0], "friction": {"static": 0.0, "kinetic": 0.0, "grip": GRIP}},
        ],
        "cut": [{"s": 0.01, "time": 0.5}],
        "solve": {"kind": "static", "load_steps": 2},
    }
    _, now, last = states(table)
    assert [(event.kind, event.piercing) for event in now.events if event.kind in ("cut", "leaves")] == [
        ("cut", ""),
        ("leaves", "hole"),
    ]
    assert np.abs(last.state.reaction[1]).max() <= GRIPPED * GRIP
    assert abs(last.energies.balance_error) <= AUDIT * last.energies.at_stake


def test_a_stitch_that_is_cut_at_rest_lets_the_tissue_go_back() -> None:
    """Independent check: two holes that a strand has drawn together are where they were once it is cut, and nothing is
    stored in tissue that had borne it."""
    table = {
        "tissue": {
            "youngs_modulus": 1e5,
            "poisson_ratio": 0.45,
            "density": 1070.0,
            "clamp": ["bottom"],
            "mesh": {"kind": "block", "size": [0.03, 0.02, 0.01], "h": 4e-3, "accuracy": "given"},
        },
        "thread": {
            "suture": "2-0 polypropylene",
            "control_points": 40,
            "path": [[-0.012, 0, 0.003], [-0.006, 0, 0], [0.006, 0, 0], [0.012, 0, 0.003]],
        },
        "piercing": [
            {"name": "left", "at": [-0.006, 0, 0], "kind": "anchored"},
            {"name": "right", "at": [0.006, 0, 0], "kind": "anchored", "draw": [[0.0, 0.0], [0.4, 1e-3]]},
        ],
        "cut": [{"s": 0.0127, "time": 0.9}],
        "solve": {"kind": "static", "load_steps": 2},
    }
    _, before, now = states(table)
    ways = [np.abs([hole.displacement[0] for hole in run.piercings]) for run in (before, now)]
    assert (ways[0] > 2e-4).all() and (ways[1] < BACK * ways[0]).all()
    assert before.piercings[0].tension_after > 0.05
    assert now.energies.elastic_tissue < BACK**2 * before.energies.elastic_tissue


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"thread": {"control_points": 8}, "cut": [{"s": 0.004, "time": 1e-5}]},
            "cut.s.*piece from 0 to 0.004 m is shorter than two spans",
        ),
        ({"solve": {"scheme": "linear"}}, "solve.scheme.*cannot cut the thread during the run"),
        ({"cut": [{"s": 0.01, "time": 1.0}] * 2}, "cut.s.*cut here twice"),
        ({"cut": [{"s": 0.1, "time": 1.0}]}, r"cut.s.*between 0 and the thread's length of [0-9.]{3,8} m"),
        (
            {"cut": [{"s": 1e-6, "time": 1e-5}]},
            "cut.s = 1e-06 is refused: an end or another cut is nearer than 0.1 spans",
        ),
        (
            {"cut": [{"s": s, "time": 1e-5} for s in (0.01, 0.010001)]},
            "cut.s = 0.010001.*an end or another cut is nearer",
        ),
        ({"cut": [{"s": 2e-4, "time": 1e-5}]}, "cut.s.*shorter than two spans"),
        ({"cut": [{"s": 0.01, "time": 0.0}]}, "cut.0.time"),
    ],
)
def test_refusals(change: dict[str, Any], words: str) -> None:
    """Independent check: what cannot be cut is refused by its key before anything is solved."""
    table = deepcopy(STRING)
    for key, value in change.items():
        table[key] = table[key] | value if isinstance(value, dict) else value
    with pytest.raises(ScenarioError, match=words):
        assemble(parse(table))


def test_what_is_cut_already_is_refused() -> None:
    """Independent check: from Python, at the place of a cut and at an end; elsewhere the energies are those before."""
    simulation = prepare(parse(STRING))
    system, state = simulation.assembly.system, simulation.start
    other, new, event = cut_thread(system, state, 0.02)
    assert np.abs(momentum(other, new) - momentum(system, state)).max() == 0.0
    before, after = initial_energies(system, state), initial_energies(other, new)
    assert after.elastic == pytest.approx(before.elastic, rel=IDENTITY)
    for place in (event.s, 0.0, 1e-6, 1.0):
        with pytest.raises(CouplingError, match="cut at"):
            cut_thread(other, new, place)
