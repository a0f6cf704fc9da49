"""Thread drawn by hand through a hole that holds it: what is drawn, what it takes, and where that work is booked."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest

import tissue
from coupling.errors import CouplingError
from coupling.paper.linear_step import linear_step
from coupling.reports.observation import observe
from coupling.rest.laying import start
from coupling.system import Piercing, System
from studies.output.records import StepRecord
from studies.scenario import Scenario, ScenarioError
from studies.simulation import prepare
from studies.simulation.assembly import assemble
from tests.bounds import IDENTITY, ORDER, TWO_SOLVERS
from tests.thread.threads import load_step
from thread.catalogue import suture
from thread.ends import Pulled
from thread.knots import clamped_knots
from thread.quadrature import gauss_rule
from thread.spline import Spline
from thread.thread import MASS_POINTS, Thread

AUDIT = 1e-9  # of the work: what a step's equations may be off by, times its motion
SUTURE = suture("2-0 polypropylene")
APART, DRAWN = 0.01, 2e-4  # of the holes, and by each hand [m]
STRAIGHT: dict[str, Any] = {
    "thread": {
        "suture": "2-0 polypropylene",
        "control_points": 24,
        "path": [[-0.015, 0, 0], [0.015, 0, 0]],
    },
    "piercing": [
        {"name": "left", "at": [-0.005, 0, 0], "kind": "anchored", "draw": [[0, 0], [1, -DRAWN]]},
        {"name": "right", "at": [0.005, 0, 0], "kind": "anchored", "draw": [[0, 0], [1, DRAWN]]},
    ],
    "solve": {"kind": "static", "duration": 1.0, "load_steps": 4},
}
STITCH: dict[str, Any] = {
    "tissue": {
        "youngs_modulus": 2e5,
        "poisson_ratio": 0.45,
        "density": 1070.0,
        "clamp": ["bottom"],
        "mesh": {"kind": "block", "size": [0.02, 0.016, 0.008], "h": 2.5e-3, "accuracy": "given"},
    },
    "thread": {
        "suture": "2-0 polypropylene",
        "control_points": 50,
        "damping": 20.0,
        "path": [[-0.01, 0, 0], [0.01, 0, 0]],
    },
    "piercing": [
        {"name": "left", "at": [-0.004, 0, 0], "kind": "anchored", "draw": [[0, 0], [0.02, -2e-4]]},
        {"name": "right", "at": [0.004, 0, 0], "kind": "anchored", "draw": [[0, 0], [0.02, 2e-4]]},
    ],
    "solve": {"dt": 1e-3, "duration": 0.02},
}  # fmt: skip


def changed(table: dict[str, Any], **solve: Any) -> Scenario:
    """The scenario solved in another way."""
    table = deepcopy(table)
    table["solve"] |= solve
    return Scenario.model_validate(table)


def run(scenario: Scenario) -> list[StepRecord]:
    """Every step."""
    return [record for record, _ in prepare(scenario).advance()]


def test_a_straight_thread_is_stretched_by_what_is_drawn() -> None:
    """Independent check: between two holes fixed in space the rest length falls by what both hands draw, and the
    tension is EA ε λ with λ = L/(L − 2d) and ε = ½(λ² − 1), exactly where knots let it jump at the holes: triple ones
    at the abscissae that the hands draw into the holes. Beyond them there is the pull on the ends."""
    outer, near, pull = 0.015, APART / 2 - DRAWN, 1e-3
    breaks = np.concatenate([np.linspace(0, outer - near, 4), np.linspace(outer - near, outer + near, 5)[1:]])
    breaks = np.concatenate([breaks, np.linspace(outer + near, 2 * outer, 4)[1:]])
    knots = np.sort(np.concatenate([clamped_knots(breaks), np.repeat([outer - near, outer + near], 2)]))
    thread = Thread(Spline(knots), SUTURE, bending=False)
    sites = tissue.fixed_sites([tissue.Site(np.array([x, 0.0, 0.0])) for x in (-APART / 2, APART / 2)])
    ends = tuple(Pulled(np.array([sign * pull, 0.0, 0.0])) for sign in (-1.0, 1.0))
    holes = [Piercing(name, False, False, draw=np.array([[0, 0], [1, d]])) for name, d in (("l", -DRAWN), ("r", DRAWN))]
    system = System(thread, ends, sites, tuple(holes))
    path = (gauss_rule(thread.spline, MASS_POINTS).s - outer)[..., None] * [1.0, 0.0, 0.0]
    first = start(system, outer + np.array([-0.5, 0.5]) * APART, path, 1.0)
    (step,) = load_step(system, first, 1.0, 1.0)
    left, right = observe(system, first, step.new)
    stretch = APART / (APART - 2.0 * DRAWN)
    tension = SUTURE.EA * 0.5 * (stretch**2 - 1.0) * stretch
    assert left.tension_after == pytest.approx(tension, rel=TWO_SOLVERS)
    assert right.tension_before == pytest.approx(tension, rel=TWO_SOLVERS)
    assert left.tension_before == pytest.approx(pull, rel=1e-6) and right.tension_after == pytest.approx(pull, rel=1e-6)
    assert right.slip == pytest.approx(DRAWN, rel=IDENTITY) and left.slip == pytest.approx(-DRAWN, rel=IDENTITY)
    assert left.state == "anchored"


def test_inside_a_span_the_tension_is_right_to_first_order() -> None:
    """Independent check: a C² spline cannot jump in strain at a hole, and is too stiff by a part of the spans there."""
    stretch = APART / (APART - 2.0 * DRAWN)
    tension, errors = SUTURE.EA * 0.5 * (stretch**2 - 1.0) * stretch, []
    for points in (51, 195):
        table = deepcopy(STRAIGHT)
        ends = {"start": {"kind": "pulled", "force": [-1e-3, 0, 0]}, "end": {"kind": "pulled", "force": [1e-3, 0, 0]}}
        table["thread"] |= {"control_points": points, "bending": False} | ends
        errors.append(run(Scenario.model_validate(table))[-1].piercings[0].tension_after / tension - 1.0)
    assert 0.0 < errors[1] < 0.01 and np.log2(errors[0] / errors[1]) / 2 == pytest.approx(1.0, abs=ORDER)


def test_the_hands_work_is_what_the_thread_stores() -> None:
    """Independent check: external work tends to the elastic energy with the second power of the load step (works are
    by the trapezoidal rule), on knots that stay as they are, and nothing is called friction."""
    errors, table = [], deepcopy(STRAIGHT)
    table["thread"]["knots"] = "fixed"
    for steps in (5, 10, 20):
        energy = run(changed(table, load_steps=steps))[-1].energy
        assert abs(energy.balance_error) <= AUDIT * energy.external_work and energy.friction_dissipation == 0.0
        errors.append(energy.external_work / energy.elastic_thread - 1.0)
    assert 0.0 < errors[0] < 2e-3 and np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=ORDER)


@pytest.mark.parametrize("solve", [{}, {"integrator": "bdf2"}, {"friction": "two-pass"}, {"epsilon": 1e-4}])
def test_a_stitch_is_tightened(solve: dict[str, Any]) -> None:
    """Independent check: drawn at both its ends a stitch comes under tension and draws its holes together, by every
    way to step; the balance of energy closes, and the hands do the work."""
    records = run(changed(STITCH, **solve))
    last = records[-1]
    left, right = last.piercings
    assert right.slip == pytest.approx(2e-4, rel=IDENTITY) and left.slip == pytest.approx(-2e-4, rel=IDENTITY)
    assert left.displacement[0] > 1e-4 and right.displacement[0] < -1e-4
    assert left.tension_after > 0.05 and right.tension_before == pytest.approx(left.tension_after, rel=TWO_SOLVERS)
    energy = last.energy
    stored = energy.elastic_thread + energy.elastic_tissue - records[0].energy.elastic_thread
    assert energy.external_work > stored > 0.0 and energy.friction_dissipation == 0.0
    assert abs(energy.balance_error) <= AUDIT * energy.external_work


def test_a_hole_that_begins_counts_from_there() -> None:
    """Independent check: what a schedule has drawn before the piercing began is no thread of this hole."""
    table = deepcopy(STITCH)
    for hole in table["piercing"]:
        hole["from"] = 0.01
    sliding = [{"name": f"{hole['name']} before", "at": hole["at"], "until": 0.01} for hole in table["piercing"]]
    table["piercing"] = [hole for pair in zip(sliding, table["piercing"], strict=True) for hole in pair]
    last = run(Scenario.model_validate(table))[-1]
    assert last.piercings[3].slip == pytest.approx(1e-4, rel=IDENTITY)


@pytest.mark.parametrize(
    ("hole", "change", "words"),
    [
        (1, {"kind": "sliding", "draw": [[0, 0.0]]}, "set kind = \"anchored\""),
        (1, {"draw": [[1, 0.0], [0.5, 1e-3]]}, "must be later than 1.0 s"),
        (1, {"draw": [[0, 0.0], [1, 0.0101]]}, "no thread remains between"),
        (1, {"draw": [[0, 0.0], [1, -0.0101]]}, "the thread leaves its hole"),
    ],
)  # fmt: skip
def test_refusals(hole: int, change: dict[str, Any], words: str) -> None:
    """Independent check: a schedule that cannot be kept is refused by its key before anything is solved."""
    table = deepcopy(STRAIGHT)
    table["piercing"][0].pop("draw")
    table["piercing"][hole] |= change
    with pytest.raises(ValueError, match=words) as caught:
        assemble(Scenario.model_validate(table))
    assert "piercing" in str(caught.value) or isinstance(caught.value, ScenarioError)


def test_what_is_drawn_through_a_hole_that_ended_is_no_longer_counted() -> None:
    """Independent check: once the thread is let go of, the hand's schedule moves it no further in the table."""
    table = deepcopy(STITCH)
    for hole in table["piercing"]:
        hole["until"] = 0.01
    last = run(Scenario.model_validate(table))[-1]
    assert last.piercings[1].s == pytest.approx(0.014 - 1e-4, rel=IDENTITY)


