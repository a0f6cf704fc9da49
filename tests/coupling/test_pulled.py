"""Thread drawn by hand with a given force: the same state as by the length that it takes, its work, and refusals."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from coupling.errors import CouplingError
from coupling.rest.equilibrium import pair_lips
from coupling.step.sliding import law_of, ruled
from coupling.step.tension import stretches_at
from coupling.system import Friction, Piercing, State
from studies.output.records import StepRecord
from studies.scenario import Scenario, parse
from studies.simulation import Simulation, prepare
from tests.bounds import IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.coupling.test_drawn import AUDIT, STITCH, STRAIGHT
from tests.thread.threads import load_step
from thread.catalogue import suture

FORCE = 0.05  # N
ARM = 0.02  # m
LEFT_OPEN = 1e-9  # [N], 1e-10 of the largest elastic force on a control point, some newtons on spans of 0.1 mm
STRAIN = 6 * FORCE / suture("2-0 polypropylene").EA  # that of the hand's largest force, to which a force along is known


def pulled(table: dict[str, Any], rows: list[list[float]], **changes: Any) -> dict[str, Any]:
    """The scene with its left hole anchored and its right one pulled instead of drawn."""
    table = deepcopy(table)
    table["piercing"][0].pop("draw")
    table["piercing"][1].pop("draw")
    table["piercing"][1]["pull"] = rows
    for hole in table["piercing"]:
        hole.update(changes)
    return table


def run(table: dict[str, Any]) -> tuple[Simulation, list[StepRecord]]:
    """Every step."""
    simulation = prepare(parse(table))
    return simulation, [record for record, _ in simulation.advance()]


def along(simulation: Simulation, state: State) -> np.ndarray:
    """The force along the unit tangent in each hole [N]."""
    system = simulation.assembly.system.at(state)
    stretch = stretches_at(system, state.s, state.N, state.present)
    law = law_of(system, state.s, state.present, 0.0, state.s, stretch=stretch)
    return ruled(law, state.sigma, system.passage_of(state), state.s, state.lam, state.y).f


@pytest.mark.parametrize("direction", ["free", [1.0, 0.0, 0.0]])
def test_a_pull_is_the_draw_that_takes_the_same_force(direction: Any) -> None:
    """Consistency check: in statics a stitch drawn by the length that a force of 50 mN draws has all forces and places
    of the one that is pulled, with and without an imposed direction; independent check: the force is the one given."""
    rows = [[0.0, 0.0], [1.0, FORCE]]
    table = pulled(STITCH, rows, direction=direction)
    table["solve"] = {"kind": "static", "duration": 1.0, "load_steps": 2}
    simulation = prepare(parse(table))
    state = simulation.start
    for share in (0.5, 1.0):
        state = load_step(simulation.assembly.system, state, share, 1.0)[-1].new
        assert along(simulation, state)[1] == pytest.approx(share * FORCE, rel=TWO_SOLVERS)
    length = float(simulation.start.s[1] - state.s[1])
    assert length > 1e-5 and state.s[0] == simulation.start.s[0]
    table["piercing"][1].pop("pull")
    table["piercing"][1]["draw"] = [[0.0, 0.0], [1.0, length]]
    other = prepare(parse(table))
    drawn = load_step(other.assembly.system, load_step(other.assembly.system, other.start, 0.5, 1.0)[-1].new, 1.0, 1.0)
    new = drawn[-1].new
    assert along(other, new)[1] == pytest.approx(FORCE, rel=TWO_SOLVERS)
    assert np.abs(new.lam - state.lam)[:, :3].max() <= TWO_SOLVERS * np.abs(state.lam[:, :3]).max()
    assert np.abs(new.y - state.y)[:, :3].max() <= TWO_SOLVERS * np.abs(state.y[:, :3]).max()


def test_a_straight_thread_takes_up_what_its_force_needs() -> None:
    """Independent check: between two holes fixed in space the strand that bears F has the stretch λ of
    F = EA ½(λ² − 1) λ, and the hand has drawn L − L/λ through, to the part of a span that a C² spline is too stiff
    by."""
    force, apart = 2.0, 0.01
    EA = suture("2-0 polypropylene").EA
    stretch = float(max(np.roots([0.5, 0.0, -0.5, -force / EA]).real))
    table = pulled(STRAIGHT, [[0.0, 0.0], [1.0, force]])
    table["thread"] |= {"control_points": 195, "bending": False, "start": {"kind": "pulled", "force": [-1e-3, 0, 0]},
                        "end": {"kind": "pulled", "force": [1e-3, 0, 0]}}  # fmt: skip
    _, records = run(table)
    assert records[-1].piercings[1].slip == pytest.approx(apart - apart / stretch, rel=0.02)
    assert records[-1].piercings[0].tension_after == pytest.approx(force, rel=0.01)


@pytest.mark.parametrize("solve", [{}, {"integrator": "euler", "epsilon": 1e-4}, {"friction": "two-pass"}])
def test_a_stitch_is_tightened_to_a_force(solve: dict[str, Any]) -> None:
    """Independent check: by every way to step the strand between the holes comes to bear the force of the hand and what
    hangs behind it, which is next to nothing; the balance closes, and the hand does the work."""
    table = pulled(STITCH, [[0.0, 0.0], [0.008, FORCE], [0.012, FORCE]])
    table["solve"] |= {"duration": 0.012} | solve
    _, records = run(table)
    left, right = records[-1].piercings
    assert right.slip > 1e-5 and left.slip == 0.0 and right.state == "anchored"
    slack = 0.0 if "epsilon" not in solve else 1e-4 * 100.0
    assert right.tension_before == pytest.approx(FORCE, abs=0.02 * FORCE + slack)
    energy = records[-1].energy
    stored = energy.elastic_thread + energy.elastic_tissue - records[0].energy.elastic_thread
    assert energy.external_work > stored > 0.0 and energy.friction_dissipation == 0.0
    assert abs(energy.balance_error) <= AUDIT * energy.external_work


def test_a_hole_that_ends_lets_go() -> None:
    """Independent check: the force is gone with the hand, whatever its schedule says."""
    table = pulled(STITCH, [[0.0, 0.0], [0.004, FORCE]], until=0.008)
    table["solve"]["duration"] = 0.01
    _, records = run(table)
    assert np.abs(records[-1].piercings[1].force).max() == 0.0
    assert records[-1].piercings[1].s == pytest.approx(records[8].piercings[1].s, rel=IDENTITY)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"kind": "sliding", "pull": [[0, 0.1]]},
            r'right\.pull\.0 = \[0.0, 0.1\] is.*give two rows, or set kind = "anchored"',
        ),
        (
            {"kind": "sliding", "draw": [[0.5, 0], [2, 1e-3]]},
            r"right\.pull = .*draw holds the thread from 0\.5 to 2\.0 s",
        ),
        ({"draw": [[0, 0.0]]}, r"right\.pull is refused.*leave out draw or pull"),
        ({"pull": [[0, 0.1], [0.5], [1, 0.1]]}, r"right\.pull\.1 = \[0\.5\].*a hand always holds an anchored thread"),
        ({"kind": "sliding", "pull": [[0.5], [1, 0.1]]}, r"right\.pull\.0 = \[0\.5\].*no hand holds the thread"),
        ({"kind": "sliding", "pull": [[0, 1.0], [0.5], [0.6], [1, 0.1]]}, r"right\.pull\.2.*no hand holds the thread"),
        (
            {"kind": "sliding", "pull": [[0, 1.0], [0.5], [1, 0.1]]},
            r"right\.pull\.2 = \[1.0, 0.1\] is refused.*two rows",
        ),
        (
            {"kind": "sliding", "pull": [[0, 1.0], [0.5], [1, 0], [2, 1]], "draw": [[0.5, 0], [1.5, 1e-3]]},
            r"right\.pull = .*draw holds the thread from 0\.5 to 1\.5 s",
        ),
        ({"pull": [[0, 0.1, 3]]}, r"right\.pull\.0 = \[0, 0\.1, 3\].*\[t\] alone to let go"),
        ({"pull": [[1, 0.0], [0.5, 1e-3]]}, r"right\.pull\.1.*must be later than 1\.0 s"),
        ({"friction": {"static": 0.1, "kinetic": 0.1}}, r"right\.friction is refused"),
    ],
)
def test_refusals(change: dict[str, Any], words: str) -> None:
    """Independent check: what a hand cannot do is refused by its key."""
    table = pulled(STRAIGHT, [[0.0, 0.0], [1.0, 0.1]])
    table["piercing"][1] |= change
    with pytest.raises(ValueError, match=words):
        parse(table)


def test_other_ways_refuse_a_pull() -> None:
    """Independent check: the linear step has no hand that pulls; where the thread slides, it pulls for a time, and does
    not draw meanwhile."""
    table = pulled(STITCH, [[0.0, 0.0], [1.0, 0.1]])
    table["solve"] |= {"scheme": "linear", "friction": "two-pass"}
    with pytest.raises(ValueError, match=r"cannot use piercing\.right\.pull"):
        Scenario.model_validate(table)
    rows = np.array([[0.0, 0.0]])
    with pytest.raises(CouplingError, match="leave out friction"):
        Piercing("hole", pull=rows, friction=Friction(0.1, 0.1), slides=False)
    with pytest.raises(CouplingError, match="give two rows"):
        Piercing("hole", pull=rows)
    late = np.array([[0.5, 0.0], [1.5, 1e-3]])
    for slides, pull in ((False, rows), (True, late - [0.5, 0.0])):
        with pytest.raises(CouplingError, match="leave one out"):
            Piercing("hole", slides=slides, pull=pull, draw=late)


NOTHING = np.zeros(0)
MU, TAIL = 0.2, 0.05  # -, N: beyond the ring the thread is pulled by that
AGAIN = 1e-3  # of the way that the thread ran back between: in time its force takes a while to swing in
BENT = 0.03  # of the ratio of the tensions: what the elastica takes that turns in the ring, of no radius


def scheduled(**solve: Any) -> dict[str, Any]:
    """A thread from an anchor to a rough ring, where it turns by 90°. A hand there draws it with FORCE, holds it, and
    lets it go, over 0.4, 0.3 and 0.3 of the run."""
    end = solve["duration"]
    pull, hold = [[0.0, 0.0], [0.4 * end, 6 * FORCE]], [[0.4 * end, 0.0], [0.7 * end, 0.0]]
    return {
        "thread": {"suture": "2-0 polypropylene", "control_points": 60, "damping": 20.0,
                   "path": [[0, 0, 0], [ARM, 0, 0], [ARM, 0, ARM]],
                   "end": {"kind": "pulled", "force": [0, 0, TAIL]}},
        "piercing": [
            {"name": "anchor", "at": [0.002, 0, 0], "kind": "anchored"},
            {"name": "ring", "at": [ARM, 0, 0], "pull": pull, "draw": hold, "friction": {"static": MU, "kinetic": MU}},
        ],
        "solve": solve,
    }  # fmt: skip


@pytest.mark.parametrize(
    "solve", [{"kind": "static", "load_steps": 10, "duration": 1.0}, {"dt": 2e-3, "duration": 0.2}]
)
def test_a_hand_tightens_holds_and_lets_go(solve: dict[str, Any]) -> None:
    """Independent check: while the hand draws the ring bears its force along the thread, while it holds nothing runs
    through, and then the thread runs back until friction holds it, with the ratio of tensions of a capstan; the hand's
    friction and the ring's do not add up, Coulomb's law holds from there on, and the balance of energy closes."""
    simulation, records = run(scheduled(**solve))
    part = simulation.steps // 10
    ring = [record.piercings[1] for record in records]
    for k in range(part, 4 * part + 1, part):
        assert ring[k].tangential_force == pytest.approx(6 * FORCE * k / (4 * part), rel=STRAIN)
        assert records[k].energy.friction_dissipation == 0.0
    held = [hole.s for hole in ring[4 * part : 7 * part + 1]]
    assert np.ptp(held) <= IDENTITY * held[0] and ring[7 * part].tension_before > 5 * FORCE
    gone = ring[7 * part + 1 :]
    assert gone[0].s > held[0] and max(hole.tension_before for hole in gone) < 0.1
    assert max(hole.cone_residual for hole in ring) <= LEFT_OPEN
    first = next(hole for hole in gone if hole.state == "slip") if solve.get("kind") else gone[-1]
    limit = np.exp(0.5 * np.pi * MU)
    assert first.tension_before / first.tension_after <= limit * (1 + BENT)
    if solve.get("kind"):
        assert first.tension_before / first.tension_after >= limit * (1 - BENT)
    energy = records[-1].energy
    assert energy.friction_dissipation > 0.0 and abs(energy.balance_error) <= LEFT_OPEN * ARM


@pytest.mark.parametrize(
    "solve", [{"kind": "static", "load_steps": 10, "duration": 1.0}, {"dt": 2e-3, "duration": 0.4}]
)
def test_a_hand_takes_the_same_thread_again(solve: dict[str, Any]) -> None:
    """Independent check: a hand that draws with a force, lets go and draws with it again has the thread where one has
    it that never let go; between them friction alone holds it, by no more than the balance at one hole allows: at rest
    as it ran back, in time as it swung past that, as it does in steps an eighth as long too. One
    that draws a length, lets go and draws another draws each from where it takes the thread."""
    end = solve["duration"]
    table = scheduled(**solve)
    ring = table["piercing"][1]
    del ring["draw"]
    force = 6 * FORCE
    ring["pull"] = [[0.0, 0.0], [0.2 * end, force], [0.3 * end], [0.5 * end, 0.5 * force], [0.7 * end, force]]
    ring["pull"] += [[0.8 * end, force]]
    simulation, records = run(table)
    part = simulation.steps // 10
    at = [records[k * part].piercings[1] for k in range(11)]
    ring["pull"] = [[0.0, 0.0], [0.2 * end, force], [0.8 * end, force]]
    held = run(table)[1][8 * part].piercings[1]
    ran_back = at[5].s - at[3].s
    assert ran_back > 1e-4 and abs(at[8].s - held.s) < AGAIN * ran_back
    assert [at[k].tangential_force for k in (3, 8)] == pytest.approx([force] * 2, rel=STRAIN)
    assert at[5].cone_residual <= RESIDUAL * force
    most = (1.0 + MU) / (1.0 - MU)
    assert (1.0 if "kind" in solve else 1.0 / most) < at[5].tension_before / at[5].tension_after < most
    assert abs(records[-1].energy.balance_error) <= LEFT_OPEN * ARM
    del ring["pull"]
    ring["draw"] = [[0.0, 0.0], [0.2 * end, 1e-4], [0.3 * end], [0.5 * end, 3e-4], [0.7 * end, 4.5e-4]]
    _, records = run(table)
    s = [records[k * part].piercings[1].s for k in range(11)]
    assert [s[0] - s[2], s[2] - s[3], s[5] - s[7]] == pytest.approx([1e-4, 0.0, 1.5e-4], abs=IDENTITY)


def test_a_hand_has_the_thread_to_the_end_of_its_load_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: lips that slide are paired anew at the end of a load step, where the hand still holds what it
    lets go in the next one: the same equilibrium, with the thread where it held it."""
    simulation = prepare(parse(scheduled(kind="static", load_steps=10, duration=1.0)))
    system, state = simulation.assembly.system, simulation.start
    for share in (0.2, 0.4, 0.6):
        state = load_step(system, state, share, 1.0)[-1].new
    held = load_step(system, state, 0.7, 1.0)[-1]
    slid = iter([0.0, 1.0, 1.0, 1.0])
    monkeypatch.setattr(type(system.organ), "lips", lambda *_: (NOTHING, np.ones(1), np.array([next(slid)])))
    again = pair_lips(system, held, 0.7, 1.0)
    assert abs(again.new.s[1] - held.new.s[1]) <= IDENTITY * held.new.s[1]
    assert again.new.lam[1, :3] == pytest.approx(held.new.lam[1, :3], rel=RESIDUAL, abs=RESIDUAL)


