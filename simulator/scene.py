"""What the camera could see at one instant: where the spacecraft is, how it is turned, which stars are there.

The stages orbit → pointing → sky in order; nothing here knows of pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.mission.clock import Clock
from simulator.mission.orbit import build_orbit
from simulator.mission.pointing import (
    Pointing,
    hold,
    mounting_of,
    point,
    point_at_random,
    point_spinning,
    round_s,
    turned_to,
)
from simulator.mission.sampling import trial_time_s
from simulator.optics.jitter import JitterPath, draw_jitter, load_spectrum
from simulator.randomness import Streams
from simulator.scenario import Scenario
from simulator.sky.apparent import SkyIndex, by_place
from simulator.sky.colours import spectral_coordinates
from simulator.sky.observer import observe
from simulator.sky.solar_system import Bodies, solar_system, sun_position_au
from simulator.sky.target import attitude_towards, body_direction, find_target
from startracker.attitude import Attitude
from startracker.catalog import load_catalog
from startracker.catalog.stars import StarCatalog
from startracker.observer import Observer

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Scene:
    """The sky from the spacecraft at one instant.

    Parameters
    ----------
    t_s : float
        Seconds after the scenario's epoch.
    r_km : array, shape (3,)
        Position of the spacecraft, GCRS.
    observer : Observer
        Epoch, barycentric position and velocity.
    sun_direction : array, shape (3,)
        Unit vector from the spacecraft to the Sun, without aberration.
    pointing : Pointing
        Attitudes and rate; the true attitude is the mean over the exposure where there is jitter.
    jitter : JitterPath, optional
        Turning of the camera about that attitude during the exposure.
    catalog : StarCatalog
        All stars of the sky.
    rows : int array, shape (N,)
        Those of them in and around the field.
    star_directions : array, shape (N, 3)
        Where each appears, ICRS axes.
    star_b_v, star_giant : array, shape (N,)
        Colour and class of their spectra (`simulator.sky.colours`).
    bodies : Bodies
        Sun, Moon and planets, wherever they are.
    """

    t_s: float
    r_km: FloatArray
    observer: Observer
    sun_direction: FloatArray
    pointing: Pointing
    jitter: JitterPath | None
    catalog: StarCatalog
    rows: IntArray
    star_directions: FloatArray
    star_b_v: FloatArray
    star_giant: FloatArray
    bodies: Bodies

    @property
    def stars(self) -> StarCatalog:
        """The stars in and around the field as a catalogue of their own."""
        return self.catalog.select(self.rows)


class SceneBuilder:
    """Scenes of one scenario's trials; clock, orbit and catalogue are shared.

    Parameters
    ----------
    scenario : Scenario
        The scenario.

    Raises
    ------
    InputError
        For a target that is not in its sky.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.clock = Clock(scenario.epoch)
        self.orbit = build_orbit(scenario.orbit, scenario.epoch)
        self._round_s = round_s(scenario.pointing, self.orbit.period_s)
        catalog = by_place(load_catalog(scenario.sky.catalog).brighter_than(scenario.sky.magnitude_limit))
        self._b_v, self._giant = spectral_coordinates(catalog.b_v, catalog.spectral_type)
        catalog = replace(catalog, spectral_type=np.full(len(catalog), ""))  # 80 bytes a star, and of no more use
        self.sky = SkyIndex(catalog)
        self._jitter = load_spectrum(scenario.pointing.jitter, scenario.base_dir)
        target = scenario.pointing.target
        self._target = find_target(target, catalog) if isinstance(target, str) else None

    def scene(
        self,
        index: int,
        streams: Streams,
        half_field_rad: float,
        at_s: float | None = None,
        attitude: Attitude | None = None,
        rate_camera_rad_s: ArrayLike | None = None,
        jitter: JitterPath | None = None,
    ) -> Scene:
        """Scene of trial `index`.

        Parameters
        ----------
        index : int
            Index of the trial.
        streams : callable
            Random stream of a stage by name.
        half_field_rad : float
            Stars this far from the boresight, at any moment of the exposure, are given.
        at_s, attitude : optional
            Time and true camera attitude in place of the trial's own.
        rate_camera_rad_s : array_like, shape (3,), optional
            Inertial angular velocity in camera axes that goes with `attitude`; else the trial's own.
        jitter : JitterPath, optional
            Jitter about this mid-exposure, of a sequence; else the trial's own is drawn.
        """
        scenario = self.scenario
        seed, sampling = scenario.seed, scenario.study.sampling
        t_s = trial_time_s(sampling, seed, index, self._round_s) if at_s is None else at_s
        r_km, v_km_s = self.orbit.state(t_s)
        observer = observe(self.clock, t_s, r_km, v_km_s)
        sun_au = sun_position_au(self.clock, t_s)
        bodies = solar_system(self.clock, t_s, observer, scenario.sky)
        rng = streams("pointing")
        if scenario.pointing.target is not None:
            pointing = hold(scenario.pointing, self._towards_target(observer, sun_au, bodies), rng)
        elif scenario.pointing.spin.rate_deg_s:
            pointing = point_spinning(scenario.pointing, t_s, rng)
        elif sampling == "sky" and at_s is None:
            pointing = point_at_random(scenario.pointing, rng, math.tau / self.orbit.period_s)
        else:
            pointing = point(scenario.pointing, r_km, v_km_s, rng)
        if attitude is not None:
            pointing = turned_to(pointing, attitude, rate_camera_rad_s)
        pointing, jitter = self._shaken(pointing, streams, jitter)
        streak_rad = math.hypot(*pointing.rate_camera_rad_s.tolist()) * scenario.detector.exposure_s
        reach_rad = min(half_field_rad + streak_rad, math.pi)
        rows = self.sky.near(pointing.camera.boresight, reach_rad, observer.epoch_jyear)
        directions = self.sky.apparent(rows, observer, sun_au, scenario.sky)
        assert observer.position_au is not None
        to_sun = sun_au - observer.position_au
        sun_direction = to_sun / math.hypot(*to_sun.tolist())
        return Scene(
            t_s=t_s,
            r_km=r_km,
            observer=observer,
            sun_direction=sun_direction,
            pointing=pointing,
            jitter=jitter,
            catalog=self.sky.catalog,
            rows=rows,
            star_directions=directions,
            star_b_v=self._b_v[rows],
            star_giant=self._giant[rows],
            bodies=bodies,
        )

    def draw_jitter(self, rng: np.random.Generator) -> JitterPath | None:
        """One realisation of the scenario's jitter, None where it has none."""
        section = self.scenario.pointing.jitter
        if not any(section.rms_arcsec):
            return None
        return draw_jitter(section, self._jitter, rng, mounting_of(self.scenario.pointing).as_matrix())

    def _shaken(
        self, pointing: Pointing, streams: Streams, jitter: JitterPath | None
    ) -> tuple[Pointing, JitterPath | None]:
        """True attitude turned by the mean of the jitter over the exposure, and the rest of the jitter about it."""
        if not any(self.scenario.pointing.jitter.rms_arcsec):
            return pointing, None
        exposure_s = self.scenario.detector.exposure_s
        jitter = jitter or self.draw_jitter(streams("jitter"))
        if jitter is None:
            return pointing, None
        mean = Attitude.from_rotation_vector(jitter.mean(exposure_s), "camera", "camera")
        camera = mean @ pointing.camera
        shaken = replace(pointing, camera=camera, body=pointing.mounting.inverse @ camera)
        return shaken, jitter.centred(exposure_s)

    def _towards_target(self, observer: Observer, sun_au: FloatArray, bodies: Bodies) -> Attitude:
        """Nominal camera attitude on the target."""
        section = self.scenario.pointing
        if isinstance(section.target, tuple):
            return Attitude.from_radec_roll(*section.target)
        if isinstance(self._target, str):
            return attitude_towards(body_direction(self._target, bodies), section)
        assert self._target is not None
        place = self.sky.catalog.select(np.array([self._target])).directions(observer.epoch_jyear)[0]
        _, directions = self.sky.view(place, 1e-9, observer, sun_au, self.scenario.sky)
        return attitude_towards(directions[np.argmax(directions @ place)], section)
