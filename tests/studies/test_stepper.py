"""A run that a host program steps: the same as the scenario's own, its forces, its times, and what is refused."""

import numpy as np
import pytest

from coupling.errors import CouplingError
from studies.scenario import Scenario, ScenarioError, parse
from studies.simulation import prepare
from studies.simulation.simulation import Simulation
from tests.bounds import TWO_SOLVERS

DT, STEPS = 1e-3, 12
ORGAN = {
    "youngs_modulus": 1e5,
    "poisson_ratio": 0.45,
    "density": 1070.0,
    "rayleigh": [5.0, 5e-4],
    "clamp": ["bottom"],
    "mesh": {"kind": "block", "size": [0.03, 0.02, 0.01], "h": 5e-3, "accuracy": "given"},
}


def scenario_of(**keys: object) -> Scenario:
    """A thread through a block, pulled at its start and driven at its end."""
    thread = {
        "suture": "2-0 polypropylene",
        "control_points": 24,
        "damping": 20.0,
        "path": [[0, 0, -0.008], [0, 0, 0.02]],
        "start": {"kind": "pulled", "force": [0, 0, -0.02], "ramp": 0.0},
        "end": {"kind": "driven", "waypoints": [[0, 0, 0, 0.02], [STEPS * DT, 0.001, 0, 0.0205]]},
    }
    hole = {"name": "hole", "at": [0, 0, 0], "direction": "normal", "footprint": 2e-3}
    solve = {"dt": DT, "duration": STEPS * DT, "organ": "krylov"}
    return parse({"tissue": ORGAN, "thread": thread, "piercing": [hole], "solve": solve} | keys)


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return prepare(scenario_of())


def fail(*arguments: object) -> None:
    """Be a step that cannot be made."""
    raise CouplingError("it snaps")


def hand(k: int) -> np.ndarray:
    """The place of the scenario's own hand after k steps."""
    return np.array([0.001, 0, 0.0005]) * (k / STEPS) + [0, 0, 0.02]


def test_a_hand_that_does_what_the_scenario_says_is_the_scenario(simulation: Simulation) -> None:
    """Consistency check: forces of every step, on the hand against its own reaction, and the places at the end; the
    record and the frame are those of a run."""
    own = [step for step, _ in simulation.advance()]
    stepper = simulation.stepper()
    for k in range(1, STEPS + 1):
        forces = stepper.step(DT, hand(k))
        scale = np.linalg.norm(own[k].piercings[0].force)
        assert np.abs(forces.hand + own[k].end_reaction).max() <= TWO_SOLVERS * scale
        assert np.abs(forces.piercings[0] - own[k].piercings[0].force).max() <= TWO_SOLVERS * scale
        assert np.allclose(forces.other, [0, 0, 0.02], atol=0.02 * TWO_SOLVERS)
    assert stepper.time == pytest.approx(own[-1].time, rel=1e-12)
    assert abs(stepper.record.piercings[0].slip - own[-1].piercings[0].slip) <= TWO_SOLVERS * 1e-3
    drawn = stepper.frame()
    assert drawn.organ is not None and np.allclose(drawn.thread.points[-1], hand(STEPS), atol=1e-12)


def test_the_hand_goes_where_it_likes_and_a_step_that_fails_is_none(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Independent check: the thread's end is where the hand is, with steps of another length too; after a step that
    fails the run is where it was and goes on; more pull is more force."""
    stepper = simulation.stepper()
    one = stepper.step(DT, [0.0005, 0.0003, 0.0201])
    more = stepper.step(0.5 * DT, [0.0005, 0.0003, 0.0203])
    assert np.allclose(stepper.frame().thread.points[-1], [0.0005, 0.0003, 0.0203], atol=1e-12)
    assert np.linalg.norm(more.hand) > np.linalg.norm(one.hand)
    with monkeypatch.context() as broken, pytest.raises(CouplingError):
        broken.setattr("coupling.run.run.advance", fail)
        broken.setattr("coupling.run.run.march", lambda *arguments: None)
        stepper.step(DT, [0.0, 0.0, 0.03])
    assert stepper.time == pytest.approx(1.5 * DT, rel=1e-12)
    assert np.all(np.isfinite(stepper.step(DT, [0.0005, 0.0003, 0.0203]).hand))


def test_times_are_counted_against_the_deadline(simulation: Simulation) -> None:
    """Independent check: whatever the machine, every step misses a deadline of zero and none one of an hour; the
    median is between nothing and the worst."""
    for deadline, missed in ((0.0, 2), (3600.0, 0)):
        stepper = simulation.stepper(deadline=deadline)
        with pytest.raises(ValueError, match="no step was taken"):
            assert stepper.timing
        for k in (1, 2):
            stepper.step(DT, hand(k))
        timing = stepper.timing
        assert (timing.steps, timing.missed) == (2, missed)
        assert 0.0 < timing.median <= timing.late <= timing.worst
        assert str(timing).startswith("2 steps: median")


def test_what_cannot_be_stepped_is_refused(simulation: Simulation) -> None:
    """Independent check: statics, an end that no hand holds by its place, and what is no place or no time."""
    with pytest.raises(ScenarioError, match=r'thread\.start\.kind = "pulled"'):
        simulation.stepper("start")
    for deadline in (-1e-3, float("nan")):
        with pytest.raises(ScenarioError, match=rf"deadline = {deadline} is refused: allowed are times of 0 s or more"):
            simulation.stepper(deadline=deadline)
    with pytest.raises(ScenarioError, match='end = "tip" is refused: allowed are "start" and "end"'):
        simulation.stepper("tip")  # type: ignore[arg-type]
    still = prepare(scenario_of(tissue=None, piercing=[], solve={"kind": "static"}))
    with pytest.raises(ScenarioError, match=r'solve\.kind = "static"'):
        still.stepper()
    here = [0, 0, 0]
    for dt, place in ((0.0, here), (float("nan"), here), (DT, [0, 0]), (DT, [0, 0, np.nan]), (DT, "there")):
        with pytest.raises(ValueError, match="allowed are a positive time"):
            simulation.stepper().step(dt, place)
