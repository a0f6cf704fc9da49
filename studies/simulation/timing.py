"""The computing time of a step."""

from collections.abc import Callable
from time import perf_counter
from typing import TypeVar

Made = TypeVar("Made")


def timed(make: Callable[[], Made], compiles: bool) -> tuple[Made, float]:
    """Return the result of a function and its wall-clock time [s].

    The time is without compilation if the function `compiles` loops.
    """
    began = perf_counter()
    if not compiles:
        return make(), perf_counter() - began
    from numba.core.event import install_timer

    compiling: list[float] = []
    with install_timer("numba:compile", compiling.append):
        result = make()
    return result, perf_counter() - began - sum(compiling)
