"""Displacement damage and random telegraph pixels have the distributions that their parameters say.

Tolerances are 5 standard errors unless stated.
"""

import math

import numpy as np
import pytest
from scipy import stats

from simulator.detector import build_fixed_pattern
from simulator.detector.chain import Detector, Moment
from simulator.detector.parameters import DetectorParameters, DisplacementDamage, RandomTelegraph
from simulator.detector.telegraph import TelegraphPixels, telegraph_pixels
from simulator.randomness import stream

SIZE = {"width": 512, "height": 400, "pitch_um": (5.5, 5.5), "temperature_c": 25.0}
PROCESS = RandomTelegraph(0.1, 800.0, low_s=30.0, high_s=12.0)


def damaged(interactions, dark_e_s, **keys):
    return DetectorParameters(**(SIZE | keys), displacement=DisplacementDamage(interactions, dark_e_s))


@pytest.mark.parametrize("interactions", [0.05, 1.0, 8.0])
def test_dark_current_of_interactions_is_compound_poisson(interactions):
    """Mean μν, variance 2μν², and a share exp(−μ) of pixels without any."""
    each = 300.0
    dark = build_fixed_pattern(damaged(interactions, each), 1).dark_e_s
    n = dark.size
    assert dark.mean() == pytest.approx(interactions * each, abs=5 * each * math.sqrt(2 * interactions / n))
    kurtosis = 24.0 / (4.0 * interactions) + 3.0  # fourth cumulant μ 4! ν⁴ over the variance squared, + 3
    error = math.sqrt((kurtosis - 1.0) / n)
    assert dark.var() == pytest.approx(2 * interactions * each**2, rel=5 * error)
    none = math.exp(-interactions)
    assert np.mean(dark == 0.0) == pytest.approx(none, abs=5 * math.sqrt(none / n))


def test_pixels_of_one_interaction_are_exponentially_distributed():
    """Few interactions: 1 % of the struck pixels have two."""
    dark = build_fixed_pattern(damaged(0.02, 300.0), 2).dark_e_s
    assert stats.kstest(dark[dark > 0], stats.expon(scale=300.0).cdf).pvalue > 1e-3


def test_damage_scales_with_temperature_as_all_dark_current():
    cold = build_fixed_pattern(damaged(1.0, 100.0, dark_doubling_c=5.0), 3).dark_e_s
    warm = build_fixed_pattern(damaged(1.0, 100.0, dark_doubling_c=5.0, temperature_c=30.0), 3).dark_e_s
    np.testing.assert_allclose(warm, 2.0 * cold, rtol=1e-12)


def telegraph(seed=1, process=PROCESS):
    return telegraph_pixels(DetectorParameters(**SIZE, telegraph=process), 1.0, seed)


def test_number_and_amplitudes_of_telegraph_pixels():
    pixels = telegraph()
    n = SIZE["width"] * SIZE["height"]
    assert len(pixels.pixels) == pytest.approx(0.1 * n, abs=5 * math.sqrt(0.09 * n))
    assert len(np.unique(pixels.pixels)) == len(pixels.pixels)
    assert stats.kstest(pixels.amplitude_e_s, stats.expon(scale=800.0).cdf).pvalue > 1e-3


def test_levels_have_their_shares_at_any_time():
    """The process is stationary: the share of the upper level is τ_high / (τ_low + τ_high) at every instant."""
    pixels = telegraph()
    share, n = 12.0 / 42.0, len(pixels.pixels)
    for t_s in (-1e4, 0.0, 0.1, 8.0, 8.571, 1e3, 3.2e7):
        assert pixels.is_high(t_s).mean() == pytest.approx(share, abs=5 * math.sqrt(share * (1 - share) / n))


