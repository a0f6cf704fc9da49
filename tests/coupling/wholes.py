"""Kernels that a test calls by themselves."""

from typing import Any

from numba import njit

from thread.kernels.parts import WholeCompiler


def whole(function: Any) -> Any:
    """A function that calls parts of the kernels, compiled in each process so that Python can call it."""
    return njit(error_model="numpy", pipeline_class=WholeCompiler)(function)
