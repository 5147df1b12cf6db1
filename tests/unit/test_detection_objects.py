"""Detectors on drawn objects: labelling against SciPy, criteria, blends, saturation, borders."""

import numpy as np
import pytest
from all_detectors import GENERAL
from scipy import ndimage
from scipy.special import erf

from simulator.theses.detectors.region_growing import grow_objects, grow_regions
from startracker.detection import Background, find_components
from startracker.detection.background import estimate
from startracker.detection.sources import cut_runs, find_runs, join_runs, measure_objects
from startracker.errors import InputError
from startracker.settings import DetectionSettings

EVERYTHING = DetectionSettings(min_pixels=1, max_pixels=10**9, max_axis_ratio=np.inf, max_stars=10**6, search_step_px=1)


def draw(shape, stars, sigma=1.0):
    """Pixel-integrated Gaussians, (x, y, flux)."""
    image = np.zeros(shape)
    for x, y, flux in stars:
        along_x = 0.5 * np.diff(erf((np.arange(shape[1] + 1) - 0.5 - x) / sigma / np.sqrt(2)))
        along_y = 0.5 * np.diff(erf((np.arange(shape[0] + 1) - 0.5 - y) / sigma / np.sqrt(2)))
        image += flux * along_y[:, None] * along_x
    return image.astype(np.float32)


def flat(shape, level=0.0, noise=1.0):
    return Background(np.full(shape, level, np.float32), np.full(shape, noise, np.float32))


@pytest.mark.parametrize("density", [0.02, 0.2, 0.41, 0.6, 0.95])
@pytest.mark.parametrize("width", [5, 8, 33, 64])
def test_labelling_equals_scipy(density, width):
    rng = np.random.default_rng([int(density * 100), width])
    image = rng.random((40, width)).astype(np.float32)
    mask = image > 1 - density
    background = flat(image.shape, 1 - density - 0.5, 0.25)  # dyadic: exact in float32
    runs = find_runs(image, background.level, background.noise, np.float32(2.0))
    mask = image > background.level + np.float32(2.0) * background.noise
    drawn = np.zeros_like(mask)
    number, count = join_runs(runs)
    label = np.zeros(mask.shape, int)
    for (y, x0, x1), n in zip(runs, number, strict=True):
        drawn[y, x0:x1] = True
        label[y, x0:x1] = n + 1
    assert np.array_equal(drawn, mask)
    twin, expected = ndimage.label(mask, np.ones((3, 3)))
    assert count == expected
    assert len(np.unique(label[mask] * 100000 + twin[mask])) == count  # one to one
    table = measure_objects(runs, number, count, image, background.level, np.inf)
    signal = image.astype(float) - background.level
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]]
    for n in range(count):
        inside = label == n + 1
        assert table["pixels"][n] == inside.sum()
        assert table["flux"][n] == pytest.approx(signal[inside].sum(), rel=1e-12)
        assert table["sum_x"][n] == pytest.approx((signal * x)[inside].sum(), rel=1e-12)
        assert table["sum_xy"][n] == pytest.approx((signal * x * y)[inside].sum(), rel=1e-12)
        assert image[int(table["y_peak"][n]), int(table["x_peak"][n])] == image[inside].max()
        border = np.zeros_like(inside)
        border[[0, -1]] = border[:, [0, -1]] = True
        assert table["edge"][n] == (inside & border).any()


def test_cutting_runs_is_thresholding_them_again():
    rng = np.random.default_rng(3)
    image = rng.random((30, 50)).astype(np.float32)
    background = flat(image.shape)
    runs = find_runs(image, background.level, background.noise, np.float32(0.3))
    signal = np.concatenate([image[y, x0:x1] - background.level[y, x0:x1] for y, x0, x1 in runs])
    keep = runs[:, 0] >= 10
    cut, left = cut_runs(runs, signal, keep, background.noise_plane, np.float32(0.7))
    image[:10] = 0
    assert np.array_equal(cut, find_runs(image, background.level, background.noise, np.float32(0.7)))
    assert np.array_equal(left, np.concatenate([image[y, x0:x1] - background.level[y, x0:x1] for y, x0, x1 in cut]))


def test_growing_from_every_pixel_equals_scipy():
    rng = np.random.default_rng(11)
    image = rng.random((40, 57)).astype(np.float32)
    background = flat(image.shape)
    table, visited = grow_objects(image, background.level, np.full_like(image, 0.55), 1, np.inf)
    twin, expected = ndimage.label(image > np.float32(0.55))  # 4-connected
    assert visited == image.size
    assert sorted(table["pixels"]) == sorted(np.bincount(twin.ravel())[1:])
    assert len(table) == expected


