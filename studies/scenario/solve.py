"""The tables `[solve]` and `[output]`."""

from collections.abc import Mapping
from math import ceil
from typing import Any, Literal

from studies.scenario.table import ScenarioTable
from studies.scenario.values import NotNegative, Positive, Vector, Whole

WHOLE = 1e-9  # of a step: a duration this near to a whole number of steps counts as whole
MOST_STEPS = 100_000_000  # at one millisecond each, the least time of a step: more than a day


class Solve(ScenarioTable):
    """The solution method."""

    kind: Literal["dynamic", "static"] = "dynamic"
    dt: Positive = 1.0e-3
    duration: Positive = 1.0
    start: Literal["path", "rest"] = "path"
    load_steps: Whole = 10
    scheme: Literal["newton", "linear"] = "newton"
    newton: Literal["auto", "numpy", "compiled"] = "auto"
    organ: Literal["auto", "whole", "krylov"] = "auto"
    integrator: Literal["euler", "bdf2"] = "bdf2"
    tolerance: Positive | None = None
    coupling: Literal["monolithic", "staggered"] = "monolithic"
    friction: Literal["implicit", "two-pass"] = "implicit"
    epsilon: NotNegative = 0.0
    gravity: Vector = (0.0, 0.0, 0.0)

    @classmethod
    def chosen(cls, data: Mapping[str, Any]) -> dict[str, Any]:
        first_order = data.get("scheme") == "linear" or data.get("friction") == "two-pass"
        return {"integrator": "euler"} if first_order else {}

    def _check_step(self) -> None:
        self._refuse(self.kind == "dynamic" and self.dt > self.duration, "dt.long")

    @property
    def is_one_system(self) -> bool:
        """Whether time steps use Newton's method, with thread and organ in one system."""
        ways = (self.kind, self.scheme, self.coupling, self.friction)
        return ways == ("dynamic", "newton", "monolithic", "implicit")

    @property
    def steps(self) -> int:
        """Number of steps, or of load steps."""
        return self.load_steps if self.kind == "static" else ceil(self.duration / self.dt - WHOLE)

    def step_by(self, time: float) -> int:
        """Return the number of the first step that ends at or after a time [s]."""
        return ceil(time / self.step - WHOLE)

    @property
    def step(self) -> float:
        """Length of a step, or of a load step [s]."""
        return self.duration / self.load_steps if self.kind == "static" else self.dt

    def _check_steps(self) -> None:
        static, count, least = self.kind == "static", self.duration / self.dt, self.duration / MOST_STEPS
        self._refuse(static and self.load_steps > MOST_STEPS, "load_steps.many", most=MOST_STEPS)
        self._refuse(not static and count > MOST_STEPS, "dt.short", count=count, most=MOST_STEPS, least=least)

    def _check_method(self) -> None:
        static, two_pass, second_order = self.kind == "static", self.friction == "two-pass", self.integrator == "bdf2"
        self._refuse(second_order and (self.scheme == "linear" or two_pass), "integrator.order")
        self._refuse(static and self.scheme == "linear", "scheme.static")
        self._refuse(two_pass and (static or second_order), "friction.method")
        self._refuse(static and self.start == "rest", "start.static")
        self._refuse(self.tolerance is not None and not self.is_one_system, "tolerance.method")
        self._refuse(static and self.coupling == "staggered", "coupling.static")


class Output(ScenarioTable):
    """The output of the run."""

    every: Whole = 10
