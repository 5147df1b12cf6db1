"""Cramér–Rao bounds against a Fisher matrix by brute force, and against closed formulas.

Brute force: the intensity of the star's image (Gaussian; Airy's [2 J₁(v)/v]², Born & Wolf § 8.5.2) is integrated over
each pixel by Gauss and Legendre's rule on 12 × 12 points, and the Fisher matrix of x, y and flux formed by differences
of whole images; 3 × 3, inverted. Nothing of the simulator's optics is used.

Closed formulas: King 1983 (PASP 95, 163) and Winick 1986 (JOSA A 3, 1809); Shuster & Oh 1981 for the attitude.
"""

import numpy as np
import pytest
from scipy.special import j1

from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.trials.bounds import (
    attitude_bound_deg,
    fisher_of_position,
    matched_sources,
    pixel_slopes,
    star_information,
)

TEXT = """
name: bounds
epoch: 2026-03-21T12:00:00Z
pointing: {target: [83.8, -1.2, 20.0], error_deg: 0}
sky: {magnitude_limit: 6.0, planets: false, earth: false}
optics: {focal_length_mm: 12, aperture_mm: 8, psf: {model: gaussian, sigma_px: 0.8}}
detector: {width: 300, height: 260, pixel_pitch_um: 8, exposure_s: 0.05, quantum_efficiency: 0.4, read_noise_e: 11,
  dark_current_e_s: 300, full_well_e: 1.0e+6, prnu: 0.01, dsnu: 0.2, gain_e_per_dn: 20, offset_dn: 50}
tracker: {magnitude_limit: 6.0, prior: true}
"""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)


def over_pixels(intensity, xy, half):
    """Integral of intensity(dx, dy) over the pixels −half … half for a star at xy."""
    k = np.arange(-half, half + 1)
    points = k[:, None] + NODES / 2
    dx, dy = (points - xy[0]).ravel(), (points - xy[1]).ravel()
    value = intensity(dx[None, :], dy[:, None])
    size = 2 * half + 1
    return np.einsum("jbia,b,a->ji", value.reshape(size, 12, size, 12), WEIGHTS / 2, WEIGHTS / 2)


def gaussian(sigma):
    return lambda x, y: np.exp(-(x * x + y * y) / (2 * sigma**2)) / (2 * np.pi * sigma**2)


def airy(lambda_n):
    def intensity(x, y):
        v = np.maximum(np.pi * np.hypot(x, y) / lambda_n, 1e-9)
        return np.pi / (4 * lambda_n**2) * (2 * j1(v) / v) ** 2

    return intensity


@pytest.mark.parametrize("model", ["gaussian", "airy"])
def test_brute_force(model):
    optics = {"gaussian": "sigma_px: 0.8", "airy": "first_dark_ring_px: 1.8"}[model]
    scenario = Scenario.parse(TEXT.replace("{model: gaussian, sigma_px: 0.8}", f"{{model: {model}, {optics}}}"))
    renderer = Renderer(scenario)
    _, truth = renderer.frame(0)
    inside = renderer.camera.contains(truth.sources.xy, -9.0)
    stars = np.flatnonzero(inside)[:4]
    found = star_information(renderer, truth, stars)
    intensity = gaussian(0.8) if model == "gaussian" else airy(1.8 / 1.21967)
    # a window as wide as any star's matter: 9 px hold all but 3 % of an Airy's light and none of its slopes to speak of
    half, h = 9, 1e-3
    dark = 300 * 0.05 * 2 ** ((20 - 25) / 8)
    for star, information in zip(stars, found, strict=True):
        place, flux = truth.sources.xy[star], truth.sources.electrons[star]
        middle = np.rint(place).astype(int)
        phase = place - middle
        image = {
            step: over_pixels(intensity, phase + step, half) for step in [(0, 0), (h, 0), (-h, 0), (0, h), (0, -h)]
        }
        slopes = [
            flux * (image[h, 0] - image[-h, 0]) / (2 * h), flux * (image[0, h] - image[0, -h]) / (2 * h), image[0, 0]
        ]  # fmt: skip
        window = truth.mean_electrons[
            middle[1] - half : middle[1] + half + 1, middle[0] - half : middle[0] + half + 1
        ]  # as rendered: it is only the noise here
        pattern = (
            0.05
            * renderer.detector.pattern.dark_e_s[
                middle[1] - half : middle[1] + half + 1, middle[0] - half : middle[0] + half + 1
            ]
        )
        variance = window + pattern + 11**2 + 20**2 / 12 + (0.01 * flux * image[0, 0]) ** 2 + (0.2 * dark) ** 2
        fisher = np.array([[np.sum(a * b / variance) for a in slopes] for b in slopes])
        expected = np.linalg.inv(fisher)[:2, :2]
        # differences over ±0.02 px: δ²/6 p‴/p′ ≈ 3e-4 at σ = 0.65; Airy's table 5e-5 of the peak, its cut wings
        # (beyond 4 σ) hold 1 % of the information of a bright star
        assert np.linalg.inv(information) == pytest.approx(
            expected, rel=2e-3 if model == "gaussian" else 0.02, abs=2e-3 * expected.max()
        )