def test_search_pattern_of_the_thesis():
    # Fig. 4.6: "a total of ((Npx − 2)/3)((Npy − 2)/3) = 28900, about 11 % of the total"; every other row of the
    # staggered pattern has one pixel fewer: 170 rows of 170 and 169 in turn
    image = np.zeros((512, 512), np.float32)
    background = flat(image.shape)
    visited = grow_objects(image, background.level, np.full_like(image, 5.0), 3, np.inf)[1]
    assert visited == 85 * 170 + 85 * 169
    assert visited == pytest.approx(28900, rel=0.004)
    assert visited / image.size == pytest.approx(0.11, abs=0.001)


def test_every_object_of_three_by_three_is_met():
    # why every third pixel is enough: the star is defocused over 3×3
    for x in range(2, 20):
        for y in range(2, 20):
            image = np.zeros((24, 24), np.float32)
            image[y : y + 3, x : x + 3] = 100
            assert len(grow_regions(image, flat(image.shape), DetectionSettings(), None)) == 1, (x, y)


def test_growing_is_not_recursive():
    image = np.ones((700, 700), np.float32)
    sky = flat(image.shape, -9.0)
    table, _ = grow_objects(image, sky.level, sky.level + 5.0, 3, np.inf)
    assert table["pixels"].tolist() == [700 * 700]


@pytest.mark.parametrize("method", GENERAL)
def test_finds_the_stars_brightest_first(method):
    rng = np.random.default_rng(5)
    grid = [(x, y) for x in range(12, 250, 24) for y in range(12, 250, 24)]
    stars = [
        (x + dx, y + dy, f)
        for (x, y), dx, dy, f in zip(grid, *rng.uniform(-3, 3, (2, 100)), np.geomspace(900, 4e4, 100), strict=True)
    ]
    image = np.rint(draw((256, 256), stars, 1.2) + rng.normal(100, 4, (256, 256))).astype(np.float32)
    spots = GENERAL[method](image, estimate(image, 32), DetectionSettings(max_stars=200, background_tile_px=32), None)
    assert len(spots) == 100
    assert np.all(np.diff(spots.flux) <= 0)
    truth = np.array(stars)[::-1]
    found = np.hypot(spots.x_peak[:, None] - truth[:, 0], spots.y_peak[:, None] - truth[:, 1]).argmin(axis=1)
    assert sorted(found) == list(range(100))
    distance = np.hypot(spots.x_peak - truth[found, 0], spots.y_peak - truth[found, 1])
    assert distance.max() < 1.5
    assert np.median(np.abs(spots.flux / truth[found, 2] - 1)) < 0.15
    few = GENERAL[method](image, estimate(image, 32), DetectionSettings(max_stars=7), None)
    assert few.flux.tolist() == spots.flux[:7].tolist()
    assert not spots.saturated.any()


@pytest.mark.parametrize("method", ["components", "region_growing"])  # clustering cuts the extended object up
def test_size_limits(method):
    image = np.zeros((60, 60), np.float32)
    image[10, 10] = 500  # hot pixel
    image[10, 30:32] = 500
    image[29:32, 10:13] = 400
    image[25:45, 25:45] = 300  # an extended object
    settings = DetectionSettings(min_pixels=3, max_pixels=36, matched_filter=False)
    spots = GENERAL[method](image, flat(image.shape), settings, None)
    assert (spots.x_peak.tolist(), spots.y_peak.tolist()) == ([10], [29])
    assert spots.pixels.tolist() == [9]


@pytest.mark.parametrize("method", GENERAL)
@pytest.mark.parametrize("slant", [0, 1])
def test_streaks_are_told_apart_only_beyond_the_limit(method, slant):
    image = np.zeros((60, 60), np.float32)
    for k in range(12):
        x, y = 20 + k, 31 + slant * k  # on the search pattern
        image[y : y + 2, x : x + 2] = 300
    generous = DetectionSettings(max_axis_ratio=100.0)
    assert len(GENERAL[method](image, flat(image.shape), generous, None)) == 1
    assert len(GENERAL[method](image, flat(image.shape), DetectionSettings(max_axis_ratio=6.0), None)) == 0


def test_axis_ratio_is_that_of_the_second_moments():
    # 7 × 3 block: variances (7² − 1)/12 = 4 and (3² − 1)/12, each plus a pixel's 1/12: ratio 49/9 = 5.44
    image = np.zeros((30, 30), np.float32)
    image[10:13, 10:17] = 100
    for limit, expected in ((5.43, 0), (5.46, 1)):
        assert len(find_components(image, flat(image.shape), DetectionSettings(max_axis_ratio=limit), None)) == expected


