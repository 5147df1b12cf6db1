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

from startracker.arguments import ABOVE_0, real_array, real_number
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.fusion.alignments import AlignedMekf
from startracker.fusion.head import Head
from startracker.fusion.state import FusionStatus, HeadRecord, Measurement, State, Update
from startracker.fusion.status import status_of
from startracker.fusion.trust import measured
from startracker.geometry.attitude import Attitude
from startracker.settings.checks import BELOW_1
from startracker.tracking.checked import checked_attitude, checked_covariance, checked_rate, checked_time
from startracker.tracking.mekf import GyroNoise, RateNoise


class _Event(NamedTuple):
    """A time up to which the filter is propagated, and a measurement at it, if any."""

    t_s: float
    rank: int
    """Order at one time: −1 for an end of a gyro sample, then the heads."""
    measurement: Measurement | None = None


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
    An attitude beyond the gate is not used. After three that agree with one another and with the gyro, the filter is
    restarted if no other head contradicts them, with the alignments and the gyro's errors that it knows; otherwise the
    head's mounting has changed, and its alignment is estimated again. A head that others outvoted does not restart the
    filter. `status` says whether the heads and the gyro agree. The first attitude starts the filter; there is no
    estimate before.

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
        if not isinstance(heads, Sequence) or not all(isinstance(head, Head) for head in heads):
            raise InputError("heads must be a list of Head")
        self.heads, self.noise = tuple(heads), noise
        self._names = {head.name: k for k, head in enumerate(heads)}
        if not heads or len(self._names) != len(heads):
            raise InputError("a filter of several heads needs at least one head, each with its own name")
        if not isinstance(noise, (GyroNoise, RateNoise)):
            raise InputError(f"noise must be GyroNoise or RateNoise; got {type(noise).__name__}")
        self.memory_s = real_number("memory_s", memory_s, least=ABOVE_0)
        self.false_rejection = real_number("false_rejection", false_rejection, least=0.0, most=BELOW_1)
        count = len(self.heads)
        self._base = State(-math.inf, None, (HeadRecord(),) * count, (None,) * count)
        self._events: list[_Event] = []
        self._states: list[State] = []
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
            For an interval that is not positive or overlaps another one, a rotation that is not three finite numbers
            or faster than 1000 rad/s, or a filter without a gyro. The filter is as before.
        """
        if not isinstance(self.noise, GyroNoise):
            raise InputError("this filter has no gyro: create it with GyroNoise, or omit the gyro's samples")
        start_s, end_s = checked_time(start_s, "a gyro sample's time"), checked_time(end_s, "a gyro sample's time")
        if not end_s > start_s:
            raise InputError(f"a gyro sample needs an interval of positive length; got {start_s} to {end_s} s")
        turn = real_array("a gyro sample", turn_rad, (3,), unit="rad")
        with np.errstate(over="ignore"):
            rate = checked_rate(turn / (end_s - start_s), "a gyro sample, divided by its interval,")
        if end_s <= self._base.t_s:
            return
        at = bisect_left(self._samples, start_s, key=lambda s: s.start_s)
        before, after = self._samples[max(at - 1, 0) : at], self._samples[at : at + 1]
        if (before and before[0].end_s > start_s) or (after and after[0].start_s < end_s):
            raise InputError(f"gyro samples overlap at {start_s} s")
        self._samples.insert(at, _Sample(start_s, end_s, rate))
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
            For an unknown head, a second attitude of a head at one time, an attitude between other frames, a covariance
            that is not symmetric and positive definite, or a time that is not finite. The filter is as before.
        """
        k = self._index(head)
        t_s = checked_time(t_s, "the time of an attitude")
        event = _Event(
            t_s, k, Measurement(k, checked_attitude(attitude, "icrs", "camera"), checked_covariance(covariance))
        )
        if t_s <= self._base.t_s:
            return Update("too_late")
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
        state = self._state(t_s)
        return state.mekf if state.mekf is None else self._propagated(state.mekf, state.t_s, t_s)

    def status(self, t_s: float) -> FusionStatus:
        """Whether the heads and the gyro agree at a time within the memory or later, from the data up to that time.

        Raises
        ------
        InputError
            For a time before the memory.
        """
        return status_of(self._state(t_s), tuple(self._names), t_s)

    # ------------------------------------------------------------------ details
    def _index(self, head: str | int) -> int:
        """Index of a head."""
        if isinstance(head, str):
            k = self._names.get(head, -1)
        else:
            whole = isinstance(head, (int, np.integer)) and not isinstance(head, bool)
            k = int(head) if whole else -1
        if not 0 <= k < len(self.heads):
            raise InputError(f"unknown head {head!r}; known: {', '.join(self._names)}")
        return k

    def _state(self, t_s: float) -> State:
        """State after the last event up to a time."""
        t_s = checked_time(t_s, "the time of an estimate")
        if not t_s >= self._base.t_s:
            raise InputError(f"{t_s} s is before the memory of the filter, which begins at {self._base.t_s} s")
        self._replay()
        at = bisect_right(self._events, t_s, key=lambda e: e.t_s)
        return self._states[at - 1] if at else self._base

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
            self._states.append(self._after(before, self._events[len(self._states)]))

    def _after(self, before: State, event: _Event) -> State:
        """State after an event."""
        t_s, measurement = event.t_s, event.measurement
        if before.mekf is None:
            return before._replace(t_s=t_s) if measurement is None else self._started(before, t_s, measurement)
        now = before.propagated(t_s, lambda mekf: self._propagated(mekf, before.t_s, t_s))
        return now if measurement is None else measured(now, measurement, self.false_rejection)

    def _started(self, before: State, t_s: float, measurement: Measurement) -> State:
        """State after the first attitude."""
        mekf, head = AlignedMekf(self.heads, *measurement, self.noise), measurement.head
        record = before.records[head]._replace(used=1, used_s=t_s)
        records = (*before.records[:head], record, *before.records[head + 1 :])
        return before._replace(t_s=t_s, mekf=mekf, records=records, update=Update("started"))

    def _propagated(self, mekf: AlignedMekf, from_s: float, t_s: float) -> AlignedMekf:
        """A filter at a later time, before the next event."""
        if t_s <= from_s:
            return mekf
        middle_s = 0.5 * (from_s + t_s)
        at = bisect_right(self._samples, middle_s, key=lambda s: s.start_s)
        sample = self._samples[at - 1] if at else None
        measured = sample is not None and middle_s <= sample.end_s
        later = mekf.copy()
        later.predict(t_s - from_s, sample.rate_rad_s if sample is not None and measured else None)
        return later

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
