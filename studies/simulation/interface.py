"""What the command and the recorder ask of a run that is prepared."""

from collections.abc import Callable, Iterator
from typing import Any, Protocol

from studies.output.checkpoint import Arrays
from studies.output.fields import OrganTopology
from studies.output.records import Ending, Snapshot, StepRecord
from studies.output.remarks import Remark
from studies.scenario import Scenario

Moments = Iterator[tuple[StepRecord, Callable[[], Snapshot]]]


class AnySimulation(Protocol):
    """What ``studies.simulation.prepare(scenario)`` gives: all that can be known before the first step."""

    @property
    def scenario(self) -> Scenario:
        """As run: with the defaults that the geometry tells."""

    @property
    def topology(self) -> OrganTopology | None:
        """The organ's mesh, None without an organ."""

    @property
    def tissue_dofs(self) -> int:
        """Unknowns of the organ that are not held."""

    @property
    def balls(self) -> int:
        """Balls of all tracts."""

    @property
    def subgrid(self) -> dict[str, dict[str, Any]]:
        """By piercing, what the organ's mesh is too coarse for, where that is added."""

    @property
    def steps(self) -> int:
        """Steps to be taken."""

    @property
    def methods(self) -> dict[str, str | None]:
        """By what the run is solved."""

    def remarks(self, ending: Ending | None = None) -> list[Remark]:
        """What is to be said of the run: what is foreseen, and what it met until an `ending`."""

    def advance(self, memory: Arrays | None = None) -> Moments:
        """Yield the start, then every accepted step, each with a function that makes its frame; with the memory of a
        step, that step again and those after it."""
