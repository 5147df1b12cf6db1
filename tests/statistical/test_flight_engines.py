"""Both engines of a scenario on the same frames: the C is as good as the reference (`benchmarks.engines`)."""

import math

import pytest

from benchmarks.engines import CASES, compared, run_engines
from benchmarks.flight import ALLOWED, LIMITS
from simulator.study.exported_c.targets import HOST

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine (Debian: gcc)"),
]
FRAMES = 100
LONG_TRAILS = "`gallery/smear`, over 36 px"
"""Not within the limits (docs/flight.md): of the faintest trails the flight build finds fewer."""


@pytest.fixture(scope="module", params=[name for name in CASES if name != LONG_TRAILS])
def engines(request):
    return run_engines(request.param, list(LIMITS), FRAMES)


@pytest.mark.parametrize("arithmetic", list(LIMITS))
def test_the_flight_build_agrees_with_the_reference(engines, arithmetic):
    result = compared(engines[arithmetic], engines["reference"])
    assert result.misidentified == 0
    # at most one status in a hundred differs: the number in N frames has a standard deviation of sqrt(0.01 N)
    differing = round((1.0 - result.agreement) * FRAMES)
    assert differing <= ALLOWED * FRAMES + 3.0 * math.sqrt(ALLOWED * FRAMES)
    assert result.ratio <= LIMITS[arithmetic]


def test_covariances_are_as_consistent_as_those_of_the_reference(engines):
    """The mean NEES is at most that of the reference plus three standard errors, sqrt(6 / N) for 3 degrees of
    freedom, times the reference's mean over 3: errors that no tracker knows are in both."""
    reference = engines["reference"].nees
    margin = 3.0 * math.sqrt(6.0 / FRAMES) * max(reference / 3.0, 1.0)
    for arithmetic in LIMITS:
        assert engines[arithmetic].nees <= reference + margin


def test_the_arithmetics_agree(engines):
    """Attitudes in single precision and in integers differ by a hundredth of their errors."""
    assert compared(engines["float"], engines["fixed"]).ratio == pytest.approx(1.0, abs=0.01)
    assert [row["status"] for row in engines["float"].rows] == [row["status"] for row in engines["fixed"].rows]


def test_attitudes_of_long_trails_are_within_their_covariances():
    """Trails of 36 px: the same statuses, and no error beyond 5 sigma of what is stated."""
    engines = run_engines(LONG_TRAILS, ["fixed"], FRAMES)
    result = compared(engines["fixed"], engines["reference"])
    assert result.agreement >= 1.0 - ALLOWED
    assert result.misidentified <= engines["reference"].misidentified
    assert not any(row["inconsistent"] for row in engines["fixed"].rows)
