"""Remedies for a failed run: each is tried on a copy before it is named."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from coupling.errors import CouplingError, RestError, TogetherError, TurnedHoleError
from meshes.errors import MeshError
from studies.output.records import StepRecord
from studies.output.remarks import Remark, remark
from studies.scenario import Scenario, ScenarioError
from studies.scenario.refusal import as_toml
from studies.scenario.toml import changed, parsed, tables
from studies.simulation.simulation import Simulation
from thread.errors import ThreadError
from tissue.errors import FactorError, TissueError

log = logging.getLogger(__name__)

Make = Callable[[Scenario], Simulation]
Settings = Mapping[str, Any]  # by dotted names

FINER = 4  # by how much shorter steps are: what a tenth more helps is chance
MOST = 5000  # corrections of Newton that a copy may take: what a few hundred steps at a quarter of their length do
PAST = 10  # steps of the run that failed, beyond the one that failed, that a copy is followed
IN_VAIN = (CouplingError, FactorError, ScenarioError, MeshError, TissueError, ThreadError)


@dataclass(frozen=True)
class Trial:
    """The result of a copy with other `settings`, computed to the `time` [s]: it "ends" well, is "past" the failure,
    "fails", is "slow" and takes more than `MOST` corrections, or is "refused"."""

    settings: Settings
    outcome: Literal["ends", "past", "fails", "slow", "refused"]
    time: float = 0.0

    @property
    def helps(self) -> bool:
        """Whether the copy gets past where the run failed."""
        return self.outcome in ("ends", "past")

    @property
    def text(self) -> str:
        """The settings as a person writes them."""
        return written(self.settings)


def written(settings: Settings) -> str:
    """Write settings as a person does."""
    return ", ".join(f"{key} = {as_toml(value)}" for key, value in settings.items())


def try_remedies(scenario: Scenario, failure: CouplingError, last: StepRecord | None, make: Make) -> Remark:
    """Try remedies for a `scenario` that failed after its `last` step (None: before the first) until one helps, and
    return the remark; `make` prepares a copy.

    What is tried is told by scenario and failure alone, and a copy is given up by the corrections that it takes, so
    that of the same run the same is said.
    """
    time, trials = last.time if last else 0.0, list[Trial]()
    for settings in remedies(scenario, failure):
        log.info("trying on a copy whether %s helps; Ctrl-C stops", written(settings))
        trials.append(attempt(scenario, settings, time, make))
        if trials[-1].helps:
            break
    return remark_of(trials, time)


def remedies(scenario: Scenario, failure: CouplingError) -> Iterator[Settings]:
    """Yield possible remedies, the most likely first."""
    solve, thread, organ = scenario.solve, scenario.thread, scenario.tissue
    if isinstance(failure, RestError):
        yield {"solve.start": "path"}
        return
    if isinstance(failure, TogetherError | TurnedHoleError) and organ is not None and organ.material == "linear":
        yield {"tissue.material": "neo-hookean"}
    if solve.coupling == "staggered":
        yield {"solve.coupling": "monolithic"}
    if solve.scheme == "linear" or solve.friction == "two-pass":
        exact = {"scheme": "newton", "friction": "implicit", "integrator": "bdf2"}
        yield {f"solve.{key}": value for key, value in exact.items() if getattr(solve, key) != value}
    if solve.kind == "static":
        yield {"solve.load_steps": FINER * solve.load_steps}
    else:
        yield {"solve.dt": solve.dt / FINER}
    yield {"thread.control_points": 2 * thread.control_points}


def attempt(scenario: Scenario, settings: Settings, time: float, make: Make) -> Trial:
    """Run a copy with other settings until it is well past a `time` [s], has taken too many corrections, or fails."""
    goal, corrections = time + PAST * scenario.solve.duration / scenario.solve.steps, 0
    try:
        copy = make(parsed(changed(tables(scenario), settings)))
    except IN_VAIN:
        return Trial(settings, "refused")
    try:
        for step, _ in copy.advance():
            time, corrections = step.time, corrections + step.newton_iterations
            if step.step == copy.steps:
                return Trial(settings, "ends", time)
            if time >= goal:
                return Trial(settings, "past", time)
            if corrections > MOST:
                return Trial(settings, "slow", time)
    except IN_VAIN:
        pass
    return Trial(settings, "fails", time)


def remark_of(trials: Sequence[Trial], time: float) -> Remark:
    """Return the remark on the `trials` on copies of a run whose last step ended at `time` [s]."""
    vain = "; ".join(trial.text for trial in trials if trial.outcome == "fails")
    slow = "; ".join(trial.text for trial in trials if trial.outcome == "slow")
    other = [f"in vain: {vain}"] * bool(vain) + [f"given up after {MOST} corrections: {slow}"] * bool(slow)
    if not trials[-1].helps:
        text = f"no remedy helped on a copy of the run; {', '.join(other)}" if other else "no copy could be prepared"
        return remark("remedy", "solve", text)
    reached = f"gets past t = {time:.4g} s; it was computed to {trials[-1].time:.4g} s"
    ways = {"ends": "comes to its end", "past": reached}
    before = f" (tried before, {', '.join(other)})" if other else ""
    text = f"tried on a copy: with {trials[-1].text} the run {ways[trials[-1].outcome]}{before}"
    return remark("remedy", "solve", text)
