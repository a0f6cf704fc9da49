"""A run into a folder, from Python and from the command."""

from collections.abc import Callable
from pathlib import Path

from studies.output.budget import check_disk
from studies.output.checkpoint import read_checkpoint
from studies.output.folder import Recorder, can_resume, check_folder, completed_run
from studies.output.lock import locked
from studies.output.opened import OpenRun, open_run
from studies.output.records import StepRecord
from studies.scenario import Scenario
from studies.simulation.interface import AnySimulation, Moments
from studies.simulation.simulation import prepare

OnStep = Callable[[StepRecord], None]


def run(
    scenario: Scenario,
    folder: Path | str,
    mesh: object = None,
    resume: bool = False,
    overwrite: bool = False,
    on_step: OnStep | None = None,
) -> OpenRun:
    """Run a scenario into a folder, and open it.

    `mesh` as in `prepare`. A folder that holds a run is refused, unless the run goes on (`resume`) or is replaced
    (`overwrite`). `on_step` is called with the record of the start and of every step; an exception from it ends the
    run, whose folder then says so. Raises the errors of input that cannot be run, and of a run that fails.
    """
    folder = Path(folder)
    with locked(folder):
        check_folder(folder, scenario, None, resume, overwrite)
        begun = begin(prepare(scenario, mesh=mesh), folder, resume)
        if begun is not None:
            recorder, moments = begun
            with recorder:
                for step, frame in moments:
                    recorder.record(step, frame)
                    if on_step is not None:
                        on_step(step)
    return open_run(folder)


def begin(simulation: AnySimulation, folder: Path, resume: bool = False) -> tuple[Recorder, Moments] | None:
    """Return what records a run into a folder, and its steps, from the last checkpoint where it is to be resumed; None
    where it is completed. Raises `ScenarioError`."""
    checkpoint = None
    if resume and can_resume(folder, simulation.scenario):
        if completed_run(folder, simulation.scenario) is not None:
            return None
        checkpoint = read_checkpoint(folder)
    if checkpoint is None:
        check_disk(folder, simulation.scenario, simulation.topology)
    moments = simulation.advance(checkpoint)
    recorder = Recorder(
        folder,
        simulation.scenario,
        simulation.topology,
        simulation.tissue_dofs,
        checkpoint,
        simulation.subgrid,
        judge=simulation.remarks,
        methods=simulation.methods,
    )
    return recorder, moments
