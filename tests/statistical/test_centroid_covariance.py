"""Centroid errors against the covariance that comes with them, over many stars under photon and read noise."""

import numpy as np
import pytest
from scipy.special import erf

from startracker.centroid import first_moment
from startracker.centroid.frame import SYSTEMATIC_PX
from startracker.detection import Background, estimate, find_components
from startracker.settings import CentroidSettings, DetectionSettings

SPACING, SIDE = 20, 50  # 2500 stars a frame


def frame(seed, sigma, flux, gain, saturation=np.inf):
    """2500 stars at random phases; electrons = DN × gain; background 100 e⁻, read noise 5 e⁻; truth (N, 2)."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(-0.5, 0.5, (SIDE, SIDE, 2))
    k = np.arange(SPACING + 1) - SPACING // 2 - 0.5
    share = 0.5 * np.diff(erf((k - phase[..., None]) / sigma / np.sqrt(2)), axis=-1)
    cells = flux * share[:, :, 1, :, None] * share[:, :, 0, None, :]
    electrons = cells.transpose(0, 2, 1, 3).reshape(SIDE * SPACING, SIDE * SPACING) * gain
    image = (rng.poisson(electrons + 100) + rng.normal(0, 5, electrons.shape)) / gain
    row, column = np.mgrid[:SIDE, :SIDE] * SPACING + SPACING // 2
    truth = np.stack([column + phase[..., 0], row + phase[..., 1]], axis=-1).reshape(-1, 2)
    return np.minimum(image, saturation).astype(np.float32), truth


def solve(image, truth, settings, gain, saturation=None, background=None):
    if background is None:
        background = Background(np.full_like(image, 100 / gain), np.full_like(image, np.sqrt(125) / gain))
    # on this lattice the wings of stars 1000 times over touch under the filter, and flat tops have no peak to part at
    settings_of_detection = DetectionSettings(max_stars=10000, max_pixels=1000, matched_filter=False)
    spots = find_components(image, background, settings_of_detection, saturation)
    found = first_moment(image, background, spots, settings, gain)
    cell = np.clip(np.rint(found.xy - SPACING // 2) // 1, 0, None)
    index = np.rint((found.xy - SPACING // 2) / SPACING).astype(int) @ [1, SIDE]
    assert len(np.unique(index)) == len(index)
    assert cell.shape == found.xy.shape
    return found, found.xy - truth[index]


@pytest.mark.parametrize("gain", [1.0, 4.0])
@pytest.mark.parametrize(("sigma", "flux"), [(0.7, 2000), (1.1, 3000), (1.6, 6000), (1.1, 1e5)])
def test_covariance_is_that_of_the_errors(sigma, flux, gain):
    # e²/variance has mean 1 and standard deviation √2; over 2 × 2500 of them the mean is good to √2/√5000 = 0.020. The
    # signal of noisy pixels below zero counts as none, which makes the variance a little too large (3 % for the
    # faintest), and first order in noise leaves out of the order of (0.05)²: 4 × 0.020 + 0.05.
    image, truth = frame([1, int(10 * sigma), int(flux)], sigma, flux / gain, gain)
    found, error = solve(image, truth, CentroidSettings(psf_sigma_px=sigma), gain)
    assert len(found) == 2500
    variance = np.stack([found.covariance[:, 0, 0], found.covariance[:, 1, 1]], axis=1)
    # the floor for what is not noise is not in these images
    ratio = error**2 / (variance - SYSTEMATIC_PX**2)
    assert ratio.mean() == pytest.approx(1.0, abs=0.13)
    # no bias: the mean error is good to its standard deviation / √2500
    assert np.abs(error.mean(axis=0)).max() < 4 * error.std() / np.sqrt(2500)
    # and none at any phase: the phase's tenths hold about 500 stars, both axes
    phase = (truth - np.rint(truth))[np.rint((found.xy - 10) / SPACING).astype(int) @ [1, SIDE]]
    for low in np.arange(-0.5, 0.5, 0.1):
        inside = error[(phase >= low) & (phase < low + 0.1)]
        assert abs(inside.mean()) < 4 * error.std() / np.sqrt(len(inside)) + 1e-4


def test_measured_width_and_background_cost_nothing():
    # the same stars, with everything measured from the frame: errors within 5 % of those with everything known, as the
    # median width of 15 stars of signal-to-noise 100 is good to about 1 %
    image, truth = frame([2], 1.1, 30000, 1.0)
    _, known = solve(image, truth, CentroidSettings(psf_sigma_px=1.1), 1.0)
    _, measured = solve(image, truth, CentroidSettings(), 1.0, background=estimate(image))
    assert measured.std() < 1.05 * known.std()


@pytest.mark.parametrize("over", [1.2, 10.0, 1000.0])
@pytest.mark.parametrize("sigma", [0.7, 1.1, 1.8])
def test_saturated_stars_stay_within_what_they_claim(sigma, over):
    image, truth = frame([3, int(10 * sigma)], sigma, 4000 * over * 2 * np.pi * sigma**2, 1.0, 4095.0)
    found, error = solve(image, truth, CentroidSettings(), 1.0, 4095.0)
    variance = np.stack([found.covariance[:, 0, 0], found.covariance[:, 1, 1]], axis=1)
    assert found.saturated.any()
    assert np.sqrt((error[found.saturated] ** 2).mean()) < 0.035
    assert (error[found.saturated] ** 2 / variance[found.saturated]).mean() < 1.0
