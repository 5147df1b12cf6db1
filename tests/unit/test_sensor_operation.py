"""The rules of operation one by one, on made frames."""

import math

import numpy as np
import pytest

from startracker.detection.defect_map import BadPixelCount
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.settings import DetectionSettings, OperationSettings
from startracker.solution import MatchedStars
from startracker.tracking.operation import SensorOperation, Verdict, image_magnitudes, saturated_near

CAMERA = Camera.from_fov(fov_deg=10.0, width=128, height=96)
FULL = 1000.0


def frame(*stars, seed=0, level=50.0):
    """Gaussian stars (x, y, peak) of σ = 1 px, cut off at 1,000 DN, with noise of 3 DN."""
    y, x = np.indices((96, 128))
    image = np.random.default_rng(seed).normal(level, 3.0, (96, 128))
    for at_x, at_y, peak in stars:
        image += peak * np.exp(-((x - at_x) ** 2 + (y - at_y) ** 2) / 2.0)
    return np.minimum(image, FULL)


def rules(exposure_s=0.4, **changes):
    return SensorOperation(OperationSettings(use=True, **changes), DetectionSettings(), CAMERA, exposure_s)


BRIGHT, MEDIUM, FAINT = 20_000.0, 2_000.0, 100.0  # saturated over 19, 5 and 0 pixels


def test_two_over_exposed_stars_shorten_the_exposure():
    operation = rules()
    verdict = operation.judge(frame((30, 40, BRIGHT), (80, 60, BRIGHT)), 0.0, FULL)
    assert verdict.rule == "exposure"
    assert verdict.image is None
    assert min(verdict.saturated_px) > 4
    assert operation.exposure_s == 0.2
    assert "next exposure 0.2 s instead of 0.4 s" in verdict.reason


@pytest.mark.parametrize("second", [FAINT, 1_200.0])
def test_one_over_exposed_star_is_let_be(second):
    """The second star has none, or up to four saturated pixels."""
    operation = rules()
    verdict = operation.judge(frame((30, 40, BRIGHT), (80, 60, second)), 0.0, FULL)
    assert verdict.rule == ""
    assert verdict.saturated_px[0] > 4
    assert all(n <= 4 for n in verdict.saturated_px[1:])
    assert operation.exposure_s == 0.4


def test_the_loop_settles():
    """Peaks go with the exposure: shortened until at most four pixels of the second star saturate, and no further."""
    operation = rules(lengthen_below=0.2)
    used = []
    for k in range(8):
        used.append(operation.exposure_s)
        scale = operation.exposure_s / 0.4
        operation.judge(frame((30, 40, 20_000 * scale), (80, 60, 9_000 * scale), seed=k), float(k), FULL)
    assert used[:5] == pytest.approx([0.4, 0.2, 0.1, 0.05, 0.05])
    assert len(set(used[4:])) == 1


def test_faint_stars_lengthen_it_again():
    operation = rules()
    operation.exposure_s = 0.1
    operation.judge(frame((30, 40, 300.0)), 0.0, FULL)  # 0.3 of saturation: left alone
    assert operation.exposure_s == 0.1
    for k, expected in enumerate((0.2, 0.4, 0.4)):
        operation.judge(frame((30, 40, FAINT), seed=k), 0.0, FULL)
        assert operation.exposure_s == pytest.approx(expected)
    operation.exposure_s = 0.1
    hot = frame((30, 40, FAINT))
    hot[10, 10] = FULL - 1  # a hot pixel is not a star
    operation.judge(hot, 0.0, FULL)
    assert operation.exposure_s == 0.2


def test_exposures_are_multiples_of_the_frame_time():
    operation = rules(exposure_s=0.1, exposure_step_s=0.017, shortest_exposure_s=0.03)
    assert operation.exposure_s == pytest.approx(5 * 0.017)
    bright = [frame((30, 40, BRIGHT), (80, 60, BRIGHT), seed=k) for k in range(4)]
    exposures = []
    for k in range(3):
        operation.judge(bright[k], 0.0, FULL)
        exposures.append(operation.exposure_s)
    assert exposures == pytest.approx([2 * 0.017] * 3)
    verdict = operation.judge(bright[3], 0.0, FULL)  # no shorter one: used as it is
    assert verdict.rule == ""
    assert verdict.image is not None


