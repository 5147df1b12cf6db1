"""The measured star image: stars of an Airy pattern are found without the bias that a Gaussian leaves."""

import functools

import numpy as np
import pytest
from scipy.special import j0, j1

from startracker.centroid import maximum_likelihood
from startracker.centroid.effective_psf import build_effective_psf
from startracker.detection import Background, Spots
from startracker.errors import InputError
from startracker.settings import CentroidSettings

STEP, SUB = 24, 5


def airy(ring_px, side, flux, seed):
    """Mean image of side² stars, 5 × 5 points a pixel, first dark ring at `ring_px`; spots and positions."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(-0.5, 0.5, (side * side, 2))
    at = (np.arange(STEP * SUB) + 0.5) / SUB - 0.5 - STEP // 2
    image = np.zeros((side * STEP, side * STEP))
    corner = np.stack(np.divmod(np.arange(side * side), side)[::-1], axis=1) * STEP + STEP // 2
    scale = 3.8317 / ring_px
    for (dx, dy), (cx, cy) in zip(phase, corner, strict=True):
        v = scale * np.hypot(at - dx, (at - dy)[:, None]) + 1e-9
        light = flux * scale**2 / (4 * np.pi) * (2 * j1(v) / v) ** 2
        cell = light.reshape(STEP, SUB, STEP, SUB).mean(axis=(1, 3))
        image[cy - STEP // 2 : cy + STEP // 2, cx - STEP // 2 : cx + STEP // 2] = cell
    peak = corner + np.rint(phase).astype(int)
    count = len(peak)
    spots = Spots(
        peak[:, 0].copy(), peak[:, 1].copy(), np.full(count, float(flux)), np.full(count, 9), np.zeros(count, bool),
        np.zeros(count, bool),
    )  # fmt: skip
    return image, spots, corner + phase


def background(image, noise=6.0):
    return Background(np.zeros_like(image), np.full_like(image, noise))


@functools.cache
def measured(ring_px):
    frames = []
    for seed in (3, 4):
        mean, spots, _ = airy(ring_px, 8, 2e4, seed)
        rng = np.random.default_rng([seed, 1])
        image = (rng.poisson(mean + 20) - 20 + rng.normal(0, 4, mean.shape)).astype(np.float32)
        frames.append((image, background(image), spots))
    return build_effective_psf(frames, gain_e_per_dn=1.0, radius_px=4.0)


@pytest.mark.parametrize("ring_px", [2.0, pytest.param(3.0, marks=pytest.mark.slow)])
def test_positions_have_no_bias(ring_px, tmp_path):
    path = tmp_path / "psf.npz"
    measured(ring_px).save(path)
    mean, spots, truth = airy(ring_px, 7, 2e4, 9)
    image = mean.astype(np.float32)
    worst = {}
    for name in (None, str(path)):
        found = maximum_likelihood(image, background(image), spots, CentroidSettings(psf=name), 1.0)
        star = np.abs(found.xy[:, None] - truth).max(axis=2).argmin(axis=1)
        assert len(np.unique(star)) == len(truth)
        error = found.xy - truth[star]
        worst[name] = np.abs(error - error.mean(axis=0)).max()
        # a star is measured to 0.01 px; the centre of the image is the mean of 128 of them: 4 × 0.01 / √128 = 0.0035
        assert np.abs(error.mean(axis=0)).max() < 3.5e-3
    # 128 stars of 2e4 photons tell the image so well that half the floor of 0.005 px remains at the worst phase
    assert worst[str(path)] < 2.5e-3
    if ring_px == 2.0:
        assert worst[None] > 5e-3


def test_it_holds_all_the_light():
    psf = measured(2.0)
    assert psf.table.sum() / psf.oversampling**2 == pytest.approx(1, abs=1e-9)
    # the pattern's light in a pixel about the centre, by 40 × 40 points
    u = (np.arange(40) + 0.5) / 40 - 0.5
    scale = 3.8317 / 2.0
    v = scale * np.hypot(u, u[:, None])
    exact = (scale**2 / (4 * np.pi) * (2 * j1(v) / v) ** 2).mean()
    # light beyond 4 px is shared out over the rest: J₀² + J₁² at the disc of that radius (Rayleigh); the square that
    # the table is holds a part of it more
    v = scale * 4.0
    assert float(psf.shares(0.0, 0.0)) == pytest.approx(exact / (1 - j0(v) ** 2 - j1(v) ** 2), rel=0.025)


def test_too_few_stars():
    mean, spots, _ = airy(2.0, 2, 2e4, 1)
    image = mean.astype(np.float32)
    with pytest.raises(InputError, match="4 stars"):
        build_effective_psf([(image, background(image), spots)])
    with pytest.raises(InputError, match="radius"):
        build_effective_psf([], radius_px=1.0)
