"""Charge above the full well: it is drained, or blooms along the column of a CCD."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel
from startracker.core import FloatArray

_SETTLED = 1e-9
"""Excess charge, relative to the full well, at which the iteration ends."""


def full_well(electrons: FloatArray, full_well_e: float, antiblooming: float) -> FloatArray:
    """Limit the charge (H, W), electrons, to the full well, in place.

    Channel stops separate the columns, but along a column there are only the potentials of the clocks: half of the
    charge above the full well moves up and half down the column to the nearest pixels that are not full (Janesick 2001,
    section 2.2.5). An antiblooming drain removes a fraction of it first.

    Parameters
    ----------
    electrons : (H, W) float64
        Charge collected.
    full_well_e : float
        Full well.
    antiblooming : float
        Fraction of the charge above the full well that is drained. At 1 all of it is, as in `charge.clip`; at 0 all of
        it blooms.
    """
    # Few columns have a pixel above the full well; the others are not touched.
    full = np.flatnonzero(electrons.max(axis=0) > full_well_e)
    bloom(electrons, full, full_well_e, 1.0 - antiblooming)
    return electrons


@kernel
def bloom(electrons: FloatArray, columns: NDArray[np.int64], full_well_e: float, spilt: float) -> float:
    """Move excess charge along the columns until it fits, in place.

    Half of the excess of each pixel moves up and half down. If the charge that arrives from both sides exceeds the full
    well of a pixel between two sources, the new excess is split again, so that both directions are equivalent. Charge
    is conserved, except for the drained fraction and the charge that leaves at the ends of the columns (into the
    register, or the drain at the opposite end).

    Parameters
    ----------
    electrons : (H, W) float64
        Charge; changed in place.
    columns : (N,) int64
        Columns with pixels above the full well.
    full_well_e : float
        Full well.
    spilt : float
        Fraction of the excess that blooms, 0 to 1; the rest is drained.

    Returns
    -------
    float
        Electrons that left at the ends of the columns.
    """
    rows = electrons.shape[0]
    excess = np.empty(rows)
    out = 0.0
    for column in columns:
        first = True
        for _ in range(10_000):
            largest = 0.0
            for row in range(rows):
                over = max(electrons[row, column] - full_well_e, 0.0)
                electrons[row, column] -= over
                # The drain takes its fraction once, not of the charge that has bloomed already.
                excess[row] = over * spilt if first else over
                largest = max(largest, excess[row])
            first = False
            if largest <= _SETTLED * full_well_e:
                break
            out += _sweep(electrons, excess, column, full_well_e)
    return out


@kernel
def _sweep(electrons: FloatArray, excess: FloatArray, column: int, full_well_e: float) -> float:
    """Move half of the excess up and half down to the nearest free capacity; both use the same capacity."""
    rows = excess.size
    arriving = np.zeros(rows)
    carried = 0.0
    # Each sweep carries charge along the column, drops as much of it into a pixel as fits, and picks up half of the
    # pixel's own excess. Both sweeps see the column as it was before, so that neither direction is preferred.
    for row in range(rows):
        fits = min(carried, full_well_e - electrons[row, column])
        arriving[row] += fits
        carried += 0.5 * excess[row] - fits
    out = carried
    carried = 0.0
    for row in range(rows - 1, -1, -1):
        fits = min(carried, full_well_e - electrons[row, column])
        arriving[row] += fits
        carried += 0.5 * excess[row] - fits
    for row in range(rows):
        electrons[row, column] += arriving[row]
    return out + carried