@pytest.mark.parametrize("method", GENERAL)
def test_saturated_stars_are_kept_and_flagged(method):
    stars = [(30, 30, 4e6), (80.3, 30.2, 3e3), (30.4, 80.3, 2e5)]
    image = np.minimum(np.rint(draw((110, 110), stars, 1.3) + 20), 4095).astype(np.float32)
    background = estimate(image, 64)
    for saturation in (4095.0, None):
        spots = GENERAL[method](image, background, DetectionSettings(), saturation)
        assert spots.saturated.tolist() == [True, True, False]
    assert GENERAL[method](image, background, DetectionSettings(), 4096.0).saturated.tolist() == [False] * 3


def test_a_star_on_a_pixel_corner_is_not_taken_for_saturated():
    image = draw((40, 40), [(20.5, 20.5, 1e4)])
    assert find_components(image, estimate(image), DetectionSettings(), None).saturated.tolist() == [False]


@pytest.mark.parametrize("method", GENERAL)
def test_border_is_flagged(method):
    image = draw((64, 64), [(1.0, 30.0, 5e3), (30.0, 62.0, 6e3), (32.0, 31.0, 7e3)])
    image[image < 1] = 0
    spots = GENERAL[method](image, flat(image.shape), DetectionSettings(), None)
    assert spots.edge.tolist() == [False, True, True]


@pytest.mark.parametrize("separation", [4.0, 5.0, 7.0])
def test_touching_stars_are_parted(separation):
    for angle in np.linspace(0, np.pi, 7):
        dx, dy = 0.5 * separation * np.cos(angle), 0.5 * separation * np.sin(angle)
        image = draw((40, 40), [(20 - dx, 20 - dy, 2e4), (20 + dx, 20 + dy, 1e4)], 1.0)
        image += np.random.default_rng(1).normal(0, 3, image.shape).astype(np.float32)
        background = flat(image.shape, 0, 3)
        spots = find_components(image, background, DetectionSettings(), None)
        assert len(spots) == 2, angle
        assert np.hypot(spots.x_peak - [20 - dx, 20 + dx], spots.y_peak - [20 - dy, 20 + dy]).max() < 1.0
        assert spots.flux[0] / spots.flux[1] == pytest.approx(2.0, rel=0.15)


def test_stars_closer_than_two_pixels_stay_one():
    image = draw((40, 40), [(19.3, 20, 2e4), (20.7, 20, 2e4)])
    assert len(find_components(image, flat(image.shape, 0, 3), DetectionSettings(), None)) == 1


@pytest.mark.parametrize("over", [1.2, 3, 10, 100, 1000])
@pytest.mark.parametrize("sigma", [0.7, 1.1, 1.8])
def test_a_flat_top_is_one_star(sigma, over):
    rng = np.random.default_rng(2)
    for x, y in 20 + rng.uniform(-0.5, 0.5, (10, 2)):
        image = draw((41, 41), [(x, y, 4000 * over * 2 * np.pi * sigma**2)], sigma)
        image = np.minimum(np.rint(image + 50 + rng.normal(0, 4, image.shape)), 4095).astype(np.float32)
        assert len(find_components(image, flat(image.shape, 50, 4), DetectionSettings(), 4095.0)) == 1


def test_very_bright_star_with_wide_wings_is_one_star():
    y, x = np.mgrid[:400, :400]
    r = np.hypot(x - 200.3, y - 199.8)
    image = np.minimum(3e6 / (1 + (r / 1.2) ** 2) ** 1.5, 65535) + 100
    image = (image + np.random.default_rng(3).normal(0, 5, image.shape)).astype(np.float32)
    spots = find_components(image, estimate(image, 32), DetectionSettings(), 65535.0)
    assert len(spots) == 1
    assert spots.saturated.all()
    assert np.hypot(spots.x_peak[0] - 200, spots.y_peak[0] - 200) < 8


def test_rings_are_no_stars():
    from scipy.special import j1

    y, x = np.mgrid[: 101 * 5, : 101 * 5] / 5 - 50.4 + 0.17
    v = np.maximum(np.hypot(x, y) * 3.8317 / 3.0, 1e-9)
    airy = ((2 * j1(v) / v) ** 2).reshape(101, 5, 101, 5).sum(axis=(1, 3))
    image = (airy * 1e5 / airy.sum()).astype(np.float32)
    for background in (flat(image.shape, 0, 0.1), flat(image.shape, 0, 3.0), estimate(image)):
        assert len(find_components(image, background, DetectionSettings(), None)) == 1


