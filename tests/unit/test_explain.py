"""Every stage says what it found; an unsolved field also what to do next."""

import numpy as np
import pytest

from startracker import Attitude, Camera, StarTracker, Status, solve_unknown_fov
from startracker.detection import METHODS, estimate
from startracker.explain import as_text, background_step, detection_steps, hints, image_step, listed_step
from startracker.inputs import image_sample
from startracker.settings import DetectionSettings
from startracker.trace import Step


@pytest.fixture(scope="module")
def image():
    """Ten stars of known brightness on a level sky of 100 with noise 4."""
    rng = np.random.default_rng(1)
    picture = rng.normal(100.0, 4.0, (256, 320))
    rows, columns = np.mgrid[0:256, 0:320]
    for x, y in rng.uniform(20, 230, (10, 2)):
        picture += 2000.0 / (2 * np.pi * 1.5) * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 3.0)
    return picture.astype(np.float32)


def test_the_numbers_told_are_those_of_the_image(image):
    text = image_step(image.shape, image_sample(image), 0.25, 4095.0).text
    assert text.startswith("320×256 pixels, float32")
    assert "25 % at saturation (4095)" in text
    background = estimate(image)
    level, noise = background_step(background).text.removeprefix("level ").split(" DN, noise per pixel ")
    low, middle, high = (float(word) for word in level.split(" / "))
    assert low <= middle <= high
    assert middle == pytest.approx(100.0, abs=1.0)
    assert float(noise.split(" / ")[1]) == pytest.approx(4.0, rel=0.1)
    settings = DetectionSettings(threshold_sigma=6.0)
    spots = METHODS["components"](image, background, settings, None)
    first, *_, last = detection_steps(spots, settings, background)
    assert first.text.startswith("threshold 6 σ (2")  # six times four
    assert last.text.startswith(f"kept {len(spots)}")


def test_an_image_solved_blind_or_not_has_its_stages_in_order(image):
    solution = solve_unknown_fov(image)
    stages = list(dict.fromkeys(step.stage for step in solution.steps))
    wanted = ["image", "background", "detection", "centroids", "identification", "attitude", "hint"]
    assert stages == [stage for stage in wanted if stage in stages]
    assert set(wanted[:5]) <= set(stages)
    assert ("hint" in stages) is not solution.solved
    assert solution.reason in as_text(solution.steps)


def test_a_list_tells_what_was_left_out():
    step = listed_step(7, np.zeros((5, 2)), np.array([100.0, 10.0, 1.0, 1.0, 1.0]))
    assert step == Step("centroids", "7 given, 2 left out (not finite, outside the image or repeated), 5.0 mag")


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.SOLVED])
@pytest.mark.parametrize("known", [True, False])
def test_whatever_fails_there_is_something_to_do(status, known):
    for stars in (0, 4, 60):
        told = hints(status, stars, known_camera=known, settings=DetectionSettings())
        assert told
        assert {step.stage for step in told} == {"hint"}


def test_hints_fit_their_case():
    assert hints(Status.SOLVED, 9, known_camera=True) == ()
    few = as_text(hints(Status.TOO_FEW_STARS, 2, known_camera=False, settings=DetectionSettings(threshold_sigma=7.0)))
    assert "threshold_sigma (now 7)" in few
    assert "give --fov" in as_text(hints(Status.NO_MATCH, 20, known_camera=False))
    assert "check --fov" in as_text(hints(Status.NO_MATCH, 20, known_camera=False, fov_known=True))
    assert "saturated" in as_text(hints(Status.NO_MATCH, 20, known_camera=True, saturated=15))


def test_a_solved_field_tells_its_attitude():
    camera = Camera.from_fov(20.0, 512, 512)
    tracker = StarTracker(camera, magnitude_limit=5.5)
    directions = tracker.guide.directions

    attitude = Attitude.from_radec_roll(83.0, 0.0, 20.0)
    vectors = attitude.apply(directions)
    near = np.flatnonzero(vectors[:, 2] > np.cos(camera.half_diagonal_rad))
    xy = camera.project(vectors[near])
    keep = camera.contains(xy)
    solution = solve_unknown_fov(xy[keep], 512, 512, flux=10 ** (-0.4 * tracker.guide.v_mag[near[keep]]))
    assert solution.solved
    text = as_text(solution.steps)
    assert f"{solution.matched} stars used" in text
    assert "standard errors" in text
    assert "hint" not in text