def test_a_hand_has_the_thread_to_the_end_of_the_step_in_which_it_lets_go() -> None:
    """Independent check: in time the hand lets go within a step. It had the thread to the end of that step, so that its
    force does not count against the law of friction."""
    table = scheduled(dt=6e-3, duration=0.2)
    ring = table["piercing"][1]
    del ring["draw"]
    records = run(table)[1]
    end = ring["pull"][-1][0]
    let_go = next(record for record in records if record.time > end)
    assert let_go.time - records[let_go.step - 1].time > let_go.time - end > 0.0
    assert let_go.piercings[1].tangential_force == pytest.approx(6 * FORCE, rel=STRAIN)
    assert max(record.piercings[1].cone_residual for record in records) <= LEFT_OPEN


def test_no_thread_is_drawn_by_a_hand_that_does_not_have_it_yet() -> None:
    """Independent check: a hand that takes the thread within a load step has it from the next one on; until then it
    stays where it sticks by friction."""
    table = scheduled(kind="static", load_steps=2, duration=1.0)
    ring = table["piercing"][1]
    del ring["pull"]
    ring |= {"friction": {"static": 0.1, "kinetic": 0.1, "grip": 5.0}, "draw": [[0.5, 0.0], [1.0, 1e-4]]}
    simulation = prepare(parse(table))
    stuck = load_step(simulation.assembly.system, simulation.start, 0.75, 1.0)[-1].new
    assert stuck.sigma[1] == 0.0 and abs(stuck.s[1] - simulation.start.s[1]) <= IDENTITY * 1e-4


