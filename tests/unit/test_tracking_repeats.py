"""Which frames are known again, and what the innovations of a window say; each part alone."""

import math

import numpy as np
import pytest

from startracker.errors import InputError
from startracker.tracking.consistency import InnovationWindow
from startracker.tracking.mekf import Innovation, chi_square_limit
from startracker.tracking.standstill import _COLUMNS, _ROWS, FrameMemory, list_key
from startracker.tracking.state import FrameClock


def test_list_is_known_in_any_order_and_not_when_one_digit_differs():
    rng = np.random.default_rng(1)
    xy, memory = rng.uniform(0, 100, size=(12, 2)), FrameMemory()
    assert memory.list_repeats(list_key(xy)) is None
    memory.keep_list(1.5, list_key(xy))
    assert memory.list_repeats(list_key(xy[rng.permutation(12)])) == 1.5
    other = xy.copy()
    other[3, 1] = np.nextafter(other[3, 1], 200.0)
    assert memory.list_repeats(list_key(other)) is None
    assert memory.list_repeats(list_key(xy[:11])) is None
    for empty in (np.empty((0, 2)), np.zeros(4), np.zeros((3, 3))):
        assert list_key(empty) == b""
    memory.keep_list(2.0, b"")
    assert memory.list_repeats(b"") is None  # nothing seen twice is nothing seen


def test_only_the_last_eight_are_remembered():
    memory = FrameMemory()
    keys = [list_key(np.array([[k, 1.0]])) for k in range(10)]
    for k, key in enumerate(keys):
        memory.keep_list(float(k), key)
    assert [memory.list_repeats(key) for key in keys] == [None, None, *map(float, range(2, 10))]


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32, np.float64, ">u2"])
def test_image_is_known_by_the_pixels_about_its_stars(kind):
    rng = np.random.default_rng(2)
    image = rng.integers(0, 255, size=(60, 80)).astype(kind)
    stars = np.array([[0.2, 0.4], [79.3, 59.1], [40.6, 30.2], [20.0, -0.4]])  # three at the border
    memory = FrameMemory()
    memory.keep_image(7.0, image, stars)
    assert memory.image_repeats(image.copy()) == 7.0
    assert memory.image_repeats(image[:, ::-1][:, ::-1]) == 7.0
    counted = image.copy()
    counted[50, 10:20] = 3
    assert memory.image_repeats(counted) == 7.0  # away from the stars
    for row, column in ((0, 0), (59, 79), (33, 44), (27, 38), (0, 17)):
        other = image.copy()
        other[row, column] += 1
        assert memory.image_repeats(other) is None
    assert memory.image_repeats(image[:50]) is None
    assert memory.image_repeats(None) is None


def test_pixels_of_a_star_begin_with_its_own():
    """The first one decides for nearly every new frame; away from stars it might be the same in all."""
    places = list(zip(_ROWS.tolist(), _COLUMNS.tolist(), strict=True))
    assert places[0] == (0, 0)
    assert sorted(places) == [(row, column) for row in range(-3, 4) for column in range(-3, 4)]


def test_masked_pixels_are_alike():
    image = np.random.default_rng(3).normal(size=(40, 40))
    image[20, 21] = math.nan
    memory = FrameMemory()
    memory.keep_image(0.0, image, np.array([[20.0, 20.0]]))
    assert memory.image_repeats(image.copy()) == 0.0
    memory.keep_image(1.0, image, np.empty((0, 2)))  # without stars there is nothing to know it by
    assert memory.image_repeats(image) == 0.0


def innovation(vector):
    white = np.array(vector, dtype=float)
    return Innovation(True, float(white @ white), 3, white)


def test_window_finds_what_stays_and_what_is_too_large():
    """Means of 0.8 on one axis: 32 frames have |Σu|²/N = 20, χ²(3) is above with 1.5e-4; no single one stands out."""
    rng = np.random.default_rng(4)
    window, found = InnovationWindow(), None
    for k in range(200):
        new = innovation(rng.normal(size=3) + ([0.8, 0.0, 0.0] if k >= 100 else 0.0))
        if window.contradicts(new):
            found = k
            break
        window.add(new)
    assert 100 < found < 150
    assert window.alarm() == window.noise_factor == 10.0
    for _ in range(32):
        assert not window.contradicts(innovation(rng.normal(size=3)))
        window.add(innovation(rng.normal(size=3)))
    assert 8.0 < window.noise_factor < 10.0
    assert window.contradicts(innovation([9.0, 0.0, 0.0]))


