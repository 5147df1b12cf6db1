"""Printed digits that were cut off instead of rounded: the thesis' Matlab printed some of its numbers so."""

from __future__ import annotations

import math
from decimal import Decimal

from simulator.theses.printed import Row, compare


def cut_off(printed: str, computed: float) -> bool:
    """Whether a computed number, cut off after the digits that are printed, is the printed one."""
    exponent = int(Decimal(printed).as_tuple().exponent)
    step = 10.0**exponent
    return math.floor(computed / step + 1e-9) == round(float(printed) / step)


def compare_cut(where: str, quantity: str, printed: str, computed: float, *, unit: str = "", why: str = "") -> Row:
    """As `compare`, and exact as well where the printed digits are those of the computed value, cut off."""
    row = compare(where, quantity, printed, computed, unit=unit, why=why)
    if row.verdict == "exact" or not cut_off(printed, computed):
        return row
    note = "printed digits cut off, not rounded"
    return Row(where, quantity, row.printed, row.computed, "exact", f"{why}; {note}" if why else note)
