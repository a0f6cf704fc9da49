"""Parts of the kernels that a test calls by themselves."""

from typing import Any

from numba import njit

from coupling.kernels.parts import WholeCompiler


def whole(part: Any) -> Any:
    """A function that Python calls, of a part that only kernels can call; compiled in each process."""

    def call(*given: Any) -> Any:
        return part(*given)

    return njit(error_model="numpy", pipeline_class=WholeCompiler)(call)
