"""Times of frames: which of them the filter can step to."""

from __future__ import annotations

import math

from startracker.errors import InputError

__all__ = ["FrameClock"]


class FrameClock:
    """Time of the last frame that was used, and what a next one's time makes of it."""

    def __init__(self) -> None:
        self.now_s: float | None = None
        """Time of the last frame; None before the first."""
        self._refused_s: float | None = None

    @staticmethod
    def read(t_s: float) -> float:
        """A time as a float; NaN and infinities too.

        Raises
        ------
        InputError
            For what is no number.
        """
        try:
            return float(t_s)
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(f"a frame's time must be a number of seconds; got {t_s!r}") from error

    def fault(self, t_s: float) -> str:
        """Why a frame's time cannot be used; empty where it can.

        A frame from before the last one is a straggler. A second one in a row, later than the first, means that the
        clock was set back: it can be used, and `is_before` is set.
        """
        if not math.isfinite(t_s):
            return f"the frame's time is no finite number of seconds: {t_s}"
        if not self.is_before(t_s):
            return ""
        before, self._refused_s = self._refused_s, t_s
        if before is not None and before < t_s:
            return ""
        return f"the frame is at {t_s} s, before the last one, at {self.now_s} s"

    def is_before(self, t_s: float) -> bool:
        """Whether a time is before the last frame's."""
        return self.now_s is not None and t_s < self.now_s

    def advance(self, t_s: float) -> float:
        """Step to a frame's time: seconds since the last frame; 0 for the first one, and after a clock was set back."""
        step_s = 0.0 if self.now_s is None else max(t_s - self.now_s, 0.0)
        self.now_s, self._refused_s = t_s, None
        return step_s
