"""Photometry against published figures.

Sources: Bessell, Castelli & Plez 1998 (A&A 333, 231, table A2: photon fluxes of an A0V star of V = 0); Bessell 1990
(passbands); Ballesteros 2012 (EPL 97, 34008); Liebe 2002 (IEEE AES 38, 587: 19,100 e⁻ s⁻¹ mm⁻²); Leinert et al. 1998
(A&AS 127, 1: 1 S10 = 27.78 mag arcsec⁻²); Greyling 1995 (Stellenbosch, § 3.4 and appendix B).
"""

import math

import numpy as np
import pytest
from scipy.constants import c, h, k

from simulator.optics.curves import Curve, load_curve
from simulator.sky.photometry import Photometer
from simulator.sky.spectra import blackbody, temperature_k

PUBLISHED = {"b": (1393.0, 438.0), "v": (995.5, 545.0), "r": (702.0, 641.0), "i": (452.0, 798.0)}
"""Photons cm⁻² s⁻¹ Å⁻¹ at the effective wavelength (nm), A0V, V = 0."""

W = np.arange(300.0, 1100.0, 0.25)


def band_photons(photons, name):
    """Mean energy flux over the passband, in photons cm⁻² s⁻¹ Å⁻¹ of the effective wavelength."""
    effective = PUBLISHED[name][1]
    passband = load_curve(f"bessell_{name}", "passband")(W)
    return np.trapezoid(photons / W * passband, W) / np.trapezoid(passband, W) * effective / 10.0


@pytest.mark.parametrize("b_v", [-0.3, 0.0, 0.65, 1.6, math.nan])
def test_v_is_the_published_zero_point_for_every_colour(b_v):
    # exact by construction but for the grid of this integral
    assert band_photons(blackbody(W, np.array([b_v]))[0], "v") == pytest.approx(995.5, rel=1e-6)


def test_photons_at_the_effective_wavelength_of_v():
    """An A0V star has 995.5 there; a black body of the same mean is within 2 %, its slope over the passband."""
    assert blackbody(np.array([545.0]), np.array([0.0]))[0, 0] / 10.0 == pytest.approx(995.5, rel=0.02)


@pytest.mark.parametrize(("name", "off"), [("b", -0.12), ("r", 0.11), ("i", 0.22)])
def test_how_far_a_black_body_is_off_in_the_other_bands(name, off):
    """Not an agreement but the honest size of the error that `blackbody` states: a black body is not an A0 star."""
    ratio = band_photons(blackbody(W, np.array([0.0]))[0], name) / PUBLISHED[name][0]
    assert ratio - 1.0 == pytest.approx(off, abs=0.01)


def test_shape_is_plancks_law():
    """Against the formula with scipy's CODATA constants (colour-science's own c₂ is rounded and 6e-5 off)."""
    t = float(temperature_k(0.65))
    photons = blackbody(W, np.array([0.65]))[0]
    exact = W**-4 / np.expm1(h * c / (W * 1e-9 * k * t))
    np.testing.assert_allclose(photons / photons[1000], exact / exact[1000], rtol=1e-9)


@pytest.mark.parametrize(("b_v", "kelvin"), [(0.65, 5778), (0.0, 10125), (1.85, 3200)])
def test_temperatures_of_ballesteros(b_v, kelvin):
    """The Sun (B−V 0.65, 5778 K), Vega's and Betelgeuse's colours, within the 5 % that the relation is good to."""
    assert temperature_k(b_v) == pytest.approx(kelvin, rel=0.05)


def test_order_of_magnitude_of_liebe():
    """19,100 e⁻ s⁻¹ mm⁻² of a V = 0 star (Liebe 2002, G2 spectrum, a silicon detector of his time): within 25 %."""
    response = load_curve("glass_lens", "transmission") * load_curve("cmv4000", "quantum_efficiency")
    assert Photometer(response, 0.01).electrons_per_s(0.0, 0.65) == pytest.approx(19100, rel=0.25)


