"""Displacement of faint stars against bright ones, and skewness: each step against its formula in NumPy."""

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from startracker.centroid import asymmetry
from startracker.centroid.asymmetry import (
    Difference,
    _averaged,
    _fit_weighted,
    _measure,
    _pooled,
    correct_asymmetry,
    displaced_part,
    measure_difference,
    reference_psf,
)
from startracker.centroid.psf_model import gaussian_psf
from startracker.centroid.psf_sums import fill_window
from startracker.centroid.skewness import common_skewness, expansions_of, shifts, skewness_covariance
from startracker.centroid.window import Pixels
from startracker.detection.tiles import as_plane

SIDE, SIZE = 9, 60
PSF = gaussian_psf(1.1, 0.8, 0.15, radius_px=8.0)


def pixels_of(image, noise, gain=0.0, flat=0.0):
    noise = np.broadcast_to(np.float32(noise), image.shape)
    planes = (as_plane(np.array(values, np.float32)) for values in (np.zeros(image.shape), noise))
    return Pixels(np.asarray(image, np.float32), *planes, gain, flat)


def model_of(star, left, top):
    """Light (N,) of a unit star in a window, and its derivatives by x and y of the star."""
    slopes = np.empty((3, SIDE * SIDE))
    fill_window(PSF.samples, left - star[0], top - star[1], SIDE, SIDE, slopes, np.empty((6, SIDE)))
    return slopes[0], -slopes[1], -slopes[2]


def fit(star, window, dark, signal, contrast):
    work, slopes, lines = np.empty((3, SIDE * SIDE)), np.empty((3, SIDE * SIDE)), np.empty((6, SIDE))
    work[0], work[1] = signal, dark
    gains, at = np.zeros((2, SIDE * SIDE)), np.zeros(2)
    assert _fit_weighted(PSF.samples, star, (*window, SIDE), contrast, work, slopes, lines, gains, at)
    return at, gains


@pytest.mark.parametrize("contrast", [0.0, 4.0, 50.0])
def test_the_gain_of_a_pixel_is_that_of_weighted_least_squares(contrast):
    """(Dᵀ W D)⁻¹ Dᵀ W for flux and position, with W the inverse of dark variance × (1 + contrast × light/peak); and the
    position is that of two steps with these weights, in noise."""
    rng = np.random.default_rng(4)
    dark, star = rng.uniform(2.0, 9.0, SIDE * SIDE), (24.3, 16.8, 700.0)
    light = 730.0 * model_of((24.35, 16.74), 20, 13)[0]
    signal = light + rng.normal(size=light.shape) * np.sqrt(dark + light)
    at, gains = fit(star, (20, 13), dark, signal, contrast)
    x, y, flux = star
    for step in range(2):
        share, by_x, by_y = model_of((x, y), 20, 13)
        design = np.stack([flux * share, flux * by_x, flux * by_y])
        weight = 1.0 / (dark * (1.0 + contrast * np.maximum(share, 0.0) / share.max()))
        solution = np.linalg.solve(design * weight @ design.T, design * weight)
        if step == 0:
            np.testing.assert_allclose(gains, solution[1:], rtol=1e-6, atol=1e-12)
        move = solution @ (signal - flux * share)
        x, y, flux = x + move[1], y + move[2], flux * math.exp(move[0])
    np.testing.assert_allclose(at, [x, y], atol=1e-9)


def test_differences_of_stars():
    """Position with equal weights minus that of the reference, its noise by the difference of the gains, and the mean
    variance of the dark; none for a window that is not complete."""
    rng = np.random.default_rng(7)
    stars = np.array(
        [[20.3, 30.7, 3000.0], [40.6, 12.2, 900.0], [3.4, 30.0, 900.0], [30.0, 56.5, 900.0], [30.0, 42.0, 900.0]]
    )
    edge = np.array([[4.2, 4.3, 900.0], [55.4, 55.2, 900.0]])  # windows of 9 pixels that just fit
    stars = np.concatenate([stars, edge])
    noise, image = rng.uniform(2.0, 4.0, (SIZE, SIZE)).astype(np.float32), np.zeros((SIZE, SIZE))
    y, x = np.mgrid[:SIZE, :SIZE]
    for a, b, f in stars:
        image += f * PSF.shares(x - a, y - b)
    image += rng.normal(size=image.shape) * noise
    image[42, 33] = np.nan
    pixels, found = pixels_of(image, noise, 0.5, 0.02), np.full((len(stars), 4), np.nan)
    _measure(pixels, PSF.samples, np.column_stack([stars, np.zeros((len(stars), 3))]), np.arange(len(stars)), 4, found)
    assert np.isfinite(found).all(axis=1).tolist() == [True, True, False, False, False, True, True]
    for k in (0, 1, 5, 6):
        left, top = round(stars[k, 0]) - 4, round(stars[k, 1]) - 4
        cut = (slice(top, top + SIDE), slice(left, left + SIDE))
        signal, dark = pixels.image[cut].astype(float).ravel(), noise[cut].astype(float).ravel() ** 2
        (plain, one), (reference, other) = (fit(tuple(stars[k]), (left, top), dark, signal, c) for c in (0.0, 50.0))
        light = np.maximum(stars[k, 2] * model_of(stars[k], left, top)[0], 0.0)
        variance = dark + 0.5 * light + (0.02 * light) ** 2
        np.testing.assert_allclose(found[k, :2], plain - reference, atol=1e-9)
        assert found[k, 2] == pytest.approx(0.5 * ((one - other) ** 2 * variance).sum(), rel=1e-6)
        assert found[k, 3] == pytest.approx(dark.mean(), rel=1e-6)


