"""Optimisation by LLVM, once for each kernel."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from numba.core import config

from startracker.compiler.replacing import Shortcut

_asked: list[bool] = []
"""Whether the kernel being compiled asks for vector instructions, the last one, and those that call it."""


@contextlib.contextmanager
def vector_instructions(asked: bool) -> Iterator[None]:
    """Within this context loops are translated to vector instructions or not."""
    _asked.append(asked)
    try:
        yield
    finally:
        _asked.pop()


def wide_vectors() -> Shortcut:
    """Vectors of 512 bits where the processor has them and the kernel asks for vector instructions.

    LLVM prefers 256 bits on Intel's processors, as the first of them with 512 lowered their clock; by these functions'
    attribute a million pixels with noise take 7.9 ms instead of 9.9.
    """
    from numba.core.codegen import CPUCodeLibrary

    add: Callable[..., None] = CPUCodeLibrary.add_ir_module

    def run(self: Any, ir_module: Any) -> None:
        if _asked[-1]:
            for function in ir_module.functions:
                if not function.is_declaration:
                    set.add(function.attributes, _WIDE)  # llvmlite's own method knows no attributes with a value
        add(self, ir_module)

    return CPUCodeLibrary, "add_ir_module", run


_WIDE = '"prefer-vector-width"="512"'


def one_optimisation() -> Iterator[Shortcut]:
    """Optimisation of a kernel with all that it calls. numba optimises each function alone before, and the whole twice.

    Vector instructions take a sixth of the time, and loops over few stars are slower with them. With LLVM's new pass
    manager only, which numba has used since its version 0.62.
    """
    from numba.core.codegen import CPUCodegen, CPUCodeLibrary

    def run_first(self: Any, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    def run(self: Any) -> None:
        passes, builder = self._codegen._module_pass_manager(loop_vectorize=_asked[-1] and config.LOOP_VECTORIZE)
        passes.run(self._final_module, builder)

    if hasattr(CPUCodegen, "_pass_builder"):
        yield CPUCodeLibrary, "_optimize_functions", run_first
        yield CPUCodeLibrary, "_optimize_final_module", run
