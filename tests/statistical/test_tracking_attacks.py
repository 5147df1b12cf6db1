"""Tracking sessions whose camera hangs, whose clock is wrong, or whose gyro is not what was said.

What must hold: never a wrong attitude, one status each, and a covariance that the errors agree with. Motions and star
lists as in `test_tracking_sequences`; images are Gaussian stars with noise.
"""

import copy
import math
import pickle
import threading

import numpy as np
import pytest
from scipy.special import chdtri

from simulator.study.sequence.statistics import effective_number
from startracker.attitude import Attitude
from startracker.camera import Camera
from startracker.errors import InputError
from startracker.observer import EARTH_KM_S, Observer
from startracker.solution import Status
from startracker.tracker import StarTracker
from startracker.tracking import GyroNoise, RateNoise, TrackingSession

DT = 0.5
WALK = 3e-5  # of the gyro, rad/√s
GYRO = GyroNoise(WALK, 1e-7, 1e-4)
LARGE = 35.0  # χ²(3) is above with a probability of 1e-7


class Session(TrackingSession):
    """A session whose observer is at rest: the frames made here have no aberration."""

    def update(self, image, t_s, **given):
        return super().update(image, t_s, observer=Observer(self.tracker.guide.epoch_jyear), **given)

    def update_centroids(self, xy, flux, t_s, **given):
        return super().update_centroids(xy, flux, t_s, observer=Observer(self.tracker.guide.epoch_jyear), **given)


@pytest.fixture(scope="module")
def tracker():
    return StarTracker(Camera.from_fov(10.0, 1024, 1024), magnitude_limit=6.5, identifier="adaptive")


@pytest.fixture(scope="module")
def small():
    return StarTracker(Camera.from_fov(10.0, 256, 256), magnitude_limit=6.0, identifier="adaptive")


def turned(attitude, vector):
    return Attitude.from_rotation_vector(vector, "camera", "camera") @ attitude


def motion(rng, frames, rate_deg_s, acceleration=0.0):
    """True attitudes, and the mean rate (camera axes) since the one before."""
    attitude, rate = Attitude(rng.normal(size=4)), rng.normal(size=3)
    rate *= math.radians(rate_deg_s) / np.linalg.norm(rate)
    mean = rate
    for _ in range(frames):
        yield attitude, mean
        before = attitude
        for _ in range(5):
            rate = rate + acceleration * rng.normal(size=3) * math.sqrt(DT / 5)
            attitude = turned(attitude, rate * DT / 5)
        mean = before.rotation_vector_to(attitude) / DT


def stars(rng, tracker, attitude, noise_px=0.2):
    index, _, xy = tracker.guide.in_field(attitude.as_matrix())
    order = np.argsort(tracker.guide.v_mag[index])
    xy = xy[order] + noise_px * rng.normal(size=xy.shape)
    return xy, 10.0 ** (-0.4 * tracker.guide.v_mag[index[order]])


def picture(rng, tracker, attitude):
    """Gaussian stars with Poisson-like noise, 16 bit."""
    camera = tracker.camera
    index, _, xy = tracker.guide.in_field(attitude.as_matrix(), margin_px=4.0)
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    image = np.full(rows.shape, 100.0)
    for (x, y), v_mag in zip(xy, tracker.guide.v_mag[index], strict=True):
        image += 2e5 * 10.0 ** (-0.4 * v_mag) * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 2.0)
    return np.clip(image + rng.normal(size=image.shape) * np.sqrt(image), 0, 65535).astype(np.uint16)


def nees_of(truth, found):
    error = truth.rotation_vector_to(found.attitude)
    return float(error @ np.linalg.solve(found.covariance, error))


def in_bounds(sequences):
    """Mean of all NEES and its 95 % bounds: χ²(3 N)/N for the effective number N of independent values."""
    number = sum(effective_number(np.array(nees)) for nees in sequences)
    mean = float(np.mean(np.concatenate(sequences)))
    low, high = (chdtri(3.0 * number, p) / number for p in (0.975, 0.025))
    return mean, low, high


