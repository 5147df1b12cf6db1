"""Shortcuts through the compiler, whose own Python code takes more time than the optimisation by LLVM.

numba repeats much of its work for every kernel, variable or call, and writes instructions without effect. `shortcuts`
spares them while one of our kernels is compiled, and leaves numba as it was for the kernels of others. With `SAME_CODE`
the machine code is that of numba alone, byte by byte; with `SAME_RESULTS` it differs, the results do not
(``tests/unit/test_compiler.py``). A version of numba without these internals compiles our kernels without the shortcut.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from numba.core.compiler_lock import global_compiler_lock

from startracker.compiler import analysis, optimisation, translation
from startracker.compiler.replacing import available, replaced

__all__ = ["SAME_CODE", "SAME_RESULTS", "shortcuts"]

SAME_CODE = tuple(
    available(
        analysis.remembered_signatures,
        analysis.settled_statements,
        analysis.light_error_contexts,
        analysis.no_live_variables,
        analysis.no_copies,
        analysis.renamed_where_used,
        analysis.variables_of_statements,
        translation.no_lock_events,
        translation.new_declarations_only,
        translation.counted_members_only,
    )
)
SAME_RESULTS = tuple(
    available(
        translation.uncounted_variables,
        translation.elements_of_arrays,
        translation.no_counts_of_arguments,
        translation.classes_by_constant,
        optimisation.wide_vectors,
        optimisation.one_optimisation,
    )
)


@contextlib.contextmanager
def shortcuts(vectorised: bool = True) -> Iterator[None]:
    """Within this context kernels are compiled with shortcuts; contexts may be nested, and no other thread compiles.

    Loops are translated to vector instructions only if `vectorised`.
    """
    with global_compiler_lock, optimisation.vector_instructions(vectorised), replaced((*SAME_CODE, *SAME_RESULTS)):
        yield
