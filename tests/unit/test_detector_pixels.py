"""The per-pixel pipeline: which pixel takes which random word, tiles, layouts; all against plain twins."""

import numpy as np
import pytest
from scipy.special import ndtri

from simulator.detector.philox import fill_bits
from simulator.detector.pixels import apply_steps
from simulator.detector.steps import (
    AMPLIFY,
    BEND,
    CLIP,
    CONVERT,
    DARK_CURRENT,
    GAUSSIAN_NOISE,
    PHOTO_RESPONSE,
    SHOT_NOISE,
    TILE,
    Step,
    of_map,
)
from simulator.randomness import draw_key, stream


def normal(shape, rng, sigma=1.0):
    out = np.empty(shape)
    apply_steps(np.zeros(shape), [Step(GAUSSIAN_NOISE, (sigma,), rng=rng)], out)
    return out


def test_which_pixel_takes_which_word():
    """Pixel k: word (k mod TILE) div (TILE/4) of the counter (k div TILE) TILE/4 + k mod (TILE/4)."""
    key, quarter = draw_key(stream(1, "n")), TILE // 4
    numbers = normal((3 * TILE,), stream(1, "n"))
    for k in (0, 1, quarter, TILE - 1, TILE, 2 * TILE + 3 * quarter + 7):
        block = np.empty(4, dtype=np.uint32)
        fill_bits(key, np.uint64(k // TILE * quarter + k % quarter), np.uint64(0), block)
        word = int(block[k % TILE // quarter])
        assert numbers[k] == pytest.approx(ndtri((word + 0.5) / 2**32), abs=1e-6)


def test_noise_of_a_pixel_depends_on_its_number_alone():
    short, long = normal((5000,), stream(2, "n")), normal((100, 301), stream(2, "n"))
    assert np.array_equal(short, long.ravel()[:5000])
    image = np.empty((100, 301))
    apply_steps(np.full((100, 301), 7.0), [Step(GAUSSIAN_NOISE, (3.0,), rng=stream(2, "n"))], image)
    np.testing.assert_allclose(image, 7.0 + 3.0 * long, rtol=0, atol=1e-14)


def test_steps_without_chance_against_numpy():
    rng = stream(3, "steps")
    shape = (45, 67)  # not a whole number of tiles
    signal = rng.uniform(0, 3e4, shape)
    response, dark = (rng.uniform(*ends, shape).astype(np.float32) for ends in ((0.9, 1.1), (0, 100)))
    kept = signal.copy()
    steps = [
        of_map(PHOTO_RESPONSE, response),
        of_map(DARK_CURRENT, dark),
        Step(CLIP, (2e4,)),
        Step(BEND, (2e4, 0.02, -0.01)),
        Step(AMPLIFY, (7.3, 55.0)),
        Step(CONVERT, (2500.0,)),
    ]
    expected = [signal, signal * response]
    expected.append(expected[-1] + dark)
    expected.append(np.minimum(expected[-1], 2e4))
    s = expected[-1] / 2e4
    expected.append(expected[-1] * (1 + 0.02 * s - 0.01 * s * s))
    expected.append(expected[-1] / 7.3 + 55.0)
    expected.append(np.clip(np.rint(expected[-1]), 0, 2500))
    for count, wanted in enumerate(expected):
        out = np.empty(shape)
        apply_steps(signal, steps[:count], out)
        np.testing.assert_allclose(out, wanted, rtol=1e-14)
    numbers = np.empty(shape, dtype=np.uint16)
    apply_steps(signal, steps, numbers)
    assert np.array_equal(numbers, expected[-1])
    assert np.array_equal(signal, kept)
    apply_steps(signal, steps, signal)
    assert np.array_equal(signal, expected[-1])


@pytest.mark.parametrize("response", [1.5, np.linspace(0.5, 1.5, 12, dtype=np.float32)])
@pytest.mark.parametrize("dark", [2.0, np.linspace(0.0, 5.0, 12, dtype=np.float32)])
def test_one_number_for_all_pixels_or_a_map(response, dark):
    out = np.empty((3, 4))
    apply_steps(np.full((3, 4), 10.0), [of_map(PHOTO_RESPONSE, response), of_map(DARK_CURRENT, dark)], out)
    assert np.array_equal(out.ravel(), np.broadcast_to(10.0 * np.float64(response) + dark, 12))


def test_maps_are_taken_in_single_precision():
    light, response, dark = np.full((2, 3), 10.0), np.full((2, 3), 1.1), np.full((2, 3), 7.3)
    out = np.empty((2, 3))
    apply_steps(light, [of_map(PHOTO_RESPONSE, response), of_map(DARK_CURRENT, dark)], out)
    assert np.array_equal(out, 10.0 * np.float64(np.float32(response)) + np.float32(dark))


def test_what_begins_a_row_stands_at_its_beginning():
    with pytest.raises(ValueError, match="a sequence of steps must begin"):
        apply_steps(np.ones((3, 4)), [of_map(DARK_CURRENT, 2.0), of_map(PHOTO_RESPONSE, 1.5)], np.empty((3, 4)))


def test_layouts_that_do_not_fit_are_refused():
    image = np.zeros((4, 6))
    with pytest.raises(ValueError, match="contiguous"):
        apply_steps(image.T, [], np.zeros((6, 4)))
    with pytest.raises(ValueError, match="contiguous"):
        apply_steps(image, [Step(SHOT_NOISE, rng=stream(1, "n"))], np.zeros((6, 4)).T)


def test_an_empty_image():
    out = np.empty((0, 4))
    apply_steps(np.empty((0, 4)), [Step(SHOT_NOISE, rng=stream(1, "n"))], out)


def test_key_is_the_first_two_integers_of_its_stream():
    for stage in range(20):
        first = stream(1, str(stage)).integers(0, 2**32, size=2, dtype=np.uint64)
        np.testing.assert_array_equal(draw_key(stream(1, str(stage))), first)
