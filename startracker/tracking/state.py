"""State of a tracking session after an update, and the times of its frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from startracker.arguments import real_number
from startracker.core import FloatArray
from startracker.display import described
from startracker.tracking.mekf import Innovation


@dataclass(frozen=True)
class TrackingState:
    """Result of the last update.

    Parameters
    ----------
    mode : str
        ``tracking``, ``prior`` (whole frame, near the prediction), ``lost_in_space``, or ``coasting`` if the frame was
        not used (status ``stale``, ``bad_time`` or ``gyro_mismatch``).
    solved : bool
        Whether the update has an attitude.
    windows : int
        Number of windows; 0 for the whole frame.
    expected, matched : int
        Number of guide stars searched for, and of stars matched.
    log_chance : float
        ln of the upper limit of the chance probability, in mode ``tracking``; otherwise NaN.
    innovation : Innovation, optional
        Comparison of the measurement with the prediction; None without a prediction.
    restarted : bool
        Whether the filter was restarted: by the first solution, or one that contradicts the prediction.
    distrusted : bool
        Whether the innovations of recent frames contradicted the filter, so that its covariance and process noise were
        increased before the frame was used.
    note : str
        Further remarks on the frame: an ignored gyro sample, a clock that was set back.
    window_xy : (windows, 2), optional
        Central pixels of the windows.
    window_half_px : int
        A window has 2 half + 1 pixels per side.
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


class FrameClock:
    """Time of the last frame used, and checks of the next."""

    def __init__(self) -> None:
        self.now_s: float | None = None
        """Time of the last frame; None before the first."""
        self._refused_s: float | None = None

    @staticmethod
    def read(t_s: float) -> float:
        """A time as a float, including NaN and infinities.

        Raises
        ------
        InputError
            If it is not a number.
        """
        return real_number("a frame's time", t_s, what="a number of seconds", finite=False)

    def fault(self, t_s: float) -> str:
        """Reason why a frame's time cannot be used; empty if it can.

        A single frame with an earlier time is late. A second one, later than the first, indicates that the clock was
        set back: it can be used, and `is_before` is true.
        """
        if not math.isfinite(t_s):
            return f"the frame's time is not a finite number of seconds: {t_s}"
        if not self.is_before(t_s):
            return ""
        before, self._refused_s = self._refused_s, t_s
        if before is not None and before < t_s:
            return ""
        return f"the frame's time, {t_s} s, is before that of the last one, {self.now_s} s"

    def is_before(self, t_s: float) -> bool:
        """Whether a time is before that of the last frame."""
        return self.now_s is not None and t_s < self.now_s

    def advance(self, t_s: float) -> float:
        """Advance to a frame's time; returns the seconds since the last frame, 0 for the first one and after the clock
        was set back."""
        step_s = 0.0 if self.now_s is None else max(t_s - self.now_s, 0.0)
        self.now_s, self._refused_s = t_s, None
        return step_s
