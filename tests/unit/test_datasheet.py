"""Parts of the datasheet without frames: estimates, limits, sequences, residuals of the sky's model, texts."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from scipy import stats

from simulator import Scenario
from simulator.build import sequence_motion
from simulator.mission.motion import rate_profile
from simulator.study.datasheet import frames
from simulator.study.datasheet.accuracy import normal_factor
from simulator.study.datasheet.performance import (
    ACQUIRED,
    FIRST_SHARE,
    _greatest_acceleration,
    bracket,
    exclusion,
    frames_to_acquire,
    recovery_frames,
    swinging,
)
from simulator.study.datasheet.run import stages_of
from simulator.study.datasheet.sheet import (
    Amounts,
    Estimate,
    Quantity,
    mean_of,
    proportion,
    rms_of,
    select,
    upper_limit,
)
from simulator.study.datasheet.tables import estimate_text
from startracker.geometry.attitude import Attitude

SCENARIO = Scenario.load("scenarios/sunsat.yaml")


def test_estimates_of_normal_errors_contain_the_truth() -> None:
    errors = np.random.default_rng(4).normal(0.5, 2.0, 4000)
    errors[7] = math.nan
    rms, mean = rms_of(errors), mean_of(errors)
    assert rms.low is not None
    assert rms.high is not None
    assert mean.low is not None
    assert mean.high is not None
    assert rms.low < math.hypot(0.5, 2.0) < rms.high
    assert mean.low < 0.5 < mean.high
    assert rms.value == pytest.approx(math.sqrt(np.nanmean(errors**2)), rel=1e-12)
    limit = upper_limit(errors - 0.5, 95.0)
    assert limit.low is not None
    assert limit.high is not None
    assert limit.low < 2.0 * stats.norm.ppf(0.975) < limit.high


def test_estimates_without_enough_errors_are_open() -> None:
    assert rms_of([1.0, math.nan]) == (None, None, None)
    assert upper_limit([math.nan], 95.0) == (None, None, None)
    few = upper_limit(np.arange(100.0), 99.7)
    assert few.value == 99.0
    assert few.high is None
    assert Estimate(1.0, None, 3.0).times(2.0) == (2.0, None, 6.0)
    assert Estimate(1.0, math.nan, math.inf).plain() == (1.0, None, None)


def test_a_proportion_has_the_interval_of_wilson() -> None:
    found = stats.binomtest(8, 10).proportion_ci(0.95, method="wilson")
    assert proportion([True] * 8 + [False] * 2) == pytest.approx((0.8, found.low, found.high))


def test_levels_of_a_normal_distribution() -> None:
    for level in (68.0, 95.0, 99.7):
        assert normal_factor(level) == pytest.approx(stats.norm.interval(level / 100.0)[1], rel=1e-12)


@pytest.mark.parametrize("limit", [0.013, 1.7, 2.0, 40.0])
def test_a_bracket_contains_the_limit(limit: float) -> None:
    found = bracket(lambda value: value <= limit, 2.0, 4, 90.0)
    assert found.passed is not None
    assert found.failed is not None
    assert found.passed <= limit < found.failed
    assert found.failed / found.passed == pytest.approx(2.0 ** (1 / 16))


def test_a_bracket_is_open_where_nothing_fails_or_passes() -> None:
    assert bracket(lambda value: True, 2.0, 4, 90.0) == (64.0, None)
    assert bracket(lambda value: False, 2.0, 4, 90.0)[0] is None


@pytest.mark.parametrize("share", [0.05, 0.5, 0.9, 0.99, 0.9969])
def test_frames_of_an_acquisition(share: float) -> None:
    count = frames_to_acquire(share)
    assert count is not None
    assert 1.0 - (1.0 - share) ** count >= ACQUIRED > 1.0 - (1.0 - share) ** (count - 1.0)
    assert (frames_to_acquire(1.0), frames_to_acquire(0.0), frames_to_acquire(None)) == (1.0, None, None)


def test_recovery_after_an_interruption() -> None:
    status = np.array(["solved"] * 3 + ["no_frame"] * 2 + ["unsolved", "solved", "solved", "no_frame"])
    found = {"status": status, "wrong": np.zeros(9, dtype=bool), "elapsed_s": 0.5 * np.arange(9)}
    assert recovery_frames(found, 1.5, 0.5) == 2
    assert recovery_frames(found, 4.0, 0.5) is None
    found["wrong"] = np.arange(9) == 6
    assert recovery_frames(found, 1.5, 0.5) == 3


def test_a_swinging_rate_has_its_acceleration_and_amplitude() -> None:
    jittered = swinging(SCENARIO, 0.4, 0.3, 20)
    profile = rate_profile(jittered.pointing, sequence_motion(jittered.sequence))
    times = np.linspace(0.0, 20 * jittered.sequence.step_s, 4001)
    rates = np.degrees([profile.at(t) for t in times])
    moving = rates[:, np.ptp(rates, axis=0).argmax()]
    assert np.abs(moving).max() == pytest.approx(0.3, abs=1e-3)
    slope = np.abs(np.diff(moving)) / np.diff(times)
    assert np.median(slope) == pytest.approx(0.4, rel=1e-6)


@pytest.mark.parametrize(
    ("passes", "same"),
    [
        ([{1: 0.2, 2: 90.0}, {1: 0.9, 2: 90.0}], True),
        ([{1: 0.2, 2: 90.0}, {2: 90.0}], False),
        ([{2: 90.0}, {1: -0.7, 2: 90.0}], False),
        # a faint star in the middle that noise hides in one of the passes
        ([{1: 0.2, 2: 90.0}, {1: 0.2}], True),
        ([{}, {}], True),
    ],
)
def test_stars_that_enter_or_leave_between_passes(passes: list[dict[int, float]], same: bool) -> None:
    assert frames._same_at_border(passes) is same


def test_the_rotation_of_displaced_stars() -> None:
    """Against the exact rotation of directions by an attitude; second order in the angle."""
    vectors = np.random.default_rng(1).normal(size=(12, 3)) * 0.1 + np.array([0.0, 0.0, 1.0])
    assumed = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    turn = np.array([2e-6, -1e-6, 3e-5])
    seen = Attitude.from_rotation_vector(turn, "camera", "camera").apply(assumed)
    assert frames._rotation(seen, assumed - seen) == pytest.approx(turn, abs=1e-9)


def test_residuals_of_the_model_against_the_angle_of_aberration() -> None:
    """A sky without aberration, which the tracker corrects all the same: the boresight is off by |v × b| / c. The fit
    weighs the stars of a field of 10 degrees evenly, whose mean direction is up to 2 degrees off: tan 2° = 3.5 %."""
    made = frames.DatasheetFrames(SCENARIO.changed({"sky.aberration": False, "sky.light_deflection": False}))
    found = np.radians(made.model_residuals(0, 4)["error_deg"])
    for index, error in enumerate(found):
        scene = made.renderer.scene(index)
        velocity, boresight = scene.observer.velocity_km_s, scene.pointing.camera.boresight
        assert velocity is not None
        expected = np.linalg.norm(np.cross(velocity, boresight)) / 299_792.458
        assert math.hypot(*error[:2]) == pytest.approx(expected, rel=0.035)
    same = SCENARIO.changed({"sky.light_deflection": False, "tracker.catalog": "hipparcos"})
    corrected = frames.DatasheetFrames(same).model_residuals(0, 4)
    # merged doubles and the Römer delay: below a milliarcsecond. Another catalogue has other parallaxes
    assert np.nanmax(np.abs(corrected["error_deg"][:, :2])) * 3600.0 < 1e-3


def test_values_in_json_have_intervals() -> None:
    quantity = Quantity("a", "A", Estimate(1.0, 0.5, None), "arcsec", "cross_x", 99.7, "mixed", "counted")
    found = json.loads(json.dumps(quantity.to_dict()))
    assert found["interval"] == [0.5, None]
    assert found["confidence"] == 0.95
    assert found["level"] == 99.7
    assert "axis" not in Quantity("b", "B", Estimate(None)).to_dict()
    assert select([quantity], "a", "cross_x", 99.7) is quantity
    assert select([quantity], "a", "cross_x") is None


@pytest.mark.parametrize(
    ("size", "unit", "percent", "text"),
    [
        (Estimate(0.1234, 0.1, 0.2), "arcsec", False, "0.123″ (0.100–0.200)"),
        (Estimate(1234.0, None, None), "s", False, "1234 s"),
        (Estimate(1.0, 0.97, 1.0), "", True, "100 % (97–100)"),
        (Estimate(5.0, 4.0, None), "deg/s", False, "5.00°/s (≥ 4.00)"),
        (Estimate(0.0, 0.0, 0.0), "arcsec", False, "0″ (exact)"),
        (Estimate(0.00415, -0.00767, 0.0112), "arcsec", False, "0.0042″ (−0.0077 to 0.0112)"),
        (Estimate(4.5e-5, 2.4e-6, 7.4e-5), "arcsec", False, "0.0450 mas (0.0024–0.0740)"),
        (Estimate(None), "s", False, "not determined"),
    ],
)
def test_texts_of_estimates(size: Estimate, unit: str, percent: bool, text: str) -> None:
    assert estimate_text(size, unit, percent) == text


def test_stages_of_life() -> None:
    assert [life for life, _ in stages_of(SCENARIO)] == ["BOL"]
    warm = SCENARIO.changed({"detector.temperature_c": 40.0})
    assert [life for life, _ in stages_of(SCENARIO, warm)] == ["BOL", "EOL"]
    aged = SCENARIO.changed({"environment.age_years": 5.0, "environment.solar_proton_events": 1.0})
    stages = stages_of(aged)
    assert [(life, stage.environment.age_years) for life, stage in stages] == [("BOL", 0.0), ("EOL", 5.0)]


@pytest.mark.parametrize("angle_deg", [1.0, 35.0, 90.0, 170.0])
def test_a_boresight_at_an_angle_from_a_body(angle_deg: float) -> None:
    direction = np.array([0.6, -0.48, 0.64])
    around = [frames._at_angle(direction, math.radians(angle_deg), azimuth) for azimuth in (0.0, 2.0, 4.0)]
    cosines = np.array(around) @ direction
    assert cosines == pytest.approx(np.full(3, math.cos(math.radians(angle_deg))), abs=1e-12)
    assert np.linalg.norm(np.mean(around, axis=0)) < 1.0 - 1e-6


class Answers:
    """A task runner that knows the limits of a camera instead of running frames."""

    def __init__(self, *, angles_deg: dict[str, float] | None = None, acceleration_deg_s2: float = 0.0) -> None:
        self.angles_deg, self.acceleration_deg_s2, self.accelerations = angles_deg, acceleration_deg_s2, []

    def run(self, tasks):
        return [self._answer(task) for task in tasks]

    def _answer(self, task):
        if task.method == "near_body":
            _, count, body, angle_deg = task.arguments
            return {"right": np.full(count, angle_deg >= self.angles_deg[body])}
        times = [point.at_s for point in task.scenario.sequence.rates]
        # the rate rises from 0 to the swing within the first quarter
        values = [max(point.roll_deg_s, point.pitch_deg_s, point.yaw_deg_s) for point in task.scenario.sequence.rates]
        acceleration = max(values) / times[1]
        self.accelerations.append(acceleration)
        solved = "solved" if acceleration <= self.acceleration_deg_s2 else "no_match"
        return {"status": np.full(40, solved), "wrong": np.zeros(40, dtype=bool)}


AMOUNTS = Amounts(*[20] * len(dataclasses.fields(Amounts)))


def test_exclusion_angles_are_those_at_which_frames_are_solved() -> None:
    """20 bisections of the logarithm leave a bracket of 1e-6: the angle that passed is the camera's."""
    angles = {"sun": 34.0, "earth": 21.0, "moon": 5.5}
    scenario = SCENARIO.changed({"optics.baffle.pst": "vane", "sky.planets": True})
    found = {quantity.name: quantity.estimate for quantity in exclusion(scenario, Answers(angles_deg=angles), AMOUNTS)}
    for body, angle_deg in angles.items():
        size = found[f"smallest_angle_{body}"]
        assert size.value == pytest.approx(angle_deg, rel=1e-5), body
        assert size.low <= angle_deg <= size.value == size.high
        assert size.low == pytest.approx(angle_deg, rel=1e-5)


@pytest.mark.parametrize("rate_deg_s", [None, 4.0])
def test_the_acceleration_begins_with_a_share_of_the_greatest_that_frames_can_follow(rate_deg_s: float | None) -> None:
    """The rate swings by half the greatest rate, 0.5°/s where none is known, within one interval at most."""
    runner = Answers(acceleration_deg_s2=0.08)
    highest = (0.5 if rate_deg_s is None else 0.5 * rate_deg_s) / SCENARIO.sequence.step_s
    found = _greatest_acceleration(SCENARIO, runner, AMOUNTS, rate_deg_s)
    assert runner.accelerations[0] == pytest.approx(FIRST_SHARE * highest, rel=1e-12)
    assert found.estimate.value == pytest.approx(0.08, rel=1e-5)


def test_the_half_width_needs_both_ends() -> None:
    assert Estimate(2.0, 1.5, 3.0).half_width == 0.75
    for size in (Estimate(2.0), Estimate(2.0, 1.5), Estimate(2.0, None, 3.0)):
        assert size.half_width is None
    assert Estimate(2.0, None, 3.0).times(2.0) == (4.0, None, 6.0)
