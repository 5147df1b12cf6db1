"""The fitted camera, the index of patterns and the calls for an unknown focal length."""

import math
from dataclasses import replace

import numpy as np
import pytest

from startracker import Attitude, Camera, InputError, Status, solve_unknown_fov
from startracker.geometry.distortion import Distortion
from startracker.identification.unknown_scale.free_scale import fit_camera
from startracker.identification.unknown_scale.quads import (
    QuadIndex,
    all_stars,
    build_quads,
    neighbour_quads,
    pack_quads,
    quad_index,
    sky_codes,
    unpack_quads,
)


def stars_of(camera, attitude, count=800):
    guide = all_stars("hipparcos").brightest(count)
    index, vectors, xy = guide.in_field(attitude.as_matrix(), 0.0, camera)
    return guide.directions[index], vectors, xy, 10.0 ** (-0.4 * guide.v_mag[index])


def test_fit_camera_gives_back_what_made_the_image():
    truth = replace(Camera.from_fov(40.0, 1024, 768, Distortion(k1=-0.12)), parity=-1)
    attitude = Attitude.from_radec_roll(30.0, 50.0, 77.0)
    directions, _, xy, _ = stars_of(truth, attitude)
    start = replace(Camera.from_fov(41.0, 1024, 768), parity=-1)
    off = Attitude.from_rotation_vector([0.01, -0.02, 0.015], "camera", "camera") @ attitude
    camera, matrix, covariance, rms = fit_camera(start, off.as_matrix(), directions, xy, with_k1=True)
    assert camera.fx == pytest.approx(truth.fx, rel=1e-4)
    # held near zero by its prior a little: 0.12/0.5² against the stars' weight
    assert camera.distortion.k1 == pytest.approx(-0.12, abs=1e-3)
    assert math.degrees(attitude.angle_to(Attitude.from_matrix(matrix))) < 1e-3
    assert rms < 0.05
    assert np.all(np.linalg.eigvalsh(covariance) > 0)


def test_fit_camera_covariance_is_that_of_repeated_noise():
    truth = Camera.from_fov(15.0, 800, 800)
    attitude = Attitude.from_radec_roll(85.0, 5.0, 10.0)
    directions, _, xy, _ = stars_of(truth, attitude, 3000)
    rng = np.random.default_rng(9)
    errors, stated = [], []
    for _ in range(200):
        noisy = xy + rng.normal(0, 0.3, xy.shape)
        _, matrix, covariance, _ = fit_camera(truth, attitude.as_matrix(), directions, noisy, with_k1=True)
        errors.append(attitude.rotation_vector_to(Attitude.from_matrix(matrix)))
        stated.append(np.diag(covariance))
    # a sample variance of 200 is good to √(2/200) = 0.1; 4 of these
    np.testing.assert_allclose(np.var(errors, axis=0) / np.mean(stated, axis=0), 1.0, atol=0.4)


def test_fit_camera_refuses_what_no_lens_does():
    camera = Camera.from_fov(30.0, 500, 500)
    directions, _, xy, _ = stars_of(camera, Attitude.from_radec_roll(85.0, 5.0, 10.0), 2000)
    centre = np.array([249.5, 249.5])
    folded = centre + (xy - centre) * (1.0 - 8.0 * np.sum(((xy - centre) / camera.fx) ** 2, axis=1, keepdims=True))
    *_, rms = fit_camera(camera, Attitude.from_radec_roll(85.0, 5.0, 10.0).as_matrix(), directions, folded, True)
    assert rms > 1.0


