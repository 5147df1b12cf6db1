"""Background and noise maps: against NumPy twins, on gradients, digitised, clipped and noise-free images."""

import numpy as np
import pytest

from startracker.detection import find_components
from startracker.detection.background import as_image, estimate, noise_floor
from startracker.detection.tiles import fill_plane, interpolate_tiles, smooth_tiles
from startracker.errors import InputError
from startracker.settings import DetectionSettings
from startracker.sorting import ranked


def rng(*key):
    return np.random.default_rng([7, *key])


def test_ranks_are_those_of_a_sort():
    for trial in range(50):
        values = rng(trial).integers(-trial, 1 + trial * 3, 1 + trial * 7).astype(np.float32)
        k = int(rng(trial, 1).integers(len(values)))
        ordered = np.sort(values)
        assert ranked(values, k) == (ordered[k], ordered[min(k + 1, len(values) - 1)])


def test_interpolation_equals_scipy():
    from scipy.interpolate import RegularGridInterpolator

    tiles = rng(1).normal(size=(5, 4))
    height, width = 83, 61
    edges_y, edges_x = (np.arange(6) * height) // 5, (np.arange(5) * width) // 4
    centres = 0.5 * (edges_y[:-1] + edges_y[1:] - 1), 0.5 * (edges_x[:-1] + edges_x[1:] - 1)
    twin = RegularGridInterpolator(centres, tiles, bounds_error=False, fill_value=None)
    y, x = np.mgrid[:height, :width]
    assert np.allclose(fill_plane(interpolate_tiles(tiles, height, width, True)), twin((y, x)), atol=2e-6)
    clamped = twin((np.clip(y, centres[0][0], centres[0][-1]), np.clip(x, centres[1][0], centres[1][-1])))
    assert np.allclose(fill_plane(interpolate_tiles(tiles, height, width, False)), clamped, atol=2e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (5, 1), (2, 2)])
def test_few_tiles(shape):
    tiles = np.full(shape, 3.5)
    assert np.all(fill_plane(interpolate_tiles(smooth_tiles(tiles), 40, 50, True)) == np.float32(3.5))


def test_smoothing_keeps_a_plane_and_removes_a_star():
    y, x = np.mgrid[:6, :7]
    plane = 3.0 * y - 2.0 * x + 10
    assert np.allclose(smooth_tiles(plane), plane, atol=1e-12)
    bright = plane.copy()
    bright[3, 3] += 1e6
    assert np.abs(smooth_tiles(bright) - plane).max() <= 3.0


@pytest.mark.parametrize("sigma", [0.2, 0.4, 1.0, 3.0, 30.0])
def test_level_and_noise_of_whole_numbers(sigma):
    # The truth is the rounded image's own standard deviation, or 1/√12 where that is less. A tile's clipped mean of 400
    # values is good to σ/20, its deviation to σ/28; the 3×3 median of tiles brings both down, so that the worst of 256
    # tiles stays within five of these.
    image = np.rint(rng(int(sigma * 10)).normal(1000.3, sigma, (1024, 1024))).astype(np.uint16)
    background = estimate(image, 64)
    true = max(image.std(), np.sqrt(1 / 12))
    assert background.level.dtype == background.noise.dtype == np.float32
    assert abs(background.level.mean() - image.mean()) < 0.02 * true
    assert np.abs(background.level - image.mean()).max() < 5 * true / 20
    assert background.noise.mean() == pytest.approx(true, rel=0.03)
    assert np.abs(background.noise / true - 1).max() < 5 / 28


def test_gradient_and_vignetting():
    y, x = np.mgrid[:768, :1024] / 1024
    sky = 2000 * (1 - 0.5 * ((x - 0.5) ** 2 + (y - 0.4) ** 2)) + 800 * x
    noise = 10.0
    background = estimate(sky + rng(3).normal(0, noise, sky.shape), 64)
    assert np.abs(background.level - sky).max() < noise
    assert np.median(background.noise) < 2.2 * noise  # the gradient within a tile counts as noise


