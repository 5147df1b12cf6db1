"""Pictures of the sky by their formulas: stretch, colours of stars, pixels in a page, and grey images of mosaics."""

import base64
import io
import math
import re

import numpy as np
import pytest
from PIL import Image

from startracker.display import PICTURE_PX
from startracker.errors import InputError
from startracker.images.bayer import _sky, bayer_to_grey
from startracker.images.picture import _levels, photograph, pixel_bytes, rgb_pixels, stretch
from startracker.images.star_colours import _B_V_GRID, rgb_of_b_v, star_tint, tinted

RNG = np.random.default_rng(2)
SKY = RNG.normal(50.0, 3.0, (90, 120)).astype(np.float32)
SKY[40:44, 60:64] += 900.0


def levels_of(values):
    sky, top = np.percentile(values, (50.0, 99.95))
    noise = 1.4826 * np.median(np.abs(values - sky))
    return sky, max(top, sky + 25.0 * noise), noise


# ---------------------------------------------------------------------- stretch
def test_levels_of_an_image():
    """Median, 99.95 % but at least 25 times the noise above it, robust noise; of few values the standard deviation."""
    assert _levels(SKY) == pytest.approx(levels_of(SKY))
    faint = SKY[:30]
    sky, top, noise = _levels(faint)
    assert top == pytest.approx(sky + 25.0 * noise)
    assert _levels(np.where(SKY > 56.0, np.nan, SKY)) == pytest.approx(levels_of(SKY[SKY <= 56.0]))
    even = np.full((10, 10), 7.0, np.float32)
    assert _levels(even) == (7.0, 32.0, 1.0)
    even[0, :3] = 9.0
    assert _levels(even)[2] == pytest.approx(even.std())
    assert _levels(np.full((3, 3), np.nan, np.float32)) is None
    large = np.zeros((1500, 1500), np.float32)  # every second row and column is looked at
    large[1::2] = large[:, 1::2] = 5.0
    assert _levels(large)[0] == 0.0


def test_the_stretch_is_an_arcsinh_above_two_sigma_below_the_sky():
    sky, top, noise = levels_of(SKY)
    black = sky - 2.0 * noise
    signal = np.clip(SKY - black, 0.0, top - black)
    expected = np.arcsinh(signal / (8.0 * noise)) / math.asinh((top - black) / (8.0 * noise))
    np.testing.assert_allclose(stretch(SKY), expected, atol=2e-6)
    damaged = SKY.copy()
    damaged[0, :3] = np.nan, np.inf, -np.inf
    shown = stretch(damaged)
    level = np.arcsinh(2.0 / 8.0) / math.asinh((top - black) / (8.0 * noise))
    np.testing.assert_allclose(shown[0, :3], [level, 1.0, 0.0], atol=2e-3)


def test_colours_keep_their_ratios():
    colour = np.stack([SKY, 2.0 * SKY + 10.0, 0.5 * SKY], axis=2)
    shown, signal = stretch(colour), np.empty(colour.shape)
    for k in range(3):
        sky, _, noise = levels_of(colour[..., k])
        signal[..., k] = np.clip(colour[..., k] - (sky - 2.0 * noise), 0.0, None)
    bright = stretch(colour.mean(axis=2))
    expected = signal * (bright / np.maximum(signal.mean(axis=2), 1e-6))[..., None]
    expected /= np.maximum(expected.max(axis=2, keepdims=True), 1.0)
    np.testing.assert_allclose(shown, expected, atol=1e-5)
    assert shown.max() <= 1.0
    dark = np.stack([SKY, np.full_like(SKY, np.nan), SKY], axis=2)
    assert np.isfinite(stretch(dark)[..., 0]).all()


def test_brightness_in_eight_bits():
    found = rgb_pixels(np.array([[-1.0, 0.0, 0.5, 1.0, 2.0, 100.4 / 255.0, 100.6 / 255.0]], np.float32))
    assert found.shape == (1, 7, 3)
    assert found[0, :, 1].tolist() == [0, 0, 128, 255, 255, 100, 101]
    colour = np.zeros((2, 2, 3), np.float32)
    colour[..., 2] = 1.0
    assert rgb_pixels(colour)[0, 0].tolist() == [0, 0, 255]


