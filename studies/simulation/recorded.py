"""A run into a folder, from Python and from the command, and remedies for a run that fails."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from coupling.errors import CouplingError, RestError, TogetherError, TurnedHoleError
from studies.output.budget import check_disk
from studies.output.checkpoint import read_checkpoint
from studies.output.folder import Recorder, can_resume, check_folder, completed_run
from studies.output.lock import folder_of, locked
from studies.output.reading import OpenRun, open_run
from studies.output.records import StepRecord
from studies.output.remarks import Remark, remark
from studies.scenario import Scenario, ScenarioError
from studies.scenario.refusal import as_toml, because
from studies.scenario.scenario import check_given
from studies.scenario.toml import changed, parsed, tables
from studies.simulation.sharing import Shared
from studies.simulation.simulation import REFUSALS, Moments, OnStep, Simulation, prepare
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


def run(
    scenario: Scenario | Simulation,
    folder: Path | str,
    mesh: object = None,
    resume: bool = False,
    overwrite: bool = False,
    on_step: OnStep | None = None,
    remedies: bool = True,
) -> OpenRun:
    """Run a scenario, or a prepared simulation, into a folder, and return the opened folder.

    `mesh` and `on_step` are as in `prepare`; None leaves the values of a prepared simulation. A
    folder with a run is refused, unless the run is continued (`resume`) or replaced (`overwrite`).
    A run with laws from Python cannot be continued, because no file identifies them. If a run
    fails, remedies are tried on copies and reported in a remark, unless `remedies` is False. Each
    step is recorded before `on_step` is called with its record. An exception from `on_step` ends
    the run, and the folder reports the end. Raises the errors of refused input and of a failed run.
    """
    folder, ready = folder_of(folder), scenario if isinstance(scenario, Simulation) else None
    if ready is not None:
        check_prepared(ready, mesh, resume)
    requested = scenario.scenario if isinstance(scenario, Simulation) else scenario
    check_given(requested)
    with locked(folder):
        check_folder(folder, requested, None, resume, overwrite)
        simulation = ready or prepare(requested, mesh=mesh)
        begun = begin(replace(simulation, on_step=on_step or simulation.on_step), folder, resume)
        if begun is not None:
            recorder, moments = begun
            try:
                with recorder:
                    for step, frame in moments:
                        recorder.record(step, frame)
            except CouplingError as failure:
                if remedies:
                    make = partial(prepare, store=Shared(), **simulation.assembly.given.parts)
                    recorder.remark(try_remedies(simulation.scenario, failure, recorder.tally.last_step, make))
                raise
    return open_run(folder)


def check_prepared(simulation: Simulation, mesh: object, resume: bool) -> None:
    """Refuse another mesh for a prepared simulation, and a resume with laws from Python."""
    if mesh is not None:
        raise ScenarioError(f"mesh is refused: {because('mesh-prepared')}")
    if resume and (unrecorded := simulation.assembly.given.unrecorded):
        raise ScenarioError(f"resume is refused: {because('resume', parts=', '.join(unrecorded))}")


def begin(simulation: Simulation, folder: Path, resume: bool = False) -> tuple[Recorder, Moments] | None:
    """Return the recorder of a run into a folder, and the steps of the run.

    A resumed run continues after its last checkpoint. The result is None if the run is complete.
    Raises `ScenarioError`.
    """
    checkpoint = None
    if resume and can_resume(folder, simulation.scenario):
        if completed_run(folder, simulation.scenario) is not None:
            return None
        checkpoint = read_checkpoint(folder)
    if checkpoint is None:
        check_disk(folder, simulation.scenario, simulation.topology)
    moments = simulation.advance(checkpoint)
    return Recorder(folder, simulation.tally(checkpoint), simulation.topology, simulation.methods), moments


# --- remedies for a failed run: each is tried on a copy before it is recommended ------------------------------


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
