"""From frame to frame: predict, look where the stars should be, match, filter; lost in space wherever that fails.

Each update tries in turn, until one holds: the windows of the predicted stars; the whole frame around the prediction;
the whole frame and the whole sky. The later ones are the tracker's own `solve`, so that tracking answers whenever that
does, and by the same standard: what is matched must be beyond chance (`IdentificationSettings.false_alarm_rate`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.attitude import Attitude
from startracker.errors import InputError
from startracker.estimation.wahba import attitude_covariance
from startracker.front_end import Clock
from startracker.observer import Observer
from startracker.settings import TrackingSettings
from startracker.solution import MatchedStars, Solution, Status
from startracker.tracker import STATED_PX, StarTracker
from startracker.tracking.following import Followed, follow
from startracker.tracking.looking import Expected, Seen, Sky, centroids_seen, look
from startracker.tracking.mekf import GyroNoise, Innovation, Mekf, RateNoise
from startracker.tracking.scatter import Scatter

__all__ = ["TrackingSession", "TrackingState"]

FloatArray = NDArray[np.float64]

_PRIOR_SIGMAS = 5.0
_LEAST_PRIOR_DEG = 0.1
_FEW_STARS = 6


@dataclass(frozen=True)
class TrackingState:
    """How the last update went.

    Parameters
    ----------
    mode : str
        ``tracking``, ``prior`` (whole frame, around the prediction) or ``lost_in_space``.
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
    window_xy: FloatArray | None = field(default=None, compare=False)
    window_half_px: int = 0


