"""Kernels of detection against plain NumPy and SciPy twins."""

import math

import numpy as np
import pytest
from scipy import ndimage

from startracker.detection.artefacts import peak_share
from startracker.detection.background import Background, estimate
from startracker.detection.classify import is_clutter, new_stamp
from startracker.detection.forms import are_long, brightest_first, is_halo, measure_forms
from startracker.detection.matched import filter_half, filter_stamp, matched_kernel, quantiles, stamp_pitch
from startracker.detection.scan import UNFILTERED, runs_above, search_rows
from startracker.detection.shapes import measure_shapes
from startracker.detection.sources import SOURCE, Searched, find_runs, join_tables
from startracker.detection.tiles import (
    Plane,
    as_plane,
    fill_plane,
    find_kth,
    sample_plane,
    smooth_tiles,
    tile_statistics,
    whole_step,
)
from startracker.detection.values import as_image, as_pixels, is_value, whole_range


def rng(*key):
    return np.random.default_rng([31, *key])


def scan_rows(image, level, noise, half, threshold, stride):
    groups, found, sample = search_rows(image, level, noise, half, threshold, stride)
    return *runs_above(groups, found, image, noise, threshold), sample


def a_plane(height=23, width=17):
    lines = rng(1).normal(100, 5, (3, width)).astype(np.float32)
    place = np.linspace(-0.4, 2.4, height)
    cell = np.clip(np.floor(place), 0, 1).astype(np.int64)
    plane = Plane(lines, cell, (place - cell).astype(np.float32))
    whole = lines[cell] + (place - cell)[:, None] * (lines[cell + 1].astype(float) - lines[cell])
    return plane, whole


def test_a_plane_is_the_map_between_its_lines():
    plane, whole = a_plane()
    np.testing.assert_allclose(fill_plane(plane), whole, atol=1e-4)  # float32 at 100 has steps of 8e-6
    y, x = np.indices(whole.shape)
    np.testing.assert_allclose(plane[y, x], whole, atol=1e-4)
    np.testing.assert_array_equal(sample_plane(plane, 5, 3), fill_plane(plane)[::5, ::3].ravel())
    assert np.array_equal(fill_plane(as_plane(fill_plane(plane))), fill_plane(plane))


def test_kernels_read_a_plane_as_the_array_it_stands_for():
    image = rng(2).normal(100, 5, (200, 150)).astype(np.float32)
    background = estimate(image, 32)
    given = Background(background.level, background.noise)
    x, y = rng(3).integers(0, 150, 40), rng(3, 1).integers(0, 200, 40)
    of_tiles = measure_shapes(image, background.level_plane, background.noise_plane, x, y, 1.2)
    assert np.array_equal(of_tiles, measure_shapes(image, given.level, given.noise, x, y, 1.2), equal_nan=True)
    assert np.array_equal(
        of_tiles, measure_shapes(image, given.level_plane, given.noise_plane, x, y, 1.2), equal_nan=True
    )


@pytest.mark.parametrize("step", [1.0, 4.0, 3.0])
@pytest.mark.parametrize("far", [0, 5000])
def test_tiles_far_apart_and_of_any_step(step, far):
    image = np.rint(rng(4, far).normal(500, 6, (192, 256))) * step
    image[:64, 100:140] += far * step
    image[70:80, :60] = 60000
    image[rng(5).random(image.shape) < 0.01] = np.nan
    counted = tile_statistics(image.astype(np.float32), 3, 4, step)
    exact = image[:64, :64][np.isfinite(image[:64, :64])]
    for tile in ((0, 0), (2, 3)):
        assert counted[0][tile] == pytest.approx(500 * step, abs=step * 6 / 3)
        assert counted[1][tile] == pytest.approx(exact.std(), rel=0.2)


def test_places_on_a_lattice_are_those_of_sorted_values():
    """Steps of any size, values that are on the lattice, off it, or too large for the step: the value or none."""
    random, found = rng(8), 0
    for trial in range(400):
        step = 10.0 ** random.uniform(-6, 6)
        origin = step * random.normal() * 10.0 ** random.uniform(0, 9)
        values = origin + step * random.integers(-40, 40, 100) * (1.0 if trial % 2 else random.choice([1.0, 0.37, 1e6]))
        values = values.astype(np.float32)
        k = int(random.integers(100))
        got = find_kth(values, 100, k, step, float(random.choice(values)))
        assert math.isnan(got) or got == np.sort(values)[k]
        found += not math.isnan(got)
    assert found > 100


