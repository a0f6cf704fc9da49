"""A run that starts at rest: it stays there, what comes later acts on it alone, and what has no rest is refused."""

import json
from copy import deepcopy
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coupling.errors import RestError
from studies.command.summary import print_summary
from studies.output.folder import Recorder
from studies.output.records import StepRecord
from studies.scenario import Scenario, ScenarioError, parse
from studies.scenario.scenario import RAMP
from studies.simulation import prepare
from studies.simulation.remedies import try_remedies
from tests.bounds import MOVED, RESIDUAL, SWING, TWO_SOLVERS

PULL, G = 0.1, 9.81
TISSUE: dict[str, Any] = {
    "youngs_modulus": 6e5,
    "poisson_ratio": 0.45,
    "density": 1070.0,
    "clamp": ["bottom"],
    "mesh": {"kind": "block", "generator": "structured", "size": [0.03, 0.02, 0.01], "h": 4e-3, "accuracy": "given"},
}
ORGANS: dict[str, dict[str, Any]] = {
    "none": {},
    "with inertia": {"rayleigh": [5.7, 5.8e-4]},
    "without inertia": {"inertia": False},
    "in its Krylov space": {},
    "at finite strain": {"material": "neo-hookean", "mesh": {**TISSUE["mesh"], "h": 5e-3}},
}


def stitched(organ: str = "none", **solve: Any) -> dict[str, Any]:
    """A thread laid slack through two rough holes, pulled at its start and held at its end."""
    hole = {"friction": {"static": 0.1, "kinetic": 0.08}}
    placed = {"direction": "normal", "footprint": 2e-3} if organ != "none" else {"direction": [0, 0, 1]}
    scene: dict[str, Any] = {
        "thread": {
            "suture": "2-0 polypropylene",
            "control_points": 60,
            "path": [[-0.005, 0, 0.02], [-0.005, 0, -0.0055], [0.005, 0, -0.0055], [0.005, 0, 0.02]],
            "damping": 20.0,
            "start": {"kind": "pulled", "force": [0, 0, PULL]},
            "end": {"kind": "driven", "waypoints": [[0, 0.005, 0, 0.02]]},
        },
        "piercing": [
            {"name": "entry", "at": [-0.005, 0, 0], **placed, **hole},
            {"name": "exit", "at": [0.005, 0, 0], **placed, **hole},
        ],
        "solve": {"start": "rest", "duration": 0.02, **solve},
    }
    if organ == "in its Krylov space":
        scene["solve"]["organ"] = "krylov"
    if organ == "none":
        scene["piercing"][0]["direction"] = [0, 0, -1]
        return scene
    return scene | {"tissue": TISSUE | ORGANS[organ]}


def records_of(scene: dict[str, Any]) -> list[StepRecord]:
    """All steps, the start first."""
    return [record for record, _ in prepare(parse(scene)).advance()]


def forces_of(record: StepRecord) -> np.ndarray:
    """All forces on the thread, `(p + 2, 3)` [N]."""
    return np.array([record.start_reaction, record.end_reaction, *(hole.force for hole in record.piercings)])


@pytest.mark.parametrize("organ", ORGANS)
def test_what_starts_at_rest_stays_there(organ: str) -> None:
    """Independent check: nothing moves or is dissipated in twenty steps, whatever the organ; the thread is taut from
    the first, and sticks in its holes as it was found."""
    start, *later = records_of(stitched(organ))
    stored = start.energy.of_deformation
    assert len(later) == 20 and start.time == 0.0 and start.energy.kinetic == 0.0
    assert abs(start.piercings[0].tension_before - PULL) < MOVED * PULL
    for record in later:
        assert np.abs(forces_of(record) - forces_of(start)).max() < TWO_SOLVERS * PULL
        assert record.energy.kinetic < TWO_SOLVERS**2 * stored
        assert all(abs(work) < TWO_SOLVERS * stored for work in dissipated(record))
        assert all(hole.state == "stick" for hole in record.piercings) and not record.events


def dissipated(record: StepRecord) -> tuple[float, ...]:
    """What a run has dissipated, and what was done from outside [J]."""
    energy = record.energy
    losses = energy.friction_dissipation, energy.viscous_dissipation, energy.numerical_dissipation
    return (*losses, energy.external_work)


