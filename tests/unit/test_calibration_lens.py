"""The parameters of a lens and their joint fit: definitions, invertibility, priors, noise floor, selection."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri

from startracker import Attitude, Camera
from startracker.calibration.procedure import _projections
from startracker.geometry.attitude import rotation_vector_to_matrix
from startracker.geometry.distortion import Distortion
from startracker.geometry.lens import (
    PARAMETERS,
    change_lens,
    corner_radius,
    is_one_to_one,
    only,
    plain,
    prior_of,
    value_of,
)
from startracker.geometry.lens_fit import Matches, fit_jointly, noise_floor, rescaled, significant, stretch, subsets

LENS = Camera(1000.0, 1020.0, 480.0, 410.0, 1000, 800, Distortion(k1=-0.1, k2=0.02, p1=1e-3, p2=-5e-4))
FISHEYE = Camera(400.0, 410.0, 480.0, 410.0, 1000, 800, Distortion(k1=0.02, k4=1e-3), projection="fisheye")


# ---------------------------------------------------------------------- definitions
@pytest.mark.parametrize("camera", [LENS, FISHEYE])
def test_a_change_of_a_parameter_is_the_difference_of_its_values(camera):
    """ln f of both axes, ln of their ratio, the principal point, and the coefficients; nothing else changes."""
    for name in PARAMETERS["pinhole" if camera is LENS else "fisheye"]:
        changed = change_lens(camera, {name: 0.01})
        for other in PARAMETERS["pinhole" if camera is LENS else "fisheye"]:
            expected = 0.01 if other == name else 0.0
            assert value_of(other, changed) - value_of(other, camera) == pytest.approx(expected, abs=1e-12)
    both = change_lens(camera, {"f": 0.1, "aspect": 0.02})
    assert both.fx == pytest.approx(camera.fx * math.exp(0.09))
    assert both.fy == pytest.approx(camera.fy * math.exp(0.11))


def test_a_camera_without_some_of_its_parameters():
    bare = plain(LENS)
    focal = math.sqrt(1000.0 * 1020.0)
    assert (bare.cx, bare.cy, bare.distortion) == (499.5, 399.5, Distortion())
    assert bare.fx == bare.fy == pytest.approx(focal)
    assert only(LENS, ("f",)) == bare
    some = only(LENS, ("f", "aspect", "cy", "k2", "p1"))
    assert some == replace(LENS, cx=499.5, distortion=Distortion(k2=0.02, p1=1e-3))
    assert only(LENS, ("cx",)) == replace(bare, cx=480.0)


def test_priors_are_for_the_middle_and_no_distortion():
    """Of a coefficient by what it moves at the corner, in shares of its radius."""
    corner = math.hypot(519.0 / 1000.0, 410.0 / 1020.0)
    assert corner_radius(LENS) == pytest.approx(corner)
    assert corner_radius(replace(LENS, cx=600.0, cy=300.0)) == pytest.approx(math.hypot(600.0 / 1000.0, 499.0 / 1020.0))
    assert prior_of("f", LENS) == (0.0, math.inf)
    assert prior_of("cx", LENS)[0] == 499.5
    assert prior_of("cy", LENS)[0] == 399.5
    assert prior_of("cx", LENS)[1] == prior_of("cy", LENS)[1] == pytest.approx(30.0)
    shares = [prior_of(f"k{n}", LENS)[1] * corner ** (2 * n) for n in (1, 2, 3)]
    assert shares[0] == pytest.approx(shares[1]) == pytest.approx(shares[2])
    tangential = [prior_of(name, LENS)[1] * corner for name in ("p1", "p2")]
    assert tangential[0] == tangential[1] < shares[0]
    assert all(prior_of(name, LENS)[0] == 0.0 for name in ("aspect", "k1", "k2", "k3", "p1", "p2"))


@pytest.mark.parametrize("k", ["k1", "k2", "k3"])
def test_a_lens_is_invertible_if_its_corner_is_before_the_fold(k):
    """r (1 + k r²ⁿ) has its maximum at r²ⁿ = −1 / ((2n + 1) k), of a height of 2n / (2n + 1) of that radius."""
    n = int(k[1])
    corner = corner_radius(replace(LENS, distortion=Distortion()))
    for share, good in ((0.98, True), (1.05, False)):
        fold = share and corner / share * (2 * n + 1) / (
            2 * n
        )  # the radius whose image is at the corner over the share
        camera = replace(LENS, distortion=Distortion(**{k: -1.0 / ((2 * n + 1) * fold ** (2 * n))}))
        assert is_one_to_one(camera) is good
    assert is_one_to_one(replace(LENS, distortion=Distortion(**{k: 0.5})))
    assert is_one_to_one(FISHEYE)
    # a corner of 3π focal lengths
    assert is_one_to_one(replace(FISHEYE, fx=71.0, fy=71.0))
    assert not is_one_to_one(replace(FISHEYE, fx=70.0, fy=70.0))


def test_projections_that_are_tried():
    wide, narrow = Camera.from_fov(41.0, 100, 80), Camera.from_fov(39.0, 100, 80)
    assert _projections("fisheye", LENS, narrow) == ("fisheye",)
    assert _projections("auto", LENS, wide) == ("pinhole",)
    assert _projections("auto", FISHEYE, narrow) == ("fisheye",)
    assert _projections("auto", None, wide) == ("pinhole", "fisheye")
    assert _projections("auto", None, narrow) == ("pinhole",)


# ---------------------------------------------------------------------- noise, selection
def test_the_noise_floor_makes_the_median_residual_that_of_rayleigh():
    """2 ln 2 of the variance, less the share of the fitted parameters; nothing is taken off."""
    rng = np.random.default_rng(1)
    residuals, variance = rng.normal(0.0, 0.3, (5000, 2)), np.full(5000, 0.1**2)
    # of 5,000 squares the median is known to 1/(ln 2 √5000) = 2 %, the floor to half of it, four times
    assert noise_floor(residuals, variance) == pytest.approx(math.sqrt(0.3**2 - 0.1**2), rel=0.04)
    squares = np.sum(residuals**2, axis=1)
    for fitted, share in ((0, 1.0), (2500, 0.75), (9900, 0.1)):
        floor = noise_floor(residuals, variance, fitted)
        assert np.median(squares / (variance + floor**2)) == pytest.approx(2.0 * math.log(2.0) * share, rel=1e-3)
    assert noise_floor(0.3 * residuals, variance) == 0.0


def test_combinations_of_parameters():
    names = ("f", "cx", "cy", "k1", "k2", "p1", "p2")
    found = list(subsets(names, (("cx", "cy"), ("p1", "p2"))))
    assert len(found) == len(set(found)) == 3 * 2 * 2
    assert all("f" in kept for kept in found)
    assert all(("cx" in kept) == ("cy" in kept) and ("p1" in kept) == ("p2" in kept) for kept in found)
    assert all("k1" in kept for kept in found if "k2" in kept)
    assert names in found
    assert ("f",) in found


def stars(count, sigma_px, seed=3, camera=LENS, matrix=None):
    rng = np.random.default_rng(seed)
    xy = rng.uniform([0.0, 0.0], [camera.width - 1.0, camera.height - 1.0], (count, 2))
    directions = camera.unproject(xy) @ (np.eye(3) if matrix is None else matrix)
    return Matches(xy + sigma_px * rng.normal(size=(count, 2)), directions, np.full(count, sigma_px))


def test_significant_parameters_are_those_that_pay_for_themselves():
    """χ²/s² has to fall by ln(observations) for each: a shift of the centre by many standard errors, and by none."""
    for shift, kept in ((0.0, False), (25.0, True)):
        camera = replace(plain(LENS), cx=499.5 + shift, distortion=Distortion(k1=-0.1))
        full = fit_jointly(
            camera, [np.eye(3)], [stars(200, 0.05, camera=camera)], ("f", "aspect", "cx", "cy", "k1", "k2")
        )
        chosen = significant(full)
        assert "k1" in chosen
        assert "k2" not in chosen
        assert ("cx" in chosen) is kept


# ---------------------------------------------------------------------- the joint fit
def test_the_joint_fit_recovers_lens_and_attitudes_within_its_covariance():
    """Two images with their own attitudes and stretches; χ² of all parameters together below that of 1e-4."""
    names, rng = ("f", "cx", "cy", "k1", "p1"), np.random.default_rng(4)
    turns = [np.array([0.3, -0.2, 1.0]), np.array([-1.0, 0.5, 0.2])]
    matrices = [rotation_vector_to_matrix(turn) for turn in turns]
    amounts = np.array([[3e-4, -1e-4], [-2e-4, 2e-4]])
    truth = only(LENS, names)
    matches = []
    for k, matrix in enumerate(matrices):
        vectors = stars(150, 0.05, seed=10 + k, camera=truth).directions
        xy = truth.project(stretch(vectors, amounts[k])) + 0.05 * rng.normal(size=(150, 2))
        matches.append(Matches(xy, vectors @ matrix, np.full(150, 0.05)))
    start = change_lens(truth, {"f": 1e-3, "cx": 0.5, "k1": 0.002})
    near = [rotation_vector_to_matrix(np.array([1e-4, 0.0, -2e-4])) @ matrix for matrix in matrices]
    fit = fit_jointly(start, near, matches, names, with_refraction=True)
    assert fit.freedom == 4 * 150 - (5 + 2 * 5)
    assert fit.chi2 / fit.freedom == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / fit.freedom))
    error = [value_of(name, fit.camera) - value_of(name, truth) for name in names]
    for found, matrix in zip(fit.matrices, matrices, strict=True):
        error += Attitude.from_matrix(matrix).rotation_vector_to(Attitude.from_matrix(found)).tolist()
    error += (fit.stretches - amounts).ravel().tolist()
    assert np.array(error) @ np.linalg.solve(fit.covariance, error) < chdtri(15, 1e-4)
    np.testing.assert_allclose(fit.stretches, amounts, atol=6e-5)
    wider = rescaled(fit, matches, with_refraction=True)
    np.testing.assert_allclose(np.diag(wider)[0] / np.diag(fit.covariance)[0], fit.chi2 / fit.freedom, rtol=0.05)


def test_a_prior_holds_what_the_stars_do_not_show():
    """Three stars about the middle of one image: the principal point is that of the prior, with its error."""
    camera = plain(LENS)
    xy = np.array([[490.0, 390.0], [512.0, 401.0], [495.0, 409.0], [505.0, 391.0]])
    matches = [Matches(xy, camera.unproject(xy), np.full(4, 5.0))]
    fit = fit_jointly(camera, [np.eye(3)], matches, ("f", "cx", "cy", "k1"))
    sigma = np.sqrt(np.diag(fit.covariance))
    for k, name in ((1, "cx"), (2, "cy"), (3, "k1")):
        assert value_of(name, fit.camera) == pytest.approx(prior_of(name, camera)[0], abs=1e-6)
        assert sigma[k] == pytest.approx(prior_of(name, camera)[1], rel=0.02)


def test_a_stretch_keeps_the_mean_of_both_axes():
    vectors = np.array([[0.1, 0.2, 1.0], [-0.3, 0.05, 0.9]])
    found = stretch(vectors, np.array([1e-3, 2e-3]))
    x, y, z = vectors.T
    np.testing.assert_allclose(found, np.column_stack([x + 1e-3 * x + 2e-3 * y, y + 2e-3 * x - 1e-3 * y, z]))
    np.testing.assert_array_equal(vectors, [[0.1, 0.2, 1.0], [-0.3, 0.05, 0.9]])
