"""Convergence of a number under refinement."""

from dataclasses import asdict, dataclass
from math import isfinite, isnan, nan
from typing import Any

from studies.verdicts import Verdict

NO_VERDICT = "no verdict"


@dataclass(frozen=True)
class Refined:
    """Convergence of a quantity.

    `numbers` begin with the coarsest level, and are NaN for a failed level. It has the `factors` of
    the levels and the theoretical order. The verdict is None with fewer than three numbers. For
    levels of accuracy it also has the `estimates` of the relative error of the holes'
    compliance [-]; otherwise they are empty.
    """

    quantity: str
    unit: str
    factors: tuple[float, ...]
    numbers: tuple[float, ...]
    theory: float
    verdict: Verdict | None
    why_not: str = ""
    estimates: tuple[float, ...] = ()

    def __repr__(self) -> str:
        return f"Refined({self.quantity} [{self.unit}]: {self.text})"

    @property
    def finest(self) -> float:
        """The number of the finest completed level, NaN without one."""
        return next((number for number in reversed(self.numbers) if not isnan(number)), nan)

    @property
    def interval(self) -> tuple[float, float] | None:
        """The interval of the grid-convergence index about the finest number, or None."""
        if self.verdict is None or not isfinite(self.verdict.index):
            return None
        half = self.verdict.index * abs(self.finest)
        return self.finest - half, self.finest + half

    @property
    def converged(self) -> bool:
        """Whether the number is called converged."""
        return self.verdict is not None and self.verdict.kind == "converged"

    @property
    def text(self) -> str:
        """The verdict in words."""
        return f"{NO_VERDICT}: {self.why_not}" if self.verdict is None else self.verdict.text

    def record(self) -> dict[str, Any]:
        """Return the content of ``verdict.json``."""
        judged = {"order": None, "limit": None, "index": None, "kind": NO_VERDICT}
        judged |= asdict(self.verdict) if self.verdict else {}
        plain = {"quantity": self.quantity, "unit": self.unit, "factors": self.factors, "numbers": self.numbers}
        plain |= {"estimates": self.estimates} if self.estimates else {}
        return {**plain, "order_of_theory": self.theory, **judged, "interval": self.interval, "verdict": self.text}
