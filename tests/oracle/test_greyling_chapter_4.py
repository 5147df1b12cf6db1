"""Chapter 4 of Greyling 1995 against its print.

Values that come out exactly are held to their printed digits; the others to formulas of their own: sums in NumPy and
SciPy's Bessel functions, which share nothing with the study. Statistical tolerances are derived beside each.
"""

import math

import numpy as np
import pytest
from scipy.special import j1

from simulator.theses.greyling1995.blur import CRITERIA, airy_bias, airy_pattern, best_sigma, sigma_of_bias, spread
from simulator.theses.greyling1995.blur import section as blur_section
from simulator.theses.greyling1995.centre import lower_equal_peaks, matlab_rand, noise_errors, smeared_frames
from simulator.theses.greyling1995.centre import smear_errors as centre_smear_errors
from simulator.theses.greyling1995.centroiding import section as centroiding_section
from simulator.theses.greyling1995.segmentation import mars_diameters_arcsec, success_rate, thesis_settings
from simulator.theses.greyling1995.segmentation import section as segmentation_section
from simulator.theses.greyling1995.star_images import (
    OFFSETS,
    distortion_errors,
    moments,
    smear_errors,
    smear_path,
    star_stamps,
    tracker_errors,
)
from simulator.theses.printed import compare
from simulator.theses.tables import exact_when_cut
from startracker.centroid.bias import moment_bias


def verdicts(section):
    return {(row.where, row.quantity): row.verdict for row in section.rows}


@pytest.fixture(scope="module")
def blur():
    return blur_section()


@pytest.fixture(scope="module")
def centroids():
    return centroiding_section(seeds=50)


def test_digits_cut_off():
    def verdict(printed, computed):
        return exact_when_cut(compare("", "", printed, computed), printed, computed).verdict

    assert verdict("0.010284", 0.0102847) == "exact"
    assert verdict("0.010284", 0.0102851) == "close"
    assert verdict("0.010284", 0.0102834) == "close"
    assert verdict("1.89", 1.8954) == "exact"
    assert verdict("1.89", 1.9) == "close"


def test_airy_pattern_is_that_of_the_bessel_function():
    x = np.linspace(0.05, 12.0, 200)
    np.testing.assert_allclose(airy_pattern(x), (2 * j1(x) / x) ** 2, rtol=1e-12)
    assert airy_pattern(0.0) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize(
    ("criterion", "sigma"),
    [("range of the error (max − min)", 1.34985), ("largest absolute error", 1.3246), ("rms error", 1.336)],
)
def test_best_sigma_by_brute_force(criterion, sigma):
    assert best_sigma(CRITERIA[criterion]) == pytest.approx(sigma, abs=5e-5)
    x = 0.1 * np.arange(1, 51)
    grid = np.arange(1.30, 1.40, 1e-4)
    errors = np.exp(-(x**2) / (2 * grid[:, None] ** 2)) - (2 * j1(x) / x) ** 2
    measure = {
        "range of the error (max − min)": np.ptp(errors, axis=1),
        "largest absolute error": np.abs(errors).max(axis=1),
        "rms error": (errors**2).sum(axis=1),
    }[criterion]
    assert grid[np.argmin(measure)] == pytest.approx(best_sigma(CRITERIA[criterion]), abs=1.01e-4)


def test_sigma_whose_bias_is_the_airy_patterns():
    assert round(sigma_of_bias(), 2) == 1.23
    grid = np.arange(1.20, 1.26, 1e-3)
    i, offsets = np.arange(-2, 3), np.arange(11) * 0.05
    weight = np.exp(-((i - offsets[:, None]) ** 2) / (2 * grid[:, None, None] ** 2))
    bias = offsets - (weight * i).sum(axis=2) / weight.sum(axis=2)
    misfit = ((bias - airy_bias(offsets)) ** 2).sum(axis=1)
    assert grid[np.argmin(misfit)] == pytest.approx(sigma_of_bias(), abs=1.01e-3)
    assert airy_bias([0.5])[0] == pytest.approx(0.10855, abs=1e-3)  # "near perfect match"


def test_share_of_the_nine_pixels():
    i = np.arange(-2, 3)
    line = np.exp(-(i**2) / (2 * 1.23**2))
    image = spread(1.23)
    assert image[1:4, 1:4].sum() / image.sum() == pytest.approx((line[1:4].sum() / line.sum()) ** 2, rel=1e-12)


def test_verdicts_of_the_stellar_image(blur):
    by = {row.quantity: row for row in blur.rows}
    exact = [quantity for quantity, row in by.items() if row.verdict == "exact"]
    assert "diameter of the Airy disk, f/1.4, 555 nm" in exact
    assert "σ whose centroid bias is the Airy pattern's" in exact
    assert by["σ of the Gaussian closest to the Airy pattern"].computed == "1.34985"
    assert by["largest relative error in the central region"].verdict == "differs"
    assert by["fraction of the central 3 × 3 in the 5 × 5 pixels"].computed.startswith("67.3 %")


