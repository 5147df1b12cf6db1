"""The skewness that all star images share: its estimate, what it corrects, and what it leaves in the covariance."""

import numpy as np
import pytest
from scipy.special import erf

from startracker.centroid import maximum_likelihood
from startracker.centroid.skewness import common_skewness, expansions_of, shifts, skewness_covariance
from startracker.centroid.window import Pixels
from startracker.detection import Background, Spots
from startracker.settings import CentroidSettings

PARTS = ((0.8, -0.2), (0.2, 0.8))
"""Share and offset along x, px, of the Gaussians of a skew image whose mean is at 0."""
KAPPA = sum(share * off**3 for share, off in PARTS)
SIGMA, NOISE, GAIN = 0.9, 5.0, 1.0
SIDE, STEP = 6, 32


def stars(low=3.0, high=4.7):
    """Positions (36, 2) at all phases, and fluxes, brightest first."""
    rng = np.random.default_rng(2)
    xy = np.stack(np.divmod(np.arange(SIDE**2), SIDE), axis=1) * STEP + STEP // 2 + rng.uniform(-0.5, 0.5, (SIDE**2, 2))
    return xy, np.logspace(high, low, SIDE**2)


def frame(parts, xy, flux, sigma=SIGMA):
    size = SIDE * STEP
    edges, image = np.arange(size + 1) - 0.5, np.zeros((size, size))
    for (x, y), f in zip(xy, flux, strict=True):
        down = 0.5 * np.diff(erf((edges - y) / sigma / np.sqrt(2.0)))
        for share, off in parts:
            image += f * share * down[:, None] * 0.5 * np.diff(erf((edges - x - off) / sigma / np.sqrt(2.0)))
    return image


def measure(image, xy, flux):
    """Centroids in the order of `xy`."""
    image = image.astype(np.float32)
    x, y = np.rint(xy).astype(np.int64).T
    clear = np.zeros(len(x), bool)
    spots = Spots(x, y, flux, np.full(len(x), 12), clear, clear)
    background = Background(np.zeros_like(image), np.full_like(image, NOISE))
    found = maximum_likelihood(image, background, spots, CentroidSettings(window_px=7), GAIN)
    order = np.hypot(*(xy[:, None] - found.xy[None]).transpose(2, 0, 1)).argmin(axis=1)
    return found, found.xy[order]


def test_the_kernel_is_the_joint_least_squares_fit():
    rng = np.random.default_rng(3)
    xy, flux = stars()
    image = frame(PARTS, xy, flux)
    image = (image + rng.normal(size=image.shape) * np.sqrt(NOISE**2 + image / GAIN)).astype(np.float32)
    background = Background(np.zeros_like(image), np.full_like(image, NOISE))
    table, chosen, half, (xx, yy, xy_) = np.column_stack([xy, flux]), np.arange(5), 3, (0.95, 0.85, 0.05)
    pixels = Pixels(image, background.level_plane, background.noise_plane, 1.0 / GAIN, 0.01)
    found, covariance, chi2, dark = common_skewness(pixels, table, chosen, half, (xx, yy, xy_))
    inverse = np.linalg.inv([[xx + 1 / 12, xy_], [xy_, yy + 1 / 12]])

    def gaussian(u, v):
        return np.exp(-0.5 * (inverse[0, 0] * u * u + 2 * inverse[0, 1] * u * v + inverse[1, 1] * v * v)) * (
            np.sqrt(np.linalg.det(inverse)) / (2 * np.pi)
        )

    def derivative(u, v, along_x, along_y, step=0.02):
        if along_x:
            ends = (derivative(u + k * step, v, along_x - 1, along_y) for k in (1, -1))
        elif along_y:
            ends = (derivative(u, v + k * step, along_x, along_y - 1) for k in (1, -1))
        else:
            return gaussian(u, v)
        return np.subtract(*ends) / (2 * step)

    rows, right = [], []
    for n in chosen:
        cx, cy = np.rint(xy[n]).astype(int)
        v, u = np.mgrid[-half : half + 1, -half : half + 1]
        u, v = (u + cx - xy[n, 0]).ravel(), (v + cy - xy[n, 1]).ravel()
        own = [derivative(u, v, *k) for k in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))]
        # −κ_abc ∂_abc/6: xxy and xyy stand in three of the eight terms each
        skew = [-derivative(u, v, *k) / d for k, d in (((3, 0), 6), ((2, 1), 2), ((1, 2), 2), ((0, 3), 6))]
        light = flux[n] * own[0]
        sigma = np.sqrt(NOISE**2 + light / GAIN + (0.01 * light) ** 2)
        block = np.zeros((len(u), 6 * len(chosen) + 4))
        block[:, 6 * n : 6 * n + 6] = np.transpose(own) * flux[n]
        block[:, -4:] = np.transpose(skew) * flux[n]
        rows.append(block / sigma[:, None])
        window = image[cy - half : cy + half + 1, cx - half : cx + half + 1].ravel()
        right.append((window - light) / sigma)
    design, data = np.vstack(rows), np.concatenate(right)
    expected = np.linalg.lstsq(design / np.linalg.norm(design, axis=0), data, rcond=None)[0]
    expected = (expected / np.linalg.norm(design, axis=0))[-4:]
    plain = np.linalg.inv(design.T @ design)[-4:, -4:]
    factor = covariance[0, 0] / plain[0, 0]
    assert dark == pytest.approx(NOISE**2)
    # numerical third derivatives are good to some 1e-3
    np.testing.assert_allclose(found, expected, atol=0.02 * np.sqrt(plain.diagonal().max()))
    assert factor > 0.99
    np.testing.assert_allclose(covariance, factor * plain, atol=0.01 * factor * plain.max())
    assert chi2 == pytest.approx(found @ np.linalg.solve(covariance, found), rel=1e-6)