def test_the_rest_is_that_of_statics() -> None:
    """Consistency check: forces, places and energies are those of a static run with one load step; slip counts from the
    rest."""
    (start, *_), static = records_of(stitched("without inertia")), stitched("without inertia", kind="static")
    static["solve"] = {"kind": "static", "load_steps": 1}
    found = records_of(static)[-1]
    assert np.abs(forces_of(start) - forces_of(found)).max() < TWO_SOLVERS * PULL
    assert abs(start.energy.of_deformation - found.energy.of_deformation) < TWO_SOLVERS * found.energy.of_deformation
    assert max(abs(hole.slip) for hole in found.piercings) > 1e-4
    for here, there in zip(start.piercings, found.piercings, strict=True):
        assert here.slip == 0.0 and abs(here.s - there.s) < TWO_SOLVERS * here.s


def test_only_what_comes_later_is_dissipated() -> None:
    """Consistency check: a hand that draws on the thread from the start on finds it taut, and the integrator takes less
    than a tenth of what it takes where slack is let go: what is left, the hand's own jump."""
    taken = {}
    for start in ("path", "rest"):
        scene = stitched("with inertia", start=start)
        scene["thread"]["end"]["waypoints"] = [[0, 0.005, 0, 0.02], [0.02, 0.005, 0, 0.0204]]
        taken[start] = records_of(scene)[-1].energy.numerical_dissipation
    assert abs(taken["rest"]) < 0.1 * taken["path"]


def hanging(ramp: float, **solve: Any) -> dict[str, Any]:
    """A mass on a thread that hangs, on whose other end a force of half its weight more pulls down."""
    return {
        "thread": {
            "suture": "2-0 polypropylene",
            "control_points": 20,
            "path": [[0, 0, 0], [0, 0, -0.1]],
            "start": {"kind": "fixed"},
            "end": {"kind": "pulled", "force": [0, 0, -0.5 * MASS * G], "ramp": ramp, "mass": MASS},
        },
        "piercing": [],
        "solve": {"start": "rest", "gravity": [0, 0, -G], **solve},
    }


MASS = 0.05


def test_a_sudden_load_draws_twice_as_far_as_at_rest() -> None:
    """Independent check: what hangs at rest under its weight and is then pulled at once by F swings by F/k about F/k
    further down, with a period of 2π √(m/k): the force of the thread peaks at mg + 2F."""
    section = prepare(parse(hanging(0.0, duration=1e-3))).assembly.system.thread
    period = 2.0 * np.pi * np.sqrt(MASS * 0.1 / section.EA)
    records = records_of(hanging(1e-9, dt=period / 400, duration=1.1 * period))
    weight, force = MASS * G, 0.5 * MASS * G
    held = np.array([record.start_reaction[2] for record in records])
    times = np.array([record.time for record in records])
    assert abs(held[0] - weight) < 1e-2 * weight  # the thread's own weight is 0.1 % of it
    assert abs(held.max() - (held[0] + 2.0 * force)) < SWING * force
    assert abs(times[held.argmax()] - 0.5 * period) < 2.0 * period / 400
    assert abs(held[times > 0.9 * period].min() - held[0]) < SWING * force


def test_a_dead_load_without_a_ramp_acts_in_full() -> None:
    """Independent check: a load that names no ramp is there from the start, as its scenario says it then; one with a
    ramp is not."""
    scenario = prepare(parse(stitched())).scenario
    end: Any = scenario.thread.start
    assert end.ramp == 0.0
    weight = MASS * G
    for ramp, load in ((0.0, 1.5 * weight), (0.05, weight)):
        (start,) = [record for record in records_of(hanging(ramp, duration=1e-3)) if record.time == 0.0]
        assert abs(start.start_reaction[2] - load) < 1e-2 * weight


