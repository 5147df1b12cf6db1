"""Laws that follow a target, and slews: against Skyfield's apparent positions, astropy's geodesy, closed forms of slews
and SciPy's spline of rotations."""

import math
from datetime import UTC, datetime

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import EarthLocation
from scipy.spatial.transform import Rotation, RotationSpline
from skyfield.api import load, wgs84
from skyfield.positionlib import Barycentric, Geocentric

from simulator.mission.attitude_law import law_attitude, law_rate_rad_s
from simulator.mission.attitudes import build_attitude_law
from simulator.mission.parameters import (
    GroundTarget,
    KeplerianElements,
    OrbitParameters,
    PointingParameters,
    Track,
    Waypoint,
    Waypoints,
)
from simulator.mission.pointing import local_level, mounting_of
from simulator.mission.tracking import ground_states
from simulator.mission.trajectories import build_trajectory
from simulator.mission.trajectory import centre_state
from startracker.core import AU_KM
from startracker.ephemeris import de421
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude

EPOCH = datetime(2026, 3, 21, 12, tzinfo=UTC)
ORBIT = build_trajectory(OrbitParameters(), EPOCH)
CLOCK = ORBIT.clock
TIMESCALE = load.timescale(builtin=True)
T_S = np.linspace(0.0, 5000.0, 11)
MAS = math.radians(1.0 / 3.6e6)
QUATERNION = (0.1, -0.2, 0.3, 0.9)


def law_of(orbit=ORBIT, **keys):
    return build_attitude_law(PointingParameters(mounting=QUATERNION, track=Track(**keys)), orbit)


def boresights(law, t_s):
    """Directions (T, 3) of the camera's boresight and of its up axis, ICRS."""
    cameras = [
        mounting_of(PointingParameters(mounting=QUATERNION)) @ Attitude(q, "icrs", "body") for q in law.quaternions(t_s)
    ]
    matrices = np.array([camera.as_matrix() for camera in cameras])
    return matrices[:, 2], -matrices[:, 1]


def seen_by_skyfield(target, t_s, orbit=ORBIT):
    """Apparent directions (T, 3) from a spacecraft, without the Sun's deflection of light, by Skyfield and ERFA."""
    import erfa

    time = TIMESCALE.tt_jd(*CLOCK.tt_jd(t_s))
    r, v = orbit.state(t_s)
    centre = centre_state(orbit.centre, CLOCK, t_s)
    position, velocity = (r + centre.r_km) / AU_KM, (v + centre.v_km_s) / AU_KM * 86_400.0
    craft = Barycentric(position.T, velocity.T, time, center=0)
    away = craft.observe(de421()[target]).xyz.au.T  # astrometric: with the light time
    unit = away / np.linalg.norm(away, axis=1, keepdims=True)
    beta = (v + centre.v_km_s) / 299_792.458
    gamma = np.sqrt(1.0 - np.sum(beta**2, axis=1))
    return erfa.ab(unit, beta, np.full(len(t_s), 1e9), gamma)  # far from the Sun: no term of its potential


@pytest.mark.parametrize("target", ["Sun", "Moon", "Jupiter", "Venus"])
def test_bodies_as_skyfield_sees_them(target):
    """(v/c)² is 2 mas for 30 km/s, and of the light time a τ²/2 is left, with the acceleration of the target: 4 km for
    Venus behind the Sun (0.011 m/s², 850 s), 3.3 mas at 1.7 au."""
    direction, _ = boresights(law_of(target=target), T_S)
    names = {"Jupiter": "jupiter barycenter"}
    away = np.linalg.norm(direction - seen_by_skyfield(names.get(target, target.lower()), T_S), axis=1)
    assert away.max() < 5.3 * MAS


