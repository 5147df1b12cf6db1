"""The model of a trail against the formula and its differences: pixels, χ², slopes, light, subtraction."""

import math

import numpy as np
import pytest
from scipy.special import ndtr

from startracker.detection.tiles import Plane, as_plane, fill_plane
from startracker.trails.lines import best_lines, bin_residual
from startracker.trails.model import (
    ANGLE,
    BLOCK,
    HALF,
    LINE,
    SIGMA,
    WORK_ROWS,
    X,
    Y,
    is_near,
    linearise,
    residual_of,
    set_light,
    subtract_trail,
    window_pixels,
)

TRAILS = {
    "flat": (30.3, 24.8, 5000.0, 3.0, 0.2, 9.0, 1.1),
    "steep": (31.1, 25.6, 4000.0, -2.0, 1.9, 7.0, 0.8),
    "along a row": (30.0, 25.2, 3000.0, 0.0, 0.0, 8.0, 1.3),
    "along a column": (30.4, 25.0, 3000.0, 1.0, math.pi / 2.0, 6.0, 0.9),
    "backwards": (30.4, 25.0, 3000.0, 1.0, -2.5, 12.0, 1.6),
    "at the corner": (3.2, 2.1, 3000.0, 1.0, 0.8, 10.0, 1.0),
}
SHAPE = (52, 61)


@pytest.fixture(params=TRAILS)
def trail(request):
    return np.array(TRAILS[request.param])


def along_and_across(p, x, y):
    dx, dy, cos, sin = x - p[0], y - p[1], math.cos(p[4]), math.sin(p[4])
    return dx * cos + dy * sin, dy * cos - dx * sin


def light(p, x, y):
    s, t = along_and_across(p, x, y)
    along = ndtr((s + p[5]) / p[6]) - ndtr((s - p[5]) / p[6])
    return p[2] / (2.0 * p[5]) * along * np.exp(-0.5 * (t / p[6]) ** 2) / (p[6] * math.sqrt(2.0 * math.pi)) + p[3]


def read(image, noise, trail, slack=0.0):
    """The pixels of the window, and how many of them are usable."""
    pixels, usable = window_pixels(image, as_plane(noise), trail, slack)
    assert pixels.shape[1] % BLOCK == 0
    return pixels, usable


@pytest.mark.parametrize("slack", [0.0, 4.0])
def test_the_window_is_five_widths_beyond_and_three_and_a_half_beside(trail, slack):
    rng = np.random.default_rng(1)
    image = rng.normal(size=SHAPE).astype(np.float32)
    image[24:26, 28] = np.nan
    noise = np.full(SHAPE, 2.0, np.float32)
    pixels, usable = read(image, noise, trail, slack)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    s, t = along_and_across(trail, x, y)
    inside = (np.abs(s) <= trail[HALF] + 5.0 * trail[SIGMA] + slack) & (np.abs(t) <= 3.5 * trail[SIGMA] + 1.0)
    good = inside & np.isfinite(image)
    given = np.isfinite(pixels[3])
    assert usable == np.count_nonzero(given) == np.count_nonzero(good)
    column, row = pixels[0, given].astype(int), pixels[1, given].astype(int)
    found = np.zeros(SHAPE, int)
    np.add.at(found, (row, column), 1)
    np.testing.assert_array_equal(found, good)
    np.testing.assert_array_equal(pixels[2, given], image[row, column])
    np.testing.assert_array_equal(pixels[3, given], 4.0)
    assert pixels.shape[1] - BLOCK < np.count_nonzero(inside) <= pixels.shape[1]


@pytest.mark.parametrize("inverse_gain", [0.0, 0.7])
def test_chi_square_and_slopes_are_those_of_the_formula(trail, inverse_gain):
    rng = np.random.default_rng(2)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    image = (light(trail, x, y) + rng.normal(0.0, 3.0, SHAPE)).astype(np.float32)
    image[25, 30] += 900.0  # beyond the cut
    pixels, _ = read(image, np.full(SHAPE, 3.0, np.float32), trail)
    work, normal, right = np.zeros((WORK_ROWS, BLOCK)), np.empty((LINE, LINE)), np.empty(LINE)
    chi2, outliers = linearise(pixels, trail, LINE, inverse_gain, 8.0, work, normal, right)
    x, y, value, variance = pixels[:, np.isfinite(pixels[3])]
    model = light(trail, x, y)
    weight = 1.0 / (variance + inverse_gain * np.maximum(model - trail[3], 0.0))
    rest = value - model
    error2 = rest**2 * weight
    # the tables of the normal distribution are within 3e-5, of a light of some 100 σ
    assert chi2 == pytest.approx(np.minimum(error2, 64.0).sum(), rel=1e-3)
    assert outliers == np.count_nonzero(error2 > 25.0)
    weight[error2 > 64.0] = 0.0
    steps = np.array([1e-4, 1e-4, 1.0, 1e-2, 1e-5, 1e-4, 1e-4])
    slopes = []
    for k, step in enumerate(steps):
        ends = []
        for sign in (1.0, -1.0):
            moved = trail.copy()
            moved[k] += sign * step
            ends.append(light(moved, x, y))
        slopes.append((ends[0] - ends[1]) / (2.0 * step))
    slopes = np.array(slopes)
    expected = (slopes * weight) @ slopes.T
    size = np.sqrt(np.diag(expected))
    lower = np.tril_indices(LINE)
    np.testing.assert_allclose(
        (normal / np.outer(size, size))[lower], (expected / np.outer(size, size))[lower], atol=2e-3
    )
    np.testing.assert_allclose(right / size, slopes @ (weight * rest) / size, atol=0.1)
    few = np.empty(LINE)
    linearise(pixels, trail, 4, inverse_gain, 8.0, work, normal, few)
    np.testing.assert_allclose(few[:4], right[:4])
    assert (few[4:] == 0.0).all()