@pytest.mark.parametrize("load_steps", [1, 2, 20])
def test_what_is_planned_within_a_load_step_takes_place_at_its_time(load_steps: int) -> None:
    """Independent check: a hand takes the thread, lets it go and takes it again at its own times. It draws the sum of
    both lengths through a hole that keeps what it grips, in any number of load steps."""
    table = scheduled(kind="static", load_steps=load_steps, duration=1.0)
    ring = table["piercing"][1]
    del ring["pull"]
    ring |= {"friction": {"static": 0.1, "kinetic": 0.1, "grip": 5.0}}
    ring |= {"draw": [[0.25, 0.0], [0.45, 2e-4], [0.5], [0.65, 0.0], [0.85, 1e-4]]}
    last = run(table)[1][-1]
    assert last.piercings[1].slip == pytest.approx(3e-4, rel=RESIDUAL)


def test_a_hand_turns_within_a_load_step() -> None:
    """Independent check: a hand draws at a hole that keeps what it grips, and lets out again. In one load step and in
    ten the strand has been stretched, and then relaxed by the length that was let out."""
    found = []
    for load_steps in (1, 10):
        table = scheduled(kind="static", load_steps=load_steps, duration=1.0)
        ring = table["piercing"][1]
        del ring["pull"]
        ring["draw"] = [[0.0, 0.0], [0.3, 2e-4], [0.6, 1e-4], [1.0, 1e-4]]
        found.append(run(table)[1][-1].piercings[1])
    assert found[0].slip == pytest.approx(1e-4, rel=RESIDUAL)
    assert found[0].tension_before == pytest.approx(found[1].tension_before, rel=1e-3)
