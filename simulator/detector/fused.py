"""a b + c rounded once, in single precision: polynomials take half the time, and give the same number on every machine,
which they would not if the compiler were free to contract products and sums."""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import intrinsic


@intrinsic
def fma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c of float32 numbers, rounded once (IEEE 754 fusedMultiplyAdd)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float32(types.float32, types.float32, types.float32), generate
