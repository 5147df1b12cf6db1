"""Shortcuts through the translation of typed statements to instructions of LLVM."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from numba.core import types
from numba.core.types.misc import MemInfoPointer

from startracker.compiler.replacing import Shortcut


def no_lock_events() -> Iterator[Shortcut]:
    """Lock around each call of LLVM, without the events from which its time can be measured."""
    from llvmlite.binding.ffi import _LLVMLock

    yield _LLVMLock, "__enter__", lambda self: self._lock.acquire() and None
    yield _LLVMLock, "__exit__", lambda self, *details: self._lock.release()


def new_declarations_only() -> Shortcut:
    """Refresh of numba's functions, which precedes each one's implementation, if there are new ones."""
    from numba.core.base import BaseContext

    refresh = BaseContext.refresh

    def declared(context: Any) -> int:
        return sum(
            len(getattr(registry, kind))
            for registry, loader in context._registries.items()
            for kind in loader.registry_items
        )

    def run(self: Any) -> None:
        count = declared(self) + declared(self.typing_context)
        if vars(self).get("declared_when_refreshed") != count:
            refresh(self)
            self.declared_when_refreshed = declared(self) + declared(self.typing_context)

    return BaseContext, "refresh", run


def _counted(models: Any, type_: Any) -> frozenset[type]:
    """Classes of a type and its members whose references are counted: of arrays, lists, text."""
    if id(type_) not in _counted_types:
        parts = models[type_].traverse_models()
        found = frozenset(type(part.fe_type) for part in parts if part.has_nrt_meminfo())
        _counted_types[id(type_)] = found, type_  # the latter keeps its id
    return _counted_types[id(type_)][0]


_counted_types: dict[int, tuple[frozenset[type], Any]] = {}


def counted_members_only() -> Shortcut:
    """Search of a value for arrays, without a look at members that contain none."""
    from numba.core.runtime.context import NRTContext

    def run(self: Any, builder: Any, type_: Any, value: Any) -> list[Any]:
        models = self._context.data_model_manager
        if not _counted(models, type_):
            return []
        model = models[type_]
        found = [(type_, model.get_nrt_meminfo(builder, value))] if model.has_nrt_meminfo() else []
        for member, get in model.traverse(builder):
            if _counted(models, member):
                found += run(self, builder, member, get(value))
        return found

    return NRTContext, "get_meminfos", run


def uncounted_variables() -> Iterator[Shortcut]:
    """Assignment and deletion of variables of which no reference is counted, without a look at the former value."""
    from numba.core.lowering import Lower

    store, delete = Lower.storevar, Lower.delvar

    def plain(self: Any, name: str) -> bool:
        return not self._disable_sroa_like_opt and not _counted(self.context.data_model_manager, self.typeof(name))

    def storevar(self: Any, value: Any, name: str, argidx: int | None = None) -> None:
        if argidx is None and name not in self._singly_assigned_vars and plain(self, name):
            self._alloca_var(name, self.typeof(name))
            self.builder.store(value, self.getvar(name))
        else:
            store(self, value, name, argidx)

    def delvar(self: Any, name: str) -> None:
        if not plain(self, name):
            delete(self, name)
        elif name not in self._blk_local_varmap:
            self._singly_assigned_vars.discard(name)  # is assigned in a later block

    yield Lower, "storevar", storevar
    yield Lower, "delvar", delvar


def elements_of_arrays() -> Shortcut:
    """Address of an array's element, without the shapes and strides of the views that other indices yield."""
    from numba.core.cgutils import get_item_pointer2, unpack_tuple
    from numba.np import arrayobj

    index_any: Callable[..., tuple[Any, list[Any], list[Any]]] = arrayobj.basic_indexing

    def run(
        context: Any, builder: Any, aryty: Any, ary: Any, index_types: Any, indices: Any, boundscheck: Any = None
    ) -> tuple[Any, list[Any], list[Any]]:
        if boundscheck or len(indices) < aryty.ndim or not all(isinstance(one, types.Integer) for one in index_types):
            return index_any(context, builder, aryty, ary, index_types, indices, boundscheck)
        shape = unpack_tuple(builder, ary.shape, aryty.ndim)
        strides = unpack_tuple(builder, ary.strides, aryty.ndim) if aryty.layout == "A" else ()
        from_start = [
            arrayobj.fix_integer_index(context, builder, type_, index, size)
            for type_, index, size in zip(index_types, indices, shape, strict=True)
        ]
        return get_item_pointer2(context, builder, ary.data, shape, strides, aryty.layout, from_start), [], []

    return arrayobj, "basic_indexing", run


