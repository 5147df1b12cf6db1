"""Sequences through the identification, the attitude and the filter of the flight build in C, beside the truth."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.randomness import stream
from simulator.study.exported_c.targets import HOST
from simulator.study.flight.library import NO_PRIOR, Known
from startracker import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.flight.design import DetectorNumbers, FlightDesign
from startracker.flight.following import BEGUN, COASTING, REJECTED, RESTARTED, TIME_BAD, USED
from startracker.flight.stars import StarList
from startracker.geometry.camera import Camera
from startracker.tracking.mekf import RateNoise
from tests.helpers.flight_stages import CompiledFlight

pytestmark = [pytest.mark.system, pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine")]

CAMERA = Camera.from_fov(12.0, 1024, 1024)
STEP_S, SIGMA_PX = 0.2, 0.1


@pytest.fixture(scope="module")
def guide():
    return GuideDatabase.build(load_catalog("hipparcos"), CAMERA, 6.0)


@pytest.fixture(scope="module", params=["fixed", "float"])
def flight(request, guide, tmp_path_factory):
    numbers, motion = DetectorNumbers(1.0, 5.0, 65000), RateNoise(acceleration=1e-5)
    design = FlightDesign(CAMERA, guide, numbers, 0.8, arithmetic=request.param, motion=motion)
    return CompiledFlight(design, tmp_path_factory.mktemp("c"))


def follow(flight, stars, time_us):
    """Result of the time, of the filter, and the answer; None if the time cannot be used."""
    time, prior = flight.predict(time_us)
    if time == TIME_BAD:
        return time, COASTING, None
    answer, _ = flight.solve_stars(stars, Known((0, 0, 0), 0, time_us, prior if prior[-1] else NO_PRIOR))
    return time, flight.take(), flight.answer()[0] if answer.attitude else answer


def stars_at(guide, rng, matrix):
    """The brightest 25 stars of a field with noise, and two false ones."""
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
    return np.linalg.norm(Rotation.from_matrix(matrix @ truth.T).as_rotvec()[:2]) * CAMERA.fx


@pytest.mark.parametrize("rate_deg_s", [0.0, 1.0, 2.0])
def test_sequences_with_frames_that_are_lost(guide, flight, rate_deg_s):
    """Frames 8 to 10 have no stars; the others are solved near the prediction, with fewer steps than without one, to
    five standard errors of 20 stars."""
    rng = stream(1, "session", int(rate_deg_s))
    steps = []
    flight.forget()
    for k, truth in enumerate(attitudes(rng, rate_deg_s, 16)):
        lost = 8 <= k < 11
        stars = stars_at(guide, rng, truth)
        _, result, answer = follow(flight, stars.take(np.arange(0 if lost else len(stars.x))), 200_000 * k)
        if lost:
            assert result == COASTING
            continue
        assert answer.status == "solved"
        assert result == (BEGUN if k == 0 else USED)
        assert not answer.counts["contradicted"]
        assert away_px(answer.attitude.as_matrix(), truth) < 5.0 * SIGMA_PX * np.sqrt(2.0 / 20.0)
        steps.append(answer.counts["steps"])
    assert follow(flight, stars, 200_000 * k)[0] == TIME_BAD
    assert np.mean(steps[1:]) < steps[0]
    assert np.degrees(np.linalg.norm(flight.filter().rate_rad_s[:2])) <= rate_deg_s + 0.01


def test_a_turn_that_nobody_predicted(guide, flight):
    """After a jump by 5° the first frame, solved against the prediction, is not mixed with it; the second restarts."""
    rng, results = stream(2, "session"), []
    flight.forget()
    truth = attitudes(rng, 0.3, 12)
    jump = Rotation.from_rotvec([np.radians(5.0), 0.0, 0.0]).as_matrix()
    for k, matrix in enumerate(truth):
        seen = jump @ matrix if k >= 8 else matrix
        _, result, answer = follow(flight, stars_at(guide, rng, seen), 200_000 * k)
        results.append(result)
        assert answer.status == "solved"
        assert away_px(answer.attitude.as_matrix(), seen) < 0.2
        assert answer.counts["contradicted"] == (k in (8, 9))
    assert results[8:] == [REJECTED, RESTARTED, USED, USED]
