"""Calibration of simulated centroids with known cameras: parameters come back within their stated errors.

Stars are real catalogue stars through cameras drawn at random; the noise is Gaussian with the stated σ of each star, so
that every statistic below has a known distribution.
"""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from lens_sequences import waves
from scipy.stats import chi2

from startracker import Attitude, Camera, InputError
from startracker.calibration import StarField, calibrate
from startracker.catalog import load_catalog
from startracker.geometry.distortion import Distortion
from startracker.geometry.lens import value_of
from startracker.geometry.lens_fit import Matches, fit_jointly, rescaled

NAMES = ("f", "aspect", "cx", "cy", "k1", "k2", "p1", "p2")


@functools.cache
def sky():
    table = load_catalog("hipparcos").brighter_than(8.0)
    return table, table.directions(table.epoch_jyear)


def camera_of(rng, fov_deg):
    base = Camera.from_fov(fov_deg, 1600, 1200)
    lens = Distortion(
        k1=rng.uniform(-0.2, 0.1), k2=rng.uniform(-0.1, 0.1), p1=rng.normal(0, 2e-3), p2=rng.normal(0, 2e-3)
    )
    centre = (base.cx + rng.normal(0, 20.0), base.cy + rng.normal(0, 20.0))
    return Camera(base.fx, base.fx * 1.002, *centre, 1600, 1200, lens)


def field_of(camera, rng, count, noise_px=0.2, name="image"):
    table, directions = sky()
    matrix = Attitude(rng.normal(size=4)).as_matrix()
    near = np.flatnonzero(directions @ matrix[2] > math.cos(1.02 * camera.half_diagonal_rad))
    xy = camera.project(directions[near] @ matrix.T)
    seen = camera.contains(xy)
    near, xy = near[seen][:count], xy[seen][:count]
    v = table.v_mag[near]
    sigma = noise_px * np.clip(10.0 ** (0.2 * (v - v.max())), 0.1, 1.0)
    measured = xy + rng.normal(size=xy.shape) * sigma[:, None]
    field = StarField(name, measured, camera.width, camera.height, 10.0 ** (-0.4 * v), sigma**2)
    return field, matrix, Matches(measured, directions[near], sigma)


def errors_of(camera, truth, names):
    return np.array([value_of(n, camera) - value_of(n, truth) for n in names])


@pytest.mark.parametrize("projection", ["pinhole", "fisheye"])
def test_errors_of_the_joint_fit_are_those_stated(projection):
    """χ² of the parameters' errors against the stated covariance over 100 seeds, and each one's own spread."""
    names = NAMES if projection == "pinhole" else ("f", "aspect", "cx", "cy", "k1", "k2", "k3")
    squares, normal = [], []
    for seed in range(100):
        rng = np.random.default_rng([seed, len(projection)])
        truth = camera_of(rng, rng.uniform(25.0, 45.0))
        if projection == "fisheye":
            lens = Distortion(k1=rng.uniform(-0.05, 0.05), k2=rng.uniform(-0.02, 0.02), k3=rng.uniform(-0.005, 0.005))
            base = Camera.from_fov(rng.uniform(90.0, 130.0), 1600, 1200, projection="fisheye")
            truth = replace(base, cx=truth.cx, cy=truth.cy, fy=1.002 * base.fx, distortion=lens)
        made = [field_of(truth, rng, 100) for _ in range(2)]
        start = replace(truth, fx=1.002 * truth.fx, distortion=Distortion(), cx=799.5, cy=599.5)
        fit = fit_jointly(start, [m[1] for m in made], [m[2] for m in made], names)
        found = errors_of(fit.camera, truth, names)
        covariance = rescaled(fit, [m[2] for m in made], with_refraction=False)[: len(names), : len(names)]
        squares.append(found @ np.linalg.solve(covariance, found))
        normal.append(found / np.sqrt(np.diag(covariance)))
    # the sum is χ² with 100 · P degrees of freedom; the error of χ²/ν in the scale, √(2/400), is below its width
    freedom = 100 * len(names)
    assert chi2.ppf(1e-4, freedom) < np.sum(squares) < chi2.ppf(1.0 - 1e-4, freedom)
    # a sample variance of 100 is good to √(2/100) = 0.14, a mean to 0.1; 4 of these
    np.testing.assert_allclose(np.var(normal, axis=0), 1.0, atol=0.57)
    np.testing.assert_allclose(np.mean(normal, axis=0), 0.0, atol=0.4)


