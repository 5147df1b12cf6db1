"""The scene at one instant: position and attitude of the spacecraft, and the stars in and around the field.

The stages orbit → pointing → sky in order; independent of pixels.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from simulator.mission.attitude_law import AttitudeLaw, common_span_s
from simulator.mission.clock import Clock
from simulator.mission.parameters import PointingParameters
from simulator.mission.pointing import (
    Pointing,
    deformed,
    hold,
    mounting_of,
    point,
    point_at_random,
    point_by,
    point_spinning,
    round_s,
    turned_to,
)
from simulator.mission.sampling import trial_time_s
from simulator.mission.thermo_elastic import angle_from_noon_rad, mounting_rotation_rad
from simulator.mission.trajectory import Trajectory, geocentric
from simulator.optics.jitter import Spectrum, camera_axes, draw_jitter
from simulator.optics.jitter_series import JitterMotion, JitterSeries, SampledJitter
from simulator.randomness import Streams
from simulator.sky.apparent import SkyIndex, by_declination, largest_shift_rad
from simulator.sky.colours import spectral_coordinates
from simulator.sky.instants import Bodies, Instant, Instants
from simulator.sky.parameters import Sky
from simulator.sky.satellites import Look, SatelliteList, Satellites
from simulator.sky.target import attitude_towards, body_direction, find_target
from startracker.catalog import load_catalog
from startracker.catalog.stars import StarCatalog
from startracker.core import AU_KM, FloatArray, IntArray
from startracker.display import fields_repr
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.observer import Observer

NEAR_BODY_RAD = math.radians(5.0)
"""Angular radius above which a body hides stars and cannot be rendered as a disk; only a body that the spacecraft
orbits is as large."""

BLOCK_TRIALS = 128
"""Trials whose ephemerides are computed together: this shares the overhead of Skyfield's calls, and the arrays fit into
the processor's cache."""


@dataclass(frozen=True, eq=False)
class Scene:
    """The sky from the spacecraft at one instant."""

    t_s: float
    """Seconds after the scenario's epoch."""
    r_km: FloatArray
    """(3,): Position of the spacecraft from the Earth's centre, GCRS."""
    observer: Observer
    """Epoch, barycentric position and velocity."""
    sun_direction: FloatArray
    """(3,): Unit vector from the spacecraft to the Sun, without aberration."""
    pointing: Pointing
    """Attitudes and rate; with jitter the true attitude is the mean over the exposure."""
    jitter: JitterMotion | None
    """Rotation of the camera relative to that attitude during the exposure."""
    streak_rad: float
    """Rotation angle of the camera during the exposure."""
    catalog: StarCatalog
    """All stars of the sky."""
    b_v: FloatArray
    """B − V of every star of the catalogue, by which its spectrum is chosen (`simulator.sky.colours`)."""
    giant: FloatArray
    """Luminosity class of every star of the catalogue: 0 (dwarf) to 1 (giant), or 10 + subtype of an M giant."""
    rows: IntArray
    """(N,): Rows of the stars in and around the field."""
    star_directions: FloatArray
    """(N, 3): Apparent directions of these stars, ICRS axes."""
    bodies: Bodies
    """Sun, Moon and planets, also outside the field."""
    satellites: Satellites | None = None
    """Sunlit satellites in and around the field; None if the sky has none."""

    __repr__ = fields_repr

    @property
    def stars(self) -> StarCatalog:
        """The stars in and around the field as a catalogue."""
        return self.catalog.select(self.rows)


class GivenState(NamedTuple):
    """Values given by a caller; None for those that the trial's random streams determine."""

    at_s: float | None = None
    """Seconds after the scenario's epoch."""
    attitude: Attitude | None = None
    """True attitude of the camera."""
    rate_camera_rad_s: ArrayLike | None = None
    """(3,): Inertial angular velocity in camera axes, for a given attitude."""
    jitter: JitterMotion | None = None
    """Jitter of a sequence relative to this mid-exposure."""