def test_ground_targets_against_astropy_and_skyfield():
    """Geodetic to fixed coordinates by astropy, to 1 mm; the direction by Skyfield's own Earth rotation to 1 mas of the
    Earth's rotation (3 cm at the surface) and aberration to (v/c)²."""
    point = GroundTarget(48.15, 11.27, 0.6)
    law = law_of(target="ground", ground=point, second_direction="orbit_normal")
    location = EarthLocation.from_geodetic(11.27 * u.deg, 48.15 * u.deg, 600.0 * u.m, ellipsoid="WGS84")
    time = TIMESCALE.tt_jd(*CLOCK.tt_jd(T_S))
    fixed = np.array([location.x.to_value("km"), location.y.to_value("km"), location.z.to_value("km")])
    station = wgs84.latlon(48.15, 11.27, 600.0)
    np.testing.assert_allclose(station.itrs_xyz.km, fixed, rtol=0, atol=1e-6)
    ground = station.at(time)
    states = ground_states(point, CLOCK, T_S)
    assert np.linalg.norm(states.r_km - ground.xyz.km.T, axis=1).max() < 4e-5
    r, v = ORBIT.state(T_S)
    away = ground.xyz.km.T - r
    light_s = np.linalg.norm(away, axis=1, keepdims=True) / 299_792.458
    # the point at the time of emission, and the aberration by the velocity in the Earth's frame
    earlier = TIMESCALE.tt_jd(CLOCK.tt_jd(0.0)[0], CLOCK.tt_jd(T_S - light_s[:, 0])[1])
    away = station.at(earlier).xyz.km.T - r
    expected = away / np.linalg.norm(away, axis=1, keepdims=True) + v / 299_792.458
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    direction, _ = boresights(law, T_S)
    # 4e-5 km at 800 km or more: 1e-8 rad, and (v/c)^2 = 6e-10
    assert np.linalg.norm(direction - expected, axis=1).max() < 5e-8 + 1e-9
    nearest = np.argmin(np.linalg.norm(away, axis=1))
    assert np.linalg.norm(away, axis=1)[nearest] < 12_800.0


def test_another_spacecraft():
    """Two spacecraft 100 km apart on one circular orbit: the direction in the local level is that of the chord, and no
    aberration is left, as both have the same speed along it: ω × d has no component across d in the first order.

    With half the angle φ between them, the chord is φ below the velocity, and relative velocity |v| 2 sin φ across it:
    n d / c = 3.5e-4 × 100 / 3e5 rad = 7.7e-8 · (v/c)…, within 1e-7.
    """
    ahead_deg = math.degrees(100.0 / 7178.1363)
    law = law_of(target="spacecraft", spacecraft=OrbitParameters(argument_of_latitude_deg=ahead_deg))
    direction, up = boresights(law, T_S)
    for k, (r, v) in enumerate(zip(*ORBIT.state(T_S), strict=True)):
        inside = local_level(r, v).apply(direction[k])
        half = math.radians(ahead_deg) / 2.0
        # the plane precesses while one follows the other: 2e-7 rad/s × 13 s × sin i
        np.testing.assert_allclose(inside, [math.cos(half), 0.0, math.sin(half)], rtol=0, atol=4e-6)
        assert abs(up[k] @ direction[k]) < 1e-14


def test_nadir_velocity_and_direction():
    r, v = ORBIT.state(T_S)
    nadir, up = boresights(law_of(target="nadir"), T_S)
    np.testing.assert_allclose(nadir, -r / np.linalg.norm(r, axis=1, keepdims=True), rtol=0, atol=1e-14)
    across = v - np.sum(v * nadir, axis=1, keepdims=True) * nadir  # up is the velocity, as far as it is across
    np.testing.assert_allclose(up, across / np.linalg.norm(across, axis=1, keepdims=True), rtol=0, atol=1e-13)
    along, _ = boresights(law_of(target="velocity", second_direction="zenith"), T_S)
    np.testing.assert_allclose(along, v / np.linalg.norm(v, axis=1, keepdims=True), rtol=0, atol=1e-14)
    fixed, north = boresights(law_of(target="direction", direction_deg=(30.0, 40.0), second_direction="north"), T_S)
    expected = Attitude.from_radec_roll(30.0, 40.0, 0.0).as_matrix()
    np.testing.assert_allclose(fixed, np.tile(expected[2], (11, 1)), rtol=0, atol=1e-14)
    np.testing.assert_allclose(north, np.tile(-expected[1], (11, 1)), rtol=0, atol=1e-14)