# ---------------------------------------------------------------- frames that come again
@pytest.mark.parametrize("noise", [RateNoise(), RateNoise(1e-6), GYRO])
def test_frozen_list_is_stale(tracker, noise):
    """A body that turns by 0.05°/s; after 15 frames the list stays the same for 95 updates, in any order."""
    rng = np.random.default_rng(3)
    session = Session(tracker, noise)
    frozen = None
    for k, (truth, mean) in enumerate(motion(rng, 112, 0.05)):
        xy, flux = stars(rng, tracker, truth)
        if k == 15:
            frozen = xy, flux
        hangs = 15 < k <= 110
        if hangs:
            order = rng.permutation(len(frozen[0]))
            xy, flux = frozen[0][order], frozen[1][order]
        found = session.update_centroids(xy, flux, k * DT, gyro_rad_s=None if isinstance(noise, RateNoise) else mean)
        assert (found.status is Status.STALE) == hangs, found.reason
        assert (found.attitude is None) == hangs
        assert found.solved == session.state.solved != hangs
        if hangs:
            assert "at 7.5 s" in found.reason
            assert session.state.mode == "coasting"
            error = truth.rotation_vector_to(session.filter_attitude)
            assert error @ np.linalg.solve(session.covariance[:3, :3], error) < LARGE
        else:
            assert nees_of(truth, found) < LARGE


def test_frozen_image_is_stale_whatever_its_corner_says(small):
    """95 times the same image, with a counter that the camera writes into its first row; then new images."""
    rng = np.random.default_rng(4)
    session = Session(small, RateNoise(1e-6))
    frozen, buffer = None, np.empty((256, 256), np.uint16)
    for k, (truth, _) in enumerate(motion(rng, 102, 0.05)):
        if not 4 < k < 100:
            frozen = picture(rng, small, truth)
        buffer[:] = frozen  # the driver's one buffer
        buffer[0, :4] = k
        found = session.update(buffer, k * DT)
        assert (found.status is Status.STALE) == (4 < k < 100), found.reason
        if found.solved:
            assert nees_of(truth, found) < LARGE
    assert session.state.solved


def test_driver_that_swaps_two_buffers_is_found_out(small):
    """Two images by turns, one of them read anew now and then: what was seen before is stale."""
    rng = np.random.default_rng(5)
    session = Session(small, RateNoise(1e-6))
    images = [picture(rng, small, truth) for truth, _ in motion(rng, 2, 0.02)]
    for k in range(10):
        found = session.update(images[k % 2], k * DT)
        assert found.status is (Status.SOLVED if k < 2 else Status.STALE)
    assert session.update(images[0].astype(float), 10 * DT).status is Status.STALE
    session.reset()
    assert session.update(images[0], 0.0).solved  # nothing is remembered


@pytest.mark.parametrize("step_s", [0.0, DT])
@pytest.mark.parametrize("image", [False, True])
def test_same_frame_five_times_counts_once(small, step_s, image):
    rng = np.random.default_rng(6)
    once, five = (Session(small, RateNoise(1e-6)) for _ in range(2))
    for k, (truth, _) in enumerate(motion(rng, 6, 0.05)):
        xy, flux = stars(rng, small, truth)
        frame = picture(rng, small, truth) if image else None
        for session in (once, five):
            found = session.update(frame, k * DT) if image else session.update_centroids(xy, flux, k * DT)
            assert found.solved
    known = once.covariance
    for m in range(1, 5):
        t_s = 5 * DT + m * step_s
        found = five.update(frame, t_s) if image else five.update_centroids(xy, flux, t_s)
        assert found.status is Status.STALE
        grown = np.linalg.eigvalsh(five.covariance[:3, :3] - known[:3, :3])
        assert grown.min() >= -1e-12 * np.trace(known[:3, :3])
        if step_s == 0.0:
            np.testing.assert_array_equal(five.covariance, known)


def test_frames_alike_but_for_their_noise_are_all_used(tracker):
    """A body that stands still: as many frames, as many answers."""
    rng = np.random.default_rng(7)
    session, truth = Session(tracker, RateNoise(1e-6)), Attitude(rng.normal(size=4))
    for k in range(20):
        assert session.update_centroids(*stars(rng, tracker, truth, 0.01), k * DT).solved


# ---------------------------------------------------------------- a gyro that is off
def run(tracker, seed, frames, scale=0.0, stamp=float, rate_deg_s=1.0, acceleration=2e-3, noise=GYRO):
    """NEES of the solved frames, and the session, of a sequence with a gyro of a scale factor error."""
    rng = np.random.default_rng(seed)
    session, nees = Session(tracker, noise), []
    for k, (truth, mean) in enumerate(motion(rng, frames, rate_deg_s, acceleration)):
        gyro = (1.0 + scale) * mean + rng.normal(size=3) * WALK / math.sqrt(DT)
        found = session.update_centroids(*stars(rng, tracker, truth), stamp(k * DT), gyro_rad_s=gyro)
        if found.solved:
            nees.append(nees_of(truth, found))
    return np.array(nees), session