def test_the_light_of_known_lines_is_found_in_one_step(trail):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    pixels, _ = read(light(trail, x, y).astype(np.float32), np.full(SHAPE, 3.0, np.float32), trail)
    other = trail.copy()
    other[2:4] = 77.0, 5.0
    set_light(pixels, other, np.zeros((WORK_ROWS, BLOCK)), np.empty((LINE, LINE)), np.empty(LINE))
    assert other[2] == pytest.approx(trail[2], rel=1e-3)
    assert other[3] == pytest.approx(trail[3], abs=0.05)


def test_a_trail_is_taken_off_without_its_sky_and_added_again(trail):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    image = light(trail, x, y).astype(np.float32)
    rest = image.copy()
    subtract_trail(rest, trail, 1.0)
    # tables within 3e-5 of the brightest pixel; 1e-9 of the light is beyond the window
    np.testing.assert_allclose(rest, trail[3], atol=2e-4 * image.max())
    subtract_trail(rest, trail, -1.0)
    np.testing.assert_allclose(rest, image, atol=1e-4)


def test_trails_are_near_if_the_light_of_one_reaches_into_the_window_of_the_other():
    p = np.array([30.0, 30.0, 1.0, 0.0, 0.6, 9.0, 1.2])
    other = p.copy()
    other[HALF] = 4.0
    for along, across, near in (
        (9.0 + 4.0 + 10.0 * 1.2 - 0.01, 0.0, True),
        (-(9.0 + 4.0 + 10.0 * 1.2 + 0.01), 0.0, False),
        (0.0, 2.0 * (3.5 * 1.2 + 2.0) - 0.01, True),
        (0.0, -(2.0 * (3.5 * 1.2 + 2.0) + 0.01), False),
        (20.0, 11.0, True),
        (20.0, 13.0, False),
        (26.0, 11.0, False),
    ):
        other[X] = p[X] + along * math.cos(p[ANGLE]) - across * math.sin(p[ANGLE])
        other[Y] = p[Y] + along * math.sin(p[ANGLE]) + across * math.cos(p[ANGLE])
        assert is_near(p, other) is near


def test_what_is_saturated_or_not_finite_has_no_residual():
    image = np.array([[10.0, 99.0], [100.0, np.nan], [101.0, -np.inf]], np.float32)
    level = np.arange(6.0, dtype=np.float32).reshape(3, 2)
    expected = [[10.0, 98.0], [np.nan, np.nan], [np.nan, np.nan]]
    np.testing.assert_array_equal(residual_of(image, as_plane(level), 100.0), expected)
    np.testing.assert_array_equal(residual_of(image, as_plane(level), math.inf)[1:, 0], [98.0, 97.0])


def test_bins_are_sums_over_squares_in_standard_deviations():
    """With noise that is linear between three lines, the last of which lies below the image's last row."""
    rng = np.random.default_rng(4)
    lines = np.outer([1.0, 2.0, 7.0], np.linspace(1.0, 1.3, 14)).astype(np.float32)
    rows = np.linspace(0.0, 1.95, 17)
    noise = Plane(lines, np.floor(rows).astype(np.int64), (rows % 1.0).astype(np.float32))
    residual = rng.normal(size=(17, 14)).astype(np.float32)
    residual[3, 4], residual[5, 7], residual[6, 8] = np.nan, np.inf, -np.inf
    for side in (1, 2, 3, 4):
        height, width = 17 // side, 14 // side
        kept = np.where(np.isfinite(residual), residual, 0.0)[: height * side, : width * side]
        sums = kept.reshape(height, side, width, side).sum(axis=(1, 3))
        scale = side * fill_plane(noise)[: height * side : side, : width * side : side]
        np.testing.assert_allclose(bin_residual(residual, noise, side), sums / scale, rtol=1e-4, atol=1e-5)


def test_the_best_line_through_each_bin_is_that_of_all_sums():
    """A value a column, on the nearest row of the sheared image; beyond its borders there is nothing to be summed."""
    rng = np.random.default_rng(5)
    bins = rng.normal(size=(15, 9)).astype(np.float32)  # column by column
    slopes = np.array([-0.9, -0.3, 0.0, 0.45])
    every, spans = np.array([2, 1]), np.array([[3, 7], [4, 8], [3, 7], [5, 9]])
    best, line = best_lines(bins, slopes, every, spans)
    width, height = bins.shape
    expected, which = np.full((width, height), -np.inf), np.zeros((width, height), int)
    for k, slope in enumerate(slopes):
        offset = np.floor(slope * (np.arange(width) - 0.5 * width) + 0.5).astype(int)
        for m in range(2):
            if k % every[m]:
                continue
            span = spans[k, m]
            for x in range(width - span + 1):
                middle = x + span // 2
                for y in range(height):
                    at = [y + offset[c] - offset[middle] for c in range(x, x + span)]
                    total = sum(bins[x + c, row] for c, row in enumerate(at) if 0 <= row < height)
                    if total / math.sqrt(span) > expected[middle, y]:
                        expected[middle, y], which[middle, y] = total / math.sqrt(span), 2 * k + m
    np.testing.assert_allclose(best, expected, atol=1e-5)
    np.testing.assert_array_equal(line, which)
