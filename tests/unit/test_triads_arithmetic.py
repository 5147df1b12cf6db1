"""Floating-point arithmetic of the triads: each operation against the thesis' formula written out star by star."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification.arithmetic import FloatArithmetic

PLAIN, EXACT = FloatArithmetic(), FloatArithmetic(exact=True)
ONE, OTHER = np.array([0]), np.array([1])


def cosine_side(b, c, angle):
    """Side opposite an angle by eq. 2.5, degrees."""
    b, c, angle = map(math.radians, (b, c, angle))
    return math.degrees(math.acos(math.cos(b) * math.cos(c) + math.sin(b) * math.sin(c) * math.cos(angle)))


@given(st.floats(-200, 200), st.floats(-150, 150))
def test_image_separation_is_equation_2_4(x, y):
    scale = np.array([0.021, 0.0216])
    image = PLAIN.image([[0.0, 0.0], [x, y]], scale)
    chi, psi = np.radians([x * scale[0], y * scale[1]])
    expected = math.degrees(math.acos(min(1.0, math.cos(chi) * math.cos(psi))))
    # acos of a cosine near one is good to 1e-6° alone
    assert PLAIN.image_separations(image, ONE, OTHER)[0] == pytest.approx(expected, abs=2e-6)


def test_small_separations_are_exact():
    image = PLAIN.image([[0.0, 0.0], [1e-6, 0.0]], [0.02, 0.02])
    assert PLAIN.image_separations(image, ONE, OTHER)[0] == pytest.approx(2e-8, rel=1e-9)
    sky = PLAIN.sky([10.0, 10.0], [20.0, 20.0 + 1e-8], 1.0)
    assert PLAIN.catalog_separations(sky, ONE, OTHER)[0] == pytest.approx(1e-8, rel=1e-4)


@given(st.floats(0, 359), st.floats(-80, 80), st.floats(0, 359), st.floats(-80, 80))
def test_catalogue_separation_is_equation_2_3(ra, dec, ra2, dec2):
    sky = PLAIN.sky([ra, ra2], [dec, dec2], 180.0)
    expected = cosine_side(90 - dec, 90 - dec2, ra2 - ra)
    assert PLAIN.catalog_separations(sky, ONE, OTHER)[0] == pytest.approx(expected, abs=3e-6)


def test_exact_geometry_sees_what_a_camera_sees():
    camera = Camera.from_fov(30.0, 640, 480)
    rng = np.random.default_rng(3)
    pixels = rng.uniform([0, 0], [640, 480], (12, 2))
    vectors = camera.unproject(pixels)
    matrix = Attitude.from_radec_roll(200.0, 10.0, 0.0).as_matrix()
    sky_vectors = vectors @ matrix
    ra = np.degrees(np.arctan2(sky_vectors[:, 1], sky_vectors[:, 0])) % 360
    dec = np.degrees(np.arcsin(sky_vectors[:, 2]))
    xy = (pixels - [319.5, 239.5]) * [1, -1]
    scale = math.degrees(camera.pixel_rad)
    image, sky = EXACT.image(xy, [scale, scale]), EXACT.sky(ra, dec, 60.0)
    i, j = np.triu_indices(12, 1)
    np.testing.assert_allclose(EXACT.image_separations(image, i, j), EXACT.catalog_separations(sky, i, j), rtol=1e-9)
    a, b, c = np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8]]).T
    for ours, theirs in zip(EXACT.image_enclosed(image, a, b, c), EXACT.catalog_enclosed(sky, a, b, c), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)
    # with roll 0 and the parity of the sky the picture need not be turned, but for the meridians' running together
    turn = EXACT.rotations(EXACT.catalog_directions(sky, a, b), EXACT.image_directions(image, a, b))
    assert np.abs((turn + 180) % 360 - 180).max() < 8.0
    plain = PLAIN.image_separations(image, i, j)
    assert np.abs(plain - EXACT.image_separations(image, i, j)).max() > 0.1  # eq. 2.4 is an approximation


def test_directions_of_the_thesis():
    # Vega: image vectors 1-2 and 1-3 at 173.3° and 182.8° (section 2.3.4.1)
    image = PLAIN.image([[16.13144, 74.39691], [-162.81865, 95.40933], [-73.08759, 69.96350]], [0.02, 0.02])
    angles = PLAIN.image_directions(image, np.array([0, 0]), np.array([1, 2]))
    np.testing.assert_allclose(angles, [173.3, 182.8], atol=0.05)
    sky = PLAIN.sky([359.0, 1.0], [10.0, 10.0], 10.0)  # across 0 h
    assert PLAIN.catalog_directions(sky, ONE, OTHER)[0] == pytest.approx(180.0)
    assert PLAIN.catalog_directions(sky, OTHER, ONE)[0] == pytest.approx(0.0)


def test_enclosed_angles_solve_the_cosine_rule():
    rng = np.random.default_rng(1)
    ra, dec = rng.uniform(0, 20, 9), rng.uniform(20, 40, 9)
    sky = PLAIN.sky(ra, dec, 60.0)
    i, j, k = np.arange(9).reshape(3, 3)
    at_i, at_j, at_k = PLAIN.catalog_enclosed(sky, i, j, k)
    side = PLAIN.catalog_separations
    for n in range(3):
        a, b, c = side(sky, j, k)[n], side(sky, i, k)[n], side(sky, i, j)[n]
        assert cosine_side(b, c, at_i[n]) == pytest.approx(a, abs=1e-9)
        assert cosine_side(a, c, at_j[n]) == pytest.approx(b, abs=1e-9)
        assert cosine_side(a, b, at_k[n]) == pytest.approx(c, abs=1e-9)
    image = PLAIN.image([[0, 0], [4, 0], [0, 3]], [1e-3, 2e-3])  # raw pixels, whatever the scales
    angles = [angle[0] for angle in PLAIN.image_enclosed(image, np.array([0]), np.array([1]), np.array([2]))]
    np.testing.assert_allclose(angles, np.degrees([math.pi / 2, math.atan2(3, 4), math.atan2(4, 3)]))


def test_coinciding_stars_have_no_angle():
    sky = PLAIN.sky([10.0, 10.0, 11.0], [5.0, 5.0, 5.0], 10.0)
    angles = PLAIN.catalog_enclosed(sky, np.array([0]), np.array([1]), np.array([2]))
    assert all(np.isfinite(angle).all() for angle in angles)


@given(st.floats(0, 359.9), st.floats(-4, 4))
def test_angles_know_the_circle(angle, step):
    first, second = np.array([angle]), np.array([(angle + step) % 360.0])
    assert PLAIN.angles_agree(first, second, abs(step) + 1e-9)[0]
    assert abs(step) < 1e-6 or not PLAIN.angles_agree(first, second, abs(step) - 1e-9)[0]
    mean = PLAIN.mean_rotations(first, second)[0]
    assert abs((mean - angle - step / 2 + 180) % 360 - 180) < 1e-9
    assert abs((PLAIN.group_mean(angle, 3 * step, 3) - angle - step + 180) % 360 - 180) < 1e-9


@pytest.mark.parametrize(
    ("xy", "scale"),
    [([[0, math.nan]], [1, 1]), ([0, 1], [1, 1]), ([[0, 1]], [0, 1]), ([[0, 1]], [1]), ([[0, 1]], [1, math.inf])],
)
def test_what_is_no_image_is_refused(xy, scale):
    with pytest.raises(InputError):
        PLAIN.image(xy, scale)
