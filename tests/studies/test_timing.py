"""The time of a step."""

import pytest
from numba.core import event

from studies.simulation import simulation


def test_what_is_compiled_counts_in_no_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: of 33 s by the clock Numba compiles for 30, one function within the other."""
    now = 0.0

    def clock() -> float:
        return now

    def step() -> str:
        nonlocal now
        now += 1.0
        with event.trigger_event("numba:compile"):
            now += 20.0
            with event.trigger_event("numba:compile"):
                now += 10.0
        now += 2.0
        return "made"

    monkeypatch.setattr(simulation, "perf_counter", clock)
    monkeypatch.setattr(event, "timer", clock)
    assert simulation.timed(step, compiles=True) == ("made", 3.0)
    assert simulation.timed(step, compiles=False) == ("made", 33.0)
