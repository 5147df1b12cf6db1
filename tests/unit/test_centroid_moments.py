"""First moment: kernels against NumPy twins, exactness on noise-free stars, borders, smear, bad input."""

import math

import numpy as np
import pytest
from scipy.special import erf
from scipy.stats import norm

from startracker.centroid import METHODS, first_moment
from startracker.centroid.bias import (
    GUESSES,
    fill_centres,
    guess_centre,
    invert_from,
    invert_moment,
    invert_moments,
    moment_bias,
    window_moments,
)
from startracker.centroid.frame import SYSTEMATIC_PX, measure_psf_sigma
from startracker.centroid.window import Peaks, Pixels, measure_stars, read_window
from startracker.detection import Background, Spots, estimate, find_components
from startracker.detection.tiles import as_plane
from startracker.errors import InputError
from startracker.settings import CentroidSettings, DetectionSettings

PHASES = np.linspace(-0.5, 0.5, 11)


def draw(shape, stars, sigma_x=1.0, sigma_y=None):
    """Pixel-integrated Gaussians, (x, y, flux)."""
    sigma_y = sigma_x if sigma_y is None else sigma_y
    image = np.zeros(shape)
    for x, y, flux in stars:
        along_x = 0.5 * np.diff(erf((np.arange(shape[1] + 1) - 0.5 - x) / sigma_x / np.sqrt(2)))
        along_y = 0.5 * np.diff(erf((np.arange(shape[0] + 1) - 0.5 - y) / sigma_y / np.sqrt(2)))
        image += flux * along_y[:, None] * along_x
    return image.astype(np.float32)


def flat(shape, level=0.0, noise=1.0):
    return Background(np.full(shape, level, np.float32), np.full(shape, noise, np.float32))


def spots_at(*peaks, saturated=False):
    x, y = np.array(peaks, dtype=np.int64).reshape(-1, 2).T.copy()
    n = len(x)
    flags = np.zeros(n, bool)
    return Spots(x, y, np.arange(n, 0.0, -1), np.full(n, 20), np.full(n, saturated), flags)


def grid_frame(sigma_x, sigma_y=None, flux=1e5):
    """A frame with one star at each of the 121 phases, and their positions."""
    centres = [(14 + 24 * i, 14 + 24 * j) for j in range(11) for i in range(11)]
    phases = [(p, q) for q in PHASES for p in PHASES]
    stars = [(x + p, y + q, flux) for (x, y), (p, q) in zip(centres, phases, strict=True)]
    return draw((270, 270), stars, sigma_x, sigma_y), np.array(stars)[:, :2]


def error_of(centroids, truth):
    nearest = np.hypot(*(centroids.xy[:, None] - truth).T).T.argmin(axis=1)
    assert sorted(nearest) == list(range(len(truth)))
    return centroids.xy - truth[nearest]


@pytest.mark.parametrize("low_high", [(-2, 2), (-1, 1), (0, 2), (-3, 1)])
@pytest.mark.parametrize("sigma", [0.3, 0.7, 1.23, 3.0])
def test_window_moments_against_scipy(sigma, low_high):
    low, high = low_high
    k = np.arange(low, high + 1)
    for centre in (-1.9, -0.3, 0.0, 0.5, 1.4):

        def moments(c, s):
            share = norm.cdf(k + 0.5, c, s) - norm.cdf(k - 0.5, c, s)
            mean = share @ k / share.sum()
            return np.array([share.sum(), mean, share @ k**2 / share.sum() - mean**2])

        found = np.array(window_moments(centre, sigma, low, high))
        # SciPy's differences lose digits in the tails: 1e-16 over a light of 1e-6
        assert np.allclose(found[:3], moments(centre, sigma), rtol=1e-9, atol=1e-9)
        step = 1e-6
        by_centre = (moments(centre + step, sigma) - moments(centre - step, sigma)) / (2 * step)
        by_sigma = (moments(centre, sigma + step) - moments(centre, sigma - step)) / (2 * step)
        assert np.allclose(found[[3, 5]], by_centre[1:], atol=1e-7)
        assert np.allclose(found[[4, 6]], by_sigma[1:], atol=1e-7)


