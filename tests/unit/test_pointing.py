"""Pointing: frames, mountings, offset, rates; the rotations are SciPy's, which the product does not use."""

import math
import pickle
from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.mission.orbit import build_orbit
from simulator.mission.parameters import OrbitParameters, PointingParameters
from simulator.mission.pointing import (
    MOUNTINGS,
    attitude_at,
    local_level,
    mounting_of,
    point,
    point_at_random,
    random_attitude,
)
from startracker.errors import InputError

EPOCH = datetime(2026, 3, 21, 12, tzinfo=UTC)
R_KM, V_KM_S = np.array([7000.0, 0.0, 0.0]), np.array([0.3, 0.0, 7.5])  # over the equator, northwards and climbing
X, Y, Z = np.eye(3)


def rng():
    return np.random.default_rng(7)


def test_local_level_axes():
    level = local_level(R_KM, V_KM_S)
    assert (level.source, level.target) == ("icrs", "local_level")
    # Z down, Y minus the orbit normal (r × v is along −y), X square to Z in the plane of the velocity
    np.testing.assert_allclose(level.as_matrix(), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], atol=1e-15)


@pytest.mark.parametrize(("r", "v"), [(R_KM, R_KM * 1e-3), (R_KM, 0 * V_KM_S), (0 * R_KM, V_KM_S)])
def test_no_local_level_without_a_plane(r, v):
    with pytest.raises(InputError, match="are parallel"):
        local_level(r, v)


@pytest.mark.parametrize(
    ("name", "boresight", "up"),
    [
        ("orbit_normal", Y, -Z),
        ("anti_orbit_normal", -Y, -Z),
        ("zenith", -Z, X),
        ("forward", X, -Z),
        ("backward", -X, -Z),
    ],
)
def test_mountings(name, boresight, up):
    mounting = mounting_of(PointingParameters(mounting=name))
    assert (mounting.source, mounting.target) == ("body", "camera")
    np.testing.assert_allclose(mounting.apply(boresight), Z, atol=1e-15)
    np.testing.assert_allclose(mounting.apply(up), -Y, atol=1e-15)
    assert np.linalg.det(mounting.as_matrix()) == pytest.approx(1.0)


def test_every_mounting_is_tested_above():
    assert set(MOUNTINGS) == {"orbit_normal", "anti_orbit_normal", "zenith", "forward", "backward"}


def test_mounting_by_quaternion_is_normalised():
    quat = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).inv().as_quat()
    mounting = mounting_of(PointingParameters(mounting=tuple(3.0 * quat)))
    expected = Rotation.from_quat(quat).inv().as_matrix()  # ours turns coordinates, SciPy's turns vectors
    np.testing.assert_allclose(mounting.as_matrix(), expected, atol=1e-15)
    assert (mounting.source, mounting.target) == ("body", "camera")


@pytest.mark.parametrize(
    ("mounting", "message"),
    [("orbit_norm", r"'orbit_norm' is not one of the mountings.*did you mean"), ((0.0, 0.0, 0.0, 0.0), "non-zero")],
)
def test_mountings_that_cannot_be_used(mounting, message):
    with pytest.raises(InputError, match=message):
        point(PointingParameters(mounting=mounting), R_KM, V_KM_S, rng())


def test_offset_and_error_turn_the_body_about_its_own_axes():
    section = PointingParameters(offset_deg=(3.0, -2.0, 5.0), error_deg=1.5)
    pointing = point(section, R_KM, V_KM_S, rng())
    error = np.radians(1.5) * rng().uniform(-1, 1, 3)
    level = local_level(R_KM, V_KM_S).as_matrix()
    nominal = Rotation.from_rotvec(np.radians([3.0, -2.0, 5.0])).inv().as_matrix() @ level
    body = Rotation.from_rotvec(error).inv().as_matrix() @ nominal
    mount = MOUNTINGS["orbit_normal"].as_matrix()
    np.testing.assert_allclose(pointing.body.as_matrix(), body, atol=1e-14)
    np.testing.assert_allclose(pointing.camera.as_matrix(), mount @ body, atol=1e-14)
    np.testing.assert_allclose(pointing.prior.as_matrix(), mount @ nominal, atol=1e-14)
    names = [(a.source, a.target) for a in (pointing.body, pointing.camera, pointing.prior, pointing.mounting)]
    assert names == [("icrs", "body"), ("icrs", "camera"), ("icrs", "camera"), ("body", "camera")]
    # the error the tracker has to find, in camera axes
    np.testing.assert_allclose(pointing.prior.rotation_vector_to(pointing.camera), mount @ error, atol=1e-14)


def test_signs_of_roll_pitch_and_yaw():
    # right-handed: roll about X lowers the +Y boresight to +Z (down), yaw about Z brings it to −X (backwards)
    turned = {}
    for axis, offset in {"roll": (1.0, 0, 0), "pitch": (0, 1.0, 0), "yaw": (0, 0, 1.0)}.items():
        pointing = point(PointingParameters(offset_deg=offset, error_deg=0.0), R_KM, V_KM_S, rng())
        turned[axis] = local_level(R_KM, V_KM_S).apply(pointing.camera.boresight)
    s, c = math.sin(math.radians(1)), math.cos(math.radians(1))
    np.testing.assert_allclose(turned["roll"], [0, c, s], atol=1e-14)
    np.testing.assert_allclose(turned["pitch"], [0, 1, 0], atol=1e-14)
    np.testing.assert_allclose(turned["yaw"], [-s, c, 0], atol=1e-14)


