"""Light of an image at positions where stars are expected, whatever the detector made of it."""

import numpy as np
import pytest

from startracker.detection import Background
from startracker.detection.background import Light

SIZE = 300


def light_of(image):
    """Noise of 2 DN about a level of 100 DN."""
    level, noise = np.full(image.shape, 100.0, np.float32), np.full(image.shape, 2.0, np.float32)
    return Light(image.astype(np.float32), Background(level, noise), 5.0)


@pytest.fixture
def image():
    return 100.0 + 2.0 * np.random.default_rng(1).standard_normal((SIZE, SIZE))


def test_positions_of_stars_are_seen(image):
    positions = np.random.default_rng(2).uniform(5.0, SIZE - 6.0, (20, 2))
    x, y = np.rint(positions[:12]).astype(int).T
    image[y, x + 1] += 30.0  # one pixel beside the expected one, 15 σ
    image[y[0], x[0]] = np.nan
    expected = np.arange(20) < 12
    assert np.array_equal(light_of(image).stands_out(positions), expected)
    assert np.array_equal(light_of(image).seen(positions), expected)


def test_the_threshold_is_that_of_a_pixel(image):
    image[:] = 100.0
    image[50, 60], image[150, 60] = 110.1, 109.9  # 5.05 and 4.95 σ
    assert light_of(image).stands_out(np.array([[60.4, 50.4], [60.0, 150.0]])).tolist() == [True, False]


def test_positions_at_and_beyond_the_border(image):
    image[:] = 100.0
    image[0, 0] = image[-1, -1] = 200.0
    found = light_of(image).stands_out(
        np.array([[0.0, 0.0], [SIZE - 1.0, SIZE - 1.0], [-3.0, -3.0], [0.0, SIZE - 1.0]])
    )
    assert found.tolist() == [True, True, True, False]


def test_light_by_chance_is_not_that_of_stars(image):
    """A quarter of the image is bright: of 40 positions 10 ± 2.7 have light; 10 are not seen, 30 are."""
    image[:, : SIZE // 4] += 100.0
    rng = np.random.default_rng(3)
    bright = rng.uniform((5.0, 5.0), (SIZE / 4 - 5.0, SIZE - 5.0), (30, 2))
    dark = rng.uniform((SIZE / 4 + 5.0, 5.0), (SIZE - 5.0, SIZE - 5.0), (30, 2))
    by_chance, more = np.concatenate([bright[:10], dark]), np.concatenate([bright, dark[:10]])
    light = light_of(image)
    assert np.count_nonzero(light.stands_out(by_chance)) == 10
    assert not light.seen(by_chance).any()
    assert np.array_equal(light.seen(more), np.arange(40) < 30)


def test_no_positions(image):
    assert light_of(image).seen(np.empty((0, 2))).shape == (0,)