@pytest.mark.parametrize("sigma", [0.4, 0.8, 1.5, 2.5])
def test_inverse_is_exact(sigma):
    for centre in np.linspace(-1.5, 1.5, 31):
        _, mean, variance, slope, *_ = window_moments(centre, sigma, -2, 2)
        found, inverse_slope = invert_moment(mean, sigma, -2, 2)
        assert found == pytest.approx(centre, abs=1e-10)
        assert inverse_slope == pytest.approx(1 / slope, rel=1e-6)
        both = invert_moments(mean, variance, -2, 2)
        assert both == pytest.approx((centre, sigma), abs=1e-6)


@pytest.mark.parametrize(("low", "high"), [(-2, 2), (-3, 1), (0, 2), (5, 11)])
@pytest.mark.parametrize("sigma", [0.11, 0.16, 0.25, 0.6, 2.5])
def test_inverse_from_any_guess(sigma, low, high):
    """Where the mean is a staircase of the centre, Newton's method leaves its bracket, and halves it."""
    middle = 0.5 * (low + high)
    for centre in np.linspace(low - 0.4, high + 0.4, 45):
        light, mean, _, slope, *_ = window_moments(centre, sigma, low, high)
        if slope < 1e-4:
            continue
        for guess in (mean, middle, low - 0.5, high + 0.5, centre + 0.3):
            found, inverse_slope, seen = invert_from(guess, mean, sigma, low, high)
            assert window_moments(found, sigma, low, high)[1] == pytest.approx(mean, abs=1e-9)
            assert found == pytest.approx(centre, abs=2e-9 / slope)
            assert inverse_slope == pytest.approx(1.0 / slope, rel=1e-3)
            assert seen == pytest.approx(light, rel=1e-3)


@pytest.mark.parametrize(("sigma", "half"), [(0.4, 1), (0.8, 2), (1.5, 2), (2.5, 3)])
def test_a_guess_from_the_table_is_near_the_centre(sigma, half):
    table = np.empty((GUESSES, 2))
    fill_centres(sigma, half, table)
    for centre in np.linspace(-0.99, 0.99, 34):
        light, mean, *_ = window_moments(centre, sigma, -half, half)
        guess = guess_centre(mean, table)
        # cubic over an eighth of a pixel: h⁴ / 384 times the fourth derivative, which grows as σ falls
        assert guess == pytest.approx(centre, abs=1e-5 if sigma > 0.5 else 2e-3)
        found, _, seen = invert_from(guess, mean, sigma, -half, half)
        assert found == pytest.approx(centre, abs=1e-10)
        assert seen == pytest.approx(light, rel=1e-6)
    far = window_moments(1.2, sigma, -half, half)[1]
    assert guess_centre(far, table) == far
    assert guess_centre(-far, table) == -far


@pytest.mark.parametrize("moment", [2.0, -2.5, 7.0])
def test_moment_that_no_star_explains(moment):
    assert invert_moment(moment, 1.0, -2, 2)[1] == np.inf
    assert np.isnan(invert_moments(0.0, 3.9, -2, 2)[1])


@pytest.mark.parametrize(("mean", "sigma"), [(1.9, 2.0), (1.999, 3.0), (2.1, 3.0), (2.5, 0.5)])
def test_no_gaussian_has_a_mean_that_none_reaches(mean, sigma):
    """Though one that is centred there has the variance: its mean over the window is another."""
    _, seen, variance, *_ = window_moments(mean, sigma, -2, 2)
    assert seen < mean - 0.05
    assert invert_moment(mean, sigma, -2, 2)[1] == np.inf
    assert np.isnan(invert_moments(mean, variance, -2, 2)[1])


def test_widths_that_are_found_are_those_of_the_moments():
    found = 0
    for mean in (-1.4, -0.3, 0.0, 0.8, 1.7):
        for variance in np.geomspace(0.02, 3.0, 12):
            centre, width = invert_moments(mean, variance, -2, 2)
            if np.isfinite(width):
                assert window_moments(centre, width, -2, 2)[1:3] == pytest.approx((mean, variance), abs=1e-6)
                found += 1
    assert 20 < found < 55


def test_bias_is_odd_and_vanishes_in_the_middle():
    offsets = np.linspace(-0.5, 0.5, 21)
    for integrated in (True, False):
        bias = moment_bias(offsets, 1.23, 5, integrated=integrated)
        assert np.allclose(bias, -bias[::-1], atol=1e-15)
        assert moment_bias(0.0, 1.23, 5, integrated=integrated).shape == ()