def test_a_common_shift_is_stated_and_its_dependence_on_brightness_removed():
    xy, flux = stars()
    found, places = measure(frame(PARTS, xy, flux), xy, flux)
    off = places - xy
    expansions = expansions_of(3, (0.95, 0.81, 0.0))
    plain = [shifts(expansions, NOISE**2, f, 1.0 / GAIN, 0.0)[0, 0] * KAPPA for f in flux]
    assert np.ptp(plain) > 0.01
    # the series leaves out what is of higher order in the skewness: a fifth
    assert np.ptp(off[:, 0]) < 0.3 * np.ptp(plain)
    stated = np.sqrt(found.common_px2[0, 0])
    assert stated == pytest.approx(np.abs(off[:, 0]).mean(), rel=0.35)
    assert np.abs(off[:, 1]).max() < 0.003
    assert found.common_px2[1, 1] < 0.003**2


def test_symmetric_images_are_left_alone():
    rng, stated = np.random.default_rng(9), 0
    xy, flux = stars()
    image = frame(((1.0, 0.0),), xy, flux)
    for _ in range(60):
        noisy = image + rng.normal(size=image.shape) * np.sqrt(NOISE**2 + image / GAIN)
        stated += measure(noisy, xy, flux)[0].common_px2 is not None
    # χ² exceeds its limit once in ten; three binomial standard deviations of that in 60 are 7
    assert stated <= 6 + 7
    assert measure(image, xy, flux)[0].common_px2 is None


def test_third_moments_of_images_narrower_than_the_pixels_resolve_are_not_used():
    """Such an image has no shift A₀ κ; how far faint stars are displaced is measured all the same."""
    xy, flux = stars()
    image = frame([(share, 0.5 * off) for share, off in PARTS], xy, flux, sigma=0.4).astype(np.float32)
    background = Background(np.zeros_like(image), np.full_like(image, NOISE))
    pixels = Pixels(image, background.level_plane, background.noise_plane, 1.0 / GAIN, 0.0)
    table = np.column_stack([xy, flux, np.full((len(xy), 3), 1e-3)])
    assert not skewness_covariance(pixels, table, np.zeros(len(xy), bool), 2, (0.16, 0.16, 0.0)).any()
    found, _ = measure(image, xy, flux)
    assert found.common_px2 is None or np.trace(found.common_px2) < 0.001**2
