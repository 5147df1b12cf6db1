"""The matched filter against its theory and against SciPy's correlation.

Sources: Turin 1960, "An introduction to matched filters": in white noise a filter k finds a signal of shape p with the
signal-to-noise ratio F Σ p k / (σ √Σ k²), at best F √(Σ p²) / σ; scipy.ndimage.correlate1d (SciPy 1.17) for the sums,
scipy.stats.norm for the rate of false alarms. Tolerances: float32 rounding for the correlation; k·σ/√N otherwise,
derived where they stand.
"""

import numpy as np
import pytest
from scipy import ndimage
from scipy.special import erf
from scipy.stats import norm

from startracker.detection import Background, estimate, find_components
from startracker.detection.matched import filter_half, filtered_pixel, matched_kernel, search_filtered
from startracker.settings import DetectionSettings


def star(x, y, sigma, size=31):
    """Shares of a pixel-integrated Gaussian's light."""
    edges = np.arange(size + 1) - 0.5
    return np.outer(*(0.5 * np.diff(erf((edges - at) / sigma / np.sqrt(2))) for at in (y, x)))


def flat(shape, noise=1.0):
    return Background(np.full(shape, 100.0, np.float32), np.full(shape, noise, np.float32))


def filter_image(image, background, sigma):
    """The whole filtered image above the level, and the excess of its noise."""
    half = filter_half(sigma)
    level = background.level_plane
    filtered = [[filtered_pixel(image, level, half, x, y)[0] for x in range(image.shape[1])] for y in range(len(image))]
    return np.array(filtered), search_filtered(image, background, half, 5.0)[2]


@pytest.mark.parametrize("shape", [(40, 57), (3, 90), (90, 2), (1, 1)])
@pytest.mark.parametrize("sigma", [0.1, 0.8, 2.3])
def test_equals_scipy_and_leaves_bad_pixels_out(shape, sigma):
    rng = np.random.default_rng(5)
    image = rng.normal(100, 3, shape).astype(np.float32)
    bad = rng.random(shape) < 0.05
    image[bad] = rng.choice([np.nan, np.inf, -np.inf], bad.sum())
    filtered, _ = filter_image(image, flat(shape), sigma)
    signal = np.where(np.isfinite(image), image.astype(float) - 100.0, 0.0)
    kernel = matched_kernel(sigma)
    for axis in (0, 1):
        signal = ndimage.correlate1d(signal, kernel, axis, mode="constant")
    assert np.array_equal(np.isnan(filtered), bad)
    np.testing.assert_allclose(filtered[~bad], signal[~bad], atol=3e-5)  # float32 at 100 has steps of 8e-6


@pytest.mark.parametrize("shape", [(40, 57), (90, 8), (2, 300), (1, 1)])
@pytest.mark.parametrize("sigma", [0.1, 0.8, 2.3])
def test_search_is_thresholding_the_filtered_image(shape, sigma):
    rng = np.random.default_rng(6)
    image = rng.normal(100, 3, shape).astype(np.float32)
    bad = rng.random(shape) < 0.05
    image[bad] = np.nan
    y, x = np.mgrid[: shape[0], : shape[1]]
    level, noise = 100 + 0.02 * x - 0.01 * y, 3 + 0.01 * x + 0.02 * y
    background = Background(level.astype(np.float32), noise.astype(np.float32))
    signal = np.where(bad, 0.0, image.astype(float) - background.level)
    for axis in (0, 1):
        signal = ndimage.correlate1d(signal, matched_kernel(sigma), axis, mode="constant")
    for threshold in (0.2, 1.0, 2.5):
        runs, found, excess = search_filtered(image, background, filter_half(sigma), threshold)
        drawn = np.full(shape, np.nan)
        at = 0
        for row, first, last in runs:
            drawn[row, first:last] = found[at : at + last - first]
            at += last - first
        margin = signal - excess * threshold * background.noise
        assert np.isfinite(drawn[(margin > 1e-4) & ~bad]).all()
        assert np.isnan(drawn[(margin < -1e-4) | bad]).all()
        inside = np.isfinite(drawn)
        np.testing.assert_allclose(drawn[inside], signal[inside], atol=3e-5)
        assert at == len(found) == inside.sum()


