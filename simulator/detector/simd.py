"""Helpers of kernels that the compiler vectorises: fused multiply-add, polynomials, and the rare-case mask.

`fma` rounds a b + c only once. Polynomials then take half the time, and give the same result on every machine; if the
compiler may contract products and sums, results depend on the machine.

A loop that branches on each element is not vectorised. A kernel therefore computes the common case for all elements,
marks the undecided ones, and processes these afterwards: `outside` counts them in blocks at vector speed, and only
blocks that contain one are searched.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from startracker._compiled import kernel

BLOCK = 64


def singles(*numbers: float) -> tuple[np.float32, ...]:
    """Numbers in single precision."""
    return tuple(np.float32(number) for number in numbers)


@intrinsic
def fma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c of float32 numbers, rounded once (IEEE 754 fusedMultiplyAdd)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float32(types.float32, types.float32, types.float32), generate


@intrinsic
def polynomial(typing_context: Any, x: Any, coefficients: Any) -> Any:
    """Polynomial of a float32 number by Horner's rule with `fma`; coefficients (N,), float32, of the highest power
    first."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        argument, terms = arguments
        value, *rest = cgutils.unpack_tuple(builder, terms)
        for term in rest:
            value = builder.fma(value, argument, term)
        return value

    return types.float32(types.float32, coefficients), generate


@kernel
def outside(values: NDArray[Any], low: float, high: float) -> int:
    """Number of the values (N,) that are not in low … high; NaN counts as outside."""
    # A sum of 32-bit numbers instead of a branch is vectorised; 64-bit ones would halve the width of the vectors.
    count = np.int32(0)
    for i in range(values.size):
        count = np.int32(count + np.int32(not ((values[i] >= low) & (values[i] <= high))))
    return int(count)
