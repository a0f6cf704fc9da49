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
from numba.core.compiler import CompilerBase
from numba.core.compiler_machinery import PassManager
from numba.core.typed_passes import (
    IRLegalization,
    NativeLowering,
    NoPythonBackend,
    NopythonTypeInference,
    PreLowerStripPhis,
)
from numba.core.untyped_passes import FixupArgs, GenericRewrites, IRProcessing, ReconstructSSA, TranslateByteCode

log = logging.getLogger(__name__)

PASSES = (
    TranslateByteCode,
    FixupArgs,
    IRProcessing,
    GenericRewrites,
    ReconstructSSA,
    NopythonTypeInference,
    PreLowerStripPhis,
    IRLegalization,
    NativeLowering,
    NoPythonBackend,
)


class KernelLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code that is optimised as a whole, and not function by function before."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout


class PartLibrary(KernelLibrary):
    """The intermediate code of a part, which is not loaded into memory."""

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


class WholeLibrary(KernelLibrary):
    """The code of a function with all of its parts."""

    _linking_libraries: list[Any]

    def _optimize_final_module(self) -> None:
        """Optimise once; Numba's first round is for counted references."""
        try:
            passes, builder = self._codegen._module_pass_manager()
        except TypeError:  # before 0.62 it returns no builder
            super()._optimize_final_module()
        else:
            passes.run(self._final_module, builder)

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


class KernelCompiler(CompilerBase):  # type: ignore[misc]
    """Numba's compiler without the passes for what no kernel contains, such as closures and array expressions."""

    library: type[KernelLibrary]

    def define_pipelines(self) -> Any:
        """Return the passes, which write into a library of the given class."""
        self.state.library = self.library(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        manager = PassManager("kernel")
        for each in PASSES:
            manager.add_pass(each)
        manager.finalize()
        return [manager]


class PartCompiler(KernelCompiler):
    """Numba's compiler of a part."""

    library = PartLibrary


class WholeCompiler(KernelCompiler):
    """Numba's compiler of a whole, which can be cached on disk."""

    library = WholeLibrary

    def define_pipelines(self) -> Any:
        """Return the passes, which write into a library that can be cached."""
        passes = super().define_pipelines()
        self.state.library.enable_object_caching()
        return passes


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
