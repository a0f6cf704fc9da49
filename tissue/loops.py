"""Decorators for loops over cells and fields: Numba compiles each at its first call and caches it on disk."""

import logging
from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit
from numba.core.caching import FunctionCache

log = logging.getLogger(__name__)
Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(kernel: Kernel) -> Kernel:
    """Return a function whose loops are compiled when it is first called, and kept on disk where one may write."""
    try:
        return sound(njit(cache=True, error_model="numpy")(kernel))
    except RuntimeError:  # no folder for the cache can be written
        return njit(error_model="numpy")(kernel)


class SoundCache(FunctionCache):  # type: ignore[misc]
    """Numba's files of a compiled function, which are emptied where they are torn: it is compiled anew then. A run that
    is killed, or a full disk, may leave them so, and Numba would end every later run in an error of pickle."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the function compiled for a signature, None if it is to be compiled."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # pickle raises whatever the bytes lead to
            log.warning("compiled loops in %s are damaged (%s); they are compiled again", self.cache_path, error)
            self.flush()
            return None


def sound(dispatcher: Any) -> Any:
    """Return a function that Numba keeps on disk with files that may be torn; where Numba is switched off, as it is."""
    if hasattr(dispatcher, "_cache"):
        dispatcher._cache = SoundCache(dispatcher.py_func)
    return dispatcher
