"""Tracking sessions whose gyro, or motion, is not what was said: the covariance still holds what the errors are."""

import math

import numpy as np
import pytest
from scipy.special import chdtri
from star_sequences import DT, LARGE, Session, motion, nees_of, stars

from simulator.study.intervals import effective_number
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.observer import EARTH_KM_S, Observer
from startracker.tracking import GyroNoise, RateNoise, TrackingSession

WALK = 3e-5  # rad/√s
GYRO = GyroNoise(WALK, 1e-7, 1e-4)


def in_bounds(sequences):
    """Mean of all NEES and its 95 % bounds: χ²(3 N)/N for the effective number N of independent values."""
    number = sum(effective_number(np.array(nees)) for nees in sequences)
    mean = float(np.mean(np.concatenate(sequences)))
    low, high = (chdtri(3.0 * number, p) / number for p in (0.975, 0.025))
    return mean, low, high


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
    """The bounds are 3.00 ± 0.07. Every second stamp late by 20 ms, 2 px here, is not noise that the filter knows of:
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
        assert ("gyro sample is not finite" in found.reason) == missing
        assert ("gyro sample is not finite" in session.state.note) == missing
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
        guide = tracker.guide.apparent_to(Observer(tracker.guide.epoch_jyear, EARTH_KM_S * along))
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
