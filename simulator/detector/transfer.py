"""Charge-transfer inefficiency of a CCD: charge left behind at each transfer forms trails behind the stars.

To first order a transfer moves each electron with the probability 1 − c, independently of the size of the packet, and
otherwise leaves it to the next packet (Janesick 2001, chapter 5). An electron that needs n transfers is therefore read
k pixels late with the probability C(n + k − 1, k) (1 − c)ⁿ cᵏ, a negative binomial distribution; the fraction (1 − c)ⁿ
is not delayed. Expected values are used, because the noise of the deferred charge, √(n c S), is far below the shot
noise. Traps with release times of many transfers, which give longer tails, are not modelled.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from startracker._compiled import kernel
from startracker.core import FloatArray

_TAIL = 1e-17
"""Trails are truncated below this fraction of a packet."""


def transfer(electrons: FloatArray, cti_parallel: float, cti_serial: float, corner: str = "top_left") -> FloatArray:
    """Charge at the output node by pixel, (H, W) electrons, a new array.

    Columns are shifted in parallel into the serial register at the corner's edge (row r at distance r takes r + 1
    transfers), then along the register to the corner (column x takes x + 1). Charge that trails beyond the last row or
    column would be read in the overscan and is lost.

    Parameters
    ----------
    electrons : (H, W) float64
        Charge at the end of the exposure.
    cti_parallel, cti_serial : float
        Charge-transfer inefficiency: fraction left behind in each transfer, 0 to below 1.
    corner : str
        Position of the output node: ``top_left`` (pixel (0, 0)), ``top_right``, ``bottom_left`` or ``bottom_right``.
    """
    flip_rows, flip_columns = corner.startswith("bottom"), corner.endswith("right")
    # The kernel transfers towards pixel (0, 0); for other corners the image is flipped before and after.
    seen = electrons[:: -1 if flip_rows else 1, :: -1 if flip_columns else 1]
    late_rows, late_columns = (late_shares(n, c) for n, c in zip(seen.shape, (cti_parallel, cti_serial), strict=True))
    charge = trail(np.ascontiguousarray(seen), late_rows, late_columns)
    return np.ascontiguousarray(charge[:: -1 if flip_rows else 1, :: -1 if flip_columns else 1])


@lru_cache(maxsize=8)
def late_shares(pixels: int, cti: float) -> FloatArray:
    """Fraction of a packet that is read k pixels late, (K, pixels) float64: [k, p] for p + 1 transfers.

    K is such that the fraction for the last pixel falls below 1e-17.
    """
    n = np.arange(1, pixels + 1, dtype=np.float64)
    share = np.exp(n * np.log1p(-cti))
    rows = [share]
    # Fractions grow up to the most likely delay, so the loop may not end before it, however small they are.
    most_likely = pixels * cti / (1.0 - cti)
    while len(rows) < pixels and (share[-1] > _TAIL or len(rows) < most_likely):
        k = len(rows)
        share = share * cti * (n + k - 1) / k
        rows.append(share)
    table = np.array(rows)
    table.setflags(write=False)
    return table


@kernel
def trail(electrons: FloatArray, late_rows: FloatArray, late_columns: FloatArray) -> FloatArray:
    """Parallel transfer towards row 0, line[r] = Σₖ late_rows[k, r − k] electrons[r − k], and serial transfer of each
    line towards column 0, out[r, x] = Σₖ late_columns[k, x − k] line[r, x − k]; a new array."""
    rows, columns = electrons.shape
    out, line = np.zeros_like(electrons), np.empty(columns)
    # Charge from k rows nearer to the register arrives late, with this row. A row is complete before its serial
    # transfer, as in the detector.
    for row in range(rows):
        line[:] = 0.0
        for k in range(min(late_rows.shape[0], row + 1)):
            share = late_rows[k, row - k]
            for column in range(columns):
                line[column] += share * electrons[row - k, column]
        for k in range(min(late_columns.shape[0], columns)):
            for column in range(columns - k):
                out[row, column + k] += late_columns[k, column] * line[column]
    return out
