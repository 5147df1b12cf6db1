"""Times of frames, and whether the filter can be propagated to them."""

from __future__ import annotations

import math

from startracker.arguments import real_number


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
