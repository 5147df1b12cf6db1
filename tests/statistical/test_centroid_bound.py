"""Fits and weighted moments against the Cramér–Rao bound, computed here by finite differences of SciPy's Gaussian.

Statistics of N errors on two axes: the rms is good to 1/√(4N) of itself, e²/variance has mean 1 ± √(2 / 2N). With N =
900 that is 0.017 and 0.033; limits are three of these above what is said at each.
"""

import functools

import numpy as np
import pytest
from scipy.special import erf

from startracker.centroid import METHODS, psf_fit
from startracker.centroid.frame import SYSTEMATIC_PX as MOMENT_FLOOR_PX
from startracker.detection import Background, Spots
from startracker.settings import CentroidSettings

SIDE, STEP = 30, 20
NOISE = 10.0
K = np.arange(STEP) - STEP // 2


def stars(shape, xy):
    """Unit star images (N, STEP, STEP) about the middle pixel; the rotated ones by 15 × 15 points a pixel."""
    xx, yy, cross = shape
    if cross == 0:
        edges = np.arange(STEP + 1) - STEP // 2 - 0.5
        along_x = 0.5 * np.diff(erf((edges - xy[:, :1]) / np.sqrt(2 * xx)), axis=1)
        along_y = 0.5 * np.diff(erf((edges - xy[:, 1:]) / np.sqrt(2 * yy)), axis=1)
        return along_y[:, :, None] * along_x[:, None, :]
    node = (np.arange(7) + 0.5) / 7 - 0.5
    points = (K[:, None] + node).ravel()
    u, v = points - xy[:, :1], points - xy[:, 1:]
    det = xx * yy - cross**2
    value = np.exp(
        (cross * u[:, None, :] * v[:, :, None] - 0.5 * (yy * u[:, None, :] ** 2 + xx * v[:, :, None] ** 2)) / det
    ) / (2 * np.pi * np.sqrt(det))
    return value.reshape(len(xy), STEP, 7, STEP, 7).mean(axis=(2, 4))


def bound(shape, xy, flux):
    """Cramér–Rao bound (N, 2, 2) of x and y, flux unknown: Fisher's matrix by central differences."""
    h = 1e-4
    step_x, step_y = np.array([h, 0]), np.array([0, h])
    model = flux * stars(shape, xy)
    slopes = [flux * (stars(shape, xy + s) - stars(shape, xy - s)) / (2 * h) for s in (step_x, step_y)]
    slopes.append(model / flux)
    fisher = np.array([[np.sum(a * b / (model + NOISE**2), axis=(1, 2)) for a in slopes] for b in slopes])
    return np.linalg.inv(fisher.transpose(2, 0, 1))[:, :2, :2]


@functools.cache
def frame(shape, flux):
    """Image in electrons, the spots, true positions in the frame, and the bound of each star."""
    rng = np.random.default_rng([7, int(flux), int(100 * shape[0])])
    phase = rng.uniform(-0.5, 0.5, (SIDE * SIDE, 2))
    electrons = flux * stars(shape, phase)
    cells = rng.poisson(electrons + NOISE**2 - 25) + rng.normal(0, 5, electrons.shape) - (NOISE**2 - 25)
    image = cells.reshape(SIDE, SIDE, STEP, STEP).transpose(0, 2, 1, 3).reshape(SIDE * STEP, SIDE * STEP)
    corner = np.stack(np.divmod(np.arange(SIDE * SIDE), SIDE)[::-1], axis=1) * STEP + STEP // 2
    peak = corner + np.rint(phase).astype(int)
    count = len(peak)
    # fluxes descending, though equal, so that the order of the spots is that of the stars
    spots = Spots(
        peak[:, 0].copy(), peak[:, 1].copy(), np.full(count, float(flux)), np.full(count, 9), np.zeros(count, bool),
        np.zeros(count, bool),
    )  # fmt: skip
    return image.astype(np.float32), spots, corner + phase, bound(shape, phase, flux)