@dataclass(frozen=True)
class SceneParameters:
    """Parameters of scenes, except the orbit."""

    seed: int
    """Seed of the run."""
    sampling: str
    """Sampling of trials: ``mission_year``, ``orbit``, ``span`` or ``sky`` (`simulator.mission.sampling`)."""
    pointing: PointingParameters
    """Mounting, attitude law and jitter."""
    spectrum: Spectrum
    """Spectrum of the jitter."""
    sky: Sky
    """Contents of the sky."""
    series: JitterSeries | None = None
    """Jitter as a time series."""
    exposure_margin_s: float = 0.0
    """Time beyond an exposure in which a rolling shutter exposes rows."""


@functools.lru_cache(maxsize=2)
def _sky_of(catalog: StarCatalog, magnitude_limit: float) -> tuple[SkyIndex, FloatArray, FloatArray]:
    """Index of the stars to a magnitude limit, and B − V and luminosity class of each (N,); cached for the cameras of a
    sweep."""
    stars = by_declination(catalog.brighter_than(magnitude_limit))
    b_v, giant = spectral_coordinates(stars.b_v, stars.spectral_type)
    # The spectral types are not needed any more, and take 80 bytes per star.
    stars = replace(stars, spectral_type=np.full(len(stars), ""))
    return SkyIndex(stars), b_v, giant