def test_counting_gives_the_clipped_moments_of_the_sample():
    image = np.rint(rng(6).normal(300, 5, (128, 20))).astype(np.float32)
    image[rng(7).random(image.shape) < 0.05] += 900
    level, noise = tile_statistics(image, 2, 1, 1.0)  # 64 × 20: every third pixel, each row starting five further
    stride = 64 * 20 // 400
    sample = np.concatenate([image[y, (y * 5) % stride :: stride] for y in range(64, 128)]).astype(float)
    median, spread = np.sort(sample)[len(sample) // 2], np.sort(sample)[int(0.841345 * len(sample))]
    std = spread - median
    for _ in range(3):
        kept = sample[np.abs(sample - median) <= 3 * max(std, 12**-0.5) + 0.5]
        std = kept.std() / 0.98658
    assert level[1, 0] == pytest.approx(kept.mean(), rel=1e-12)
    assert noise[1, 0] == pytest.approx(std, rel=1e-9)


def test_smoothing_is_a_median():
    tiles = rng(8).normal(size=(6, 5))
    assert np.array_equal(smooth_tiles(tiles)[1:-1, 1:-1], ndimage.median_filter(tiles, 3)[1:-1, 1:-1])


@pytest.mark.parametrize(
    ("values", "step"), [([], 0), ([np.nan], 0), ([5, np.inf], 1), ([0.5, 1], 0), ([6, 6], 1), ([-9, 6, 21], 15)]
)
def test_whole_step(values, step):
    assert whole_step(np.array(values, np.float32)) == step


@pytest.mark.parametrize("width", [1, 7, 64, 65, 200])
@pytest.mark.parametrize("density", [0.0, 0.03, 0.5, 1.0])
def test_runs_are_the_marked_pixels(width, density):
    marked = rng(9, width).random((7, width)) < density
    runs = find_runs(marked.astype(np.float32), np.zeros(marked.shape, np.float32), np.ones_like(marked), 0.5)
    padded = np.pad(marked.astype(int), ((0, 0), (1, 1)))
    starts, ends = (np.argwhere(np.diff(padded, axis=1) == step) for step in (1, -1))
    assert runs.tolist() == np.column_stack([starts, ends[:, 1]]).tolist()


def test_quantiles_equal_numpy():
    values = rng(10).normal(size=1000).astype(np.float32)
    assert quantiles(values, (0.25, 0.5, 0.9331)) == pytest.approx(np.quantile(values, (0.25, 0.5, 0.9331)), rel=1e-6)
    assert quantiles(values[:1], (0.5,)) == [float(values[0])]


@pytest.mark.parametrize(("x", "y"), [(20, 15), (0, 0), (39, 3), (5, 29)])
@pytest.mark.parametrize("sigma", [None, 0.3, 2.0])
def test_stamp_of_the_filtered_image(x, y, sigma):
    image = rng(11).normal(100, 3, (30, 40)).astype(np.float32)
    image[rng(12).random(image.shape) < 0.05] = np.nan
    plane = as_plane(np.full(image.shape, 98.0, np.float32))
    signal = np.nan_to_num(image.astype(float) - 98.0)
    kernel = matched_kernel(0.8 if sigma is None else sigma)
    for axis in (0, 1):
        signal = ndimage.correlate1d(signal, kernel, axis, mode="constant")
    half, radius = filter_half(sigma), 9
    pitch = stamp_pitch(half, radius)
    out = np.empty(19 * pitch, np.float32)
    filter_stamp(image, plane, half, x, y, radius, np.empty(2 * pitch**2, np.float32), out)
    expected = np.pad(np.where(np.isnan(image), np.nan, signal), radius, constant_values=np.nan)
    np.testing.assert_allclose(out.reshape(19, pitch)[:, :19], expected[y : y + 19, x : x + 19], atol=3e-5)


@pytest.mark.parametrize("missing", [0.02, 0.0])
def test_clutter_against_its_definition(missing):
    image = rng(13).normal(0, 1, (120, 130)).astype(np.float32)
    image[40:90, 40:90] += 6 * (rng(14).random((50, 50)) < 0.05)
    image[rng(15).random(image.shape) < missing] = np.nan
    places = rng(16).integers(0, 120, (80, 2))
    x, y = places.T.copy()
    image[y, x] = 12.0
    radius = rng(17).uniform(0.3, 14.0, 80)
    level = as_plane(np.zeros_like(image))
    expected = np.zeros(80, bool)
    rows, columns = np.indices(image.shape)
    for n in range(80):
        j, i = rows - y[n], columns - x[n]
        inner = min(np.ceil(radius[n]), 12) + 2
        ring = (i**2 + j**2 > inner**2) & (i**2 + j**2 <= (inner + 8) ** 2) & np.isfinite(image)
        sector = (i > 0) * 4 + (j > 0) * 2 + (abs(i) > abs(j))
        tops = [max(image[ring & (sector == s)].max(initial=0.0), 0.0) for s in range(8)]
        median = np.sort(image[ring])[ring.sum() // 2]
        fourth = np.sort(tops)[4] - median
        expected[n] = fourth > 4.0 and 12.0 - median < 2.0 * fourth
    searched, stamp = Searched(image, level, level, UNFILTERED), new_stamp(len(UNFILTERED))
    found = [is_clutter(searched, x[n], y[n], radius[n], 4.0, 2.0, stamp) for n in range(80)]
    assert np.array_equal(found, expected)
    assert 5 < expected.sum() < 75


def a_table(count=60):
    table = np.zeros(count, SOURCE)
    random = rng(19)
    table["flux"] = np.sort(random.lognormal(8, 2, count))[::-1]
    table["peak_residual"] = table["flux"] * random.uniform(0.1, 0.5, count)
    table["pixels"] = random.integers(1, 40, count)
    table["x_peak"], table["y_peak"] = random.integers(0, 100, (2, count))
    return table


def test_halo_against_its_definition():
    table = a_table()
    peak, flux = table["peak_residual"], table["flux"]
    expected = np.zeros(len(table), bool)
    for star in range(len(table)):
        times = peak[star] / peak
        dark = 1.9 * np.sqrt(flux[star] / (np.pi * peak[star]))
        reach = np.maximum(2.5 * np.sqrt(table["pixels"][star] / np.pi) + 3.0, dark * np.cbrt(3.0 * 0.045 * times))
        distance = np.hypot(table["x_peak"] - table["x_peak"][star], table["y_peak"] - table["y_peak"][star])
        expected |= (distance < reach) & (times > 20.0)
    assert np.array_equal(is_halo(table), expected)
    assert 0 < expected.sum() < len(table)


def test_forms_are_the_moments_of_the_pixels():
    random, table = rng(20), np.zeros(12, SOURCE)
    expected = []
    for row in table:
        x, y, s = random.uniform(0, 9, 30), random.uniform(0, 4, 30), random.uniform(1, 2, 30)
        row["pixels"], row["flux"] = 30, s.sum()
        row["sum_x"], row["sum_y"], row["sum_xx"], row["sum_yy"], row["sum_xy"] = (
            s @ product for product in (x, y, x * x, y * y, x * y)
        )
        expected.append(np.cov(np.stack([x, y]), aweights=s, bias=True) + np.eye(2) / 12)
    forms = measure_forms(table, 5.0)
    values = np.linalg.eigvalsh(expected)
    np.testing.assert_allclose(forms.moments, [[c[0, 0], c[1, 1], c[0, 1]] for c in expected], rtol=1e-9, atol=1e-9)
    assert np.array_equal(forms.long, values[:, 1] > 5.0 * values[:, 0])
    assert 0 < forms.long.sum() < len(table)


@pytest.mark.parametrize("sigma", [0.3, 0.9])
def test_peak_share_is_that_of_a_filtered_star(sigma):
    edges = (np.arange(-15, 17) - 0.5) / np.sqrt(2) / sigma
    from scipy.special import erf

    along = 0.5 * np.diff(erf(edges))
    signal = ndimage.correlate1d(along, matched_kernel(0.8), mode="constant")
    assert peak_share(sigma, filter_half(None)) == pytest.approx((along[15] / signal[15]) ** 2, rel=1e-6)


def whole_frame():
    image = rng(21).poisson(300, (150, 210)).astype(np.uint16)
    for n in range(40):
        y, x = rng(22, n).integers(3, 140, 2)
        image[y : y + 3, x : x + 3] += rng(23, n).integers(0, 900, (3, 3)).astype(np.uint16)
    return image


def test_images_of_integers_stay_integers():
    image = whole_frame()
    assert as_pixels(image) is image
    assert as_pixels(image.astype(np.int32)).dtype == as_image(image).dtype == np.float32
    assert as_pixels(image[:, ::2]).flags.c_contiguous
    assert is_value(3.0)
    assert not is_value(np.nan)


def test_integers_give_what_floats_give():
    image = whole_frame()
    whole, floats = estimate(image, 32), estimate(image.astype(np.float32), 32)
    for one, other in ((whole.level, floats.level), (whole.noise, floats.noise)):
        assert np.array_equal(one, other)
    planes = whole.level_plane, whole.noise_plane
    found = [scan_rows(pixels, *planes, filter_half(None), np.float32(5), 7) for pixels in (image, as_image(image))]
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one, other)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0, -0.4, 1.7])
def test_scan_finds_what_is_above_a_noise_that_varies(share):
    image = rng(24).normal(0, 1, (12, 90)).astype(np.float32)
    image[rng(25).random(image.shape) < 0.02] = np.nan
    lines = rng(26).uniform(0.2, 2.0, (3, 90)).astype(np.float32)
    shares = np.array([share, 0.5] * 6, np.float32)
    noise = Plane(lines, np.repeat([0, 1], 6), shares)
    level = as_plane(np.zeros_like(image))
    runs, signal, sample = scan_rows(image, level, noise, UNFILTERED, np.float32(1.2), 1)
    y, x = np.indices(image.shape)
    limit = np.float32(1.2) * noise[y, x]
    above = image > limit
    marked = np.zeros(image.shape, bool)
    for row, first, last in runs:
        assert not marked[row, first : last + 1].any()
        marked[row, first:last] = True
    assert np.array_equal(marked, above)
    assert np.array_equal(signal, image[above])
    np.testing.assert_allclose(sample, (image / noise[y, x])[np.isfinite(image)], rtol=1e-6)