def measure(method, shape, flux, settings=None):
    image, spots, truth, limit = frame(shape, flux)
    background = Background(np.zeros_like(image), np.full_like(image, NOISE))
    found = METHODS[method](image, background, spots, settings or CentroidSettings(), 1.0)
    star = np.rint((found.xy - STEP // 2) / STEP).astype(int) @ [1, SIDE]
    assert len(np.unique(star)) == len(star) == len(truth)
    return found, found.xy - truth[star], limit[star], truth[star]


ROUND, NARROW, WIDE, SLANTED = (0.81, 0.81, 0.0), (0.36, 0.36, 0.0), (2.25, 2.25, 0.0), (1.6, 1.1, 0.5)


@pytest.mark.parametrize("flux", [1500, 6000, 60000])
@pytest.mark.parametrize("shape", [ROUND, NARROW, WIDE, SLANTED])
@pytest.mark.parametrize("method", ["least_squares", "maximum_likelihood"])
def test_fits_reach_the_bound(method, shape, flux):
    if shape == WIDE and flux == 1500:
        pytest.skip("such stars are not above the noise in any pixel")
    found, error, limit, truth = measure(method, shape, flux)
    # windows of 2½ σ and a width measured from nine stars cost 2 %
    ratio = np.sqrt((error**2).mean() / np.trace(limit, axis1=1, axis2=2).mean() * 2)
    assert 1 - 3 * 0.017 < ratio < 1.02 + 3 * 0.017
    # no bias at any phase: tenths hold 180 errors; the interpolation of the table is good to 5e-4 px
    phase = truth - np.rint(truth)
    for low in np.arange(-0.5, 0.5, 0.1):
        inside = error[(phase >= low) & (phase < low + 0.1)]
        assert abs(inside.mean()) < 4 * error.std() / np.sqrt(len(inside)) + 5e-4
    # flux goes as σ² of the image assumed: known to 2 / (signal-to-noise) of a star / √9 stars; three of these, and
    # 1 % beyond the window
    to_noise = flux / np.sqrt(flux + 4 * np.pi * (shape[0] + 1 / 12) * NOISE**2)
    assert found.flux.mean() == pytest.approx(flux, rel=0.01 + 2 / to_noise)


@pytest.mark.parametrize("flux", [1500, 6000, 60000])
@pytest.mark.parametrize("shape", [ROUND, SLANTED])
@pytest.mark.parametrize("method", ["weighted_moment", "least_squares", "maximum_likelihood"])
def test_covariances_tell_the_truth(method, shape, flux):
    # eᵀ C⁻¹ e has mean 2 and variance 4: ± 2/√900 = 0.067; 5 % for the noise of measured widths and signals
    found, error, _, _ = measure(method, shape, flux)
    floor_px = MOMENT_FLOOR_PX if method == "weighted_moment" else psf_fit.SYSTEMATIC_PX
    covariance = found.covariance - floor_px**2 * np.eye(2)
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    assert squared.mean() == pytest.approx(2.0, abs=3 * 0.067 + 0.1)
    correlation = (error[:, 0] * error[:, 1]).mean() / error.var()
    claimed = covariance[:, 0, 1].mean() / np.trace(covariance, axis1=1, axis2=2).mean() * 2
    # four standard deviations, as 18 such numbers are looked at
    assert correlation == pytest.approx(claimed, abs=4 / np.sqrt(900))


def test_weighted_moment_is_near_the_bound_for_faint_stars_where_the_plain_one_is_not():
    _, weighted, limit, _ = measure("weighted_moment", ROUND, 1500)
    _, plain, _, _ = measure("moment", ROUND, 1500)
    bounded = np.sqrt(np.trace(limit, axis1=1, axis2=2).mean() / 2)
    assert weighted.std() / bounded < 1.1 + 3 * 0.017
    assert plain.std() / bounded > 1.2


def test_a_pixel_response_that_is_known_about_is_in_the_covariance():
    image, spots, _, _ = frame(ROUND, 60000)
    rng = np.random.default_rng(8)
    uneven = (image * rng.normal(1, 0.03, image.shape)).astype(np.float32)
    background = Background(np.zeros_like(image), np.full_like(image, NOISE))
    settings = CentroidSettings(flat_field_error=0.03)
    found = METHODS["maximum_likelihood"](uneven, background, spots, settings, 1.0)
    _, _, truth, _ = frame(ROUND, 60000)
    star = np.rint((found.xy - STEP // 2) / STEP).astype(int) @ [1, SIDE]
    error = found.xy - truth[star]
    covariance = found.covariance - psf_fit.SYSTEMATIC_PX**2 * np.eye(2)
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    assert squared.mean() == pytest.approx(2.0, abs=3 * 0.067 + 0.1)