def test_reference_mounting_turns_about_its_boresight_once_an_orbit():
    pointing = point(PointingParameters(error_deg=0.0), R_KM, V_KM_S, rng())
    n = 7000.0 * 7.5 / 7000.0**2  # |r × v| / r²
    np.testing.assert_allclose(pointing.rate_camera_rad_s, [0, 0, -n], atol=1e-18)


def test_orbital_rate_is_one_inertial_vector_whatever_offset_and_error():
    pointing = point(PointingParameters(offset_deg=(10.0, 20.0, -30.0), error_deg=25.0), R_KM, V_KM_S, rng())
    inertial = np.cross(R_KM, V_KM_S) / (R_KM @ R_KM)
    np.testing.assert_allclose(pointing.rate_camera_rad_s, pointing.camera.apply(inertial), atol=1e-17)


def test_body_rate_comes_on_top_in_body_axes():
    section = PointingParameters(error_deg=0.0, rate_deg_s=(0.1, 0.2, 0.3))
    rate = point(section, R_KM, V_KM_S, rng()).rate_camera_rad_s
    # camera x = −X, y = Z, z = Y of the body
    np.testing.assert_allclose(rate, np.radians([-0.1, 0.3, 0.2]) - [0, 0, 7.5 / 7000.0], atol=1e-17)


@pytest.mark.parametrize("propagator", ["j2", "sgp4"])
@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_rate_is_how_the_attitude_changes(propagator, mounting):
    """Against the pointing of the same orbit a little later, with offset: the rate is constant there but for the node's
    motion and precession (2e-7 rad/s), and with SGP4 the wobble of its osculating plane (2e-4 of the orbital rate) and
    the angular acceleration e n² dt² (1e-3 · 1e-6 · 25): over 5 s that is 1e-6 rad and 2e-6 rad."""
    orbit = build_orbit(OrbitParameters(propagator=propagator), EPOCH)
    section = PointingParameters(mounting=mounting, offset_deg=(20.0, -30.0, 40.0), error_deg=0.0)
    now = point(section, *orbit.state(1000.0), rng())
    for dt_s in (-5.0, 5.0):
        later = point(section, *orbit.state(1000.0 + dt_s), rng())
        assert attitude_at(now, dt_s).angle_to(later.camera) < 3e-6
        assert attitude_at(now, 0.0).angle_to(later.camera) > 4e-3
    assert (attitude_at(now, 1.0).source, attitude_at(now, 1.0).target) == ("icrs", "camera")


def test_attitude_at_is_a_right_handed_turn():
    section = PointingParameters(error_deg=0.0, rate_deg_s=(0.5, -0.4, 1.3))
    pointing = point(section, R_KM, V_KM_S, rng())
    expected = Rotation.from_rotvec(pointing.rate_camera_rad_s * 2.5).inv().as_matrix() @ pointing.camera.as_matrix()
    np.testing.assert_allclose(attitude_at(pointing, 2.5).as_matrix(), expected, atol=1e-14)


def test_random_attitudes_have_offset_error_and_rates_as_in_orbit():
    section = PointingParameters(offset_deg=(3.0, -2.0, 5.0), error_deg=1.5, rate_deg_s=(0.1, 0.0, 0.0))
    n = 7.5 / 7000.0
    anywhere = point_at_random(section, rng(), orbital_rate_rad_s=n)
    in_orbit = point(section, R_KM, V_KM_S, rng())
    np.testing.assert_allclose(
        anywhere.prior.rotation_vector_to(anywhere.camera),
        in_orbit.prior.rotation_vector_to(in_orbit.camera),
        atol=1e-14,
    )
    np.testing.assert_allclose(anywhere.rate_camera_rad_s, in_orbit.rate_camera_rad_s, atol=1e-17)
    np.testing.assert_allclose((anywhere.mounting @ anywhere.body).as_matrix(), anywhere.camera.as_matrix(), atol=1e-14)
    again = rng()
    again.uniform(-1, 1, 3)
    assert anywhere.prior.angle_to(random_attitude(again)) < 1e-14
    # without an orbital rate only the body's own remains
    still = point_at_random(section, rng())
    assert np.linalg.norm(still.rate_camera_rad_s) == pytest.approx(math.radians(0.1))


def test_the_stream_is_read_alike_whatever_the_section():
    sections = [PointingParameters(error_deg=e, mounting=m) for e, m in ((0.0, "zenith"), (1.0, "orbit_normal"))]
    left = []
    for section in sections:
        generator = rng()
        point(section, R_KM, V_KM_S, generator)
        left.append(generator.random())
    assert left[0] == left[1]


def test_same_generator_same_pointing_and_it_pickles():
    one, two = (point(PointingParameters(), R_KM, V_KM_S, rng()) for _ in range(2))
    copy = pickle.loads(pickle.dumps(one))
    for other in (two, copy):
        assert np.array_equal(one.camera.as_quat(), other.camera.as_quat())
        assert np.array_equal(one.rate_camera_rad_s, other.rate_camera_rad_s)
