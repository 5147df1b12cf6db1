"""Distribution of the random attitude error and of random attitudes. Fixed seeds; limits at 5 standard errors, so that
a correct program fails for 1 of 30,000 seeds and statistics (some 40 of them here: 1 in 800)."""

import math

import numpy as np
import pytest
from scipy.stats import kstest

from simulator.mission.parameters import PointingParameters
from simulator.mission.pointing import MOUNTINGS, point, random_attitude

R_KM, V_KM_S = np.array([7178.0, 0.0, 0.0]), np.array([0.0, 1.0, 7.4])
K = 5.0


def test_attitude_error_is_uniform_on_each_axis():
    n, half_deg = 3000, 1.0
    rng = np.random.default_rng(20260321)
    section = PointingParameters(error_deg=half_deg)
    to_body = MOUNTINGS["orbit_normal"].inverse
    errors = np.empty((n, 3))
    for trial in range(n):
        pointing = point(section, R_KM, V_KM_S, rng)
        errors[trial] = np.degrees(to_body.apply(pointing.prior.rotation_vector_to(pointing.camera)))
    sigma = half_deg / math.sqrt(3)  # uniform within ± w: mean 0, standard deviation w/√3
    assert np.all(np.abs(errors) <= half_deg * (1 + 1e-12))
    assert np.all(np.abs(errors.mean(axis=0)) < K * sigma / math.sqrt(n))
    # variance of x² for the uniform: w⁴ (1/5 − 1/9) = 4 w⁴/45
    assert np.all(np.abs((errors**2).mean(axis=0) - sigma**2) < K * half_deg**2 * math.sqrt(4 / 45 / n))
    # correlation of independent axes: standard error 1/√n
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < K / math.sqrt(n)
    for axis in range(3):
        assert kstest(errors[:, axis], "uniform", args=(-half_deg, 2 * half_deg)).pvalue > 1e-4


@pytest.fixture(scope="module")
def random_matrices():
    rng = np.random.default_rng(1992)
    return np.array([random_attitude(rng).as_matrix() for _ in range(4000)])


def test_random_attitudes_point_everywhere_alike(random_matrices):
    # each element of a Haar-distributed rotation is uniform in [−1, 1] (Archimedes): mean 0, variance 1/3
    n = len(random_matrices)
    assert np.abs(random_matrices.mean(axis=0)).max() < K * math.sqrt(1 / 3 / n)
    assert np.abs((random_matrices**2).mean(axis=0) - 1 / 3).max() < K * math.sqrt(4 / 45 / n)
    for row in range(3):
        for column in range(3):
            assert kstest(random_matrices[:, row, column], "uniform", args=(-1, 2)).pvalue > 1e-5


def test_angle_of_random_rotations(random_matrices):
    # density (1 − cos θ)/π on [0, π] (Miles 1965): what uniform Euler angles or axis and angle do not give
    angle = np.arccos(np.clip((np.trace(random_matrices, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert kstest(angle, lambda x: (x - np.sin(x)) / np.pi).pvalue > 1e-4


def test_roll_is_uniform_whatever_the_boresight(random_matrices):
    rng = np.random.default_rng(5)
    attitudes = [random_attitude(rng) for _ in range(2000)]
    roll = np.array([a.roll_deg for a in attitudes])
    ra = np.array([a.ra_deg for a in attitudes])
    assert kstest(roll, "uniform", args=(0, 360)).pvalue > 1e-4
    assert kstest(ra, "uniform", args=(0, 360)).pvalue > 1e-4
    # circular independence of roll and RA: |mean exp(i(roll ± RA))| is Rayleigh with σ² = 1/(2n): P(> 5σ) = 4e-6
    for sign in (1, -1):
        assert abs(np.mean(np.exp(1j * np.radians(roll + sign * ra)))) < K / math.sqrt(2 * len(roll))