STAMPS = {
    "right": float,
    "scaled": lambda t_s: 1.01 * t_s,
    "late": lambda t_s: t_s + 0.02 * (round(t_s / DT) % 2),
    "repeated": math.floor,
}


@pytest.mark.parametrize("stamps", list(STAMPS))
def test_gyro_with_a_scale_factor_error_of_one_percent(tracker, stamps):
    """The rate of the body wanders, so that no bias explains it. Without the state and the watch: NEES of 5 to 9."""
    sequences = [run(tracker, seed, 60, 0.01, STAMPS[stamps])[0] for seed in range(4)]
    mean, low, high = in_bounds(sequences)
    assert low < mean < high
    assert min(map(len, sequences)) >= (30 if stamps == "repeated" else 60)


@pytest.mark.slow
@pytest.mark.parametrize("stamps", list(STAMPS))
def test_gyro_with_a_scale_factor_error_over_long_sequences(tracker, stamps):
    """The bounds are 3.00 ± 0.07. Every second stamp late by 20 ms, 2 px here, is no noise that the filter knows of:
    the watch covers it to within some 3 % of the NEES, and a tenth is allowed."""
    sequences = [run(tracker, 100 + seed, 240, 0.01, STAMPS[stamps])[0] for seed in range(24)]
    mean, low, high = in_bounds(sequences)
    assert low < mean < high * (1.1 if stamps == "late" else 1.0)


@pytest.mark.slow
def test_scale_factors_that_are_not_estimated_are_found_out_by_the_innovations(tracker):
    """The filter that is told of no scale factor error loses confidence, and its errors are as it says after that."""
    noise = GyroNoise(WALK, 1e-7, 1e-4, scale_sigma=0.0)
    runs = [run(tracker, seed, 120, 0.01, noise=noise) for seed in range(8)]
    assert all(session.filter_attitude is not None for _, session in runs)
    mean, low, high = in_bounds([nees for nees, _ in runs])
    assert mean < 1.25 * high
    assert low < mean


def test_bias_that_jumps_is_learnt_in_two_frames(tracker):
    """0.5°/s on an axis, where 0.006°/s was allowed for: before, every frame restarted."""
    rng = np.random.default_rng(8)
    session, restarts = Session(tracker, GYRO), []
    bias = np.array([math.radians(0.5), 0.0, 0.0])
    for k, (truth, mean) in enumerate(motion(rng, 60, 0.2, 1e-4)):
        gyro = mean + bias * (k >= 20) + rng.normal(size=3) * WALK / math.sqrt(DT)
        found = session.update_centroids(*stars(rng, tracker, truth), k * DT, gyro_rad_s=gyro)
        assert found.solved
        assert nees_of(truth, found) < LARGE
        restarts.append(session.state.restarted)
        assert k < 24 or session.state.mode == "tracking"
    assert 1 <= sum(restarts[20:]) <= 2
    sigma = np.sqrt(np.diag(session.covariance)[3:])
    assert (np.abs(session.bias_rad_s - bias) < 5.0 * sigma).all()


@pytest.mark.parametrize("sample", [[math.nan] * 3, [0.0, math.inf, 0.0], [1e-3, math.nan, 0.0]])
def test_gyro_sample_that_is_not_finite_costs_no_frame(tracker, sample):
    rng = np.random.default_rng(9)
    session = Session(tracker, GYRO)
    for k, (truth, mean) in enumerate(motion(rng, 20, 0.2, 1e-4)):
        missing = k in (8, 9, 15)
        gyro = sample if missing else mean + rng.normal(size=3) * WALK / math.sqrt(DT)
        before = session.covariance
        found = session.update_centroids(*stars(rng, tracker, truth), k * DT, gyro_rad_s=gyro)
        assert found.solved
        assert nees_of(truth, found) < LARGE
        assert ("gyro's sample is not finite" in found.reason) == missing
        assert ("gyro's sample is not finite" in session.state.note) == missing
        assert not missing or np.trace(session.covariance[:3, :3]) > np.trace(before[:3, :3])
    for wrong in ([0.0, 0.0], "fast", [[0.0] * 3]):
        with pytest.raises(InputError, match="three numbers"):
            session.update_centroids(np.empty((0, 2)), None, 100.0, gyro_rad_s=wrong)