def test_the_sun_suspends_until_the_camera_has_turned():
    operation = rules(suspend_turn_deg=0.6, longest_suspension_s=60.0)
    sun = frame()
    sun[20:60, 30:70] = FULL  # 13 % of the pixels
    rate = np.radians([0.0, 0.3, 0.4])  # 0.5°/s
    verdict = operation.judge(sun, 10.0, FULL, rate)
    assert verdict.rule == "sun"
    assert verdict.image is None
    assert "13.0 %" in verdict.reason
    assert operation.suspended(11.1)
    assert not operation.suspended(11.3)
    operation.judge(sun, 20.0, FULL)  # a rate that is not known
    assert operation.suspended(79.0)
    assert not operation.suspended(80.5)
    assert not operation.suspended(-5.0)  # a clock that was set back does not suspend it until it has caught up


def test_the_moon_is_cleared_by_its_size():
    y, x = np.indices((96, 128))
    image = frame((30, 40, 400.0))
    image[(x - 90) ** 2 + (y - 50) ** 2 < 81] = FULL
    operation = rules(clear_pixels=100, sun_share=0.05)
    verdict = operation.judge(image, 0.0, FULL)
    assert verdict.rule == "moon"
    assert operation.exposure_s == 0.4
    assert np.isnan(verdict.image[50, 90])
    assert np.isnan(verdict.image[50, 100])  # with a margin
    assert np.isfinite(verdict.image[40, 30])
    assert 249 < verdict.cleared_px < 420
    assert rules(clear_pixels=1000, sun_share=0.05).judge(image, 0.0, FULL).rule == ""


def test_what_touches_the_border_is_no_star():
    image = frame((30, 40, BRIGHT))
    image[0:6, 60:66] = FULL
    assert rules().judge(image, 0.0, FULL).rule == ""


def turned(degrees):
    return Attitude.from_radec_roll(degrees, 0.0, 0.0)


def test_blemishes_stay_while_stars_move():
    operation = rules(blemish_frames=4, blemish_shift_px=6.0)
    none = MatchedStars.none()
    for k in range(5):
        image = frame((20.0 + 10 * k, 40.0, 300.0), seed=k)
        image[70, 90] += 200.0
        image[10, 15] = 0.0
        verdict = operation.judge(image, float(k), FULL)
        operation.learn(image, verdict, turned(0.8 * k), none)
    assert np.argwhere(operation.blemishes).tolist() == [[10, 15], [70, 90]]
    verdict = operation.judge(frame((70.0, 40.0, 300.0), seed=5), 5.0, FULL)
    assert np.isnan(verdict.image[70, 90])


def test_frozen_frame_moves_no_rule():
    """The same over-exposed image ten times: shortened once; and its pixels are no blemishes while the body turns."""
    operation = rules(blemish_frames=3, blemish_shift_px=6.0)
    image = frame((30, 40, BRIGHT), (80, 60, BRIGHT))
    assert operation.judge(image, 0.0, FULL).rule == "exposure"
    for k in range(1, 10):
        verdict = operation.judge(image, float(k), FULL)
        assert verdict.rule == "stale"
        assert verdict.image is None
        assert operation.exposure_s == 0.2
    sound = frame((20.0, 40.0, 300.0))
    for k in range(6):
        operation.learn(sound, operation.judge(sound, 10.0 + k, FULL), turned(0.8 * k), MatchedStars.none())
    assert not operation.blemishes.any()
    dark = np.full((96, 128), FULL)  # the Sun saturates every frame alike
    assert [operation.judge(dark, t_s, FULL).rule for t_s in (20.0, 90.0)] == ["sun", "sun"]


def test_frames_of_the_same_sky_tell_once():
    operation = rules(blemish_frames=3, blemish_shift_px=6.0)
    for k in range(6):
        image = frame((20.0, 40.0, 300.0), seed=k)
        operation.learn(image, operation.judge(image, float(k), FULL), turned(0.01 * k), MatchedStars.none())
    assert not operation.blemishes.any()


