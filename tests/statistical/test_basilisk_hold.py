"""The example in which a spacecraft of Basilisk holds its attitude on rendered star images alone.

The camera has no fixed pattern here: on a fixed attitude the errors of the same pixels are the same in every frame,
which the theory of the loop, with independent errors of frames, does not describe.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("Basilisk", reason="needs the package bsk (extra basilisk)")
pytestmark = pytest.mark.slow

EXAMPLES = str(Path(__file__).parents[2] / "examples" / "live")
sys.path.insert(0, EXAMPLES)
import basilisk_hold  # noqa: E402
from basilisk_hold import ARCSEC, SCENARIO, fly, steady  # noqa: E402

sys.path.remove(EXAMPLES)

from simulator import Scenario  # noqa: E402

WHITE = Scenario.load(SCENARIO).changed(
    {
        "detector.prnu": 0.0,
        "detector.dsnu": 0.0,
        "detector.hot_pixel_fraction": 0.0,
        "tracker.centroid.flat_field_error": 0.0,
    }
)
SECONDS, SETTLED_S = 700.0, 400.0
CHANCE = 1e-4


@pytest.fixture(scope="module")
def flights():
    return fly(WHITE, SECONDS), fly(WHITE, SECONDS, ideal=True)


def test_every_frame_is_solved_and_none_wrong(flights):
    rows = [m.row for m in flights[0].measurements]
    assert len(rows) == 2 * SECONDS + 1
    assert {row["status"] for row in rows} == {"solved"}
    assert not any(row["wrong"] for row in rows)
    assert rows[0]["mode"] == "lost_in_space"


def test_it_holds_within_the_stated_error(flights):
    """The mean square of the pointing error over 5 minutes, by the discrete Lyapunov equation of the loop with the
    error of a frame that the tracker states: limits at 1e-4 either side of each axis."""
    found = steady(WHITE, flights[0], SETTLED_S)
    theory, frames = found.expected, len(found.pointing_rad)
    ratio = np.mean(found.pointing_rad**2, axis=0) / theory.pointing.diagonal()
    low, high = theory.pointing_limits(frames, CHANCE)
    assert (low < ratio).all(), (low, ratio)
    assert (ratio < high).all(), (ratio, high)
    assert (np.sqrt(np.diag(theory.pointing)) < np.sqrt(np.diag(theory.of_frame))).all()
    assert (high < 3.0).all()  # the limits mean something


def test_the_tracker_knows_its_error(flights):
    """NEES by the covariance that the tracker states, which does not know of the torques."""
    found = steady(WHITE, flights[0], SETTLED_S)
    ratio = found.nees.mean() / found.expected.nees
    low, high = found.expected.nees_limits(len(found.nees), CHANCE)
    assert low < ratio < high
    assert 2.0 < found.expected.nees < 3.5
    stated = np.mean([m.covariance[:3, :3] for m in flights[0].measurements if m.t_s >= SETTLED_S], axis=0)
    to_body = basilisk_hold.mounting_of(WHITE.pointing).inverse.as_matrix()
    # the errors of frames scatter by some per cent, of which the filter averages ten
    np.testing.assert_allclose(np.diag(to_body @ stated @ to_body.T), np.diag(found.expected.stated), rtol=0.02)


def test_ideal_navigation_leaves_no_error(flights):
    """What remains is the end of the acquisition, e^(−0.027 t): below a tenth of a standard deviation of the other."""
    ideal = flights[1].pointing_rad[flights[1].t_s >= SETTLED_S]
    expected = np.sqrt(np.diag(steady(WHITE, flights[0], SETTLED_S).expected.pointing))
    assert (np.sqrt(np.mean(ideal**2, axis=0)) < 0.1 * expected).all()
    assert np.abs(ideal[-1]).max() < 0.01 * ARCSEC
