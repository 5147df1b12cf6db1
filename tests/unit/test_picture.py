"""Stretch, star colours and formats of pictures."""

import io

import numpy as np
import pytest
from matplotlib import rc_context
from PIL import Image

from startracker.images.picture import FORMATS, pixel_bytes, rgb_pixels, stretch
from startracker.images.star_colours import rgb_of_b_v, star_tint, tinted

RNG = np.random.default_rng(1)
SKY = RNG.normal(50.0, 3.0, (480, 640))
SKY[100:103, 200:203] += 2000.0
SKY[300:303, 400:403] += 60.0


def test_the_stretch_is_positive_with_a_dark_grey_sky():
    shown = stretch(SKY)
    assert shown.min() == 0.0
    assert shown.max() == 1.0
    assert 0.02 < np.median(shown) < 0.15
    assert shown[101, 201] > shown[301, 401] > 3 * np.median(shown)  # bright and faint star are both seen
    order = np.argsort(SKY, axis=None)
    assert (np.diff(shown.ravel()[order]) >= 0.0).all()


def test_the_stretch_of_damaged_images_is_finite():
    assert not stretch(np.full((4, 4), np.nan)).any()
    assert np.isfinite(stretch(np.where(SKY > 55.0, np.nan, SKY))).all()
    assert np.isfinite(stretch(np.full((5, 5), 7.0))).all()


def test_scale_and_offset_do_not_matter():
    np.testing.assert_allclose(stretch(SKY), stretch(256.0 * SKY + 1000.0), atol=1e-3)


def test_colours_of_stars_follow_their_temperature():
    blue, sun, red = rgb_of_b_v(np.array([-0.2, 0.65, 1.6]))
    assert blue[2] == 1.0
    assert blue[0] < 0.75
    # Sun of 5,800 K: near white, a little warmer than D65
    assert sun[0] == 1.0
    assert 0.75 < sun[2] < 0.98
    assert red[0] == 1.0
    assert red[2] < 0.35
    np.testing.assert_array_equal(rgb_of_b_v(np.array([np.nan])), [[1.0, 1.0, 1.0]])


def test_the_tint_is_that_of_the_star_at_it_and_white_far_away():
    tint = star_tint((100, 120), np.array([[20.0, 30.0], [90.0, 70.0]]), np.array([100.0, 5.0]), np.array([1.6, -0.2]))
    np.testing.assert_allclose(tint[30, 20], rgb_of_b_v(np.array([1.6]))[0], atol=0.02)
    assert tint[70, 90, 2] > tint[70, 90, 0]
    np.testing.assert_allclose(tint[5, 115], 1.0)
    grey = np.full((100, 120), 10.0)
    np.testing.assert_allclose(tinted(grey, np.array([[20.0, 30.0]]), np.array([1.0]), np.array([1.6])), 10.0)


@pytest.mark.parametrize("form", FORMATS)
def test_pixels_in_every_format(form):
    data = pixel_bytes(rgb_pixels(stretch(SKY)), form)
    start = {"png": b"\x89PNG", "jpg": b"\xff\xd8\xff", "jpeg": b"\xff\xd8\xff", "svg": b"<?xml", "pdf": b"%PDF"}[form]
    assert data.startswith(start)
    if form in ("png", "jpg", "jpeg"):
        with Image.open(io.BytesIO(data)) as picture:
            assert picture.size == (640, 480)
    with rc_context({"figure.autolayout": True}):  # as Basilisk sets it for the whole program
        assert pixel_bytes(rgb_pixels(stretch(SKY)), form) == data


def test_small_frames_are_enlarged():
    with Image.open(io.BytesIO(pixel_bytes(rgb_pixels(stretch(SKY[:165, :192]))))) as picture:
        assert picture.size == (768, 660)
