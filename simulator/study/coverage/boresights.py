"""Attitudes of a camera: uniform over the whole sky, or along a mission's path; and their exclusion angles.

All attitudes have the same weight, of the sky or of the time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from simulator.build import build_mounting, build_orbit, build_scenes
from simulator.constants import EARTH_RADIUS_KM
from simulator.mission.clock import Clock
from simulator.mission.pointing import level_matrices, round_s
from simulator.mission.sampling import trial_time_s
from simulator.mission.trajectory import from_earth, geocentric
from simulator.optics.jitter import NO_JITTER
from simulator.randomness import stream
from simulator.scenario import Scenario
from simulator.scenario.fields import all_keys
from simulator.scene import GivenState
from simulator.study.body_angles import angle_from_deg
from startracker.core import BoolArray, FloatArray
from startracker.display import fields_repr
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, direction_to_radec

_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
_PLASTIC = 0.754_877_666_246_692_8
"""1/ρ with ρ the plastic number: steps of the roll that are incommensurable with the golden angle."""

NO_EARTH = 2.0
"""Cosine of the Earth's angular radius that no direction reaches."""


@dataclass(frozen=True)
class Exclusion:
    """Exclusion angles, degrees; 0: none."""

    sun_deg: float = 0.0
    moon_deg: float = 0.0
    """Minimum angle between the boresight and the centre of the body."""
    earth_deg: float = 0.0
    """Minimum angle between the boresight and the Earth's limb, lit or dark."""
    sources: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)
    """Key or option that the angle of each body comes from, for display."""

    def __post_init__(self) -> None:
        for name in ("sun_deg", "moon_deg", "earth_deg"):
            value = getattr(self, name)
            if not 0.0 <= value <= 180.0:
                raise InputError(f"{name.removesuffix('_deg')} exclusion: must be from 0 to 180 degrees, not {value:g}")


@dataclass(frozen=True, eq=False)
class Boresights:
    """Attitudes of a camera, all of equal weight."""

    kind: str
    """``sky`` or ``path``."""
    matrices: FloatArray
    """(N, 3, 3): ICRS → camera."""
    t_s: FloatArray
    """(N,): Seconds after the scenario's epoch."""
    nadir: FloatArray
    """(N, 3): Direction of the Earth's centre."""
    limb_cosine: FloatArray
    """(N,): Cosine of the Earth's angular radius; `NO_EARTH` without occultation."""
    excluded: dict[str, BoolArray]
    """(N,) by body (``sun``, ``moon``, ``earth``): whether its exclusion angle is violated."""
    rolls: int = 1
    """Successive attitudes per direction."""

    __repr__ = fields_repr

    def __len__(self) -> int:
        return len(self.matrices)

    @property
    def directions(self) -> FloatArray:
        """Unit vectors (N, 3) along the boresight, ICRS."""
        return self.matrices[:, 2]

    @property
    def ra_deg(self) -> FloatArray:
        """Right ascension (N,), 0 to 360."""
        return np.degrees(direction_to_radec(self.directions)[0])

    @property
    def dec_deg(self) -> FloatArray:
        """Declination (N,)."""
        return np.degrees(direction_to_radec(self.directions)[1])

    @property
    def roll_deg(self) -> FloatArray:
        """Position angle (N,) of the camera's up direction (−y), east of north, 0 to 360."""
        east, north = _east_north(self.directions)
        up = -self.matrices[:, 1]
        angle = np.arctan2(np.sum(up * east, axis=1), np.sum(up * north, axis=1))
        return np.asarray(np.degrees(angle) % 360.0)

    @property
    def allowed(self) -> BoolArray:
        """Attitudes (N,) that violate no exclusion angle."""
        out = np.ones(len(self), dtype=bool)
        for broken in self.excluded.values():
            out &= ~broken
        return out


def sky_grid(count: int) -> FloatArray:
    """Unit vectors (`count`, 3) distributed uniformly over the sphere: the Fibonacci lattice.

    zᵢ = 1 − (2i + 1)/N, φᵢ = i π (3 − √5); each point represents 4π/N (González 2010, "Measurement of areas on a sphere
    using Fibonacci and latitude–longitude lattices", Math. Geosci. 42, 49).
    """
    i = np.arange(count)
    z = 1.0 - (2.0 * i + 1.0) / count
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(_GOLDEN_ANGLE * i), radius * np.sin(_GOLDEN_ANGLE * i), z], axis=1)


def whole_sky(
    count: int, rolls: int = 1, scenario: Scenario | None = None, exclusion: Exclusion | None = None
) -> Boresights:
    """Attitudes with boresights distributed uniformly over the sky.

    Rolls are uniform as well: a non-repeating step from direction to direction, and `rolls` equidistant ones per
    direction. The Earth does not occult stars.

    Parameters
    ----------
    count : int
        Number of directions.
    rolls : int
        Rolls per direction.
    scenario, exclusion : optional
        Exclusion angles, for the Sun, the Moon and the Earth as seen from the scenario's spacecraft at the epoch.

    Raises
    ------
    InputError
        For fewer than one direction or roll.
    """
    _at_least_one("boresights", count)
    _at_least_one("rolls", rolls)
    directions = np.repeat(sky_grid(count), rolls, axis=0)
    turn = (np.arange(count)[:, None] * _PLASTIC + np.arange(rolls) / rolls).ravel() * (2.0 * math.pi)
    east, north = _east_north(directions)
    up = np.cos(turn)[:, None] * north + np.sin(turn)[:, None] * east
    matrices = np.stack([np.cross(-up, directions), -up, directions], axis=1)
    n = len(matrices)
    nothing = Boresights("sky", matrices, np.zeros(n), np.zeros((n, 3)), np.full(n, NO_EARTH), {}, rolls)
    if scenario is None or exclusion is None:
        return nothing
    orbit = build_orbit(scenario)
    r_km = np.broadcast_to(geocentric(orbit, nothing.t_s[:1]).r_km, (n, 3))
    excluded = _excluded(exclusion, Clock(scenario.epoch), nothing.t_s, r_km, directions)
    return Boresights("sky", matrices, nothing.t_s, nothing.nadir, nothing.limb_cosine, excluded, rolls)