def test_read_window_against_numpy():
    rng = np.random.default_rng(1)
    image, level = rng.normal(50, 9, (20, 30)).astype(np.float32), np.full((20, 30), 30, np.float32)
    noise = rng.uniform(1, 3, (20, 30)).astype(np.float32)
    found = read_window(Pixels(image, as_plane(level), as_plane(noise), 0.5, 0.0), 12, 9, 2)
    k = np.arange(-2, 3)
    signal = (image - level).astype(float)[7:12, 10:15]
    variance = noise.astype(float)[7:12, 10:15] ** 2 + np.maximum(signal, 0) * 0.5
    total = signal.sum()
    mean_x, mean_y = (signal @ k).sum() / total, (signal.T @ k).sum() / total
    wx, wy = np.broadcast_to(k - mean_x, (5, 5)), np.broadcast_to(k - mean_y, (5, 5)).T
    expected = [total, mean_x, mean_y, (signal * wx**2).sum() / total, (signal * wy**2).sum() / total]
    expected += [(variance * a * b).sum() / total**2 for a, b in ((wx, wx), (wy, wy), (wx, wy))]
    assert np.allclose(found, [*expected, -2, 2, -2, 2], rtol=1e-6)


@pytest.mark.parametrize("sigma", [0.5, 0.8, 1.23, 1.8])
@pytest.mark.parametrize("window", [3, 5, 7])
def test_noise_free_stars_at_any_phase(sigma, window):
    image, truth = grid_frame(sigma)
    spots = find_components(image, flat(image.shape, 0, 0.01), DetectionSettings(max_stars=200), None)
    background = flat(image.shape, 0, 1.0)
    known = first_moment(image, background, spots, CentroidSettings(window_px=window, psf_sigma_px=sigma), 1.0)
    # float32 images carry 6e-8 of the peak; the slope of the correction multiplies it
    assert np.abs(error_of(known, truth)).max() < 1e-4
    assert np.abs(error_of(known, truth)).max() < 2e-6 or (window == 3 and sigma > 1)
    assert known.flux == pytest.approx(1e5, rel=1e-4)
    measured = first_moment(image, background, spots, CentroidSettings(window_px=window), 1.0)
    assert np.abs(error_of(measured, truth)).max() < 2e-3
    plain = first_moment(image, background, spots, CentroidSettings(window_px=window, bias_correction=False), 1.0)
    assert np.abs(error_of(plain, truth)).max() > 2e-4  # the correction does something


@pytest.mark.parametrize("sigmas", [(0.9, 1.4), (1.5, 0.8)])
def test_width_is_measured_along_each_axis(sigmas):
    image, truth = grid_frame(*sigmas)
    background = flat(image.shape, 0, 0.01)
    spots = find_components(image, background, DetectionSettings(max_stars=200), None)
    assert measure_psf_sigma(image, background, spots) == pytest.approx(sigmas, abs=1e-4)
    assert np.abs(error_of(first_moment(image, background, spots), truth)).max() < 2e-3


def test_airy_stars():
    # first dark ring at 1.5 to 3 px, noise-free, widths measured; a Gaussian is not the true image: 0.04 px remain
    from scipy.special import j1

    rng = np.random.default_rng(2)
    for ring, limit in ((1.5, 0.03), (2.0, 0.04), (2.5, 0.015), (3.0, 0.02)):
        image, truth = np.zeros((200, 200), np.float32), []
        for x in range(20, 190, 32):
            for y in range(20, 190, 32):
                dx, dy = rng.uniform(-0.5, 0.5, 2)
                v, u = np.mgrid[: 21 * 9, : 21 * 9] / 9 - 10.5 + 0.5 / 9
                v = np.maximum(np.hypot(u - dx, v - dy) * 3.8317 / ring, 1e-9)
                star = ((2 * j1(v) / v) ** 2).reshape(21, 9, 21, 9).sum(axis=(1, 3))
                image[y - 10 : y + 11, x - 10 : x + 11] = 1e4 * star / star.sum()
                truth.append((x + dx, y + dy))
        background = flat(image.shape, 0, 1.0)
        spots = find_components(image, background, DetectionSettings(), None)
        error = error_of(first_moment(image, background, spots, CentroidSettings(), 1.0), np.array(truth))
        assert np.abs(error).max() < limit


