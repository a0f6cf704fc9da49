"""Decorators for loops over cells and fields.

Numba compiles each loop at its first call and caches it on disk.
"""

import logging
from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit
from numba.core.caching import FunctionCache

log = logging.getLogger(__name__)
Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(kernel: Kernel) -> Kernel:
    """Return a function that is compiled at its first call.

    The compiled function is cached on disk if a folder can be written.
    """
    try:
        return sound(njit(cache=True, error_model="numpy")(kernel))
    except RuntimeError:  # no folder for the cache can be written
        return njit(error_model="numpy")(kernel)


class SoundCache(FunctionCache):  # type: ignore[misc]
    """Numba's cache of a compiled function on disk.

    Damaged files are deleted, and the function is compiled again.

    A killed run or a full disk can leave damaged files. Every later run would then end with an
    error of pickle.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the function compiled for a signature, or None if it must be compiled."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # pickle can raise any error on damaged bytes
            log.warning("compiled loops in %s are damaged (%s); they are compiled again", self.cache_path, error)
            self.flush()
            return None


def sound(dispatcher: Any) -> Any:
    """Return the function with a cache that tolerates damaged files.

    Without Numba the function is unchanged.
    """
    if hasattr(dispatcher, "_cache"):
        dispatcher._cache = SoundCache(dispatcher.py_func)
    return dispatcher
