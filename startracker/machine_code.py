"""Shortcuts in numba's use of LLVM: a kernel is optimised and translated once, with all that it calls.

numba optimises every function alone, again when it is linked with those that it calls, and again within each of its
callers, and makes machine code of it each time. Here a kernel that is called from Python is optimised as a whole, with
all that it calls, as numba does it last; only that becomes machine code.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from typing import Any

from llvmlite import binding as llvm  # type: ignore[import-untyped]
from numba.core import caching
from numba.core.codegen import CPUCodegen, CPUCodeLibrary, JITCodeLibrary, JITCPUCodegen
from numba.core.cpu import CPUContext
from numba.core.environment import lookup_environment

from startracker.lowering import Shortcut


class Purpose(Enum):
    """Use of the kernel that is compiled."""

    FOR_PYTHON = "called from Python"
    INNER = "called from other kernels only"
    INNER_LOOP = "called from other kernels only, with a loop"
    """Optimised before it becomes a part of others, among whose arrays its loops may not be vectorised."""


_under_way: list[tuple[Purpose, str]] = [(Purpose.FOR_PYTHON, "")]
"""Purposes and names of the kernels that are being compiled, each within the one before."""


@contextmanager
def compiled_for(purpose: Purpose, name: str) -> Iterator[None]:
    """A kernel of this name is compiled for this purpose."""
    _under_way.append((purpose, name))
    try:
        yield
    finally:
        _under_way.pop()


def _conversion_for_python() -> Shortcut:
    """Function that converts Python's arguments and results, for kernels called from Python."""
    create = CPUContext.create_cpython_wrapper

    def create_cpython_wrapper(self: Any, *arguments: Any, **options: Any) -> None:
        if _under_way[-1][0] is Purpose.FOR_PYTHON:
            create(self, *arguments, **options)

    return CPUContext, "create_cpython_wrapper", create_cpython_wrapper


def _few_function_passes() -> Shortcut:
    """Passes of a function as numba wrote it, after which a tenth of it is left."""

    def optimize_functions(self: Any, module: Any) -> None:
        module.data_layout = self._codegen._data_layout
        builder, passes = self._codegen._pass_builder(), llvm.create_new_function_pass_manager()
        passes.add_sroa_pass()
        passes.add_instruction_combine_pass()
        passes.add_simplify_cfg_pass()
        passes.add_refprune_pass()
        for function in module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    return CPUCodeLibrary, "_optimize_functions", optimize_functions


def _no_passes_between() -> Shortcut:
    """Passes of a kernel with all that it calls, before it is optimised fully.

    numba rotates its loops, which is early by then: those of the detector would not be vectorised.
    """
    manager = CPUCodegen._module_pass_manager

    def module_pass_manager(self: Any, **options: Any) -> Any:
        if options.get("cost") != "cheap":
            return manager(self, **options)
        passes = llvm.create_new_module_pass_manager()
        passes.add_refprune_pass()
        return passes, self._pass_builder()

    return CPUCodegen, "_module_pass_manager", module_pass_manager


_optimise, _translate = CPUCodeLibrary._optimize_final_module, CPUCodeLibrary._finalize_final_module


def _optimised_later() -> Shortcut:
    def optimize_final_module(self: Any) -> None:
        if _under_way[-1] == (Purpose.INNER_LOOP, self.name):  # not a library function that it calls
            _optimise(self)

    return CPUCodeLibrary, "_optimize_final_module", optimize_final_module


def _translated_later() -> Shortcut:
    def finalize_final_module(self: Any) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    return CPUCodeLibrary, "_finalize_final_module", finalize_final_module


def _machine_code_of_entries() -> Shortcut:
    """Address of a function for Python; the library that has it is optimised and translated, unless it was on disk."""
    address = JITCodeLibrary.get_pointer_to_function

    def get_pointer_to_function(self: Any, name: str) -> int:
        self._ensure_finalized()
        if not self._compiled_object:
            if all(function.name != name or function.is_declaration for function in self._final_module.functions):
                return 0
            _optimise(self)
        _translate(self)
        for variable in self._final_module.global_variables:
            environment = lookup_environment(variable.name)
            if environment is not None:  # of a function that was linked
                self.codegen.set_env(variable.name, environment)
        pointer: int = address(self, name)
        return pointer

    return JITCodeLibrary, "get_pointer_to_function", get_pointer_to_function


def _environments_of_entries() -> Shortcut:
    """Python's objects that a function refers to, which has no place for them without machine code."""
    set_environment = JITCPUCodegen.set_env

    def set_env(self: Any, name: str, environment: Any) -> None:
        if self._engine.get_global_value_address(name):
            set_environment(self, name, environment)

    return JITCPUCodegen, "set_env", set_env


def machine_code_shortcuts() -> list[Shortcut]:
    """Shortcuts of optimisation and translation."""
    return [
        _conversion_for_python(),
        _few_function_passes(),
        _no_passes_between(),
        _optimised_later(),
        _translated_later(),
        _machine_code_of_entries(),
        _environments_of_entries(),
    ]


class _InnerFiles(caching.CompileResultCacheImpl):  # type: ignore[misc]  # numba has no types
    """Names and contents of the files of kernels that other kernels call."""

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        return f"{super().get_filename_base(fullname, abiflags)}.inner"

    def reduce(self, compiled: Any) -> Any:
        library = compiled.library
        library.serialize_using_object_code = library.serialize_using_bitcode  # there is no machine code
        return super().reduce(compiled)


class InnerCache(caching.Cache):  # type: ignore[misc]  # numba has no types
    """Cache of a kernel as other kernels call it: code to be linked, without machine code."""

    _impl_class = _InnerFiles
