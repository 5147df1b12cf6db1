"""Sequences through the identification, the attitude and the filter of the flight build, beside the truth."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.randomness import stream
from simulator.study.exported_c.targets import HOST
from simulator.study.flight.program import FlightProgram, list_text
from startracker import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.flight.design import DetectorNumbers, FlightDesign
from startracker.flight.following import BEGUN, COASTING, REJECTED, RESTARTED, TIME_BAD, USED, following_tables
from startracker.flight.session import FlightSession
from startracker.flight.solver import FlightTracker
from startracker.flight.stars import StarList
from startracker.geometry.camera import Camera
from startracker.tracking.mekf import RateNoise

pytestmark = pytest.mark.system

ONE = 1 << 30
CAMERA = Camera.from_fov(12.0, 1024, 1024)
STEP_S, SIGMA_PX = 0.2, 0.1


@pytest.fixture(scope="module")
def tracker():
    guide = GuideDatabase.build(load_catalog("hipparcos"), CAMERA, 6.0)
    return FlightTracker.build(FlightDesign(CAMERA, guide, DetectorNumbers(1.0, 5.0, 65000), 0.8))


def stars_at(tracker, rng, matrix):
    """The brightest 25 stars of a field with noise, and two false ones."""
    guide = tracker.design.guide
    index, _, xy = guide.in_field(matrix, -2.0, CAMERA)
    index, xy = index[:25], xy[:25]
    xy = np.concatenate([xy + rng.normal(size=xy.shape) * SIGMA_PX, rng.uniform(5.0, 1018.0, (2, 2))])
    flux = np.concatenate([1e6 * 10.0 ** (-0.4 * guide.v_mag[index]), [2000.0, 1500.0]])
    return StarList.of(xy, flux, np.full(len(xy), SIGMA_PX**2))


def attitudes(rng, rate_deg_s, count):
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(-np.radians(rate_deg_s) * STEP_S * axis / np.linalg.norm(axis)).as_matrix()
    out = [Rotation.random(random_state=rng).as_matrix()]
    while len(out) < count:
        out.append(turn @ out[-1])
    return out


def away_px(matrix, truth):
    """Error across the boresight, pixels."""
    return np.linalg.norm(Rotation.from_matrix(matrix / ONE @ truth.T).as_rotvec()[:2]) * CAMERA.fx


@pytest.mark.parametrize("rate_deg_s", [0.0, 1.0, 2.0])
def test_sequences_with_frames_that_are_lost(tracker, rate_deg_s):
    """Frames 8 to 10 have no stars; the others are solved near the prediction, with fewer steps than without one, to
    five standard errors of 20 stars."""
    rng = stream(1, "session", int(rate_deg_s))
    session = FlightSession(tracker, following_tables(RateNoise(acceleration=1e-5)))
    steps = []
    for k, truth in enumerate(attitudes(rng, rate_deg_s, 16)):
        lost = 8 <= k < 11
        stars = stars_at(tracker, rng, truth)
        _, result, answer = session.update_stars(stars.take(np.arange(0 if lost else len(stars.x))), 200_000 * k)
        if lost:
            assert result == COASTING
            continue
        assert answer.solved
        assert result == (BEGUN if k == 0 else USED)
        assert not answer.prior_contradicted
        assert away_px(answer.matrix, truth) < 5.0 * SIGMA_PX * np.sqrt(2.0 / 20.0)
        steps.append(answer.steps)
    assert session.update_stars(stars, 200_000 * k)[0] == TIME_BAD
    assert np.mean(steps[1:]) < steps[0]
    rate = np.array([float(value) for value in session.following.rate]) * 2.0**-20
    assert np.degrees(np.linalg.norm(rate[:2])) <= rate_deg_s + 0.01


def test_a_turn_that_nobody_predicted(tracker):
    """After a jump by 5° the first frame, solved against the prediction, is not mixed with it; the second restarts."""
    rng, results = stream(2, "session"), []
    session = FlightSession(tracker, following_tables())
    truth = attitudes(rng, 0.3, 12)
    jump = Rotation.from_rotvec([np.radians(5.0), 0.0, 0.0]).as_matrix()
    for k, matrix in enumerate(truth):
        seen = jump @ matrix if k >= 8 else matrix
        _, result, answer = session.update_stars(stars_at(tracker, rng, seen), 200_000 * k)
        results.append(result)
        assert answer.solved
        assert away_px(answer.matrix, seen) < 0.2
        assert answer.prior_contradicted == (k in (8, 9))
    assert results[8:] == [REJECTED, RESTARTED, USED, USED]


@pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine")
def test_the_program_follows_the_same_sequence_bit_for_bit(tracker, tmp_path):
    rng, texts, expected = stream(3, "session"), [], []
    session = FlightSession(tracker, following_tables())
    jump = Rotation.from_rotvec([np.radians(5.0), 0.0, 0.0]).as_matrix()
    times = [0, 200_000, 400_000, 600_000, 500_000, 800_000, 800_000, 1_000_000, 1_200_000, 1_400_000, 100, 300]
    for k, (matrix, time_us) in enumerate(zip(attitudes(rng, 1.0, len(times)), times, strict=True)):
        stars = stars_at(tracker, rng, jump @ matrix if k >= 8 else matrix)
        stars = stars.take(np.arange(0 if k == 5 else len(stars.x)))
        texts.append(list_text(stars, time_us=time_us))
        expected.append(session.update_stars(stars, time_us))
    for found, followed in zip(FlightProgram(tracker.design, tmp_path).sequence(texts), expected, strict=True):
        assert found.counts["filter"] == followed.result
        if followed.time == TIME_BAD:
            assert found.status == "bad_time"
        elif followed.answer.solved:
            assert found.quaternion == tuple(followed.answer.quaternion.tolist())
            assert found.covariance == tuple(followed.answer.covariance.ravel().tolist())
    assert {BEGUN, USED, REJECTED, RESTARTED, COASTING} == {followed.result for followed in expected}
