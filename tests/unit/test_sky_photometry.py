"""The photometer: scaling, table, unknown colours, pickling, and what stays light to import."""

import math
import pickle
import subprocess
import sys

import numpy as np
import pytest

from simulator.constants import DEFAULT_B_V
from simulator.optics.curves import Curve, load_curve
from simulator.sky.photometry import Photometer
from simulator.sky.spectra import B_V_RANGE, LATE_GIANT, SOLAR_B_V, SPECTRA, colour_sequence
from startracker.errors import InputError


@pytest.fixture(scope="module")
def photometer():
    return Photometer(load_curve("glass_lens", "transmission") * load_curve("cmv4000", "quantum_efficiency"), 4.9)


def test_five_magnitudes_are_a_factor_of_hundred_and_area_is_linear(photometer):
    bright, faint = photometer.electrons_per_s([1.0, 6.0], [0.3, 0.3])
    assert bright / faint == pytest.approx(100.0, rel=1e-12)
    double = Photometer(photometer.response, 9.8).electrons_per_s(1.0, 0.3)
    assert double == pytest.approx(2 * bright, rel=1e-12)


@pytest.mark.parametrize("giant", [0.0, 1.0, 0.3])
@pytest.mark.parametrize("spectrum", ["colour_sequence", "blackbody"])
def test_table_follows_the_integral_between_its_colours(photometer, spectrum, giant):
    colours = np.linspace(*B_V_RANGE, 1477)
    w = photometer.response.wavelength_nm
    photons = SPECTRA[spectrum](w, colours, np.full(len(colours), giant))
    exact = 4.9 * np.trapezoid(photons * photometer.response.value, w, axis=1)
    table = Photometer(photometer.response, 4.9, spectrum)
    np.testing.assert_allclose(table.electrons_per_s(0.0, colours, giant), exact, rtol=1e-4)


def test_table_follows_the_integral_between_late_giants(photometer):
    subtype = np.linspace(*LATE_GIANT, 777)
    w = photometer.response.wavelength_nm
    exact = 4.9 * np.trapezoid(colour_sequence(w, np.full(777, 1.6), subtype) * photometer.response.value, w, axis=1)
    np.testing.assert_allclose(photometer.electrons_per_s(0.0, 1.6, subtype), exact, rtol=1e-4)


def test_unknown_class_counts_as_the_population(photometer):
    """Halfway between dwarfs and giants by the share at that B−V; red stars are giants, blue ones dwarfs."""
    red, blue, between = photometer.electrons_per_s(5.0, [1.56, 0.3, 0.85])
    assert red == photometer.electrons_per_s(5.0, 1.56, 1.0)
    assert blue == photometer.electrons_per_s(5.0, 0.3, 0.0)
    dwarf, giant = photometer.electrons_per_s(5.0, 0.85, [0.0, 1.0])
    assert between == pytest.approx(0.22 * dwarf + 0.78 * giant, rel=1e-12)


def test_bins_share_out_all_electrons(photometer):
    b_v, edges = np.array([-0.2, 0.65, 1.5, math.nan]), [450.0, 550.0, 633.3, 700.0, 900.0]
    weights = photometer.bin_weights(b_v, edges)
    assert weights.shape == (4, 4)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-12)
    w = np.arange(340.0, 1100.01, 0.02)  # a fine sum with each of its points in one bin
    photons = colour_sequence(w, np.array([0.65]), 0.27)[0] * photometer.response(w)
    member = np.searchsorted(edges[1:-1], w)
    expected = [photons[member == k].sum() / photons.sum() for k in range(4)]
    np.testing.assert_allclose(photometer.bin_weights([0.65], edges, [0.27])[0], expected, atol=3e-5)


def test_mean_wavelength_is_that_of_the_bins(photometer):
    edges = np.arange(340.0, 1101.0, 2.0)
    weights = photometer.bin_weights([0.0, 1.5], edges)
    # the mean inside a bin lies within a tenth of a nanometre of its middle
    middle = (edges[1:] + edges[:-1]) / 2
    np.testing.assert_allclose(photometer.effective_wavelength_nm([0.0, 1.5]), weights @ middle, atol=0.1)


def test_redder_stars_have_longer_waves(photometer):
    for giant in (0.0, 1.0, None):
        assert (np.diff(photometer.effective_wavelength_nm(np.linspace(-0.3, 3.0, 100), giant)) > 0).all()


def test_unknown_and_extreme_colours(photometer):
    got = photometer.electrons_per_s([5.0] * 4, [math.nan, DEFAULT_B_V, -1.0, 9.0])
    assert got[0] == got[1]
    np.testing.assert_array_equal(got[2:], photometer.electrons_per_s([5.0, 5.0], B_V_RANGE))


@pytest.mark.parametrize(("spectrum", "error"), [("colour_sequence", 1e-4), ("blackbody", 1e-5)])
def test_trapezoids_are_fine_enough(photometer, spectrum, error):
    """Finer steps hardly move the count of any star; lines and bands cost more than a smooth curve."""
    w = np.arange(340.0, 1050.01, 0.05)
    b_v = np.array([-0.3, 0.6, 2.0])
    fine = 4.9 * np.trapezoid(SPECTRA[spectrum](w, b_v, np.zeros(3)) * photometer.response(w), w, axis=1)
    table = Photometer(photometer.response, 4.9, spectrum)
    np.testing.assert_allclose(table.electrons_per_s(0.0, b_v, 0.0), fine, rtol=error)


def test_a_flat_response_is_integrated_finely_too():
    w = np.arange(300.0, 1100.01, 0.05)
    exact = np.trapezoid(colour_sequence(w, np.array([0.0]))[0] * 0.5, w)
    assert Photometer(Curve.flat(0.5), 1.0).electrons_per_s(0.0, 0.0, 0.0) == pytest.approx(exact, rel=1e-4)


def test_background_is_one_tenth_magnitude_star_a_square_degree(photometer):
    pixel_sr = (20.0 / 206264.80624709636) ** 2  # 20 × 20 arcsec²
    surface = 27.78  # mag arcsec⁻² of 1 S10
    star = photometer.electrons_per_s(surface - 2.5 * math.log10(75 * 400), SOLAR_B_V, 0.0)
    # 27.78 is rounded from 27.7815: 0.0015 mag = 0.14 %
    assert photometer.background_e_s_pixel(75.0, pixel_sr) == pytest.approx(float(star), rel=2e-3)


def test_pickles(photometer):
    again = pickle.loads(pickle.dumps(photometer))
    np.testing.assert_array_equal(again.electrons_per_s([3.0], [1.1]), photometer.electrons_per_s([3.0], [1.1]))


def test_faults():
    with pytest.raises(InputError, match="area of an aperture must be positive; got 0"):
        Photometer(Curve.flat(1.0), 0.0)
    with pytest.raises(
        InputError, match=r"'blackbdy' is not one of the spectra: .*blackbody.*; did you mean 'blackbody'\?"
    ):
        Photometer(Curve.flat(1.0), 1.0, "blackbdy")


@pytest.mark.parametrize("edges", [[500.0], [500.0, 400.0], [[1.0, 2.0]]])
def test_edges_must_rise(photometer, edges):
    with pytest.raises(InputError, match="at least two ascending edges"):
        photometer.bin_weights([0.5], edges)


def test_colour_science_is_not_imported_before_it_is_used():
    code = "import sys, simulator.sky.photometry, simulator.optics.splat; sys.exit('colour' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
