"""Functions that Numba compiles as parts of others alone, and the others, of which each is a whole.

By itself Numba optimises every function with all that it calls and makes machine code of it, once more at each level of
calls. Of a part nothing is done but to write it down: a whole is linked of all its parts, those of parts too, and
optimised at once. `pipeline_class` is Numba's own door for this ("Notes on Custom Pipelines" in its manual), the
methods are those of `numba.core.codegen.JITCodeLibrary`. A part can be called by a whole and by parts alone.
"""

import logging
from typing import Any

from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

log = logging.getLogger(__name__)


class PartLibrary(JITCodeLibrary):  # type: ignore[misc]
    """The code of a part as it was written, which has no place in memory."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        """Leave the code as it is."""
        self._finalize_dynamic_globals()
        self._finalized = True

    @property
    def codegen(self) -> "PartLibrary":
        """What Numba asks to `set_env`."""
        return self

    def set_env(self, name: str, environment: object) -> None:
        """Set no environment: it would be a place in memory."""


class WholeLibrary(JITCodeLibrary):  # type: ignore[misc]
    """The code of a function with all of its parts."""

    _linking_libraries: list[Any]

    def finalize(self) -> None:
        """Link all parts, each once, optimise them together, and give them their place in memory."""
        self._linking_libraries = linked(self._linking_libraries)
        super().finalize()


def linked(libraries: list[Any]) -> list[Any]:
    """Return libraries with those that the parts among them call, each once."""
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
        """Return Numba's own passes, which write into the library of a part."""
        self.state.library = PartLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        return super().define_pipelines()


class WholeCompiler(Compiler):  # type: ignore[misc]
    """Numba's compiler of a whole, which may be kept on disk."""

    def define_pipelines(self) -> Any:
        """Return Numba's own passes, which write into the library of a whole."""
        self.state.library = WholeLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        self.state.library.enable_object_caching()
        return super().define_pipelines()


class SoundCache(FunctionCache):  # type: ignore[misc]
    """Numba's files of a compiled function, discarded where they are torn: it is compiled anew then. A run that is
    killed, or a full disk, may leave them so. `tissue.loops` has the same, since neither package imports the other."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the function compiled for a signature, or None if it has to be compiled."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # pickle raises whatever the bytes lead to
            log.warning("compiled kernels in %s are torn (%s); they are compiled anew", self.cache_path, error)
            self.flush()
            return None