@pytest.mark.parametrize("spike", [[5.0, 0.0, 0.0], [1e30, -1e30, 1e300]])
def test_one_absurd_gyro_sample_costs_no_frame(tracker, spike):
    rng = np.random.default_rng(10)
    session = Session(tracker, GYRO)
    for k, (truth, mean) in enumerate(motion(rng, 20, 0.2, 1e-4)):
        found = session.update_centroids(
            *stars(rng, tracker, truth), k * DT, gyro_rad_s=np.array(spike) if k == 10 else mean
        )
        assert found.solved, found.reason
        assert nees_of(truth, found) < LARGE
    assert session.state.mode == "tracking"


@pytest.mark.parametrize(("told", "true"), [(1e-5, 1e-3), (1e-5, 1e-4), (1e-6, 1e-5)])
def test_rate_that_wanders_more_than_was_said(tracker, told, true):
    """Process noise too small by 10 to 100: the innovations say so, and the filter believes them.

    Its errors are as it says once a window of frames has been seen. Without the watch the NEES are 6 to 18.
    """
    sequences = []
    for seed in range(3):
        rng = np.random.default_rng(20 + seed)
        session, nees = Session(tracker, RateNoise(told)), []
        for k, (truth, _) in enumerate(motion(rng, 100, 0.3, true)):
            found = session.update_centroids(*stars(rng, tracker, truth), k * DT)
            assert found.solved
            nees.append(nees_of(truth, found))
        sequences.append(np.array(nees[40:]))
    mean, _, high = in_bounds(sequences)
    assert mean < high


FAULTY = {
    "misaligned by 0.5°": lambda mean, before: Attitude.from_rotation_vector(
        np.radians([0.5, -0.5, 0.5]), "camera", "camera"
    ).apply(mean),
    "late by a sample": lambda mean, before: before,
    "scale 5 % off": lambda mean, before: 1.05 * mean,
    "of the wrong sign": lambda mean, before: -mean,
    "in degrees": lambda mean, before: np.degrees(mean),
    "stuck": lambda mean, before: np.array([0.01, 0.01, 0.01]),
    "coarse": lambda mean, before: np.round(mean / 1e-3) * 1e-3,
    "never finite": lambda mean, before: np.full(3, math.nan),
}


@pytest.mark.parametrize("fault", list(FAULTY))
def test_gyro_with_a_fault_costs_accuracy_not_consistency(tracker, fault):
    """The filter has no state for most of these: the watch finds them. Until it does, and between its alarms, the NEES
    is somewhat above its bounds; a quarter is allowed."""
    sequences = []
    for seed in range(3):
        rng = np.random.default_rng(30 + seed)
        session, nees, before = Session(tracker, GYRO), [], np.zeros(3)
        for k, (truth, mean) in enumerate(motion(rng, 80, 1.0, 2e-3)):
            gyro = FAULTY[fault](mean, before) + rng.normal(size=3) * WALK / math.sqrt(DT)
            before = mean
            found = session.update_centroids(*stars(rng, tracker, truth), k * DT, gyro_rad_s=gyro)
            assert found.solved
            nees.append(nees_of(truth, found))
        sequences.append(np.array(nees))
    mean, _, high = in_bounds(sequences)
    assert mean < 1.25 * high
    assert max(map(max, sequences)) < LARGE


def test_without_an_observer_the_covariance_has_the_aberration_in_it(tracker):
    """Up to 20.5″ that no frame shows and no filter averages, from an observer who moves with the Earth.

    NEES of 40 independent sequences: 3 on average, and no heavier a tail than χ²'s, √(6/40) of standard deviation.
    """
    tilt, nees = math.radians(23.4393), []
    for seed in range(40):
        rng = np.random.default_rng(50 + seed)
        phase = rng.uniform(0.0, 2.0 * math.pi)
        along = np.array([math.cos(phase), math.sin(phase) * math.cos(tilt), math.sin(phase) * math.sin(tilt)])
        guide = tracker.guide.seen_by(Observer(tracker.guide.epoch_jyear, EARTH_KM_S * along))
        session = TrackingSession(tracker, RateNoise(1e-6))
        for k, (truth, _) in enumerate(motion(rng, 6, 0.05)):
            index, vectors, _ = guide.in_field(truth.as_matrix())
            xy = tracker.camera.project(vectors) + 0.2 * rng.normal(size=(len(index), 2))
            found = session.update_centroids(xy, 10.0 ** (-0.4 * guide.v_mag[index]), k * DT)
            assert found.solved
        assert session.state.mode == "tracking"
        assert session.covariance[0, 0] == found.covariance[0, 0]
        nees.append(nees_of(truth, found))
    assert np.mean(nees) == pytest.approx(3.0, abs=4.0 * math.sqrt(6.0 / 40))


