"""The benchmark's scenes are what they say: noise, attitudes, numbers of stars, and the same again for the same key."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from benchmarks import oracle
from benchmarks.cases import CASES, matching
from benchmarks.scenes import SIZE_PX, Case, SceneMaker, sky
from benchmarks.score import wrong_limits_rad
from startracker import Camera
from startracker.geometry.attitude import rotation_vector_to_matrix

N = 2000


@pytest.fixture(scope="module")
def maker():
    return SceneMaker(Case("test", noise_px=0.3, false_stars=3, dropped=0.2))


@pytest.fixture(scope="module")
def scenes(maker):
    return [maker.scene(index) for index in range(N)]


def test_a_scene_is_the_same_alone_as_in_a_run(maker, scenes):
    alone = SceneMaker(maker.case).scene(1234)
    for name in ("xy", "flux", "star", "matrix"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(scenes[1234], name))


def test_case_seed_and_index_each_key_a_stream(maker, scenes):
    others = [
        SceneMaker(Case("test 2", noise_px=0.3, false_stars=3, dropped=0.2)).scene(7),
        SceneMaker(maker.case, seed=2).scene(7),
        scenes[8],
    ]
    assert all(not np.allclose(other.matrix, scenes[7].matrix, atol=1e-3) for other in others)


def test_matrices_are_rotations(scenes):
    for scene in scenes[:50]:
        np.testing.assert_allclose(scene.matrix @ scene.matrix.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(scene.matrix) == pytest.approx(1.0)


def test_attitudes_are_uniform(scenes):
    """Each element of a uniform rotation is uniform in [-1, 1] (Archimedes); the angle has density (1 − cos)/π.

    Kolmogorov–Smirnov, each at 1e-4: ten tests fail by chance once in a thousand seeds, and the seed is fixed.
    """
    elements = np.array([scene.matrix for scene in scenes])
    for row in range(3):
        for column in range(3):
            assert stats.kstest(elements[:, row, column], stats.uniform(-1, 2).cdf).pvalue > 1e-4
    angle = np.arccos(np.clip((np.trace(elements, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert stats.kstest(angle, lambda a: (a - np.sin(a)) / np.pi).pvalue > 1e-4


def test_centroid_noise(maker, scenes):
    """rms over M values is σ (1 ± 1/√(2M)); mean 0 ± σ/√M; 4 standard errors. The camera's own map makes the truth."""
    offsets = []
    for scene in scenes:
        true = scene.star >= 0
        vectors = maker.directions[scene.star[true]] @ scene.matrix.T
        offsets.append(scene.xy[true] - maker.camera.project(vectors))
    values = np.concatenate(offsets).ravel()
    assert np.std(values) == pytest.approx(0.3, rel=4 / math.sqrt(2 * len(values)))
    assert abs(np.mean(values)) < 4 * 0.3 / math.sqrt(len(values))


def test_magnitude_noise(maker, scenes):
    noise = np.concatenate(
        [
            -2.5 * np.log10(scene.flux[scene.star >= 0]) - maker.catalog.v_mag[scene.star[scene.star >= 0]]
            for scene in scenes
        ]
    )
    assert np.std(noise) == pytest.approx(0.1, rel=4 / math.sqrt(2 * len(noise)))


def test_brightest_first_and_inside(maker, scenes):
    for scene in scenes:
        assert np.all(np.diff(scene.flux) <= 0)
        assert maker.camera.contains(scene.xy).all()


@pytest.mark.parametrize(("fov_deg", "limit", "stars"), [(10.0, 6.0, 11), (10.0, 6.5, 19), (20.0, 5.5, 25)])
def test_mean_number_of_stars_as_the_peers_had_it(fov_deg, limit, stars):
    """Mean = stars of the sky × solid angle of the field / 4π: exact for uniform attitudes.

    The solid angle of a square pyramid of full angle a is 4 arcsin(sin²(a/2)).
    """
    solid_angle = 4 * math.asin(math.sin(math.radians(fov_deg / 2)) ** 2)
    mean = len(sky(fov_deg, limit)) * solid_angle / (4 * math.pi)
    assert round(mean) == stars
    case = Case("mean number", fov_deg=fov_deg, magnitude_limit=limit, noise_px=0.0)
    maker = SceneMaker(case)
    counts = np.array([maker.scene(index).true_stars for index in range(N)])
    assert counts.mean() == pytest.approx(mean, abs=4 * counts.std() / math.sqrt(N))


def test_dropped_share_and_false_stars(maker, scenes):
    """The stars kept of the same fields, whole: binomial, so √(0.8·0.2/38,000) = 0.2 %; 4 standard errors."""
    assert all(np.count_nonzero(scene.star < 0) == 3 for scene in scenes)
    whole = SceneMaker(replace(maker.case, dropped=0.0))
    there = sum(whole.scene(index).true_stars for index in range(N))
    kept = sum(scene.true_stars for scene in scenes)
    assert kept / there == pytest.approx(0.8, abs=4 * math.sqrt(0.16 / there))


