"""Charge above the full well: drained, or spilt along the column of a CCD."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.kernels import kernel

FloatArray = NDArray[np.float64]

_SETTLED = 1e-9
"""Charge above the full well, relative to it, that is no longer followed."""


def full_well(electrons: FloatArray, full_well_e: float, antiblooming: float) -> FloatArray:
    """Charge that pixels hold, (H, W) electrons, in place.

    Channel stops keep charge from its neighbours in the row, while along the column only the potential of the clocks
    does: charge above the full well spills up and down the column, half each, into the nearest room (Janesick 2001,
    section 2.2.5). An antiblooming drain takes a share of it first.

    Parameters
    ----------
    electrons : (H, W) float64
        Charge collected.
    full_well_e : float
        Full well.
    antiblooming : float
        Share of the charge above the full well that is drained: 1: all of it, as `exposure.clip` does; 0: all blooms.
    """
    full = np.flatnonzero(electrons.max(axis=0) > full_well_e)
    bloom(electrons, full, full_well_e, 1.0 - antiblooming)
    return electrons


@kernel
def bloom(electrons: FloatArray, columns: NDArray[np.int64], full_well_e: float, spilt: float) -> float:
    """Spill charge along the columns until it fits, in place.

    Half of each pixel's excess sweeps up, half down; what both sweeps together bring too much to a pixel between two
    sources is split again, so that neither direction comes first. Nothing is made or lost but what is drained and what
    runs out at the ends of the columns (into the register, or the drain opposite).

    Parameters
    ----------
    electrons : (H, W) float64
        Charge; changed in place.
    columns : (N,) int64
        Columns to look at; the others hold no pixel above the full well.
    full_well_e : float
        Full well.
    spilt : float
        Share of the excess that spills, 0 to 1; the rest is drained.

    Returns
    -------
    float
        Electrons that ran out at the ends of the columns.
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
                excess[row] = over * spilt if first else over
                largest = max(largest, excess[row])
            first = False
            if largest <= _SETTLED * full_well_e:
                break
            out += _sweep(electrons, excess, column, full_well_e)
    return out


@kernel
def _sweep(electrons: FloatArray, excess: FloatArray, column: int, full_well_e: float) -> float:
    """Carry half of the excess up and half down into the room that is there; both see the same room."""
    rows = excess.size
    arriving = np.zeros(rows)
    carried = 0.0
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
