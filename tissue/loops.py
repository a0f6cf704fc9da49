"""How the loops over cells and over fields are compiled: by Numba, when each is first called, and kept on disk."""

from collections.abc import Callable
from typing import TypeVar

from numba import njit

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(kernel: Kernel) -> Kernel:
    """Return a function whose loops are compiled when it is first called, and kept on disk where one may write."""
    try:
        return njit(cache=True, error_model="numpy")(kernel)
    except RuntimeError:  # no folder for the cache can be written
        return njit(error_model="numpy")(kernel)
