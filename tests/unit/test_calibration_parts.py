"""Parts of a calibration with exact answers: images that agree, changes that are applied, errors of a lens."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from startracker import Camera, Observer
from startracker.calibration import StarField
from startracker.calibration.applied import applied_change
from startracker.calibration.consensus import FocalLengths, agreeing, repeated
from startracker.calibration.field import SkyPart, pair_up, sky_part
from startracker.calibration.known import KnownField, starting_camera
from startracker.calibration.residual_field import FIELD_TERMS, ResidualField, field_columns
from startracker.calibration.result import CalibratedField, Calibration
from startracker.calibration.star_memory import StarMemory
from startracker.catalog import load_catalog
from startracker.geometry.attitude import Attitude
from startracker.geometry.distortion import Distortion

CAMERA = Camera.from_fov(10.0, 1000, 800)


# ---------------------------------------------------------------------- images that agree
def test_images_agree_within_their_errors_or_the_tolerance():
    """5 σ, and at least what refraction explains, or an unknown distortion as long as the lens is not known."""
    among = np.array([True, True, True, True, False, False, True])
    off = np.array([0.0, 5.9e-4, -6.1e-4, 4.9e-3, 3.9e-3, 4.1e-3, 0.0])
    sigma = np.array([1e-5, 1e-5, 1e-5, 1e-3, 1e-5, 1e-5, np.inf])
    # the median of the first four is 2.95e-4
    expected = [True, True, False, True, False, False, False]
    assert agreeing(FocalLengths(off, sigma), among, lens_known=True).tolist() == expected
    two = FocalLengths(np.array([0.0, 1.19e-3, 1.21e-3]), np.full(3, 1e-5))
    assert agreeing(two, np.array([True, True, False]), lens_known=True).tolist() == [True, True, False]
    rough = FocalLengths(np.array([0.0, 7.9e-3, 8.1e-3]), np.full(3, 1e-5))
    assert agreeing(rough, np.array([True, True, False]), lens_known=False).tolist() == [True, True, False]
    wide = FocalLengths(np.array([0.0, 0.0, 4.9e-3, 5.1e-3]), np.array([1e-5, 1e-5, 1e-3, 1e-3]))
    assert agreeing(wide, np.ones(4, bool), lens_known=True).tolist() == [False, False, True, True]
    most = np.array([True, True, False, False])
    assert agreeing(wide, most, lens_known=True).tolist() == [True, True, True, False]
    assert not agreeing(two, np.zeros(3, bool), lens_known=True).any()


def star_field(xy):
    return StarField("image", np.asarray(xy, dtype=float), 1000, 800)


def test_copies_have_the_same_centroids_whatever_else_differs():
    rng = np.random.default_rng(1)
    xy = rng.uniform(0.0, 800.0, (40, 2))
    again = xy + 1e-4
    again[36:] += 50.0  # nine tenths are enough
    fields = [star_field(part) for part in (xy, xy + 0.05, again, xy[:37], xy[:35], np.empty((0, 2)), xy + 0.05)]
    assert repeated(fields) == {2: 0, 3: 0, 6: 1}
    again[35:] += 50.0
    assert repeated([star_field(xy), star_field(again)]) == {}
    assert repeated([star_field(np.empty((0, 2)))] * 2) == {}


# ---------------------------------------------------------------------- what is applied
@pytest.mark.parametrize("sigmas", [0.0, 1.0, 3.0, 3.5, 6.0])
def test_a_single_change_is_weighed_by_savage_and_dickeys_ratio(sigmas):
    """Unchanged: the ratio of the posterior to the prior density at no change; changed: odds of 0.01."""
    prior, sigma = 4e-6, 1e-4
    change = np.array([sigmas * sigma])
    unchanged = norm.pdf(0.0, change[0], sigma) / norm.pdf(0.0, 0.0, math.sqrt(prior))
    expected = change * 0.01 / (0.01 + unchanged)
    found = applied_change(("f",), change, np.array([[sigma**2]]), np.array([prior]))
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-300)


def test_two_changes_are_the_mean_over_which_of_them_changed():
    """The second one costs a tenth of the odds; what stays fixed takes its correlated share off the other."""
    prior = np.array([1.0, 9.0])
    change, covariance = np.array([0.12, -0.5]), np.array([[0.0016, 0.0012], [0.0012, 0.0225]])
    density = norm(0.0, np.sqrt(prior)).pdf(0.0)
    both = multivariate_normal(change, covariance).pdf([0.0, 0.0]) / np.prod(density)
    alone = norm(change, np.sqrt(np.diag(covariance))).pdf(0.0) / density
    shares = [(both, [0.0, 0.0])]
    for k in range(2):  # only k changed
        other = 1 - k
        mean = np.zeros(2)
        mean[k] = change[k] - covariance[k, other] / covariance[other, other] * change[other]
        shares.append((0.01 * alone[other], mean))
    shares.append((0.001, change))
    total = sum(weight for weight, _ in shares)
    expected = sum(weight / total * np.asarray(mean) for weight, mean in shares)
    np.testing.assert_allclose(applied_change(("f", "cx"), change, covariance, prior), expected, rtol=1e-10)


# ---------------------------------------------------------------------- one image
def test_pairs_of_another_brightness_are_mismatches():
    """Magnitudes from the median zero point; NaN places are not on the image, and few stars say nothing."""
    predicted = np.array([[10.0, 10.0], [20.0, 10.0], [30.0, 10.0], [np.nan, 5.0], [40.0, 10.0], [50.0, 10.0]])
    v_mag = np.array([1.0, 2.0, 3.0, 1.0, 4.0, 5.0])
    xy = predicted[[0, 1, 2, 4, 5]] + 0.5
    flux = 10.0 ** (-0.4 * (v_mag[[0, 1, 2, 4, 5]] + 7.0))
    gate = np.full(5, 1.0)
    pairs, unlike = pair_up(xy, flux, predicted, v_mag, gate, 0.5)
    assert (pairs.tolist(), unlike) == ([[0, 0], [1, 1], [2, 2], [3, 4], [4, 5]], 0)
    for factor, kept in ((10.0 ** (0.4 * 0.49), 5), (10.0 ** (0.4 * 0.51), 4), (10.0 ** (-0.4 * 0.51), 4)):
        changed = flux.copy()
        changed[3] *= factor
        pairs, unlike = pair_up(xy, changed, predicted, v_mag, gate, 0.5)
        assert (len(pairs), unlike) == (kept, 5 - kept)
        assert kept == 5 or 3 not in pairs[:, 0]
        four = pair_up(xy[1:], changed[1:], predicted, v_mag, gate[1:], 0.5)
        assert (len(four[0]), four[1]) == (4, 0)
        assert len(pair_up(xy, None, predicted, v_mag, gate, 0.5)[0]) == 5


def test_stars_around_a_field_are_those_within_a_tenth_of_it():
    catalog = load_catalog("hipparcos")
    attitude = Attitude.from_radec_roll(83.0, 0.0, 10.0).as_matrix()
    observer = Observer(2025.0, np.array([0.0, 30.0, 0.0]))
    reach = 1.1 * CAMERA.half_diagonal_rad + math.radians(0.1)
    part = sky_part(catalog, None, attitude, CAMERA)
    inside = np.count_nonzero(catalog.directions(catalog.epoch_jyear) @ attitude[2] >= math.cos(reach))
    assert 0.9 * inside < len(part.catalog) <= inside
    farthest = np.arccos(np.min(part.directions @ attitude[2]))
    assert reach - math.radians(0.1) < farthest <= reach
    np.testing.assert_array_equal(part.directions, part.catalog.directions(catalog.epoch_jyear))
    moved = sky_part(catalog, observer, attitude, CAMERA)
    still = sky_part(catalog, replace(observer, velocity_km_s=None), attitude, CAMERA)
    np.testing.assert_array_equal(still.directions, part.catalog.directions(2025.0))
    # towards the velocity by v/c sin θ
    angle = np.arccos(np.clip(np.sum(moved.directions * still.directions, axis=1), -1.0, 1.0))
    expected = 30.0 / 299792.458 * np.sqrt(1.0 - still.directions[:, 1] ** 2)
    np.testing.assert_allclose(angle, expected, rtol=1e-3, atol=2e-8)
    assert (moved.directions[:, 1] > still.directions[:, 1]).all()
    whole = sky_part(catalog, None, attitude, replace(CAMERA, fx=100.0, fy=100.0, projection="equidistant"))
    assert np.min(whole.directions @ attitude[2]) < -0.99


def known(sigma_px=None, focal=CAMERA.fx, k1=0.0):
    catalog = load_catalog("hipparcos")
    part = catalog.select(np.arange(5))
    variance = None if sigma_px is None else np.full(3, sigma_px**2)
    field = StarField("image", np.arange(6.0).reshape(3, 2), 1000, 800, variance_px2=variance)
    camera = replace(CAMERA, fx=focal, fy=focal, distortion=Distortion(k1=k1))
    pairs = np.array([[2, 4], [0, 1]])
    return KnownField(field, camera, np.eye(3), SkyPart(part, part.directions(2000.0)), pairs)


def test_errors_of_an_identified_image():
    """Of the centroid, the catalogue and the floor; 0.1 px if nothing is stated."""
    for sigma_px, own in ((0.3, 0.3), (None, 0.1)):
        one = known(sigma_px)
        catalogue = one.sky.catalog.position_sigma_rad / CAMERA.pixel_rad
        np.testing.assert_allclose(one.sigma(0.4), math.sqrt(own**2 + 0.4**2 + catalogue**2) * np.ones(3))
    blurred = replace(known(0.3), camera=replace(CAMERA, fx=1e9, fy=1e9))
    assert blurred.sigma()[0] > 0.31
    matches = known(0.3).matches(floor_px=0.4)
    np.testing.assert_array_equal(matches.xy, [[4.0, 5.0], [0.0, 1.0]])
    np.testing.assert_array_equal(matches.directions, known().sky.directions[[4, 1]])
    np.testing.assert_allclose(matches.sigma_px, known(0.3).sigma(0.4)[:2])


def test_the_camera_to_start_from_is_the_median_of_those_of_the_images():
    fields = [known(focal=focal, k1=k1) for focal, k1 in ((900.0, 0.3), (1000.0, -0.1), (5000.0, 0.1))]
    pinhole = starting_camera(fields, "pinhole")
    assert (pinhole.fx, pinhole.fy, pinhole.distortion.k1, pinhole.projection) == (1000.0, 1000.0, 0.1, "pinhole")
    fisheye = starting_camera(fields, "fisheye")
    assert fisheye.distortion.k1 == pytest.approx(0.1 + 1.0 / 3.0)
    assert fisheye.projection == "fisheye"


# ---------------------------------------------------------------------- the result
def result(names, covariance, residuals=((3.0, 4.0), (0.0, 1.0), (1.0, 0.0)), sigma=(0.1, 0.2, 0.3)):
    camera = replace(CAMERA, fx=1000.0, fy=1010.0, cx=480.0, cy=390.0, distortion=Distortion(k1=-0.1, p1=1e-3))
    fields = tuple(
        CalibratedField(
            "image",
            Attitude([0.0, 0.0, 0.0, 1.0]),
            np.eye(3),
            np.zeros((len(rows), 2)),
            np.zeros(len(rows), np.int64),
            np.zeros(len(rows)),
            np.array(rows),
            np.array(errors),
            rejected,
            9,
            np.zeros(2),
        )
        for rows, errors, rejected in ((residuals[:2], sigma[:2], 2), (residuals[2:], sigma[2:], 3))
    )
    return Calibration(camera, names, covariance, fields, (), 0.0, 1.0, 1, 2000.0)


def test_sums_over_all_images():
    found = result(("f",), np.eye(1) * 1e-6)
    assert (found.stars, found.rejected) == (3, 5)
    assert found.rms_px == pytest.approx(math.sqrt((25.0 + 1.0 + 1.0) / 3.0))
    assert found.fields[0].rms_px == pytest.approx(math.sqrt(13.0))
    weights = np.array([100.0, 25.0, 100.0 / 9.0])
    assert found.weighted_rms_px == pytest.approx(math.sqrt(weights @ [25.0, 1.0, 1.0] / weights.sum()))
    assert found.well_measured().tolist() == [True, True, False]
    assert found.rms_arcsec == pytest.approx(found.rms_px * math.degrees(found.camera.pixel_rad) * 3600.0)


def test_standard_errors_of_both_focal_lengths():
    """fx = f (1 − a/2), fy = f (1 + a/2): the errors of f and a together, with their covariance."""
    covariance = np.diag([1e-6, 4e-6, 0.25, 0.04])
    covariance[0, 1] = covariance[1, 0] = 8e-7
    values = result(("f", "aspect", "cx", "k1"), covariance).values()
    assert values["fx"] == (1000.0, pytest.approx(1000.0 * math.sqrt(1e-6 + 1e-6 - 8e-7)), "px")
    assert values["fy"] == (1010.0, pytest.approx(1010.0 * math.sqrt(1e-6 + 1e-6 + 8e-7)), "px")
    assert values["cx"] == (480.0, 0.5, "px")
    assert values["cy"] == (390.0, 0.0, "px")
    assert values["k1"] == (-0.1, pytest.approx(0.2), "")
    assert list(values) == ["fx", "fy", "cx", "cy", "k1"]
    square = result(("f", "p1"), np.diag([1e-6, 9e-8])).values()
    assert square["fx"][1] == pytest.approx(1.0)
    assert square["fy"][1] == pytest.approx(1.01)
    assert square["p1"] == (1e-3, pytest.approx(3e-4), "")


# ---------------------------------------------------------------------- memory of stars, and the displacement field
def test_residuals_of_a_star_fade_and_long_ones_are_cut():
    """Weights 1/σ² of one hundredth less at each new one; a residual counts for at most five standard errors."""
    memory = StarMemory(2, 1e-6)
    assert memory.rows(np.array([7, 9, 7])).tolist() == [0, 1, 0]
    assert memory.rows(np.array([11, 9])).tolist() == [2, 1]
    sigma, lens = 3e-6, 4e-6
    sums, weights, squares = np.zeros(3), 0.0, 0.0
    for k, residual in enumerate([2e-6, -1e-6, 1e-3]):
        memory.add_residuals(np.array([1]), np.array([[0.0, residual, 0.0]]), np.array([sigma]), np.array([lens]))
        kept = min(abs(residual), 25e-6) * np.sign(residual)  # five times 5e-6
        sums = 0.99 * sums + np.array([0.0, kept, 0.0]) / sigma**2
        weights, squares = 0.99 * weights + sigma**-2, 0.99**2 * squares + sigma**-2
        np.testing.assert_allclose(memory._sum[1], sums)
        np.testing.assert_allclose(memory._weight[1, :2], [weights, squares])
        np.testing.assert_allclose(memory._weight[1, 3], lens**2)
        assert memory.sightings(np.array([0, 1])) == pytest.approx([0.0, sum(0.99**i for i in range(k + 1))])
    assert (memory._sum[[0, 2]] == 0.0).all()


@pytest.mark.parametrize(("share", "trusted"), [(0.99, True), (1.01, False)])
def test_a_star_that_stays_off_is_not_used(share, trusted):
    """χ² of its mean residual above 13.8, with noise, lens and constant errors; tested from five sightings on."""
    memory, sigma, lens = StarMemory(1, 2e-6), 3e-6, 1e-6
    rows = memory.rows(np.array([5]))
    for count in range(1, 9):
        weights = 0.99 ** np.arange(count)
        noise2 = sigma**2 * np.sum(weights**2) / np.sum(weights) ** 2
        off = share * math.sqrt(13.8 * (noise2 + lens**2 + (2e-6) ** 2))
        single = StarMemory(1, 2e-6)
        rows = single.rows(np.array([5]))
        for _ in range(count):
            single.add_residuals(rows, np.array([[off, 0.0, 0.0]]), np.array([sigma]), np.array([lens]))
        # below five fading sightings nothing is said: the sixth reaches them
        assert single.trusted(rows).tolist() == [trusted or count < 6]
    assert memory.trusted(memory.rows(np.array([5, 6]))).all()


def test_constant_errors_of_stars_are_followed_through_the_lens():
    """S ← M S + ∂, and the covariance is the sum over stars and axes."""
    rng = np.random.default_rng(3)
    memory, slopes = StarMemory(2, 1e-6), np.zeros((3, 2, 3))
    rows = memory.rows(np.array([1, 2, 3]))
    for used in ([0, 1], [1, 2], [2]):
        update, added = rng.normal(size=(2, 2)), rng.normal(size=(len(used), 2, 3))
        memory.follow(update, rows[used], added)
        slopes = np.einsum("pq,jqk->jpk", update, slopes)
        slopes[used] += added
        expected = 1e-12 * np.einsum("jpk,jqk->pq", slopes, slopes)
        np.testing.assert_allclose(memory.covariance, expected)


def test_displacements_of_a_field_are_orthogonal_and_of_one_size():
    """Over the pixels of an image, up to the grid: 1 on one axis, and no constant, rotation or scale among them."""
    camera = Camera.from_fov(10.0, 120, 80)
    y, x = np.mgrid[:80, :120]
    xy = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    columns = field_columns(camera, xy)
    assert columns.shape == (9600, 2, FIELD_TERMS)
    products = np.einsum("mik,mil->kl", columns, columns) / len(xy)
    expected = np.eye(FIELD_TERMS)
    expected[0, 0] = expected[1, 1] = 2.0  # on both axes
    np.testing.assert_allclose(products, expected, atol=5e-3)
    u, v = (2.0 * (xy - [59.5, 39.5]) / [120, 80]).T
    nothing = np.zeros_like(u)
    for one in ([u, v], [-v, u], [np.ones_like(u), nothing], [nothing, np.ones_like(u)]):
        along = np.einsum("mik,im->k", columns, np.array(one)) / len(xy)
        np.testing.assert_allclose(along, 0.0, atol=5e-3)
    np.testing.assert_allclose(columns[:, :, 0], math.sqrt(3.0) * np.column_stack([u, -v]))


def test_the_size_of_a_displacement_that_nothing_is_known_of():
    """The mean over eleven sizes, each half of the one before, with equal probability; without one there are none."""
    field = ResidualField(2, 0.4)
    assert field.rms_px == pytest.approx(0.4 * math.sqrt(np.mean(0.25 ** np.arange(11))))
    assert (field.mean == 0.0).all()
    none = ResidualField(2, 0.0)
    assert (none.terms, none.rms_px) == (0, 0.0)