def test_whole_calibration_recovers_the_camera():
    """From centroids alone: identification, matching and rejection do not bias what comes out."""
    squares = []
    for seed in range(12):
        rng = np.random.default_rng([seed, 77])
        truth = camera_of(rng, rng.uniform(20.0, 40.0))
        made = [field_of(truth, rng, 110, name=f"image {k}")[0] for k in range(3)]
        made = [add_false(field, rng, 12) for field in made]
        result = calibrate(made, parameters=NAMES)
        assert not result.unsolved
        found = errors_of(result.camera, truth, result.names)
        squares.append(found @ np.linalg.solve(result.covariance, found))
        # at most one star in a thousand lies beyond 3.7 σ, and a false one may stand beside a star
        assert result.stars >= 3 * 110 - 12
        assert result.rejected <= 12
    freedom = 12 * len(NAMES)
    assert chi2.ppf(1e-3, freedom) < np.sum(squares) < chi2.ppf(1.0 - 1e-3, freedom)


def add_false(field, rng, count):
    """The field with stars that no catalogue has, of the brightness of the faintest."""
    xy = np.concatenate([field.xy, rng.uniform(0, [field.width - 1, field.height - 1], (count, 2))])
    flux = np.concatenate([field.flux, np.full(count, field.flux.min())])
    variance = np.concatenate([field.variance_px2, np.full(count, field.variance_px2.max())])
    return replace(field, xy=xy, flux=flux, variance_px2=variance)


def test_attitudes_have_the_errors_stated():
    """With the camera fitted along; over 60 images."""
    squares = []
    for seed in range(20):
        rng = np.random.default_rng([seed, 5])
        truth = camera_of(rng, 30.0)
        made = [field_of(truth, rng, 100, name=str(k)) for k in range(3)]
        result = calibrate([m[0] for m in made], fov_deg=30.0, parameters=NAMES)
        for one, (_, matrix, _) in zip(result.fields, made, strict=True):
            off = Attitude.from_matrix(matrix).rotation_vector_to(one.attitude)
            squares.append(off @ np.linalg.solve(one.covariance, off))
    # three an image; the three of one calibration share their camera, which can triple the variance of the sum
    mean, spread = 3.0, math.sqrt(6.0 / 60.0 * 3.0)
    assert abs(np.mean(squares) - mean) < 4.0 * spread


def test_a_smooth_distortion_is_part_of_the_stated_errors():
    """0.3 px that no lens model describes, in three images each: its effect on the parameters is common to all stars
    and images. Before, the errors of the attitudes were up to 25σ. The attitudes of one calibration share their error:
    the sum of the NEES of one of them over four distortions is within the 99.9 % limit of χ² of 12, and the focal
    length within 4σ."""
    truth, total = Camera.from_fov(20.0, 1024, 1024, Distortion(k1=-0.1)), 0.0
    for seed in range(4):
        rng, displacement, fields, matrices = np.random.default_rng(seed), waves(seed, 0.3), [], []
        for k in range(3):
            field, matrix, _ = field_of(truth, rng, 60, 0.05, name=f"{k}")
            fields.append(replace(field, xy=field.xy + displacement(field.xy)))
            matrices.append(matrix)
        found = calibrate(fields, camera=truth)
        assert found.field_px == pytest.approx(0.3, rel=0.5)
        assert any("a smooth distortion of" in note for note in found.notes)
        error = Attitude.from_matrix(matrices[0]).rotation_vector_to(found.fields[0].attitude)
        total += error @ np.linalg.solve(found.fields[0].covariance, error)
        f = found.names.index("f")
        assert abs(errors_of(found.camera, truth, ("f",))[0]) < 4.0 * np.sqrt(found.covariance[f, f])
    assert total < chi2.ppf(0.999, 12)


def test_only_what_is_significant_is_kept():
    """BIC keeps a needless coefficient with P(χ²₁ > ln 600 = 6.4) = 1.1 %; five choices a camera, 15 cameras."""
    extra = 0
    for seed in range(15):
        rng = np.random.default_rng([seed, 9])
        truth = Camera.from_fov(30.0, 1600, 1200, Distortion(k1=-0.1))
        made = [field_of(truth, rng, 100, name=str(k))[0] for k in range(3)]
        names = set(calibrate(made, fov_deg=30.0).names)
        assert {"f", "k1"} <= names
        extra += len(names - {"f", "k1"})
    # at most eight choices of 1.1 % each, some worth two coefficients: 1.3 ± 1.7 expected in all
    assert extra <= 7