@pytest.mark.parametrize(("x", "y"), [(15.0, 15.0), (15.5, 15.5), (15.2, 14.7)])
@pytest.mark.parametrize("sigma", [0.5, 0.8, 1.2])
def test_gain_in_signal_to_noise(x, y, sigma):
    shares = star(x, y, sigma)
    image = (100.0 + 1000.0 * shares).astype(np.float32)
    filtered, _ = filter_image(image, flat(image.shape), sigma)
    best = 1000.0 * np.sqrt(np.sum(shares**2))
    peak = float(filtered.max())
    assert peak <= best * (1 + 1e-5)  # Cauchy and Schwarz: nothing is better
    if (x, y) == (15.0, 15.0):
        assert peak == pytest.approx(best, rel=0.005)  # the filter ends at 2.5 σ
    assert peak > 1000.0 * shares.max()


def test_noise_keeps_its_size_and_false_alarms_are_those_of_the_normal_distribution():
    image = np.random.default_rng(1).normal(100, 3, (1000, 1000)).astype(np.float32)
    filtered, excess = filter_image(image, flat(image.shape, 3.0), 0.8)
    # correlated over some 8 pixels: the standard deviation is known to 1 / √(2 · 1e6 / 8) = 0.2 %, here 4 of these
    assert np.std(filtered) == pytest.approx(3.0, rel=0.008)
    assert excess == pytest.approx(1.0, abs=0.06)  # of 8192 pixels: quantiles to 1.5 %, 4σ
    above = np.count_nonzero(filtered > 4 * 3.0)
    expected = 1e6 * norm.sf(4)
    assert abs(above - expected) < 4 * np.sqrt(8 * expected)  # in clumps of up to 8
    assert len(find_components(image, flat(image.shape, 3.0), DetectionSettings(), None)) <= 5  # 0.3 expected


def test_correlated_noise_is_recognised():
    white = np.random.default_rng(2).normal(0, 3, (600, 600))
    smooth = ndimage.gaussian_filter(white, 0.7)
    smooth = (100 + 3 * smooth / smooth.std()).astype(np.float32)
    filtered, excess = filter_image(smooth, flat(smooth.shape, 3.0), 0.8)
    assert np.std(filtered) / 3.0 > 1.5
    assert excess == pytest.approx(np.std(filtered) / 3.0, rel=0.07)


def test_finds_stars_that_no_three_pixels_show():
    rng = np.random.default_rng(3)
    image = rng.normal(100, 3, (600, 600))
    grid = [(x, y) for x in range(30, 580, 60) for y in range(30, 580, 60)]
    phases = rng.uniform(-0.5, 0.5, (len(grid), 2))
    for (x, y), (u, v) in zip(grid, phases, strict=True):
        image[y - 15 : y + 16, x - 15 : x + 16] += 9.0 * 3.0 / 0.35 * star(15 + u, 15 + v, 0.8)
    image = image.astype(np.float32)
    background = estimate(image)
    found = {}
    for on in (False, True):
        settings = DetectionSettings(matched_filter=on, max_stars=1000)
        spots = find_components(image, background, settings, None)
        xy = np.column_stack([spots.x_peak, spots.y_peak])
        distance = np.hypot(*(np.array(grid)[:, None] - xy[None]).T) if len(xy) else np.full((1, len(grid)), np.inf)
        found[on] = np.count_nonzero(distance.min(axis=0) < 2.2)
        assert np.count_nonzero(distance.min(axis=1) >= 2.2) <= 2
    # signal-to-noise ratio 9 √(Σp²) / 0.35 ≥ 7.6 after the filter: under 1 % are missed at 5σ; before it the third
    # brightest pixel has under 4σ
    assert found[True] >= 97
    assert found[False] <= 60
