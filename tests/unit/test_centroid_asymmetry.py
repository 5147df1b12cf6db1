"""Displacement of faint stars against bright ones by an asymmetric image: measured from the frame, and corrected."""

import numpy as np
import pytest
from scipy.special import erf

from startracker.centroid import maximum_likelihood
from startracker.centroid.asymmetry import (
    EXAMINED_ASYMMETRIC,
    Difference,
    correct_asymmetry,
    displaced_part,
    measure_difference,
    reference_psf,
    unknown_reference,
)
from startracker.centroid.psf_fit import _unexplained
from startracker.centroid.psf_kernel import Starts
from startracker.centroid.psf_model import gaussian_psf
from startracker.centroid.psf_shape import fit_gaussian
from startracker.centroid.window import Pixels
from startracker.detection import Background, Spots
from startracker.settings import CentroidSettings

SKEW = ((0.75, -0.25), (0.25, 0.75))
"""Share and offset along x, px, of the Gaussians of an asymmetric image."""
SYMMETRIC = ((1.0, 0.0),)
SIGMA, NOISE, GAIN = 0.45, 5.0, 1.0
SIDE, STEP = 7, 32


def frame(parts, seed=None, sigma=SIGMA):
    """Image, positions (49, 2) at all phases and fluxes, brightest first; with noise if a seed is given."""
    rng = np.random.default_rng(2)
    xy = np.stack(np.divmod(np.arange(SIDE**2), SIDE), axis=1) * STEP + STEP // 2 + rng.uniform(-0.5, 0.5, (SIDE**2, 2))
    flux, size = np.logspace(4.0, 2.4, SIDE**2), SIDE * STEP
    edges, image = np.arange(size + 1) - 0.5, np.zeros((size, size))
    for (x, y), f in zip(xy, flux, strict=True):
        down = 0.5 * np.diff(erf((edges - y) / sigma / np.sqrt(2.0)))
        for share, off in parts:
            image += f * share * down[:, None] * 0.5 * np.diff(erf((edges - x - off) / sigma / np.sqrt(2.0)))
    if seed is not None:
        image += np.random.default_rng(seed).normal(size=image.shape) * np.sqrt(NOISE**2 + image / GAIN)
    return image.astype(np.float32), xy, flux


def measured(image, xy, flux):
    """Centroids, and their positions in the order of `xy`."""
    x, y = np.rint(xy).astype(np.int64).T
    clear = np.zeros(len(x), bool)
    background = Background(np.zeros_like(image), np.full_like(image, NOISE))
    found = maximum_likelihood(
        image, background, Spots(x, y, flux, np.full(len(x), 12), clear, clear), CentroidSettings(), GAIN
    )
    return found, found.xy[np.hypot(*(xy[:, None] - found.xy[None]).transpose(2, 0, 1)).argmin(axis=1)]


def difference(image, xy, flux):
    """The measured difference, with a Gaussian that has the second moments of the image."""
    background = Background(np.zeros_like(image), np.full_like(image, NOISE))
    pixels = Pixels(image, background.level_plane, background.noise_plane, 1.0 / GAIN, 0.0)
    table = np.column_stack([xy, flux, np.full((len(xy), 3), 1e-3)])
    return measure_difference(
        pixels, gaussian_psf(SIGMA**2, SIGMA**2, radius_px=6.0), table, np.zeros(len(xy), bool), 2
    )


def test_the_part_of_a_contrast():
    """1 for faint stars, 0 at the reference, monotonic, continued beyond it with the other sign."""
    part = displaced_part(np.array([0.0, 1.0, 3.0, 10.0, 50.0, 300.0]))
    # fits of images with coma of 0.1 waves at f/4 with these weights: 1, 0.86, 0.69, 0.41, 0, −0.37
    np.testing.assert_allclose(part, [1.0, 0.86, 0.69, 0.41, 0.0, -0.37], atol=0.08)
    assert np.all(np.diff(part) < 0.0)


def test_a_symmetric_image_has_no_difference():
    found = difference(*frame(SYMMETRIC))
    assert np.abs(found.mean).max() < 1e-4
    assert found.asymmetric < 0.1


def test_a_symmetric_image_in_noise_is_left_alone():
    asymmetric = [difference(*frame(SYMMETRIC, seed)).asymmetric > EXAMINED_ASYMMETRIC for seed in range(60)]
    # fewer than one in ten; three binomial standard deviations of 6 in 60 are 7
    assert sum(asymmetric) <= 13


