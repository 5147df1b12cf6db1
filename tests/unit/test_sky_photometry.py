"""The photometer: scaling, table, unknown colours, pickling, and what stays light to import."""

import math
import pickle
import subprocess
import sys

import numpy as np
import pytest

from simulator.optics.curves import Curve, load_curve
from simulator.sky.photometry import Photometer
from simulator.sky.spectra import B_V_RANGE, DEFAULT_B_V, SOLAR_B_V, blackbody
from startracker.errors import InputError


@pytest.fixture(scope="module")
def photometer():
    return Photometer(load_curve("glass_lens", "transmission") * load_curve("cmv4000", "quantum_efficiency"), 4.9)


def test_five_magnitudes_are_a_factor_of_hundred_and_area_is_linear(photometer):
    bright, faint = photometer.electrons_per_s([1.0, 6.0], [0.3, 0.3])
    assert bright / faint == pytest.approx(100.0, rel=1e-12)
    double = Photometer(photometer.response, 9.8).electrons_per_s(1.0, 0.3)
    assert double == pytest.approx(2 * bright, rel=1e-12)


def test_table_follows_the_integral_between_its_colours(photometer):
    colours = np.linspace(*B_V_RANGE, 2477)
    w = photometer.response.wavelength_nm
    exact = 4.9 * np.trapezoid(blackbody(w, colours) * photometer.response.value, w, axis=1)
    np.testing.assert_allclose(photometer.electrons_per_s(0.0, colours), exact, rtol=3e-5)


def test_unknown_and_extreme_colours(photometer):
    got = photometer.electrons_per_s([5.0] * 4, [math.nan, DEFAULT_B_V, -1.0, 9.0])
    assert got[0] == got[1]
    np.testing.assert_array_equal(got[2:], photometer.electrons_per_s([5.0, 5.0], B_V_RANGE))


def test_trapezoids_are_fine_enough(photometer):
    """Halving the steps moves the count of any star by less than 1e-5."""
    w = np.arange(340.0, 1050.01, 0.05)
    fine = 4.9 * np.trapezoid(blackbody(w, np.array([-0.3, 0.6, 2.0])) * photometer.response(w), w, axis=1)
    np.testing.assert_allclose(photometer.electrons_per_s(0.0, [-0.3, 0.6, 2.0]), fine, rtol=1e-5)


def test_a_flat_response_is_integrated_finely_too():
    w = np.arange(300.0, 1100.01, 0.05)
    exact = np.trapezoid(blackbody(w, np.array([0.0]))[0] * 0.5, w)
    assert Photometer(Curve.flat(0.5), 1.0).electrons_per_s(0.0, 0.0) == pytest.approx(exact, rel=1e-5)


def test_background_is_one_tenth_magnitude_star_a_square_degree(photometer):
    pixel_sr = (20.0 / 206264.80624709636) ** 2  # 20 × 20 arcsec²
    surface = 27.78  # mag arcsec⁻² of 1 S10
    star = photometer.electrons_per_s(surface - 2.5 * math.log10(75 * 400), SOLAR_B_V)
    # 27.78 is rounded from 27.7815: 0.0015 mag = 0.14 %
    assert photometer.background_e_s_pixel(75.0, pixel_sr) == pytest.approx(float(star), rel=2e-3)


def test_pickles(photometer):
    again = pickle.loads(pickle.dumps(photometer))
    np.testing.assert_array_equal(again.electrons_per_s([3.0], [1.1]), photometer.electrons_per_s([3.0], [1.1]))


def test_faults():
    with pytest.raises(InputError, match="area of an aperture must be positive; got 0"):
        Photometer(Curve.flat(1.0), 0.0)
    with pytest.raises(
        InputError, match=r"'blackbdy' is not one of the spectra: blackbody; did you mean 'blackbody'\?"
    ):
        Photometer(Curve.flat(1.0), 1.0, "blackbdy")


def test_colour_science_is_not_imported_before_it_is_used():
    code = "import sys, simulator.sky.photometry, simulator.optics.splat; sys.exit('colour' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
