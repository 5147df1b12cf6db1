"""Tracking from frame to frame: predict, search at the predicted positions, match, filter; otherwise lost in space.

Each update tries in turn, until one succeeds: windows around the predicted stars; the whole frame near the prediction;
the whole frame and the whole sky. The last two are the tracker's `solve`, so that tracking succeeds whenever that does,
with the same criterion: the probability of a chance match (`IdentificationSettings.false_alarm_rate`).
"""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.arguments import ABOVE_0, of_kind, plain, real_array, real_number
from startracker.core import FloatArray
from startracker.display import described
from startracker.field_solution import STATED_PX, unsolved
from startracker.front_end import Clock
from startracker.geometry.attitude import Attitude, camera_attitude
from startracker.identification.acceptance import accepts
from startracker.inputs import GivenImage, given_image
from startracker.inputs import plain as plain_array
from startracker.observer import Observer, corrects_aberration
from startracker.settings import TrackingSettings
from startracker.settings.checks import settings_or_default
from startracker.solution import Solution, Status
from startracker.tracker import StarTracker
from startracker.tracking.candidates import (
    Candidates,
    Expected,
    Sky,
    as_pixels,
    given_candidates,
    measure_windows,
    streak_px,
    window_half,
)
from startracker.tracking.checked import checked_rate
from startracker.tracking.consistency import Scatter, at_least_stated
from startracker.tracking.following import Followed
from startracker.tracking.mekf import GyroNoise, Innovation, Mekf, RateNoise
from startracker.tracking.standstill import FrameMemory, list_key
from startracker.tracking.state import FrameClock, TrackingState
from startracker.tracking.watched import WatchedFilter


