"""Shortcuts through the compiler's own Python code, which takes more time than the optimisation by LLVM.

numba repeats much of its work for every kernel, variable or call. `shortcuts` spares the repetition while one of our
kernels is compiled, and leaves numba as it was for the kernels of others. The machine code is the same, byte by byte
(``tests/unit/test_compiler.py``), but for `_light_first_optimisation` and `_classes_by_constant`, with which the
results are the same. A version of numba without these internals compiles our kernels without the shortcut.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from numba.core import config, types
from numba.core.compiler_lock import global_compiler_lock

__all__ = ["shortcuts"]

Shortcut = tuple[Any, str, Callable[..., Any]]
"""Class or module, name of a method or function, and the one in its stead."""

_VALUES = ("Number", "Boolean", "Array", "BaseTuple", "SliceType", "NoneType")
"""Types of arguments that decide the type of a result alone."""


@contextlib.contextmanager
def shortcuts(vectorised: bool = True) -> Iterator[None]:
    """Within this context kernels are compiled with shortcuts; contexts may be nested, and no other thread compiles.

    Loops are translated to vector instructions only if `vectorised`.
    """
    with global_compiler_lock, contextlib.ExitStack() as after:
        _vectorised.append(vectorised)
        after.callback(_vectorised.pop)
        for owner, name, shortcut in _SHORTCUTS:
            method = vars(owner).get(name)
            if method is shortcut:  # of an outer context
                continue
            if method is None:
                after.callback(delattr, owner, name)
            else:
                after.callback(setattr, owner, name, method)
            setattr(owner, name, shortcut)
        yield


_vectorised: list[bool] = []
"""Of the kernel being compiled, the last one, and of those that call it."""


def _remembered_signatures() -> Shortcut:
    """Signature of a function or operator of numba for given types, looked up after the first time.

    To type a sum of two numbers, numba tries some twenty meanings of ``+``, dates, lists and sets among them.
    """
    from numba.core.targetconfig import ConfigStack, TargetConfig
    from numba.core.types.functions import BaseFunction

    resolve, options = BaseFunction.get_call_type, TargetConfig._values
    values = tuple(getattr(types, name) for name in _VALUES)
    known: dict[Any, tuple[Any, Any, Any]] = {}

    def get_call_type(self: Any, context: Any, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        if kws or not hasattr(self, "_impl_keys") or not all(isinstance(argument, values) for argument in args):
            return resolve(self, context, args, kws)
        flags = ConfigStack.top_or_none()
        key = id(self), args, None if flags is None else repr(options.__get__(flags))
        if key not in known:
            found: Any = resolve(self, context, args, kws)
            known[key] = found, self._impl_keys[found.args], self  # the last keeps its id
        signature, implementation, _ = known[key]
        self._impl_keys[signature.args] = implementation  # compiled with these options, not another kernel's
        return signature

    return BaseFunction, "get_call_type", get_call_type


def _no_live_variables() -> Shortcut:
    """Update of a function after each pass, without the variables that are live at the start of its blocks.

    They are read for generators and for Python's objects only, of which kernels have none.
    """
    from numba.core.postproc import PostProcessor, VariableLifetime
    from numba.core.transforms import canonicalize_cfg

    update, delete = PostProcessor.run, PostProcessor._insert_var_dels

    def run(self: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
        function = self.func_ir
        if function.is_generator:
            update(self, emit_dels, extend_lifetimes)
            return
        function.blocks = canonicalize_cfg(function.blocks)
        function.variable_lifetime = VariableLifetime(function.blocks)
        function.generator_info = None
        if emit_dels:
            delete(self, extend_lifetimes=extend_lifetimes)

    return PostProcessor, "run", run


def _no_copies() -> Iterator[Shortcut]:
    """Blocks and scope of a function that is inlined, which numba copies twice, although it translates the function
    again for each call and no caller uses the unchanged copy."""
    from numba.core.ir import Block, Scope

    for owner in (Block, Scope):
        yield owner, "__deepcopy__", lambda self, memo: self


def _renamed_where_used() -> Shortcut:
    """Renaming of a variable that is assigned more than once, in the statements that use it instead of all."""
    from numba.core import ssa
    from numba.core.ir import Assign, Block, Inst, Var

    def used(statement: Any) -> set[str]:
        read = statement.value if isinstance(statement, Assign) else statement
        if isinstance(read, Var):
            return {read.name}
        return {variable.name for variable in read.list_vars()} if isinstance(read, Inst) else set()

    def run(blocks: dict[int, Any], states: dict[str, Any], handler: Any) -> dict[int, Any]:
        variable = states["varname"]
        if isinstance(handler, ssa._FreshVarHandler):

            def concerned(statement: Any) -> bool:
                return isinstance(statement, Assign) and statement.target.name == variable
        else:
            known = vars(handler._cache_list_vars).setdefault("names_used", {})

            def concerned(statement: Any) -> bool:
                if id(statement) not in known:
                    known[id(statement)] = used(statement), statement  # the latter keeps its id
                return variable in known[id(statement)][0]

        rewritten = {}
        for label, block in blocks.items():
            states["label"], states["block"] = label, block
            rewritten[label] = Block(scope=block.scope, loc=block.loc)
            rewritten[label].body = [
                (handler.on_assign if isinstance(statement, Assign) else handler.on_other)(states, statement)
                if concerned(statement)
                else statement
                for statement in block.body
            ]
        return rewritten

    return ssa, "_run_block_rewrite", run


def _variables_of_statements() -> Shortcut:
    """List of a statement's variables, which each pass asks for, with the frequent types of its values first."""
    from numba.core.ir import Inst, Loc, Var

    def listed(self: Any, value: Any) -> list[Any]:
        kind = type(value)
        if kind is Var:
            return [value]
        if kind is Loc or kind is str or value is None:
            return []
        if isinstance(value, Inst):
            return value.list_vars()  # type: ignore[no-any-return]
        if isinstance(value, dict):
            value = value.values()
        elif not isinstance(value, list | tuple):
            return []
        found = []
        for one in value:
            kind = type(one)
            if kind is Var:
                found.append(one)
            elif not (kind is Loc or kind is str or one is None):
                found += listed(self, one)
        return found

    return Inst, "_rec_list_vars", listed