def test_stars_before_a_nebula_and_beside_the_moon():
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:300, :300]
    nebula = 400 * np.exp(-((x - 90) ** 2 + (y - 90) ** 2) / 2 / 15**2)
    moon = 5000.0 * (np.hypot(x - 220, y - 220) < 25)
    image = draw((300, 300), [(80, 90, 2e4), (97.3, 84.2, 3e4), (200, 60, 8e3), (60, 200, 8e3)]) + nebula + moon + 100
    image = rng.poisson(image).astype(np.float32)
    spots = find_components(image, estimate(image, 32), DetectionSettings(), 65535.0)
    found = sorted(zip(spots.x_peak.tolist(), spots.y_peak.tolist(), strict=True))
    assert found == [(60, 200), (80, 90), (97, 84), (200, 60)]


def test_noise_free_frame_gives_its_stars_and_no_others():
    rng = np.random.default_rng(6)
    stars = [(x, y, f) for x, y, f in zip(*rng.uniform(20, 490, (2, 40)), 10 ** rng.uniform(0, 2.4, 40), strict=True)]
    image = draw((512, 512), stars, 1.1)
    for picture in (image, image * 1e-6, image + np.float32(7.5)):
        spots = find_components(picture, estimate(picture), DetectionSettings(), None)
        assert 36 <= len(spots) <= 40  # some of them may touch
        assert (
            np.hypot(spots.x_peak[:, None] - np.array(stars)[:, 0], spots.y_peak[:, None] - np.array(stars)[:, 1])
            .min(axis=1)
            .max()
            < 1.5
        )


def test_false_alarms_in_pure_noise():
    image = np.rint(np.random.default_rng(8).normal(200, 12, (1024, 1024))).astype(np.float32)
    for method in GENERAL.values():
        assert len(method(image, estimate(image), DetectionSettings(), None)) == 0


@pytest.mark.parametrize("method", GENERAL)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_pixels_that_are_not_finite_belong_to_no_object(method, bad):
    image = draw((60, 60), [(40, 40, 1e4)])
    image[9:12, 9:12] = bad
    image[40, 46] = bad
    spots = GENERAL[method](image, flat(image.shape), DetectionSettings(min_pixels=1), None)
    assert (spots.x_peak.tolist(), spots.y_peak.tolist()) == ([40], [40])
    assert np.isfinite(spots.flux).all()


@pytest.mark.parametrize("method", GENERAL)
def test_background_must_fit(method):
    with pytest.raises(InputError, match="its background"):
        GENERAL[method](np.zeros((5, 5), np.float32), flat((6, 6)), DetectionSettings(), None)


def test_search_step_must_be_positive():
    with pytest.raises(InputError, match="search_step_px is 0"):
        grow_regions(np.zeros((9, 9), np.float32), flat((9, 9)), DetectionSettings(search_step_px=0), None)


def rings(shape, places, radius=4.5, width=0.8):
    """Star images far out of focus: rings with a dark middle."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    image = np.zeros(shape)
    for cx, cy, height in places:
        image += height * np.exp(-0.5 * ((np.hypot(x - cx, y - cy) - radius) / width) ** 2)
    return image.astype(np.float32)


def test_ring_images_are_stars_not_blends():
    """Every star is a ring with several peaks, deep valleys between: each is one object. Before, all were parted."""
    rng = np.random.default_rng(4)
    offsets = rng.uniform(-0.5, 0.5, 20)
    places = [(30.0 + 40 * (n % 5) + offsets[n], 30.0 + 40 * (n // 5), 400.0 - 5 * n) for n in range(20)]
    image = rings((180, 220), places) + rng.normal(size=(180, 220)).astype(np.float32) * 6.0
    found = find_components(image, flat(image.shape, noise=6.0), DetectionSettings(max_pixels=400))
    at = np.stack([found.x_peak, found.y_peak], axis=1)
    nearest = np.hypot(*(at[:, None] - np.array(places)[None, :, :2]).transpose(2, 0, 1)).argmin(axis=1)
    assert len(set(nearest)) == len(nearest) >= len(places) - 1


def test_doubles_among_round_images_are_parted_all_the_same():
    places = [(30.0 + 40 * i, 30.0 + 40 * j) for i in range(5) for j in range(4)]
    stars = [(x, y, 5e3 - 10 * n) for n, (x, y) in enumerate(places)]
    stars += [(x + (5.0, 0.0, -4.0)[n], y + (0.0, 5.0, 4.0)[n], 4e3) for n, (x, y) in enumerate(places[:3])]
    image = draw((180, 220), stars, 1.2)
    found = find_components(image, flat(image.shape), DetectionSettings())
    assert len(found) == len(stars)