def test_known_stars_tell_nothing_of_their_pixels():
    """A star that the camera holds on to is bright in every frame; matched, it is not a blemish."""
    stars = MatchedStars(np.array([[20.0, 40.0]]), np.array([1]), np.array(["a"]), *np.ones((2, 1)), np.zeros((1, 2)))
    found = []
    for known in (MatchedStars.none(), stars):
        operation = rules(blemish_frames=3, blemish_shift_px=6.0)
        for k in range(4):
            image = frame((20.0, 40.0, 300.0), seed=k)
            operation.learn(image, operation.judge(image, float(k), FULL), turned(0.8 * k), known)
        found.append(int(operation.blemishes.sum()))
    assert found[0] > 5
    assert found[1] == 0


def test_magnitudes_by_the_calibrated_relation():
    """1,000 DN of 3 electrons in half a second are 6,000 electrons a second: 2.5 lg 6000 = 9.445."""
    read = image_magnitudes([1000.0, 100.0, 0.0], 3.0, 0.5, 15.0)
    assert read[0] == pytest.approx(15.0 - 9.4454, abs=1e-4)
    assert read[1] - read[0] == pytest.approx(2.5)
    assert np.isnan(read[2])


def test_saturated_stars_are_told():
    image = frame((30, 40, BRIGHT), (80, 60, FAINT))
    assert saturated_near(image, [[30.2, 40.1], [80.0, 60.0], [0.0, 0.0]], FULL).tolist() == [True, False, False]


def test_count_leaves_out_what_a_frame_does_not_tell():
    count = BadPixelCount()
    flat = np.random.default_rng(1).normal(50.0, 1.0, (40, 40))
    flat[5, 5] = 500.0
    ignore = np.zeros((40, 40), bool)
    ignore[5, 5] = True
    for k in range(6):
        count.add(flat, ignore if k % 2 else None)
    assert count.bad(3)[5, 5]
    assert not count.bad(4)[5, 5]  # told of in three frames only
    assert count.bad().sum() == 1


@pytest.mark.parametrize("lacking", ["attitude", "image"])
def test_frame_without_an_attitude_or_not_used_teaches_nothing(lacking):
    """Without an attitude it is not known whether the stars have moved, and a frame that the rules refuse is not used:
    the same frames would show two defects."""
    operation = rules(blemish_frames=4, blemish_shift_px=6.0)
    for k in range(5):
        image = frame((20.0 + 10 * k, 40.0, 300.0), seed=k)
        image[70, 90] += 200.0
        verdict = operation.judge(image, float(k), FULL)
        if lacking == "image":
            verdict = Verdict("sun", "saturated", None)
        operation.learn(image, verdict, None if lacking == "attitude" else turned(0.8 * k), MatchedStars.none())
    assert not operation.blemishes.any()


@pytest.mark.parametrize("exposure_s", [0.0, -1.0, math.nan, math.inf])
def test_an_exposure_that_is_not_positive_is_refused(exposure_s):
    with pytest.raises(InputError, match="the exposure must be positive"):
        rules(exposure_s)


@pytest.mark.parametrize(
    ("exposure_s", "step_s", "shortest_s", "allowed_s"),
    [
        (0.4, 0.0, 0.01, 0.4),
        (0.004, 0.0, 0.01, 0.01),
        (0.45, 0.1, 0.01, 0.4),
        (0.3, 0.1, 0.01, 0.3),  # 0.3 / 0.1 is 2.9999999999999996
        (0.05, 0.1, 0.01, 0.1),
        (0.25, 0.1, 0.31, 0.4),
        (0.25, 0.1, 0.3, 0.3),
    ],
)
def test_exposures_are_whole_steps_not_below_the_shortest(exposure_s, step_s, shortest_s, allowed_s):
    operation = rules(exposure_s, exposure_step_s=step_s, shortest_exposure_s=shortest_s)
    assert operation.exposure_s == pytest.approx(allowed_s, rel=1e-9)