@pytest.mark.parametrize(
    ("start", "ramp", "remarks", "grows"),
    [("rest", None, [], 0.0), ("rest", 0.0, [], 0.0), ("rest", 0.1, ["rest-unloaded"], 0.1), ("path", None, [], RAMP)],
)
def test_a_run_says_how_its_dead_load_grows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], start: str, ramp: float | None, remarks: list[str], grows: float
) -> None:
    """Independent check: none of a load that grows is there at a rest, and that is remarked; a time that the scenario
    leaves out stands in the summary, on the console and in the file, like one that it gives."""
    scene = stitched(start=start, duration=1.0)
    scene["thread"]["start"] |= {} if ramp is None else {"ramp": ramp}
    scene["solve"]["dt"] = 0.5
    simulation = prepare(parse(scene))
    record, frame = next(simulation.advance())
    pull = np.linalg.norm(record.start_reaction)
    assert abs(pull - (PULL if grows == 0.0 else 0.0)) < TWO_SOLVERS * PULL
    assert [said.code for said in simulation.foreseen if said.where == "thread.start"] == remarks
    with Recorder(tmp_path, simulation.tally()) as recorder:
        recorder.record(record, frame)
    print_summary(simulation.scenario, recorder, "completed")
    told = [line for line in capsys.readouterr().out.splitlines() if line.startswith("load")]
    assert told == ([f"load       thread.start: {PULL:g} N, grows within {grows:g} s"] if grows else [])
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert summary["thread"]["start"]["grows_within"] == grows


@pytest.mark.parametrize("step", [0, 3])
def test_a_run_from_rest_goes_on_to_the_same_numbers(step: int) -> None:
    """Consistency check: from the memory of its start, and of a later step, where steps are made at once, to the
    round-off of a step that begins such a batch and not one within it."""
    scene = stitched("without inertia", duration=0.006)
    scene["thread"]["control_points"] = 30
    scene["thread"]["end"]["waypoints"] = [[0, 0.005, 0, 0.02], [0.02, 0.005, 0, 0.021]]
    whole = records_of(scene)
    kept = whole[step].kept
    assert kept is not None
    again = [record for record, _ in prepare(parse(scene)).advance(kept())]
    assert [record.step for record in again] == list(range(step, 7))
    for one, other in zip(again, whole[step:], strict=True):
        assert np.abs(forces_of(one) - forces_of(other)).max() <= RESIDUAL * PULL
        assert np.abs(np.array(astuple(one.energy)) - astuple(other.energy)).max() <= RESIDUAL * other.energy.at_stake


def test_a_stepper_begins_taut() -> None:
    """Independent check: the hand of a host program feels the thread at its first step, and moves nothing while it
    stays where it is."""
    scene = stitched()
    stepper = prepare(parse(scene)).stepper()
    felt = stepper.step(1e-3, [0.005, 0, 0.02])
    assert -felt.hand[2] > 0.2 * PULL
    assert np.abs(stepper.step(1e-3, [0.005, 0, 0.02]).hand - felt.hand).max() < TWO_SOLVERS * PULL


def test_the_way_out_of_no_rest_is_tried() -> None:
    """Independent check: of a run that finds no rest nothing but a start without one is tried, which helps, and it is
    named."""
    scene = stitched()
    scene["thread"] |= {"end": {"kind": "pulled", "force": [0, 0, 4 * PULL]}}
    said = try_remedies(prepare(parse(scene)).scenario, RestError(""), None, prepare)
    assert 'solve.start = "path"' in said.message and "no help" not in said.message


def test_what_has_no_rest_is_refused_in_words() -> None:
    """Independent check: a thread that is drawn out of its holes has none, the error says so and what starts without;
    one that slides freely is refused before, and statics, which has no clock to start."""
    scene = stitched()
    scene["thread"] |= {"end": {"kind": "pulled", "force": [0, 0, 4 * PULL]}}
    with pytest.raises(RestError, match=r'no rest to start from.*runs out of its last hole.*solve\.start = "path"'):
        records_of(scene)
    scene["thread"]["start"]["force"], scene["thread"]["end"]["force"] = [0, 0, 10 * PULL], [0, 0, 40 * PULL]
    scene["piercing"] = [{**hole, "friction": {"static": 0.0, "kinetic": 0.0}} for hole in scene["piercing"]]
    with pytest.raises(ScenarioError, match=r'dead loads are unbalanced.*solve\.start = "path"'):
        prepare(parse(scene))
    still = deepcopy(stitched())
    still["solve"]["kind"] = "static"
    with pytest.raises(ScenarioError, match=r'solve\.start = "rest" is refused'):
        parse(still)
    assert Scenario.model_validate(stitched(start="path")).solve.start == "path"


