"""How an update of a tracking session went."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from startracker.display import described
from startracker.tracking.mekf import Innovation

__all__ = ["TrackingState"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class TrackingState:
    """How the last update went.

    Parameters
    ----------
    mode : str
        ``tracking``, ``prior`` (whole frame, around the prediction), ``lost_in_space``, or ``coasting`` where the
        frame was not used at all (status ``stale`` or ``bad_time``).
    solved : bool
        Whether the update gave an attitude.
    windows : int
        Windows looked at; 0 where the whole frame was.
    expected, matched : int
        Guide stars looked for, and stars matched.
    log_chance : float
        ln of the largest probability that chance does as well; of tracking alone, else NaN.
    innovation : Innovation, optional
        How the measurement compared with the prediction; None where there was no prediction.
    restarted : bool
        Whether the filter began anew: the first solution, or one that contradicts the prediction.
    distrusted : bool
        Whether the innovations of the last frames together contradicted the filter, which then lost confidence: its
        covariance and its process noise were raised before the frame was taken in.
    note : str
        What else there is to say of the frame: a gyro sample that was left out, a clock that was set back.
    window_xy : (windows, 2), optional
        Central pixels of the windows.
    window_half_px : int
        A window has 2 half + 1 pixels a side.
    """

    mode: str = "lost_in_space"
    solved: bool = False
    windows: int = 0
    expected: int = 0
    matched: int = 0
    log_chance: float = math.nan
    innovation: Innovation | None = None
    restarted: bool = False
    distrusted: bool = False
    note: str = ""
    window_xy: FloatArray | None = field(default=None, compare=False)
    window_half_px: int = 0

    def __repr__(self) -> str:
        stars = f"{self.matched} of {self.expected} expected stars" if self.expected else f"{self.matched} stars"
        windows = f"{self.windows} windows" if self.windows else ""
        flags = [name for name in ("restarted", "distrusted") if getattr(self, name)]
        solved = "solved" if self.solved else "not solved"
        return described("TrackingState", self.mode, solved, stars, windows, *flags, self.note)
