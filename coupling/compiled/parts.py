"""Functions that Numba compiles as parts of others alone.

By itself Numba optimises every function with all that it calls and makes machine code of it, once more at each level of
calls. Of a part neither is done: the outermost function that calls it is optimised with all of its parts at once.
`pipeline_class` is Numba's own door for this ("Notes on Custom Pipelines" in its manual); the methods are those of
`numba.core.codegen.JITCodeLibrary`.
"""

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class PartLibrary(JITCodeLibrary):  # type: ignore[misc]
    """The code of a part as it was written, which has no place in memory."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        """Leave the code as it is."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    @property
    def codegen(self) -> "PartLibrary":
        """What Numba asks to `set_env`."""
        return self

    def set_env(self, name: str, environment: object) -> None:
        """Set no environment: it would be a place in memory."""


class PartCompiler(Compiler):  # type: ignore[misc]
    """Numba's compiler of a part."""

    def define_pipelines(self) -> Any:
        """Return Numba's own passes, which write into the library of a part."""
        self.state.library = PartLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        return super().define_pipelines()
