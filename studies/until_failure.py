"""The steps of a study's run, up to the one that fails."""

from collections.abc import Iterator

from coupling.errors import CouplingError
from studies.simulation import Simulation
from studies.simulation.memory import OrganRun


def steps_until_failure(simulation: Simulation) -> Iterator[tuple[OrganRun, str]]:
    """Yield the run after every step, with empty words; after a failure the run before it again, with its name and
    reason."""
    now = simulation.beginning()
    while now.number < simulation.steps:
        try:
            now = simulation.next(now)
        except CouplingError as error:
            yield now, f"{type(error).__name__}: {error}"
            return
        yield now, ""
