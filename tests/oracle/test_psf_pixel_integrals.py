"""Pixel values against brute-force integrals of the published formulas.

Gaussian: scipy.integrate.dblquad of exp(−r²/2σ²)/2πσ². Airy: Gauss–Legendre quadrature of π/(4λ²N²) [2J₁(v)/v]², v =
πr/λN (Born & Wolf, § 8.5.2), in cells small against a ring, good to 1e-12. The table of the Airy core is
interpolated: 5e-5 of the peak, as its docstring states; its wings are means over rings: λN/(31 r³) of the light.
"""

import numpy as np
import pytest
from scipy.integrate import dblquad, quad
from scipy.special import j1

from simulator.optics import airy
from simulator.optics.lens import Lens
from simulator.optics.psf import MIN_LAMBDA_N_PX, PSFS, build_psf
from simulator.optics.psf_model import PsfModel
from simulator.optics.splat import render_stars

NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)


def airy_pixel(dx, dy, lambda_n, aspect):
    """Share of the light in the pixel (dx, dy) from the star; lengths in columns, a row is 1/aspect columns high."""
    cells = max(1, int(np.ceil(1.0 / lambda_n)))
    total = 0.0
    for i in range(cells):
        for j in range(cells):
            x = dx - 0.5 + (i + 0.5 + NODES / 2) / cells
            y = (dy - 0.5 + (j + 0.5 + NODES / 2) / cells) / aspect
            v = np.pi * np.maximum(np.hypot(x[None, :], y[:, None]), 1e-9) / lambda_n
            intensity = np.pi / (4 * lambda_n**2) * (2 * j1(v) / v) ** 2
            total += np.einsum("i,j,ij", WEIGHTS, WEIGHTS, intensity) / (2 * cells) ** 2
    return total / aspect


@pytest.mark.parametrize(("sigma", "aspect"), [(0.3, 1.0), (1.23, 1.0), (1.0, 13.75 / 16)])
def test_gaussian_against_dblquad(sigma, aspect):
    psf = build_psf(PsfModel(sigma_px=sigma), 2.0, (10.0 * aspect, 10.0))
    star = np.array([[10.21, 9.64]])
    image = render_stars((21, 21), star, np.ones(1), [1e12], psf) / 1e12  # so bright that nothing is cut off
    for i, j in [(10, 10), (11, 9), (12, 10), (10, 12)]:
        x, y = i - star[0, 0], j - star[0, 1]
        exact, _ = dblquad(
            lambda v, u: np.exp(-(u**2 + (v / aspect) ** 2) / (2 * sigma**2)) / (2 * np.pi * sigma**2 * aspect),
            x - 0.5, x + 0.5, y - 0.5, y + 0.5, epsabs=1e-12,
        )  # fmt: skip
        assert image[j, i] == pytest.approx(exact, abs=1e-11)


@pytest.mark.parametrize(
    ("ring", "aspect"), [(2.0, 1.0), (0.9, 1.0), (0.27, 1.0), (0.11, 1.0), (2.0, 13.75 / 16), (1.0, 1.8), (6.0, 1.0)]
)
def test_airy_core(ring, aspect):
    psf = build_psf(PsfModel(model="airy", first_dark_ring_px=ring), 2.0, (10.0 * aspect, 10.0))
    lambda_n = ring / airy.FIRST_RING
    peak = airy_pixel(0, 0, lambda_n, aspect)
    rng = np.random.default_rng(int(100 * ring))
    for _ in range(12):
        star = 40 + rng.uniform(-0.5, 0.5, 2)
        image = render_stars((81, 81), star[None], np.ones(1), [1e6], psf) / 1e6
        reach = min(psf.core_half_px, int(2 * ring) + 1)
        for i, j in 40 + rng.integers(-reach, reach + 1, (4, 2)):
            exact = airy_pixel(i - star[0], j - star[1], lambda_n, aspect)
            assert image[j, i] == pytest.approx(exact, abs=5e-5 * peak)


@pytest.mark.parametrize(("ring", "aspect"), [(2.0, 1.0), (0.27, 1.0), (2.0, 13.75 / 16)])
def test_airy_wings(ring, aspect):
    psf = build_psf(PsfModel(model="airy", first_dark_ring_px=ring), 2.0, (10.0 * aspect, 10.0))
    lambda_n = ring / airy.FIRST_RING
    image = render_stars((161, 161), np.array([[80.2, 79.7]]), np.ones(1), [1e8], psf) / 1e8
    for i, j in [(80 + psf.core_half_px + 1, 80), (80 - psf.core_half_px - 1, 84), (80, 30), (120, 120)]:
        dx, dy = i - 80.2, j - 79.7
        bound = lambda_n / (31 * np.hypot(dx, dy / aspect) ** 3)
        assert image[j, i] == pytest.approx(airy_pixel(dx, dy, lambda_n, aspect), abs=bound)


@pytest.mark.parametrize("x", [0.3, airy.FIRST_RING, 5.0])
def test_encircled_energy_is_the_integral_of_the_pattern(x):
    """0.838 within the first dark ring (Born & Wolf)."""
    exact = quad(lambda r: np.pi / 4 * (2 * j1(np.pi * r) / (np.pi * r)) ** 2 * 2 * np.pi * r, 0, x)[0]
    assert airy.encircled_energy(x) == pytest.approx(exact, abs=1e-9)
    assert airy.encircled_energy(airy.FIRST_RING) == pytest.approx(0.8378, abs=5e-5)


@pytest.mark.parametrize("pitch_um", [(13.75, 16.0), (16.0, 13.75), (5.5, 5.5)])
@pytest.mark.parametrize("contrast", [0.0, 0.3])
def test_a_gaussian_is_round_on_the_detector_and_its_finest_structure_is_along_the_longer_pitch(pitch_um, contrast):
    """One width in µm, with the spreading of charge, and so σ in pixels of either pitch."""
    psf = PSFS["gaussian"](PsfModel(sigma_px=0.8), Lens(2.0, pitch_um, diffusion_um=6.0, contrast=contrast))
    sigma_um = np.hypot(0.8 * pitch_um[0], 6.0)
    expected = sigma_um / pitch_um[0], sigma_um / pitch_um[1]
    assert (psf.sigma_px, psf.sigma_y_px) == pytest.approx(expected, rel=1e-12)
    assert psf.feature_px == pytest.approx(min(expected), rel=1e-12)


def test_diffraction_sets_the_ring_where_nothing_else_does():
    """1.22 λN: Greyling's f/1.4 at 555 nm has an Airy disk of 1.896 µm diameter."""
    psf = build_psf(PsfModel(model="airy", wavelength_nm=555.0), 1.4, (1.0, 1.0))
    radius = psf.sigma_px / (1.34985 / 3.8317)
    assert 2 * radius == pytest.approx(1.896, abs=0.001)


def test_sharper_than_the_table_can_hold():
    """Below `MIN_LAMBDA_N_PX` the image is drawn at that width; a star in the middle of a pixel keeps 90 % there."""
    psf = build_psf(PsfModel(model="airy", wavelength_nm=600.0), 0.24, (10.0, 10.0))
    image = render_stars((41, 41), np.array([[20.0, 20.0]]), np.ones(1), [1e6], psf) / 1e6
    assert image[20, 20] == pytest.approx(airy_pixel(0, 0, MIN_LAMBDA_N_PX, 1.0), abs=5e-5)
    assert image[20, 20] > 0.9
