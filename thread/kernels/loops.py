"""Compilation of the loops: Numba compiles an outermost loop at its first call and caches it with
all its parts.

A function is compiled again for each constant integer argument, except for integers of NumPy.
Slices of arrays would bring in a hundred functions of Numba, so that the loops use single numbers.
Sums keep their order: if the compiler could reorder a sum, the order would depend on the addresses
of the arrays, and a resumed run would not give the same bits.
"""

import sys
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar

import numpy as np
from numba import njit

from thread.kernels.parts import PartCompiler, SoundCache, WholeCompiler

Kernel = TypeVar("Kernel", bound=Callable[..., object])
entered: Any = None  # the part that an entry calls; it differs in each entry
PART = {"pipeline_class": PartCompiler, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def numbers(*constants: int) -> tuple[int, ...]:
    """Return integers of NumPy, for which a function is not compiled again."""
    return tuple(np.array(constants))


def loop(kernel: Kernel) -> Kernel:
    """Return a function that is compiled into the loops that call it.

    The function must not allocate arrays or call a function that returns arrays. Numba then does not
    count references to its arrays.
    """
    return njit(error_model="numpy", _nrt=False, **PART)(kernel)


def owning(kernel: Kernel) -> Kernel:
    """Return a function that is compiled as in `loop` and that can allocate arrays or call a
    function that returns arrays. It should have few arrays as arguments.
    """
    return njit(error_model="numpy", _nrt=True, **PART)(kernel)


def outermost(kernel: Kernel) -> Kernel:
    """Return a compiled function that Python calls, cached on disk if a folder can be written; it
    allocates no arrays.
    """
    options = {"error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True, "pipeline_class": WholeCompiler}
    try:
        whole: Any = njit(cache=True, **options)(kernel)
    except RuntimeError:  # no folder for the cache can be written
        return njit(**options)(kernel)
    if hasattr(whole, "_cache"):  # absent if Numba is disabled
        whole._cache = SoundCache(whole.py_func)
    return whole


def entry(part: Kernel) -> Kernel:
    """Return a part in a form that Python calls, cached on disk for the present text of the kernels
    (`files_of`).

    Numba's cache uses as key the name of a function, its code and the values in its closure, here a
    digest. Without the digest Numba would not notice a change in a function that the part calls.
    The part is a global name, because a part in a closure would have a different key in every
    process.
    """
    digest = sources(str(sys.modules[part.__module__].__file__))

    def call(*given: Any) -> Any:
        assert digest
        return entered(*given)

    names = {**call.__globals__, "entered": part}
    whole: Any = FunctionType(call.__code__, names, part.__name__, None, call.__closure__)
    whole.__qualname__ = f"{part.__module__}.{part.__qualname__}"
    return outermost(whole)


def files_of(module: str) -> list[Path]:
    """Return the kernel files of the thread, and the kernel files in the folder "kernels" that
    contains a `module`.
    """
    here = Path(__file__).parent
    rooms = [here, *(folder for folder in Path(module).parents if folder.name == here.name and folder != here)]
    return [path for room in rooms for path in sorted(room.rglob("*.py"))]


def sources(module: str) -> int:
    """Return a non-zero digest of the kernels that a module can call (`files_of`)."""
    digest = sha256()
    for path in files_of(module):
        digest.update(path.read_bytes())
    return 1 + int.from_bytes(digest.digest()[:7])
