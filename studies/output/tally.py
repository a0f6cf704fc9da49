"""Totals, extremes and remarks of a run for its summary, collected step by step."""

from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np

from studies.output.checkpoint import ANEW, CHECKPOINT, Arrays, pack, unpack
from studies.output.columns import RUN, range_summary, state_summary, values
from studies.output.records import Ending, Record, StepRecord, nothing_met
from studies.output.remarks import Remark
from studies.scenario import Scenario, ScenarioError

NEVER = -1  # step
NOTHING = {"newton_iterations": 0, "constraint_max": 0.0, "seconds": 0.0, "whole_from": NEVER}  # before the start
Status = Literal["completed", "failed", "interrupted"]
Judge = Callable[[Ending | None], Sequence[Remark]]  # returns remarks at the end of a run; None: before its start


class Tally:
    """Collects the summary of a run of a scenario; the ``memory`` of a checkpoint continues it.

    Raises `ScenarioError` for an incomplete checkpoint.
    """

    def __init__(
        self,
        scenario: Scenario,
        tissue_dofs: int = 0,
        judge: Judge | None = None,
        memory: Arrays | None = None,
        refinement: Mapping[str, Any] | None = None,
    ) -> None:
        self._judge = judge
        self.scenario = scenario
        self.begun = NEVER  # the step of the checkpoint
        self._names = [hole.name for hole in scenario.piercing]
        self._tissue_dofs = tissue_dofs
        self.own: list[Remark] = []
        self.last_step: StepRecord | None = None
        self.refinement = refinement or {}
        known: Arrays = memory or {}
        self._totals: dict[str, Any] = {key: type(none)(known.get(key, none)) for key, none in NOTHING.items()}
        self._extremes = nothing_met(len(self._names), len(scenario.tie))
        if memory is not None:
            try:
                self.begun, self._extremes = int(memory["step"]), unpack(self._extremes, memory, "extremes")
            except KeyError as error:
                raise ScenarioError(f"{CHECKPOINT} is of another version of this code ({error}); {ANEW}") from None

    def count(self, step: StepRecord) -> None:
        """Add an accepted step, which is then the last step.

        The laid start of a static run is no equilibrium. The values of its step are not among the extremes.
        """
        self.last_step = step
        now = self._totals
        now["newton_iterations"] += step.newton_iterations
        now["constraint_max"] = max(now["constraint_max"], step.constraint_max)
        now["seconds"] += step.seconds if step.step else 0.0
        if now["whole_from"] == NEVER and step.krylov is not None and not step.krylov.vectors:
            now["whole_from"] = step.step
        if step.step or self.scenario.solve.kind == "dynamic":
            self._extremes = self._extremes.after_step(step)

    @property
    def whole_from(self) -> int | None:
        """The first step with all unknowns of an organ instead of its Krylov space.

        None if there was no such step.
        """
        return None if self._totals["whole_from"] == NEVER else self._totals["whole_from"]

    def see(self, organ: Record | None) -> None:
        """Add the organ of a frame, None without an organ."""
        self._extremes = self._extremes.after_frame(organ)

    def memory(self) -> dict[str, Any]:
        """Return the content for a checkpoint, as arrays."""
        return {key: np.array(value) for key, value in self._totals.items()} | pack(self._extremes, "extremes")

    @property
    def remarks(self) -> list[Remark]:
        """Remarks on the run up to its last step."""
        ending = None if self.last_step is None else (self.last_step, self._extremes)
        return [*(self._judge(ending) if self._judge else ()), *self.own]

    def summary(self, status: Status, error: str = "") -> dict[str, Any]:
        """Return the contents of ``summary.json`` after the last step, without the provenance."""
        step = self.last_step
        ended = {"status": status, "error": error, "tissue_dofs": self._tissue_dofs}
        ended |= {"time": step.time, "steps": step.step} if step else {"time": 0.0, "steps": 0}
        head = values(RUN, SimpleNamespace(**ended, **self._totals))
        parts: dict[str, Any] = {"remarks": [remark.record() for remark in self.remarks]}
        if self.scenario.tissue is not None:
            parts["range"] = range_summary(self._names, self._extremes)
        if step is not None and step.krylov is not None:
            parts["krylov"] = {"vectors": step.krylov.vectors, "residual": self._extremes.residual}
        if "rounds" in self.refinement:
            parts["mesh"] = {"rounds": self.refinement["rounds"]}
        state = state_summary(step, self.scenario) if step else {}
        sources = {"compliance_error": "errors", "bounds": "bounds"}
        for name, hole in state.get("piercings", {}).items():
            known = {key: self.refinement.get(of, {}).get(name) for key, of in sources.items()}
            hole.update({key: value for key, value in known.items() if value is not None})
        return head | parts | state
