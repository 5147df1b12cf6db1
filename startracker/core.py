"""Types of arrays, and constants of physics and units."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
IntArray = NDArray[np.int64]
Int32Array = NDArray[np.int32]
BoolArray = NDArray[np.bool_]
Columns = dict[str, NDArray[Any]]
"""Columns of a table by name, one value per row."""


SPEED_OF_LIGHT_KM_S = 299_792.458
"""Exact by the SI definition of the metre."""

J2000_JD_TT = 2_451_545.0
"""Julian date (TT) of the epoch J2000.0."""

DAYS_PER_JULIAN_YEAR = 365.25

AU_KM = 149_597_870.7
"""Astronomical unit; exact, IAU 2012 Resolution B2."""

ARCSEC_RAD = math.pi / 648_000.0
"""One second of arc in radians."""

ARCSEC_PER_DEG = 3600.0

MAS_RAD = ARCSEC_RAD / 1000.0
"""One milliarcsecond in radians."""
