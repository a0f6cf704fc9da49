"""Remedies for a failed run: each is tried on a copy before it is recommended."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal

from coupling.errors import CouplingError, RestError, TogetherError, TurnedHoleError
from studies.output.records import StepRecord
from studies.output.remarks import Remark, remark
from studies.scenario import Scenario, as_toml, changed, parsed, tables
from studies.simulation.simulation import REFUSALS, Simulation
from tissue.errors import FactorError

log = logging.getLogger(__name__)

Make = Callable[[Scenario], Simulation]
Settings = Mapping[str, Any]  # by dotted names
# of a copy: it ends well, is past the failure, fails, needs more than MOST corrections, or is refused
Outcome = Literal["ends", "past", "fails", "slow", "refused"]

FINER = 4  # factor of shorter steps: a smaller change can help by chance
MOST = 5000  # allowed Newton corrections of a copy: enough for a few hundred shorter steps
PAST = 10  # number of steps of the failed run beyond the failure, to which a copy is computed
IN_VAIN = (CouplingError, FactorError, *REFUSALS)


def written(settings: Settings) -> str:
    """Return settings in the notation of a scenario."""
    return ", ".join(f"{key} = {as_toml(value)}" for key, value in settings.items())


def try_remedies(scenario: Scenario, failure: CouplingError, last: StepRecord | None, make: Make) -> Remark:
    """Try remedies for a failed `scenario` until one helps, and return the remark.

    `last` is its last step, None for a failure before the first step; `make` prepares a copy. Only
    scenario and failure determine the remedies. A copy is ended by its number of corrections and
    not by time, so repeated runs give the same remark.
    """
    time, fails, slow = last.time if last else 0.0, list[str](), list[str]()
    for settings in remedies(scenario, failure):
        text = written(settings)
        log.info("trying on a copy whether %s helps; Ctrl-C stops", text)
        outcome, reached = attempt(scenario, settings, time, make)
        if outcome in ("ends", "past"):
            past = f"gets past t = {time:.4g} s; it was computed to {reached:.4g} s"
            way = "reaches its end" if outcome == "ends" else past
            before = f" (tried before, {in_vain(fails, slow)})" if fails or slow else ""
            return remark("remedy", "solve", text=f"tried on a copy: with {text} the run {way}{before}")
        fails += [text] * (outcome == "fails")
        slow += [text] * (outcome == "slow")
    helpless = f"no remedy helped on a copy of the run; {in_vain(fails, slow)}"
    return remark("remedy", "solve", text=helpless if fails or slow else "no copy could be prepared")


def in_vain(fails: Sequence[str], slow: Sequence[str]) -> str:
    """Return the settings of copies that failed or were slow, in words."""
    words = [f"no help: {'; '.join(fails)}"] * bool(fails)
    return ", ".join(words + [f"stopped after {MOST} corrections: {'; '.join(slow)}"] * bool(slow))


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


def attempt(scenario: Scenario, settings: Settings, time: float, make: Make) -> tuple[Outcome, float]:
    """Run a copy with other settings, and return the outcome and the time reached [s].

    The copy ends well past a `time` [s], or after too many corrections.
    """
    goal, corrections = time + PAST * scenario.solve.duration / scenario.solve.steps, 0
    try:
        copy = make(parsed(changed(tables(scenario), settings)))
    except IN_VAIN:
        return "refused", 0.0
    try:
        for step, _ in copy.advance():
            time, corrections = step.time, corrections + step.newton_iterations
            if step.step == copy.steps:
                return "ends", time
            if time >= goal:
                return "past", time
            if corrections > MOST:
                return "slow", time
    except IN_VAIN:
        pass
    return "fails", time