@pytest.mark.parametrize("width", [5, 64, 203])
def test_runs_above_a_higher_threshold_are_those_of_a_search_for_it(width):
    image = rng(28, width).normal(0, 1, (30, width)).astype(np.float32)
    image[rng(29).random(image.shape) < 0.02] = np.nan
    planes = as_plane(np.zeros_like(image)), as_plane(np.full_like(image, 0.5))
    groups, found, _ = search_rows(image, *planes, filter_half(None), np.float32(1.0), 7)
    higher = scan_rows(image, *planes, filter_half(None), np.float32(2.5), 7)
    for one, other in zip(runs_above(groups, found, image, planes[1], np.float32(2.5)), higher[:2], strict=True):
        assert np.array_equal(one, other)
    signal = np.nan_to_num(image.astype(float))
    for axis in (0, 1):
        signal = ndimage.correlate1d(signal, matched_kernel(0.8), axis, mode="constant")
    above = (signal > 1.25) & np.isfinite(image)
    marked = np.zeros(image.shape, bool)
    for row, first, last in higher[0]:
        marked[row, first:last] = True
    assert np.array_equal(marked, above)
    np.testing.assert_allclose(higher[1], signal[above], atol=1e-5)  # 50 products of float32 numbers below 8


@pytest.mark.parametrize("step", [1e-9, 3000.0])
def test_brightest_first_is_a_sort_by_flux_then_position(step):
    table = a_table()
    table["flux"] = np.round(table["flux"] / step) * step
    table["y_peak"] %= 3
    order = np.lexsort((table["x_peak"], table["y_peak"], -table["flux"]))
    ranked = brightest_first(table[::-1].copy())
    for column in ("flux", "y_peak", "x_peak"):
        assert np.array_equal(ranked[column], table[column][order])
    assert (len(np.unique(table["flux"])) < len(order)) == (step > 1.0)