def test_differences_that_are_pooled(monkeypatch):
    """Finite ones of less than two pixels, near the others; the width of the image includes the pixel's."""
    rng = np.random.default_rng(3)
    rows = np.column_stack([rng.normal(0.05, 0.02, (9, 2)), np.full(9, 4e-4), np.linspace(3.0, 5.0, 9)])
    rows[1, 2], rows[2, 0], rows[3, 1], rows[4, 0] = np.nan, 2.1, -2.1, 1.9
    table = np.column_stack([np.indices((3, 3)).reshape(2, -1).T * 30.0, np.arange(9.0, 0.0, -1.0), np.zeros((9, 3))])
    monkeypatch.setattr(asymmetry, "_measure", lambda p, s, t, stars, h, found: found.__setitem__(slice(None), rows))
    nothing = np.zeros(9, bool)
    found = measure_difference(None, gaussian_psf(0.7, 0.4, 0.1, radius_px=4.0), table, nothing, 3)
    kept = rows[[0, 5, 6, 7, 8]]
    expected = _averaged(*_pooled(kept[:, :2], kept[:, 2]), math.sqrt(0.55 + 1.0 / 12.0), kept[:, 3].mean())
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    rows[:, 2] = np.nan
    none = measure_difference(None, PSF, table, nothing, 3)
    assert (none.mean.tolist(), none.covariance.tolist(), none.asymmetric) == ([0.0, 0.0], [[0.0, 0.0]] * 2, 0.0)


def test_a_displacement_in_positions_and_covariances():
    """Part g of the contrast in the brightest pixel; what the stars share by their weights is common, the rest their
    own. A star of which a part is saturated keeps its position, and states the whole displacement."""
    rng = np.random.default_rng(2)
    table = np.column_stack(
        [
            rng.uniform(10, 50, (6, 2)),
            np.geomspace(3e4, 200, 6),
            rng.uniform(1e-5, 2e-3, (6, 2)),
            rng.normal(0, 1e-4, 6),
        ]
    )
    table[1, 4], table[2, 2], table[5, 3:5] = np.nan, -5.0, 2e-5
    unfit = np.arange(6) == 3
    square = np.array([[4e-4, 1e-4], [1e-4, 9e-4]])
    found = Difference(np.array([0.05, -0.03]), square, 0.6, 16.0)
    pixels, psf, after = (
        pixels_of(np.zeros((9, 9)), 4.0, 0.5, 0.01),
        gaussian_psf(0.9, 0.6, 0.2, radius_px=4.0),
        table.copy(),
    )
    common = correct_asymmetry(found, pixels, psf, after, unfit)
    expected, used = table.copy(), [0, 4, 5]
    peak = table[used, 2] / (2.0 * np.pi * np.sqrt(np.linalg.det([[0.9 + 1 / 12, 0.2], [0.2, 0.6 + 1 / 12]])))
    part = displaced_part((0.5 * peak + (0.01 * peak) ** 2) / 16.0)
    weight = 1.0 / np.maximum(table[used, 3] + table[used, 4], 2e-4)
    middle = np.average(part, weights=weight)
    own = (part - middle) ** 2
    assert own.min() > 1e-4
    expected[used, :2] -= part[:, None] * found.mean
    expected[used, 3:6] += own[:, None] * [square[0, 0], square[1, 1], square[0, 1]]
    whole = square + np.outer(found.mean, found.mean)
    expected[3, 3:6] += whole[0, 0], whole[1, 1], whole[0, 1]
    np.testing.assert_allclose(after, expected, rtol=1e-12)
    np.testing.assert_allclose(common, middle**2 * square, rtol=1e-12)
    assert not correct_asymmetry(found, pixels, psf, after, np.ones(6, bool)).any()


