"""Thread drawn by hand with a given force: the same state as by the length that it takes, its work, and refusals."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from coupling.equilibrium import load_step
from coupling.errors import CouplingError
from coupling.sliding import force_along_thread, law_of
from coupling.system import Friction, Piercing, State
from studies.output.records import StepRecord
from studies.scenario import Scenario, parse
from studies.simulation import Simulation, prepare
from tests.bounds import IDENTITY, TWO_SOLVERS
from tests.coupling.test_drawn import AUDIT, STITCH, STRAIGHT
from thread.catalogue import suture

FORCE = 0.05  # N


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
    system = simulation.assembly.system
    law = law_of(system, state.s, state.present, 0.0, state.s)
    return force_along_thread(law, system.passage_of(state), state.s, state.lam, state.y)


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
        ({"kind": "sliding"}, r'right\.pull is refused.*set kind = "anchored"'),
        ({"draw": [[0, 0.0]]}, r"right\.pull is refused.*leave out draw or pull"),
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
    """Independent check: neither the linear step nor a hole in which the thread slides has a hand that pulls."""
    table = pulled(STITCH, [[0.0, 0.0], [1.0, 0.1]])
    table["solve"] |= {"scheme": "linear", "friction": "two-pass"}
    with pytest.raises(ValueError, match=r"knows no piercing\.right\.pull"):
        Scenario.model_validate(table)
    rows = np.array([[0.0, 0.0]])
    for given in ({"friction": Friction(0.1, 0.1), "slides": False}, {}):
        with pytest.raises(CouplingError, match="does not slide"):
            Piercing("hole", pull=rows, **given)
    with pytest.raises(CouplingError, match="leave one out"):
        Piercing("hole", slides=False, pull=rows, draw=rows)
