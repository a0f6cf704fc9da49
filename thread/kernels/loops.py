"""How the loops are compiled: when an outermost one is first called, which is kept on disk with all that it calls.

A function is compiled once for each constant integer that it is called with, unless that is a number of NumPy's; and
what is done with a part of an array brings in a hundred functions of Numba's, so the loops go from number to number.
Sums stay in their order: where the compiler may choose it, it chooses by where arrays happen to lie, and a resumed run
does not go on to the same bits.
"""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

import numpy as np
from numba import njit

from thread.kernels.parts import PartCompiler, WholeCompiler

Kernel = TypeVar("Kernel", bound=Callable[..., object])
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
        return njit(cache=True, **options)(kernel)
    except RuntimeError:  # no folder for the cache can be written
        return njit(**options)(kernel)


def files_of(*modules: str) -> list[Path]:
    """Return the modules of this folder and of the folders that the files `modules` stand in."""
    folders = dict.fromkeys(Path(module).parent for module in (__file__, *modules))
    return [path for folder in folders for path in sorted(folder.glob("*.py"))]


def sources(*modules: str) -> int:
    """Return a digest of the modules of `files_of`, not zero.

    Numba keeps a function on disk by the text of its own module, and would not see that one it calls has changed. Of a
    function made within another what it takes from there counts too, so it takes this.
    """
    digest = sha256()
    for path in files_of(*modules):
        digest.update(path.read_bytes())
    return 1 + int.from_bytes(digest.digest()[:7])
