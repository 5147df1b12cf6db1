"""Numbers drawn from the table of a level, against SciPy's distributions and plain NumPy twins, word by word."""

import numpy as np
import pytest
from scipy import stats

from simulator.detector import FixedPattern, detect
from simulator.detector import level as levels
from simulator.detector.level import draw_level, level_number
from simulator.detector.philox import draw_key, fill_words, further_bits
from simulator.detector.pixels import TILE, walk
from simulator.detector.steps import (
    AMPLIFY,
    BEND,
    CLIP,
    CONVERT,
    DARK_SIGNAL,
    LIGHT,
    NORMAL_NOISE,
    PHOTO_RESPONSE,
    SHOT_NOISE,
    Step,
    begin,
    of_map,
)
from simulator.randomness import stream
from simulator.scenario.schema import DetectorSection
from startracker.errors import InputError

LEVEL, READ_E, GAIN, OFFSET = 7.5, 10.0, 3.3, 60.0
MEGAPIXEL = 1 << 20


def level_table(level, steps, pixels):
    return levels.level_table(level, *begin(steps), pixels)


def row(read_e=READ_E, gain=GAIN, offset=OFFSET, top=4095.0, seed=1, shot=True):
    steps = [Step(LIGHT), Step(SHOT_NOISE, rng=stream(seed, "shot"))] if shot else [Step(LIGHT)]
    steps.append(Step(CLIP, (13_500.0,)))
    if read_e:
        steps.append(Step(NORMAL_NOISE, (read_e,), rng=stream(seed, "read")))
    return [*steps, Step(AMPLIFY, (gain, offset)), Step(CONVERT, (top,))]


