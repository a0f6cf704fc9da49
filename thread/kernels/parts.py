"""Two kinds of compiled functions: parts, which are only compiled into others, and wholes.

By default Numba optimises every function together with all functions that it calls, and makes
machine code of it. This work is repeated at each level of calls. A part is only written down as
intermediate code. A whole is linked from all its parts, including parts of parts, and is optimised
once. `pipeline_class` is Numba's interface for this ("Notes on Custom Pipelines" in its manual);
the methods belong to `numba.core.codegen.JITCodeLibrary`. Only wholes and other parts can call a
part.
"""

import logging
from typing import Any

from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

log = logging.getLogger(__name__)


class PartLibrary(JITCodeLibrary):  # type: ignore[misc]
    """The intermediate code of a part, which is not loaded into memory."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        """Finish the code without optimising it."""
        self._finalize_dynamic_globals()
        self._finalized = True

    @property
    def codegen(self) -> "PartLibrary":
        """The object on which Numba calls `set_env`."""
        return self

    def set_env(self, name: str, environment: object) -> None:
        """Do nothing: an environment would need an address in memory."""


class WholeLibrary(JITCodeLibrary):  # type: ignore[misc]
    """The code of a function with all of its parts."""

    _linking_libraries: list[Any]

    def finalize(self) -> None:
        """Link all parts, each once, optimise them together, and load them into memory."""
        self._linking_libraries = linked(self._linking_libraries)
        super().finalize()


def linked(libraries: list[Any]) -> list[Any]:
    """Return the libraries and all libraries that their parts call, each once."""
    found = dict.fromkeys(libraries)
    waiting = list(found)
    while waiting:
        library = waiting.pop()
        if isinstance(library, PartLibrary):
            new = [called for called in dict.fromkeys(library._linking_libraries) if called not in found]
            found |= dict.fromkeys(new)
            waiting += new
    return list(found)


class PartCompiler(Compiler):  # type: ignore[misc]
    """Numba's compiler of a part."""

    def define_pipelines(self) -> Any:
        """Return Numba's standard passes, which write into the library of a part."""
        self.state.library = PartLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        return super().define_pipelines()


class WholeCompiler(Compiler):  # type: ignore[misc]
    """Numba's compiler of a whole, which can be cached on disk."""

    def define_pipelines(self) -> Any:
        """Return Numba's standard passes, which write into the library of a whole."""
        self.state.library = WholeLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        self.state.library.enable_object_caching()
        return super().define_pipelines()


class SoundCache(FunctionCache):  # type: ignore[misc]
    """Numba's cache of a compiled function on disk; damaged files are deleted and the function is
    compiled again.

    A killed run or a full disk can leave damaged files. `tissue.loops` has the same class, because
    neither package imports the other.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the function compiled for a signature, or None if it must be compiled."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # pickle can raise any error on damaged bytes
            log.warning("compiled kernels in %s are torn (%s); they are compiled anew", self.cache_path, error)
            self.flush()
            return None
