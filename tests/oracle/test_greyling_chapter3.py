"""Chapter 3 of Greyling 1995 against our study of it.

Numbers are those that the thesis prints, or, of its figures and of its script, those that were found by computing them
again from its text with the Bright Star Catalogue (5th edition). Tolerances are half of the last digit given, unless a
comment says otherwise.
"""

import math

import numpy as np
import pytest
from scipy.constants import c, h

from simulator.theses.greyling1995 import density, matrix, noise, path, photometry, starlight


def rows_of(section, where):
    return [row for row in section.rows if row.where == where]


# ---------------------------------------------------------------------- 3.2
def test_the_boresight_stays_at_8_6_degrees():
    year = path.year_path()
    np.testing.assert_allclose(year.dec_date_deg, 8.600, atol=0.0005)
    assert year.ra_date_deg[0] == pytest.approx(245.0, abs=0.05)  # Ω + 90° with Ω = 155°


def test_period_and_inclination():
    by_name = {row.quantity: row for row in path.section().rows}
    assert by_name["period"].computed == "100.87 min"
    assert by_name["inclination"].verdict == "exact"


def test_only_the_corrected_matrix_is_a_rotation():
    # one element is wrong: every other one is that of the corrected matrix
    angles = np.radians([37.0, 98.6, -65.0])
    printed, corrected = (matrix.printed_matrix(*angles, corrected=flag) for flag in (False, True))
    assert matrix.departure_from_rotation(corrected) < 1e-15
    assert matrix.departure_from_rotation(printed) > 0.1
    assert np.argwhere(printed != corrected).tolist() == [[2, 0]]
    assert {row.verdict for row in rows_of(path.section(), "eq. 3.3, A.19")} == {"differs"}


def test_the_map_is_sanson_flamsteeds():
    # equal in area: the strip between two parallels has the area of the zone on the sphere, 2π (sin δ₂ − sin δ₁)
    dec = np.linspace(-30.0, 55.0, 8001)
    left, right = path.sanson_flamsteed(0.0, dec)[0], path.sanson_flamsteed(360.0, dec)[0]
    area = np.radians(1.0) ** 2 * np.trapezoid(right - left, dec)
    assert area == pytest.approx(2 * math.pi * (math.sin(math.radians(55.0)) - math.sin(math.radians(-30.0))), rel=1e-7)
    assert path.sanson_flamsteed(180.0, 40.0)[0] == 0.0


def test_galactic_plane_along_the_path():
    # the galactic pole (J2000) stands at RA 192.8595°, Dec 27.1283°: its distance from each crossing is 90°
    for ra in path.galactic_crossings_deg(8.6):
        cosine = math.sin(math.radians(8.6)) * math.sin(math.radians(27.1283)) + math.cos(math.radians(8.6)) * math.cos(
            math.radians(27.1283)
        ) * math.cos(math.radians(ra - 192.8595))
        assert cosine == pytest.approx(0.0, abs=2e-6)  # four decimals of the pole, 1e-4 deg


# ---------------------------------------------------------------------- 3.3
@pytest.mark.parametrize(
    ("limit", "window", "fewest"),
    [
        *((5.0, 10.0, 0), (6.0, 10.0, 2), (6.5, 10.0, 6), (7.0, 10.0, 6)),
        *((5.0, 12.0, 0), (6.0, 12.0, 3), (6.5, 12.0, 7), (7.0, 12.0, 8)),
    ],
)
def test_fewest_stars_along_the_path(limit, window, fewest):
    assert density.window_counts(limit, window)[1].min() == fewest


def test_densities_of_the_thesis_figures():
    ra, five = density.window_counts(5.0)
    assert len(ra) == 360
    assert np.sum(five == 0) == 17
    assert five.mean() == pytest.approx(3.17, abs=0.005)
    assert (five.max(), ra[five.argmax()]) == (9, 86.0)
    _, six = density.window_counts(6.0)
    assert ra[six == 2].tolist() == [226.0, 227.0, 228.0]
    assert six.mean() == pytest.approx(10.2, abs=0.05)
    assert six.max() == 22
    assert density.window_counts(6.5)[1].mean() == pytest.approx(16.2, abs=0.05)
    seven = density.window_counts(7.0)[1]
    assert seven.mean() == pytest.approx(17.8, abs=0.05)
    assert seven.max() == 45


def test_a_window_across_the_equinox_counts_both_sides():
    ra, dec, v = density._bright_stars()
    inside = (v <= 6.0) & (np.abs(dec - 8.6) <= 5.0)
    by_hand = np.sum(inside & (((ra + 5.0) % 360.0) <= 10.0))
    assert density.window_counts(6.0)[1][0] == by_hand
    assert by_hand > 0


def test_five_degree_steps_are_every_fifth_of_one_degree():
    for limit in (5.0, 6.0, 7.0):
        np.testing.assert_array_equal(
            density.window_counts(limit, step_deg=5.0)[1], density.window_counts(limit)[1][::5]
        )


def test_cells_hold_every_star_of_their_band():
    _, _, counts = density.cell_counts()
    _, dec, _ = density._bright_stars()
    assert counts.sum() == np.sum((dec >= -25.0) & (dec <= 40.0))
    assert counts.shape == (13, 72)


def test_verdicts_on_table_3_3():
    rows = rows_of(density.section(), "Table 3.3")
    assert [row.printed for row in rows] == ["187", "556", "1,660", "5,146", "15,095", "44,700"]
    assert [row.computed for row in rows] == [
        "174",
        "518",
        "1,630",
        "5,080",
        "9,050",
        "9,096",
    ]  # README of the catalogue
    assert [row.verdict for row in rows] == ["close"] * 4 + ["differs"] * 2