def along_path(scenario: Scenario, count: int, exclusion: Exclusion | None = None) -> Boresights:
    """Attitudes at the instants of the scenario's trials 0 … `count` − 1, without the random pointing error.

    Stars occulted by the Earth are not counted, unless the scenario has ``sky.earth: false``.

    Raises
    ------
    InputError
        For fewer than one instant, or a scenario with random attitudes (``study.sampling: sky``).
    """
    _at_least_one("boresights", count)
    sampling = scenario.study.sampling
    if sampling == "sky" and scenario.pointing.target is None:
        raise InputError("study.sampling: sky has no boresight path; omit --path, or use mission_year, orbit or span")
    orbit = build_orbit(scenario)
    period_s = round_s(scenario.pointing, orbit.period_s)
    t_s = trial_time_s(sampling, scenario.seed, np.arange(count), period_s, build_scenes(scenario).span_s)
    centred = orbit.state(t_s)
    r_km = from_earth(orbit, t_s, *centred).r_km
    if scenario.pointing.law == "level":
        body = Attitude.from_rotation_vector(np.radians(scenario.pointing.offset_deg), "local_level", "body")
        turn = (build_mounting(scenario) @ body).as_matrix()
        matrices = turn @ level_matrices(*centred)
    else:
        matrices = _of_scenes(scenario, t_s)
    distance = np.linalg.norm(r_km, axis=1)
    limb = np.sqrt(1.0 - np.minimum(EARTH_RADIUS_KM / distance, 1.0) ** 2)
    excluded = _excluded(exclusion or Exclusion(), orbit.clock, t_s, r_km, matrices[:, 2])
    return Boresights(
        "path",
        matrices,
        t_s,
        -r_km / distance[:, None],
        limb if scenario.sky.earth else np.full(count, NO_EARTH),
        excluded,
    )


def _of_scenes(scenario: Scenario, t_s: FloatArray) -> FloatArray:
    """Matrices (N, 3, 3) of a camera that does not hold the local level."""
    steady = scenario.model_copy(update={"pointing": replace(scenario.pointing, error_deg=0.0, jitter=NO_JITTER)})
    scenes = build_scenes(steady)
    scenes.plan(t_s)

    def attitude(index: int) -> FloatArray:
        def streams(stage: str) -> np.random.Generator:
            return stream(scenario.seed, stage, index)

        return scenes.scene(index, streams, 1e-6, 0.0, GivenState(at_s=float(t_s[index]))).pointing.camera.as_matrix()

    return np.array([attitude(index) for index in range(len(t_s))])


def _excluded(
    exclusion: Exclusion, clock: Clock, t_s: FloatArray, r_km: FloatArray, directions: FloatArray
) -> dict[str, BoolArray]:
    """Attitudes that violate each exclusion angle that is set."""
    limits = {body: getattr(exclusion, f"{body}_deg") for body in ("sun", "moon", "earth")}
    return {
        body: angle_from_deg(body, clock, t_s, r_km, directions) < limit
        for body, limit in limits.items()
        if limit > 0.0
    }


def _east_north(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    ra, dec = direction_to_radec(directions)
    east = np.stack([-np.sin(ra), np.cos(ra), np.zeros_like(ra)], axis=1)
    north = np.stack([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)], axis=1)
    return east, north


def _at_least_one(what: str, count: int) -> None:
    if count < 1:
        raise InputError(f"{what}: must be at least 1, not {count}")


BODIES = ("sun", "moon", "earth")


def exclusion_of(scenario: Scenario, given: Mapping[str, float | None] | None = None) -> Exclusion:
    """Exclusion angles, and the source of each that is not zero: given, else those of the specification, else those of
    the baffle, if the scenario has one.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    given : mapping, optional
        Angle by body, degrees; None: the scenario's.
    """
    angles, sources = {}, {}
    defaults = {key.path: key.default for key in all_keys()}
    for body in BODIES:
        path = f"optics.baffle.{body}_exclusion_deg"
        specified = getattr(scenario.specification, f"{body}_exclusion_deg")
        of_baffle = (
            0.0 if scenario.optics.baffle.pst is None else getattr(scenario.optics.baffle, f"{body}_exclusion_deg")
        )
        chosen = (given or {}).get(body)
        if chosen is not None:
            angle, source = chosen, f"--{body}-deg"
        elif specified is not None:
            angle, source = specified, f"specification.{body}_exclusion_deg"
        else:
            angle, source = of_baffle, f"{path}, {'the default' if of_baffle == defaults[path] else 'as set'}"
        angles[f"{body}_deg"] = angle
        if angle > 0.0:
            sources[body] = source
    return Exclusion(**angles, sources=sources)


def everything_excluded(looks: Boresights, exclusion: Exclusion) -> str:
    """Sentence with the angles that exclude every attitude: those that do so alone, otherwise all."""
    alone = [body for body, broken in looks.excluded.items() if broken.all()]
    return "everything is excluded by " + " and ".join(
        exclusion.sources.get(body, body) for body in alone or looks.excluded
    )


def exclusion_text(body: str, angle_deg: float, source: str) -> str:
    """An exclusion angle and where it comes from: ``within 25° of its limb (optics.baffle.earth_exclusion_deg, …)``."""
    return f"within {angle_deg:g}° of its {'limb' if body == 'earth' else 'centre'} ({source})"
