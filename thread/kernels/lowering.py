"""Short code for the arrays and variables of kernels.

Numba writes about fifty instructions to read an entry of an array, and some at the end of each
variable. LLVM removes most of them, which takes longer than the rest of its work. `Lower` is the
class of Numba that writes the code of a function for LLVM.
"""

from typing import Any

from numba import types
from numba.core import cgutils
from numba.core.compiler_machinery import register_pass
from numba.core.imputils import impl_ret_borrowed
from numba.core.ir_utils import get_definition, guard
from numba.core.lowering import Lower
from numba.core.typed_passes import BaseNativeLowering
from numba.np.arrayobj import load_item, store_item


class ShortLower(Lower):  # type: ignore[misc]
    """Numba's lowering, with shorter code for entries of arrays and for the end of variables."""

    def lower_expr(self, resty: Any, expr: Any) -> Any:
        """Return the value of an expression."""
        if expr.op not in ("getiter", "iternext", "pair_first", "pair_second"):
            return super().lower_expr(resty, expr)
        kind, value = self.typeof(expr.value.name), self.loadvar(expr.value.name)
        if isinstance(kind, types.Pair):
            part = self.builder.extract_value(value, int(expr.op == "pair_second"))
            self.incref(resty, part)
            return part
        if isinstance(kind, types.RangeIteratorType):
            return self.next_of_range(kind, value, resty)
        if isinstance(kind, types.RangeType) and self.counts_by_one(expr.value):
            return self.begin_range(kind, value)
        return super().lower_expr(resty, expr)

    def counts_by_one(self, range_: Any) -> bool:
        """Return whether a variable is made by `range` without a step."""
        made = guard(get_definition, self.func_ir, range_)
        if getattr(made, "op", "") != "call" or made.vararg is not None:
            return False
        called = guard(get_definition, self.func_ir, made.func)
        return getattr(called, "value", None) is range and len(made.args) < 3 and not made.kws

    def begin_range(self, kind: Any, value: Any) -> Any:
        """Return the state of a loop over a range with steps of one: the next number, and the count left."""
        builder, model = self.builder, self.context.data_model_manager[kind.iterator_type]
        start, stop, step = cgutils.unpack_tuple(builder, value)
        left = cgutils.alloca_once_value(builder, builder.sub(stop, start))
        state = self.context.get_constant_undef(kind.iterator_type)
        fields = {"iter": cgutils.alloca_once_value(builder, start), "stop": stop, "step": step, "count": left}
        for name, each in fields.items():
            state = model.set(builder, state, each, name)
        return state

    def next_of_range(self, kind: Any, state: Any, pair: Any) -> Any:
        """Return the next number of a range, and whether there is one."""
        builder, model = self.builder, self.context.data_model_manager[kind]
        at, left_at = model.get(builder, state, "iter"), model.get(builder, state, "count")
        number, left = builder.load(at), builder.load(left_at)
        builder.store(builder.add(number, model.get(builder, state, "step")), at)
        builder.store(builder.sub(left, left.type(1), flags=["nsw"]), left_at)
        found = builder.insert_value(self.context.get_constant_undef(pair), number, 0)
        return builder.insert_value(found, builder.icmp_signed(">", left, left.type(0)), 1)

    def delvar(self, name: str) -> None:
        """End a variable; only arrays whose references are counted need code for this."""
        if self.context.enable_nrt and self.context.data_model_manager[self.typeof(name)].contains_nrt_meminfo():
            super().delvar(name)

    def lower_getitem(self, resty: Any, expr: Any, value: Any, index: Any, signature: Any) -> Any:
        """Return an entry of an array, or its part at the first indices."""
        kind, indices = self.typeof(value.name), self.indices_of(value.name, index.name)
        if not indices:
            return super().lower_getitem(resty, expr, value, index, signature)
        array = self.loadvar(value.name)
        at = self.address_of(kind, array, indices)
        if len(indices) < kind.ndim:
            return impl_ret_borrowed(self.context, self.builder, resty, self.part(kind, array, at, resty))
        return self.context.cast(self.builder, load_item(self.context, self.builder, kind, at), kind.dtype, resty)

    def lower_setitem(self, target_var: Any, index_var: Any, value_var: Any, signature: Any) -> Any:
        """Write an entry of an array."""
        kind, indices = self.typeof(target_var.name), self.indices_of(target_var.name, index_var.name)
        if not indices or len(indices) < kind.ndim:
            return super().lower_setitem(target_var, index_var, value_var, signature)
        at = self.address_of(kind, self.loadvar(target_var.name), indices)
        value = self.context.cast(self.builder, self.loadvar(value_var.name), self.typeof(value_var.name), kind.dtype)
        return store_item(self.context, self.builder, kind, value, at)

    def indices_of(self, array: str, index: str) -> list[Any]:
        """Return the indices of an array; empty for slices, and for values that are no arrays."""
        kind, value = self.typeof(index), self.loadvar(index)
        kinds = tuple(kind) if isinstance(kind, types.BaseTuple) else (kind,)
        if not isinstance(self.typeof(array), types.Array) or not all(isinstance(x, types.Integer) for x in kinds):
            return []
        values = cgutils.unpack_tuple(self.builder, value) if isinstance(kind, types.BaseTuple) else [value]
        return [self.context.cast(self.builder, x, of, types.intp) for x, of in zip(values, kinds, strict=True)]

    def address_of(self, kind: Any, array: Any, indices: list[Any]) -> Any:
        """Return the address of an entry of an array, or of its part at the first indices."""
        builder, model = self.builder, self.context.data_model_manager[kind]
        shape, data = model.get(builder, array, "shape"), model.get(builder, array, "data")
        counts = [builder.extract_value(shape, axis) for axis in range(kind.ndim)]
        indices = [self.from_start(*each) for each in zip(indices, counts, strict=False)]
        if kind.layout == "C":
            offset = indices[0]
            for axis in range(1, kind.ndim):
                offset = builder.mul(offset, counts[axis])
                offset = builder.add(offset, indices[axis]) if axis < len(indices) else offset
            return builder.gep(data, [offset])
        steps = model.get(builder, array, "strides")
        for axis, index in enumerate(indices):
            data = cgutils.pointer_add(builder, data, builder.mul(index, builder.extract_value(steps, axis)))
        return data

    def from_start(self, index: Any, count: Any) -> Any:
        """Return an index that counts from the start; a negative one counts from the end."""
        negative = self.builder.icmp_signed("<", index, index.type(0))
        return self.builder.select(negative, self.builder.add(index, count), index)

    def part(self, kind: Any, array: Any, at: Any, result: Any) -> Any:
        """Return an array with the last axes of another, whose data begin at an address."""
        builder, old, new = self.builder, self.context.data_model_manager[kind], self.context.data_model_manager[result]
        part, nitems = self.context.get_constant_undef(result), self.context.get_constant(types.intp, 1)
        for name in ("shape", "strides"):
            axes = cgutils.unpack_tuple(builder, old.get(builder, array, name))[-result.ndim :]
            part = new.set(builder, part, cgutils.pack_array(builder, axes), name)
            if name == "shape":
                for count in axes:
                    nitems = builder.mul(nitems, count)
        for name in ("itemsize", "meminfo", "parent"):
            part = new.set(builder, part, old.get(builder, array, name), name)
        return new.set(builder, new.set(builder, part, nitems, "nitems"), at, "data")


@register_pass(mutates_CFG=True, analysis_only=False)
class ShortLowering(BaseNativeLowering):  # type: ignore[misc]
    """The pass of Numba's compiler that calls `ShortLower`."""

    _name = "short_lowering"
    lowering_class = ShortLower