def no_counts_of_arguments() -> Iterator[Shortcut]:
    """Translation of a kernel that neither makes nor returns an array, and has no lists or text, without counting the
    references, as its caller holds the arrays; and without the deletions of variables that end the counts."""
    from numba.core.errors import NumbaRuntimeError
    from numba.core.ir_utils import enforce_no_dels, enforce_no_phis
    from numba.core.postproc import PostProcessor
    from numba.core.typed_passes import BaseNativeLowering, IRLegalization

    delete: Callable[..., bool] = IRLegalization.run_pass
    translate: Callable[..., bool] = BaseNativeLowering.run_pass

    def legalise(self: Any, state: Any) -> bool:
        if _has_references(state):
            return delete(self, state)
        state["counting"], state.targetctx = state.targetctx, state.targetctx.subtarget(enable_nrt=False)
        enforce_no_phis(state.func_ir)
        enforce_no_dels(state.func_ir)
        PostProcessor(state.func_ir).run()
        return True

    def run_pass(self: Any, state: Any) -> bool:
        if "counting" in state:
            library = state.library
            with contextlib.suppress(NumbaRuntimeError):  # a function of NumPy makes an array for itself
                return translate(self, state)
            state.library, state.targetctx = library, state["counting"]
            PostProcessor(state.func_ir).run(emit_dels=True)
        return translate(self, state)

    yield IRLegalization, "run_pass", legalise
    yield BaseNativeLowering, "run_pass", run_pass


def _has_references(state: Any) -> bool:
    """Whether a typed function has lists or text, returns arrays, or has statements that may make one."""
    from numba.core.ir import Assign, Expr, SetItem, StaticSetItem

    def counted(type_: Any) -> frozenset[type]:
        return _counted(state.targetctx.data_model_manager, type_)

    def makes_array(statement: Any) -> bool:
        if isinstance(statement, SetItem | StaticSetItem):  # a copy of what is assigned, if both overlap
            return bool(counted(state.typemap[statement.value.name]))
        value = statement.value if isinstance(statement, Assign) else None
        if not isinstance(value, Expr) or not counted(state.typemap[statement.target.name]):
            return False
        if value.op in ("getitem", "static_getitem"):
            index = value.index if value.op == "getitem" else value.index_var
            return index is not None and bool(counted(state.typemap[index.name]))
        if value.op == "call":
            return not isinstance(state.typemap[value.func.name], types.NamedTupleClass)
        return value.op not in _VIEWS

    if counted(state.return_type) or any(counted(type_) - _ARRAYS for type_ in state.typemap.values()):
        return True
    return any(makes_array(statement) for block in state.func_ir.blocks.values() for statement in block.body)


_ARRAYS = frozenset((types.Array, MemInfoPointer))
_VIEWS = (
    *("getattr", "static_getattr", "build_tuple", "cast", "phi"),
    *("getiter", "iternext", "pair_first", "exhaust_iter"),
)
"""Statements whose results are arguments of a function, or parts of them."""


def classes_by_constant() -> Iterator[Shortcut]:
    """Class of each returned array and named tuple, from the constants of the kernel; numba calls a Python function to
    look it up, which takes 0.3 µs each time."""
    from numba.core.pythonapi import PythonAPI

    box, serialize, unserialize = PythonAPI.from_native_value, PythonAPI.serialize_object, PythonAPI.unserialize

    def from_native_value(self: Any, typ: Any, val: Any, env_manager: Any = None) -> Any:
        if env_manager is not None and env_manager.pyapi is self:
            self.constants, self.classes = env_manager, {}
        return box(self, typ, val, env_manager)

    def serialize_object(self: Any, thing: Any) -> Any:
        pointer = serialize(self, thing)
        if isinstance(thing, type) and hasattr(self, "classes"):
            self.classes[pointer] = thing
        return pointer

    def run(self: Any, pointer: Any) -> Any:
        thing = getattr(self, "classes", {}).get(pointer)
        if thing is None:
            return unserialize(self, pointer)
        found = self.constants.read_const(self.constants.add_const(thing))
        self.incref(found)
        return found

    yield PythonAPI, "from_native_value", from_native_value
    yield PythonAPI, "serialize_object", serialize_object
    yield PythonAPI, "unserialize", run
