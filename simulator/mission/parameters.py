"""Parameters of orbit, pointing and motion; the scenario's sections of these names are these classes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from simulator.optics.jitter import NO_JITTER, Jitter
from startracker.display import changed_fields

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class KeplerianElements:
    """Keplerian elements at the epoch; given by `semi_major_axis_km`."""

    semi_major_axis_km: float | None = None
    """Semi-major axis; null: the orbit is not defined by elements."""
    eccentricity: float = 0.0
    """Eccentricity of the ellipse."""
    inclination_deg: float = 0.0
    """Inclination to the reference plane."""
    raan_deg: float = 0.0
    """Right ascension of the ascending node; with the ecliptic its longitude."""
    argument_of_periapsis_deg: float = 0.0
    """Angle from the ascending node to the periapsis."""
    mean_anomaly_deg: float = 0.0
    """Mean anomaly at the epoch: 0 at the periapsis."""


@dataclass(frozen=True)
class StateVector:
    """Position and velocity at the epoch; given by both."""

    position_km: Vector | None = None
    """Position relative to the centre; null: the orbit is not defined by a state vector."""
    velocity_km_s: Vector | None = None
    """Velocity relative to the centre."""


@dataclass(frozen=True)
class ForceModel:
    """Forces of the numerical propagator."""

    zonal_degree: int = 6
    """Highest zonal harmonic of the Earth, J2 to J6; below 2 the Earth is a point mass."""
    third_bodies: bool = True
    """Attraction by Sun and Moon, and, far from the Earth, by the Earth and the planets."""


@dataclass(frozen=True)
class OrbitParameters:
    """The orbit: circular around the Earth, or one of `elements`, `state`, `tle`, `omm`, `oem`, `spk` and `csv`, beside
    which the keys of the circular orbit are not used. The node of a circular orbit is given by either `raan_deg` or
    `ltan_h`."""

    altitude_km: float = 800.0
    """Circular orbit: height above the equatorial radius."""
    inclination_deg: float | Literal["auto"] = "auto"
    """Circular orbit: inclination; ``auto`` is sun-synchronous by J2."""
    ltan_h: float | None = None
    """Circular orbit: local mean solar time of the ascending node, hours; 22.5 if neither node key is given."""
    raan_deg: float | None = None
    """Circular orbit: right ascension of the ascending node at the epoch, true equator of date."""
    argument_of_latitude_deg: float = 0.0
    """Circular orbit: angle from the ascending node at the epoch."""
    elements: KeplerianElements = KeplerianElements()
    """Elliptical orbit by its elements at the epoch."""
    state: StateVector = StateVector()
    """Orbit by its position and velocity at the epoch."""
    tle: str | None = None
    """File of two-line elements, through SGP4."""
    omm: str | None = None
    """File of mean elements, CCSDS OMM in KVN or XML, through SGP4."""
    oem: str | None = None
    """File of an ephemeris, CCSDS OEM in KVN or XML, with its own interpolation."""
    spk: str | None = None
    """SPICE kernel of types 2, 3, 8, 9, 12 or 13."""
    csv: str | None = None
    """Table of states with the columns ``utc`` (or ``t_s`` after the epoch), ``x_km``, ``y_km``, ``z_km``, ``vx_km_s``,
    ``vy_km_s``, ``vz_km_s``."""
    object: str | int | None = None
    """Name or number of the spacecraft in a file with several; in an SPK kernel its NAIF number."""
    centre: Literal["Earth", "Moon", "Sun"] = "Earth"
    """Centre of the elements, the state, the SPK kernel or the table, and of the local level."""
    frame: Literal["auto", "icrf", "equator_of_date", "ecliptic"] = "auto"
    """Axes of the elements, the state or the table: ICRF, true equator and equinox of date, or mean ecliptic and
    equinox of J2000. ``auto``: for elements around the Earth the equator of date, around the Sun the ecliptic,
    otherwise ICRF."""
    propagator: str = "auto"
    """``j2``: secular rates by J2; ``sgp4``: circular elements through SGP4; ``kepler``: two bodies; ``numerical``:
    integration of `forces`. ``auto``: ``j2`` for elements around the Earth, ``kepler`` around Moon and Sun,
    ``numerical`` for a state."""
    forces: ForceModel = ForceModel()
    """Forces of the numerical propagator."""
    max_age_days: float = 30.0
    """Longest time between the epoch of two-line or mean elements and an instant; the error of SGP4 grows by some km
    per day."""

    __repr__ = changed_fields

    @property
    def source(self) -> str:
        """The key that defines the orbit: ``circular``, ``elements``, ``state`` or the key of a file."""
        return next(iter(self.sources), "circular")

    @property
    def sources(self) -> tuple[str, ...]:
        """All keys that define an orbit; a valid section has at most one."""
        given = {"elements": self.elements.semi_major_axis_km, "state": self.state.position_km}
        return tuple(k for k in SOURCES if given.get(k, getattr(self, k)) is not None)

    @property
    def described(self) -> str:
        """Short description for display: ``800 km orbit``, ``orbit of cbers2.tle``."""
        source = self.source
        if source == "circular":
            return f"{self.altitude_km:g} km orbit"
        return f"orbit of {Path(getattr(self, source)).name}" if source in FILES else f"{self.centre} orbit by {source}"


FILES = ("tle", "omm", "oem", "spk", "csv")
"""Keys of `OrbitParameters` that name a file."""
SOURCES = ("elements", "state", *FILES)


@dataclass(frozen=True)
class Spin:
    """Free spin of a body with two equal moments of inertia: its axis of symmetry, body +Z, precesses about the
    inertially fixed angular momentum."""

    rate_deg_s: float = 0.0
    """Angular velocity about body +Z; 0: no spin."""
    axis_deg: tuple[float, float] = (0.0, 90.0)
    """Right ascension and declination of the angular momentum (ICRS)."""
    phase_deg: float = 0.0
    """Rotation of the body about its +Z at the epoch; at 0, and with `cone_phase_deg` 0, its +X points east."""
    cone_deg: float = 0.0
    """Half angle of the cone that +Z describes about that axis."""
    cone_phase_deg: float = 0.0
    """Position of +Z on the cone at the epoch: position angle about the axis, north through east."""
    inertia_ratio: float = 0.1
    """Ratio of the moment of inertia about +Z to the transverse one: below 1 a rod, above 1 a disk. The precession rate
    is `rate_deg_s` times this ratio, divided by the cosine of `cone_deg`."""


@dataclass(frozen=True)
class AttitudeSource:
    """Attitudes from a file: one of `aem`, `ck`, `csv` and `parquet`."""

    aem: str | None = None
    """CCSDS AEM in KVN or XML, with its own interpolation."""
    ck: str | None = None
    """SPICE kernel of attitudes; needs `sclk` and the extra ``spice``."""
    sclk: str | None = None
    """SPICE kernel of the spacecraft's clock, for `ck`."""
    csv: str | None = None
    """Table with the columns ``utc`` (or ``t_s`` after the epoch), ``qx``, ``qy``, ``qz``, ``qw``: the unit quaternion,
    scalar last, that transforms coordinates from `frame` to the body or camera."""
    parquet: str | None = None
    """The same table in Parquet."""
    object: str | int | None = None
    """Name or number of the object in a file with several; in a CK kernel its NAIF number."""
    gives: Literal["auto", "body", "camera"] = "auto"
    """Whether the attitudes are those of the body or of the camera; `mounting` relates one to the other. ``auto``: in
    an AEM by the name of the frame (``SC_BODY``, ``STARTRACKER``), otherwise of the body."""
    frame: Literal["icrf", "eme2000", "equator_of_date", "teme", "itrf", "ecliptic", "local_level"] = "icrf"
    """Axes from which the quaternions of a table transform; ``local_level`` as for `offset_deg`."""
    interpolation: Literal["slerp", "spline"] = "slerp"
    """Interpolation of a table. ``slerp``: constant rate between rows; ``spline``: cubic spline of rotations with
    continuous rates and accelerations."""

    @property
    def sources(self) -> tuple[str, ...]:
        """Keys of files that are given; a valid section has at most one."""
        return tuple(key for key in ATTITUDE_FILES if getattr(self, key) is not None)


