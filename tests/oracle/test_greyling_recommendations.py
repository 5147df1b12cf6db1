"""What Greyling 1995 recommends, built: planet or star, identification from raw pixels, equal pixels; and the review.

Formulas of Gaussian detection theory and of the first moment's error are held against draws of noise.
"""

import math

import numpy as np
import pytest

from simulator.theses.greyling1995 import recommendations as r
from simulator.theses.greyling1995.review import CASES, review
from startracker.detection.sensitivity import correct_sensitivity, sensitivity_map
from startracker.errors import InputError
from startracker.identification import METHODS


def test_a_disk_widens_the_star_by_a_sixteenth_of_its_diameter_squared():
    # the variance of an even disk of diameter d along one axis is d²/16; of a stamp wide enough to hold all of it
    i = np.arange(-2, 3.0)
    for diameter in (0.2, 0.4):
        narrow = 0.65  # 3.8 σ to the edge of the 5 × 5; sampling adds exp(−2π²σ²) = 2e-4 of a pixel² at most
        star, disk = (r.disk_stamp(d, 0.0, narrow) for d in (0.0, diameter))
        widths = [(stamp * i**2).sum() / stamp.sum() for stamp in (star, disk)]
        assert widths[1] - widths[0] == pytest.approx(diameter**2 / 16, rel=0.05)
        assert disk.sum() == pytest.approx(star.sum(), rel=1e-3)  # the same light


def planet_score(stamp, noise):
    """Correlation with the signature of a disk, in standard deviations of the noise."""
    direction = r._direction(0.5, r.THESIS_SIGMA, sigma_known=True)
    return (stamp * direction).sum() / (noise * np.linalg.norm(direction))


def test_the_score_is_standard_normal_for_stars_whatever_their_unknowns():
    rng = np.random.default_rng(5)
    noise = 10 ** (-50 / 20)
    scores = []
    for _ in range(2000):
        star = rng.uniform(0.6, 1.0) * r.disk_stamp(0.0, rng.uniform(-0.02, 0.02)) + rng.uniform(0.0, 0.5)
        scores.append(planet_score(star + noise * rng.standard_normal((5, 5)), noise))
    # 2000 draws: 4σ are 4/√2000 = 0.09 of the mean and 4/√4000 = 0.063 of the standard deviation; a shift of 0.02 px
    # leaves, in second order, less than 0.03
    assert np.mean(scores) == pytest.approx(0.0, abs=0.12)
    assert np.std(scores) == pytest.approx(1.0, rel=0.063)


@pytest.mark.parametrize("diameter", [0.5, 0.9])
def test_detectability_is_what_draws_give(diameter):
    snr_db = 50.0
    rng = np.random.default_rng(7)
    noise = 10 ** (-snr_db / 20)
    planet = r.disk_stamp(diameter)
    limit = 2.3263  # 1 % of a normal distribution
    found = np.mean([planet_score(planet + noise * rng.standard_normal((5, 5)), noise) > limit for _ in range(1500)])
    expected = r.planet_detectability(diameter, snr_db)
    assert 0.05 < expected < 0.99
    # binomial, 4σ; the score takes the direction of a disk of half a pixel, which is that of any small one to 1 %
    assert found == pytest.approx(expected, abs=4 * math.sqrt(expected * (1 - expected) / 1500) + 0.02)


def test_least_snr_is_where_the_share_is_reached():
    for known in (True, False):
        snr = r.least_snr_db(0.71, 0.99, sigma_known=known)
        assert r.planet_detectability(0.71, snr, sigma_known=known) == pytest.approx(0.99, abs=1e-6)
    # d' grows as the square of the diameter: half of it needs 12 dB more
    assert r.least_snr_db(0.2) - r.least_snr_db(0.4) == pytest.approx(40 * math.log10(2), abs=0.1)


def test_raw_pixels_identify_the_same_frames():
    orders = r.raw_pixels_first(6)
    first, raw = orders["centroids first"], orders["raw pixels first"]
    assert (raw.solved, raw.wrong) == (6, 0)
    assert (first.solved, first.wrong) == (6, 0)
    assert raw.centroids <= first.centroids == 8
    # both measure with the same centroids: a third of an arc second of 70″ a pixel, not half a pixel
    assert np.median(raw.errors_arcsec) < 2.0


def test_error_by_unequal_pixels():
    rng = np.random.default_rng(11)
    stamp = r.star_stamps([0.3], 1.23, integrated=True)[0]
    i = np.arange(-2, 3)
    moments = []
    for _ in range(4000):
        uneven = stamp * (1 + 0.03 * rng.standard_normal((5, 5)))
        moments.append((uneven * i).sum() / uneven.sum())
    # 4000 draws: 1/√8000 = 1.1 %, 4σ; second order 0.03² / 10
    assert np.std(moments) == pytest.approx(r.prnu_error_px(0.03, 1.23, 0.3), rel=0.046)


def test_sensitivities_are_measured_and_corrected():
    rng = np.random.default_rng(3)
    gain = 1 + 0.03 * rng.standard_normal((40, 50))
    dark = 100.0
    flats = rng.poisson(40_000 * gain, (16, 40, 50)) + dark
    found = sensitivity_map(flats, dark)
    # 1/√(16 · 40,000) = 0.00125; 2000 pixels: 4σ of the standard deviation are 6.4 %
    assert np.std(found - gain / gain.mean()) == pytest.approx(0.00125, rel=0.064)
    image = 500.0 * gain + dark
    corrected = correct_sensitivity(image, gain / gain.mean(), dark)
    np.testing.assert_allclose(corrected, 500.0 * gain.mean() + dark, rtol=1e-6)


def test_dead_pixels_become_nan_and_wrong_input_is_said():
    gain = np.ones((4, 4))
    gain[1, 2] = 0.0
    corrected = correct_sensitivity(np.full((4, 4), 7.0), gain)
    assert np.isnan(corrected[1, 2])
    assert np.isfinite(corrected).sum() == 15
    with pytest.raises(InputError, match=r"\(4, 4\) but the map of sensitivities \(3, 3\)"):
        correct_sensitivity(np.ones((4, 4)), np.ones((3, 3)))
    with pytest.raises(InputError, match="must be brighter"):
        sensitivity_map(np.full((2, 4, 4), 5.0), 5.0)


def test_every_fast_identifier_in_every_case():
    names = ("adaptive", "pyramid", "pattern_hash")
    found = review(1, names)
    assert set(found) == {(name, case) for name in names for case in CASES}
    for result in found.values():
        assert result.wrong == 0
        assert result.fields == 6
        assert 0.0 < result.time_ms < 1000.0
    assert all(found[name, "lost in space"].right == 6 for name in names)
    assert set(names) < set(METHODS)