# ---------------------------------------------------------------------- 3.4
def test_output_voltage_as_coded_and_right():
    assert starlight.thesis_mv(6.5, extra_lambda=True) == pytest.approx(5.405, abs=0.0005)
    assert starlight.thesis_mv(6.5, extra_lambda=False) == pytest.approx(8.75, abs=0.005)


def test_output_voltage_by_hand():
    # five boxes Δλ = 0.1493 λ: U = 1.4 µV t A/25 Σ E λ/(hc) η Δλ; integrate() is exact for boxes
    area_cm2, seconds, flux = math.pi * 25.0, 0.2, 10 ** (-0.4 * 3.0)
    um, irradiance, efficiency = starlight.BANDS_UM, starlight.IRRADIANCE_W_CM2_UM, starlight.EFFICIENCY
    electrons = np.sum(irradiance * um * 1e-6 / (h * c) * efficiency * 0.1493 * um) * area_cm2 * seconds * flux
    got = starlight.thesis_mv(3.0, aperture_m=0.1, exposure_s=0.2, extra_lambda=False)
    assert got == pytest.approx(electrons / 25 * 1.4e-3, rel=1e-9)


def test_voltage_grows_with_area_and_time_and_a_magnitude_is_the_fifth_root_of_100():
    for law in (
        lambda v, d, t: starlight.thesis_mv(v, d, t, extra_lambda=True),
        starlight.camera_mv,
    ):
        one = law(5.0, 0.1, 0.25)
        assert law(5.0, 0.05, 0.5) == pytest.approx(one / 2, rel=1e-12)
        assert one / law(6.0, 0.1, 0.25) == pytest.approx(100 ** (1 / 5), rel=1e-12)


def test_spectrum_against_the_thesis_irradiances():
    # published to two or three digits from photometry of another kind; ours within 4 % of each
    for um, printed in zip(starlight.BANDS_UM, starlight.IRRADIANCE_W_CM2_UM, strict=True):
        nearby = np.linspace(um * 1e3 - 25.0, um * 1e3 + 25.0, 201)
        assert starlight.irradiance_w_cm2_um(nearby, 0.0, 0.0, 0.0).mean() == pytest.approx(printed, rel=0.04)


def test_illuminance_of_a_star():
    # 2.54e-6 lx of V = 0 (Allen 1973, Astrophysical Quantities: outside the atmosphere; 1 %)
    assert photometry.illuminance_lux("photopic") == pytest.approx(2.54e-6, rel=0.01)
    assert 10 ** (photometry.ZERO_LUX / 2.5) == pytest.approx(2.65e-6, abs=0.005e-6)


def test_the_lens_cannot_be_built():
    lens = [row for row in photometry.section().rows if row.printed == "an off-the-shelf lens"]
    assert [row.computed for row in lens] == ["f/0.24", "f/0.15"]
    assert all(row.verdict == "differs" and "f/0.5" in row.why for row in lens)


def test_noise_budget():
    terms, measured = noise.equation_terms_e(), noise.measured_terms_e()
    assert terms["photon noise"] == 1000.0
    assert terms["reset noise"] == pytest.approx(110, abs=5)  # printed to two digits
    assert pytest.approx(1.467, abs=0.0005) == 1310 * noise.VOLT_PER_E * 1e3
    # a standard deviation over N pixels is good to 1/√(2N), N = 65,536: 0.28 %; the DSNU, a log-normal of 100 % whose
    # kurtosis is 41, to √(40/65536)/2 = 1.2 %; the dark mean to 10/100/√131072 = 0.03 %. 4 σ.
    assert measured["photon noise"] == pytest.approx(1000.0, rel=4 * 0.0028)
    assert measured["dark signal"] == pytest.approx(100.0, rel=4 * 0.0003)
    assert measured["DSNU"] == pytest.approx(100.0, rel=4 * 0.012)
    assert measured["reset noise"] == pytest.approx(terms["reset noise"], rel=4 * 0.0028)
    squares = 1000.0**2 + 100.0 + 100.0**2 + terms["reset noise"] ** 2
    assert measured["together"] == pytest.approx(math.sqrt(squares), rel=4 * 0.0028)


def test_all_noise_in_one_frame_adds_in_squares():
    # 1,000 electrons of light, so that each term tells. The variance of N pixels is good to √(m₄ − m₂²)/√N: DSNU
    # 100⁴ × 40, the rest, normal, 2 × 13,936²; together 259 of 23,936, the standard deviation to 0.54 %. 4 σ.
    squares = 1000.0 + 100.0 + 100.0**2 + noise.equation_terms_e()["reset noise"] ** 2
    assert noise.measured_terms_e(1000.0)["together"] == pytest.approx(math.sqrt(squares), rel=4 * 0.0054)


@pytest.mark.parametrize(
    ("printed", "unit"),
    [("49.54", "dB"), ("1541.7", ""), ("63.76", "dB"), ("7708.5", ""), ("13", ""), ("1.5", "mV"), ("253440", "bits")],
)
def test_noise_numbers_come_out_to_every_printed_digit(printed, unit):
    text = f"{printed} {unit}".strip()
    rows = [row for row in noise.section().rows if row.printed == text]
    assert any(row.verdict == "exact" for row in rows)
    number = float(rows[0].computed.split()[0])
    assert number == pytest.approx(float(printed), abs=0.5 * 10.0 ** -len(printed.partition(".")[2]))


def test_bits_of_the_converter():
    assert noise.faint_star_dn(13) >= 5 > noise.faint_star_dn(12)