ATTITUDE_FILES = ("aem", "ck", "csv", "parquet")
"""Keys of `AttitudeSource` that name a file of attitudes."""


@dataclass(frozen=True)
class Waypoint:
    """An attitude of the camera at a time."""

    at_s: float
    """Seconds after the epoch."""
    ra_deg: float
    """Right ascension of the boresight, ICRS."""
    dec_deg: float
    """Declination of the boresight."""
    roll_deg: float = 0.0
    """Position angle of the camera's up axis (−y), east of north."""


@dataclass(frozen=True)
class Waypoints:
    """Slews from attitude to attitude."""

    points: tuple[Waypoint, ...] = ()
    """Attitudes in order of time: a list of {at_s, ra_deg, dec_deg, roll_deg}; empty: no slews."""
    profile: Literal["eigenaxis", "spline"] = "eigenaxis"
    """``eigenaxis``: rest, and a slew about one axis that ends at `at_s`, with constant acceleration, constant rate and
    constant deceleration; ``spline``: a cubic spline of rotations through all attitudes, from the first to the last."""
    max_rate_deg_s: float = 1.0
    """Maximum rate of an ``eigenaxis`` slew; a short slew does not reach it."""
    acceleration_deg_s2: float = 0.1
    """Angular acceleration at its start and deceleration at its end."""


