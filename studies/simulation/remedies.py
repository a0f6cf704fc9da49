"""Remedies for a failed run: each is tried on a copy before it is recommended."""

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

FINER = 4  # factor of shorter steps: a smaller change can help by chance
MOST = 5000  # allowed Newton corrections of a copy: enough for a few hundred shorter steps
PAST = 10  # number of steps of the failed run beyond the failure, to which a copy is computed
IN_VAIN = (CouplingError, FactorError, ScenarioError, MeshError, TissueError, ThreadError)


@dataclass(frozen=True)
class Trial:
    """The result of a copy with other `settings`, computed to the `time` [s].

    Its outcome: it "ends" well, is "past" the failure, "fails", is "slow" (more than `MOST` corrections), or is
    "refused".
    """

    settings: Settings
    outcome: Literal["ends", "past", "fails", "slow", "refused"]
    time: float = 0.0

    @property
    def helps(self) -> bool:
        """Whether the copy passes the time of the failure."""
        return self.outcome in ("ends", "past")

    @property
    def text(self) -> str:
        """The settings in the notation of a scenario."""
        return written(self.settings)


def written(settings: Settings) -> str:
    """Return settings in the notation of a scenario."""
    return ", ".join(f"{key} = {as_toml(value)}" for key, value in settings.items())


def try_remedies(scenario: Scenario, failure: CouplingError, last: StepRecord | None, make: Make) -> Remark:
    """Try remedies for a failed `scenario` until one helps, and return the remark.

    `last` is its last step, None for a failure before the first step; `make` prepares a copy. Only scenario and
    failure determine the remedies. A copy is ended by its number of corrections and not by time, so repeated
    runs give the same remark.
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
    """Run a copy with other settings until it is well past a `time` [s], needs too many corrections, or fails."""
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
    other = [f"no help: {vain}"] * bool(vain) + [f"stopped after {MOST} corrections: {slow}"] * bool(slow)
    if not trials[-1].helps:
        text = f"no remedy helped on a copy of the run; {', '.join(other)}" if other else "no copy could be prepared"
        return remark("remedy", "solve", text=text)
    reached = f"gets past t = {time:.4g} s; it was computed to {trials[-1].time:.4g} s"
    ways = {"ends": "reaches its end", "past": reached}
    before = f" (tried before, {', '.join(other)})" if other else ""
    text = f"tried on a copy: with {trials[-1].text} the run {ways[trials[-1].outcome]}{before}"
    return remark("remedy", "solve", text=text)
