"""Whether a frame shows points or trails: what makes the detector consider trails, and what lies on one."""

import numpy as np
import pytest
from scipy.special import erf

from startracker.detection import METHODS, Background, Spots, estimate
from startracker.detection.components import decide
from startracker.settings import DetectionSettings

SIGMA, NOISE, SIZE = 1.2, 5.0, 256


def drawn(stars, seed=1):
    """Stars (x, y, flux, length along x), drawn as the mean of Gaussian images along a line, with noise."""
    image = np.random.default_rng(seed).normal(100.0, NOISE, (SIZE, SIZE))
    edges = np.arange(SIZE + 1) - 0.5
    for x, y, flux, length in stars:
        offsets = (np.arange(40) + 0.5) / 40 - 0.5 if length else np.zeros(1)
        across = 0.5 * np.diff(erf((edges - y) / SIGMA / np.sqrt(2)))
        along = np.mean([0.5 * np.diff(erf((edges - x - t * length) / SIGMA / np.sqrt(2))) for t in offsets], axis=0)
        image += flux * across[:, None] * along
    return image.astype(np.float32)


def field(length, count=16, flux=12000.0, seed=3):
    rng = np.random.default_rng(seed)
    cells = np.stack(np.divmod(np.arange(16), 4), axis=1)[:count] * 60 + 36
    return [(*(cell + rng.uniform(-4, 4, 2)), flux, length) for cell in cells]


@pytest.mark.parametrize(("max_axis_ratio", "trailed"), [(2.5, True), (5.0, False)])
def test_a_wide_limit_on_the_axis_ratio_keeps_elongated_stars_points(max_axis_ratio, trailed):
    """Stars drawn over 5 px make the detector consider trails if their axis ratio of about 2 exceeds 0.6 of the limit.

    A user whose lens elongates its stars sets a wide limit, and no other hypothesis is followed.
    """
    image = drawn(field(5.0))
    found = METHODS["components"](image, estimate(image, 64), DetectionSettings(max_axis_ratio=max_axis_ratio))
    assert len(found) == 16
    assert (found.other is not None) == trailed


def test_points_on_a_trail_are_left_out_and_points_beside_it_stay():
    """Twenty round stars and a satellite's trail: the four pieces of the trail that were found as points are rejected,
    and a star 12 px beside the trail's middle is not."""
    stars = field(0.0)
    x, y = 128.0, 127.0
    beside = (x, y + 12.0, 12000.0, 0.0)
    image = drawn([*stars, beside, (x, y, 60000.0, 40.0)])
    background = Background(np.full_like(image, 100.0), np.full_like(image, NOISE))
    pieces = [(x + d, y, 9000.0, 0.0) for d in (-15.0, -5.0, 5.0, 15.0)]
    listed = np.array([*stars, beside, *pieces])
    n = len(listed)
    points = Spots(
        np.rint(listed[:, 0]).astype(np.int64),
        np.rint(listed[:, 1]).astype(np.int64),
        listed[:, 2],
        np.full(n, 20),
        np.zeros(n, bool),
        np.zeros(n, bool),
        listed[:, :2].copy(),
    )
    trails = Spots(
        np.array([int(x)]),
        np.array([int(y)]),
        np.array([60000.0]),
        np.array([200]),
        np.zeros(1, bool),
        np.zeros(1, bool),
        np.array([[x, y]]),
        np.array([[40.0, 0.0]]),
    )
    found = decide(trails, points, image, background, 50)
    assert found.other is trails
    assert len(found) == len(stars) + 1
    assert not np.any((np.abs(found.centre[:, 1] - y) < 2.0) & (np.abs(found.centre[:, 0] - x) < 20.0))
