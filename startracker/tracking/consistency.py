"""Whether the innovations of the last frames together are what the filter says they should be.

One innovation says little of a filter that is far more certain than a frame: an error of several of its standard
deviations is lost in the frame's. Over a window the innovations, whitened, are independent Gaussian deviates of
variance 1, and there are two sums with known distributions: that of their squares, χ² of all their degrees of freedom,
and the square of their vector sum over the number of frames, χ² of three, which finds an error that stays (Bar-Shalom,
Li & Kirubarajan 2001, *Estimation with Applications to Tracking and Navigation*, section 5.4).
"""

from __future__ import annotations

from collections import deque

from startracker.tracking.mekf import Innovation, chi_square_limit

__all__ = ["InnovationWindow"]

_Sums = tuple[float, float, float, float, float, float]
"""Of squares, of degrees of freedom, of frames with a whitened innovation, and of its three components."""
_NOTHING: _Sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_LENGTH = 32
_FALSE_ALARM = 1e-3
"""Probability of either sum's exceeding its limit by chance. A false alarm costs some of the averaging, no frame."""
_TOO_SMALL = 0.99
"""The sum of squares exceeds its limit with this probability: below it, the raised noise is too much."""
_FEWEST = 2
_RAISE = 10.0
"""Factor of the variances after an alarm."""
_FADE = 1.0 / 256.0
"""Share of the excess of the process noise that is taken back with every frame that fits."""
_LARGEST = 1e8


class InnovationWindow:
    """The innovations of the last frames, and the factor by which the process noise must exceed the configured one."""

    def __init__(self) -> None:
        self.noise_factor = 1.0
        self._frames: deque[_Sums] = deque()
        self._total = _NOTHING
        self._last: tuple[Innovation, _Sums] | None = None

    def contradicts(self, innovation: Innovation) -> bool:
        """Whether the last frames together with one more contradict the filter."""
        self._last = innovation, _sums(innovation)
        total = _add(self._total, self._last[1])
        if len(self._frames) == _LENGTH:
            total = _add(total, self._frames[0], -1.0)
        distance2, freedom, number, x, y, z = total
        if len(self._frames) + 1 < _FEWEST:
            return False
        if distance2 > chi_square_limit(round(freedom), _FALSE_ALARM):
            return True
        return number >= _FEWEST and (x * x + y * y + z * z) / number > chi_square_limit(3, _FALSE_ALARM)

    def add(self, innovation: Innovation) -> None:
        """Take in an innovation that fits."""
        if len(self._frames) == _LENGTH:
            self._total = _add(self._total, self._frames.popleft(), -1.0)
        sums = self._last[1] if self._last is not None and self._last[0] is innovation else _sums(innovation)
        self._frames.append(sums)
        self._total = _add(self._total, sums)
        self.noise_factor += _FADE * (1.0 - self.noise_factor)
        full = len(self._frames) == _LENGTH
        if full and self.noise_factor > 1.0 and self._total[0] < chi_square_limit(round(self._total[1]), _TOO_SMALL):
            self.forget()
            self.noise_factor = max(1.0, self.noise_factor / _RAISE)

    def alarm(self) -> float:
        """Raise the process noise and begin a new window; the factor by which to raise the covariance too."""
        self.forget()
        self.noise_factor = min(self.noise_factor * _RAISE, _LARGEST)
        return _RAISE

    def restart(self) -> None:
        """Begin a new window after an innovation beyond the gate; the second within a window is an alarm."""
        if len(self._frames) < _LENGTH:
            self.alarm()
        self.forget()

    def forget(self) -> None:
        """Begin a new window: the filter has begun anew."""
        self._frames.clear()
        self._total = _NOTHING


def _sums(innovation: Innovation) -> _Sums:
    if innovation.whitened is None:
        return innovation.distance2, innovation.freedom, 0.0, 0.0, 0.0, 0.0
    x, y, z = innovation.whitened.tolist()
    return innovation.distance2, innovation.freedom, 1.0, x, y, z


def _add(a: _Sums, b: _Sums, sign: float = 1.0) -> _Sums:
    return (
        a[0] + sign * b[0],
        a[1] + sign * b[1],
        a[2] + sign * b[2],
        a[3] + sign * b[3],
        a[4] + sign * b[4],
        a[5] + sign * b[5],
    )