@pytest.mark.parametrize(
    ("variance", "half", "windows"),
    [(1.0, 3, [6, 3]), (2.6, 3, [6, 5]), (0.4, 4, [8, 4]), (20.0, 3, [6, 8]), (2.0, 2, [4])],
)
def test_windows_of_the_reference_ellipse(monkeypatch, variance, half, windows):
    """Twice the half width at first, then 2½ widths along the longer axis, from the first half width to 8 px, until the
    window stays; with the weights of the reference, from four times the variances, then from the ellipse before."""
    calls, shape = [], (0.5 * variance + 0.1, 0.5 * variance + 0.1, 0.5 * variance - 0.1)

    def fitted(pixels, starts, stars, size, start, contrast):
        calls.append((size, start, contrast))
        assert (starts.half == half).all()
        return shape, (0.01, 0.02)

    monkeypatch.setattr(asymmetry, "fit_gaussian", fitted)
    table = np.column_stack([np.indices((3, 3)).reshape(2, -1).T * 30.0, np.arange(9.0, 0.0, -1.0), np.zeros((9, 3))])
    found = reference_psf(None, gaussian_psf(0.9, 0.9, radius_px=4.0), table, np.zeros(9, bool), half)
    assert [call[0] for call in calls] == windows
    assert [call[1:] for call in calls] == [((3.6, 3.6, 0.0), 50.0), (shape, 50.0)][: len(calls)]
    assert found.shape == pytest.approx(shape)
    assert found.width_error == (0.01, 0.02)
    least = max(gaussian_psf(0.9, 0.9, radius_px=4.0).radius_px, 2.5 * math.sqrt(variance) + 2.0)
    assert least <= found.radius_px <= least + 3.0 / found.oversampling + 1e-9


@pytest.mark.parametrize("shape", [(math.nan,) * 3, (0.0, 1.0, 0.0), (1.0, 1.0, 1.0), (-1.0, -1.0, 0.0)])
def test_a_reference_ellipse_that_cannot_be_fitted(monkeypatch, shape):
    monkeypatch.setattr(asymmetry, "fit_gaussian", lambda *_: (shape, (0.0, 0.0)))
    table = np.column_stack([np.indices((3, 3)).reshape(2, -1).T * 30.0, np.ones(9), np.zeros((9, 3))])
    assert reference_psf(None, PSF, table, np.zeros(9, bool), 3) is None


# ---------------------------------------------------------------------- skewness
@pytest.mark.parametrize(("flux", "flat"), [(100.0, 0.0), (2e4, 0.0), (2e4, 0.03)])
def test_shift_per_cumulant(flux, flat):
    """A = (Dᵀ W D)⁻¹ Dᵀ W K with D of value and position and K of the cumulants."""
    expansions = expansions_of(3, (0.9, 0.7, 0.1))
    light = flux * expansions[:, 0]
    weight = 1.0 / (16.0 + 0.5 * light + (flat * light) ** 2)
    design, skew = expansions[:, :3], expansions[:, 6:]
    expected = np.linalg.solve(design.T * weight @ design, design.T * weight @ skew)[1:]
    np.testing.assert_allclose(shifts(expansions, 16.0, flux, 0.5, flat), expected, rtol=1e-9, atol=1e-15)
    # row by row, with the variance of the pixel
    v, u = (axis.ravel() for axis in np.mgrid[-3:4, -3:4])
    matrix = np.array([[0.9, 0.1], [0.1, 0.7]]) + np.eye(2) / 12.0
    np.testing.assert_allclose(expansions[:, 0], multivariate_normal(cov=matrix).pdf(np.stack([u, v], axis=1)))


def skewed_field(seed=1, count=9, cumulant=0.25):
    """Nine stars 18 px apart of an image whose Gaussian has a third cumulant along x, with noise, as table."""
    rng, half = np.random.default_rng(seed), 8
    corner = np.stack(np.divmod(np.arange(count), 3), axis=1) * 18.0 + 12.0
    table = np.column_stack([corner, np.linspace(9e4, 5e4, count), np.full((count, 3), 1e-4)])
    expansions = expansions_of(half, (0.9, 0.7, 0.1))
    image = rng.normal(0.0, 4.0, (SIZE, SIZE))
    for x, y, f in table[:, :3]:
        part = f * (expansions[:, 0] + cumulant * expansions[:, 6]).reshape(17, 17)
        image[int(y) - 8 : int(y) + 9, int(x) - 8 : int(x) + 9] += part
    return pixels_of(image, 4.0, 0.5, 0.0), table