@dataclass(frozen=True)
class GroundTarget:
    """A point above the ellipsoid of WGS 84."""

    latitude_deg: float = 0.0
    """Geodetic latitude."""
    longitude_deg: float = 0.0
    """Longitude, positive to the east."""
    height_km: float = 0.0
    """Height above the ellipsoid."""


@dataclass(frozen=True)
class Track:
    """A body axis points at a target, and a second axis as closely as possible along a second direction."""

    target: (
        Literal["nadir", "velocity", "ground", "spacecraft", "direction", "Sun", "Moon", "Earth"]
        | Literal["Mercury", "Venus", "Mars", "Jupiter", "Saturn", "Uranus", "Neptune"]
        | None
    ) = None
    """The target: the centre of the trajectory (``nadir``), the ``velocity``, `ground`, `spacecraft`, `direction_deg`
    or a body; null: the body holds the local level. Targets are followed behind the Earth as well."""
    direction_deg: tuple[float, float] = (0.0, 0.0)
    """Right ascension and declination (ICRS) for ``direction``."""
    ground: GroundTarget = GroundTarget()
    """Point on the Earth for ``ground``."""
    spacecraft: OrbitParameters = OrbitParameters()
    """Orbit of another spacecraft for ``spacecraft``, with the keys of `orbit`."""
    axis: Vector | None = None
    """Body axis that points at the target; null: the camera's boresight."""
    second_axis: Vector | None = None
    """Body axis towards the second direction; null: the camera's up axis (−y)."""
    second_direction: Literal["velocity", "zenith", "orbit_normal", "north", "Sun"] = "velocity"
    """Second direction: velocity, zenith, orbit normal (r × v), celestial north pole (ICRS) or Sun."""


@dataclass(frozen=True)
class ThermoElastic:
    """Thermo-elastic motion of the mounting around the orbit: a rotation of the camera relative to the body that is not
    known on board."""

    amplitude_arcsec: Vector = (0.0, 0.0, 0.0)
    """Amplitude of the rotation about the camera's x, y, z; 0: none. With `heads`, each head has this rotation about
    its own axes."""
    phase_deg: Vector = (0.0, 0.0, 0.0)
    """Orbit angle at which the rotation about each axis is greatest."""
    reference: Literal["noon", "node"] = "noon"
    """Zero of the orbit angle. ``noon``: where the orbit is nearest to the Sun; the middle of the eclipse is at 180°;
    ``node``: the ascending node."""


