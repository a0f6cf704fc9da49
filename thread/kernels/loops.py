"""How the loops are compiled: when an outermost one is first called, which is kept on disk with all that it calls.

A function is compiled once for each constant integer that it is called with, unless that is a number of NumPy's; and
what is done with a part of an array brings in a hundred functions of Numba's, so the loops go from number to number.
Sums stay in their order: where the compiler may choose it, it chooses by where arrays happen to lie, and a resumed run
does not go on to the same bits.
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
entered: Any = None  # the part that an entry calls: each entry has its own
PART = {"pipeline_class": PartCompiler, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def numbers(*constants: int) -> tuple[int, ...]:
    """Return integers that a function called with them is not compiled anew for."""
    return tuple(np.array(constants))


def loop(kernel: Kernel) -> Kernel:
    """Return a function that is compiled into the loops that call it. It makes no array, returns none, and calls none
    that does: so nobody counts who refers to its arrays, of which it is given some dozens."""
    return njit(error_model="numpy", _nrt=False, **PART)(kernel)


def owning(kernel: Kernel) -> Kernel:
    """Return likewise a function that makes arrays, or calls one that returns them."""
    return njit(error_model="numpy", _nrt=True, **PART)(kernel)


def outermost(kernel: Kernel) -> Kernel:
    """Return a compiled function that Python calls, kept on disk where one may write; it makes no arrays either."""
    options = {"error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True, "pipeline_class": WholeCompiler}
    try:
        whole: Any = njit(cache=True, **options)(kernel)
    except RuntimeError:  # no folder for the cache can be written
        return njit(**options)(kernel)
    if hasattr(whole, "_cache"):  # not where Numba is switched off
        whole._cache = SoundCache(whole.py_func)
    return whole


def entry(part: Kernel) -> Kernel:
    """Return a part as Python calls it, kept on disk for the kernels as they are (`files_of`).

    Numba keeps a function on disk by its name, its code and the values that it takes from the function around it, here
    a digest: by itself Numba would not see that a function which the part calls has changed. The part stands among
    the global names, since no two processes would find the same one in a closure.
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
    """Return the kernels of the thread, and those of the room "kernels" that the file of a `module` stands in."""
    here = Path(__file__).parent
    rooms = [here, *(folder for folder in Path(module).parents if folder.name == here.name and folder != here)]
    return [path for room in rooms for path in sorted(room.rglob("*.py"))]


def sources(module: str) -> int:
    """Return a digest of the kernels that a module may call (`files_of`), not zero."""
    digest = sha256()
    for path in files_of(module):
        digest.update(path.read_bytes())
    return 1 + int.from_bytes(digest.digest()[:7])
