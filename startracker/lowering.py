"""Shortcuts in numba's translation of arrays and loops to instructions of LLVM.

numba writes an array into memory at each use, reads all its dimensions and strides, and multiplies by one and adds
zero; LLVM removes this again. Here the instructions are left out, which halves their number. The optimised code is the
same (``tests/unit/test_compiler.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, reduce
from typing import Any

from numba.core import cgutils, types

Shortcut = tuple[Any, str, Any]
"""Class or module, name of a method or function, and that in its stead."""


def _structures_as_values() -> list[Shortcut]:
    """Structures that are given as a value are read as a value, and written to memory at the first change only."""
    proxy = cgutils._StructProxy
    begin, item, value, attribute = proxy.__init__, proxy.__getitem__, proxy._getvalue, proxy.__getattr__

    def __init__(self: Any, context: Any, builder: Any, value: Any = None, ref: Any = None) -> None:
        model = context.data_model_manager[self._fe_type]
        if value is None or ref is not None or not isinstance(self, cgutils.ValueStructProxy) or self._has_references:
            begin(self, context, builder, value, ref)
            return
        self._context, self._builder, self._datamodel = context, builder, model
        self._be_type = self._get_be_type(model)
        assert value.type == self._be_type, (value.type, self._be_type)
        self._given, self._given_at = value, _position(builder)

    def __getitem__(self: Any, index: int) -> Any:
        given = self.__dict__.get("_given")
        return item(self, index) if given is None else self._builder.extract_value(given, index)

    def _getvalue(self: Any) -> Any:
        given = self.__dict__.get("_given")
        return value(self) if given is None else given

    def __getattr__(self: Any, name: str) -> Any:
        if name in ("_value", "_outer_ref") and "_given" in self.__dict__:
            return _stored(self)
        return attribute(self, name)

    return [
        (proxy, "__init__", __init__),
        (proxy, "__getitem__", __getitem__),
        (proxy, "_getvalue", _getvalue),
        (proxy, "__getattr__", __getattr__),
        (proxy, "_has_references", False),
    ]


def _stored(structure: Any) -> Any:
    """Write a structure to memory where it was given, so that all later blocks can read it."""
    builder, given_at = structure._builder, structure._given_at
    here = _position(builder)
    builder.position_at_start(builder.function.entry_basic_block)
    memory = builder.alloca(structure._be_type)
    _go_to(builder, given_at)
    builder.store(structure._given, memory)
    _go_to(builder, here)
    structure._value = structure._outer_ref = memory
    del structure._given
    return memory


def _position(builder: Any) -> tuple[Any, Any]:
    """Block and instruction after which the next one is written, which stays valid if others are written elsewhere."""
    return builder.block, builder.block.instructions[builder._anchor - 1] if builder._anchor else None


def _go_to(builder: Any, position: tuple[Any, Any]) -> None:
    block, last = position
    if last is None:
        builder.position_at_start(block)
    else:
        builder.position_after(last)


def _arrays_as_values() -> list[Shortcut]:
    """Structures of arrays, with a class per type instead of one per use."""
    from numba.np import arrayobj

    make = arrayobj.make_array

    @cache
    def of_array(array: types.Array) -> Any:
        structure = make(array)
        if type(array) is not types.Array:
            structure._has_references = True  # it may be another array in memory
            return structure
        memory_shape = structure.shape

        def shape(self: Any) -> Any:
            given = self.__dict__.get("_given")
            if given is None:
                return memory_shape.fget(self)
            return self._builder.extract_value(given, self._datamodel.get_field_position("shape"))

        structure.shape = property(shape)
        structure._make_refs = cgutils._StructProxy._make_refs
        return structure

    return [(arrayobj, "make_array", of_array)]


def _plain_addresses() -> list[Shortcut]:
    """Address of an array's element, without factors of one, terms of zero, and dimensions that are not needed."""

    def get_item_pointer(
        context: Any, builder: Any, aryty: Any, ary: Any, inds: Any, wraparound: bool = False, boundscheck: bool = False
    ) -> Any:
        shape = cgutils.unpack_tuple(builder, ary.shape, count=aryty.ndim)
        strides = () if aryty.layout in "CF" else cgutils.unpack_tuple(builder, ary.strides, count=aryty.ndim)
        given = {"data": ary.data, "shape": shape, "strides": strides, "layout": aryty.layout, "inds": inds}
        return get_item_pointer2(context, builder, **given, wraparound=wraparound, boundscheck=boundscheck)

    whole = cgutils.get_item_pointer2

    def get_item_pointer2(
        context: Any,
        builder: Any,
        data: Any,
        shape: Sequence[Any],
        strides: Sequence[Any],
        layout: str,
        inds: Sequence[Any],
        wraparound: bool = False,
        boundscheck: bool = False,
    ) -> Any:
        if layout != "C" or wraparound or boundscheck or not inds:
            return whole(context, builder, data, shape, strides, layout, inds, wraparound, boundscheck)
        steps = [reduce(builder.mul, shape[axis:]) for axis in range(1, len(shape))]
        terms = [builder.mul(index, step) for index, step in zip(inds, steps, strict=False)]
        return builder.gep(data, [reduce(builder.add, [*terms, *inds[len(steps) :]])])

    return [(cgutils, "get_item_pointer", get_item_pointer), (cgutils, "get_item_pointer2", get_item_pointer2)]


