"""Random bits of pixels by Philox-4x32-10, a counter-based generator.

Salmon, Moraes, Dror & Shaw (2011), "Parallel random numbers: as easy as 1, 2, 3". The key is taken from the stream of
the effect and the counter from the pixel number, so that the noise of a pixel does not depend on other pixels or their
order. NumPy's generators are sequential; a counter-based one computes sixteen pixels at a time (0.3 ns for 32 bits).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from simulator.randomness import Key
from startracker._compiled import kernel_part

Bits = NDArray[np.uint32]

_MULTIPLY_0, _MULTIPLY_1 = 0xD2511F53, 0xCD9E8D57
_WEYL_0, _WEYL_1 = 0x9E3779B9, 0xBB67AE85
_LOW, _ROUNDS = 0xFFFFFFFF, 10
_HALF = np.uint64(32)
_FRACTION_SHIFT, _UNIT = np.uint64(11), 2.0**-53


@intrinsic
def block(typing_context: Any, k0: Any, k1: Any, counter: Any, lane: Any) -> Any:
    """128 random bits, as four uint64 below 2³², of a counter (64 bits) and a lane (32 bits); the key is k0 and k1,
    32 bits each.

    The instructions of the ten rounds are generated one after another, because a loop would prevent vectorisation over
    counters.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def number(value: int) -> Any:
            return context.get_constant(types.uint64, value)

        def halves(product: Any) -> tuple[Any, Any]:
            return builder.and_(product, number(_LOW)), builder.lshr(product, number(32))

        k0, k1, counter, lane = arguments
        (x0, x1), x2, x3 = halves(counter), lane, number(0)
        for _ in range(_ROUNDS):
            # One round: two 32 × 32 bit products, whose halves are permuted and combined with the key; the key is then
            # incremented by the Weyl constants.
            (low_0, high_0), (low_1, high_1) = (
                halves(builder.mul(number(by), x)) for by, x in ((_MULTIPLY_0, x0), (_MULTIPLY_1, x2))
            )
            x0, x1 = builder.xor(builder.xor(high_1, x1), k0), low_1
            x2, x3 = builder.xor(builder.xor(high_0, x3), k1), low_0
            k0, k1 = (halves(builder.add(k, number(weyl)))[0] for k, weyl in ((k0, _WEYL_0), (k1, _WEYL_1)))
        return context.make_tuple(builder, signature.return_type, (x0, x1, x2, x3))

    return types.UniTuple(types.uint64, 4)(*(types.uint64,) * 4), generate


@kernel_part
def fill_bits(key: Key, first: np.uint64, lane: np.uint64, bits: Bits) -> None:
    """Write the random bits of the N counters first, first + 1, … to `bits` (4 N,): the first 32 bits of all blocks,
    then the second ones, and so on."""
    n = bits.size // 4
    w0, w1, w2, w3 = bits[:n], bits[n : 2 * n], bits[2 * n : 3 * n], bits[3 * n : 4 * n]
    for i in range(n):
        x0, x1, x2, x3 = block(key[0], key[1], first + np.uint64(i), lane)
        w0[i], w1[i], w2[i], w3[i] = np.uint32(x0), np.uint32(x1), np.uint32(x2), np.uint32(x3)


@kernel_part
def further_bits(key: Key, pixel: int) -> float:
    """Uniform deviate in (0, 1) from the 53 additional bits of a pixel (lane 1), exact in double precision."""
    x0, x1, _, _ = block(key[0], key[1], np.uint64(pixel), np.uint64(1))
    return (np.float64((x0 | (x1 << _HALF)) >> _FRACTION_SHIFT) + 0.5) * _UNIT