class TrackingSession:
    """Attitudes of one camera over time.

    Parameters
    ----------
    tracker : StarTracker
        The star tracker, which solves frames without a prediction.
    noise : RateNoise or GyroNoise
        Motion of the camera between frames: nearly constant rate, or as measured by a gyro.
    settings : TrackingSettings
        Settings of tracking.
    exposure_s : float
        Exposure time, which with the rate determines the length of star images and windows. Frames of the simulator
        state their own.

    Notes
    -----
    A solution's attitude is the filter's, with its covariance, from this and all previous frames. Times are those
    of mid-exposure. A repeated frame has the status ``stale``, one without a usable time ``bad_time``; neither has an
    attitude, and `filter_attitude` is the prediction. Updates from several threads are serialised.
    """

    def __init__(
        self,
        tracker: StarTracker,
        noise: RateNoise | GyroNoise | None = None,
        *,
        settings: TrackingSettings | None = None,
        exposure_s: float = 0.0,
    ) -> None:
        self.tracker = of_kind("tracker", tracker, StarTracker)
        self.noise = RateNoise() if noise is None else of_kind("noise", noise, (RateNoise, GyroNoise))
        self.settings = settings_or_default("settings", settings, TrackingSettings)
        self.exposure_s = real_number("exposure_s", exposure_s, unit="s", least=0.0)
        self.state = TrackingState()
        self._watched = self._new_filter()
        self._clock, self._scatter, self._memory = FrameClock(), Scatter(), FrameMemory()
        self._frame: NDArray[Any] | bytes | None = None
        self._used_s: float | None = None
        self._note = ""
        self._observer: Observer | None = None
        self._sky = Sky(tracker.guide, tracker.camera.pixel_rad)
        self._lock = threading.RLock()

    def __repr__(self) -> str:
        now = f"{self.state.mode}, {self._filter!r}" if self._filter else "no attitude yet"
        return described("TrackingSession", now, repr(self.tracker.camera))

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._lock = threading.RLock()

    def _new_filter(self) -> WatchedFilter:
        return WatchedFilter(self.noise, self.settings.false_rejection, self.tracker.direction_estimator)

    # ------------------------------------------------------------------ what the filter knows
    @property
    def _filter(self) -> Mekf | None:
        return self._watched.mekf

    @property
    def filter_attitude(self) -> Attitude | None:
        """Attitude of the filter at the last update, solved or not; None before the first solution."""
        return self._filter.attitude if self._filter else None

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance (6, 6) of the filter: attitude in camera axes, and rate or bias."""
        return self._watched.covariance

    @property
    def rate_rad_s(self) -> FloatArray | None:
        """Rate (3,) of the camera in its own axes."""
        return self._filter.rate_rad_s if self._filter else None

    @property
    def bias_rad_s(self) -> FloatArray | None:
        """Bias (3,) of the gyro; zero without a gyro."""
        return self._filter.bias_rad_s if self._filter else None

    def reset(
        self, attitude: Attitude | None = None, sigma_deg: float = 1.0, rate_rad_s: ArrayLike | None = None
    ) -> None:
        """Reset the session, or start from an attitude from another source.

        Parameters
        ----------
        attitude : Attitude or scipy Rotation, optional
            ICRS to camera, at the time of the next frame.
        sigma_deg : float or astropy Quantity
            Standard deviation of the attitude about each axis, degrees.
        rate_rad_s : array_like or astropy Quantity, shape (3,), optional
            Rate of the camera, camera axes.
        """
        if attitude is not None:
            attitude = camera_attitude("attitude", attitude)
        sigma_deg = real_number("sigma_deg", sigma_deg, unit="deg", least=ABOVE_0)
        if rate_rad_s is not None:
            rate_rad_s = checked_rate(plain(rate_rad_s, "rad/s", "rate_rad_s"), "rate_rad_s")
        with self._lock:
            self._watched = self._new_filter()
            self._clock, self._scatter, self._memory = FrameClock(), Scatter(), FrameMemory()
            self.state, self._used_s = TrackingState(), None
            if attitude is not None:
                self._watched.begin(attitude, np.eye(3) * math.radians(sigma_deg) ** 2, rate_rad_s)

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
        """Attitude of an image taken at a time.

        Parameters
        ----------
        image, observer, saturation_dn, gain_e_per_dn
            As in `StarTracker.solve`. The exposure time of a frame replaces `exposure_s` of the session.
        t_s : float or astropy Quantity
            Mid-exposure, seconds of any uniform clock.
        gyro_rad_s : array_like or astropy Quantity, shape (3,), optional
            Mean measured rate since the last frame, camera axes. Non-finite samples are ignored.

        Returns
        -------
        Solution
            With the attitude of the filter. `state` describes how it was obtained.

        Raises
        ------
        InputError
            For a time that is not a number, or a gyro rate that is not three numbers or given without a gyro.
        """
        with self._lock:
            clock, given = Clock(), given_image(image, observer, None, saturation_dn, gain_e_per_dn)
            pixels = as_pixels(given.image)
            refused = self._begin(t_s, gyro_rad_s, self._memory.image_repeats(pixels), given.observer)
            if refused is not None:
                return self._refuse(*refused, np.empty((0, 2)), clock)
            self._frame = pixels
            return self._update_image(given, clock)

    def _update_image(self, given: GivenImage, clock: Clock) -> Solution:
        expected, accepted = self._expect(given.observer), None
        if expected is not None and self._filter is not None:
            length = streak_px(self.tracker, self._filter.rate_rad_s, given.exposure_s or self.exposure_s)
            covariance, largest_half = self._filter.attitude_covariance, self.settings.max_window_px
            half = window_half(self.tracker, expected, covariance, length, largest_half)
            detector = given.saturation_dn, given.gain_e_per_dn
            seen = measure_windows(given.image, self.tracker, expected, half, length, self._scatter.factor, *detector)
            clock.lap("windows")
            followed = self._follow(seen, expected)
            if self._accepts(followed):
                if not followed.hides_a_part(self.tracker.camera):
                    return self._tracked(followed, clock)
                accepted = followed
        prior, prior_deg = self._watched.prior(self.settings.prior_limit_deg)
        found = self.tracker.solve(given, prior=prior, prior_deg=prior_deg)
        if accepted is not None and found.status is Status.SATURATED:  # which is why a part is hidden
            return self._tracked(accepted, clock)
        followed = None
        if not found.solved and expected is not None:
            # windows contain chance neighbours; over the whole frame a few stars at predicted positions have more
            # weight
            seen = given_candidates(self.tracker, found.centroids, None, max(self._scatter.factor, 1.0))
            followed = self._follow(seen, expected)
        return self._whole_frame(found, followed, prior, prior_deg, clock, None)

    def update_centroids(
        self,
        xy: ArrayLike,
        flux: ArrayLike | None,
        t_s: float,
        *,
        gyro_rad_s: ArrayLike | None = None,
        observer: Observer | None = None,
    ) -> Solution:
        """Attitude from given star positions; parameters as in `update` and `StarTracker.solve_centroids`.

        The centroid error is estimated from the residuals of previous frames.
        """
        with self._lock:
            of_kind("observer", observer, (Observer, type(None)))
            clock, points = Clock(), real_array("centroids", plain_array(xy), finite=False)
            if flux is not None:
                flux = real_array("fluxes", plain_array(flux), finite=False)
            key = list_key(points)
            refused = self._begin(t_s, gyro_rad_s, self._memory.list_repeats(key), observer)
            if refused is not None:
                return self._refuse(*refused, points if key else np.empty((0, 2)), clock)
            self._frame = key
            followed = self._follow_centroids(points, flux, observer)
            if self._accepts(followed):
                return self._tracked(followed, clock)
            prior, prior_deg = self._watched.prior(self.settings.prior_limit_deg)
            found = self.tracker.solve_centroids(xy, flux, prior=prior, prior_deg=prior_deg, observer=observer)
            return self._whole_frame(found, followed, prior, prior_deg, clock, STATED_PX)

    # ------------------------------------------------------------------ prediction
    def _begin(
        self, t_s: float, gyro_rad_s: ArrayLike | None, same_as_s: float | None, observer: Observer | None
    ) -> tuple[Status, str] | None:
        """Propagate to a frame's time; returns status and reason of a frame that cannot be used."""
        t_s, gyro_rad_s = plain(t_s, "s", "t_s"), plain(gyro_rad_s, "rad/s", "gyro_rad_s")
        gyro, self._note = self._watched.sample(gyro_rad_s)
        now_s = self._clock.read(t_s)
        self._watched.distrusted, self._watched.without_observer = False, not corrects_aberration(observer)
        self._frame, self._observer = None, observer
        fault = self._clock.fault(now_s)
        if not fault and now_s == self._used_s and same_as_s is None:
            fault = f"another frame has the same time, {now_s} s: the rotation since then is unknown"
        if fault:
            return Status.BAD_TIME, fault
        if self._clock.is_before(now_s):
            self._note = f"the clock was set back from {self._clock.now_s} s; the filter was restarted"
            self._watched.forget()
        self._watched.predict(self._clock.advance(now_s), gyro)
        if same_as_s is not None:
            return Status.STALE, f"the frame has exactly the same stars as the one at {same_as_s} s"
        return None

    def _refuse(self, status: Status, reason: str, xy: FloatArray, clock: Clock) -> Solution:
        """Solution of a frame that is not used."""
        self.state = TrackingState("coasting", note=self._note)
        refused = unsolved(self.tracker.camera, status, self._with_note(reason), clock, xy)
        return replace(refused, catalog=self.tracker.guide.catalog.provenance)

    def _with_note(self, reason: str) -> str:
        return f"{reason}; {self._note}" if self._note else reason

    def _expect(self, observer: Observer | None) -> Expected | None:
        """Guide stars at their predicted positions; None without a useful prediction."""
        if self._filter is None or self._watched.uncertainty_rad > 0.5 * self.tracker.guide.half_diagonal_rad:
            return None
        expected = self._sky.expected(self._filter.matrix, observer, self.settings.max_stars)
        return expected if len(expected.index) else None

    # ------------------------------------------------------------------ following
    def _follow(self, seen: Candidates | None, expected: Expected) -> Followed | None:
        """The frame matched with the prediction; None if it cannot be, or only the tracker can judge it."""
        if seen is None:
            return None
        followed = self._watched.follow(self.tracker.camera, seen, expected, self.tracker.identification)
        return None if followed is None or followed.is_doubtful(self.tracker.camera) else followed

    def _follow_centroids(
        self, points: FloatArray, flux: ArrayLike | None, observer: Observer | None
    ) -> Followed | None:
        expected = self._expect(observer)
        fits = points.ndim == 2 and points.shape[1] == 2 and (flux is None or np.size(flux) == len(points))
        if expected is None or not fits:  # the tracker reports invalid input
            return None
        signal = None if flux is None else np.asarray(flux, dtype=float).reshape(-1)
        return self._follow(given_candidates(self.tracker, points, signal, self._scatter.factor), expected)

    def _accepts(self, followed: Followed | None) -> TypeGuard[Followed]:
        """Whether a followed frame is accepted by the rule of `identification.acceptance`."""
        return followed is not None and accepts(followed.log_chance, self.tracker.identification)

    def _used(self, xy: FloatArray) -> float:
        """Remember a frame used by the filter, by its list or its identified stars (M, 2); returns its time."""
        now_s = self._clock.now_s
        assert now_s is not None
        if isinstance(self._frame, bytes):
            self._memory.keep_list(now_s, self._frame)
        else:
            self._memory.keep_image(now_s, self._frame, xy)
        self._frame, self._used_s = None, now_s
        return now_s

    def _tracked(self, followed: Followed, clock: Clock) -> Solution:
        """Solution of a frame that was followed."""
        seen, stars = followed.seen, followed.stars
        alone = followed.star_attitude(self.tracker.camera) if self._watched.has_gyro else None
        if fault := self._watched.contradiction(alone):
            return self._refuse(Status.GYRO_MISMATCH, fault, seen.xy, clock)
        self._watched.take_followed(followed)
        self._watched.add_star_attitude(alone)
        self._watched.mark_solved(self._used(seen.xy[stars]))
        self._scatter.add(followed.residual_px, seen.stated_px[stars])
        self.state = TrackingState(
            mode="tracking",
            solved=True,
            windows=seen.windows,
            expected=len(followed.expected.index),
            matched=len(stars),
            log_chance=followed.log_chance,
            innovation=followed.innovation,
            distrusted=self._watched.distrusted,
            note=self._note,
            window_xy=seen.window_xy,
            window_half_px=seen.window_half_px,
        )
        clock.lap("tracking")
        times_ms, note = clock.times_ms(), self._with_note("")
        return followed.solution(self.tracker, self._watched.attitude_covariance, note, times_ms, self._observer)

    # ------------------------------------------------------------------ the whole frame
    def _whole_frame(
        self,
        found: Solution,
        followed: Followed | None,
        prior: Attitude | None,
        prior_deg: float,
        clock: Clock,
        stated_px: float | None,
    ) -> Solution:
        """Solution of a frame processed by the tracker."""
        if found.attitude is None or found.covariance is None:
            if self._accepts(followed):
                return self._tracked(followed, clock)
            matched: int = 0
            innovation: Innovation | None = None
            if followed is not None:  # too few for an attitude, but used by the filter
                innovation, matched = followed.innovation, len(followed.stars)
                self._watched.take_followed(followed)
                self._used(followed.seen.xy[followed.stars])
            self.state = TrackingState("lost_in_space", matched=matched, innovation=innovation, note=self._note)
            return replace(found, reason=self._with_note(found.reason), times_ms=clock.times_ms())
        within = prior is not None and found.attitude.angle_to(prior) <= math.radians(prior_deg) * math.sqrt(3.0)
        mode = "prior" if within else "lost_in_space"
        covariance = self._watched.own_covariance(found.attitude, found.covariance)
        alone = found.attitude.quat, covariance
        if fault := self._watched.contradiction(alone):
            return self._refuse(Status.GYRO_MISMATCH, fault, found.centroids, clock)
        if stated_px is not None:
            stars = found.stars.fitted
            self._scatter.begin(stars.residual_px, np.full(len(stars), stated_px))
            covariance = at_least_stated(covariance, self.tracker.camera, stars.xy, stated_px)
        innovation, restarted = self._watched.take_attitude(self._used(found.stars.xy), found.attitude, covariance)
        self._watched.add_star_attitude(alone)
        self.state = TrackingState(
            mode,
            True,
            matched=found.matched,
            innovation=innovation,
            restarted=restarted,
            distrusted=self._watched.distrusted,
            note=self._note,
        )
        found = replace(found, reason=self._with_note(found.reason), times_ms={**found.times_ms, **clock.times_ms()})
        return replace(found, attitude=self.filter_attitude, covariance=self._watched.attitude_covariance)
