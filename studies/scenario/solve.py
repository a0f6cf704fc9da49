"""The tables `[solve]` and `[output]`."""

from collections.abc import Mapping
from math import ceil
from typing import Any, Literal

from studies.scenario.table import NotNegative, Positive, ScenarioTable, Vector, Whole

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
        if self.kind == "dynamic" and self.dt > self.duration:
            raise ValueError(f".dt = {self.dt} is refused: it must not exceed duration = {self.duration}; lower it")

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
        """Return the number of the first step, or load step, that ends at or after a time [s]."""
        return ceil(time / self.step - WHOLE)

    @property
    def step(self) -> float:
        """Length of a step, or of a load step [s]."""
        return self.duration / self.load_steps if self.kind == "static" else self.dt

    def _check_steps(self) -> None:
        if self.kind == "static" and self.load_steps > MOST_STEPS:
            raise ValueError(f".load_steps = {self.load_steps} is refused: at most {MOST_STEPS} are allowed; lower it")
        count = self.duration / self.dt
        if self.kind == "dynamic" and count > MOST_STEPS:
            raise ValueError(
                f".dt = {self.dt} is refused: duration = {self.duration} takes {count:.3g} steps, and at most "
                f"{MOST_STEPS} are allowed; use {self.duration / MOST_STEPS:.3g} or more, or shorten the duration"
            )

    def _check_method(self) -> None:
        if self.integrator == "bdf2" and (self.scheme == "linear" or self.friction == "two-pass"):
            raise ValueError(
                '.integrator = "bdf2" is refused: the linear scheme and two-pass friction use backward Euler; use '
                'integrator = "euler", or scheme = "newton" with friction = "implicit"'
            )
        if self.scheme == "linear" and self.kind == "static":
            raise ValueError(
                '.scheme = "linear" is refused: solve.kind is static, and the linear scheme makes time steps; use '
                'scheme = "newton" or kind = "dynamic"'
            )
        if self.friction == "two-pass" and (self.kind == "static" or self.integrator == "bdf2"):
            raise ValueError(
                '.friction = "two-pass" is refused: it makes time steps of backward Euler; use friction = "implicit", '
                'or kind = "dynamic" with integrator = "euler"'
            )
        if self.start == "rest" and self.kind == "static":
            raise ValueError(
                '.start = "rest" is refused: solve.kind is static, so every load step ends at rest; leave it out, '
                'or use kind = "dynamic"'
            )
        if self.tolerance is not None and not self.is_one_system:
            raise ValueError(
                f".tolerance = {self.tolerance} is refused: it needs time steps by Newton's method, thread and "
                'organ in one system; leave it out, or use kind = "dynamic" with scheme = "newton", coupling = '
                '"monolithic" and friction = "implicit"'
            )
        if self.coupling == "staggered" and self.kind == "static":
            raise ValueError(
                '.coupling = "staggered" is refused: solve.kind is static, and staggering needs time steps; use '
                'coupling = "monolithic" or kind = "dynamic"'
            )


class Output(ScenarioTable):
    """The output of the run."""

    every: Whole = 10