@pytest.mark.parametrize("name", ["10deg 6.5, 0.1 px", "10deg 6.5, focal length 1% wrong", "20deg 5.5, 0.1 px"])
def test_no_star_of_the_field_is_left_out(name):
    """Against all stars of the sky, one by one: those in front of the camera that fall on the image."""
    maker = SceneMaker(replace(CASES[name], noise_px=0.0))
    half = SIZE_PX / 2
    for index in range(200):
        scene = maker.scene(index)
        vectors = maker.directions @ scene.matrix.T
        ahead = vectors[:, 2] > 0
        offset = np.abs(scene.focal_px * vectors[:, :2] / vectors[:, 2:])
        assert set(np.flatnonzero(ahead & (offset < half).all(axis=1))) == set(scene.star)


def test_false_stars_are_spread_evenly_and_as_bright_as_stars(maker, scenes):
    places = np.concatenate([scene.xy[scene.star < 0] for scene in scenes])
    for axis in range(2):
        assert stats.kstest(places[:, axis], stats.uniform(-0.5, SIZE_PX).cdf).pvalue > 1e-4
    magnitude = np.concatenate([-2.5 * np.log10(scene.flux[scene.star < 0]) for scene in scenes])
    blurred = maker.catalog.v_mag + 0.1 * np.random.default_rng(1).standard_normal(len(maker.catalog))
    assert stats.ks_2samp(magnitude, blurred).pvalue > 1e-4


def test_no_two_true_stars_closer_than_the_camera_resolves():
    maker = SceneMaker(Case("doubles", noise_px=0.0))
    for index in range(300):
        xy = maker.scene(index).xy
        apart = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))[np.triu_indices(len(xy), 1)]
        assert apart.min(initial=math.inf) > 1.9  # a pixel at the corner is 0.8 % smaller; merging moves centres a bit


@pytest.mark.parametrize("case", [case for case in matching([]) if case.true_stars or case.brightest])
def test_exactly_six(case):
    assert all(SceneMaker(case).scene(index).true_stars == 6 for index in range(20))


def test_random_points_are_no_stars():
    for case in matching(["random"]):
        scene = SceneMaker(case).scene(3)
        assert len(scene.xy) == case.false_stars
        assert scene.true_stars == 0


def test_the_focal_length_is_wrong_both_ways():
    case = CASES["10deg 6.5, focal length 1% wrong"]
    maker = SceneMaker(case)
    factors = np.array([maker.scene(index).focal_px / maker.camera.fx for index in range(200)])
    np.testing.assert_allclose(np.unique(factors), [0.99, 1.01])
    assert 70 < np.count_nonzero(factors > 1) < 130  # binomial, 4.2 σ


# ------------------------------------------------------------------ the oracle
def _seen(rng, count=12, fov_deg=10.0):
    camera = Camera.from_fov(fov_deg, SIZE_PX, SIZE_PX)
    return camera, rng.uniform(0, SIZE_PX - 1, (count, 2))


def test_rotation_error_is_the_rotation_vector():
    for vector in ([1e-6, -2e-6, 3e-6], [0.3, -0.2, 1.0], [0.0, 0.0, 0.0]):
        got = oracle.rotation_error(np.eye(3), rotation_vector_to_matrix(np.array(vector)))
        np.testing.assert_allclose(got, vector, rtol=1e-9, atol=1e-15)
    assert np.linalg.norm(oracle.rotation_error(np.eye(3), np.diag([-1.0, -1.0, 1.0]))) == pytest.approx(math.pi)


@pytest.mark.parametrize("fit_focal", [False, True])
def test_bound_is_what_least_squares_scatters_by(fit_focal):
    """An independent Gauss–Newton fit (finite differences of the camera's own map) of 400 noisy frames.

    A variance over 400 samples is good to √(2/400) = 7 %, its root to 3.5 %; 4 standard errors.
    """
    rng = np.random.default_rng(3)
    camera, xy = _seen(rng)
    vectors = camera.unproject(xy)

    def pixels(unknown):
        turned = vectors @ rotation_vector_to_matrix(unknown[:3]).T
        return (xy_centre + math.exp(unknown[3]) * (camera.project(turned) - xy_centre)).T.ravel()

    xy_centre = np.array([camera.cx, camera.cy])
    step = 1e-6
    columns = np.stack([(pixels(step * row) - pixels(-step * row)) / (2 * step) for row in np.eye(4)], axis=1)
    columns = columns[:, : 4 if fit_focal else 3]
    errors = np.linalg.lstsq(columns, 0.1 * rng.standard_normal((24, 400)), rcond=None)[0]
    cross, roll = oracle.bound(vectors, camera.fx, 0.1, fit_focal=fit_focal)
    assert cross == pytest.approx(math.sqrt(np.mean(errors[0] ** 2 + errors[1] ** 2)), rel=0.14)
    assert roll == pytest.approx(math.sqrt(np.mean(errors[2] ** 2)), rel=0.14)


def test_wahba_finds_the_attitude():
    rng = np.random.default_rng(5)
    camera, xy = _seen(rng)
    observed = camera.unproject(xy)
    truth = rotation_vector_to_matrix(np.array([0.5, -1.0, 2.0]))
    np.testing.assert_allclose(oracle.wahba(observed, observed @ truth), truth, atol=1e-12)


def test_wrong_is_more_than_noise_explains():
    pixel = 3.4e-4
    assert wrong_limits_rad((1e-6, 1e-5), pixel) == (5 * pixel, math.radians(1.0))
    assert wrong_limits_rad((0.01, 0.1), pixel) == (0.1, 1.0)
    assert wrong_limits_rad((math.inf, math.inf), pixel) == (0.0, 0.0)  # one star or none: nothing to be right about