@dataclass(frozen=True)
class PointingParameters:
    """Mounting of the camera, and attitude of the body: relative to the local level, or by one of `target`, `spin`,
    `attitude`, `track` and `waypoints`."""

    mounting: str | tuple[float, float, float, float] = "orbit_normal"
    """Name of a mounting, or the quaternion (x, y, z, w) from body to camera."""
    target: str | Vector | None = None
    """Point the camera at this target instead of holding the local level: right ascension, declination and roll in
    degrees (ICRS), or the name of a star of the sky's catalogue (``Alp CMa``, ``HIP 32349``) or of a body (``Moon``,
    ``Jupiter``)."""
    target_offset_deg: tuple[float, float] = (0.0, 0.0)
    """Position of a named target in the image: degrees from the boresight along +x (columns) and +y (rows)."""
    target_roll_deg: float = 0.0
    """Roll of the camera on a named target."""
    offset_deg: Vector = (0.0, 0.0, 0.0)
    """Fixed attitude offset of the body from the local level, or from what replaces it: roll, pitch, yaw (rotation
    vector)."""
    error_deg: float = 1.0
    """Half width of the uniformly distributed random attitude offset per trial and axis: the uncertainty of the other
    sensors."""
    rate_deg_s: Vector = (0.0, 0.0, 0.0)
    """Body rate about X, Y, Z in addition to the rotation of the local-level frame, or of what replaces it."""
    spin: Spin = Spin()
    """Free spin instead of the local level; off if its rate is 0."""
    attitude: AttitudeSource = AttitudeSource()
    """Attitudes from a file instead of the local level."""
    waypoints: Waypoints = Waypoints()
    """Slews from attitude to attitude instead of the local level."""
    track: Track = Track()
    """An axis that follows a target, instead of the local level."""
    jitter: Jitter = NO_JITTER
    """Jitter."""
    thermo_elastic: ThermoElastic = ThermoElastic()
    """Motion of the mounting around the orbit."""

    __repr__ = changed_fields

    @property
    def laws(self) -> tuple[str, ...]:
        """Keys that define the attitude instead of the local level; a valid section has at most one."""
        given = {
            "target": self.target is not None,
            "spin": self.spin.rate_deg_s != 0.0,
            "attitude": bool(self.attitude.sources),
            "waypoints": bool(self.waypoints.points),
            "track": self.track.target is not None,
        }
        return tuple(key for key, is_given in given.items() if is_given)

    @property
    def law(self) -> str:
        """The key that defines the attitude: ``level`` (the local level), ``target``, ``spin``, ``attitude``,
        ``waypoints`` or ``track``."""
        return next(iter(self.laws), "level")


@dataclass(frozen=True)
class RatePoint:
    """A point of a rate profile."""

    at_s: float
    """Seconds after the first frame."""
    roll_deg_s: float = 0.0
    """Rate about body X."""
    pitch_deg_s: float = 0.0
    """Rate about body Y."""
    yaw_deg_s: float = 0.0
    """Rate about body Z."""


@dataclass(frozen=True)
class Slew:
    """A slew about one axis: constant acceleration, constant rate, constant deceleration."""

    turn_deg: Vector = (0.0, 0.0, 0.0)
    """Rotation vector of the whole slew in body axes; 0: no slew."""
    max_rate_deg_s: float = 2.0
    """Maximum rate; a short slew does not reach it."""
    acceleration_deg_s2: float = 0.2
    """Angular acceleration at the start and deceleration at the end."""
    start_s: float = 10.0
    """Start of the slew after the first frame."""


@dataclass(frozen=True)
class SequenceMotion:
    """Times and motion of a sequence."""

    start_s: float
    """Mid-exposure of the first frame, after the epoch."""
    step_s: float
    """Time between frames."""
    rates: tuple[RatePoint, ...]
    """Points of the rate profile."""
    slew: Slew
    """A slew in addition to the rate profile."""


@dataclass(frozen=True)
class Gyro:
    """A gyro used by the tracking filter between frames, aligned with the camera axes; noise terms as in IEEE Std
    952-1997."""

    use: bool = False
    """Use the gyro; false: the filter estimates the rate from the stars alone."""
    angle_random_walk_deg_sqrt_h: float = 0.05
    """White noise of the rate."""
    bias_deg_h: float = 10.0
    """Standard deviation of the constant bias, each axis."""
    bias_instability_deg_h: float = 0.5
    """Standard deviation of the varying part of the bias (first-order Gauss–Markov process)."""
    bias_time_s: float = 300.0
    """Correlation time of the varying part of the bias."""
    scale_factor_ppm: float = 0.0
    """Standard deviation of the constant scale-factor error of each axis; 10,000 is 1 %."""
