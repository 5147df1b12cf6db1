"""Covariances of the fit against the closed formulas of King 1983 (PASP 95, 163) and Winick 1986 (JOSA A 3, 1809).

Gaussian image of width s, background noise n a pixel, F photons: where the background dominates the variance of x is
8π s⁴ n² / F² and that of F is 4π s² n²; where the star's photons do, the variance of x is s² / F. Both hold for fine
pixels; at s = 2 px a pixel adds 1/12 to s², which carries 2 % of s⁴ into 4 %: s² + 1/12 is used, good to (1/12/s²)² =
4e-4 and, for the photons, to 1/12/s² = 2 %. The window reaches 4 s, where e⁻⁸ = 3e-4 of the light is lost.
"""

import numpy as np
import pytest

from startracker.centroid import maximum_likelihood
from startracker.centroid.psf_fit import SYSTEMATIC_PX
from startracker.centroid.psf_model import gaussian_psf
from startracker.detection import Background, Spots
from startracker.settings import CentroidSettings

S = 2.0


def covariance(flux, noise):
    psf = gaussian_psf(S**2, S**2, radius_px=12.0)
    k = np.arange(41) - 20
    image = (flux * psf.shares(k - 0.2, (k + 0.3)[:, None])).astype(np.float32)
    spots = Spots(
        np.array([20]), np.array([20]), np.array([flux]), np.array([20]), np.zeros(1, bool), np.zeros(1, bool)
    )
    background = Background(np.zeros_like(image), np.full_like(image, noise))
    settings = CentroidSettings(window_px=17, psf_sigma_px=S)
    found = maximum_likelihood(image, background, spots, settings, 1.0)
    assert found.flux[0] == pytest.approx(flux, rel=2e-3)
    return found.covariance[0] - SYSTEMATIC_PX**2 * np.eye(2)


def test_background_limited():
    flux, noise = 2e4, 300.0  # the star's photons add 2e4 / (2π 4) = 800 to 90,000 at its peak: 0.5 %
    wide = S**2 + 1 / 12
    assert np.diag(covariance(flux, noise)) == pytest.approx(8 * np.pi * wide**2 * noise**2 / flux**2, rel=0.02)


def test_photon_limited():
    flux = 1e6
    # noise of 1 a pixel: 4π s² = 50 against a million photons; more in the outer pixels, which hold little
    assert np.diag(covariance(flux, 1.0)) == pytest.approx((S**2 + 1 / 12) / flux, rel=0.03)