def test_choice_of_the_brightest_pixel_costs_nothing():
    # thesis Fig. 4.11: choosing the wrong one of two equal pixels cost 0.035 px
    for x in (20.5, 20.45, 20.55):
        image = draw((40, 40), [(x, 20.2, 1e5)], 1.23)
        found = [
            first_moment(image, flat(image.shape), spots_at((peak, y)), CentroidSettings(psf_sigma_px=1.23), 1.0).xy[0]
            for peak in (19, 20, 21, 22)
            for y in (19, 20, 21)
        ]
        assert np.abs(np.array(found) - [x, 20.2]).max() < 2e-6


def test_window_moves_to_the_star():
    # without the correction the wrong central pixel would cost 0.2 px; with it, noise
    image = draw((40, 40), [(20.2, 20.1, 1e5)], 1.1)
    settings = CentroidSettings(bias_correction=False)
    found = [
        first_moment(image, flat(image.shape), spots_at(peak), settings, 1.0) for peak in ((20, 20), (21, 20), (19, 21))
    ]
    for other in found[1:]:
        assert np.array_equal(other.xy, found[0].xy)
        assert np.array_equal(other.covariance, found[0].covariance)


@pytest.mark.parametrize("x", [0.0, 0.3, 0.9, -0.3, 61.4, 63.0])
def test_window_cut_by_the_border(x):
    image = draw((64, 64), [(x, 30.3, 1e5)], 1.1)
    peak = int(np.clip(round(x), 0, 63))
    found = first_moment(image, flat(image.shape), spots_at((peak, 30)), CentroidSettings(psf_sigma_px=1.1), 1.0)
    assert found.xy[0] == pytest.approx([x, 30.3], abs=1e-5)
    assert found.flux[0] == pytest.approx(1e5, rel=1e-4)
    inner = first_moment(
        draw((64, 64), [(30 + x % 1, 30.3, 1e5)], 1.1),
        flat((64, 64)),
        spots_at((30, 30)),
        CentroidSettings(psf_sigma_px=1.1),
        1.0,
    )
    if x < 0.5:
        assert found.covariance[0, 0, 0] > inner.covariance[0, 0, 0]


def test_uncorrected_moment_is_the_thesis_own():
    # eqs. 4.6 and 4.7 over 5 × 5
    image = draw((40, 40), [(20.3, 19.8, 1e5)], 1.23)
    window = image[18:23, 18:23].astype(float)
    k = np.arange(-2, 3)
    found = first_moment(image, flat(image.shape), spots_at((20, 20)), CentroidSettings(bias_correction=False), 1.0)
    assert found.xy[0, 0] == pytest.approx(20 + (window @ k).sum() / window.sum(), abs=1e-7)
    assert found.xy[0, 1] == pytest.approx(20 + (window.T @ k).sum() / window.sum(), abs=1e-7)


def test_saturated_star():
    image = np.minimum(draw((64, 64), [(30.3, 31.8, 4e6)], 1.2), 4095)
    spots = find_components(image, flat(image.shape, 0, 5), DetectionSettings(), 4095.0)
    found = first_moment(image, flat(image.shape, 0, 5), spots, CentroidSettings(), 1.0)
    assert found.saturated.tolist() == [True]
    assert np.abs(found.xy[0] - [30.3, 31.8]).max() < 0.05
    assert np.sqrt(found.covariance[0, 0, 0]) > 0.05


def test_bled_star_owns_up_to_it():
    image = np.minimum(draw((64, 64), [(30.3, 31.8, 1e6)], 1.2), 4095)
    image[15:50, 30] = 4095
    settings = DetectionSettings(max_axis_ratio=100)
    spots = find_components(image, flat(image.shape, 0, 5), settings, 4095.0)
    found = first_moment(image, flat(image.shape, 0, 5), spots, CentroidSettings(), 1.0)
    assert np.sqrt(found.covariance[0, 0, 0]) > 0.2
    assert np.abs(found.xy[0] - [30.3, 31.8]).max() < 3 * np.sqrt(found.covariance[0, 0, 0])


