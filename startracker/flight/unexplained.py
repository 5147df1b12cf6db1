"""Numbers of the check of an attitude against the whole field (`c/tracker_unexplained.c`).

The rule is that of `startracker.unexplained`, whose limits they are, for the list of stars alone: when the attitude is
known the pixels of the frame are not kept any more, so that light beside the list cannot be asked for.
"""

from __future__ import annotations

import math

import numpy as np

from startracker import unexplained
from startracker.field_solution import IMAGE_FLOOR_PX, STATED_PX
from startracker.flight.c_table import CTable

UNEXPLAINED_MODULES = ("unexplained",)
CONTRAST_BITS = 20
"""Fraction bits of logarithms."""
_PIXEL, _VARIANCE, _SHARE = float(1 << 16), float(1 << 36), float(1 << 16)


def unexplained_constants() -> dict[str, int]:
    """Macros of the exported tables."""
    contrast = float(1 << CONTRAST_BITS)
    return {
        "UNEXPLAINED_LARGEST_CONTRAST": round(unexplained.LARGEST_CONTRAST * contrast),
        "UNEXPLAINED_DOUBTFUL_CONTRAST": round(unexplained.DOUBTFUL_CONTRAST * contrast),
        "UNEXPLAINED_FEWEST": unexplained.FEWEST,
        "UNEXPLAINED_FEWEST_OF_ANOTHER": unexplained.FEWEST_OF_ANOTHER,
        # rounded down, so that equal fractions are not below them
        "UNEXPLAINED_LEAST_EXPLAINED": math.floor(unexplained.LEAST_EXPLAINED * _SHARE),
        "UNEXPLAINED_LEAST_SHARE": math.floor(unexplained.LEAST_SHARE * _SHARE),
        "UNEXPLAINED_BRIGHT": math.floor(unexplained.BRIGHT * _SHARE),
        "UNEXPLAINED_BORDER": round((unexplained.BORDER_PX - 0.5) * _PIXEL),
        "UNEXPLAINED_BESIDE": round(unexplained.BESIDE_PX * _PIXEL),
        "UNEXPLAINED_LINES": 2 * unexplained.DIRECTIONS,
        "UNEXPLAINED_FEW_STARS": unexplained.FEW_STARS,
        "UNEXPLAINED_FEW_GATE2": round(unexplained.FEW_STARS_SIGMAS**2 * 256.0),
        "UNEXPLAINED_FLOOR": round(IMAGE_FLOOR_PX**2 * _VARIANCE),
        "UNEXPLAINED_UNKNOWN": round(STATED_PX**2 * _VARIANCE),
    }


def unexplained_arrays(most: int) -> list[CTable]:
    """Constant arrays, for up to `most` stars or guide stars of a field."""
    n = np.arange(most + 1)
    sums = np.rint(n * np.log(np.maximum(n, 1)) * (1 << CONTRAST_BITS)).astype(np.int64)
    angle = math.pi / unexplained.DIRECTIONS * np.arange(2 * unexplained.DIRECTIONS)
    lines = np.rint(np.column_stack([np.cos(angle), np.sin(angle)]) * (1 << 30)).astype(np.int64)
    return [
        CTable("int32_t", "unexplained_sum", "n ln n, 20 fraction bits", sums),
        CTable("int32_t", "unexplained_line", "directions across the image, 2.30", lines),
    ]
