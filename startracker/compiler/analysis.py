"""Shortcuts through the analysis of a kernel's statements: its variables, their types, functions that become parts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from numba.core import types

from startracker.compiler.replacing import Shortcut

_VALUES = ("Number", "Boolean", "Array", "BaseTuple", "SliceType", "NoneType")
"""Types of arguments that decide the type of a result alone."""


def remembered_signatures() -> Shortcut:
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


def settled_statements() -> Iterator[Shortcut]:
    """Inference of types, without the statements of which no variable has another type than when they were last typed.

    numba types all statements of a function again until no type changes, at least twice.
    """
    from numba.core.typeinfer import ConstraintNetwork, TypeVarMap

    propagate, look_up = ConstraintNetwork.propagate, TypeVarMap.__getitem__
    # variables and types read by the statement being typed, and by those whose functions are compiled meanwhile
    read: list[list[tuple[Any, Any]]] = []

    def noted(self: Any, name: str) -> Any:
        variable = look_up(self, name)
        if read:
            read[-1].append((variable, variable.type))
        return variable

    def run(self: Any, typeinfer: Any) -> list[Any]:
        statements, settled, errors = self.constraints, vars(self).setdefault("settled", {}), []
        try:
            for statement in statements:
                if statement in settled and all(variable.type is type_ for variable, type_ in settled[statement]):
                    continue
                self.constraints = [statement]
                read.append([])
                try:
                    found = propagate(self, typeinfer)
                finally:
                    variables = read.pop()
                # one that refined a type may have read it as well
                if not found and all(type_ in (None, variable.type) for variable, type_ in variables):
                    settled[statement] = [(variable, variable.type) for variable, _ in variables]
                errors += found
        finally:
            self.constraints = statements
        return errors

    yield TypeVarMap, "__getitem__", noted
    yield ConstraintNetwork, "propagate", run


def light_error_contexts() -> Iterator[Shortcut]:
    """Context of errors, which numba enters for each statement, as a class instead of a generator."""
    from numba.core import errors, lowering, typeinfer

    describe = vars(errors)["new_error_context"]

    class Context:
        def __init__(self, text: str, *values: Any, **named: Any) -> None:
            self.described = text, values, named

        def __enter__(self) -> None:
            pass

        def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
            if error is not None:
                text, values, named = self.described
                with describe(text, *values, **named):
                    raise error

    yield lowering, "new_error_context", Context
    yield typeinfer, "new_error_context", Context


def no_live_variables() -> Shortcut:
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


def no_copies() -> Iterator[Shortcut]:
    """Blocks and scope of a function that is inlined, which numba copies twice, although it translates the function
    again for each call and no caller uses the unchanged copy."""
    from numba.core.ir import Block, Scope

    for owner in (Block, Scope):
        yield owner, "__deepcopy__", lambda self, memo: self


def renamed_where_used() -> Shortcut:
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


def variables_of_statements() -> Shortcut:
    """List of a statement's variables, which each pass asks for, with the frequent types of its values first."""
    from numba.core.ir import Inst, Loc, Var

    def listed(self: Any, value: Any) -> list[Any]:
        kind = type(value)
        if kind is Var:
            return [value]
        if kind is Loc or kind is str or value is None:
            return []
        if isinstance(value, Inst):
            variables: list[Any] = value.list_vars()
            return variables
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
