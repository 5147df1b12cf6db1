"""The background that follows structure: when it is needed, and that it takes nothing from the stars."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from startracker.detection import estimate
from startracker.detection.background import follow_structure, has_structure

SIZE, NOISE = 320, 5.0


def sky(rng, structure=0.0):
    return (200.0 + structure + NOISE * rng.standard_normal((SIZE, SIZE))).astype(np.float32)


def smooth(rng, scale):
    field = gaussian_filter(rng.standard_normal((SIZE, SIZE)), scale, mode="wrap")
    return field / field.std()


def star(x, y, flux, sigma=0.9):
    edges = np.arange(SIZE + 1) - 0.5
    along_x, along_y = (0.5 * np.diff(erf((edges - c) / (np.sqrt(2.0) * sigma))) for c in (x, y))
    return flux * np.outer(along_y, along_x)


@pytest.mark.parametrize("amplitude", [0.0, 2.0, 15.0, 100.0, 1000.0])
def test_structure_is_seen_where_it_is_as_strong_as_the_noise(amplitude):
    """With a standard deviation of A beside the noise N, tiles show √(A² + N²): 1.5 N at A = 1.1 N."""
    rng = np.random.default_rng(1)
    for _ in range(5):
        image = sky(rng, amplitude * smooth(rng, 12.0))
        assert has_structure(image, estimate(image)) == (amplitude > 1.5 * NOISE)


def test_stars_trails_and_hot_pixels_are_no_structure():
    rng = np.random.default_rng(2)
    image = sky(rng)
    for _ in range(60):
        image += star(*rng.uniform(5, SIZE - 6, 2), 10.0 ** rng.uniform(2.5, 4.5))
        x, y = rng.uniform(40, SIZE - 41, 2)
        image += sum(star(x + 0.7 * k, y + 0.5 * k, 100.0) for k in range(-15, 16))
    image[rng.random(image.shape) < 0.01] += 500.0
    assert not has_structure(image.astype(np.float32), estimate(image))


@pytest.mark.parametrize(("amplitude", "scale"), [(50.0, 12.0), (200.0, 20.0), (1000.0, 50.0)])
def test_level_and_noise_under_structure(amplitude, scale):
    """What is left of the structure is below the noise of a pixel; tiles of 64 px leave more than 5 times as much."""
    rng = np.random.default_rng(3)
    structure = amplitude * smooth(rng, scale)
    image = sky(rng, structure)
    found, plain = follow_structure(image), estimate(image)
    left = np.std(found.level - 200.0 - structure)
    assert left < NOISE
    assert np.std(plain.level - 200.0 - structure) > 5.0 * left
    # 102,400 pixels less those of the level: a standard deviation to 0.2 %, and what is left of the structure
    assert NOISE * 0.9 < np.median(found.noise) < np.hypot(NOISE, left) * 1.05


def test_a_plane_has_its_own_noise():
    rng = np.random.default_rng(4)
    image = sky(rng, 3.0 * np.arange(SIZE)[None, :] + 1.0 * np.arange(SIZE)[:, None])
    assert has_structure(image, estimate(image))
    found = follow_structure(image)
    # the level itself takes the noise of 5 × 5 bins of 16 px with it: 2 %, at most 10 % by its median and twicing
    assert np.median(found.noise) == pytest.approx(NOISE, rel=0.1)
    assert np.abs(found.level - image.astype(float)).mean() < NOISE


@pytest.mark.parametrize("flux", [300.0, 3000.0, 30000.0])
def test_a_star_keeps_its_light(flux):
    """Within 3 standard errors of the level's own noise, 0.06 N a pixel over a window of 7 × 7, and 1 %."""
    rng = np.random.default_rng(5)
    image = 200.0 + smooth(rng, 25.0) * 50.0 + 0.0 * sky(rng)
    clean = follow_structure(image.astype(np.float32)).level
    level = follow_structure((image + star(160.3, 160.6, flux)).astype(np.float32)).level
    window = np.s_[157:164, 157:164]
    assert abs((level - clean)[window].sum()) < 0.01 * flux + 3.0 * 0.06 * NOISE * 49


def test_small_and_empty_frames():
    for shape in ((1, 1), (3, 7), (12, 12), (40, 9)):
        image = np.full(shape, 7.0, np.float32)
        assert not has_structure(image, estimate(image))
        assert follow_structure(image).level == pytest.approx(image)
    gaps = np.full((64, 64), np.nan, np.float32)
    assert not has_structure(gaps, estimate(gaps))
    assert follow_structure(gaps).shape == gaps.shape