def test_neighbour_quads_are_sets_of_four_neighbours():
    rng = np.random.default_rng(2)
    vectors = rng.normal(size=(30, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    index = np.arange(0, 30, 2)
    quads = neighbour_quads(vectors, index)
    assert set(quads.ravel()) <= set(index)
    assert all(len(set(q)) == 4 for q in quads)
    assert len({tuple(sorted(q)) for q in quads}) == len(quads)
    near = {int(i): set(index[np.argsort(-vectors[index] @ vectors[i])[:7]].tolist()) for i in index}
    assert all(any(set(q) <= near[int(i)] for i in q) for q in quads.tolist())
    assert len(neighbour_quads(vectors, index[:3])) == 0
    assert len(neighbour_quads(vectors, index[:4])) == 1


def test_candidates_are_those_of_brute_force():
    rng = np.random.default_rng(6)
    directions = rng.normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    index = QuadIndex.of(*build_quads(directions, (10.0, 14.0)))
    codes = index.codes[::200].astype(float) + 0.002
    tolerance = np.full(len(codes), 0.05)
    low, high = index.baseline_rad[::200] * 0.9, index.baseline_rad[::200] * 1.1
    query, found, distance = index.candidates(codes, tolerance, low, high)
    every = np.linalg.norm(index.codes[None] - codes[:, None], axis=2)
    fits = (every <= 0.05) & (index.baseline_rad >= low[:, None]) & (index.baseline_rad <= high[:, None])
    assert sorted(zip(query.tolist(), found.tolist(), strict=True)) == sorted(map(tuple, np.argwhere(fits).tolist()))
    assert np.all(np.diff(distance) >= 0)
    # and the codes are those of the stars they name
    again, _, angle = sky_codes(directions, index.quads[::200].astype(np.int64))
    np.testing.assert_allclose(again, index.codes[::200], atol=1e-6)
    np.testing.assert_allclose(angle, index.baseline_rad[::200], rtol=1e-6)


def test_a_packed_index_is_the_same_index():
    rng = np.random.default_rng(16)
    directions = rng.normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    codes, quads, baseline_rad = build_quads(directions, (10.0, 14.0))
    index = unpack_quads(pack_quads(codes, quads), directions)
    np.testing.assert_array_equal(index.quads, quads)
    np.testing.assert_allclose(index.codes, codes, rtol=0, atol=2**-16 + 1e-7)
    # the difference of two single-precision unit vectors, 1e-7, over the shortest angle
    np.testing.assert_allclose(index.baseline_rad, baseline_rad, rtol=0, atol=3e-7)
    # numbers beyond 16 bits
    far = np.array([[65535, 65536, 131_072, 200_000]], dtype=np.int32)
    places = np.zeros((200_001, 3))
    places[:, 2] = 1.0
    np.testing.assert_array_equal(unpack_quads(pack_quads(codes[:1], far), places).quads, far)
    # all shapes there are fit in
    assert codes.min() > -0.45
    assert codes.max() < 1.45


def test_the_index_covers_the_sky_at_every_size():
    index = quad_index("hipparcos")
    directions = all_stars("hipparcos").directions
    baseline = np.degrees(index.baseline_rad)
    for low, high in ((0.8, 2.0), (2.0, 5.0), (5.0, 12.0), (12.0, 30.0)):
        chosen = (baseline > low) & (baseline < high)
        middle = directions[index.quads[chosen, 0]]
        octant = (middle > 0) @ np.array([1, 2, 4])
        assert np.bincount(octant, minlength=8).min() > 50


@pytest.mark.parametrize("fov_deg", [5.0, 12.0, 30.0, 60.0])
@pytest.mark.parametrize("parity", [1, -1])
def test_any_field_and_parity_is_solved(fov_deg, parity):
    camera = replace(Camera.from_fov(fov_deg, 1000, 800), parity=parity)
    attitude = Attitude.from_radec_roll(95.0, 12.0, 200.0)
    count = int(min(40_000, 40 * 41_253 / (fov_deg**2 * 0.8)))
    _, _, xy, flux = stars_of(camera, attitude, count)
    solution = solve_unknown_fov(xy, 1000, 800, flux=flux)
    assert solution.solved, solution.reason
    assert solution.parity == parity
    assert solution.fov_deg == pytest.approx(fov_deg, rel=1e-3)
    assert math.degrees(attitude.angle_to(solution.attitude)) < 1e-3 * fov_deg
    assert np.abs(solution.stars.residual_px).max() < 0.5
    np.testing.assert_allclose(
        solution.camera.project(solution.attitude.apply(all_stars("hipparcos").directions[:5])).shape, (5, 2)
    )
    assert solve_unknown_fov(xy, 1000, 800, flux=flux, parity=-parity).status is not Status.SOLVED


def test_a_field_of_view_elsewhere_is_no_match():
    camera = Camera.from_fov(12.0, 1000, 800)
    _, _, xy, flux = stars_of(camera, Attitude.from_radec_roll(95.0, 12.0, 200.0), 8000)
    assert solve_unknown_fov(xy, 1000, 800, flux=flux, fov_deg=12.3, fov_error=0.05).solved
    assert not solve_unknown_fov(xy, 1000, 800, flux=flux, fov_deg=20.0, fov_error=0.05).solved


def test_few_stars_and_empty_images_have_their_status():
    assert solve_unknown_fov(np.zeros((5, 2)) + np.arange(5)[:, None] * 9, 100, 100).status is Status.TOO_FEW_STARS
    assert solve_unknown_fov(np.empty((0, 2)), 100, 100).status is Status.NO_STARS
    assert solve_unknown_fov(np.zeros((60, 80))).status is Status.NO_STARS
    assert solve_unknown_fov(np.zeros((60, 80, 3))).status is Status.BAD_IMAGE
    assert solve_unknown_fov(np.full((60, 80), 255, np.uint8)).status is Status.SATURATED


def test_mistakes_of_the_caller_are_one_clear_line():
    xy = np.zeros((9, 2))
    for wrong, says in (
        ({"fov_deg": 0.0}, "field of view"),
        ({"fov_deg": float("nan")}, "field of view"),
        ({"fov_error": 2.0}, "fov_error"),
        ({"parity": 0}, "parity"),
    ):
        with pytest.raises(InputError, match=says):
            solve_unknown_fov(xy, 100, 100, **wrong)
    with pytest.raises(InputError, match="width and the height"):
        solve_unknown_fov(xy, 100)
    with pytest.raises(InputError, match="size"):
        solve_unknown_fov(xy, 0, 100)


def test_a_strong_barrel_is_solved():
    # an action camera: k1 r² = -0.1 at the corner, shapes there 20 % narrower than they are
    camera = Camera.from_fov(62.0, 1280, 960, Distortion(k1=-0.18))
    rng = np.random.default_rng(4)
    for attitude in (Attitude.from_radec_roll(95.0, 12.0, 20.0), Attitude.from_radec_roll(280.0, 20.0, 100.0)):
        _, _, xy, flux = stars_of(camera, attitude, 900)
        xy = xy + rng.normal(0, 0.5, xy.shape)
        solution = solve_unknown_fov(xy, 1280, 960, flux=flux)
        assert solution.solved, solution.reason
        assert math.degrees(attitude.angle_to(solution.attitude)) < 0.05
        assert solution.camera.distortion.k1 == pytest.approx(-0.18, abs=0.02)


def test_a_fisheye_is_solved_from_what_is_known_roughly():
    truth = Camera.from_fov(120.0, 1200, 1000, Distortion(k1=0.02), projection="fisheye")
    attitude = Attitude.from_radec_roll(95.0, 12.0, 200.0)
    _, _, xy, flux = stars_of(truth, attitude, 500)
    rough = replace(truth, fx=1.02 * truth.fx, fy=1.02 * truth.fy, distortion=Distortion())
    solution = solve_unknown_fov(xy, 1200, 1000, flux=flux, camera=rough)
    assert solution.solved, solution.reason
    assert math.degrees(attitude.angle_to(solution.attitude)) < 0.01
    assert solution.camera.fx == pytest.approx(truth.fx, rel=1e-3)


def test_decentred_distortion_is_fitted_and_weights_are_used():
    truth = Camera.from_fov(40.0, 1600, 1200, Distortion(k1=-0.1, p1=3e-3, p2=-2e-3))
    attitude = Attitude.from_radec_roll(95.0, 12.0, 200.0)
    _, _, xy, flux = stars_of(truth, attitude, 3000)
    rng = np.random.default_rng(7)
    sigma = np.where(np.arange(len(xy)) % 3 == 0, 1.0, 0.1)
    noisy = xy + rng.normal(size=xy.shape) * sigma[:, None]
    weighed = solve_unknown_fov(noisy, 1600, 1200, flux=flux, variance_px2=sigma**2)
    plain = solve_unknown_fov(noisy, 1600, 1200, flux=flux)
    assert weighed.solved
    assert weighed.camera.distortion.p1 == pytest.approx(3e-3, abs=2e-4)
    assert weighed.camera.distortion.p2 == pytest.approx(-2e-3, abs=2e-4)
    assert np.trace(weighed.covariance) < np.trace(plain.covariance)
    # six standard errors about each axis, for three of them
    off = attitude.rotation_vector_to(weighed.attitude)
    assert off @ np.linalg.solve(weighed.covariance, off) < 25.0


def test_mistakes_about_rough_camera_and_variances():
    camera = Camera.from_fov(12.0, 100, 100)
    xy = np.random.default_rng(1).uniform(0, 99, (9, 2))
    with pytest.raises(InputError, match="not both"):
        solve_unknown_fov(xy, 100, 100, camera=camera, fov_deg=12.0)
    with pytest.raises(InputError, match="the camera has 100×100"):
        solve_unknown_fov(xy, 120, 100, camera=camera)
    with pytest.raises(InputError, match="9 centroids, but 8 variances"):
        solve_unknown_fov(xy, 100, 100, variance_px2=np.ones(8))
    with pytest.raises(InputError, match="positive"):
        solve_unknown_fov(xy, 100, 100, variance_px2=np.zeros(9))
