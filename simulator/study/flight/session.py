"""The flight build from frame to frame, as its users' programs call it: prediction, identification near it, filter.

It has the interface of `startracker.TrackingSession`. The filter is the C's own, with the motion that was exported.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from simulator.study.flight.engine import FlightEngine, known_of, prior_numbers, star_list
from simulator.study.flight.library import NO_PRIOR, Known
from startracker.core import FloatArray
from startracker.display import described
from startracker.flight.following import (
    BEGUN,
    COASTING,
    DISTRUSTED,
    REJECTED,
    RESTARTED,
    TIME_BAD,
    TIME_SET_BACK,
    USED,
)
from startracker.front_end import Clock
from startracker.geometry.attitude import Attitude
from startracker.identification.observed import as_prior
from startracker.inputs import given_image
from startracker.observer import Observer
from startracker.solution import Solution, Status
from startracker.tracking import GyroNoise, Innovation, RateNoise, TrackingState

_COMPONENTS = 3
"""Number of components of an innovation: the C filters attitudes."""
_MICRO, _ONE_RAD_S = 1e6, float(1 << 30)
"""Units of times and gyro rates."""


class FlightSession:
    """Attitudes of one camera over time by its flight build.

    Parameters
    ----------
    engine : FlightEngine
        The engine; its library keeps the filter, and must not be used by another session.

    Notes
    -----
    The C does not use windows: a frame that is identified near the prediction has the mode ``prior``. An attitude that
    contradicts the filter is a solution of its frame, and the mode is ``coasting`` as the filter does not use it.
    """

    def __init__(self, engine: FlightEngine) -> None:
        self.tracker, self._library = engine, engine.library
        self.exposure_s = 0.0
        self.reset()

    def __repr__(self) -> str:
        return described("FlightSession", self.state.mode, repr(self.tracker.camera))

    # ------------------------------------------------------------------ what the filter knows
    @property
    def noise(self) -> RateNoise | GyroNoise:
        """Motion of the camera between frames that was exported."""
        return self.tracker.design.motion

    @property
    def filter_attitude(self) -> Attitude | None:
        """Attitude of the filter at the last update; None before the first solution."""
        state = self._library.filter()
        return None if state is None else Attitude(state.quaternion, "icrs", "camera")

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance (6, 6) of the filter: attitude in camera axes, and rate or bias."""
        state = self._library.filter()
        return None if state is None else state.covariance

    @property
    def rate_rad_s(self) -> FloatArray | None:
        """Rate (3,) of the camera in its own axes."""
        state = self._library.filter()
        return None if state is None else state.rate_rad_s

    @property
    def bias_rad_s(self) -> FloatArray | None:
        """Bias (3,) of the gyro; zero without a gyro."""
        state = self._library.filter()
        return None if state is None else state.bias_rad_s

    def reset(self, attitude: Attitude | None = None, sigma_deg: float = 1.0) -> None:
        """Forget the filter; an attitude from other sensors is the prior of frames until the first solution.

        Parameters
        ----------
        attitude : Attitude, optional
            ICRS to camera, at the time of the next frame.
        sigma_deg : float
            Its standard deviation about each axis, degrees. The prior is a uniform distribution of this deviation, with
            a radius of √3 times as much.
        """
        self._library.forget()
        self.state = TrackingState()
        self._first = prior_numbers(as_prior(attitude, math.sqrt(3.0) * sigma_deg))

    # ------------------------------------------------------------------ frames
    def update(
        self,
        image: Any,
        t_s: float,
        *,
        gyro_rad_s: ArrayLike | None = None,
        observer: Observer | None = None,
        saturation_dn: float | None = None,
        gain_e_per_dn: float | None = None,
    ) -> Solution:
        """Attitude of an image taken at a time; parameters as in `startracker.TrackingSession.update`."""
        clock, given = Clock(), given_image(image, observer, None, saturation_dn, gain_e_per_dn)
        known = self._predict(t_s, gyro_rad_s, given.observer)
        if known is None:
            return self._bad_time(t_s, clock)
        if fault := self.tracker.read(given.image, known):
            return self.tracker.refused(Status.BAD_IMAGE, fault, clock)
        clock.lap("detection")
        self._library.finish()
        clock.lap("identification")
        return self._follow(known, given.observer, clock)

    def update_centroids(
        self,
        xy: ArrayLike,
        flux: ArrayLike | None,
        t_s: float,
        *,
        gyro_rad_s: ArrayLike | None = None,
        observer: Observer | None = None,
        sigma_px: ArrayLike = 0.1,
    ) -> Solution:
        """Attitude of star positions measured at a time, brightest first."""
        clock, known = Clock(), self._predict(t_s, gyro_rad_s, observer)
        if known is None:
            return self._bad_time(t_s, clock)
        signal = np.ones(np.size(xy) // 2) if flux is None else flux
        self._library.solve_stars(star_list(xy, signal, sigma_px), known)
        clock.lap("identification")
        return self._follow(known, observer, clock)

    def _predict(self, t_s: float, gyro_rad_s: ArrayLike | None, observer: Observer | None) -> Known | None:
        """Propagate to a frame's time; returns what is known of the frame, or None if the time cannot be used."""
        gyro = None
        if gyro_rad_s is not None and np.isfinite(np.asarray(gyro_rad_s, dtype=float)).all():
            gyro = np.rint(np.asarray(gyro_rad_s, dtype=float) * _ONE_RAD_S).astype(int).tolist()
        time_us = round(float(t_s) * _MICRO)
        self._time, prior = self._library.predict(time_us, gyro)
        if self._time == TIME_BAD:
            return None
        if self._library.filter() is None:
            prior = self._first
        return known_of(observer)._replace(time_us=time_us, prior=prior)

    def _bad_time(self, t_s: float, clock: Clock) -> Solution:
        self.state = TrackingState("coasting")
        return self.tracker.refused(Status.BAD_TIME, f"{t_s} s is not after the time of the last frame", clock)

    def _follow(self, known: Known, observer: Observer | None, clock: Clock) -> Solution:
        """Give the answer of a frame to the filter; its solution with the filter's attitude."""
        answer, stars = self._library.answer()
        note = "; the clock was set back, and the filter forgotten" if self._time == TIME_SET_BACK else ""
        result = self._library.take()
        solution = self.tracker.solution(answer, stars, observer, clock, note)
        mode, used = "lost_in_space", result not in (REJECTED, COASTING)
        if used:
            self._first = NO_PRIOR
            near = known.prior[-1] > 0 and not solution.prior_contradicted
            mode = "prior" if near else mode
            filtered, _ = self._library.answer()
            solution = replace(solution, attitude=filtered.attitude, covariance=filtered.covariance_rad2)
        self.state = TrackingState(
            "coasting" if result == REJECTED else mode,
            used,
            matched=answer.counts["used"],
            innovation=self._innovation() if result in (USED, DISTRUSTED) else None,
            restarted=result in (BEGUN, RESTARTED),
            distrusted=result == DISTRUSTED,
        )
        return solution

    def _innovation(self) -> Innovation | None:
        """Innovation of the last attitude; None if the filter has just begun a new window."""
        state = self._library.filter()
        if state is None or state.distance2 < 0.0:
            return None
        return Innovation(True, state.distance2, _COMPONENTS)
