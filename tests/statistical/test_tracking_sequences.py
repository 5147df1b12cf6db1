"""Sequences of centroids, tracked: never less than lost in space, never wrong, better where the motion is known.

The motions, the centroids and their errors are made here: stars of the guide catalogue where the true attitude puts
them, with errors, some left out, and false ones. "Less" is counted frame by frame over every case of a grid: a frame
that the tracker solves alone must be solved in tracking too.
"""

import math

import numpy as np
import pytest
from star_sequences import DT, LARGE, motion, turned

from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.solution import Status
from startracker.tracking import GyroNoise, RateNoise, TrackingSession

WRONG_RAD = math.radians(0.3)  # ten times the roll's error of the worst frames here
FRAMES = 16


def centroids(rng, tracker, attitude, noise_px=0.3, false=0, drop=0.0, keep=None):
    index, _, xy = tracker.guide.in_field(attitude.as_matrix())
    chosen = np.flatnonzero(rng.random(len(index)) >= drop)
    if keep is not None:
        chosen = rng.permutation(chosen)[:keep]
    magnitude = tracker.guide.v_mag[index[chosen]] + 0.1 * rng.normal(size=len(chosen))
    xy = xy[chosen] + noise_px * rng.normal(size=(len(chosen), 2))
    edge = [tracker.camera.width - 0.5, tracker.camera.height - 0.5]
    xy = np.concatenate([xy, rng.uniform(-0.5, edge, size=(false, 2))])
    magnitude = np.concatenate([magnitude, rng.uniform(2.0, 6.5, size=false)])
    order = np.argsort(magnitude)
    return xy[order], 10.0 ** (-0.4 * magnitude[order])


def cross_rms(errors):
    return float(np.sqrt(np.mean(np.square(np.array(errors)[:, :2]))))


@pytest.mark.parametrize("rate_deg_s", [0.1, 1.0, 3.0])
@pytest.mark.parametrize(
    ("noise_px", "false", "drop"), [(0.1, 0, 0.0), (0.3, 5, 0.2), (1.0, 0, 0.2), (1.0, 5, 0.4), (0.3, 40, 0.0)]
)
def test_never_less_than_lost_in_space(tracker, rate_deg_s, noise_px, false, drop):
    rng = np.random.default_rng(round(100 * noise_px + 10 * rate_deg_s) + false)
    session = TrackingSession(tracker, RateNoise(1e-5))
    single, filtered, nees = [], [], []
    for k, (truth, _) in enumerate(motion(rng, FRAMES, rate_deg_s, 1e-5)):
        xy, flux = centroids(rng, tracker, truth, noise_px, false, drop)
        alone = tracker.solve_centroids(xy, flux)
        found = session.update_centroids(xy, flux, k * DT)
        assert found.solved or not alone.solved
        assert session.state.solved == found.solved
        if found.solved:
            assert truth.angle_to(found.attitude) < WRONG_RAD
        if k > 2:
            assert found.solved, found.reason  # once there was a solution, tracking holds it
            assert session.state.mode == "tracking"
            error = truth.rotation_vector_to(found.attitude)
            filtered.append(error)
            nees.append(error @ np.linalg.solve(found.covariance, error))
            if alone.solved:
                single.append(truth.rotation_vector_to(alone.attitude))
    # the filter averages some frames: it may be worse in a short sequence by the chance of few errors alone, 26 of them
    assert cross_rms(filtered) < cross_rms(single) * (1.0 + 2.0 / math.sqrt(2.0 * 26))
    # errors of a sequence hang together over some five frames: some three independent values of χ²(3), four deviations
    assert np.mean(nees) < 3.0 + 4.0 * math.sqrt(6.0 / 3.0)


def test_filter_beats_the_single_frame(tracker):
    """Over 60 frames at a steady rate the error falls well below one frame's; σ/√N to be fair would be an eighth."""
    rng = np.random.default_rng(8)
    session = TrackingSession(tracker, RateNoise(1e-7))
    single, filtered = [], []
    for k, (truth, _) in enumerate(motion(rng, 60, 0.2)):
        xy, flux = centroids(rng, tracker, truth, 0.5)
        found = session.update_centroids(xy, flux, k * DT)
        if k >= 20:
            filtered.append(truth.rotation_vector_to(found.attitude))
            single.append(truth.rotation_vector_to(tracker.solve_centroids(xy, flux).attitude))
    # a line fitted to N frames has at its end 2/√N of one frame's error: 0.45 at 20, 0.26 at 60
    assert cross_rms(filtered) < 0.6 * cross_rms(single)


@pytest.mark.parametrize("off_deg", [0.05, 1.0, 10.0, 180.0])
@pytest.mark.parametrize("sigma_deg", [0.003, 0.3, 2.0])
def test_wrong_prediction_costs_no_frame(tracker, off_deg, sigma_deg):
    rng = np.random.default_rng(round(off_deg * 100))
    for _ in range(3):
        truth = Attitude(rng.normal(size=4))
        axis = rng.normal(size=3)
        session = TrackingSession(tracker)
        session.reset(turned(truth, axis / np.linalg.norm(axis) * math.radians(off_deg)), sigma_deg)
        xy, flux = centroids(rng, tracker, truth, 0.3, 3, 0.2)
        alone, found = tracker.solve_centroids(xy, flux), session.update_centroids(xy, flux, 0.0)
        assert found.solved or not alone.solved
        assert not found.solved or truth.angle_to(found.attitude) < WRONG_RAD
        if off_deg > max(10.0 * sigma_deg, 0.2) and found.solved:  # 0.1° is searched in any case
            assert session.state.restarted
            assert session.state.mode == "lost_in_space"