def test_neighbours_widen_the_covariance():
    settings = CentroidSettings(psf_sigma_px=1.0)
    alone = draw((40, 40), [(20, 20, 1e4)])
    pair = draw((40, 40), [(20, 20, 1e4), (24, 20, 3e4)])
    one = first_moment(alone, flat(alone.shape), spots_at((20, 20)), settings, 1.0)
    both = first_moment(pair, flat(pair.shape), spots_at((20, 20), (24, 20)), settings, 1.0)
    star = int(np.argmin(both.flux))
    assert np.abs(both.xy[star] - one.xy[0]).max() > 5 * np.sqrt(one.covariance[0, 0, 0])
    assert np.abs(both.xy[star] - one.xy[0]).max() < 2 * np.sqrt(both.covariance[star, 0, 0])


def test_bright_star_never_claims_less_than_the_floor():
    image = draw((40, 40), [(20, 20, 1e7)])
    found = first_moment(image, flat(image.shape), spots_at((20, 20)), CentroidSettings(psf_sigma_px=1.0), 1e6)
    assert np.sqrt(found.covariance[0, 0, 0]) == pytest.approx(SYSTEMATIC_PX, rel=1e-3)


def test_light_within_one_pixel():
    image = np.zeros((20, 20), np.float32)
    image[10, 10] = 1000
    found = first_moment(image, flat(image.shape), spots_at((10, 10)), CentroidSettings(psf_sigma_px=0.12), 1.0)
    assert np.hypot(*(found.xy[0] - 10)) < 0.5
    assert 0.1 < np.sqrt(found.covariance[0, 0, 0]) < 0.4


def test_without_a_gain_the_covariance_is_still_positive():
    image, _ = grid_frame(1.0)
    image += 100 + np.random.default_rng(1).normal(0, 3, image.shape).astype(np.float32)
    for shift in (0, -100, -5000):
        background = estimate(image + shift)
        spots = find_components(image + np.float32(shift), background, DetectionSettings(), None)
        found = first_moment(image + np.float32(shift), background, spots, CentroidSettings())
        assert (np.linalg.eigvalsh(found.covariance) > 0).all()


def test_brightest_first_and_hopeless_windows_left_out():
    image = draw((64, 64), [(10, 10, 1e4), (30, 30, 5e4), (50, 50, 2e4), (50, 10, 3e4)])
    image[10, 51] = np.nan
    spots = spots_at((10, 10), (30, 30), (50, 50), (50, 10), (10, 50))  # the last has no light
    image[49:52, 9:12] = -5
    found = first_moment(image, flat(image.shape), spots, CentroidSettings(psf_sigma_px=1.0), 1.0)
    # that with a pixel missing beside its middle is measured by the others
    assert found.flux == pytest.approx([5e4, 3e4, 2e4, 1e4], rel=1e-3)
    assert found.xy == pytest.approx(np.array([[30, 30], [50, 10], [50, 50], [10, 10]]), abs=0.01)
    assert found.covariance.shape == (4, 2, 2)


def test_no_spots():
    found = METHODS["moment"](np.zeros((9, 9), np.float32), flat((9, 9)), Spots.none(), CentroidSettings(), None)
    assert len(found) == 0
    assert found.xy.shape == (0, 2)


def test_width_when_no_star_tells():
    image = np.zeros((30, 30), np.float32)
    assert measure_psf_sigma(image, flat(image.shape), Spots.none()) == (1.0, 1.0)
    assert measure_psf_sigma(image, flat(image.shape), spots_at((10, 10), saturated=True)) == (1.0, 1.0)


@pytest.mark.parametrize(
    ("settings", "gain", "match"),
    [
        ({"window_px": 4}, 1.0, "window_px is 4"),
        ({"window_px": 1}, 1.0, "window_px is 1"),
        ({"psf_sigma_px": 0.0}, 1.0, "psf_sigma_px is 0.0"),
        ({"psf_sigma_px": np.nan}, 1.0, "psf_sigma_px is nan"),
        ({}, 0.0, "gain is 0.0"),
        ({}, -1.0, "gain is -1.0"),
    ],
)
def test_unusable_input(settings, gain, match):
    with pytest.raises(InputError, match=match):
        first_moment(np.zeros((9, 9), np.float32), flat((9, 9)), Spots.none(), CentroidSettings(**settings), gain)


