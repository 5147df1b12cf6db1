"""Region growing with the rules of Greyling 1995 alone: 7 to 36 pixels, σx²/σy² in 0.7 to 1.3, stop at eight."""

import math

import numpy as np
import pytest
from all_detectors import DETECTORS, GENERAL

from simulator.theses.detectors.round_regions import find_first_regions, find_round_regions
from startracker.detection import Background
from startracker.errors import InputError
from startracker.settings import DetectionSettings

SIDE = 96
RULES = DetectionSettings(threshold_dn=10.0, min_pixels=7, max_pixels=36, max_axis_ratio=1.3, max_stars=8)


def flat(shape=(SIDE, SIDE)):
    return Background(np.zeros(shape, np.float32), np.ones(shape, np.float32))


# rows of the search pattern are 2, 5, 8 …, of its columns every third: what is placed below lies on them


def stars(places, sigma_x=1.23, sigma_y=1.23, peak=100.0):
    y, x = np.mgrid[:SIDE, :SIDE]
    image = np.zeros((SIDE, SIDE))
    for k, (x0, y0) in enumerate(places):
        height = peak[k] if np.ndim(peak) else peak
        image += height * np.exp(-((x - x0) ** 2) / (2 * sigma_x**2) - (y - y0) ** 2 / (2 * sigma_y**2))
    return image.astype(np.float32)


def test_both_are_methods_of_the_tracker():
    assert DETECTORS["round_regions"] is find_round_regions
    assert DETECTORS["first_regions"] is find_first_regions
    assert set(GENERAL) < set(DETECTORS)  # those leave hot pixels and streaks in: not for every image


@pytest.mark.parametrize("peak", [30.0, 100.0, 350.0])
def test_a_star_is_found_where_it_is(peak):
    found = find_round_regions(stars([(40.3, 50.7)], peak=peak), flat(), RULES)
    assert len(found) == 1
    # the moment over the pixels above 10 DN of a symmetric star: its cut edge shifts it by less than a fifth of a pixel
    np.testing.assert_allclose(found.centre[0], [40.3, 50.7], atol=0.2)
    # area of the circle above the threshold, 2πσ² ln(I₀/T), to the pixels on its edge
    area = 2 * math.pi * 1.23**2 * math.log(peak / 10.0)
    assert found.pixels[0] == pytest.approx(area, abs=2 * math.sqrt(area))


@pytest.mark.parametrize(("shape", "reason"), [((2, 3), "too small"), ((6, 7), "too large"), ((2, 8), "axis ratio")])
def test_what_is_left_out_and_why(shape, reason):
    image = np.zeros((SIDE, SIDE), np.float32)
    image[29 : 29 + shape[0], 40 : 40 + shape[1]] = 50.0
    found = find_round_regions(image, flat(), RULES)
    assert len(found) == 0
    assert found.rejected == {reason: 1}


@pytest.mark.parametrize(("pixels", "kept"), [((2, 3), 0), ((1, 7), 0), ((6, 6), 1), ((6, 7), 0), ((3, 3), 1)])
def test_sizes_of_seven_to_thirty_six(pixels, kept):
    image = np.zeros((SIDE, SIDE), np.float32)
    image[29 : 29 + pixels[0], 40 : 40 + pixels[1]] = 50.0
    assert len(find_round_regions(image, flat(), RULES)) == kept


@pytest.mark.parametrize(("ratio", "kept"), [(0.65, 0), (0.75, 1), (1.0, 1), (1.25, 1), (1.35, 0)])
def test_the_limits_of_the_axis_ratio(ratio, kept):
    # a low threshold, so that the measured moments are those of the whole star
    rules = DetectionSettings(threshold_dn=1e-3, min_pixels=7, max_pixels=400, max_axis_ratio=1.3, max_stars=8)
    image = stars([(48.0, 48.0)], sigma_x=2.0 * math.sqrt(ratio), sigma_y=2.0)
    assert len(find_round_regions(image, flat(), rules)) == kept


def test_a_slanted_streak_passes_the_ratio_of_x_and_y():
    """What the rule of x and y cannot see; the tracker's own detectors take principal axes."""
    y, x = np.mgrid[:SIDE, :SIDE] - 48.0
    along, across = (x + y) / math.sqrt(2), (x - y) / math.sqrt(2)
    image = (100.0 * np.exp(-(along**2) / (2 * 2.0**2) - across**2 / (2 * 0.8**2))).astype(np.float32)
    assert len(find_round_regions(image, flat(), RULES)) == 1


def test_the_eight_brightest_or_the_first_eight():
    places = [(12 + 24 * (k % 4) + 0.2, 10 + 24 * (k // 4) + 0.1) for k in range(12)]
    peaks = 40.0 + 30.0 * np.arange(12)  # fainter ones first in reading order
    image = stars(places, peak=peaks)
    brightest, first = (find(image, flat(), RULES) for find in (find_round_regions, find_first_regions))
    assert len(brightest) == len(first) == 8
    for found, chosen in ((brightest, places[:3:-1]), (first, places[7::-1])):
        np.testing.assert_allclose(np.stack([found.x_peak, found.y_peak], 1), np.round(chosen), atol=1)
    assert brightest.rejected == {"fainter than the brightest": 4}
    assert first.rejected == {}
    assert np.all(np.diff(first.flux) < 0)


def test_the_search_ends_at_the_eighth():
    image = stars([(12 + 24 * (k % 4), 10 + 24 * (k // 4)) for k in range(8)])
    image[89:91, 80:83] = 50.0  # too small, below the eighth star: not reached
    assert find_first_regions(image, flat(), RULES).rejected == {}
    assert find_round_regions(image, flat(), RULES).rejected == {"too small": 1}


def test_without_an_absolute_threshold_it_is_that_of_the_noise():
    image = stars([(40.0, 50.0)]) + np.float32(200.0)
    background = Background(np.full_like(image, 200.0), np.full_like(image, 2.0))
    rules = DetectionSettings(threshold_sigma=5.0, min_pixels=7, max_pixels=36, max_axis_ratio=1.3)
    found = find_round_regions(image, background, rules)
    assert found.pixels.tolist() == [np.count_nonzero(image > 210.0)]


def test_bad_pixels_and_input():
    image = stars([(40.0, 50.0)])
    image[20, 20], image[70:73, 70:73] = np.nan, np.inf
    assert len(find_round_regions(image, flat(), RULES)) == 1
    with pytest.raises(InputError, match="compute it again"):
        find_round_regions(image, flat((8, 8)), RULES)
    with pytest.raises(InputError, match="search_step_px is 0"):
        find_round_regions(image, flat(), DetectionSettings(search_step_px=0))
