"""Digital numbers that all steps together give pixels of one mean, by χ² against SciPy's distributions.

A fixed seed makes each p-value one number; a right sampler gives less than 1e-4 once in 10⁴ seeds. The last test is the
control: that of a read noise 1 % too large fails.
"""

import numpy as np
import pytest
from scipy import stats

from simulator.detector.pixels import apply_steps
from simulator.detector.steps import AMPLIFY, CLIP, CONVERT, GAUSSIAN_NOISE, LIGHT, SHOT_NOISE, TILE, Step
from simulator.randomness import stream

P_LIMIT = 1e-4
SHAPE = (1024, 1024)


def draw(mean, read_e, gain, offset, full_well, top, seed="level", shot=True):
    rng = stream(21, f"{seed} {mean} {read_e} {gain} {offset}"), stream(22, seed)
    steps = [Step(LIGHT)]
    if shot:
        steps.append(Step(SHOT_NOISE, rng=rng[0]))
    steps.append(Step(CLIP, (full_well,)))
    if read_e:
        steps.append(Step(GAUSSIAN_NOISE, (read_e,), rng=rng[1]))
    steps += [Step(AMPLIFY, (gain, offset)), Step(CONVERT, (top,))]
    image = np.empty(SHAPE, dtype=np.uint16)
    apply_steps(np.full(SHAPE, mean), steps, image)
    return image


def chi_square_p(image, mean, read_e, gain, offset, full_well, top, shot=True):
    """p-value; numbers with fewer than 30 expected pixels are one bin at either end."""
    n = np.arange(stats.poisson.ppf(1e-12, mean), stats.poisson.isf(1e-12, mean) + 1) if shot else np.array([mean])
    p = stats.poisson.pmf(n, mean) if shot else np.ones(1)
    charge, v = np.minimum(n, full_well), np.arange(top)
    if read_e:
        cumulative = np.zeros(v.size)
        for one, share in zip(charge, p, strict=True):
            cumulative += share * stats.norm.cdf((v + 0.5 - offset) * gain, one, read_e)
    else:
        reads = np.clip(np.rint(charge / gain + offset), 0, top)
        cumulative = np.cumsum(np.bincount(reads.astype(int), p, int(top) + 1))[:-1]
    expected = np.diff(cumulative, prepend=0.0, append=1.0) * image.size
    observed = np.bincount(image.ravel(), minlength=int(top) + 1)
    common = np.flatnonzero(expected >= 30.0)
    first, last = common[0], common[-1]
    bins = [[a[:first].sum(), *a[first : last + 1], a[last + 1 :].sum()] for a in (observed, expected)]
    observed, expected = (np.array(a) for a in bins)
    assert np.all(observed[expected < 1e-9] == 0)
    few = (expected < 5.0).nonzero()[0]  # the ends, where they hold next to nothing, and holes of coarse gains
    observed, expected = np.delete(observed, few), np.delete(expected, few)
    return stats.chisquare(observed, expected * observed.sum() / expected.sum()).pvalue


CASES = [
    # mean, read noise, electrons a DN, offset, full well, top
    (1.0, 10.0, 3.3, 60.0, 13_500.0, 4095.0),
    (0.05, 2.0, 0.5, 20.0, 13_500.0, 4095.0),
    (20.0, 3.0, 1.0, 10.0, 13_500.0, 4095.0),
    (20.0, 10.0, 3.3, 60.0, 13_500.0, 4095.0),
    (20.0, 10.0, 3.3, 0.0, 13_500.0, 4095.0),  # clipped at 0
    (1000.0, 8.0, 4.0, 60.0, 13_500.0, 4095.0),
    (1000.0, 8.0, 4.0, 60.0, 1010.0, 4095.0),  # at the full well
    (1000.0, 8.0, 4.0, 10.0, 13_500.0, 255.0),  # at the top of the converter
    (3.0, 0.0, 1.0, 5.0, 13_500.0, 255.0),
    (64.0, 0.0, 2.0, 5.0, 13_500.0, 255.0),
]


@pytest.mark.parametrize("case", CASES)
def test_distribution_of_digital_numbers(case):
    assert chi_square_p(draw(*case), *case) > P_LIMIT


def test_without_shot_noise():
    case = (50.0, 10.0, 3.3, 60.0, 13_500.0, 4095.0)
    assert chi_square_p(draw(*case, shot=False), *case, shot=False) > P_LIMIT


def test_neighbours_are_uncorrelated():
    # Correlation of independent numbers: σ = 1/√N; 4σ.
    numbers = draw(*CASES[3], seed="neighbours").ravel().astype(float)
    for lag in (1, 2, TILE // 4, TILE, SHAPE[1]):
        assert abs(np.corrcoef(numbers[:-lag], numbers[lag:])[0, 1]) < 4 / np.sqrt(numbers.size)


def test_another_noise_would_be_found_out():
    mean, read_e, *rest = CASES[3]
    assert chi_square_p(draw(*CASES[3]), mean, 1.01 * read_e, *rest) < 1e-12
