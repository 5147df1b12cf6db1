"""The kernels behind the bounds of the attitude, the paths of stars and the camera, against plain NumPy and SciPy that
does the same on whole arrays; tolerances are rounding."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator import Renderer, Scenario
from simulator.detector.fixed_pattern import FixedPattern
from simulator.optics.smear import _longest, _positions, star_paths, turning
from simulator.optics.splat import add_gaussians
from simulator.study.trials import bounds
from simulator.study.trials.trial import TrialRunner
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion, project_pinhole

SMALL = ["detector.width=256", "detector.height=256"]


@pytest.fixture(scope="module")
def renderer():
    return Renderer(Scenario.load("cubesat_ideal", SMALL))


def test_images_and_slopes_are_differences_of_images_of_the_renderer(renderer):
    rng = np.random.default_rng(3)
    psf = renderer.focal_plane.psfs.psf()
    paths, weights = rng.uniform(-2.0, 2.0, (7, 3, 2)), np.array([0.25, 0.5, 0.25])
    paths[0, 1] = np.nan  # a moment that leaves no light
    paths[2, 0, 0] = paths[3, 2, 1] = np.nan
    paths[1] += 9.0  # a star off its own image
    half, step = 5, bounds._STEP_PX
    found = bounds.image_slopes(psf, paths, weights, half)

    def drawn(dx, dy):
        images = np.zeros((7, 11, 11))
        for image, path in zip(images, paths, strict=True):
            moved = path[None] + half + np.array([dx, dy])
            add_gaussians(image, moved, weights, np.ones(1), psf.radius_px(np.ones(1)), psf.sigma_px, psf.sigma_y_px)
        return images

    expected = (
        drawn(0, 0), (drawn(step, 0) - drawn(-step, 0)) / (2 * step), (drawn(0, step) - drawn(0, -step)) / (2 * step)
    )  # fmt: skip
    for ours, theirs, rounding in zip(found, expected, (1e-17, 1e-14, 1e-14), strict=True):  # differences over 0.04 px
        assert theirs.any()
        np.testing.assert_allclose(ours, theirs, rtol=1e-14, atol=rounding)


@pytest.mark.parametrize("even_dark", [True, False])
@pytest.mark.parametrize("shot_noise", [True, False])
def test_variances_are_those_of_whole_arrays(renderer, even_dark, shot_noise):
    rng = np.random.default_rng(4)
    section = replace(renderer.detector.parameters, shot_noise=shot_noise)
    section_exposure_s = 0.5
    mean = rng.uniform(0.0, 1.2 * section.full_well_e, (40, 50))
    dark = 12.0 if even_dark else rng.uniform(0.0, 400.0, mean.shape).astype(np.float32)
    centres = np.array([[0, 0], [49, 39], [20, 10], [-30, 5]])
    star = rng.uniform(0.0, 5e3, (4, 7, 7))
    found, exposure_s = star.copy(), section_exposure_s
    wells = bounds._wells(FixedPattern(1.0, dark / exposure_s), section, exposure_s)
    noise = bounds._noise(section, exposure_s)
    bounds._variances_about(found, mean, wells, centres.astype(float), noise)
    offsets = np.arange(7) - 3
    columns, rows = centres[:, 0, None] + offsets, centres[:, 1, None] + offsets
    inside = ((rows >= 0) & (rows < 40))[:, :, None] & ((columns >= 0) & (columns < 50))[:, None, :]
    at = (np.clip(rows, 0, 39)[:, :, None], np.clip(columns, 0, 49)[:, None, :])
    darkness = np.broadcast_to(dark, mean.shape)[at].astype(float)
    variance = bounds.pixel_variance_e2(mean[at], darkness, star, section, exposure_s)
    expected = np.where(inside & (mean[at] + darkness < section.full_well_e), variance, np.inf)
    assert 0 < np.isinf(expected[:3]).sum() < expected[:3].size
    assert np.isinf(expected[3]).all()
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_fisher_matrices_are_those_of_matrix_products():
    rng = np.random.default_rng(5)
    share, slope_x, slope_y = rng.normal(size=(3, 6, 9, 9))
    flux, variance = rng.uniform(100.0, 1e4, 6), rng.uniform(50.0, 500.0, (6, 9, 9))
    variance[0, :, 4:] = np.inf  # pixels that tell nothing
    variance[1, 2, 2] = share[1, 2, 2] = slope_x[1, 2, 2] = slope_y[1, 2, 2] = 0.0
    variance[2], share[2] = np.inf, 0.0
    found = bounds.fisher_of_position(share, slope_x, slope_y, flux, variance)
    for n in range(6):
        used = variance[n] > 0.0
        parts = np.array([flux[n] * slope_x[n][used], flux[n] * slope_y[n][used], share[n][used]])
        full = (parts / variance[n][used]) @ parts.T
        expected = full[:2, :2] - np.outer(full[:2, 2], full[:2, 2]) / (full[2, 2] or 1.0)
        np.testing.assert_allclose(found[n], expected, rtol=1e-11, atol=1e-12)


STEP_RAD = 1e-5


def test_slopes_of_pixels_are_central_differences_of_crossed_vectors(renderer):
    camera = renderer.focal_plane.true_camera
    vectors = camera.unproject(np.random.default_rng(6).uniform(0.0, 255.0, (20, 2)))
    turns = np.concatenate([np.eye(3), -np.eye(3)]) * STEP_RAD
    turned = vectors[None] - np.cross(turns[:, None, :], vectors[None])
    xy = camera.project(turned.reshape(-1, 3)).reshape(6, 20, 2)
    expected = np.moveaxis((xy[:3] - xy[3:]) / (2.0 * STEP_RAD), 0, -1)
    np.testing.assert_array_equal(bounds.pixel_slopes(camera, vectors), expected)


def test_matched_stars_are_the_brightest_near(renderer):
    truth = renderer.frame(0)[1]
    rng = np.random.default_rng(7)
    xy = np.concatenate([truth.sources.xy + rng.uniform(-3.0, 3.0, truth.sources.xy.shape), [[-500.0, 0.0]]])
    distance = np.hypot(*np.moveaxis(truth.sources.xy[None] - xy[:, None], -1, 0))
    light = np.where((distance <= bounds.SAME_STAR_PX) & (truth.sources.kind == "star"), truth.sources.electrons, -1.0)
    best = light.argmax(axis=1)[light.max(axis=1) > 0.0]
    np.testing.assert_array_equal(bounds.matched_sources(truth, xy), np.unique(best))
    assert len(bounds.matched_sources(truth, np.empty((0, 2)))) == 0


def test_rotations_are_those_of_scipy_and_turn_what_they_should(renderer):
    turn, moments = np.array([0.3, -1.2, 0.7]), np.linspace(-0.5, 0.5, 9)
    matrices = turning(turn, moments)
    np.testing.assert_allclose(matrices, Rotation.from_rotvec(moments[:, None] * turn).as_matrix(), atol=4e-16)
    np.testing.assert_array_equal(turning(np.zeros(3), moments), np.tile(np.eye(3), (9, 1, 1)))
    directions, camera = np.random.default_rng(8).normal(size=(12, 3)), renderer.camera
    vectors = np.einsum("kij,nj->nki", matrices, directions)
    found = _positions(directions, matrices, 0.1, camera.image_map)
    low = vectors[..., 2] < 0.1
    assert 0 < low.sum() < low.size
    assert np.isnan(found[low]).all()
    np.testing.assert_allclose(found[~low], camera.project(vectors[~low]), rtol=1e-12)


def test_the_longest_path_leaves_out_chords_to_nowhere():
    xy = np.random.default_rng(9).normal(size=(5, 6, 2))
    xy[2, 3], xy[4] = np.nan, np.nan
    expected = np.nansum(np.linalg.norm(np.diff(xy, axis=1), axis=2), axis=1).max()
    assert _longest(xy) == pytest.approx(expected, rel=1e-15)
    assert _longest(np.empty((0, 6, 2))) == 0.0


@pytest.mark.parametrize("parity", [1, -1])
def test_a_pinhole_projects_by_ratio_distortion_and_scale(parity):
    lens = Distortion(k1=-0.1, k2=0.02, p1=1e-3, p2=-2e-3, k4=0.01)
    camera = Camera(700.0, 710.0, 300.0, 200.0, 640, 480, lens, parity)
    vectors = np.random.default_rng(10).normal(size=(50, 3))
    ahead = vectors[:, 2] > 1e-9
    flat = project_pinhole(vectors[ahead], lens.as_array(), 1.0, 1.0, 0.0, 0.0)
    found = camera.project(vectors)
    np.testing.assert_array_equal(found[ahead], flat * [parity * 700.0, 710.0] + [300.0, 200.0])
    assert np.isnan(found[~ahead]).all()
    assert (~ahead).any()


def test_paths_are_those_of_attitudes_that_turn(renderer):
    camera, rate, exposure_s = renderer.camera, np.array([0.01, -0.02, 0.05]), 0.4
    vectors = camera.unproject(np.random.default_rng(11).uniform(20.0, 230.0, (9, 2)))
    xy, weights = star_paths(camera, vectors, rate, exposure_s)
    nodes = np.polynomial.legendre.leggauss(len(weights))[0]
    for k, node in enumerate(nodes):
        turn = Attitude.from_rotation_vector(rate * node * exposure_s / 2.0, "camera", "camera")
        np.testing.assert_allclose(xy[:, k], camera.project(turn.apply(vectors)), atol=1e-10)


def test_rows_do_not_know_which_trials_ran_before():
    scenario = Scenario.load("cubesat_ideal", SMALL)
    one, other = TrialRunner(scenario), TrialRunner(scenario)
    forward = {index: one.run(index) for index in (0, 1, 2, 3)}
    backward = {index: other.run(index) for index in (3, 1, 2, 0)}
    for index, row in forward.items():
        for name, value in row.items():
            if not name.endswith("_ms"):
                np.testing.assert_equal(backward[index][name], value, f"{index} {name}")  # NaN equals NaN
