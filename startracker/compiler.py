"""Shortcuts through the compiler, while one of our kernels is compiled; numba is as it was for the kernels of others.

numba repeats three things of its Python code for every kernel, which are spared here. It also writes several times the
instructions that are needed (`startracker.lowering`), and optimises them several times (`startracker.machine_code`).
Versions of numba with which this has not been tested compile our kernels in their own way, which takes twice as long.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numba
from numba.core import types
from numba.core.compiler_lock import global_compiler_lock

from startracker.lowering import Shortcut, lowering_shortcuts
from startracker.machine_code import Purpose, compiled_for, machine_code_shortcuts

__all__ = ["shortcuts"]

_VALUES = ("Number", "Boolean", "Array", "BaseTuple", "SliceType", "NoneType")
"""Types of arguments that decide the type of a result alone."""


@contextlib.contextmanager
def shortcuts(purpose: Purpose = Purpose.FOR_PYTHON, name: str = "") -> Iterator[None]:
    """Within this context kernels are compiled with shortcuts; contexts may be nested, and no other thread compiles."""
    with global_compiler_lock, compiled_for(purpose, name), contextlib.ExitStack() as after:
        for owner, attribute, shortcut in _SHORTCUTS:
            present = vars(owner).get(attribute)
            if present is shortcut:  # of an outer context
                continue
            if attribute not in vars(owner):
                after.callback(delattr, owner, attribute)
            else:
                after.callback(setattr, owner, attribute, present)
            setattr(owner, attribute, shortcut)
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


def _all_shortcuts() -> Iterator[Shortcut]:
    yield from (_remembered_signatures(), _no_live_variables(), _one_scope())
    yield from lowering_shortcuts()
    yield from machine_code_shortcuts()


_TESTED = ("0.68.",)
_SHORTCUTS = tuple(_all_shortcuts()) if numba.__version__.startswith(_TESTED) else ()