@pytest.mark.parametrize("turned", [False, True])
def test_faint_stars_are_where_bright_ones_are(turned):
    """An image narrower than its third moments need: faint stars lay 0.034 px beside bright ones."""
    image, xy, flux = frame(SKEW)
    if turned:  # along y
        image, xy = np.ascontiguousarray(image.T), xy[:, ::-1].copy()
    found, places = measured(image, xy, flux)
    along = (places - xy)[:, 1 if turned else 0]
    bright, faint = (flux > 3000.0) & (flux < 10000.0), flux < 600.0
    assert abs(along[bright].mean() - along[faint].mean()) < 0.02
    assert found.common_px2 is not None
    across = (places - xy)[:, 0 if turned else 1]
    assert abs(across.mean()) < 0.003


def common_ellipse(image, xy, half=3, contrast=0.0):
    """The Gaussian that the nine brightest stars have in common."""
    background = Background(np.zeros_like(image), np.full_like(image, NOISE))
    pixels = Pixels(image, background.level_plane, background.noise_plane, 1.0 / GAIN, 0.0)
    starts = Starts(xy[:, 0].copy(), xy[:, 1].copy(), np.full(len(xy), half), np.full(len(xy), np.inf))
    return fit_gaussian(pixels, starts, np.arange(9), half, (0.5, 0.5, 0.0), contrast)[0]


@pytest.mark.parametrize("contrast", [0.0, 50.0])
def test_the_common_ellipse_of_gaussians_is_theirs(contrast):
    image, xy, _ = frame(SYMMETRIC)
    # the nodes of the pixels' integrals: 3 along each axis
    np.testing.assert_allclose(common_ellipse(image, xy, contrast=contrast), [SIGMA**2, SIGMA**2, 0.0], atol=1e-3)


def test_the_width_of_undersampled_images_is_not_biased():
    """A star in the middle of a pixel does not show that its image is narrow, and fits of single stars then have none:
    their medians were too wide. Stars of a signal-to-noise ratio of 12 to 40."""
    image, xy, _ = frame(SYMMETRIC)
    found = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noisy = (0.04 * image + NOISE * rng.normal(size=image.shape)).astype(np.float32)
        found.append(common_ellipse(noisy, xy, half=2)[0])
    assert np.isfinite(found).all()
    assert np.mean(found) == pytest.approx(SIGMA**2, abs=4.0 * np.std(found) / np.sqrt(len(found)))


def test_an_orientation_that_pixels_do_not_resolve_is_left_out():
    """Coma along x is symmetric in y. At chance positions in the pixels the ellipses of nine narrow images were turned
    by the same sign, which moved all stars along y."""
    image, xy, _ = frame(((0.75, -0.12), (0.25, 0.36)))
    xx, yy, xy_ = common_ellipse(image, xy)
    assert xy_ == 0.0 or abs(xy_) < 0.01 * np.sqrt(xx * yy)


def prepared(image, xy, flux, sigma=SIGMA):
    """Pixels, a round Gaussian, and the table of fits of stars."""
    background = Background(np.zeros_like(image), np.full_like(image, NOISE))
    pixels = Pixels(image, background.level_plane, background.noise_plane, 1.0 / GAIN, 0.0)
    table = np.column_stack([xy, flux, np.full((len(xy), 3), 1e-3)])
    return pixels, gaussian_psf(sigma**2, sigma**2, radius_px=6.0), table, np.zeros(len(xy), bool)


def test_the_error_of_a_displacement_is_in_the_covariance():
    """What all stars share of it is returned, and what differs between bright and faint ones is in their own."""
    pixels, psf, table, unfit = prepared(*frame(SKEW))
    found = measure_difference(pixels, psf, table, unfit, 2)._replace(mean=np.array([0.1, 0.0]))
    after = table.copy()
    common = correct_asymmetry(found, pixels, psf, after, unfit)
    part = (table[:, 0] - after[:, 0]) / 0.1
    # the faintest star has a contrast of 250/(2π (0.45² + 1/12))/5² = 5.6
    assert part[-1] == pytest.approx(0.51, abs=0.02)
    own = after[:, 3] - table[:, 3]
    middle = np.sqrt(common[0, 0] / found.covariance[0, 0])
    np.testing.assert_allclose(own, (part - middle) ** 2 * found.covariance[0, 0], atol=1e-12)
    np.testing.assert_array_equal(after[:, 1], table[:, 1])


