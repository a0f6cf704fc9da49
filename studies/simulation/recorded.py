"""A run into a folder, from Python and from the command."""

from dataclasses import replace
from functools import partial
from pathlib import Path

from coupling.errors import CouplingError
from studies.output.budget import check_disk
from studies.output.checkpoint import read_checkpoint
from studies.output.folder import Recorder, can_resume, check_folder, completed_run
from studies.output.lock import folder_of, locked
from studies.output.reading import OpenRun, open_run
from studies.scenario import Scenario, ScenarioError, because, check_given
from studies.simulation.remedies import try_remedies
from studies.simulation.sharing import Shared
from studies.simulation.simulation import Moments, OnStep, Simulation, prepare


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