@pytest.mark.parametrize(("side", "factor"), [(600, 1), (599, 2), (300, 2), (299, 3)])
def test_small_pictures_are_enlarged_to_600_pixels(side, factor):
    """By a whole number; a grey picture has one channel, a coloured one three."""
    grey = np.repeat(RNG.integers(0, 255, (20, side, 1), np.uint8), 3, axis=2)
    with Image.open(io.BytesIO(pixel_bytes(grey))) as picture:
        assert (picture.size, picture.mode) == ((side * factor, 20 * factor), "L")
        np.testing.assert_array_equal(np.asarray(picture)[::factor, ::factor], grey[..., 0])
    grey[3, 4, 1] += 1
    with Image.open(io.BytesIO(pixel_bytes(grey))) as picture:
        assert picture.mode == "RGB"
        np.testing.assert_array_equal(np.asarray(picture)[factor - 1 :: factor, factor - 1 :: factor], grey)


@pytest.mark.parametrize(("width", "step"), [(2 * PICTURE_PX - 1, 1), (2 * PICTURE_PX, 2), (4 * PICTURE_PX + 3, 3)])
def test_pictures_for_a_page_are_means_of_squares(width, step):
    image = RNG.normal(100.0, 5.0, (50, width)).astype(np.float32)
    page = photograph(image, "<sky>")
    assert 'alt="&lt;sky&gt;"' in page
    assert f"max-width:{PICTURE_PX}px" in page
    with Image.open(io.BytesIO(base64.b64decode(re.search(r"base64,([^\"]+)", page)[1]))) as picture:
        assert picture.size == (width // step, 50 // step)
        whole = image[: 50 - 50 % step, : width - width % step]
        mean = whole.reshape(50 // step, step, width // step, step).mean(axis=(1, 3))
        shown = np.asarray(picture, float)
        np.testing.assert_allclose(shown.mean(), rgb_pixels(stretch(mean)).mean(), atol=2.0)
    assert "base64" in photograph(image[:1], "a line")


# ---------------------------------------------------------------------- colours of stars
def test_stars_are_black_bodies():
    """Of Ballesteros' temperature, with Planck's law and the standard observer; the largest component is 1."""
    from colour import MSDS_CMFS, RGB_COLOURSPACES

    observer = MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    metre = observer.wavelengths * 1e-9
    for b_v in _B_V_GRID[[0, 10, 21, 48]]:
        kelvin = 4600.0 * (1.0 / (0.92 * b_v + 1.7) + 1.0 / (0.92 * b_v + 0.62))
        light = metre**-5.0 / np.expm1(6.62607015e-34 * 299792458.0 / (1.380649e-23 * metre * kelvin))
        rgb = RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB @ (light @ observer.values)
        rgb = np.clip(rgb, 0.0, None)
        np.testing.assert_allclose(rgb_of_b_v(np.array([b_v]))[0], rgb / rgb.max(), rtol=1e-6)
    between = rgb_of_b_v(np.array([_B_V_GRID[5] + 0.25 * (_B_V_GRID[6] - _B_V_GRID[5])]))[0]
    ends = rgb_of_b_v(_B_V_GRID[[5, 6]])
    np.testing.assert_allclose(between, 0.75 * ends[0] + 0.25 * ends[1])
    np.testing.assert_array_equal(rgb_of_b_v(np.array([-3.0, 9.0])), rgb_of_b_v(np.array([-0.4, 2.0])))


def test_the_tint_is_averaged_by_flux_with_moffat_profiles():
    """(1 + r²/4)^−1.5 in a window of 8 px for the faintest star, growing with the fourth root of the flux to 48; white
    has 0.02 of the weight of the faintest."""
    xy = np.array([[30.3, 20.6], [45.0, 22.0], [70.2, 40.0], [-60.0, 10.0], [20.0, 50.0]])
    flux, b_v = np.array([160.0, 10.0, 1e5, 50.0, -1.0]), np.array([1.5, -0.2, 0.5, 0.1, 0.3])
    rgb, total = rgb_of_b_v(b_v), np.zeros((60, 120, 4))
    y, x = np.mgrid[:60, :120]
    for k in (0, 1, 2, 3):
        reach = int(np.clip(8.0 * (flux[k] / 10.0) ** 0.25, 8, 48))
        column, row = np.round(xy[k]).astype(int)
        window = (np.abs(x - column) <= reach) & (np.abs(y - row) <= reach)
        weight = flux[k] / 10.0 * (1.0 + ((x - xy[k, 0]) ** 2 + (y - xy[k, 1]) ** 2) / 4.0) ** -1.5 * window
        total += weight[..., None] * np.append(rgb[k], 1.0)
    total += 0.02
    np.testing.assert_allclose(star_tint((60, 120), xy, flux, b_v), total[..., :3] / total[..., 3:], rtol=2e-5)
    assert (star_tint((6, 7), xy[4:], flux[4:], b_v[4:]) == 1.0).all()
    image = RNG.normal(20.0, 2.0, (60, 120)).astype(np.float32)
    sky = np.median(image)
    expected = sky + (image - sky)[..., None] * star_tint((60, 120), xy, flux, b_v)
    np.testing.assert_allclose(tinted(image, xy, flux, b_v), expected, rtol=1e-6)


# ---------------------------------------------------------------------- mosaics
def test_the_sky_of_a_site_is_clipped_at_three_sigma():
    values = RNG.normal(100.0, 4.0, 4000).astype(np.float32)
    values[:50] = 5000.0
    values[50] = np.nan
    sample = values[np.isfinite(values)].astype(float)
    for _ in range(5):
        kept = np.abs(sample - np.median(sample)) <= 3.0 * sample.std()
        if kept.all():
            break
        sample = sample[kept]
    assert _sky(values) == pytest.approx((np.median(sample), sample.std()))
    assert _sky(np.full(4, np.nan, np.float32)) == (0.0, 0.0)
    assert _sky(np.full(4, 3.0, np.float32)) == (3.0, 0.0)
    many = np.zeros(2 * 65536, np.float32)  # every second value is looked at
    many[1::2] = 9.0
    assert _sky(many) == (0.0, 0.0)


@pytest.mark.parametrize(("pattern", "green"), [("RGGB", (1, 2)), ("BGGR", (1, 2)), ("grbg", (0, 3)), ("GBRG", (0, 3))])
def test_sites_are_scaled_to_the_green_ones(pattern, green):
    mosaic = np.empty((60, 80))
    for k, (level, noise) in enumerate(((100.0, 3.0), (200.0, 6.0), (210.0, 5.0), (50.0, 2.0))):
        row, column = divmod(k, 2)
        mosaic[row::2, column::2] = np.random.default_rng(k).normal(level, noise, (30, 40))
    found = bayer_to_grey(mosaic, pattern)
    skies = [_sky(mosaic[k // 2 :: 2, k % 2 :: 2].astype(np.float32)) for k in range(4)]
    level, noise = np.mean([skies[k] for k in green], axis=0)
    for k, (own, spread) in enumerate(skies):
        cut = (slice(k // 2, None, 2), slice(k % 2, None, 2))
        np.testing.assert_allclose(found[cut], (mosaic[cut] - own) * noise / spread + level, rtol=1e-5)
    np.testing.assert_array_equal(bayer_to_grey(mosaic, pattern, balance=False), mosaic.astype(np.float32))
    flat = mosaic.copy()
    flat[1::2, 1::2] = 50.0  # without noise a site is only shifted
    spread = [_sky(flat[k // 2 :: 2, k % 2 :: 2].astype(np.float32)) for k in green]
    np.testing.assert_allclose(bayer_to_grey(flat, pattern)[1::2, 1::2], np.mean([one[0] for one in spread]), rtol=1e-5)


def test_what_is_no_mosaic():
    for wrong in (np.zeros(4), np.zeros((1, 4)), np.zeros((4, 1)), np.full((2, 2), "a")):
        with pytest.raises(InputError, match="at least 2×2"):
            bayer_to_grey(wrong)
    assert bayer_to_grey(np.zeros((2, 2))).shape == (2, 2)
    for name in ("RGBG", 3, None):
        with pytest.raises(InputError, match="it must be one of RGGB"):
            bayer_to_grey(np.zeros((4, 4)), name)
