"""Attitude from identified stars: estimators by name in `METHODS`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from startracker.estimation.result import Estimate
from startracker.estimation.star_pair import pitch_error_deg, star_pair
from startracker.estimation.wahba import wahba_svd

__all__ = ["METHODS", "Estimate", "Estimator", "pitch_error_deg", "star_pair", "wahba_svd"]

FloatArray = NDArray[np.float64]
Estimator: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], Estimate]
"""Signature of an estimator: observed (M, 3), reference (M, 3), sigma_rad (M,)."""

METHODS: dict[str, Estimator] = {"svd": wahba_svd, "star_pair": star_pair}
"""Estimators by name; packages add theirs in the entry-point group ``boresight.estimators``."""