def _no_lock_events() -> Iterator[Shortcut]:
    """Lock around each call of LLVM, without the events from which its time can be measured."""
    from llvmlite.binding.ffi import _LLVMLock

    yield _LLVMLock, "__enter__", lambda self: self._lock.acquire() and None
    yield _LLVMLock, "__exit__", lambda self, *details: self._lock.release()


def _new_declarations_only() -> Shortcut:
    """Refresh of numba's functions, which precedes each one's implementation, if there are new ones."""
    from numba.core.base import BaseContext

    refresh = BaseContext.refresh
    seen: dict[int, int] = {}

    def declared(context: Any) -> int:
        return sum(
            len(getattr(registry, kind))
            for registry, loader in context._registries.items()
            for kind in loader.registry_items
        )

    def run(self: Any) -> None:
        count = declared(self) + declared(self.typing_context)
        if seen.get(id(self)) != count:
            refresh(self)
            seen[id(self)] = declared(self) + declared(self.typing_context)

    return BaseContext, "refresh", run


def _classes_by_constant() -> Iterator[Shortcut]:
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


def _light_first_optimisation() -> Iterator[Shortcut]:
    """Optimisation of each function before those that it calls are inlined, by three passes: all follow afterwards.

    With LLVM's new pass manager only, which numba has used since its version 0.62.
    """
    from llvmlite.binding import create_new_function_pass_manager
    from numba.core.codegen import CPUCodegen, CPUCodeLibrary

    def run(self: Any, module: Any) -> None:
        module.data_layout = self._codegen._data_layout
        for function in module.functions:
            if not function.is_declaration:
                passes = create_new_function_pass_manager()
                passes.add_sroa_pass()
                passes.add_simplify_cfg_pass()
                passes.add_instruction_combine_pass()
                passes.run(function, self._codegen._pass_builder(opt=1))

    if hasattr(CPUCodegen, "_pass_builder"):
        yield CPUCodeLibrary, "_optimize_functions", run


def _vectorised_if_asked() -> Iterator[Shortcut]:
    """Optimisation of a kernel with all that it calls, without vector instructions unless it works on many pixels.

    They take a sixth of the optimisation, and loops over few stars are slower with them.
    """
    from numba.core.codegen import CPUCodegen, CPUCodeLibrary

    def run(self: Any) -> None:
        codegen = self._codegen
        for options in {"cost": "cheap", "opt": codegen._opt_level}, {}:
            vectorised = {"loop_vectorize": not options and _vectorised[-1] and config.LOOP_VECTORIZE}
            passes, builder = codegen._module_pass_manager(**vectorised, **options)
            passes.run(self._final_module, builder)

    if hasattr(CPUCodegen, "_pass_builder"):
        yield CPUCodeLibrary, "_optimize_final_module", run


def _available(*found_by: Callable[[], Shortcut | Iterator[Shortcut]]) -> Iterator[Shortcut]:
    for find in found_by:
        with contextlib.suppress(ImportError, AttributeError):  # another version of numba
            found = find()
            if isinstance(found, tuple):
                yield found
            else:
                yield from found


_SHORTCUTS = tuple(
    _available(
        _remembered_signatures,
        _no_live_variables,
        _no_copies,
        _renamed_where_used,
        _variables_of_statements,
        _no_lock_events,
        _new_declarations_only,
        _classes_by_constant,
        _light_first_optimisation,
        _vectorised_if_asked,
    )
)