def test_covariance_of_the_shift_of_all():
    """A₀ of a star with fifty times the photon noise in its peak, times κ κᵀ and its covariance, by what is kept of κ:
    1 − (7.8/χ²)²."""
    shape, unfit = (0.9, 0.7, 0.1), np.arange(9) == 4
    seen = []
    for cumulant in (0.0, 0.007, 0.01, 0.25):
        pixels, table = skewed_field(cumulant=cumulant)
        left = np.array([0, 1, 2, 3, 5, 6, 7, 8])
        mean, covariance, chi2, dark = common_skewness(pixels, table, left, 3, shape)
        found = skewness_covariance(pixels, table, unfit, 3, shape)
        seen.append(chi2)
        if chi2 <= 7.8:
            assert not found.any()
            continue
        kept = 1.0 - (7.8 / chi2) ** 2
        peak = 1.0 / (2.0 * np.pi * np.sqrt(np.linalg.det([[0.9 + 1 / 12, 0.1], [0.1, 0.7 + 1 / 12]])))
        reference = shifts(expansions_of(3, shape), dark, 50.0 * dark / (0.5 * peak), 0.5, 0.0)
        expected = reference @ (kept * covariance + kept**2 * np.outer(mean, mean)) @ reference.T
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert min(seen) < 7.8 < sorted(seen)[-2] < 30.0


def test_images_whose_skewness_is_not_measured():
    """Narrower than 0.3 px² along an axis; of a ratio of axes of 1.5 or more; and without photon noise the reference is
    a star of the background's."""
    pixels, table = skewed_field()
    nothing = np.zeros(9, bool)
    for shape, measured in (
        ((0.9, 0.301, 0.0), False),  # a streak: 0.9 > 2.25 × 0.301
        ((0.67, 0.301, 0.0), True),
        ((0.67, 0.299, 0.0), False),
        ((0.68, 0.301, 0.0), False),
        ((0.9, 0.9, 0.34), True),  # axes of 1.24 and 0.56: a ratio of 2.214
        ((0.9, 0.9, 0.36), False),  # 1.26 and 0.54: 2.33
        ((0.45, 0.45, 0.16), False),  # 0.29 along the narrower axis
        ((math.nan, 0.7, 0.0), False),
    ):
        assert skewness_covariance(pixels, table, nothing, 3, shape).any() == measured, shape
    dark = pixels._replace(inverse_gain=0.0)
    mean, covariance, chi2, variance = common_skewness(dark, table, np.arange(9), 3, (0.9, 0.7, 0.1))
    kept, faint = 1.0 - (7.8 / chi2) ** 2, shifts(expansions_of(3, (0.9, 0.7, 0.1)), variance, 0.0, 0.0, 0.0)
    expected = faint @ (kept * covariance + kept**2 * np.outer(mean, mean)) @ faint.T
    np.testing.assert_allclose(skewness_covariance(dark, table, nothing, 3, (0.9, 0.7, 0.1)), expected, rtol=1e-9)


def test_too_few_stars_for_a_common_skewness():
    """Three with complete windows are needed; one at the border or with a missing pixel is none of them."""
    pixels, table = skewed_field()
    shape = (0.9, 0.7, 0.1)
    assert common_skewness(pixels, table, np.arange(3), 3, shape)[2] > 0.0
    for x, y in ((2.4, 12.0), (12.0, 2.4), (56.6, 12.0), (12.0, 56.6)):
        table[2, :2] = x, y
        mean, covariance, chi2, dark = common_skewness(pixels, table, np.arange(3), 3, shape)
        assert (mean.any(), covariance.any(), chi2, dark) == (False, False, 0.0, 1.0)
    for x, y in ((2.6, 12.0), (12.0, 2.6), (56.4, 12.0), (12.0, 56.4)):
        table[2, :2] = x, y
        assert common_skewness(pixels, table, np.arange(3), 3, shape)[2] != 0.0
    pixels, table = skewed_field()
    pixels.image[12, 13] = np.nan
    assert common_skewness(pixels, table, np.array([0, 1, 2]), 3, shape)[2] == 0.0
    assert common_skewness(pixels, table, np.array([0, 1, 2, 3]), 3, shape)[2] > 0.0
