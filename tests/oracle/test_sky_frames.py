"""Ecliptic and galactic frames against ERFA."""

import erfa
import numpy as np
import pytest

from simulator.sky.celestial_frames import ECLIPTIC, GALACTIC, equator_of


def test_the_galactic_frame_is_that_of_erfa():
    """``icrs2g``; 1e-12: both take the matrix of the Hipparcos catalogue, to 16 digits."""
    for l_rad, b_rad in ((0.3, 0.2), (2.0, -1.1), (5.5, 1.3)):
        ra, dec = erfa.g2icrs(l_rad, b_rad)
        found = GALACTIC @ erfa.s2c(ra, dec)
        assert found == pytest.approx(erfa.s2c(l_rad, b_rad), abs=1e-12)
    assert GALACTIC @ GALACTIC.T == pytest.approx(np.eye(3), abs=1e-14)


def test_the_ecliptic_frame_is_that_of_erfa():
    """``ecm06`` at J2000, which contains the frame bias of 0.02″, 1e-7 rad."""
    assert ECLIPTIC == pytest.approx(erfa.ecm06(2451545.0, 0.0), abs=1.2e-7)
    assert ECLIPTIC @ ECLIPTIC.T == pytest.approx(np.eye(3), abs=1e-15)


def test_an_equator_is_a_closed_circle_through_the_axes():
    for frame in (ECLIPTIC, GALACTIC):
        circle = equator_of(frame, 5)
        assert circle == pytest.approx(np.array([frame[0], frame[1], -frame[0], -frame[1], frame[0]]), abs=1e-15)
    assert equator_of(ECLIPTIC).shape == (721, 3)
