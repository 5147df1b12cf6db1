"""Attitude of a body from several heads and a gyro, whose data may arrive late and in any order.

The filter stores its data with their times for a while, and its state after each. Data older than the last are inserted
at their time, and the filter is computed again from there. The estimate is therefore that of the data in order of time,
to the last bit, whatever the order of their arrival. Compared with a state augmented by those of past exposures
(Roumeliotis & Burdick 2002, Proc. IEEE ICRA, 1788), no linearisation is kept, gates are judged again, and delays need
not be known in advance.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from startracker.arrays import FloatArray
from startracker.errors import InputError
from startracker.fusion.alignments import AlignedMekf, Head
from startracker.geometry.attitude import Attitude
from startracker.tracking.mekf import GyroNoise, Innovation, RateNoise

_MOST_REJECTED = 3
"""Number of successive attitudes beyond the gate, of any heads, after which the filter and not the heads is wrong."""
_LEAST_STEP_S = 1e-3


class Measurement(NamedTuple):
    """Attitude measured by one head."""

    head: int
    attitude: Attitude
    """ICRS to its camera."""
    covariance: FloatArray
    """(3, 3): Of its error in camera axes, rad²."""


class Update(NamedTuple):
    """What a measurement did."""

    outcome: str
    """``started``, ``used``, ``rejected`` (beyond the gate), ``restarted`` (as several in a row were), or ``too_late``
    (older than the memory)."""
    innovation: Innovation | None = None
    """Comparison with the prediction; None for the first one, and one that is too late."""


class _Event(NamedTuple):
    """A time up to which the filter is propagated, and a measurement at it, if any."""

    t_s: float
    rank: int
    """Order at one time: −1 for an end of a gyro sample, then the heads."""
    measurement: Measurement | None = None


class _State(NamedTuple):
    """The filter after an event; filters are never modified."""

    t_s: float
    mekf: AlignedMekf | None
    update: Update | None = None
    rejected: int = 0
    """Number of successive measurements beyond the gate."""
    accepted_s: float = -math.inf
    """Time of the last measurement that was not."""


class _Sample(NamedTuple):
    """Mean rate measured by the gyro over an interval."""

    start_s: float
    end_s: float
    rate_rad_s: FloatArray


class FusionFilter:
    """Filter of a body with several heads.

    Parameters
    ----------
    heads : sequence of Head
        The heads.
    noise : GyroNoise or RateNoise
        Errors of the gyro, whose axes are the body's, or the motion without one.
    false_rejection : float
        Probability that the gate rejects a correct attitude of a head.
    memory_s : float
        Time for which data are stored: the longest delay that is accounted for, in seconds before the latest data.

    Raises
    ------
    InputError
        For no heads, two of one name, or a memory that is not positive.

    Notes
    -----
    An attitude beyond the gate is not used. After three in a row, of any heads, the filter is restarted from the last,
    with the alignments that it knows. The first attitude starts it; there is no estimate before.

    Examples
    --------
    >>> import numpy as np
    >>> from startracker import Attitude
    >>> from startracker.fusion import FusionFilter, Head
    >>> from startracker.tracking import GyroNoise
    >>> along_z = Attitude([0, 0, 0, 1], "body", "camera")
    >>> along_x = Attitude.from_rotation_vector([0, np.pi / 2, 0], "body", "camera")
    >>> fusion = FusionFilter([Head("a", along_z), Head("b", along_x, 3e-4)], GyroNoise())
    >>> fusion.add_attitude("a", 0.0, Attitude([0, 0, 0, 1]), np.diag([1.0, 1.0, 100.0]) * 1e-10).outcome
    'started'
    >>> fusion.add_gyro(0.0, 1.0, [0.0, 0.0, 0.01])
    >>> float(np.degrees(fusion.estimate(1.0).attitude.angle_to(Attitude([0, 0, 0, 1], "icrs", "body")))).__round__(3)
    0.573
    """

    def __init__(
        self,
        heads: Sequence[Head],
        noise: GyroNoise | RateNoise,
        *,
        false_rejection: float = 1e-6,
        memory_s: float = 60.0,
    ) -> None:
        self.heads, self.noise = tuple(heads), noise
        self._names = {head.name: k for k, head in enumerate(heads)}
        if not heads or len(self._names) != len(heads):
            raise InputError("a filter of several heads needs at least one head, each with its own name")
        if not memory_s > 0.0:
            raise InputError(f"memory_s must be a positive time; got {memory_s}")
        self.false_rejection, self.memory_s = false_rejection, memory_s
        self._base = _State(-math.inf, None)
        self._events: list[_Event] = []
        self._states: list[_State] = []
        self._samples: list[_Sample] = []

    def __repr__(self) -> str:
        names = ", ".join(self._names)
        return f"<FusionFilter {names}, {len(self._events)} events in memory>"

    # ------------------------------------------------------------------ data
    def add_gyro(self, start_s: float, end_s: float, turn_rad: ArrayLike) -> None:
        """A gyro's rotation over an interval.

        Parameters
        ----------
        start_s, end_s : float
            Interval, s. It may be late, but must not overlap another one.
        turn_rad : array_like, shape (3,)
            Measured rotation vector in body axes (coning compensated), rad. If an attitude lies within the interval,
            rotation and noise are divided in proportion to the time.

        Raises
        ------
        InputError
            For an interval that is not positive or overlaps another one, a rotation that is not three finite numbers,
            or a filter without a gyro.
        """
        turn = np.array(turn_rad, dtype=float)
        if not isinstance(self.noise, GyroNoise):
            raise InputError("this filter has no gyro: create it with GyroNoise, or omit the gyro's samples")
        if not (math.isfinite(start_s) and math.isfinite(end_s) and end_s > start_s):
            raise InputError(f"a gyro sample needs an interval of positive length; got {start_s} to {end_s} s")
        if turn.shape != (3,) or not np.isfinite(turn).all():
            raise InputError(f"a gyro sample must be three finite numbers in rad; got {turn_rad!r}")
        if end_s <= self._base.t_s:
            return
        at = bisect_left(self._samples, start_s, key=lambda s: s.start_s)
        before, after = self._samples[max(at - 1, 0) : at], self._samples[at : at + 1]
        if (before and before[0].end_s > start_s) or (after and after[0].start_s < end_s):
            raise InputError(f"gyro samples overlap at {start_s} s")
        self._samples.insert(at, _Sample(start_s, end_s, turn / (end_s - start_s)))
        del self._states[bisect_right(self._events, start_s, key=lambda e: e.t_s) :]
        for t_s in (start_s, end_s):
            self._insert(_Event(t_s, -1))
        self._forget()

    def add_attitude(self, head: str | int, t_s: float, attitude: Attitude, covariance: ArrayLike) -> Update:
        """An attitude measured by a head.

        Parameters
        ----------
        head : str or int
            Name or index of the head.
        t_s : float
            Mid-exposure, s; it may be late.
        attitude : Attitude
            ICRS to the camera of this head.
        covariance : array_like, shape (3, 3)
            Of its error in camera axes, rad². Errors of different attitudes are assumed to be independent: attitudes of
            single frames, not those of a `TrackingSession`.

        Raises
        ------
        InputError
            For an unknown head, a second attitude of a head at one time, or a covariance that is not positive definite.
        """
        k = self._names.get(head, -1) if isinstance(head, str) else head
        if not 0 <= k < len(self.heads):
            raise InputError(f"unknown head {head!r}; known: {', '.join(self._names)}")
        p = np.array(covariance, dtype=float)
        if p.shape != (3, 3) or not (np.isfinite(p).all() and (np.linalg.eigvalsh(p) > 0).all()):
            raise InputError("an attitude's covariance must be 3×3, finite and positive definite")
        if not math.isfinite(t_s):
            raise InputError(f"the time of an attitude must be finite; got {t_s}")
        if t_s <= self._base.t_s:
            return Update("too_late")
        event = _Event(t_s, k, Measurement(k, attitude, p))
        if not self._insert(event):
            raise InputError(f"head {self.heads[k].name} has two attitudes at {t_s} s")
        self._replay()
        update = self._states[self._find(event)].update
        assert update is not None
        self._forget()
        return update

    # ------------------------------------------------------------------ results
    def estimate(self, t_s: float) -> AlignedMekf | None:
        """The filter at a time within its memory or later, from the data up to that time; None before the first
        attitude.

        Raises
        ------
        InputError
            For a time before the memory.
        """
        if not t_s >= self._base.t_s:
            raise InputError(f"{t_s} s is before the memory of the filter, which begins at {self._base.t_s} s")
        self._replay()
        at = bisect_right(self._events, t_s, key=lambda e: e.t_s)
        state = self._states[at - 1] if at else self._base
        return self._propagated(state, t_s)

    # ------------------------------------------------------------------ details
    def _find(self, event: _Event) -> int:
        return bisect_left(self._events, event[:2], key=lambda e: e[:2])

    def _insert(self, event: _Event) -> bool:
        """Insert an event, and discard the states after it; False if there is one with its time and rank."""
        at = self._find(event)
        if event.t_s <= self._base.t_s or (at < len(self._events) and self._events[at][:2] == event[:2]):
            return False
        self._events.insert(at, event)
        del self._states[at:]
        return True

    def _replay(self) -> None:
        """Compute the states that are missing."""
        while len(self._states) < len(self._events):
            before = self._states[-1] if self._states else self._base
            event = self._events[len(self._states)]
            mekf = self._propagated(before, event.t_s)
            if event.measurement is None:
                state = before._replace(t_s=event.t_s, mekf=mekf, update=None)
            else:
                state = self._measured(before, event.t_s, mekf, event.measurement)
            self._states.append(state)

    def _propagated(self, state: _State, t_s: float) -> AlignedMekf | None:
        """The filter of a state at a later time, before the next event."""
        if state.mekf is None or t_s <= state.t_s:
            return state.mekf
        middle_s = 0.5 * (state.t_s + t_s)
        at = bisect_right(self._samples, middle_s, key=lambda s: s.start_s)
        sample = self._samples[at - 1] if at else None
        measured = sample is not None and middle_s <= sample.end_s
        mekf = state.mekf.copy()
        mekf.predict(t_s - state.t_s, sample.rate_rad_s if sample is not None and measured else None)
        return mekf

    def _measured(self, before: _State, t_s: float, mekf: AlignedMekf | None, measured: Measurement) -> _State:
        """State after a measurement, from the one before and its filter at the time of the measurement."""
        if mekf is None:
            started = AlignedMekf(self.heads, *measured, self.noise)
            return _State(t_s, started, Update("started"), 0, t_s)
        after = mekf.copy()
        innovation = after.update_head(*measured, self.false_rejection)
        if innovation.accepted:
            return _State(t_s, after, Update("used", innovation), 0, t_s)
        if before.rejected + 1 < _MOST_REJECTED:
            return _State(t_s, mekf, Update("rejected", innovation), before.rejected + 1, before.accepted_s)
        off_rad = mekf.head_attitude(measured.head).angle_to(measured.attitude)
        noise = self.noise
        usual = noise.bias_sigma_rad_s if isinstance(noise, GyroNoise) else noise.rate_sigma_rad_s
        after.restart(*measured, max(usual, off_rad / max(t_s - before.accepted_s, _LEAST_STEP_S)))
        return _State(t_s, after, Update("restarted", innovation), 0, t_s)

    def _forget(self) -> None:
        """Discard events older than the memory."""
        cut = bisect_left(self._events, self._events[-1].t_s - self.memory_s, key=lambda e: e.t_s)
        if cut == 0:
            return
        self._replay()
        self._base = self._states[cut - 1]
        del self._events[:cut], self._states[:cut]
        keep = bisect_right(self._samples, self._base.t_s, key=lambda s: s.end_s)
        del self._samples[:keep]
