"""Tracking sessions whose camera hangs or whose clock is wrong.

What must hold: never a wrong attitude, one status each, and a covariance that the errors agree with. Images are
Gaussian stars with noise.
"""

import copy
import math
import pickle
import threading

import numpy as np
import pytest
from star_sequences import DT, LARGE, Session, motion, nees_of, stars

from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.solution import Status
from startracker.tracker import StarTracker
from startracker.tracking import GyroNoise, RateNoise

GYRO = GyroNoise(3e-5, 1e-7, 1e-4)


@pytest.fixture(scope="module")
def small():
    return StarTracker(Camera.from_fov(10.0, 256, 256), magnitude_limit=6.0, identifier="adaptive")


def picture(rng, tracker, attitude):
    """Gaussian stars with Poisson-like noise, 16 bit."""
    camera = tracker.camera
    index, _, xy = tracker.guide.in_field(attitude.as_matrix(), margin_px=4.0)
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    image = np.full(rows.shape, 100.0)
    for (x, y), v_mag in zip(xy, tracker.guide.v_mag[index], strict=True):
        image += 2e5 * 10.0 ** (-0.4 * v_mag) * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 2.0)
    return np.clip(image + rng.normal(size=image.shape) * np.sqrt(image), 0, 65535).astype(np.uint16)


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