class TrackingSession:
    """Attitudes of one camera over time.

    Parameters
    ----------
    tracker : StarTracker
        The star tracker; it does the frames for which there is no prediction.
    noise : RateNoise or GyroNoise
        How the camera moves between frames: at a rate that changes little, or as a gyro measures.
    settings : TrackingSettings
        Knobs.
    exposure_s : float
        Exposure time: star images are longer by the rate times it, and windows with them.

    Notes
    -----
    A solution's attitude is the filter's, with its covariance: what this frame and all before it tell. Times are those
    of mid-exposure.
    """

    def __init__(
        self,
        tracker: StarTracker,
        noise: RateNoise | GyroNoise | None = None,
        *,
        settings: TrackingSettings | None = None,
        exposure_s: float = 0.0,
    ) -> None:
        if not (math.isfinite(exposure_s) and exposure_s >= 0.0):
            raise InputError(f"an exposure lasts zero seconds or more; got {exposure_s}")
        self.tracker = tracker
        self.noise = noise or RateNoise()
        self.settings = settings or TrackingSettings()
        self.exposure_s = exposure_s
        self.state = TrackingState()
        self._filter: Mekf | None = None
        self._now, self._started = 0.0, False
        self._scatter = Scatter()
        self._sky = Sky(tracker.guide)
        self._solved: tuple[float, Attitude] | None = None

    # ------------------------------------------------------------------ what the filter knows
    @property
    def filter_attitude(self) -> Attitude | None:
        """Filter's attitude at the last update, solved or not; None before the first solution."""
        return self._filter.attitude if self._filter else None

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance (6, 6) of the filter: attitude in camera axes, and rate or bias."""
        return self._filter.covariance if self._filter else None

    @property
    def rate_rad_s(self) -> FloatArray | None:
        """Camera's rate (3,) in its own axes."""
        return self._filter.rate_rad_s if self._filter else None

    @property
    def bias_rad_s(self) -> FloatArray | None:
        """Gyro's bias (3,); zero without a gyro."""
        return self._filter.bias_rad_s if self._filter else None

    def reset(
        self, attitude: Attitude | None = None, sigma_deg: float = 1.0, rate_rad_s: ArrayLike | None = None
    ) -> None:
        """Forget everything, or start from an attitude known otherwise.

        Parameters
        ----------
        attitude : Attitude, optional
            ICRS to camera, at the next frame's time.
        sigma_deg : float
            Its standard deviation about each axis.
        rate_rad_s : array_like, optional
            Camera's rate.
        """
        self._filter, self._solved, self.state = None, None, TrackingState()
        self._started, self._scatter = False, Scatter()
        if attitude is not None:
            if not (math.isfinite(sigma_deg) and sigma_deg > 0.0):
                raise InputError(f"sigma_deg must be a positive angle in degrees; got {sigma_deg}")
            self._filter = Mekf(attitude, np.eye(3) * math.radians(sigma_deg) ** 2, self.noise, rate_rad_s)

    # ------------------------------------------------------------------ frames
    def update(
        self,
        image: ArrayLike,
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
            As in `StarTracker.solve`.
        t_s : float
            Mid-exposure, seconds on any clock that runs evenly.
        gyro_rad_s : array_like, shape (3,), optional
            Mean measured rate since the last frame, camera axes.

        Returns
        -------
        Solution
            Its attitude is the filter's. `state` tells how it came about.

        Raises
        ------
        InputError
            For a time before the last frame's.
        """
        clock = Clock()
        self._predict(t_s, gyro_rad_s)
        expected = self._expect(observer)
        if expected is not None and self._filter is not None:
            across_x, across_y, about = self._filter.rate_rad_s
            turn = math.hypot(across_x, across_y) + abs(about) * self.tracker.guide.half_diagonal_rad
            streak_px = turn * self.exposure_s / self.tracker.camera.pixel_rad
            seen = look(
                image,
                self.tracker,
                expected,
                self._filter.attitude_covariance,
                streak_px,
                self.settings.max_window_px,
                self._scatter.factor,
                saturation_dn,
                gain_e_per_dn,
            )
            clock.lap("windows")
            followed = self._follow(seen, expected)
            if followed is not None and self._sure(followed):
                return self._tracked(followed, clock)
        prior, prior_deg = self._prior()
        found = self.tracker.solve(
            image,
            prior=prior,
            prior_deg=prior_deg,
            observer=observer,
            saturation_dn=saturation_dn,
            gain_e_per_dn=gain_e_per_dn,
        )
        followed = None
        if not found.solved and expected is not None:
            # windows hold chance neighbours; over the whole frame a few stars just where predicted weigh more
            seen = centroids_seen(self.tracker, found.centroids, None, max(self._scatter.factor, 1.0))
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
        """Attitude of star positions measured elsewhere; parameters as in `update` and `StarTracker.solve_centroids`.

        The centroids' error is told by the residuals of the frames before.
        """
        clock = Clock()
        self._predict(t_s, gyro_rad_s)
        followed = self._follow_centroids(xy, flux, observer)
        if followed is not None and self._sure(followed):
            return self._tracked(followed, clock)
        prior, prior_deg = self._prior()
        found = self.tracker.solve_centroids(xy, flux, prior=prior, prior_deg=prior_deg, observer=observer)
        return self._whole_frame(found, followed, prior, prior_deg, clock, STATED_PX)

    # ------------------------------------------------------------------ prediction
    def _predict(self, t_s: float, gyro_rad_s: ArrayLike | None) -> None:
        if not math.isfinite(t_s):
            raise InputError(f"a frame's time must be a number of seconds; got {t_s}")
        if self._started and t_s < self._now:
            raise InputError(f"frames come in order of time: this one is at {t_s} s, the last was at {self._now} s")
        if gyro_rad_s is not None and not isinstance(self.noise, GyroNoise):
            raise InputError("this session has no gyro: give it noise=GyroNoise(...), or leave gyro_rad_s out")
        if self._filter is not None and self._started:
            self._filter.predict(t_s - self._now, gyro_rad_s)
            if not self._uncertainty() < math.pi / 2.0:  # nothing is known any more
                self._filter = None
        self._now, self._started = float(t_s), True

    def _uncertainty(self) -> float:
        """Largest standard deviation of the predicted attitude about any axis, rad."""
        assert self._filter is not None
        return math.sqrt(sum(self._filter.attitude_covariance.diagonal().tolist()))

    def _prior(self) -> tuple[Attitude | None, float]:
        """Prediction as the identification takes it: an attitude and its largest error, degrees."""
        if self._filter is None:
            return None, 1.0
        width = max(math.degrees(_PRIOR_SIGMAS * self._uncertainty()), _LEAST_PRIOR_DEG)
        return (self._filter.attitude, width) if width <= self.settings.prior_limit_deg else (None, 1.0)

    def _expect(self, observer: Observer | None) -> Expected | None:
        """Guide stars where the prediction puts them; None without a prediction that helps."""
        if self._filter is None or self._uncertainty() > 0.5 * self.tracker.guide.half_diagonal_rad:
            return None
        expected = self._sky.expected(self._filter.matrix, observer, self.settings.max_stars)
        return expected if len(expected.index) else None

    # ------------------------------------------------------------------ following
    def _follow(self, seen: Seen | None, expected: Expected) -> Followed | None:
        if seen is None or self._filter is None:
            return None
        return follow(self._filter, self.tracker.camera, seen, expected, self.settings.false_rejection)

    def _follow_centroids(self, xy: ArrayLike, flux: ArrayLike | None, observer: Observer | None) -> Followed | None:
        expected = self._expect(observer)
        points = np.asarray(xy, dtype=float)
        fits = points.ndim == 2 and points.shape[1] == 2 and (flux is None or np.size(flux) == len(points))
        if expected is None or not fits:  # for what does not fit the tracker has words
            return None
        signal = None if flux is None else np.asarray(flux, dtype=float).reshape(-1)
        return self._follow(centroids_seen(self.tracker, points, signal, self._scatter.factor), expected)

    def _sure(self, followed: Followed) -> bool:
        return followed.log_chance <= math.log(self.tracker.identification.false_alarm_rate)

    def _tracked(self, followed: Followed, clock: Clock) -> Solution:
        """Answer of a frame that was followed."""
        camera, guide, seen, stars = self.tracker.camera, self.tracker.guide, followed.seen, followed.stars
        self._filter = followed.filter
        self._scatter.add(followed.residual_px, seen.stated_px[stars])
        chosen = followed.expected.index[followed.partner]
        expected = len(followed.expected.index)
        attitude = followed.filter.attitude
        self._solved = (self._now, attitude)
        self.state = TrackingState(
            "tracking",
            True,
            seen.windows,
            expected,
            len(stars),
            followed.log_chance,
            followed.innovation,
            window_xy=seen.window_xy,
            window_half_px=seen.window_half_px,
        )
        clock.lap("tracking")
        return Solution(
            Status.SOLVED,
            f"tracked: {len(stars)} of {len(seen.xy)} stars are where predicted, {expected} expected; "
            f"by chance with probability 1e{math.floor(followed.log_chance / math.log(10.0))}",
            attitude,
            followed.filter.attitude_covariance,
            MatchedStars(
                seen.xy[stars],
                guide.catalog.id[chosen],
                guide.catalog.star_name[chosen],
                guide.v_mag[chosen],
                seen.flux[stars],
                followed.residual_px,
            ),
            seen.xy,
            camera.fov_deg,
            camera.parity,
            clock.times_ms(),
            camera,
        )

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
        """Answer of a frame that the tracker has worked on."""
        if found.attitude is None or found.covariance is None:
            if followed is not None and self._sure(followed):
                return self._tracked(followed, clock)
            matched: int = 0
            innovation: Innovation | None = None
            if followed is not None:  # too few for an attitude, but the filter learns from them
                self._filter, innovation, matched = followed.filter, followed.innovation, len(followed.stars)
            self.state = TrackingState("lost_in_space", matched=matched, innovation=innovation)
            return replace(found, times_ms=clock.times_ms())
        mode = "lost_in_space"
        if prior is not None and found.attitude.angle_to(prior) <= math.radians(prior_deg) * math.sqrt(3.0):
            mode = "prior"
        covariance = found.covariance
        if stated_px is not None:
            stars = found.stars.fitted
            self._scatter.begin(stars.residual_px, np.full(len(stars), stated_px))
            if len(stars) < _FEW_STARS:  # residuals so few can be small by luck
                sigma = np.full(len(stars), stated_px * self.tracker.camera.pixel_rad)
                stated = attitude_covariance(self.tracker.camera.unproject(stars.xy), sigma)
                covariance = covariance * max(1.0, float(np.trace(stated) / np.trace(covariance)))
        innovation = None
        if self._filter is not None:
            innovation = self._filter.update_attitude(found.attitude, covariance, self.settings.false_rejection)
        restarted = innovation is None or not innovation.accepted
        if restarted:
            self._restart(found.attitude, covariance)
        assert self._filter is not None
        self._solved = (self._now, self._filter.attitude)
        self.state = TrackingState(mode, True, matched=found.matched, innovation=innovation, restarted=restarted)
        return replace(
            found,
            attitude=self._filter.attitude,
            covariance=self._filter.attitude_covariance,
            times_ms={**found.times_ms, **clock.times_ms()},
        )

    def _restart(self, attitude: Attitude, covariance: FloatArray) -> None:
        """Begin from an attitude that the prediction did not foresee; how far it is off bounds the rate."""
        if self._filter is None:
            self._filter = Mekf(attitude, covariance, self.noise)
            return
        second = None
        if isinstance(self.noise, RateNoise) and self._solved is not None:
            t_s, before = self._solved
            turn = before.angle_to(attitude) / max(self._now - t_s, 1e-3)
            second = max(self.noise.rate_sigma_rad_s, turn)
        self._filter.reset(attitude, covariance, np.zeros(3), second)
