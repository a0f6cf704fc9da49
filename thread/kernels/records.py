"""Records: named tuples that Python hands to compiled functions, which hand on only their address.

By default, Numba hands on every number of every array in a named tuple as an argument of its own.
These arguments were half of the code of the kernels. A compiled function can read the fields of a
record, and it can write to the arrays in it. A tuple made in a kernel is no record; the functions
that it is handed to are compiled again for it.
"""

from hashlib import sha256
from itertools import accumulate
from typing import Any, TypeVar

from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

Class = TypeVar("Class", bound=type[Any])
WORD = 8  # bytes; no number is larger


class Record(types.Type):  # type: ignore[misc]
    """The type of the instances of a named tuple's class, whose fields have these `kinds`."""

    def __init__(self, made: Any, kinds: tuple[Any, ...]) -> None:
        self.fields: tuple[str, ...] = made._fields
        self.kinds = kinds
        digest = sha256(repr((made.__module__, self.fields, kinds)).encode()).hexdigest()
        super().__init__(name=f"{made.__name__}_{digest[:16]}")  # it is part of the name of each function


def record(made: Class) -> Class:
    """Make records of the instances of a named tuple's class."""
    typeof_impl.register(made, lambda value, c: Record(made, tuple(typeof_impl(each, c) for each in value)))
    return made


@register_model(Record)
class RecordModel(models.PrimitiveModel):  # type: ignore[misc]
    """The address of the fields."""

    def __init__(self, manager: Any, kind: Record) -> None:
        super().__init__(manager, kind, cgutils.voidptr_t)


@infer_getattr
class RecordAttribute(AttributeTemplate):  # type: ignore[misc]
    """The types of the fields."""

    key = Record

    def generic_resolve(self, kind: Record, name: str) -> Any:
        """Return the type of a field; None if there is none of this name."""
        return kind.kinds[kind.fields.index(name)] if name in kind.fields else None


def words(parts: Any) -> int:
    """Return the number of words of a value, from the parts in which Numba hands it on."""
    return sum(map(words, parts)) if isinstance(parts, tuple) else 1


def offsets(context: Any, kind: Record) -> list[int]:
    """Return the places of the fields from the address on, and the size of all [words]."""
    sizes = (words(context.data_model_manager[each].get_argument_type()) for each in kind.kinds)
    return list(accumulate(sizes, initial=0))


def field_address(context: Any, builder: Any, kind: Record, address: Any, i: int) -> Any:
    """Return the address of field i."""
    at = builder.gep(address, [cgutils.intp_t(WORD * offsets(context, kind)[i])], inbounds=True)
    return builder.bitcast(at, context.get_value_type(kind.kinds[i]).as_pointer())


@lower_getattr_generic(Record)  # type: ignore[untyped-decorator]
def load_field(context: Any, builder: Any, kind: Record, address: Any, name: str) -> Any:
    """Load a field; a write to an array does not change it, so that it is loaded once."""
    field = builder.load(field_address(context, builder, kind, address, kind.fields.index(name)))
    field.set_metadata("invariant.load", builder.module.add_metadata([]))
    return field


@unbox(Record)  # type: ignore[untyped-decorator]
def unbox_record(kind: Record, value: Any, c: Any) -> Any:
    """Write the fields of a named tuple into memory of the calling function.

    The called function must not count references (`thread.kernels.loops.outermost`). Numba never
    merges it with the calling one, for which a field is not constant.
    """
    *_, words = offsets(c.context, kind)
    address = c.builder.bitcast(cgutils.alloca_once(c.builder, cgutils.intp_t, words), cgutils.voidptr_t)
    wrong = cgutils.false_bit
    for i, each in enumerate(kind.kinds):
        item, at = c.pyapi.tuple_getitem(value, i), field_address(c.context, c.builder, kind, address, i)
        if isinstance(each, types.Array):
            missed = c.pyapi.numba_array_adaptor(item, c.builder.bitcast(at, cgutils.voidptr_t))
            wrong = c.builder.or_(wrong, cgutils.is_not_null(c.builder, missed))
        else:
            native = c.unbox(each, item)
            c.builder.store(native.value, at)
            wrong = c.builder.or_(wrong, native.is_error)
    return NativeValue(address, is_error=wrong)
