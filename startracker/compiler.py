"""Shortcuts through the compiler's own Python code, which takes more time than the optimisation by LLVM.

numba repeats three things for every kernel. `shortcuts` spares the repetition while one of our kernels is compiled, and
leaves numba as it was for the kernels of others. The machine code is the same, byte by byte
(``tests/unit/test_compiler.py``). A version of numba without these internals compiles our kernels without the shortcut.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from numba.core import types
from numba.core.compiler_lock import global_compiler_lock

__all__ = ["shortcuts"]

Shortcut = tuple[type, str, Callable[..., Any]]
"""Class, name of a method, and the method in its stead."""

_VALUES = ("Number", "Boolean", "Array", "BaseTuple", "SliceType", "NoneType")
"""Types of arguments that decide the type of a result alone."""


@contextlib.contextmanager
def shortcuts() -> Iterator[None]:
    """Within this context kernels are compiled with shortcuts; contexts may be nested, and no other thread compiles."""
    with global_compiler_lock, contextlib.ExitStack() as after:
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


def _one_scope() -> Shortcut:
    """The scope of variables of a function that is inlined, which numba copies for each block, with all variables."""
    from numba.core.ir import Scope

    return Scope, "__deepcopy__", lambda self, memo: self


def _available() -> Iterator[Shortcut]:
    for shortcut in (_remembered_signatures, _no_live_variables, _one_scope):
        with contextlib.suppress(ImportError, AttributeError):  # another version of numba
            yield shortcut()


_SHORTCUTS = tuple(_available())