def test_body_axes_other_than_the_camera_s():
    """A panel's normal towards the Sun, an antenna as near as possible to nadir: the angle between the axes is kept."""
    panel, antenna = np.array([0.0, 3.0, 4.0]), np.array([1.0, 1.0, 0.0])
    law = law_of(target="Sun", axis=tuple(panel), second_axis=tuple(antenna), second_direction="zenith")
    sun = seen_by_skyfield("sun", T_S)
    r, _ = ORBIT.state(T_S)
    for k, q in enumerate(law.quaternions(T_S)):
        body = Attitude(q, "icrs", "body")
        np.testing.assert_allclose(body.inverse.apply(panel / 5.0), sun[k], rtol=0, atol=3 * MAS)
        pointed = body.inverse.apply(antenna)
        # antenna, Sun and zenith are in one plane, the antenna on the side of the zenith
        normal = np.cross(sun[k], r[k])
        assert abs(pointed @ normal) < 1e-7 * np.linalg.norm(normal)
        assert np.cross(sun[k], pointed) @ normal > 0.0


def test_rates_of_a_pass():
    """Overhead of a point on the orbit's ground track, the rate is (v − v_ground)/h, some 1°/s from 400 km; from
    differences of directions at 1 s."""
    orbit = build_trajectory(OrbitParameters(altitude_km=400.0), EPOCH)
    r, _ = orbit.state(600.0)
    place = wgs84.geographic_position_of(Geocentric(r / AU_KM, t=TIMESCALE.tt_jd(*CLOCK.tt_jd(600.0)), center=399))
    point = GroundTarget(place.latitude.degrees, place.longitude.degrees, 0.0)
    law = law_of(orbit, target="ground", ground=point)
    before, after = boresights(law, np.array([599.5, 600.5]))[0]
    rate = law_rate_rad_s(law, 600.0)
    in_body = mounting_of(PointingParameters(mounting=QUATERNION)).inverse.apply([0.0, 0.0, 1.0])
    across = rate - (rate @ in_body) * in_body
    assert np.linalg.norm(across) == pytest.approx(np.linalg.norm(after - before), rel=1e-4)
    assert math.degrees(np.linalg.norm(across)) == pytest.approx(1.0, abs=0.1)


def test_mistakes_with_targets():
    with pytest.raises(
        InputError, match=r"at 2026-03-21T12:00:00.000 UTC the target is along second_direction: zenith"
    ):
        law_of(target="nadir", second_direction="zenith").quaternions(T_S)
    with pytest.raises(InputError, match=r"axis \[0.0, 0.0, 1.0\] and second_axis \[0.0, 0.0, -2.0\] are parallel"):
        law_of(target="nadir", axis=(0.0, 0.0, 1.0), second_axis=(0.0, 0.0, -2.0))
    hyperbola = KeplerianElements(7000.0, 1.5)
    with pytest.raises(InputError, match=r"orbit.elements: an ellipse"):
        law_of(target="spacecraft", spacecraft=OrbitParameters(elements=hyperbola))


# ---------------------------------------------------------------- slews
POINTS = (Waypoint(10.0, 30.0, 40.0, 0.0), Waypoint(100.0, 120.0, -10.0, 50.0), Waypoint(140.0, 125.0, -10.0, 50.0))


def slews(points=POINTS, **keys):
    return build_attitude_law(PointingParameters(mounting=QUATERNION, waypoints=Waypoints(points, **keys)), ORBIT)


def camera_of(law, t_s):
    return mounting_of(PointingParameters(mounting=QUATERNION)) @ Attitude(
        law.quaternions(np.array([t_s]))[0], "icrs", "body"
    )


