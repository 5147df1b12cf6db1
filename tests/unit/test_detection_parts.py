"""Decisions of the detection, one by one: tables of objects, blends, values that are not light, sharpness."""

import math

import numpy as np
import pytest

from startracker.detection import Background, Spots
from startracker.detection.artefacts import (
    Sharpness,
    _last_light,
    _width_beside_pixels,
    common_width,
    has_crowd,
    is_sharp,
    mask_extremes,
    sharpest_star,
)
from startracker.detection.blends import _chain_peaks, _of_common_image, _Peaks, _valley, part_blends
from startracker.detection.components import measure_found
from startracker.detection.matched import filter_half, filtered_pixel
from startracker.detection.scan import UNFILTERED, runs_above, search_rows
from startracker.detection.shapes import MINOR, MINOR_ERROR, PEAK_SHARE, SHAPE_COLUMNS, SHAPE_SNR, shapes_at
from startracker.detection.sources import (
    SOURCE,
    Searched,
    add_pixel,
    find_runs,
    is_saturated,
    join_runs,
    measure_objects,
)
from startracker.detection.tiles import Plane, as_plane
from tests.helpers.source_tables import objects, plane


# ---------------------------------------------------------------------- runs
@pytest.mark.parametrize("width", [7, 40, 67])
def test_a_run_goes_on_from_one_group_of_pixels_to_the_next(width):
    """The search works in groups of eight pixels; runs end at pixels below the threshold and at the border only."""
    image = np.where(np.random.default_rng(width).random((24, width)) < 0.9, 9.0, 0.0).astype(np.float32)
    image[3] = image[4] = 9.0  # from border to border
    image[5, : width // 2] = image[6, width // 2 :] = 0.0
    level, noise = np.zeros_like(image), np.ones_like(image)
    groups, found, _ = search_rows(image, as_plane(level), as_plane(noise), UNFILTERED, np.float32(5.0), 7)
    runs, signal = runs_above(groups, found, image, as_plane(noise), np.float32(5.0))
    expected = find_runs(image, level, noise, np.float32(5.0))
    assert runs.tolist() == expected.tolist()
    assert [3, 0, width] in runs.tolist()
    assert [4, 0, width] in runs.tolist()
    assert len(signal) == (image > 5.0).sum()
    assert (signal == 9.0).all()


@pytest.mark.parametrize("heights", [(24, 24), (40, 8), (23, 40)])
def test_groups_are_those_with_a_pixel_above_the_lower_of_two_lines_of_noise(heights):
    """Lines of the noise map at two rows; the limit of the rows between is that of the lower line at each column."""
    rng = np.random.default_rng(5)
    height, step = heights
    lines = rng.uniform(0.5, 3.0, (height // step + 2, 48)).astype(np.float32)
    cell, share = np.divmod(np.arange(height), step)
    noise = Plane(lines, cell, (share / step).astype(np.float32))
    image = rng.exponential(1.0, (height, 48)).astype(np.float32)
    groups, found, _ = search_rows(image, plane(image.shape, 0.0), noise, UNFILTERED, np.float32(2.0), 7)
    limit = 2.0 * np.minimum(lines[cell], lines[cell + 1])
    marked = (image > limit).reshape(height, -1, 8).any(axis=2)
    assert 0.05 < marked.mean() < 0.95
    rows, places = np.nonzero(marked)
    assert groups.tolist() == np.column_stack([rows, 8 * places]).tolist()
    assert np.array_equal(found, image.reshape(height, -1, 8)[rows, places])


# ---------------------------------------------------------------------- tables
def test_sums_over_the_pixels_of_an_object():
    """Of equal peaks the first in reading order; signal above the level, value at saturation."""
    rng = np.random.default_rng(1)
    for _ in range(5):
        y, x = (axis.ravel() for axis in np.mgrid[3:8, 4:10])
        order = rng.permutation(len(x))
        x, y, value = x[order], y[order], rng.integers(10, 16, len(x)).astype(float)
        level = rng.uniform(1.0, 2.0, len(x))
        row = np.zeros(1, SOURCE)
        for k in range(len(x)):
            add_pixel(row[0], x[k], y[k], value[k], level[k], 14.0)
        signal, top = value - level, np.flatnonzero(value == value.max())
        first = top[np.lexsort((x[top], y[top]))[0]]
        assert (row["pixels"], row["at_peak"], row["saturated"]) == (len(x), len(top), np.sum(value >= 14.0))
        assert (row["x_peak"], row["y_peak"], row["peak"]) == (x[first], y[first], value.max())
        assert row["peak_residual"] == pytest.approx(signal[first])
        for name, weight in (
            ("flux", 1.0),
            ("sum_x", x),
            ("sum_y", y),
            ("sum_xx", x * x),
            ("sum_yy", y * y),
            ("sum_xy", x * y),
        ):
            assert row[name] == pytest.approx(np.sum(signal * weight))
    negative = np.zeros(1, SOURCE)
    add_pixel(negative[0], 3, 4, -5.0, 1.0, np.inf)
    assert (negative["peak"], negative["x_peak"], negative["at_peak"]) == (-5.0, 3, 1)


def test_flat_tops_are_saturated_where_the_level_is_unknown():
    """All at the highest value, if one of them has five pixels of it."""
    table = objects(4, peak=[9.0, 9.0, 8.0, 9.0], at_peak=[4, 1, 9, 5], saturated=[0, 0, 1, 0])
    assert is_saturated(table, True).tolist() == [False, False, True, False]
    assert is_saturated(table, False).tolist() == [True, True, False, True]
    table["at_peak"][3] = 4
    assert not is_saturated(table, False).any()
    assert is_saturated(table[:0], False).shape == (0,)


# ---------------------------------------------------------------------- blends
def test_the_valley_between_two_peaks():
    """The least of the pixels on the line; between equal ones of the highest of 3 × 3 about each."""
    image = np.random.default_rng(2).uniform(10.0, 20.0, (12, 14)).astype(np.float32)
    level = plane(image.shape, 3.0)
    for ends in ((1, 2, 9, 8), (9, 8, 1, 2), (3, 3, 3, 9), (0, 0, 13, 11), (5, 4, 12, 4)):
        x0, y0, x1, y1 = ends
        steps = max(abs(x1 - x0), abs(y1 - y0))
        line = [(round(x0 + (x1 - x0) * k / steps), round(y0 + (y1 - y0) * k / steps)) for k in range(steps + 1)]
        assert _valley(image, level, *ends) == pytest.approx(min(image[y, x] for x, y in line) - 3.0)
        same = image.copy()
        same[y0, x0] = same[y1, x1] = 19.5
        highest = [same[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].max() for x, y in line]
        assert _valley(same, level, *ends) == pytest.approx(min(highest) - 3.0)


@pytest.mark.parametrize(
    ("apart", "heights", "valley", "noise", "parted"),
    [
        (4, (100.0, 60.0), 47.9, 1.0, True),
        (4, (100.0, 60.0), 48.1, 1.0, False),  # 0.8 of the fainter
        (4, (100.0, 60.0), 30.0, 7.4, True),
        (4, (100.0, 60.0), 30.0, 7.6, False),  # by four times the noise
        (2, (100.0, 60.0), 10.0, 1.0, True),
        (1, (100.0, 60.0), 60.0, 1.0, False),
        (4, (100.0, 5.1), 0.0, 1.0, True),
        (4, (100.0, 4.9), 0.0, 0.1, False),  # 0.05 of the brighter: a ring
    ],
)
def test_peaks_that_a_valley_separates(apart, heights, valley, noise, parted):
    image = np.zeros((9, 20), np.float32)
    image[4, 5], image[4, 5 + apart] = heights
    image[4, 6 : 5 + apart] = valley
    position = np.array([[5, 4, 0], [5 + apart, 4, 0]])
    head, following = np.full(1, -1), np.full(2, -1)
    peaks = _Peaks(position, np.array(heights))
    count = _chain_peaks(
        peaks, np.array([0, 1]), image, plane(image.shape, 0.0), plane(image.shape, noise), head, following
    )
    assert count == int(parted)
    assert head[0] == (1 if parted else -1)
    if parted:
        assert following.tolist() == [-1, 0]


def test_every_pixel_is_of_the_nearest_star():
    """Three stars in one object, a fourth alone: the sums of each part, and what touches the border."""
    y, x = np.mgrid[:30, :40]
    places = np.array([[0, 8], [7, 8], [7, 15], [30, 20]])
    image = sum(
        f * np.exp(-0.5 * ((x - a) ** 2 + (y - b) ** 2) / 2.0)
        for f, (a, b) in zip((900, 700, 500, 300), places, strict=True)
    ).astype(np.float32)
    level, noise = plane(image.shape, 0.0), plane(image.shape, 0.01)
    runs = find_runs(image, np.zeros_like(image), np.ones_like(image), np.float32(1.0))
    number, count = join_runs(runs)
    table = measure_objects(runs, number, count, image, level, 600.0)
    assert count == 2
    found, parted = part_blends(runs, number, table, 400, image, level, noise, 600.0)
    assert (len(found), parted) == (4, 1)
    found = found[np.argsort(-found["peak"])]
    assert np.column_stack([found["x_peak"], found["y_peak"]]).tolist() == places.tolist()
    assert found["edge"].tolist() == [True, False, False, False]
    above = (image > 1.0) & (x < 22)
    nearest = ((x[..., None] - places[:3, 0]) ** 2 + (y[..., None] - places[:3, 1]) ** 2).argmin(axis=2)
    for k in range(3):
        mine = above & (nearest == k)
        tied = (
            (x - places[0, 0]) ** 2 + (y - places[0, 1]) ** 2 == (x - places[1, 0]) ** 2 + (y - places[1, 1]) ** 2
        ).any()
        assert not tied or k > 1
        assert found["pixels"][k] == mine.sum()
        assert found["flux"][k] == pytest.approx(image[mine].sum(), rel=1e-6)
        assert found["saturated"][k] == (mine & (image >= 600.0)).sum()
    whole, none = part_blends(runs, number, table, table["pixels"].max() - 1, image, level, noise, 600.0)
    assert (len(whole), none) == (2, 0)


@pytest.mark.parametrize(
    ("rings", "others", "sizes", "common"),
    [
        (3, 2, 9.0, True),
        (2, 1, 9.0, False),  # three are needed
        (3, 3, 9.0, False),  # and six of ten
        (6, 4, 9.0, True),
        (6, 5, 9.0, False),
    ],
)
def test_a_frame_of_rings(rings, others, sizes, common):
    """Most of the brightest objects have several peaks, and are of one size; such as are larger are blends anyway."""
    count = rings + others
    table = objects(count, flux=np.arange(count, 0.0, -1.0), pixels=40, peak=1.0)
    table["sum_xx"] = table["flux"] * sizes  # about zero
    parted = np.arange(count) < rings
    assert _of_common_image(table, parted, 100).tolist() == (parted & common).tolist()
    for name, value in (("edge", True), ("saturated", 1), ("pixels", 101), ("pixels", 5)):
        changed = table.copy()
        changed[name][:rings] = value
        assert not _of_common_image(changed, parted, 100).any()
    if common:
        wide = table.copy()
        wide["sum_xx"][0] *= 1.24
        assert _of_common_image(wide, parted, 100)[0]
        wide["sum_xx"][0] *= 1.26 / 1.24
        assert not _of_common_image(wide, parted, 100)[0]
        wide["sum_xx"][:rings] *= np.geomspace(0.1, 10.0, rings)
        assert not _of_common_image(wide, parted, 100).any()
        moved = table.copy()  # the size is that about the centre
        moved["sum_x"], moved["sum_y"] = 5.0 * table["flux"], -3.0 * table["flux"]
        moved["sum_xx"] = table["flux"] * (25.0 + 5.0)
        moved["sum_yy"] = table["flux"] * (9.0 + 4.0)
        assert _of_common_image(moved, parted, 100).tolist() == parted.tolist()


# ---------------------------------------------------------------------- values and hot pixels
def test_the_first_gap_of_seven_powers_of_two_ends_the_light():
    """From 2⁷ of the limit on; pixels between do not count, nor gaps below the limit."""
    for values, expected in (
        ([3.0, 500.0], math.inf),  # from 4 to 256: six powers between
        ([3.0, 520.0], 4.0),
        ([3.0, 300.0, 1e6, 1e9], 512.0),
        ([0.001, 3.0], math.inf),
        ([1e30, 3.0], 4.0),
        ([np.nan, np.inf, 3.0], math.inf),
    ):
        image = np.array([values, values], np.float32)
        assert _last_light(image, 0.0, 2.5) == expected, values
    assert _last_light(np.array([[1e30]], np.float32), 0.0, 2.5) == math.inf  # nothing to compare it with
    assert _last_light(np.array([[3.0, 1e30]], np.float32), 0.0, 0.0) == 4.0


def test_extremes_are_sought_beyond_a_hundred_thousand_times_the_noise():
    rng = np.random.default_rng(3)
    image = rng.normal(1000.0, 1.0, (60, 60)).astype(np.float32)
    # the noise of 1 times 1e5 is below 2¹⁷, and seven empty powers of two above that are needed
    for value in (1.6e7, -1.6e7):
        near = image.copy()
        near[5, 5] = value
        assert mask_extremes(near, near.min(), near.max())[1] == 0
    for value in (1.7e7, -1.7e7, 1e30, -1e30):
        far = image.copy()
        far[5, 5] = value
        found, count = mask_extremes(far, far.min(), far.max())
        assert count == 1
        assert np.isnan(found[5, 5])
        assert np.isfinite(found).sum() == 3599
    whole = np.zeros((4, 4), np.uint16)
    assert mask_extremes(whole, 0.0, 9e9)[0] is whole
    nothing = np.full((4, 4), np.nan, np.float32)
    assert mask_extremes(nothing, 0.0, 9e9) == (nothing, 0)


def spots(count, **rejected):
    zero, flags = np.zeros(count, np.int64), np.zeros(count, bool)
    names = {name.replace("_", " "): value for name, value in rejected.items()}
    return Spots(zero, zero, np.ones(count), zero, flags, flags, rejected=names)


def test_a_crowd_of_objects_or_of_hot_pixels():
    assert has_crowd(spots(3, streak=18), 10_000)
    assert not has_crowd(spots(3, streak=17), 10_000)
    assert has_crowd(spots(2, hot_pixel=9), 10**6)
    assert not has_crowd(spots(2, hot_pixel=8), 10**6)
    assert has_crowd(spots(0, hot_pixel=5), 10**6)
    assert not has_crowd(spots(0, hot_pixel=4), 10**6)


def test_the_width_that_most_share():
    """Within a factor of 1.3 either way; of two groups of one size the wider, and the median of the group."""
    assert common_width(np.array([1.0, 1.1, 1.29, 5.0, 5.1])) == 1.1
    assert common_width(np.array([1.0, 1.1, 5.0, 5.2, np.nan, -1.0, np.inf])) == pytest.approx(5.1)
    assert common_width(np.array([2.0, 2.0 * 1.31])) == 2.62
    assert math.isnan(common_width(np.array([np.nan, 0.0])))


def shapes_of(*groups):
    """Rows of minor variance, share of the brightest pixel, and signal-to-noise ratio, with how often each occurs."""
    rows = []
    for count, minor, share, snr in groups:
        row = np.zeros(SHAPE_COLUMNS)
        row[[MINOR, PEAK_SHARE, SHAPE_SNR]] = minor, share, snr
        rows += [row] * count
    return np.array(rows)


@pytest.mark.parametrize(
    ("groups", "width"),
    [
        (((5, 0.1, 0.8, 20.0), (3, 0.9, 0.3, 20.0)), 0.9),
        (((4, 0.1, 0.8, 20.0), (3, 0.9, 0.3, 20.0)), 7.0),  # five sharp ones are needed
        (((5, 0.1, 0.8, 20.0), (2, 0.9, 0.3, 20.0)), 7.0),  # and three stars
        (((4, 0.1, 0.8, 20.0), (1, 0.1, 0.7, 20.0), (3, 0.9, 0.3, 20.0)), 0.9),  # four of five are single pixels
        (((7, 0.1, 0.8, 20.0), (2, 0.1, 0.7, 20.0), (3, 0.9, 0.3, 20.0)), 7.0),
        (((5, 0.1, 0.8, 7.9), (3, 0.9, 0.3, 20.0)), 7.0),  # with too little light to tell
        (((5, 0.1, 0.8, 20.0), (3, 0.31, 0.3, 20.0)), 0.31),
        (((5, 0.1, 0.8, 20.0), (3, 0.29, 0.3, 20.0)), 7.0),
    ],
)
def test_the_width_of_stars_that_are_few_among_hot_pixels(groups, width):
    assert _width_beside_pixels(shapes_of(*groups), 7.0) == width


def searched_of(image, half=UNFILTERED, noise=2.0):
    image = np.asarray(image, np.float32)
    return Searched(image, plane(image.shape, 0.0), plane(image.shape, noise), half)


def star_image(sigma2, flux=5000.0, count=9, side=30, seed=4):
    rng, size = np.random.default_rng(seed), 3 * side
    y, x = np.mgrid[:size, :size]
    at = np.stack(np.divmod(np.arange(count), 3), axis=1) * side + side / 2 + rng.uniform(-0.5, 0.5, (count, 2))
    image = sum(np.exp(-0.5 * ((x - a) ** 2 + (y - b) ** 2) / sigma2) for a, b in at) * flux / (2.0 * math.pi * sigma2)
    return image, np.rint(at).astype(np.int64)


@pytest.mark.parametrize(("sigma2", "limit"), [(0.8, 0.45 * 0.8), (0.2, 0.0), (2.0, 0.4), (9.0, 0.4)])
def test_the_sharpest_star_of_a_frame(sigma2, limit):
    """0.45 of the common variance, 0.4 px² at most, and none where stars are as sharp as tracks. A wide star widens the
    weight under which it is measured; the share of the brightest pixel is that of such a star after the filter."""
    image, pixels = star_image(sigma2)
    searched = searched_of(image)
    found = sharpest_star(pixels, np.ones(9, bool), searched, 4)
    assert found.limit_px2 == pytest.approx(limit, rel=0.06)
    assert found.peak_share == math.inf
    if sigma2 > 1.2**2:
        assert found.weight_px == pytest.approx(1.2 * math.sqrt(sigma2), rel=0.1)
    else:
        assert found.weight_px == 1.2
    np.testing.assert_array_equal(found.shapes, shapes_at(*searched[:3], pixels, found.weight_px))
    few = sharpest_star(pixels, np.arange(9) >= 7, searched, 4)
    assert np.isfinite(few.shapes[:, MINOR]).tolist() == [True] * 4 + [False] * 3 + [True] * 2
    filtered = sharpest_star(pixels, np.ones(9, bool), searched_of(image, filter_half(0.8)), 4)
    assert (filtered.peak_share < 1.0) is (limit > 0.0)


@pytest.mark.parametrize(
    ("minor", "error", "share", "sharp"),
    [
        (0.2, 0.04, math.inf, True),
        (0.2, 0.06, math.inf, False),  # by twice its error
        (0.9, 0.0, math.inf, False),
        (0.9, 0.0, "above", True),  # or by its brightest pixel, by three times the noise
        (0.9, 0.0, "below", False),
    ],
)
def test_a_source_that_is_sharper_than_a_star(minor, error, share, sharp):
    image = np.zeros((11, 11))
    image[5, 5] = 100.0
    searched = searched_of(image, filter_half(0.8))
    filtered, signal = filtered_pixel(searched.image, searched.level, searched.half, 5, 5)
    if share != math.inf:
        share = (signal - 3.0 * 2.0) / filtered * (0.999 if share == "above" else 1.001)
    shapes = shapes_of((1, minor, 0.5, 20.0))
    shapes[0, MINOR_ERROR] = error
    assert is_sharp(searched, Sharpness(0.3, share, 1.2, shapes), 0, 5, 5) is sharp


# ---------------------------------------------------------------------- oversized objects
def test_an_oversized_object_is_searched_at_doubled_thresholds():
    """A nebula with two stars: parts that exceed the threshold twofold at their peak are kept, its structure is not."""
    y, x = np.mgrid[:120, :120]
    nebula = 40.0 * np.exp(-0.5 * ((x - 60) ** 2 + (y - 60) ** 2) / 400.0)
    image = nebula + sum(
        f * np.exp(-0.5 * ((x - a) ** 2 + (y - b) ** 2))
        for f, a, b in ((900.0, 40, 55), (300.0, 80, 70), (500.0, 10, 110))
    )
    image[60, 60] += 30.0  # structure
    image = image.astype(np.float32)
    flat = Background(np.zeros_like(image), np.full_like(image, 2.0))
    runs = find_runs(image, flat.level, flat.noise, np.float32(5.0))
    signal = np.concatenate([image[r, a:b] for r, a, b in runs])
    table, parted = measure_found(runs, signal, image, flat, 5.0, 60, np.inf)
    bright = table[np.argsort(-table["peak"])]
    assert list(zip(bright["x_peak"], bright["y_peak"], strict=True))[:3] == [(40, 55), (10, 110), (80, 70)]
    assert len(table) == 3
    assert (table["pixels"] <= 60).all()
    assert parted == 0
    whole, parted = measure_found(runs, signal, image, flat, 5.0, 20_000, np.inf)
    assert (len(whole), parted) == (4, 1)  # peaks with valleys between them
    single, _ = measure_found(runs, signal, image, flat, 5.0, 60, np.inf, 1)
    assert list(zip(single["x_peak"], single["y_peak"], strict=True)) == [(10, 110)]
