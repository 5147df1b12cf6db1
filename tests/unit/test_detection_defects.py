"""Defective pixels of single frames: what is masked, what is not, and how gaps are bridged."""

import numpy as np
import pytest
from scipy.special import erf

from startracker.detection import estimate
from startracker.detection.artefacts import fill_gaps, mask_extremes, mask_impulses

SIZE = 200


def stars(rng, sigma, count, noise=4.0, faintest=200.0):
    """Stars of a Gaussian integrated over pixels, at random phases, fluxes from `faintest` over two decades."""
    image = 60.0 + noise * rng.standard_normal((SIZE, SIZE))
    edges = np.arange(SIZE + 1) - 0.5
    for _ in range(count):
        x, y = rng.uniform(5, SIZE - 6, 2)
        along_x, along_y = (0.5 * np.diff(erf((edges - c) / (np.sqrt(2.0) * sigma))) for c in (x, y))
        image += faintest * 10.0 ** rng.uniform(0.0, 2.0) * np.outer(along_y, along_x)
    return image


def extremes(image):
    return mask_extremes(image, float(np.nanmin(image)), float(np.nanmax(image)))


@pytest.mark.parametrize("sigma", [0.3, 0.5, 0.9, 1.5])
def test_stars_are_not_masked_as_hot_pixels(sigma):
    """With the sharpest, some stand on a pixel's centre, but they are not most of the objects."""
    image = stars(np.random.default_rng(1), sigma, 150).astype(np.float32)
    masked, count = mask_impulses(image, estimate(image))
    assert count == 0
    assert masked is image


@pytest.mark.parametrize("share", [0.003, 0.01, 0.05, 0.1])
@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
def test_hot_pixels_are_masked_and_stars_beside_them_kept(share, dtype):
    rng = np.random.default_rng(2)
    clean = stars(rng, 0.7, 20, faintest=2000.0)
    hot = rng.random(clean.shape) < share
    image = np.where(hot, clean + 300.0, clean).astype(dtype)
    masked, count = mask_impulses(image, estimate(image))
    found = ~np.isfinite(masked)
    sky = clean < 60.0 + 40.0  # a hot pixel in a star's image is not an impulse
    # missed where three of eight neighbours are hot too: 0.6 % at 5 %, 3.8 % at 10 %
    assert found[hot & sky].mean() > 0.95
    assert not found[~hot].any()
    assert count == found.sum()


@pytest.mark.parametrize("noise", [0.0, 4.0])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_values_far_beyond_the_others_are_masked_and_stars_are_not(noise, scale):
    rng = np.random.default_rng(3)
    clean = (scale * stars(rng, 0.6, 30, noise)).astype(np.float32)
    assert extremes(clean)[0] is clean
    image = clean.copy()
    y, x = rng.integers(0, SIZE, (2, 5))
    image[y, x] = np.float32(scale) * np.array([1e9, -1e9, 1e12, -3e30, 3e11], np.float32)
    masked, count = extremes(image)
    assert count == 5
    assert np.isnan(masked[y, x]).all()
    assert np.isfinite(masked).sum() == masked.size - 5


def test_a_border_of_missing_data_is_masked():
    image = stars(np.random.default_rng(4), 0.9, 30).astype(np.float32)
    image[:40] = -3.4e38
    masked, count = extremes(image)
    assert count == 40 * SIZE
    assert np.isnan(masked[:40]).all()


def test_gaps_are_bridged_exactly_over_a_smooth_surface():
    y, x = np.mgrid[:30, :40].astype(np.float64)
    surface = 5.0 + 0.3 * x + 0.02 * x**2 - 0.1 * y + 0.01 * y**2 + 0.004 * x * y
    image = surface.astype(np.float32)
    image[[3, 10, 20], [30, 7, 19]] = np.nan
    image[0, 0] = image[29, 39] = np.inf
    image[14:19, 24:29] = np.nan  # too wide: its middle has no neighbours
    filled = fill_gaps(image)
    assert np.abs(filled - surface)[[3, 10, 20], [30, 7, 19]].max() < 1e-4
    assert np.isfinite(filled[[0, 29], [0, 39]]).all()
    assert np.isnan(filled[15:18, 25:28]).all()
    whole = surface.astype(np.float32)
    assert fill_gaps(whole) is whole