def test_slews_about_the_eigenaxis_in_the_shortest_time():
    """Rest, a slew of θ in θ/ω + ω/α (trapezoid) or 2 √(θ/α) (triangle) seconds, and rest; on the way the rotation from
    the start is about the eigenaxis, and rate and acceleration are within their limits."""
    law = slews(max_rate_deg_s=2.0, acceleration_deg_s2=0.1)
    cameras = [Attitude.from_radec_roll(p.ra_deg, p.dec_deg, p.roll_deg) for p in POINTS]
    turn = np.array(cameras[0].rotation_vector_to(cameras[1]))
    angle_deg = np.degrees(np.linalg.norm(turn))
    takes_s = angle_deg / 2.0 + 2.0 / 0.1 if angle_deg > 2.0**2 / 0.1 else 2.0 * math.sqrt(angle_deg / 0.1)
    starts = 100.0 - takes_s
    for t, camera in ((-1e6, 0), (10.0, 0), (starts - 0.01, 0), (100.0, 1), (120.0, 1), (140.0, 2), (1e6, 2)):
        found = camera_of(law, t)
        np.testing.assert_allclose(found.rotation_vector_to(cameras[camera]), 0.0, atol=1e-14)
    t = np.linspace(starts, 100.0, 400)
    angles = np.array([cameras[0].rotation_vector_to(camera_of(law, x)) for x in t])
    sizes = np.degrees(np.linalg.norm(angles, axis=1))
    np.testing.assert_allclose(angles[5:] / sizes[5:, None], np.tile(turn / angle_deg, (395, 1)), atol=1e-8)
    speed = np.gradient(sizes, t)
    assert speed.max() <= 2.0 + 1e-9
    assert np.abs(np.gradient(speed, t)).max() <= 0.1 + 1e-6
    # half way at half of the time, as it accelerates as it decelerates
    assert np.interp(starts + takes_s / 2.0, t, sizes) == pytest.approx(angle_deg / 2.0, rel=1e-4)
    # the quarter of a parabola at the start
    assert sizes[40] == pytest.approx(0.05 * (t[40] - starts) ** 2, rel=1e-9)
    rate = np.degrees(np.linalg.norm(law_rate_rad_s(law, 100.0 - takes_s / 2.0)))
    assert rate == pytest.approx(min(2.0, math.sqrt(angle_deg * 0.1)), rel=1e-3)


def test_splines_through_the_attitudes():
    law = slews(profile="spline")
    cameras = [Attitude.from_radec_roll(p.ra_deg, p.dec_deg, p.roll_deg) for p in POINTS]
    along = RotationSpline([p.at_s for p in POINTS], Rotation.from_quat([c.quat for c in cameras]))
    for t in (10.0, 33.0, 100.0, 139.0, 140.0):
        expected = along(t).as_matrix().T
        np.testing.assert_allclose(camera_of(law, t).as_matrix(), expected, rtol=0, atol=1e-14)
    assert law.span_s == (10.0, 140.0)
    with pytest.raises(
        InputError, match=r"pointing.waypoints covers 2026-03-21T12:00:10.000 to .*; 2026-03-21T12:00:0"
    ):
        law_attitude(law, 0.0)


def test_mistakes_with_slews():
    with pytest.raises(InputError, match=r"the slew of 5.* to the attitude at 140 s takes 14.* s, and 10 s are left"):
        slews((POINTS[0], Waypoint(130.0, 120.0, -10.0, 50.0), POINTS[2]), max_rate_deg_s=2.0)
    with pytest.raises(InputError, match=r"points must be in order of time; 10 s comes after 100 s"):
        slews(POINTS[1::-1])
    with pytest.raises(InputError, match=r"a spline needs two points"):
        slews(POINTS[:1], profile="spline")
    np.testing.assert_allclose(camera_of(slews(POINTS[:1]), 5.0).ra_deg, 30.0)
