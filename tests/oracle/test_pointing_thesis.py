"""Pointing against Appendix A of the thesis, and the boresight's path over a year.

Source: B. C. Greyling, "A Charge Coupled Device Star Sensor System for a Low Earth Orbit Microsatellite",
M.Eng. thesis, Stellenbosch, 1995,
section 3.2 and Appendix A. Its elementary rotations (A.1 to A.3) are taken as printed; of its products two things are
corrected. [θ_E0], the turn by u + π/2 about y, is printed as a turn about z (A.12), and [φ_E0] as one about y (A.13):
here they are the elementary matrices that the text names. Element (3,1) of (3.3)/(A.19), without which that matrix is
not orthogonal, is −cos(u + π/2) sin(π/2 − i). The final turn about z is by −Ω, which is the printed β + π/2 − Ω
with right ascension counted from the equinox. Tolerances: rounding of products of rotations, 1e-12.
"""

import math
from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.mission.frames import true_of_date
from simulator.mission.orbit import build_orbit
from simulator.mission.parameters import OrbitParameters, PointingParameters
from simulator.mission.pointing import boresight_path, local_level, mounting_of, point

EPOCH = datetime(2026, 3, 21, 12, tzinfo=UTC)
YEAR_S = 365.2422 * 86_400.0

THESIS_LOCAL_LEVEL_FROM_FOV = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])  # (A.9)
FOV_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])  # the thesis: x right, y up, z against the boresight


def turn_x(a):  # (A.3)
    return np.array([[1, 0, 0], [0, math.cos(a), math.sin(a)], [0, -math.sin(a), math.cos(a)]])


def turn_y(a):  # (A.2)
    return np.array([[math.cos(a), 0, -math.sin(a)], [0, 1, 0], [math.sin(a), 0, math.cos(a)]])


def turn_z(a):  # (A.1)
    return np.array([[math.cos(a), math.sin(a), 0], [-math.sin(a), math.cos(a), 0], [0, 0, 1]])


def thesis_celestial_from_camera(u, i, node):
    earth_from_level = turn_z(-node) @ turn_x(math.pi / 2 - i) @ turn_y(u + math.pi / 2)
    return earth_from_level @ THESIS_LOCAL_LEVEL_FROM_FOV @ FOV_FROM_CAMERA


def printed_total_matrix(u, i, gamma, corrected):
    """(3.3)/(A.19) as printed, or with its element (3,1) corrected; `gamma` is β + π/2 − Ω."""
    su, cu = math.sin(u + math.pi / 2), math.cos(u + math.pi / 2)
    si, ci = math.sin(math.pi / 2 - i), math.cos(math.pi / 2 - i)
    sg, cg = math.sin(gamma), math.cos(gamma)
    last = -cu * si if corrected else -cu * ci * sg
    return np.array(
        [
            [-cu * ci * cg + su * sg, si * cg, -su * ci * cg - cu * sg],
            [cu * ci * sg + su * cg, -si * sg, su * ci * sg - cu * cg],
            [last, -ci, -su * si],
        ]
    )


@pytest.mark.parametrize("u_deg", [0.0, 37.0, 90.0, 181.0, 305.5])
@pytest.mark.parametrize("raan_deg", [0.0, 155.0, 269.9])
@pytest.mark.parametrize("inclination_deg", [98.6, 51.6, 90.0])
def test_whole_camera_attitude_is_the_thesis_matrix(u_deg, raan_deg, inclination_deg):
    section = OrbitParameters(inclination_deg=inclination_deg, raan_deg=raan_deg, argument_of_latitude_deg=u_deg)
    orbit = build_orbit(section, EPOCH)
    camera = mounting_of(PointingParameters()).as_matrix() @ local_level(*orbit.state(0.0)).as_matrix()
    celestial_from_camera = true_of_date(orbit.clock, 0.0) @ camera.T
    expected = thesis_celestial_from_camera(*np.radians([u_deg, inclination_deg, raan_deg]))
    np.testing.assert_allclose(celestial_from_camera, expected, atol=1e-12)


def test_printed_matrix_is_a_rotation_only_with_its_element_corrected():
    angles = np.radians([37.0, 98.6, -65.0])
    corrected, printed = (printed_total_matrix(*angles, corrected=flag) for flag in (True, False))
    np.testing.assert_allclose(corrected @ corrected.T, np.eye(3), atol=1e-15)
    assert np.abs(printed @ printed.T - np.eye(3)).max() > 0.1
    # as z, y, z turns in place of z, x, y: the misprinted factors A.11 to A.16, in the order of A.17
    factors = turn_z(angles[2]) @ turn_y(math.pi / 2 - angles[1]) @ turn_z(angles[0] + math.pi / 2)
    np.testing.assert_allclose(corrected, factors @ THESIS_LOCAL_LEVEL_FROM_FOV, atol=1e-15)