def gaussian_fisher(sigma, flux, noise, phase=(0.2, -0.3)):
    half, h = int(8 * sigma), 1e-3
    image = [
        over_pixels(gaussian(sigma), np.add(phase, step), half)[None]
        for step in [(0, 0), (h, 0), (-h, 0), (0, h), (0, -h)]
    ]
    share, right, left, below, above = image
    variance = flux * share + noise**2
    return fisher_of_position(share, (right - left) / (2 * h), (below - above) / (2 * h), np.array([flux]), variance)[0]


def test_a_star_cut_off_knows_its_place_less_well_for_its_unknown_flux():
    """Right half off the image: place and flux are no longer apart, and the 3 × 3 matrix must be inverted whole."""
    half, h, flux = 6, 1e-3, 5e3
    images = [
        over_pixels(gaussian(0.9), np.add((0.1, 0.2), step), half)[None]
        for step in [(0, 0), (h, 0), (-h, 0), (0, h), (0, -h)]
    ]
    share, right, left, below, above = images
    variance = flux * share + 200.0
    variance[:, :, half + 1 :] = np.inf
    slope_x, slope_y = (right - left) / (2 * h), (below - above) / (2 * h)
    parts = np.stack([flux * slope_x, flux * slope_y, share])[:, 0, :, : half + 1].reshape(3, -1)
    full = (parts / variance[0, :, : half + 1].ravel()) @ parts.T
    found = fisher_of_position(share, slope_x, slope_y, np.array([flux]), variance)[0]
    assert np.linalg.inv(found) == pytest.approx(np.linalg.inv(full)[:2, :2], rel=1e-9)
    assert found[0, 0] < 0.9 * full[0, 0]  # else the flux would not matter here


def test_king_background_limited():
    # σ_x² = 8π s⁴ n² / F²; a pixel adds 1/12 to s², good to (1/12/s²)² = 4e-4; the star's own light adds 5e-4
    s, flux, noise = 2.0, 1e3, 100.0
    bound = np.linalg.inv(gaussian_fisher(s, flux, noise))
    assert np.diag(bound) == pytest.approx(8 * np.pi * (s * s + 1 / 12) ** 2 * noise**2 / flux**2, rel=3e-3)


def test_winick_photon_limited():
    # σ_x² = s² / F: the light of a pixel adds 1/12 to s², less than which the loss cannot be (Winick 1986, § 4)
    s, flux = 2.0, 1e7
    bound = np.linalg.inv(gaussian_fisher(s, flux, 1e-3))
    assert np.diag(bound) == pytest.approx((s * s + 1 / 12) / flux, rel=2e-3)


def test_attitude_of_equal_errors_is_shuster_and_ohs():
    """With equal σ a star and a small field P = σ² [Σ (I − b bᵀ)]⁻¹; at 2° a pixel spans cos² of its angle less: 0.2 %,
    and a turn about the axis is known from the same. The slopes' part along b stays zero."""
    camera = Renderer(Scenario.parse(TEXT.replace("focal_length_mm: 12", "focal_length_mm: 60"))).camera
    xy = np.random.default_rng(3).uniform([10, 10], [290, 250], (12, 2))
    b = camera.unproject(xy)
    slopes = pixel_slopes(camera, b)
    sigma_px = 0.03
    ours = np.linalg.inv(np.einsum("nia,nib->ab", slopes, slopes) / sigma_px**2)
    sigma = sigma_px * camera.pixel_rad
    expected = sigma**2 * np.linalg.inv(np.sum(np.eye(3) - b[:, :, None] * b[:, None, :], axis=0))
    assert np.diag(ours) == pytest.approx(np.diag(expected), rel=3e-3)
    # moving along itself moves no star: J b = 0
    assert np.abs(np.einsum("nia,na->ni", slopes, b)).max() < 1e-5 / camera.pixel_rad


def test_without_anything_random_there_is_no_bound():
    renderer = Renderer(Scenario.parse(TEXT).noiseless())
    _, truth = renderer.frame(0)
    stars = np.flatnonzero(renderer.camera.contains(truth.sources.xy))
    assert np.isnan(attitude_bound_deg(renderer, truth, stars)).all()
    assert np.isnan(attitude_bound_deg(Renderer(Scenario.parse(TEXT)), truth, stars[:1])).all()


def test_more_stars_bound_the_attitude_more_tightly():
    renderer = Renderer(Scenario.parse(TEXT))
    _, truth = renderer.frame(0)
    stars = np.flatnonzero(renderer.camera.contains(truth.sources.xy))
    few, all_of_them = (attitude_bound_deg(renderer, truth, chosen) for chosen in (stars[::2], stars))
    assert (all_of_them < few).all()
    # centroids belong to the brightest star within 3 px, and each star counts once
    xy = truth.sources.xy[stars[:4]]
    assert set(matched_sources(truth, np.concatenate([xy, xy + 0.1]))) <= set(stars)
    assert len(matched_sources(truth, np.array([[-500.0, -500.0]]))) == 0