def by_scipy(mean, read_e, gain, offset, numbers, top):
    """P(≤ v) and P(> v) of numbers below `top`, counted to 12σ and more."""
    n = np.arange(max(mean - 12 * np.sqrt(mean), 0.0) // 1, mean + 12 * np.sqrt(mean) + 50)
    p, v = stats.poisson.pmf(n, mean), numbers[numbers < top]
    if read_e:
        z = ((v[:, None] + 0.5 - offset) * gain - n) / read_e
        return stats.norm.cdf(z) @ p, stats.norm.sf(z) @ p
    reads = np.clip(np.rint(n / gain + offset), 0, top)
    return (reads <= v[:, None]) @ p, (reads > v[:, None]) @ p


@pytest.mark.parametrize(
    ("mean", "read_e", "gain", "offset", "top"),
    [
        (7.5, 10.0, 3.3, 60.0, 4095.0),
        (0.02, 1.5, 0.4, 3.0, 255.0),
        (300.0, 3.0, 2.0, 0.0, 4095.0),
        (5.0, 10.0, 3.3, 0.0, 4095.0),  # half of it below 0
        (900.0, 5.0, 3.0, 60.0, 255.0),  # nearly all above the top
        (40.0, 0.0, 1.0, 100.0, 4095.0),
        (40.0, 0.0, 2.0, 100.5, 4095.0),  # counts on the edges: even numbers take them
    ],
)
def test_the_distribution(mean, read_e, gain, offset, top):
    table = level_table(mean, row(read_e, gain, offset, top), MEGAPIXEL)
    numbers = table.lowest + np.arange(len(table.below))
    below, above = by_scipy(mean, read_e, gain, offset, numbers, top)
    # Sums of some hundred terms, each of SciPy's and ours good to some 1e-14: probabilities of counts are exponentials
    # of up to 60. What lies beyond the bounds, 1e-26, is left out.
    np.testing.assert_allclose(table.below, below, rtol=1e-12, atol=1e-25)
    np.testing.assert_allclose(table.above, above, rtol=1e-12, atol=1e-25)
    outer = by_scipy(mean, read_e, gain, offset, np.array([table.lowest - 1, numbers[-1] + 1]), top + 2)
    assert outer[0][0] < 1e-25 or table.lowest == 0
    assert outer[1][1] < 1e-25 or numbers[-1] + 1 == top


def test_steps_before_the_counts_and_after():
    """Response and dark current of all pixels alike make another mean; two noises add up; a bent response is that of
    each count."""
    plain = level_table(1.1 * LEVEL + 2.0, row(), MEGAPIXEL)
    steps = row()
    steps[1:1] = [of_map(PHOTO_RESPONSE, 1.1), of_map(DARK_SIGNAL, 2.0)]
    steps[-3:-2] = [Step(NORMAL_NOISE, (6.0,), rng=stream(1, "a")), Step(NORMAL_NOISE, (8.0,), rng=stream(1, "b"))]
    np.testing.assert_allclose(level_table(LEVEL, steps, MEGAPIXEL).below, plain.below, rtol=1e-12)

    steps = row(read_e=0.0, gain=1.0)
    steps[-2:-2] = [Step(BEND, (100.0, -0.2, 0.1))]
    table = level_table(LEVEL, steps, MEGAPIXEL)
    n = np.arange(200)
    reads = np.rint(n * (1 - 0.2 * n / 100 + 0.1 * (n / 100) ** 2) + 60)
    p = stats.poisson.pmf(n, LEVEL)
    expected = [p[reads <= table.lowest + i].sum() for i in range(len(table.below))]
    np.testing.assert_allclose(table.below, expected, rtol=1e-12)


def twin(table, words, fraction):
    """Least number whose P(≤ v) exceeds (words + fraction)/2³²; above the middle by what is left."""
    lower = words < 2**31
    passed = np.searchsorted(table.below, (words + fraction) / 2**32, side="right")
    left = ((2**32 - 1 - words.astype(np.int64)) + (1 - fraction)) / 2**32
    passed_above = len(table.above) - np.searchsorted(table.above[::-1], left, side="left")
    return table.lowest + np.where(lower, passed, passed_above)


@pytest.mark.parametrize(("mean", "read_e"), [(LEVEL, READ_E), (0.01, 2.0), (50.0, 0.0), (800.0, 5.0)])
def test_every_way_to_a_number(mean, read_e):
    table = level_table(mean, row(read_e), MEGAPIXEL)
    edge = np.clip(np.floor(np.where(table.below < 0.5, table.below, 1 - table.above) * 2**32), 0, 2**32 - 1)
    words = np.concatenate(
        [
            stream(2, "words").integers(0, 2**32, 200_000),
            np.clip(edge[:, None] + [-1, 0, 1], 0, 2**32 - 1).ravel(),
            np.arange(2000),
            2**32 - 1 - np.arange(2000),
            np.repeat([0, 2**32 - 1], 2000),
        ]
    ).astype(np.uint32)
    key, first = draw_key(stream(2, "key")), 11
    drawn = np.empty(words.size, dtype=np.int32)
    draw_level(table, key, first, words, drawn)
    fraction = np.array([further_bits(key, first + i) for i in range(words.size)])
    assert np.array_equal(drawn, twin(table, words, fraction))


def test_nothing_is_left_out_that_could_be_drawn():
    """The least u is 2⁻⁸⁶, of word 0 and the least fraction of 53 bits; the largest is as far from 1."""
    least, table = 2.0**-86, level_table(LEVEL, row(), MEGAPIXEL)
    assert table.below[0] < least
    assert table.above[-1] < least
    ends = level_number(table, np.uint32(0), 2.0**-54), level_number(table, np.uint32(2**32 - 1), 1.0 - 2.0**-53)
    assert ends[0] == table.lowest + np.flatnonzero(table.below > least)[0]
    assert ends[1] == table.lowest + np.flatnonzero(table.above < 2 * least)[0]


def words_of(pixels, seed):
    """Words of an image's pixels: the layout of `pixels.TILE`."""
    key, quarter = draw_key(stream(seed, "shot")), TILE // 4
    words = np.empty((-(-pixels // TILE), TILE), dtype=np.uint32)
    for k, tile in enumerate(words):
        fill_words(key, np.uint64(k * quarter), np.uint64(0), tile)
    return key, words.ravel()[:pixels]


def starry(shape, share, seed):
    """An even image with a share of its pixels lit: some in runs, some rows altogether."""
    rng = stream(seed, "stars")
    image = np.full(shape, LEVEL)
    lit = rng.random(shape) < share
    lit[rng.integers(0, shape[0], 5)] = True
    image[lit] += rng.uniform(0, 400, lit.sum())
    return image, lit


@pytest.mark.parametrize("share", [0.0, 0.02, 0.2, 0.3, 1.0])
def test_each_pixel_by_itself(share):
    """Of the level: from the table by its word; off it: what the steps make of it without a level."""
    image, lit = starry((245, 267), share, seed=3)  # not a whole number of tiles
    kept = image.copy()
    drawn, stepped = np.empty(image.shape, dtype=np.uint16), np.empty(image.shape)
    walk(image, row(), drawn, LEVEL)
    walk(image, row(), stepped)
    assert np.array_equal(image, kept)
    assert np.array_equal(drawn[lit], stepped[lit])
    key, words = words_of(image.size, 1)
    fraction = np.array([further_bits(key, k) for k in range(image.size)])
    expected = twin(level_table(LEVEL, row(), image.size), words, fraction).reshape(image.shape)
    assert np.array_equal(drawn[~lit], expected[~lit])
    walk(image, row(), image, LEVEL)
    assert np.array_equal(image, drawn)


def test_a_star_changes_no_other_pixel():
    (one, lit_one), (two, lit_two) = (starry((245, 267), share, seed) for share, seed in ((0.02, 4), (0.3, 5)))
    both = ~lit_one & ~lit_two
    two[lit_one] = one[lit_one]
    first, second = (np.empty(one.shape, dtype=np.uint16) for _ in range(2))
    walk(one, row(), first, LEVEL)
    walk(two, row(), second, LEVEL)
    assert np.array_equal(first[both | lit_one], second[both | lit_one])


def without(kernel):
    return [step for step in row() if step.kernel != kernel]


@pytest.mark.parametrize(
    ("steps", "level", "pixels"),
    [
        ([], LEVEL, MEGAPIXEL),
        (without(CONVERT), LEVEL, MEGAPIXEL),
        ([Step(LIGHT), *row()[2:3], *row()[4:]], LEVEL, MEGAPIXEL),  # nothing by chance
        ([Step(LIGHT), of_map(DARK_SIGNAL, np.ones(MEGAPIXEL)), *row()[1:]], LEVEL, MEGAPIXEL),
        ([*row()[:4], Step(BEND, (1e4, 0.1, 0.0)), *row()[4:]], LEVEL, MEGAPIXEL),  # normal noise is bent too
        ([*row()[:2], *row()[1:]], LEVEL, MEGAPIXEL),  # counts of counts
        (row(), LEVEL, 256),
        (row(), 1.3e4, MEGAPIXEL),
        (row(), 1e20, MEGAPIXEL),
        (row(gain=0.01), LEVEL, MEGAPIXEL),
        (row(), -1.0, MEGAPIXEL),
        (row(), np.nan, MEGAPIXEL),
    ],
)
def test_what_has_no_table(steps, level, pixels):
    assert level_table(level, steps, pixels) is None


def test_light_that_cannot_be():
    for wrong in (-1.0, np.nan, np.inf):
        image = np.full((256, 256), LEVEL)
        image[100, 100] = wrong
        with pytest.raises(InputError, match="negative or not finite"):
            walk(image, row(), np.empty(image.shape, dtype=np.uint16), LEVEL)


def test_the_chain_takes_a_level():
    section = DetectorSection(
        width=256, height=256, pixel_pitch_um=5.5, exposure_s=0.5, full_well_e=13_500.0, read_noise_e=READ_E
    )
    mean, lit = starry((256, 256), 0.02, seed=6)

    def frame(pattern, **options):
        return detect(mean, section, pattern, lambda name: stream(6, name, 0), **options).image

    perfect, uneven = FixedPattern(1.0, 0.0), FixedPattern(np.ones(mean.shape), 0.0)
    stepped, drawn = frame(perfect), frame(perfect, keep_charge=False, level_e=LEVEL)
    assert np.array_equal(drawn[lit], stepped[lit])
    assert not np.array_equal(drawn[~lit], stepped[~lit])
    assert np.array_equal(frame(perfect, level_e=LEVEL), stepped)  # the charge is kept
    assert np.array_equal(frame(uneven, keep_charge=False, level_e=LEVEL), stepped)