@pytest.mark.parametrize("ltan_h", [0.0, 6.0, 22.5])
def test_boresight_stays_at_plus_8_6_degrees_and_90_degrees_ahead_of_the_node(ltan_h):
    orbit = build_orbit(OrbitParameters(inclination_deg=98.6, ltan_h=ltan_h), EPOCH)
    t_s = np.linspace(0.0, YEAR_S, 733)
    path = boresight_path(orbit, PointingParameters(), t_s)
    np.testing.assert_allclose(path.dec_date_deg, 8.6, atol=1e-9)
    ahead = (path.ra_date_deg - np.degrees(orbit.raan_rad(t_s)) - 90.0 + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(ahead, 0.0, atol=1e-9)
    assert np.all((path.ra_date_deg >= 0) & (path.ra_date_deg < 360))
    # once around the sky in the year, eastwards, through RA 0 wherever it began
    assert np.unwrap(np.radians(path.ra_date_deg))[-1] - math.radians(path.ra_date_deg[0]) > math.radians(355.0)
    # ICRS: precession has tilted the pole by 20.04″ a year, 0.152° at the end in 2027.22, and nutation does by ≤ 9.3″
    assert np.abs(path.dec_deg - 8.6).max() < 27.22 * 20.04 / 3600 + 9.3 / 3600
    assert np.abs(path.dec_deg - 8.6).max() > 0.13


def test_fixed_offset_makes_the_circle_of_section_3_2():
    # "Any offset from the +Y axis will cause the boresight path to form circles around a declination of 8.6°": a yaw of
    # 2° tips the boresight by 2° towards −X, at an angle that follows the spacecraft around its orbit
    orbit = build_orbit(OrbitParameters(inclination_deg=98.6), EPOCH)
    t_s = np.linspace(0.0, orbit.period_s, 91)
    path = boresight_path(orbit, PointingParameters(offset_deg=(0.0, 0.0, 2.0)), t_s)
    centre = boresight_path(orbit, PointingParameters(), t_s)

    def unit(ra, dec):
        ra, dec = np.radians(ra), np.radians(dec)
        return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)

    apart = np.linalg.norm(unit(path.ra_deg, path.dec_deg) - unit(centre.ra_deg, centre.dec_deg), axis=1)
    np.testing.assert_allclose(apart, 2 * math.sin(math.radians(1.0)), rtol=1e-12)
    # at the northernmost and southernmost points of the circle the declination of date is 8.6° ± 2°; 91 points miss
    # them by at most 2° of the turn, 2° (1 − cos 2°) = 0.0012°; pitch moves nothing
    assert path.dec_date_deg.max() == pytest.approx(10.6, abs=0.0013)
    assert path.dec_date_deg.min() == pytest.approx(6.6, abs=0.0013)
    pitched = boresight_path(orbit, PointingParameters(offset_deg=(0.0, 30.0, 0.0)), t_s)
    np.testing.assert_allclose(pitched.dec_deg, centre.dec_deg, atol=1e-10)


def test_path_over_a_pole():
    # a polar orbit and a boresight along the velocity: over the pole and through every right ascension wrap
    orbit = build_orbit(OrbitParameters(inclination_deg=90.0, raan_deg=0.0), EPOCH)
    t_s = np.linspace(0.0, orbit.period_s, 721)
    path = boresight_path(orbit, PointingParameters(mounting="forward"), t_s)
    assert np.all(np.isfinite(path.ra_deg))
    assert path.dec_date_deg.max() == pytest.approx(90.0, abs=1e-6)  # u = 0: straight up
    assert path.dec_date_deg.min() < -89.7
    assert np.all((path.ra_deg >= 0) & (path.ra_deg < 360))


def test_path_is_the_camera_that_point_gives():
    section = PointingParameters(offset_deg=(1.0, -2.0, 3.0), error_deg=0.0, mounting="zenith")
    orbit = build_orbit(OrbitParameters(), EPOCH)
    for t_s in (0.0, 1234.5, 1.9e7):
        pointing = point(section, *orbit.state(t_s), np.random.default_rng(0))
        path = boresight_path(orbit, section, t_s)
        # SciPy's own composition of the same three turns; its rotations turn vectors, so theirs are the inverses
        level = Rotation.from_matrix(local_level(*orbit.state(t_s)).as_matrix())
        offset = Rotation.from_rotvec(np.radians(section.offset_deg)).inv()
        mounting = Rotation.from_matrix(np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1.0]]))
        np.testing.assert_allclose((mounting * offset * level).as_matrix(), pointing.camera.as_matrix(), atol=1e-13)
        assert path.ra_deg == pytest.approx(pointing.camera.ra_deg, abs=1e-9)
        assert path.dec_deg == pytest.approx(pointing.camera.dec_deg, abs=1e-9)
