"""Chapter 3 of Greyling 1995 against our study of it.

Numbers are those that the thesis prints, or, of its figures and of its script, those that were found by computing them
again from its text with the Bright Star Catalogue (5th edition). Tolerances are half of the last digit given, unless a
comment says otherwise.
"""

import math

import numpy as np
import pytest

from simulator.theses.greyling1995 import density, noise, path, photometry, starlight


def rows_of(section, where):
    return [row for row in section.rows if row.where == where]


# ---------------------------------------------------------------------- 3.2
def test_the_boresight_stays_at_8_6_degrees():
    year = path.year_path()
    np.testing.assert_allclose(year.dec_date_deg, 8.600, atol=0.0005)
    assert year.ra_date_deg[0] == pytest.approx(245.0, abs=0.05)  # Ω + 90° with Ω = 155°


def test_the_sun_angle_is_that_of_the_listing():
    # bs_path.m: Sun_Angle = 30; the boresight is 90° + 30° behind the Sun, and stays at i − 90°
    assert path.SUN_ANGLE_DEG == 30.0
    for omega, spin in ((0.0, 0.0), (0.0, 77.0), (140.0, 10.0)):
        ra, dec = path.bs_path(omega, spin, exchanged=True)
        assert (ra, dec) == pytest.approx(((240.0 + omega) % 360.0, 8.6), abs=1e-9)
    row = rows_of(path.section(), "Fig. 3.3")[0]
    assert row.printed == "120°"
    assert row.verdict == "close"  # 115° from Table 3.2's node: 4.2 %
    assert "no number" not in " ".join(r.why for r in path.section().rows)


def test_period_and_inclination():
    by_name = {row.quantity: row for row in path.section().rows}
    assert by_name["period"].computed == "100.87 min"
    assert by_name["inclination"].verdict == "exact"


def test_only_the_corrected_matrix_is_a_rotation():
    # one element is wrong: every other one is that of the corrected matrix
    angles = np.radians([37.0, 98.6, -65.0])
    printed, corrected = (path.printed_matrix(*angles, corrected=flag) for flag in (False, True))
    assert path.departure_from_rotation(corrected) < 1e-15
    assert path.departure_from_rotation(printed) > 0.1
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
    # ccdmag.m line by line: U = A_pixel t (q G / C0) A_lens / (25 A_pixel) Σ E η Δλ λ_µm / (h v), v = c / λ
    um = np.array([0.44, 0.55, 0.64, 0.79, 1.25])
    w_m2_um = np.array([6.6e-12, 3.6e-12, 2.25e-12, 1.22e-12, 2.92e-13]) * 1e4 * (100 ** (1 / 5)) ** -3.0
    width = np.array([0.1, 0.55 - 0.44, 0.64 - 0.55, 0.79 - 0.64, 1.25 - 0.79])
    eta, v = np.array([0.2, 0.4, 0.5, 0.38, 0.05]), 3e8 / (um * 1e-6)
    lens, pixel = math.pi * (0.1 / 2) ** 2, 10e-6 * 10e-6
    for extra in (True, False):
        rate = lens / (pixel * 25) * np.sum(w_m2_um * eta * width * (um if extra else 1.0) / (6.626e-34 * v))
        volts = pixel * 0.2 * (1.6e-19 * rate * 0.7) / 0.1e-12
        got = starlight.thesis_mv(3.0, aperture_m=0.1, exposure_s=0.2, extra_lambda=extra)
        assert got == pytest.approx(volts * 1e3, rel=1e-12)


def test_nothing_of_the_voltage_is_fitted():
    np.testing.assert_allclose(starlight.WIDTHS_UM, [0.10, 0.11, 0.09, 0.15, 0.46])
    assert starlight.VOLT_PER_E == pytest.approx(1.12e-6)  # q G / C0
    rows = {row.quantity: row for row in photometry.section().rows}
    assert not any("fitted" in row.why for row in rows.values())
    assert any("ccdmag.m" in row.why and "1.12 µV" in row.why for row in rows.values())


def test_second_script_of_the_listing():
    # ten pixels, 1.4 µV, other efficiencies, no surplus λ: by hand, in the listing's constants
    um = np.array([0.44, 0.55, 0.64, 0.79, 1.25])
    flux, eta = np.array([6.6e-12, 3.6e-12, 2.25e-12, 1.22e-12, 2.92e-13]), np.array([0.1, 0.28, 0.4, 0.38, 0.05])
    rate = 1e-6 * np.sum(flux * eta * np.array([0.1, 0.11, 0.09, 0.15, 0.46]) * um) / (6.626e-34 * 3e8) * 1e4
    volts = rate * math.pi * 0.05**2 * 0.5 * 1.4e-6 / 10
    assert starlight.second_script_mv(0.0, 0.1, 0.5) == pytest.approx(volts * 1e3, rel=1e-12)
    assert 100 ** (1.6 / 5) == pytest.approx(4.36, abs=0.006)  # the factor of its loop: a star of V = −1.6


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
    assert photometry.illuminance_lux() == pytest.approx(2.54e-6, rel=0.01)
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


def test_no_agreement_without_the_inputs():
    """A row that says that an input is missing, or an output not printed, is neither exact nor close."""
    sections = (path, density, photometry, noise)
    rows = [row for module in sections for row in module.section().rows]
    lacking = [row for row in rows if "not available" in row.why or "not printed" in row.why or row.printed == "–"]
    assert len(lacking) >= 5
    assert {row.verdict for row in lacking} <= {"not printed", "input missing", "open"}
