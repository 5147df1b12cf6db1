"""Tracking of the flight build in C beside truth and startracker.tracking."""

import ctypes
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from flight_c import SANITIZED, library
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from simulator.randomness import stream
from startracker.errors import InputError
from startracker.flight.directions import grid_arrays, grid_constants, grid_tables
from startracker.flight.following import (
    BEGUN,
    COASTING,
    FOLLOWING_MODULES,
    REJECTED,
    RESTARTED,
    TIME_BAD,
    TIME_GOOD,
    TIME_SET_BACK,
    USED,
    following_arrays,
    following_constants,
    following_tables,
)
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.tracking.mekf import GyroNoise, RateNoise
from startracker.tracking.watched import WatchedFilter

pytestmark = [pytest.mark.system, pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")]

ONE = 1 << 30
SIGMA = np.array([1.5, 1.5, 15.0]) / 206265.0  # of an attitude about the camera's axes
NOISE = RateNoise(acceleration=1e-5)
GYRO = GyroNoise(scale_sigma=0.0)


def fixed(matrix):
    return np.rint(np.asarray(matrix) * ONE).astype(np.int64)


def covariance_of(sigma=SIGMA):
    return np.rint(np.diag(sigma**2) * 2.0**60).astype(np.int64)


def rate_sequence(rng, rate_deg_s, count, step_s=0.2, acceleration=1e-5):
    """Attitudes (N, 3, 3) and rates (N, 3) of a camera that turns at nearly constant rate."""
    rate = rng.normal(size=3)
    rate *= np.radians(rate_deg_s) / max(np.linalg.norm(rate), 1e-9)
    matrix, out, rates = Rotation.random(random_state=rng).as_matrix(), [], []
    for _ in range(count):
        out.append(matrix)
        rates.append(rate)
        for _ in range(10):  # the rate changes during a step
            after = rate + rng.normal(size=3) * acceleration * np.sqrt(step_s / 10.0)
            matrix = Rotation.from_rotvec(-0.5 * (rate + after) * step_s / 10.0).as_matrix() @ matrix
            rate = after
    return np.array(out), np.array(rates)


def measured_from(rng, truth):
    return Rotation.from_rotvec(rng.normal(size=3) * SIGMA).as_matrix() @ truth


def error(matrix, truth):
    return Rotation.from_matrix(np.asarray(matrix) @ truth.T).as_rotvec()


MORE = """#include "tracker_following.h"
int tracker_following_bytes(void);
int tracker_following_bytes(void)
{
    return (int)sizeof(struct tracker_following);
}
int tracker_take(struct tracker_following *f, int solved, struct tracker_matrix *attitude, int64_t covariance[3][3]);
void tracker_rates(const struct tracker_following *f, int64_t *out);
/* Rate and bias, rad/s of 40 fraction bits. */
void tracker_rates(const struct tracker_following *f, int64_t *out)
{
    int k;
    for (k = 0; k < 3; k++) {
        out[k] = tracker_integer_of(f->rate[k], 20);
        out[3 + k] = tracker_integer_of(f->bias[k], 20);
    }
}
int tracker_take(struct tracker_following *f, int solved, struct tracker_matrix *attitude, int64_t covariance[3][3])
{
    struct tracker_answer answer;
    int result, k;
    answer.status = solved ? TRACKER_SOLVED : TRACKER_NO_MATCH;
    answer.attitude = *attitude;
    for (k = 0; k < 9; k++)
        answer.covariance[k / 3][k % 3] = covariance[k / 3][k % 3];
    result = (int)tracker_following_take(f, &answer);
    *attitude = answer.attitude;
    for (k = 0; k < 9; k++)
        covariance[k / 3][k % 3] = answer.covariance[k / 3][k % 3];
    return result;
}
"""


class Built:
    """The compiled filter."""

    def __init__(self, folder, noise, arithmetic="fixed"):
        tables = following_tables(noise)
        camera = grid_tables(SimpleNamespace(camera=Camera.from_fov(12.0, 1024, 1024)))
        constants = {"MAX_STARS": 60, "SEARCH_KEPT": 4, **grid_constants(camera), **following_constants(tables)}
        arrays = [*grid_arrays(camera), *following_arrays(tables)]
        self.lib = library(folder, FOLLOWING_MODULES, constants, arrays, SANITIZED, arithmetic=arithmetic, source=MORE)
        self.memory = ctypes.create_string_buffer(self.lib.tracker_following_bytes())
        self.start()

    def start(self):
        self.lib.tracker_following_start(self.memory)
        self.prior = np.zeros((3, 3), np.int64), 0

    def predict(self, time_us, gyro=None):
        """Whether the time can be used; sets `prior`, matrix and radius."""
        given = None if gyro is None else (ctypes.c_int32 * 3)(*gyro.tolist())
        prior = (ctypes.c_int32 * 10)()
        status = self.lib.tracker_following_predict(self.memory, ctypes.c_int64(time_us), given, prior)
        self.prior = np.array(prior[:9], np.int64).reshape(3, 3), prior[9]
        return status

    def update(self, matrix, covariance):
        rows = (ctypes.c_int32 * 9)(*matrix.ravel().tolist())
        return self.lib.tracker_following_update(self.memory, rows, (ctypes.c_int64 * 9)(*covariance.ravel().tolist()))

    def take(self, solved, matrix, covariance):
        """Result, and attitude and covariance of the answer after it."""
        rows, values = (
            (ctypes.c_int32 * 9)(*matrix.ravel().tolist()),
            (ctypes.c_int64 * 9)(*covariance.ravel().tolist()),
        )
        result = self.lib.tracker_take(self.memory, int(solved), rows, values)
        return result, np.array(rows, np.int64).reshape(3, 3), np.array(values, np.int64).reshape(3, 3)

    def state(self):
        """Attitude and covariance; None if there is none."""
        rows, covariance = (ctypes.c_int32 * 9)(), (ctypes.c_int64 * 9)()
        if not self.lib.tracker_following_attitude(self.memory, rows, covariance):
            return None
        return np.array(rows, np.int64).reshape(3, 3), np.array(covariance, np.int64).reshape(3, 3)

    def rates(self):
        """Rate and bias, rad/s."""
        out = (ctypes.c_int64 * 6)()
        self.lib.tracker_rates(self.memory, out)
        return np.array(out).reshape(2, 3) * 2.0**-40


@pytest.fixture(scope="module", params=["fixed", "float"])
def ours(request, tmp_path_factory):
    """The filter with the camera's rate, and its relative errors by rounding."""
    built = Built(tmp_path_factory.mktemp("c"), NOISE, request.param)
    built.rounding = {"fixed": (0.01, 1e-3), "float": (0.1, 0.02)}[request.param]
    return built


@pytest.mark.parametrize("rate_deg_s", [0.0, 0.3, 2.0])
def test_a_sequence_beside_truth_and_star_tracker(ours, rate_deg_s):
    """The same measurements through StarTracker's filter: attitudes to 0.01 of the standard error, the rounding
    of the noise densities; normalised squared errors of the second half within the chi-square bounds of 1e-4 for a
    tenth of the frames, as successive errors are correlated; the filter is better than its measurements. In single
    precision attitudes to 0.1 of the standard error, and these to 2 %."""
    rng = stream(1, "following", int(10 * rate_deg_s))
    truth, rates = rate_sequence(rng, rate_deg_s, 120)
    theirs, nees, filtered, raw = WatchedFilter(NOISE, 1e-6), [], [], []
    ours.start()
    for k, matrix in enumerate(truth):
        measured = fixed(measured_from(rng, matrix))
        assert ours.predict(200_000 * k) == TIME_GOOD
        theirs.predict(0.2 if k else 0.0, None)
        if k > 3:
            prior, radius = ours.prior
            assert np.linalg.norm(error(prior / ONE, matrix)) < radius / 2.0**28
        result = ours.update(measured, covariance_of())
        theirs.take_attitude(0.2 * k, Attitude.from_matrix(measured / ONE), covariance_of() / 2.0**60)
        assert result == (BEGUN if k == 0 else USED)
        attitude, covariance = ours.state()
        away, covariance = error(attitude / ONE, matrix), covariance / 2.0**60
        apart = error(attitude / ONE, theirs.mekf.matrix)
        sigma = np.sqrt(np.diag(covariance))
        assert np.abs(apart / sigma).max() < ours.rounding[0]
        assert sigma == pytest.approx(np.sqrt(np.diag(theirs.mekf.attitude_covariance)), rel=ours.rounding[1])
        filtered.append(away)
        raw.append(error(measured / ONE, matrix))
        nees.append(away @ np.linalg.solve(covariance, away))
    rate, _ = ours.rates()
    assert np.linalg.norm(rate - rates[-1]) < 3e-4
    half = len(nees) // 2
    assert chi2.ppf(1e-4, 18) < 6.0 * np.mean(nees[half:]) < chi2.ppf(1 - 1e-4, 18)
    assert np.mean(np.square(filtered[half:])) < 0.8 * np.mean(np.square(raw[half:]))


def test_frames_are_lost_and_found_again(ours):
    """Three frames without an attitude: the radius grows and contains the truth, and the filter goes on."""
    rng = stream(2, "following")
    truth, _ = rate_sequence(rng, 1.0, 60)
    radii = []
    ours.start()
    for k, matrix in enumerate(truth):
        ours.predict(200_000 * k)
        prior, radius = ours.prior
        radii.append(radius)
        if 40 <= k < 43:
            assert np.linalg.norm(error(prior / ONE, matrix)) < radius / 2.0**28
            continue
        result = ours.update(fixed(measured_from(rng, matrix)), covariance_of())
        assert result == (BEGUN if k == 0 else USED)
        if k > 45:
            assert np.linalg.norm(error(ours.state()[0] / ONE, matrix)[:2]) < 5.0 * SIGMA[0]
    assert radii[0] == 0  # nothing is known
    # five times 2°/s for 0.2 s about each of three axes: 3.46°
    assert radii[1] == pytest.approx(5.0 * np.sqrt(3.0) * np.radians(0.4) * 2.0**28, rel=1e-3)
    assert min(radii[2:]) > 0


def test_a_wrong_attitude_is_rejected_and_a_second_one_restarts_the_filter(ours):
    rng = stream(3, "following")
    truth, _ = rate_sequence(rng, 0.5, 60)
    wrong = Rotation.from_rotvec([0.02, -0.01, 0.05]).as_matrix()
    results = []
    ours.start()
    for k, matrix in enumerate(truth):
        ours.predict(200_000 * k)
        away = wrong if k == 30 or k >= 40 else np.eye(3)
        results.append(ours.update(fixed(measured_from(rng, away @ matrix)), covariance_of()))
        if k in (30, 31, 40):
            assert np.linalg.norm(error(ours.state()[0] / ONE, matrix)) < 1e-3
    assert results[30] == REJECTED
    assert results[31] == USED
    assert results[40:42] == [REJECTED, RESTARTED]
    assert REJECTED not in results[42:]
    assert np.linalg.norm(error(ours.state()[0] / ONE, wrong @ truth[-1])[:2]) < 5.0 * SIGMA[0]


def test_times_that_cannot_be_used(ours):
    attitude = fixed(np.eye(3))
    ours.start()
    assert ours.predict(1000) == TIME_GOOD
    ours.update(attitude, covariance_of())
    assert ours.predict(1000) == TIME_BAD  # the rotation since then is unknown
    assert ours.predict(500) == TIME_BAD  # late
    assert ours.predict(1200) == TIME_GOOD
    assert ours.predict(500) == TIME_BAD
    assert ours.predict(600) == TIME_SET_BACK
    assert ours.prior[1] == 0
    assert ours.update(attitude, covariance_of()) == BEGUN
    assert ours.predict(10**12) == TIME_GOOD  # a day later nothing is known
    assert ours.prior[1] == 0


@pytest.mark.parametrize("arithmetic", ["fixed", "float"])
def test_the_bias_of_a_gyro_is_found(tmp_path, arithmetic):
    """The bias to four standard deviations of what a line through 60 attitudes gives, and better than a tenth of it."""
    rng = stream(4, "following")
    truth, rates = rate_sequence(rng, 1.0, 60, acceleration=1e-3)
    bias, ours = np.array([5e-4, -3e-4, 2e-4]), Built(tmp_path, GYRO, arithmetic)
    for k, matrix in enumerate(truth):
        mean = rates[k] if k == 0 else -error(matrix, truth[k - 1]) / 0.2
        ours.predict(200_000 * k, fixed(mean + bias + rng.normal(size=3) * 3e-5 / np.sqrt(0.2)))
        ours.update(fixed(measured_from(rng, matrix)), covariance_of())
    _, found = ours.rates()
    assert np.abs(found - bias)[:2].max() < 5e-5
    with pytest.raises(InputError, match="scale"):
        following_tables(GyroNoise())


def steps(rng, count):
    """Times, gyro samples and measurements of all kinds: long gaps, late frames, wrong attitudes, odd covariances."""
    truth, rates = rate_sequence(rng, float(rng.choice([0.0, 0.5, 2.0, 40.0])), count)
    time_us = 0
    for matrix, rate in zip(truth, rates, strict=True):
        time_us += int(rng.choice([200_000] * 20 + [0, -100_000, 3_000_000, 10**9, 10**12]))
        gyro = fixed(rate + rng.normal(size=3) * 1e-4) if rng.random() < 0.8 else None
        measured, covariance = measured_from(rng, matrix), covariance_of()
        kind = int(rng.integers(30))
        if kind == 0:
            measured = Rotation.random(random_state=rng).as_matrix()
        elif kind == 1:
            covariance = covariance_of(10.0 ** rng.uniform(-7.0, 0.0, 3))
        elif kind == 2:
            measured = None
        yield time_us, gyro, None if measured is None else fixed(measured), covariance


@pytest.mark.parametrize("arithmetic", ["fixed", "float"])
@pytest.mark.parametrize("noise", [NOISE, GYRO], ids=["rate", "gyro"])
def test_anything_may_be_given(tmp_path, noise, arithmetic):
    """Without undefined behaviour: rows stay unit vectors, and variances positive."""
    built, seen = Built(tmp_path, noise, arithmetic), set()
    for sequence in range(4):
        built.start()
        for time_us, gyro, measured, covariance in steps(stream(5, "following", sequence), 60):
            status = built.predict(time_us, gyro)
            if measured is not None and status != TIME_BAD:
                seen.add(built.update(measured, covariance))
            state = built.state()
            if state is not None:
                assert np.abs((state[0] / ONE) @ (state[0] / ONE).T - np.eye(3)).max() < 1e-7
                assert np.diag(state[1]).min() > 0
    assert len(seen) >= 4


def test_an_answer_is_replaced_by_that_of_the_filter(ours):
    rng = stream(8, "following")
    ours.start()
    for k, matrix in enumerate(rate_sequence(rng, 1.0, 12)[0]):
        away = Rotation.from_rotvec([0.02, 0.0, 0.0]).as_matrix() if k == 9 else np.eye(3)
        measured = fixed(measured_from(rng, away @ matrix))
        ours.predict(200_000 * k)
        result, attitude, covariance = ours.take(k != 6, measured, covariance_of())
        assert (result in (COASTING, REJECTED)) == (k in (6, 9))
        expected = (measured, covariance_of()) if k in (6, 9) else ours.state()
        assert np.array_equal(attitude, expected[0])
        assert np.array_equal(covariance, expected[1])