def test_stars_of_which_a_part_was_fitted_are_as_uncertain_as_the_displacement():
    """Saturated stars and those at the border: before, they were not moved and stated no error. One with a stated error
    of 0.005 px and an actual one of 0.16 px turned a frame about itself."""
    pixels, psf, table, unfit = prepared(*frame(SKEW))
    found = Difference(np.array([0.1, -0.2]), np.array([[4e-4, 1e-4], [1e-4, 9e-4]]), 0.9, NOISE**2)
    unfit[:2] = True
    after = table.copy()
    correct_asymmetry(found, pixels, psf, after, unfit)
    np.testing.assert_array_equal(after[:2, :3], table[:2, :3])
    stated = [0.1**2 + 4e-4, 0.2**2 + 9e-4, -0.1 * 0.2 + 1e-4]
    np.testing.assert_allclose(after[:2, 3:6] - table[:2, 3:6], [stated, stated])


def test_all_stars_measure_the_difference_better_than_nine():
    """It depends on the position in the pixel; of 27 stars less remains of that than of nine. Variances of such means
    are as one to three; noise of 200 draws of both is a tenth of them."""
    xy = frame(SKEW)[1]
    pixels, psf, table, _ = prepared(*frame_of_equal(xy))
    rng, means = np.random.default_rng(9), {9: [], 27: []}
    for _ in range(100):
        unfit = np.ones(len(xy), bool)
        unfit[rng.choice(len(xy), 40, replace=False)] = False
        order = rng.permutation(len(xy))
        table[:, 2] = 5000.0 * (1.0 + 1e-6 * order)  # which ones are the brightest is chance
        for most, found in means.items():
            found.append(measure_difference(pixels, psf, table, unfit, 2, most).mean[0])
    assert np.std(means[27]) < 0.7 * np.std(means[9])
    assert np.mean(means[27]) == pytest.approx(np.mean(means[9]), abs=4.0 * np.std(means[9]) / 10.0)


def frame_of_equal(xy):
    """A noise-free frame of skewed stars of equal flux at these positions."""
    size = SIDE * STEP
    edges, image = np.arange(size + 1) - 0.5, np.zeros((size, size))
    for x, y in xy:
        down = 0.5 * np.diff(erf((edges - y) / SIGMA / np.sqrt(2.0)))
        for share, off in SKEW:
            image += 5000.0 * share * down[:, None] * 0.5 * np.diff(erf((edges - x - off) / SIGMA / np.sqrt(2.0)))
    return image.astype(np.float32), xy, np.full(len(xy), 5000.0)


CORE_AND_TAIL = ((0.42, -0.6, 0.6), (0.58, 1.1, 1.7))
"""Share, offset along x and σ, px, of a sharp core and a wide tail, as of coma out of focus."""


def test_the_reference_is_the_whole_image_and_not_its_core():
    """The fit with equal weights of a narrow start ends at the core; positions of that ellipse are 0.5 px away."""
    size = SIDE * STEP
    xy, edges, image = frame(SYMMETRIC)[1], np.arange(size + 1) - 0.5, np.zeros((size, size))
    for x, y in xy:
        for share, off, sigma in CORE_AND_TAIL:
            along, down = (0.5 * np.diff(erf((edges - at) / sigma / np.sqrt(2.0))) for at in (x + off, y))
            image += 3000.0 * share * down[:, None] * along
    image = image.astype(np.float32)
    pixels, psf, table, unfit = prepared(image, xy - [0.6, 0.0], np.full(len(xy), 3000.0), 0.6)
    other = reference_psf(pixels, psf, table, unfit, 2)
    assert other is not None
    assert other.shape[0] > 2.0 * other.shape[1] * 0.6 > 1.2
    # a fit that fails says how far the stars may be displaced: 0.6 widths
    found = Difference(np.zeros(2), np.zeros((2, 2)), 0.5, 1.0)
    np.testing.assert_allclose(unknown_reference(other, found), 0.5 * 0.36 * 0.5 * sum(other.shape[:2]) * np.eye(2))


def test_a_resolved_image_that_was_corrected_has_no_misfit_left():
    """Its shape displaces stars by their brightness only; the misfit made errors of the positions probable that were
    not there. In images of half a pixel they are, and a misfit that is unknown stays so."""
    wide, narrow = gaussian_psf(2.4, 0.95, radius_px=6.0), gaussian_psf(2.4, 0.3, radius_px=6.0)
    assert [_unexplained(misfit, wide) for misfit in (None, -1.5, 40.0)] == [None, -1.5, 0.0]
    assert [_unexplained(misfit, narrow) for misfit in (None, -1.5, 40.0)] == [None, -1.5, 40.0]


@pytest.mark.parametrize(("sigma", "explained"), [(1.0, True), (SIGMA, False)])
def test_the_misfit_of_asymmetric_images(sigma, explained):
    parts = [(share, off * sigma / SIGMA) for share, off in SKEW]
    found, _ = measured(*frame(parts, 3, sigma))
    assert found.common_px2 is not None
    assert (found.misfit <= 0.0) == explained