def test_refraction_is_told_from_the_lens():
    """Two fields through air, 40° and 60° up: the stretch is κ tan²z / 2 along the vertical, within its errors."""
    rng = np.random.default_rng(40)
    truth = Camera.from_fov(20.0, 1600, 1200, Distortion(k1=-0.1))
    table, directions = sky()
    kappa = math.radians(58.3 / 3600.0)
    made = []
    for altitude_deg in (40.0, 60.0):
        matrix = Attitude(rng.normal(size=4)).as_matrix()
        # a level camera: up is −y
        altitude = math.radians(altitude_deg)
        zenith = np.array([0.0, -math.cos(altitude), math.sin(altitude)]) @ matrix
        z = np.arccos(np.clip(directions @ zenith, -1.0, 1.0))
        up = zenith - directions * np.cos(z)[:, None]
        up /= np.maximum(np.linalg.norm(up, axis=1), 1e-9)[:, None]
        high = z < math.radians(80.0)
        seen_at = directions + up * (kappa * np.tan(np.where(high, z, 0.0)))[:, None]
        xy = truth.project((seen_at / np.linalg.norm(seen_at, axis=1)[:, None]) @ matrix.T)
        ahead = high & (directions @ matrix[2] > math.cos(truth.half_diagonal_rad))
        keep = np.flatnonzero(ahead & truth.contains(xy))[:200]
        sigma = np.full(len(keep), 0.05)
        measured = xy[keep] + rng.normal(0, 0.05, (len(keep), 2))
        flux = 10.0 ** (-0.4 * table.v_mag[keep])
        made.append(StarField(f"{altitude_deg:.0f}°", measured, 1600, 1200, flux, sigma**2))
    result = calibrate(made, fov_deg=20.0, refraction=True)
    for one, altitude_deg in zip(result.fields, (40.0, 60.0), strict=True):
        amount = 0.5 * kappa / math.tan(math.radians(altitude_deg)) ** 2
        # vertical (y) is shortened: x (1 + a), y (1 − a) with a > 0. σ ≈ 0.05 px / (300 px · √200) = 1.2e-5; 4 of
        # these, and 5 % for what is not linear over 15°
        assert one.refraction[0] == pytest.approx(amount, abs=5e-5 + 0.05 * amount)
        assert abs(one.refraction[1]) < 5e-5
    assert "aspect" not in result.names
    without = calibrate(made, fov_deg=20.0)
    assert "aspect" in without.names
    assert without.rms_px > result.rms_px


@pytest.mark.parametrize("images", [3, 5])
@pytest.mark.parametrize("factor", [0.97, 0.985, 1.005, 1.03])
def test_a_photograph_at_another_zoom_is_found_and_left_out(factor, images):
    rng = np.random.default_rng([7, images, round(1000 * factor)])
    camera = camera_of(rng, rng.uniform(12.0, 40.0))
    odd = int(rng.integers(images))
    zoomed = replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
    fields = [field_of(zoomed if k == odd else camera, rng, 60, name=f"{k}.png")[0] for k in range(images)]
    found = calibrate(fields, fov_deg=camera.undistorted_fov_deg)
    assert list(found.unsolved) == [f"{odd}.png"]
    assert f"{factor:.3f}"[:4] in found.unsolved[f"{odd}.png"]
    alone = calibrate([f for k, f in enumerate(fields) if k != odd], fov_deg=camera.undistorted_fov_deg)
    # the same stars but for those near the gate: far within a standard error
    assert found.camera.fx == pytest.approx(alone.camera.fx, abs=0.3 * alone.values()["fx"][1])


def test_images_of_two_zooms_without_a_majority_are_refused():
    rng = np.random.default_rng(5)
    camera = camera_of(rng, 20.0)
    other = replace(camera, fx=1.02 * camera.fx, fy=1.02 * camera.fy)
    fields = [field_of(one, rng, 60, name=f"{k}.png")[0] for k, one in enumerate((camera, other, camera, other))]
    with pytest.raises(InputError, match=r"not taken at one focal length .*1\.png 1\.0"):
        calibrate(fields, fov_deg=20.0)


def test_an_image_given_many_times_counts_once():
    rng = np.random.default_rng(6)
    camera = camera_of(rng, 20.0)
    fields = [field_of(camera, rng, 60, name=f"{k}.png")[0] for k in range(3)]
    copies = [replace(fields[1], name=f"copy-{k}.png") for k in range(9)]
    once, many = calibrate(fields, fov_deg=20.0), calibrate([*fields, *copies], fov_deg=20.0)
    assert list(many.unsolved.values()) == ["duplicate of 1.png"] * 9
    np.testing.assert_array_equal(many.covariance, once.covariance)
    assert many.camera == once.camera
