"""The shipped sequence under its rules of operation: each rule acts, and the sensor comes out of it."""

import json

import numpy as np
import pytest

from simulator import Scenario
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.sequence.run import run_sequence
from startracker.errors import InputError

pytestmark = pytest.mark.system

OVERRIDES = [
    "sequence.step_s=2",
    "sequence.frames=112",
    "tracker.centroider=moment",  # the fits take long on the streaks
    "sequence.dropouts=[{start_s: 30, duration_s: 2}]",
]


@pytest.fixture(scope="module")
def operated(tmp_path_factory):
    scenario = Scenario.load("operation", overrides=OVERRIDES)
    return run_sequence(scenario, out=tmp_path_factory.mktemp("operated"))


def test_over_exposed_frames_are_discarded_and_the_exposure_shortened(operated):
    columns = operated.columns
    first = columns["exposure_s"][0]
    assert columns["status"][:2].tolist() == ["discarded", "discarded"]
    assert columns["exposure_s"][:3] == pytest.approx([first, first / 2, first / 4])
    assert columns["status"][2] == "solved"
    assert (columns["saturated_px"][:2] > 4).all()
    assert "saturated pixels, more than 4" in columns["reason"][0]
    # and longer again, once the bright stars have left the field
    assert columns["exposure_s"][60:100].max() == pytest.approx(first)


def test_the_moon_is_cleared_and_the_frame_solved(operated):
    columns = operated.columns
    moon = columns["rule"] == "moon"
    assert moon.sum() >= 8
    assert (columns["status"][moon] == "solved").all()
    assert (columns["cleared_px"][moon] > 150).all()
    assert (columns["bodies_in_field"][moon] >= 1).all()


def test_the_sun_suspends_the_sensor_until_it_has_passed(operated):
    columns = operated.columns
    suspended = np.flatnonzero(columns["status"] == "suspended")
    assert len(suspended) >= 10
    assert np.ptp(suspended) == len(suspended) - 1  # all at once
    assert ((columns["rule"] == "sun") == (columns["status"] == "suspended")).all()
    taken = np.isfinite(columns["render_ms"][suspended])
    assert 0 < taken.sum() <= len(suspended)
    assert all("Sun" in names for names in columns["excluded"][suspended][taken])
    assert (columns["mode"][suspended] == "coasting").all()
    after = columns["status"][suspended[-1] + 1 :]
    assert (after == "solved").mean() > 0.9
    assert operated.summary["wrong"] == 0
    assert operated.summary["stars_misidentified"] == 0


def test_no_frame_is_taken_while_suspended():
    """The first frame shows the Sun, the rate is not known: none is taken for the longest suspension, 60 s."""
    scenario = Scenario.load(
        "operation",
        overrides=[
            "pointing.target=Sun",
            "sequence.frames=20",
            "sequence.step_s=0.25",
            "sequence.slew.turn_deg=[0,0,0]",
            "sequence.rates=[{at_s: 0, roll_deg_s: 0.4}]",
        ],
    )
    runner = SequenceRunner(scenario)
    rows = [frame.row for frame in runner.frames()]
    taken = [row["index"] for row in rows if np.isfinite(row["render_ms"])]
    assert taken == [0]
    assert {row["status"] for row in rows} == {"suspended"}


def test_blemishes_are_mapped_from_successive_frames(operated):
    columns, found = operated.columns, operated.summary["operation"]["blemishes"]
    assert columns["blemished_px"][0] == 0
    assert found["certain"] > 30
    assert found["certain_mapped"] >= 0.9 * found["certain"]
    assert found["sound_mapped"] == 0
    assert found["mapped"] == columns["blemished_px"][-1]


def test_magnitudes_leave_the_error_of_the_colour(operated):
    """Silicon sees red stars brighter than V does: the slope is that of the photometer over the same colours."""
    magnitudes = operated.summary["operation"]["magnitudes"]
    assert magnitudes["stars"] > 1000
    runner = SequenceRunner(operated.scenario)
    b_v = np.array([0.0, 1.5])
    rate = runner.renderer.focal_plane.photometer.electrons_per_s(np.zeros(2), b_v)
    expected = -2.5 * np.log10(rate[1] / rate[0]) / 1.5
    assert expected < -0.1
    assert magnitudes["colour_slope"] == pytest.approx(expected, abs=0.08)
    assert magnitudes["std_without_colour"] < magnitudes["rms"]


def test_dropouts_are_no_rule(operated):
    columns = operated.columns
    assert columns["status"][15] == "no_frame"
    assert columns["rule"][15] == ""


def test_files_tell_of_the_rules(operated):
    summary = json.loads((operated.folder / "sequence.json").read_text())
    assert summary["operation"]["discarded"] >= 2
    assert summary["unsolved_by_status"]["suspended"] * 2.0 == summary["operation"]["suspended_s"]
    page = (operated.folder / "sequence.html").read_text()
    assert "Rules of operation" in page
    assert "Moon: cleared" in page


def test_without_the_rules_nothing_changes():
    """The same frames as if there were none: the keys are there, and off."""
    plain = run_sequence(Scenario.load("operation", overrides=["sequence.operation.use=false", "sequence.frames=2"]))
    assert "rule" not in plain.columns
    assert "operation" not in plain.summary
    assert "discarded" not in plain.columns["status"]


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("lengthen_below=0.7", "endless cycle"),
        ("shortest_exposure_s=3", "longer than detector.exposure_s"),
        ("exposure_step_s=1", "longer than detector.exposure_s"),
    ],
)
def test_contradictions_are_told(override, words):
    with pytest.raises(InputError, match=words):
        Scenario.load("operation", overrides=[f"sequence.operation.{override}"])