def test_a_path_goes_through_its_holes() -> None:
    """Independent check: every hole lies on the path on which the thread is laid, also off the middle of the arc at a
    corner, with two holes at one corner, and next to a straight line."""
    corner = [[-0.02, 0, 0], [0, 0, 0], [0, 0, 0.02]]
    for places in (
        [[-0.5e-3, 0, 0]],
        [[-0.5e-3, 0, 0], [0, 0, 0.5e-3]],
        [[-0.012, 1e-3, 0], [0, 0, 0], [0, 2e-3, 0.015]],
    ):
        holes = [{"name": f"hole {k}", "at": place} for k, place in enumerate(places)]
        table = {"thread": {"suture": "4-0 nylon", "path": corner}, "piercing": holes}
        ready = prepare(parse(table | {"solve": {"kind": "static"}})).assembly
        assert ready.laid.position(ready.at) == pytest.approx(np.array(places), abs=1e-9)
        lines = np.linalg.norm(np.diff([corner[0], *places, corner[2]], axis=0), axis=1).sum()
        assert lines * (1 - 1e-9) <= ready.laid.length <= 1.05 * max(lines, 0.04)


@pytest.mark.parametrize("turn", [60, 90, 150])
def test_a_thread_is_laid_through_the_corner_that_has_its_hole(turn: float) -> None:
    """Independent check: with a hole at the corner of its path the thread is as long as the two lines of the corner.
    The bend of an elastica takes 4 λ (1 − cos(turn/4)) more, λ² = EI/T, and this is the stretch of the thread."""
    way = np.radians(turn)
    corner = [[-0.02, 0, 0], [0, 0, 0], [0.02 * np.cos(way), 0, 0.02 * np.sin(way)]]
    ends = {"start": {"kind": "fixed"}, "end": {"kind": "fixed"}}
    hole = {"name": "corner", "at": [0, 0, 0]}
    table = {"thread": {"suture": "4-0 nylon", "path": corner, **ends}, "piercing": [hole]}
    simulation = prepare(parse(table | {"solve": {"kind": "static", "load_steps": 1}}))
    thread = simulation.assembly.system.thread
    assert thread.spline.end == pytest.approx(0.04, abs=5e-6)
    *_, (last, _) = simulation.advance()
    tension = (4 * (1 - np.cos(way / 4)) * np.sqrt(thread.EI) * thread.EA / thread.spline.end) ** (2 / 3)
    assert last.piercings[0].tension_before == pytest.approx(tension, rel=0.05)


@pytest.mark.parametrize("steps", [1, 4, 40])
@pytest.mark.parametrize("suture", ["2-0 nylon", "2-0 polypropylene", "4-0 nylon"])
def test_the_number_of_load_steps_does_not_matter(suture: str, steps: int) -> None:
    """Independent check: the strands at a rough hole bear T₂ − T₁ = μ (T₁ + T₂) sin(turn/2) in any number of load
    steps, although the bend of the laid thread is stretched by half a newton and friction could keep it."""
    turn, mu, load, arm = np.radians(150.0), 0.4, 2.0, 0.02
    arms = arm * np.array([[-np.cos(turn / 2), 0, np.sin(turn / 2)], [np.cos(turn / 2), 0, np.sin(turn / 2)]])
    pulled = {"kind": "pulled", "force": (load / arm * arms[1]).tolist()}
    path = [arms[0].tolist(), [0, 0, 0], arms[1].tolist()]
    table = {
        "thread": {"suture": suture, "path": path, "start": {"kind": "fixed"}, "end": pulled},
        "piercing": [
            {"name": "hole", "at": [0, 0, 0], "direction": [1, 0, 0], "friction": {"static": mu, "kinetic": mu}}
        ],
        "solve": {"kind": "static", "load_steps": steps},
    }
    *_, (last, _) = prepare(parse(table)).advance()
    share = mu * np.sin(turn / 2)
    assert last.piercings[0].tension_before == pytest.approx(load * (1 - share) / (1 + share), rel=0.01)
