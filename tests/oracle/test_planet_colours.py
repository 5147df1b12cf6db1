"""Moon and planets shine by sunlight times their albedo: colours against published ones, electrons against a plain sum.

Published: B−V and V−Rc of the planets from their magnitudes, Mallama, Krobusek & Pavlov 2017 (Icarus 282, 19), table 3;
of the Moon B−V and U−B, Lane & Irvine 1973 (AJ 78, 267). Albedos are means over bands and the lines between them are
straight, so 0.06 mag. With the spectra of dwarfs of the same B−V, V−Rc of Uranus was +0.33 and Jupiter 20 % too bright.
"""

import numpy as np
import pytest

from simulator.optics.curves import Curve
from simulator.sky.albedo import body_photons
from simulator.sky.library import synthetic_colours
from simulator.sky.photometry import Photometer
from simulator.sky.spectra import V0_PHOTONS_S_CM2_NM, V_EFFECTIVE_NM, V_GRID_NM, mean_v

NM = np.arange(300.0, 1150.0, 1.0)
PUBLISHED = {  # B−V, V−Rc
    "Mercury": (0.97, 0.52),
    "Venus": (0.70, 0.35),
    "Mars": (1.36, 0.82),
    "Jupiter": (0.86, 0.35),
    "Uranus": (0.50, -0.27),
    "Neptune": (0.39, -0.33),
    "Sun": (0.653, 0.352),
}


def colours(name):
    return synthetic_colours(NM, body_photons(NM, name, "colour_sequence") / NM)


@pytest.mark.parametrize("name", PUBLISHED)
def test_colours_of_planets(name):
    _, b_v, v_r, _ = colours(name)
    assert (b_v, v_r) == pytest.approx(PUBLISHED[name], abs=0.06)


def test_saturn_and_the_moon():
    # of Saturn table 3 has B−V 1.07 and, synthesised, V−Rc 0.51; its photometric R is 0.17 mag fainter
    _, b_v, v_r, _ = colours("Saturn")
    assert b_v == pytest.approx(1.07, abs=0.06)
    assert 0.34 - 0.06 < v_r < 0.68
    u_b, b_v, *_ = colours("Moon")
    assert (u_b, b_v) == pytest.approx((0.46, 0.92), abs=0.08)


@pytest.mark.parametrize("name", [*PUBLISHED, "Saturn", "Moon"])
def test_every_body_has_the_v_of_its_magnitude(name):
    for family in ("colour_sequence", "blackbody"):
        photons = body_photons(V_GRID_NM, name, family)[None]
        assert mean_v(V_GRID_NM, photons)[0] == pytest.approx(V0_PHOTONS_S_CM2_NM / V_EFFECTIVE_NM, rel=2e-3)


def test_electrons_are_the_plain_sum_and_fewer_than_of_a_dwarf_of_that_colour():
    silicon = Curve(np.array([350.0, 450.0, 600.0, 750.0, 900.0, 1050.0]), np.array([0.1, 0.5, 0.6, 0.5, 0.25, 0.02]))
    photometer = Photometer(silicon, 4.9)
    fine = np.arange(350.0, 1050.01, 0.1)
    for name, b_v, least, most in (
        ("Jupiter", 0.83, 1.1, 1.35),
        ("Uranus", 0.56, 1.4, 2.0),
        ("Venus", 0.82, 1.03, 1.25),
        ("Moon", 0.92, 0.9, 1.05),
    ):
        plain = (
            np.trapezoid(body_photons(fine, name, "colour_sequence") * silicon(fine), fine) * 4.9 * 10 ** (-0.4 * 2.5)
        )
        (found,) = photometer.body_electrons_per_s(np.array([name]), np.array([2.5]))
        assert found == pytest.approx(plain, rel=1e-3)
        assert least < photometer.electrons_per_s(2.5, b_v, 0.0) / found < most, name