def test_false_alarms_are_rare():
    """6400 consistent frames: each sum has its 1e-3 in every window, 200 of which are separate; 10 alarms are allowed.

    Windows overlap, so that chance has several tries in each; 1 to 3 alarms come with other seeds.
    """
    rng = np.random.default_rng(5)
    window, alarms = InnovationWindow(), 0
    for _ in range(200 * 32):
        new = innovation(rng.normal(size=3))
        if window.contradicts(new):
            alarms += 1
            window.alarm()
        window.add(new)
    assert alarms <= 10
    assert window.noise_factor < 10.0


def test_raised_noise_is_taken_back_where_innovations_are_too_small():
    rng = np.random.default_rng(6)
    window = InnovationWindow()
    for _ in range(4):
        window.alarm()
    assert window.noise_factor == 1e4
    for _ in range(200):
        window.add(innovation(0.3 * rng.normal(size=3)))
    assert window.noise_factor == pytest.approx(1.0, abs=0.2)


def test_one_star_counts_by_its_square_alone():
    window = InnovationWindow()
    for _ in range(40):
        assert not window.contradicts(Innovation(True, 2.0, 2))
        window.add(Innovation(True, 2.0, 2))
    assert window.contradicts(Innovation(True, 60.0, 2))


def test_clock():
    clock = FrameClock()
    assert clock.fault(-3.0) == ""
    assert clock.advance(-3.0) == 0.0
    assert clock.advance(2.0) == 5.0
    assert "before that of the last one" in clock.fault(1.0)
    assert "before that of the last one" in clock.fault(0.5)  # earlier still: another straggler
    assert clock.fault(3.0) == ""
    assert clock.fault(0.7) == ""  # after a refused one: the clock was set back
    assert clock.is_before(0.7)
    assert clock.advance(0.7) == 0.0
    for bad in (math.nan, math.inf, -math.inf):
        assert "not a finite number" in clock.fault(bad)
    assert math.isnan(clock.read(np.float32("nan")))
    for wrong in (None, "noon", [1, 2], np.datetime64("2020-01-01"), 10**400):
        with pytest.raises(InputError, match="number of seconds"):
            clock.read(wrong)


@pytest.mark.parametrize(("ratio", "found"), [(1.03, True), (0.97, False)])
def test_limit_of_the_mean_innovation_is_that_of_chi_square(ratio, found):
    """Constant innovations v: |Σv|²/N = N v² is χ² of three, with 16.27 for a probability of 1e-3."""
    frames = 32
    vector = [math.sqrt(ratio * chi_square_limit(3, 1e-3) / frames), 0.0, 0.0]
    window = InnovationWindow()
    for _ in range(frames - 1):
        window.add(innovation(vector))
    assert window.contradicts(innovation(vector)) == found


def test_two_frames_are_the_fewest_that_contradict():
    window = InnovationWindow()
    assert not window.contradicts(innovation([9.0, 0.0, 0.0]))
    window.add(innovation([0.0, 0.0, 0.0]))
    assert window.contradicts(innovation([9.0, 0.0, 0.0]))
    # a frame without a whitened innovation does not count for the mean: 2 × 16.4 is below χ²(5), and above χ²(3)
    window.forget()
    window.add(Innovation(True, 0.0, 2))
    assert not window.contradicts(innovation([math.sqrt(16.4), 0.0, 0.0]))


def test_only_the_last_frames_count():
    """32, the new one included: what is older is taken off, from every sum."""
    window = InnovationWindow()
    for _ in range(32):
        window.add(innovation([0.0, 1.0, 0.0]))
    for _ in range(31):
        window.add(innovation([0.0, 0.0, 0.0]))
    assert not window.contradicts(innovation([0.0, 0.0, 0.0]))
    limit = math.sqrt(chi_square_limit(96, 1e-3))
    assert not window.contradicts(innovation([0.0, 0.0, 0.99 * limit]))
    assert window.contradicts(innovation([0.0, 0.0, 1.01 * limit]))


def test_an_outlier_within_a_window_is_an_alarm_and_after_a_full_one_not():
    window = InnovationWindow()
    for _ in range(31):
        window.add(innovation([1.0, 1.0, 1.0]))
    window.restart()
    assert window.noise_factor == 10.0
    for _ in range(32):
        window.add(innovation([1.0, 1.0, 1.0]))
    before = window.noise_factor
    window.restart()
    assert window.noise_factor == before
    assert not window.contradicts(innovation([99.0, 0.0, 0.0]))  # a new window
    for _ in range(20):
        window.alarm()
    assert window.noise_factor == 1e8