class SceneBuilder:
    """Builds scenes of trials with common clock, orbit and catalogue.

    Parameters
    ----------
    parameters : SceneParameters
        Pointing and sky.
    orbit : Trajectory
        Trajectory of the spacecraft.
    law : AttitudeLaw, optional
        Attitude law of the body (`simulator.mission.attitudes`).
    satellites : SatelliteList, optional
        Other satellites.

    Raises
    ------
    InputError
        For a target that is not in the sky.
    """

    def __init__(
        self,
        parameters: SceneParameters,
        orbit: Trajectory,
        law: AttitudeLaw | None = None,
        satellites: SatelliteList | None = None,
    ) -> None:
        self.parameters = parameters
        self.orbit = orbit
        self.law = law
        self.satellites = satellites
        self.span_s = common_span_s(orbit.span_s, *([law.span_s] if law else []))
        """First and last time of trajectory and attitudes, seconds after the epoch."""
        self.clock: Clock = orbit.clock
        self._round_s = round_s(parameters.pointing, orbit.period_s)
        seen = parameters.sky
        self.sky, self._b_v, self._giant = _sky_of(load_catalog(seen.catalog), seen.magnitude_limit)
        # A named target is looked up once; a target given by coordinates needs no catalogue.
        target = parameters.pointing.target
        self._target = find_target(target, self.sky.catalog) if isinstance(target, str) else None
        self._blocks: dict[int, Instants] = {}  # the newest block of trials
        self._plan: tuple[Instants | None, dict[float, int]] = (None, {})  # a block of planned times, and their rows

    def instant(self, index: int) -> Instant:
        """Time of trial `index`, and positions of spacecraft and bodies."""
        block, row = self.block(index)
        return block.at(row)

    def block(self, index: int) -> tuple[Instants, int]:
        """Block of `BLOCK_TRIALS` trials that are computed at once, and the row of trial `index` in it.

        The blocks only depend on the index, so that a trial has the same values independently of other trials and
        workers.
        """
        block, row = divmod(index, BLOCK_TRIALS)
        if block not in self._blocks:
            indices = np.arange(block * BLOCK_TRIALS, (block + 1) * BLOCK_TRIALS)
            given = self.parameters
            t_s = trial_time_s(given.sampling, given.seed, indices, self._round_s, self.span_s)
            # Only the newest block is held: trials are rendered in order, so an older one is not needed again.
            self._blocks = {block: Instants.of(self.orbit, t_s, self.parameters.sky)}
        return self._blocks[block], row

    def plan(self, t_s: ArrayLike) -> None:
        """Compute the ephemerides of times (N,) that will be passed to `scene` as `at_s`, in one block."""
        times = np.array(t_s, dtype=float)
        rows = {time: row for row, time in enumerate(times.tolist())}
        self._plan = (Instants.of(self.orbit, times, self.parameters.sky), rows)

    def instant_at(self, t_s: float) -> Instant:
        """Positions of spacecraft and bodies at a time, seconds after the epoch."""
        planned, rows = self._plan
        if planned is None or t_s not in rows:
            return Instants.of(self.orbit, np.array([t_s]), self.parameters.sky).at(0)
        return planned.at(rows[t_s])

    def scene(
        self,
        index: int,
        streams: Streams,
        half_field_rad: float,
        exposure_s: float,
        given: GivenState = GivenState(),
    ) -> Scene:
        """Scene of trial `index`.

        Parameters
        ----------
        index : int
            Index of the trial.
        streams : callable
            Random stream of a stage by name.
        half_field_rad : float
            Stars up to this angle from the boresight, at any moment of the exposure, are included.
        exposure_s : float
            Exposure time.
        given : GivenState, optional
            Time, attitude, rate and jitter instead of the trial's.
        """
        sky = self.parameters.sky
        now = self.instant(index) if given.at_s is None else self.instant_at(float(given.at_s))
        observer, sun_au = now.observer, now.sun_au
        pointing = self._pointing(now, streams("pointing"), given)
        pointing, jitter = self._jittered(pointing, streams, given.jitter, exposure_s)
        # A star can enter the field during the exposure, so the cap of stars is wider by the streak.
        streak_rad = math.hypot(*pointing.rate_camera_rad_s.tolist()) * exposure_s
        reach_rad = min(half_field_rad + streak_rad, math.pi)
        boresight = pointing.camera.boresight
        self._refuse_near_surface(now, boresight, reach_rad)
        rows = self.sky.near(boresight, reach_rad, observer.epoch_jyear, largest_shift_rad(observer))
        assert observer.position_au is not None
        to_sun = sun_au - observer.position_au
        return Scene(
            t_s=now.t_s,
            r_km=now.r_km,
            observer=observer,
            sun_direction=to_sun / math.hypot(*to_sun.tolist()),
            pointing=pointing,
            jitter=jitter,
            streak_rad=streak_rad,
            catalog=self.sky.catalog,
            b_v=self._b_v,
            giant=self._giant,
            rows=rows,
            star_directions=self.sky.apparent(rows, observer, sun_au, sky),
            bodies=now.bodies,
            satellites=self._satellites(now, boresight, reach_rad, exposure_s),
        )

    def _satellites(
        self, now: Instant, boresight: FloatArray, reach_rad: float, exposure_s: float
    ) -> Satellites | None:
        """Satellites in and around the field; None if the sky has none."""
        if self.satellites is None:
            return None
        observer = now.observer
        assert observer.velocity_km_s is not None
        assert observer.position_au is not None
        look = Look(
            now.t_s,
            exposure_s + self.parameters.exposure_margin_s,
            lambda t_s: geocentric(self.orbit, t_s),
            self.orbit.span_s,
            observer.velocity_km_s - now.v_km_s,  # barycentric velocity of the Earth
            (now.sun_au - observer.position_au) * AU_KM + now.r_km,  # geocentric position of the Sun
            boresight,
            reach_rad,
        )
        return self.satellites.near(look, self.parameters.sky)

    def _pointing(self, now: Instant, rng: np.random.Generator, given: GivenState) -> Pointing:
        """True attitude and rate, without jitter."""
        # The order is the precedence of the laws. The generator is used by the law even if the attitude is given,
        # because the given one has the random prior error of the trial.
        law = self.parameters.pointing
        if law.target is not None:
            pointing = hold(law, self._towards_target(now.observer, now.sun_au, now.bodies), rng)
        elif law.spin.rate_deg_s:
            pointing = point_spinning(law, now.t_s, rng)
        elif self.parameters.sampling == "sky" and given.at_s is None:
            pointing = point_at_random(law, rng, math.tau / self.orbit.period_s)
        elif self.law is not None:
            pointing = point_by(law, self.law, now.t_s, rng)
        else:
            pointing = point(law, now.r_centre_km, now.v_centre_km_s, rng)
        pointing = deformed(pointing, self._mounting_rotation_rad(now))
        if given.attitude is not None:
            pointing = turned_to(pointing, given.attitude, given.rate_camera_rad_s)
        return pointing

    def mounting_rotation_rad(self, t_s: float) -> FloatArray | None:
        """Thermo-elastic rotation vector (3,) of the mounting, camera axes, seconds after the epoch; None if there is
        none."""
        return self._mounting_rotation_rad(self.instant_at(t_s))

    def _mounting_rotation_rad(self, now: Instant) -> FloatArray | None:
        given = self.parameters.pointing.thermo_elastic
        if not any(given.amplitude_arcsec):
            return None
        if given.reference == "node":
            return mounting_rotation_rad(given, math.radians(now.orbit_argument_deg))
        assert now.observer.position_au is not None
        to_sun = now.sun_au - now.observer.position_au
        return mounting_rotation_rad(given, angle_from_noon_rad(now.r_centre_km, now.v_centre_km_s, to_sun))

    def _refuse_near_surface(self, now: Instant, boresight: FloatArray, reach_rad: float) -> None:
        """Raise `InputError` if the surface of a large body other than the Earth may be in the field."""
        bodies = now.bodies
        for k in (bodies.angular_radius_rad > NEAR_BODY_RAD).nonzero()[0]:
            away = math.acos(min(max(float(boresight @ bodies.direction[k]), -1.0), 1.0))
            if away < bodies.angular_radius_rad[k] + reach_rad:
                raise InputError(
                    f"{self.clock.isot(now.t_s)}: {bodies.name[k]}, {math.degrees(bodies.angular_radius_rad[k]):.0f}° "
                    "in radius, is in the field; near surfaces other than the Earth's are not rendered: point the "
                    "camera away from it (pointing.mounting: zenith)"
                )

    def sequence_jitter(self, rng: np.random.Generator, start_s: float) -> JitterMotion | None:
        """Jitter of a sequence relative to its first mid-exposure at `start_s`, None if there is none."""
        given = self.parameters
        jitter, matrix = given.pointing.jitter, mounting_of(given.pointing).as_matrix()
        if given.series is not None:
            return SampledJitter(given.series, start_s, camera_axes(jitter, matrix))
        return draw_jitter(jitter, given.spectrum, rng, matrix, over_sequence=True)

    def _frame_jitter(self, rng: np.random.Generator, exposure_s: float) -> JitterMotion | None:
        """Jitter of a single frame, None if there is none."""
        given = self.parameters
        jitter, matrix = given.pointing.jitter, mounting_of(given.pointing).as_matrix()
        if given.series is not None:
            return given.series.section(jitter, rng, exposure_s + given.exposure_margin_s, matrix)
        return draw_jitter(jitter, given.spectrum, rng, matrix)

    def _jittered(
        self, pointing: Pointing, streams: Streams, jitter: JitterMotion | None, exposure_s: float
    ) -> tuple[Pointing, JitterMotion | None]:
        """True attitude including the mean jitter over the exposure, and the remaining jitter about it."""
        if self.parameters.pointing.jitter.is_off:
            return pointing, None
        jitter = jitter or self._frame_jitter(streams("jitter"), exposure_s)
        if jitter is None:
            return pointing, None
        # A tracker measures the mean attitude over the exposure, so the mean of the jitter belongs to the truth, and
        # only the deviation from it smears the image.
        mean = Attitude.from_rotation_vector(jitter.mean(exposure_s), "camera", "camera")
        camera = mean @ pointing.camera
        jittered = replace(pointing, camera=camera, body=pointing.mounting.inverse @ camera)
        return jittered, jitter.centred(exposure_s)

    def _towards_target(self, observer: Observer, sun_au: FloatArray, bodies: Bodies) -> Attitude:
        """Nominal attitude of the camera, pointed at ``pointing.target``."""
        pointing = self.parameters.pointing
        if isinstance(pointing.target, tuple):
            return Attitude.from_radec_roll(*pointing.target)
        if isinstance(self._target, str):
            return attitude_towards(body_direction(self._target, bodies), pointing)
        assert self._target is not None
        directions = self.sky.apparent(np.array([self._target]), observer, sun_au, self.parameters.sky)
        return attitude_towards(directions[0], pointing)