def test_jump_between_frames_is_followed_at_once(tracker):
    """A body that turns by 40° unseen, and one that goes on turning at 8°/s, four times what was allowed for."""
    rng = np.random.default_rng(4)
    session = TrackingSession(tracker, RateNoise(1e-5))
    truth = Attitude(rng.normal(size=4))
    modes = []
    for k in range(12):
        if k == 4:
            truth = turned(truth, [0.5, -0.4, 0.2])
        if k > 4:
            truth = turned(truth, np.radians([2.0, 3.0, 1.5]))
        xy, flux = centroids(rng, tracker, truth, 0.2)
        found = session.update_centroids(xy, flux, k * DT)
        assert found.solved
        assert truth.angle_to(found.attitude) < WRONG_RAD
        modes.append(session.state.mode)
    assert modes[3] == "tracking"
    assert modes[4] == "lost_in_space"
    assert modes[-1] == "tracking"


@pytest.mark.parametrize("with_gyro", [False, True])
def test_blinded_for_half_a_minute(tracker, with_gyro):
    """The Sun: 60 frames of nothing, or of false stars; then tracking goes on without a search."""
    rng = np.random.default_rng(6)
    bias = np.array([1e-3, -2e-3, 5e-4])
    noise = GyroNoise(3e-5, 1e-7, 5e-3) if with_gyro else RateNoise(3e-6)
    session = TrackingSession(tracker, noise)
    for k, (truth, mean) in enumerate(motion(rng, 100, 0.3, 0.0 if with_gyro else 3e-6)):
        gyro = mean + bias + rng.normal(size=3) * 3e-5 / math.sqrt(DT) if with_gyro else None
        xy, flux = centroids(rng, tracker, truth, 0.3, 2, 0.1)
        blind = 30 <= k < 90
        if blind:
            xy = rng.uniform(0.0, 1023.0, size=(6 * (k % 2), 2))
            flux = np.ones(len(xy))
        found = session.update_centroids(xy, flux, k * DT, gyro_rad_s=gyro)
        assert found.solved != blind
        if not blind:
            assert truth.angle_to(found.attitude) < WRONG_RAD
            assert k == 0 or session.state.mode == "tracking"
        else:
            assert found.attitude is None
            error = truth.rotation_vector_to(session.filter_attitude)
            p = session.covariance[:3, :3]
            assert error @ np.linalg.solve(p, error) < LARGE
    if with_gyro:
        sigma = np.sqrt(np.diag(session.covariance)[3:])
        assert (np.abs(session.bias_rad_s - bias) < 5.0 * sigma).all()


@pytest.mark.parametrize("few", [1, 2, 3])
def test_few_stars_hold_the_attitude(tracker, few):
    rng = np.random.default_rng(7)
    session = TrackingSession(tracker, RateNoise(3e-6))
    solved = taken = 0
    for k, (truth, _) in enumerate(motion(rng, 30, 0.2, 3e-6)):
        xy, flux = centroids(rng, tracker, truth, 0.2, keep=few if k >= 10 else None)
        found = session.update_centroids(xy, flux, k * DT)
        error = truth.rotation_vector_to(session.filter_attitude)
        assert error @ np.linalg.solve(session.covariance[:3, :3], error) < LARGE
        if k >= 10:
            solved += found.solved
            assert found.solved or found.status in (Status.TOO_FEW_STARS, Status.NO_MATCH)
            taken += session.state.matched == few
    # a faint star alone, or two of them, are not always beyond chance, and a residual may be beyond its gate
    assert taken >= 17  # the filter takes in even one star
    assert solved == 0 if few == 1 else solved >= 18


def test_random_points_are_never_tracked(tracker):
    """The evidence' own bound: e⁻ᵗ of random frames reach t at most; here none of 600 may reach 1e-7.

    Of 600 some 6 may reach ln 100, 16 at most but for a chance of 2e-4 (Poisson).
    """
    rng = np.random.default_rng(9)
    worth = 0
    for sigma_deg in (0.003, 0.05, 0.5):
        for n in (2, 8, 25, 60):
            for _ in range(50):
                session = TrackingSession(tracker)
                session.reset(Attitude(rng.normal(size=4)), sigma_deg)
                xy = rng.uniform(0.0, 1023.0, size=(n, 2))
                followed = session._follow_centroids(xy, None, None)
                worth += followed is not None
                assert not session._accepts(followed)
    assert worth <= 16


def test_what_cannot_be(tracker):
    session = TrackingSession(tracker)
    assert session.update_centroids(np.empty((0, 2)), None, 1.0).status is Status.NO_STARS
    assert session.update_centroids(np.empty((0, 2)), None, 0.5).status is Status.BAD_TIME
    with pytest.raises(InputError, match="no gyro"):
        session.update_centroids(np.empty((0, 2)), None, 2.0, gyro_rad_s=[0, 0, 0])
    assert session.update_centroids(np.empty((0, 2)), None, math.nan).status is Status.BAD_TIME
    with pytest.raises(InputError):
        TrackingSession(tracker, exposure_s=-1.0)
    assert not session.update_centroids([[math.nan, 3.0], [5.0, 5.0], [5.0, 5.0]], [1.0, 2.0, 3.0], 3.0).solved
    assert session.filter_attitude is None
    session.reset(Attitude.from_radec_roll(10.0, 10.0), 0.01)
    for image in (np.zeros((1024, 1024)), np.zeros((3, 3)), np.full((1024, 1024), np.nan), np.full((1024, 1024), "a")):
        assert not session.update(image, 4.0).solved