def test_background_must_fit():
    with pytest.raises(InputError, match="its background"):
        first_moment(np.zeros((9, 9), np.float32), flat((9, 8)), Spots.none(), CentroidSettings(), None)


def test_where_no_star_image_is_nothing_is_measured():
    """The light of one pixel beside noise, under windows made for wide stars: its error came out as 20 pixels."""
    rng = np.random.default_rng(3)
    for _ in range(300):
        image = rng.normal(0.0, 4.3, (24, 24)).astype(np.float32)
        image[12, 12] += 33.0
        background = Background(np.zeros_like(image), np.full_like(image, 4.3))
        found = first_moment(image, background, spots_at((12, 12)), CentroidSettings(psf_sigma_px=0.9), 3.3)
        assert (np.sqrt(found.covariance[:, [0, 1], [0, 1]]) < 1.1).all()


def measured(image, noise, sigma, half, *, peak, pixels=1, saturated=False, correct=True):
    """Row of one star with a given brightest pixel, on a background of zero."""
    planes = as_plane(np.zeros(image.shape, np.float32)), as_plane(np.full(image.shape, noise, np.float32))
    peaks = Peaks(*(np.array([value]) for value in (*peak, pixels, saturated)))
    return measure_stars(Pixels(image, *planes, 0.0, 0.0), peaks, half, *sigma, correct)[0]


@pytest.mark.parametrize("wide", [0, 1])
def test_a_star_known_no_better_than_its_width_is_none(wide):
    """The wider axis counts, and at least one pixel; noise of the size of its own light over the window."""
    for sigmas in ((1.0, 2.5), (0.5, 0.6)):
        sigma = sigmas if wide else sigmas[::-1]
        image = draw((41, 41), [(20.2, 19.9, 1000.0)], *sigma)
        limit = max(*sigma, 1.0) ** 2
        certain = measured(image, 1e-3, sigma, 4, peak=(20, 20))
        largest = max(certain[3:5]) / 1e-6  # variances go with that of the noise
        for share, found in ((0.98, True), (1.02, False)):
            row = measured(image, math.sqrt(share * limit / largest), sigma, 4, peak=(20, 20))
            assert bool(np.isfinite(row).all()) is found
    np.testing.assert_allclose(certain[:2], [20.2, 19.9], atol=1e-4)


@pytest.mark.parametrize("off", [(0, 0), (3, 0), (0, -3), (-2, 2)])
def test_the_window_of_a_flat_top_moves_to_its_middle(off):
    """Any of the saturated pixels may be given as the brightest; also at a corner of the image."""
    for x, y in ((30.3, 31.8), (1.4, 62.2)):
        image = np.minimum(draw((64, 64), [(x, y, 4e6)], 1.2), 4095)
        peak = (min(max(round(x) + off[0], 0), 63), min(max(round(y) + off[1], 0), 63))
        given = {"pixels": int(np.count_nonzero(image == 4095)), "saturated": True}
        row = measured(image, 5.0, (1.2, 1.2), 2, peak=peak, **given)
        expected = measured(image, 5.0, (1.2, 1.2), 2, peak=(round(x), round(y)), **given)
        np.testing.assert_allclose(row, expected)
        assert np.abs(row[:2] - [x, y]).max() < (0.05 if x > 10 else 1.5)
    dark = np.zeros((64, 64), np.float32)
    assert np.isnan(measured(dark, 5.0, (1.2, 1.2), 2, peak=(30, 30), saturated=True)).all()


def test_charge_along_an_axis_adds_to_the_error_of_a_flat_top():
    """0.05 px and a quarter of the difference of the widths, on both axes."""
    image = draw((64, 64), [(30.0, 32.0, 1e4)], 1.0, 2.0)
    row = measured(image, 1e-3, (1.0, 2.0), 8, peak=(30, 32), saturated=True)
    widths = math.sqrt(1.0 + 1.0 / 12.0) - math.sqrt(4.0 + 1.0 / 12.0)
    np.testing.assert_allclose(row[3:5], 0.05**2 + (0.25 * widths) ** 2, rtol=1e-3)
    assert row[2] == pytest.approx(1e4, rel=1e-4)