# ---------------------------------------------------------------- clocks
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -5.0, 4.4])
def test_time_that_cannot_be_has_a_status_and_changes_nothing(tracker, bad):
    rng = np.random.default_rng(11)
    session = Session(tracker, RateNoise(1e-6))
    for k, (truth, _) in enumerate(motion(rng, 20, 0.2)):
        if k == 10:
            known = session.covariance, session.filter_attitude
            found = session.update_centroids(*stars(rng, tracker, truth), bad)
            assert found.status is Status.BAD_TIME
            assert found.attitude is None
            assert found.covariance is None
            assert session.state.mode == "coasting"
            np.testing.assert_array_equal(session.covariance, known[0])
            assert session.filter_attitude.angle_to(known[1]) == 0.0
            continue
        found = session.update_centroids(*stars(rng, tracker, truth), k * DT)
        assert found.solved
        assert k < 3 or not session.state.restarted
        assert nees_of(truth, found) < LARGE


def test_other_frame_at_the_same_time_is_refused(tracker):
    rng = np.random.default_rng(12)
    session = Session(tracker, RateNoise(1e-6))
    truths = [truth for truth, _ in motion(rng, 4, 0.2)]
    assert session.update_centroids(*stars(rng, tracker, truths[0]), 0.0).solved
    found = session.update_centroids(*stars(rng, tracker, truths[1]), 0.0)
    assert found.status is Status.BAD_TIME
    assert "same time" in found.reason
    # a frame that gave nothing may be tried again with another list
    assert session.update_centroids(np.empty((0, 2)), None, 1.5).status is Status.NO_STARS
    assert session.update_centroids(*stars(rng, tracker, truths[3]), 1.5).solved
    for wrong in (None, "noon", [1.0, 2.0]):
        with pytest.raises(InputError, match="number of seconds"):
            session.update_centroids(np.empty((0, 2)), None, wrong)


def test_clock_that_is_set_back_costs_one_frame(tracker):
    rng = np.random.default_rng(13)
    session, status = Session(tracker, RateNoise(1e-6)), []
    for k, (truth, _) in enumerate(motion(rng, 20, 0.2)):
        found = session.update_centroids(*stars(rng, tracker, truth), k * DT + (1000.0 if k < 10 else 0.0))
        status.append(found.status)
        assert not found.solved or nees_of(truth, found) < LARGE
        assert ("set back" in found.reason) == (k == 11)
    assert status[10] is Status.BAD_TIME
    assert [s for s in status if s is not Status.SOLVED] == [Status.BAD_TIME]
    assert session.state.mode == "tracking"


@pytest.mark.parametrize("gap_s", [1e3, 1e6, 1e12, 1e300])
@pytest.mark.parametrize("with_gyro", [False, True])
def test_huge_gap_ends_in_a_search_not_in_a_wrong_attitude(tracker, gap_s, with_gyro):
    rng = np.random.default_rng(14)
    session = Session(tracker, GYRO if with_gyro else RateNoise(1e-6))
    for k, (_, mean) in enumerate(motion(rng, 3, 0.2)):
        truth = Attitude(rng.normal(size=4))
        gyro = mean if with_gyro else None
        found = session.update_centroids(*stars(rng, tracker, truth), k * gap_s, gyro_rad_s=gyro)
        assert found.solved, found.reason
        assert nees_of(truth, found) < LARGE


# ---------------------------------------------------------------- copies and threads
def test_session_is_copied_pickled_and_shared_by_threads(tracker):
    rng = np.random.default_rng(15)
    session = Session(tracker, RateNoise(1e-6))
    frames = [(stars(rng, tracker, truth), truth) for truth, _ in motion(rng, 40, 0.1)]
    for k in range(5):
        assert session.update_centroids(*frames[k][0], k * DT).solved
    for twin in (copy.deepcopy(session), pickle.loads(pickle.dumps(session))):
        assert twin.update_centroids(*frames[4][0], 5 * DT).status is Status.STALE
        np.testing.assert_allclose(
            twin.update_centroids(*frames[6][0], 6 * DT).covariance,
            copy.deepcopy(session).update_centroids(*frames[6][0], 6 * DT).covariance,
            rtol=1e-6,
        )
    answers = []

    def work(mine):
        for k in mine:
            answers.append((k, session.update_centroids(*frames[k][0], k * DT)))

    threads = [threading.Thread(target=work, args=(range(5 + i, 40, 3),)) for i in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(answers) == 35
    for k, found in answers:
        assert found.status in (Status.SOLVED, Status.BAD_TIME)
        assert not found.solved or nees_of(frames[k][1], found) < LARGE