def test_levels_are_correlated_as_a_two_state_process():
    """Autocovariance p(1 − p) exp(−|Δt| (1/τ_low + 1/τ_high)) (Machlup 1954), within and across the cells of time."""
    pixels = telegraph()
    share, rate, n = 12.0 / 42.0, 1.0 / 30.0 + 1.0 / 12.0, len(pixels.pixels)
    for start in (100.0, 104.0, 5.0e6):
        first = pixels.is_high(start)
        for step in (0.0, 0.5, 3.0, 8.571, 30.0, 200.0):
            covariance = np.mean((first - share) * (pixels.is_high(start + step) - share))
            expected = share * (1 - share) * math.exp(-rate * step)
            assert covariance == pytest.approx(expected, abs=5 * share * (1 - share) * 2 / math.sqrt(n))


def test_durations_of_levels_are_exponential():
    """Durations in one pixel's record at 0.25 s, complete ones only; a bin of 0.25 s, and 1 % of missed short visits,
    blur a distribution of 12 or 30 s: the Kolmogorov distance is below 3 % + 1.63/√N (1 %)."""
    pixels = telegraph(process=RandomTelegraph(0.0005, 800.0, low_s=30.0, high_s=12.0))
    times = np.arange(0.0, 3000.0, 0.25)
    levels = np.array([pixels.is_high(t) for t in times]).T
    for level, mean in ((False, 30.0), (True, 12.0)):
        lengths = []
        for record in levels:
            edges = np.flatnonzero(np.diff(record)) + 1
            runs = np.diff(edges) * 0.25
            lengths += list(runs[record[edges[:-1]] == level])
        assert len(lengths) > 2000
        distance = stats.kstest(lengths, stats.expon(scale=mean).cdf).statistic
        assert distance < 0.03 + 1.63 / math.sqrt(len(lengths))


def test_the_level_does_not_depend_on_what_was_asked_before():
    asked = [telegraph().is_high(t) for t in (5.0, 900.0, 17.0)]
    pixels = telegraph()
    for t, level in zip((900.0, 17.0, 5.0), (asked[1], asked[2], asked[0]), strict=True):
        assert np.array_equal(pixels.is_high(t), level)
    assert not np.array_equal(telegraph(seed=2).pixels, pixels.pixels)


def test_frames_show_two_levels():
    """A pixel's mean over frames at one level is its dark signal, or that and the amplitude; shot noise is Poisson."""
    detector = DetectorParameters(
        **SIZE, dark_current_e_s=200.0, telegraph=RandomTelegraph(0.01, 5000.0, 30.0, 12.0), adc_bits=None
    )
    pattern = build_fixed_pattern(detector, 4)
    ready, pixels = Detector(detector, pattern), pattern.telegraph
    assert isinstance(pixels, TelegraphPixels)
    dark = np.zeros((SIZE["height"], SIZE["width"]))
    excess = np.zeros((2, len(pixels.pixels)))
    count = np.zeros((2, len(pixels.pixels)))
    for k in range(60):
        moment = Moment(0.2, 40.0 * k)
        electrons = ready.expose(dark, moment, lambda name, k=k: stream(4, name, k)).electrons
        level = pixels.is_high(moment.t_s).astype(int)
        excess[level, np.arange(len(level))] += electrons.flat[pixels.pixels] - 40.0
        count[level, np.arange(len(level))] += 1
    low, high = excess.sum(axis=1) / count.sum(axis=1)
    assert low == pytest.approx(0.0, abs=5 * math.sqrt(40.0 / count[0].sum()))
    expected = np.average(0.2 * pixels.amplitude_e_s, weights=count[1])
    assert high == pytest.approx(expected, abs=5 * math.sqrt((40.0 + expected) / count[1].sum()))


def test_dead_pixels_do_not_switch():
    detector = DetectorParameters(**SIZE, dead_pixel_fraction=0.3, telegraph=PROCESS)
    pattern = build_fixed_pattern(detector, 5)
    assert np.all((pattern.telegraph.amplitude_e_s == 0) == pattern.dead.flat[pattern.telegraph.pixels])