def _holds_references(context: Any, kind: types.Type) -> bool:
    return bool(context.data_model_manager[kind].contains_nrt_meminfo())


def _counted_parts_only() -> list[Shortcut]:
    """Counts of references: only variables, and parts of them, that hold references are read."""
    from numba.core.lowering import Lower
    from numba.core.runtime.context import NRTContext

    delete, store = Lower.delvar, Lower.storevar
    holds_references = cache(_holds_references)

    def get_meminfos(self: Any, builder: Any, kind: Any, value: Any) -> list[Any]:
        model = self._context.data_model_manager[kind]
        found = [(kind, model.get_nrt_meminfo(builder, value))] if model.has_nrt_meminfo() else []
        for part, read in model.traverse(builder):
            if holds_references(self._context, part):
                found += get_meminfos(self, builder, part, read(value))
        return found

    def delvar(self: Any, name: str) -> None:
        if holds_references(self.context, self.typeof(name)):
            delete(self, name)
        elif name not in self._blk_local_varmap:
            self._singly_assigned_vars.discard(name)
            self._alloca_var(name, self.typeof(name))

    def storevar(self: Any, value: Any, name: str, argidx: int | None = None) -> None:
        if name in self._singly_assigned_vars or holds_references(self.context, self.typeof(name)):
            store(self, value, name, argidx)
            return
        self._alloca_var(name, self.typeof(name))
        self.builder.store(value, self.getvar(name))

    return [(NRTContext, "get_meminfos", get_meminfos), (Lower, "delvar", delvar), (Lower, "storevar", storevar)]


_RANGES = types.range_iter32_type, types.range_iter64_type, types.unsigned_range_iter64_type


def _steps_of_one() -> list[Shortcut]:
    """Start of a loop over a range with a step of one, whose number of steps is a difference."""
    from numba.core import ir
    from numba.core.lowering import Lower

    translate = Lower.lower_expr

    def lower_expr(self: Any, result: Any, expression: Any) -> Any:
        if expression.op != "getiter" or result not in _RANGES:
            return translate(self, result, expression)
        calls = self.func_ir._definitions.get(expression.value.name, ())
        if len(calls) != 1 or not isinstance(calls[0], ir.Expr) or calls[0].op != "call" or len(calls[0].args) > 2:
            return translate(self, result, expression)
        builder, given = self.builder, self.loadvar(expression.value.name)
        start, stop = builder.extract_value(given, 0), builder.extract_value(given, 1)
        zero, one = start.type(0), start.type(1)
        steps = builder.sub(stop, start)
        steps = builder.select(builder.icmp_signed(">", steps, zero), steps, zero)
        iterator = self.context.get_value_type(result)(None)
        for field, value in enumerate((_in_memory(builder, start), stop, one, _in_memory(builder, steps))):
            iterator = builder.insert_value(iterator, value, field)
        return iterator

    return [(Lower, "lower_expr", lower_expr)]


def _in_memory(builder: Any, value: Any) -> Any:
    """Address of a variable with this value."""
    memory = cgutils.alloca_once(builder, value.type)
    builder.store(value, memory)
    return memory


def lowering_shortcuts() -> list[Shortcut]:
    """Shortcuts of the translation to instructions."""
    return [
        *_structures_as_values(),
        *_arrays_as_values(),
        *_plain_addresses(),
        *_counted_parts_only(),
        *_steps_of_one(),
    ]
