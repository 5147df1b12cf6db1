"""Columns of a trial that say where and how it was: against astropy, the orbit's own elements, and closed formulas."""

import math

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord

from simulator.scenario import Scenario
from simulator.scene import SceneBuilder
from simulator.study.trials.trial import (
    TrialRunner,
    argument_of_latitude_deg,
    galactic_latitude_deg,
    normalised_error_squared,
)
from startracker.attitude import Attitude

SMALL = ("detector.width=256", "detector.height=256", "optics.focal_length_mm=12", "optics.aperture_mm=8.5")


@pytest.mark.parametrize(("ra", "dec"), [(10.0, 41.0), (266.4, -28.9), (192.86, 27.13), (12.9, -27.1)])
def test_galactic_latitude_as_astropys(ra, dec):
    theirs = SkyCoord(ra * u.deg, dec * u.deg, frame="icrs").galactic.b.deg
    # both take the pole of the Hipparcos catalogue; astropy's FK5 pole differs by 0.02″
    assert galactic_latitude_deg(Attitude.from_radec_roll(ra, dec, 12.0)) == pytest.approx(theirs, abs=1e-4)


@pytest.mark.parametrize("start_deg", [0.0, 30.0, 200.0, 359.0])
def test_argument_of_latitude_is_the_elements_own(start_deg):
    scenario = Scenario.load("sunsat", overrides=[f"orbit.argument_of_latitude_deg={start_deg}"])
    orbit = SceneBuilder(scenario).orbit
    for share in (0.0, 0.25, 1.6):
        found = argument_of_latitude_deg(orbit, share * orbit.period_s)
        off = (found - start_deg - 360.0 * share + 180.0) % 360.0 - 180.0
        assert off == pytest.approx(0.0, abs=1e-6)


def test_normalised_error_of_known_numbers():
    covariance = np.diag(np.radians([1e-4, 2e-4, 5e-3]) ** 2)
    assert normalised_error_squared(np.array([2e-4, -2e-4, 5e-3]), covariance) == pytest.approx(4 + 1 + 1)
    assert math.isnan(normalised_error_squared(np.array([np.nan, 0.0, 0.0]), covariance))
    assert math.isnan(normalised_error_squared(np.ones(3), None))


def test_a_trial_has_its_bound_and_place():
    row = TrialRunner(Scenario.load("cubesat", overrides=SMALL)).run(0)
    assert row["status"] == "solved"
    for axis in ("cross_x", "cross_y", "about_boresight"):
        # an error beyond six of its bounds in a field of few stars would be no noise: 1e-9 for a normal one
        assert abs(row[f"error_{axis}_deg"]) < 6 * row[f"bound_{axis}_deg"]
        # what the tracker believes is no better than what is possible (its noise is measured: 15 %), nor twice as bad
        assert 0.85 < row[f"sigma_{axis}_deg"] / row[f"bound_{axis}_deg"] < 2.0
    assert 0.0 <= row["orbit_argument_deg"] < 360.0
    assert row["temperature_c"] == 20.0
    assert 0.0 < row["limit_mag"] <= 6.5


def test_no_stars_no_bound():
    row = TrialRunner(Scenario.load("cubesat", overrides=[*SMALL, "sky.magnitude_limit=-1", "sky.planets=false"])).run(
        0
    )
    assert row["status"] != "solved"
    assert math.isnan(row["bound_cross_x_deg"])
    assert math.isnan(row["nees"])
    assert math.isnan(row["limit_mag"])