def test_stars_and_moon_do_not_lift_the_sky():
    image = rng(4).normal(50, 4, (512, 512))
    for _ in range(150):
        x, y = rng(4, _).integers(5, 500, 2)
        image[y : y + 5, x : x + 5] += 3000
    image[200:240, 300:340] = 60000
    background = estimate(image, 64)
    assert np.abs(background.level - 50).max() < 2.0
    assert background.noise.max() < 6.0


def test_image_cut_off_at_zero_has_noise_above_it():
    # half-normal: everything below zero lost. The threshold must come from the spread that is left
    image = np.rint(np.maximum(rng(5).normal(0, 2, (512, 512)), 0)).astype(np.uint8)
    background = estimate(image, 64)
    spots = find_components(as_image(image), background, DetectionSettings(max_stars=1000), None)
    assert background.noise.min() > 0.8
    assert len(spots) < 3


@pytest.mark.parametrize(
    ("values", "step"),
    [([0, 16, 48, 320], 16), ([7, 7, 7], 1), ([3, 4, 9], 1), ([255, 65535], 65280)],
)
def test_step_of_whole_numbers(values, step):
    image = np.tile(np.array(values, np.float32), (8, 100))
    assert noise_floor(image) == (step, pytest.approx(step / np.sqrt(12)))


def test_step_of_averaged_colours():
    image = rng(6).integers(0, 9, (200, 200, 3)).mean(axis=2).astype(np.float32)
    step, floor = noise_floor(image)
    assert step == pytest.approx(1 / 3, rel=1e-3)
    assert floor == pytest.approx(1 / 3 / np.sqrt(12), rel=1e-3)


def test_continuous_noise_has_no_step():
    step, floor = noise_floor(rng(8).normal(0, 1, (300, 300)).astype(np.float32))
    assert step == 0.0
    assert floor < 1e-3


@pytest.mark.parametrize("value", [0.0, 1.0, -3.5, 1e-20, 65535.0, 3e38])
def test_constant_image_has_a_positive_noise_and_no_spots(value):
    image = np.full((64, 64), value, np.float32)
    background = estimate(image, 64)
    assert np.all(background.level == np.float32(value))
    assert np.all(background.noise > 0)
    assert len(find_components(image, background, DetectionSettings(), None)) == 0


def test_pixels_that_are_not_numbers_are_left_out():
    image = rng(9).normal(100, 5, (256, 256))
    clean = estimate(image, 64)
    image[rng(9, 1).random(image.shape) < 0.2] = np.nan
    image[:64, :64] = np.nan
    image[100, 100] = np.inf
    holes = estimate(image, 64)
    assert np.isfinite(holes.level).all()
    assert np.isfinite(holes.noise).all()
    assert np.abs(holes.level - clean.level).max() < 2.0
    nothing = estimate(np.full((64, 64), np.nan), 64)
    assert np.all(nothing.level == 0)
    assert np.all(nothing.noise == 1)


def test_any_layout_and_type_gives_the_same():
    image = rng(10).integers(0, 4000, (128, 160)).astype(np.uint16)
    reference = estimate(image, 32)
    for other in (
        image.astype(np.int64),
        image.astype(np.float64),
        np.asfortranarray(image),
        np.dstack([image] * 2)[..., 0],
    ):
        again = estimate(other, 32)
        assert np.array_equal(again.level, reference.level)
        assert np.array_equal(again.noise, reference.noise)
    read_only = image.copy()
    read_only.flags.writeable = False
    before = read_only.copy()
    estimate(read_only, 32)
    assert np.array_equal(read_only, before)


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (1, 1), (1, 300), (16, 16), (7, 3)])
def test_tiny_images(shape):
    background = estimate(np.ones(shape), 64)
    assert background.level.shape == background.noise.shape == shape


@pytest.mark.parametrize(
    ("image", "tile", "match"),
    [
        (np.zeros((4, 4, 3)), 64, "two dimensions"),
        (np.zeros(9), 64, "two dimensions"),
        (np.zeros((4, 4), complex), 64, "real numbers"),
        (np.array([["a", "b"]]), 64, "real numbers"),
        (np.zeros((64, 64)), 4, "background_tile_px is 4"),
    ],
)
def test_unusable_input(image, tile, match):
    with pytest.raises(InputError, match=match):
        estimate(image, tile)
