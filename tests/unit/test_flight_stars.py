"""Stars between the stages of a flight build: the format, its limits and its rounding."""

import numpy as np
import pytest

from startracker.errors import InputError
from startracker.flight.stars import SATURATED, StarList

pytestmark = pytest.mark.system


def test_round_trip_within_half_a_unit():
    rng = np.random.default_rng(4)
    xy, flux, variance = rng.uniform(-50, 4100, (40, 2)), rng.uniform(0, 1e6, 40), rng.uniform(1e-5, 4.0, 40)
    stars = StarList.of(xy, flux, variance, np.full(40, SATURATED))
    assert np.abs(stars.xy_px - xy).max() <= 0.5 / 2**16
    assert np.abs(stars.flux_dn - flux).max() <= 0.5 / 2**4
    assert np.abs(stars.variance_px2 - variance).max() <= 0.5 / 2**26
    assert (stars.take([3, 1]).x == stars.x[[3, 1]]).all()
    assert (stars.flags == SATURATED).all()


def test_ends_of_the_formats():
    stars = StarList.of([[0.0, -0.5]], [1e12], [1e9])
    assert (stars.flux[0], stars.variance[0], stars.flags[0]) == (2**31 - 1, 2**32 - 1, 0)
    assert StarList.of([[0.0, 0.0]], [-3.0], [0.0])[2:4] == (0, 1)
    assert len(StarList.of([], [], []).x) == 0


@pytest.mark.parametrize(
    "bad", [([[np.nan, 0.0]], [1.0], [1.0]), ([[4e4, 0.0]], [1.0], [1.0]), ([[0.0, 0.0]], [np.inf], [1.0])]
)
def test_what_no_star_has(bad):
    with pytest.raises(InputError, match="finite numbers"):
        StarList.of(*bad)