def test_moment_of_the_kernel_is_the_plain_sum():
    stamps = star_stamps(OFFSETS, 1.1, 1.4)
    i = np.arange(-2, 3)
    plain = (stamps * i).sum(axis=(1, 2)) / stamps.sum(axis=(1, 2))
    np.testing.assert_allclose(moments(stamps), plain, atol=2e-7)  # single precision of an image


def test_table_4_1_and_4_2_come_out_as_printed(centroids):
    rows = [row for row in centroids.rows if row.where == "Table 4.1"]
    assert len(rows) == 11
    assert {row.verdict for row in rows} == {"exact"}
    table = [row for row in centroids.rows if row.where == "Table 4.2"]
    assert [row.verdict for row in table].count("exact") == 7
    (misprint,) = [row for row in table if row.verdict == "differs"]
    assert (misprint.printed, misprint.computed) == ("0.025°", "0.00250°")


def test_the_generator_is_park_and_millers():
    # their check: from 1 the 10,000th is 1,043,618,065; and the sequence that Matlab 4's manual shows for rand
    assert round(matlab_rand(1, 10_000)[0, -1] * (2**31 - 1)) == 1_043_618_065
    shown = [0.2190, 0.0470, 0.6789, 0.6793, 0.9347, 0.3835, 0.5194, 0.8310, 0.0346, 0.0535]
    state = round(0.21895918632809 * (2**31 - 1))
    np.testing.assert_allclose(matlab_rand(state, 9)[0], shown[1:], atol=5.1e-5)


def test_noise_of_the_listing_line_by_line():
    """`centre.m`: n = 0.1*(rand(11) - 0.05), the matrix filled by columns, seed 5 before the first offset."""
    state, largest = 5, []
    clean, noisy = [], []
    for offset in np.arange(51) * 0.01:
        noise = np.empty((11, 11))
        for column in range(11):
            for row in range(11):
                state = 16807 * state % (2**31 - 1)
                noise[row, column] = 0.1 * (state / (2**31 - 1) - 0.05)
        star = np.zeros((11, 11))
        for x in range(-2, 3):
            for y in range(-2, 3):
                star[5 + y, 5 + x] = 10 * math.exp(-((x - offset) ** 2 + y**2) / (2 * 1.325**2))
        for image, out in ((star, clean), (star + noise, noisy)):
            peak = np.argmax(image.max(axis=0))
            window = image[3:8, peak - 2 : peak + 3]
            out.append(peak - 5 + float((window * np.arange(-2, 3)).sum() / window.sum()))
    errors, wrong = noise_errors(40.0)
    np.testing.assert_allclose(errors[0], np.array(clean) - np.array(noisy), atol=1e-12)
    largest = np.abs(errors[~wrong]).max()
    assert largest == pytest.approx(0.0080, abs=5e-5)
    assert np.flatnonzero(wrong[0]).tolist() == [50]  # half a pixel: two equal ones


def test_noise_rows_are_compared_with_the_seed_of_the_listing(centroids):
    rows = [row for row in centroids.rows if row.where == "Fig. 4.10"]
    assert [row.printed for row in rows] == ["0.0063 L", "0.088 L"]
    assert all("seed 5" in row.quantity and "centre.m" in row.why for row in rows)
    assert not any("unprinted seed" in row.why for row in centroids.rows)


def test_noise_error_has_the_variance_of_a_first_moment():
    """Uniform noise of range A: var(m) = A²/12 Σ (i − m)² / S², first order, about the mean that its mean makes. 200
    seeds of 30 offsets: 1/√(2·6000) = 0.9 % of the standard deviation, 4σ are 3.7 %; second order 1e-4."""
    offsets = np.arange(30) * 0.01
    errors, wrong = noise_errors(40.0, np.arange(1, 201), 1.23, offsets)
    assert not wrong.any()
    i = np.arange(-2, 3)
    x = np.exp(-0.5 * ((i - offsets[:, None]) / 1.23) ** 2)
    total = x.sum(axis=1) * np.exp(-0.5 * (i / 1.23) ** 2).sum()
    mean = (x * i).sum(axis=1) / x.sum(axis=1)
    expected = 0.01 / math.sqrt(12.0) * np.sqrt((5 * (i - mean[:, None]) ** 2).sum(axis=1)) / total
    shift = 25 * 0.0045 * mean / (total + 25 * 0.0045)  # a mean of 0.45 A pulls the moment to the middle
    spread = np.sqrt(np.mean(((errors - shift) / expected) ** 2))
    assert spread == pytest.approx(1.0, rel=0.04)