@pytest.mark.parametrize("needed", [1, 3, 9])
def test_long_objects_among_the_brightest(needed):
    random, table = rng(27), a_table()
    width = random.choice([0.5, 3.0], (2, len(table)))
    for n, (column, square) in enumerate((("sum_x", "sum_xx"), ("sum_y", "sum_yy"))):
        table[square] = table["flux"] * width[n] ** 2
        table[column] = 0.0
    long = measure_forms(table, 5.0).long
    brightest = [n for n in np.argsort(-table["flux"]) if table["pixels"][n] >= 10][:20]
    assert are_long(table, needed, 10, 20, 5.0) == (long[brightest].sum() >= needed)
    assert 3 <= long[brightest].sum() < long.sum()


@pytest.mark.parametrize("least", [0, 200, 65_535, 65_536])
def test_range_of_integers_is_that_of_numpy(least):
    image = rng(40).integers(3, 65_536, (37, 53)).astype(np.uint16)
    image[5, 7] = 65_535
    expected = image.min(), image.max(), np.count_nonzero(image.astype(np.int64) >= least)
    assert whole_range(image, least) == expected


def test_joined_tables_have_all_columns_of_both():
    first, second = (np.zeros(count, SOURCE) for count in (3, 2))
    for column in SOURCE.names:
        first[column], second[column] = rng(41).integers(0, 2, 3), rng(42).integers(0, 2, 2)
    assert np.array_equal(join_tables(first, second), np.concatenate([first, second]))
