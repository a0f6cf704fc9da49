"""Calls of a compiled function by its address: the code of the function is not compiled again into its caller."""

from collections.abc import Callable
from typing import Any

from numba import config, typeof
from numba.core import cgutils, types
from numba.extending import intrinsic


def address_of(function: Any, given: tuple[object, ...]) -> int:
    """Return the address of a function compiled for the types of the arguments `given`.

    The address is zero if Numba is disabled. A function that is cached on disk has another address
    in each process.
    """
    if config.DISABLE_JIT:
        return 0
    kinds = tuple(typeof(x) for x in given)
    function.compile(kinds)
    made = function.overloads[kinds]
    return int(made.library.get_pointer_to_function(made.fndesc.llvm_func_name))


def by_address(function: Any) -> Callable[[int, tuple[Any, ...]], Any]:
    """Return a function for loops that calls a compiled function by an address and a tuple of arguments.

    The address is the result of `address_of`.
    """
    if config.DISABLE_JIT:
        return lambda _, given: function(*given)

    @intrinsic  # type: ignore[untyped-decorator]
    def call(context: Any, address: Any, given: Any) -> Any:
        kinds = tuple(given)
        result = function.overloads[kinds].signature.return_type

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            convention = context.call_conv
            kind = convention.get_function_type(result, kinds)
            pointer = builder.inttoptr(values[0], kind.as_pointer())
            arguments = cgutils.unpack_tuple(builder, values[1])
            status, found = convention.call_function(builder, pointer, result, kinds, arguments)
            with cgutils.if_unlikely(builder, status.is_error):
                convention.return_status_propagate(builder, status)
            return found

        return result(types.intp, given), generate

    return call