def test_spikes_are_those_of_the_other_of_two_equal_pixels():
    path = smear_path(4.0, 37.0)
    frame = smeared_frames(path, np.array([0.5]), 1.23)[0]
    assert frame[5, 5] == pytest.approx(frame[5, 6], rel=1e-12)  # symmetric about the star's centre
    right, other = centre_smear_errors(path), centre_smear_errors(path, other_of_equal=True)
    np.testing.assert_array_equal(right[:10], other[:10])
    # windows mirrored about the star: the errors before the bias is taken off are each other's negatives
    bias = moment_bias(0.5, 1.23, 5, integrated=False)
    assert other[10] + bias == pytest.approx(-(right[10] + bias), abs=1e-9)


def test_of_equal_peaks_one_stays():
    frame = np.array([[1.0, 9.0, 9.0], [2.0, 9.0, 3.0]])
    np.testing.assert_array_equal(lower_equal_peaks(frame, 2), [[1.0, 9.0, 7.0], [2.0, 7.0, 3.0]])
    assert frame[0, 2] == 9.0


def test_smear_is_that_of_a_long_sum():
    t = (np.arange(20_000) + 0.5) / 20_000 - 0.5
    i = np.arange(-2, 3)
    rate, angle, offset = 8.0, math.radians(30.0), 0.35
    x = offset + rate * 0.5 * math.cos(angle) * t
    y = rate * 0.5 * math.sin(angle) * t
    image = np.einsum(
        "ti,tj->ji", np.exp(-((i - x[:, None]) ** 2) / (2 * 1.23**2)), np.exp(-((i - y[:, None]) ** 2) / (2 * 1.23**2))
    )
    still = np.exp(-((i - offset) ** 2) / (2 * 1.23**2))
    error = (still * i).sum() / still.sum() - (image * i).sum() / image.sum()
    assert smear_errors(rate, 30.0)[7] == pytest.approx(error, abs=2e-5)  # nodes: 1e-4 of the peak at the most
    assert smear_errors(rate, 90.0) == pytest.approx(np.zeros(11), abs=1e-6)


def test_distortion_of_20_per_cent_costs_nearly_0_09():
    assert round(float(distortion_errors(0.8)[-1]), 2) == 0.09
    # the printed claim that 50 % stays below 0.1 L does not hold
    assert np.abs(distortion_errors(0.5)).max() > 0.2


def test_our_tracker_has_no_bias_and_does_not_mind_distortion():
    assert np.abs(tracker_errors()).max() < 1e-6
    assert np.abs(tracker_errors(1.23 / 0.8, 1.23)).max() < 1e-6
    assert len(tracker_errors()) == 81
    assert np.abs(tracker_errors(snr_db=20.0)).max() > 0.05


@pytest.mark.parametrize("rule", ["first", "brightest"])
def test_region_growing_deteriorates_below_30_db(rule):
    assert success_rate(40.0, 3, rule=rule).clean == 1.0
    assert success_rate(25.0, 3, rule=rule).clean == 0.0


def test_the_trackers_own_settings_bear_more_noise():
    assert success_rate(25.0, 3, rule="tracker").clean == 1.0


def test_alien_objects_are_told_from_stars():
    odd = success_rate(60.0, 5, aliens=True)
    assert (odd.clean, odd.false_objects) == (1.0, 0.0)


def test_thesis_limits():
    settings = thesis_settings(5.0)
    assert (settings.min_pixels, settings.max_pixels, settings.search_step_px) == (7, 36, 3)


def test_mars_is_seconds_of_arc_across():
    # Meeus, Astronomical Algorithms, ch. 55: semidiameter 4.68″ at 1 au; nearest in 2003 at 0.3727 au, 25.1″
    least, most = mars_diameters_arcsec()
    assert most == pytest.approx(2 * 4.68 / 0.3727, rel=2e-3)
    assert 3.4 < least < 3.6


def test_verdicts_of_region_growing():
    section = segmentation_section(frames=5)
    assert verdicts(section)["§ 4.2.1", "pixels searched, 512 × 512"] == "exact"
    # the threshold is not printed: near 30 dB with the one assumed, but no agreement
    (knee,) = [row for row in section.rows if row.printed == "30 dB"]
    assert knee.verdict == "input missing"
    assert {row.verdict for row in section.rows if row.printed == "100 %"} == {"input missing"}
    assert all(row.computed.startswith("100 %") for row in section.rows if row.printed == "100 %")
    assert float(knee.computed.split()[2]) == pytest.approx(30.0, abs=3.0)


def test_figures_of_chapter_4_draw(blur, centroids):
    for made in (blur, centroids, segmentation_section(frames=1)):
        assert made.figures
        for name in made.figures:
            figure = made.figure(name)
            assert any(ax.get_xlabel() for ax in figure.axes)
            assert any(ax.get_ylabel() for ax in figure.axes)