def drawn_late(length: float, **thread: Any) -> Scenario:
    """A stitch whose right hole begins at 4 ms, 6 mm before the end of the thread, and draws from then on."""
    table = deepcopy(STITCH)
    table["thread"] |= thread
    table["piercing"][0].pop("draw")
    table["piercing"][1] |= {"from": 0.004, "draw": [[0.004, 0.0], [0.014, length]]}
    return Scenario.model_validate(table)


@pytest.mark.parametrize(
    ("length", "thread"), [(-0.0065, {}), (0.003, {"cuts": [0.012]}), (-0.0025, {"cuts": [0.016]})]
)
def test_a_thread_that_a_late_hole_draws_out_ends_the_run(length: float, thread: dict[str, Any]) -> None:
    """Independent check: where a hole begins is not known beforehand, so that a hand may come to the end of the thread
    or of its piece. Beyond it there is nothing to draw; up to there the run goes on."""
    times = []
    with pytest.raises(CouplingError, match="drawn out of piercing 'right'"):
        times.extend(record.time for record, _ in prepare(drawn_late(length, **thread)).advance())
    out = abs(length) - 5e-4  # of the thread between hole and end
    assert times == [] or times[-1] <= 0.004 + 0.01 * out / abs(length) + 1e-3


def test_other_ways_refuse_what_is_drawn() -> None:
    """Independent check: the linear step draws no thread, nor does a hand without a time to do it."""
    simulation = prepare(Scenario.model_validate(STITCH))
    with pytest.raises(CouplingError, match="draws no thread by hand"):
        linear_step(simulation.assembly.system, simulation.start, 1e-3)
    with pytest.raises(ValueError, match=r"cannot use piercing\.left\.draw"):
        changed(STITCH, scheme="linear", friction="two-pass")
    with pytest.raises(CouplingError, match="give two rows"):
        Piercing("hole", draw=np.array([[0.0, 0.0]]))


@pytest.mark.parametrize("knots", ["travelling", "fixed"])
def test_load_steps_do_the_work_that_a_laid_thread_stores(knots: str) -> None:
    """Independent check: a thread that is laid 1 % too short pulls on its ends before they are drawn. The trapezoidal
    rule does the work of the mean force, whose error falls with the square of the load step."""
    errors = []
    for steps in (1, 2, 4):
        thread = {
            "suture": "4-0 nylon",
            "knots": knots,
            "length": 0.0594,
            "path": [[0, 0, 0], [0, 0, 0.06]],
            "start": {"kind": "fixed"},
            "end": {"kind": "driven", "waypoints": [[0, 0, 0, 0.06], [1, 0, 0, 0.0603]]},
        }
        table = {"thread": thread, "solve": {"kind": "static", "duration": 1.0, "load_steps": steps}}
        first, *_, last = run(Scenario.model_validate(table))
        gained = last.energy.elastic_thread - first.energy.elastic_thread
        errors.append(last.energy.external_work / gained - 1.0)
    assert 0.0 < errors[0] < 1e-3
    assert np.log2(errors[:-1] / np.array(errors[1:])) == pytest.approx(2.0, abs=ORDER)