def test_surface_brightness_of_one_s10():
    """A pixel of one square arcsecond under 1 S10 gets what a star of V = 27.78 gives (rounded: 0.0015 mag)."""
    photometer = Photometer(Curve.flat(0.5), 100.0)
    got = photometer.background_e_s_pixel(1.0, (math.pi / 648000) ** 2)
    magnitude = -2.5 * math.log10(got / photometer.electrons_per_s(0.0, 0.653, 0.0))
    assert magnitude == pytest.approx(27.78, abs=0.005)


# ---------------------------------------------------------------- Greyling 1995
BANDS_UM = np.array([0.44, 0.55, 0.64, 0.79, 1.25])
IRRADIANCE_W_CM2_UM = np.array([6.6, 3.6, 2.25, 1.22, 0.292]) * 1e-12
QE = np.array([0.2, 0.4, 0.5, 0.38, 0.05])
PHOTONS_NM = IRRADIANCE_W_CM2_UM * 1e-3 * BANDS_UM * 1e-6 / (h * c)
"""Photons cm⁻² s⁻¹ nm⁻¹ of V = 0 in his five bands."""

AREA_CM2, EXPOSURE_S, PIXELS, UV_PER_E = math.pi * 36.0, 0.5, 25, 1.12
WIDTHS_UM = np.array([0.1, 0.55 - 0.44, 0.64 - 0.55, 0.79 - 0.64, 1.25 - 0.79])


def electrons(photons, response):
    product = photons * response
    return np.trapezoid(product.value, product.wavelength_nm)


def millivolts(electrons_cm2_s, v_mag=6.5):
    return electrons_cm2_s * AREA_CM2 * EXPOSURE_S * 10 ** (-0.4 * v_mag) / PIXELS * UV_PER_E * 1e-3


def test_voltage_of_the_thesis_camera():
    """V = 6.5, 0.5 s, 12 cm, 25 pixels: 8.75 mV with the right physics, 5.405 mV with one λ (µm) too many.

    The widths of the five bands and the gain are those of `ccdmag.m` in appendix B. The sum is checked here through
    the product of two curves, with each band a box in the photons and the efficiency a constant in it.
    """
    total = with_extra_lambda = 0.0
    for um, width, photons, qe in zip(BANDS_UM, WIDTHS_UM, PHOTONS_NM, QE, strict=True):
        edges = 1e3 * (um + width * np.array([-0.5, 0.5]))
        of_band = electrons(Curve(edges, np.full(2, photons)), Curve([300.0, 1700.0], [qe, qe]))
        total += of_band
        with_extra_lambda += of_band * um
    listing = h * c / (6.626e-34 * 3e8)  # its constants, of four digits, and one
    assert millivolts(total) * listing == pytest.approx(8.75, abs=0.0005)
    assert millivolts(with_extra_lambda) * listing == pytest.approx(5.405, abs=0.0005)


def test_integral_of_two_straight_lines_is_exact():
    """∫ of the product of his curves, both straight between the bands, against Simpson's rule (exact for parabolas)."""
    photons, response = Curve(BANDS_UM * 1e3, PHOTONS_NM), Curve(BANDS_UM * 1e3, QE)
    exact = 0.0
    for i in range(4):
        n, q = PHOTONS_NM[i : i + 2], QE[i : i + 2]
        middle = n.mean() * q.mean()
        exact += (BANDS_UM[i + 1] - BANDS_UM[i]) * 1e3 / 6 * (n[0] * q[0] + 4 * middle + n[1] * q[1])
    assert electrons(photons, response) == pytest.approx(exact, rel=1e-5)


def test_our_spectrum_gives_the_thesis_camera_the_same_order():
    """An A0 star and the shipped TC211 curve, no losses in the lens: within a factor 1.6 of 8.75 mV."""
    response = Curve.flat(1.0) * load_curve("tc211", "quantum_efficiency")
    got = millivolts(float(Photometer(response, 1.0).electrons_per_s(0.0, 0.0)))
    assert 8.75 / 1.6 < got < 8.75 * 1.6
