"""Diffraction against closed formulas: the Airy pattern with obscuration (Born & Wolf, § 8.6.2), Maréchal's Strehl
ratio exp(−(2πσ)²) (§ 9.1.3; Mahajan 1983, for small σ), the axial intensity sinc²(W₀₂₀) under
defocus (§ 8.8.2), energy on a disk by quadrature of the pattern, orthonormal Zernike polynomials (Noll 1976, table 1).
"""

import itertools

import numpy as np
import pytest
from scipy.integrate import quad

from simulator.optics import airy, diffraction, pupil
from simulator.optics.lens import Lens
from simulator.optics.psf import aberrated, build_psf
from simulator.optics.psf_model import FieldAberrations, PsfModel, Zernike
from simulator.optics.psf_set import build_psf_set
from simulator.optics.splat import render_stars
from simulator.optics.zernike import NOLL, noll_order, wavefront, zernike

X = np.linspace(-12, 12, 61)
ONE = np.zeros(1)


@pytest.mark.parametrize("hole", [0.0, 0.3, 0.6])
def test_without_aberrations_it_is_the_airy_pattern(hole):
    ours = pupil.intensity(np.zeros((1, 11)), X, X, hole)[0]
    np.testing.assert_allclose(ours, airy.intensity(np.hypot(X[None], X[:, None]), hole), atol=1e-10)


@pytest.mark.parametrize("hole", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("x", [0.5, 1.3, 6.0])
def test_encircled_energy(hole, x):
    exact = quad(lambda r: 2 * np.pi * r * airy.intensity(r, hole), 0, x, limit=200)[0]
    assert airy.encircled_energy(x, hole) == pytest.approx(exact, abs=1e-9)
    assert airy.intensity(airy.first_ring(hole), hole) == pytest.approx(0.0, abs=1e-20)


@pytest.mark.parametrize("name", sorted(NOLL))
def test_strehl_ratio(name):
    for sigma in (0.02, 0.05):
        coefficients = np.zeros((1, 11))
        coefficients[0, NOLL[name] - 1] = sigma
        strehl = pupil.intensity(coefficients, ONE, ONE, centred=False)[0, 0, 0] / (np.pi / 4)
        assert strehl == pytest.approx(np.exp(-((2 * np.pi * sigma) ** 2)), abs=0.004)


@pytest.mark.parametrize("edge_waves", [0.25, 0.5, 1.0, 1.7])
def test_defocus_on_the_axis(edge_waves):
    """δ = 8N² λ W₀₂₀ behind the focus leaves sinc²(W₀₂₀) of the peak; dark at a whole wave."""
    shift_um = 8 * 2.8**2 * 0.6 * edge_waves
    coefficients = np.zeros((1, 11))
    coefficients[0, 3] = diffraction.defocus_waves(shift_um, 2.8, 600.0)
    axis = pupil.intensity(coefficients, ONE, ONE)[0, 0, 0] / (np.pi / 4)
    assert axis == pytest.approx(np.sinc(edge_waves) ** 2, abs=1e-10)


@pytest.mark.parametrize("hole", [0.0, 0.3, 0.6])
def test_mean_slopes_over_an_annulus(hole):
    """Of W = c √8 (3ρ² − 2) x the mean of ∂W/∂x is c √8 (1 + 3ε²), as ⟨ρ²⟩ = (1 + ε²)/2 and ⟨x²⟩ half of it; of a tilt
    c 2x it is 2c; of all that is even or has a higher symmetry it is 0."""
    coefficients = np.zeros((11, 11))
    np.fill_diagonal(coefficients, 0.1)
    found = pupil.mean_slope(coefficients, hole)
    expected = np.zeros((11, 2))
    expected[[1, 2], [0, 1]] = 0.1 * 2.0
    coma = 0.1 * np.sqrt(8.0) * (1.0 + 3.0 * hole**2)
    expected[NOLL["coma_x"] - 1, 0] = expected[NOLL["coma_y"] - 1, 1] = coma
    np.testing.assert_allclose(found, expected, atol=1e-8)


@pytest.mark.parametrize(("name", "radius"), [("defocus", 8.0 * np.sqrt(3.0)), ("astigmatism", 4.0 * np.sqrt(6.0))])
def test_geometric_radius_is_twice_the_steepest_slope(name, radius):
    """At the edge, where ∂W/∂ρ of √3 (2ρ² − 1) is 4√3, and of √6 ρ² cos 2θ 2√6; the nodes end 1 % before it."""
    coefficients = np.zeros((2, 11))
    coefficients[:, NOLL[name] - 1] = 0.05, 0.2
    assert pupil.geometric_radius(coefficients) == pytest.approx(0.2 * radius, rel=0.02)


def test_zernike_polynomials():
    """Noll's table: order of the first, and an orthonormal set."""
    orders = [(0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3), (3, 3), (4, 0)]
    assert [noll_order(j) for j in range(1, 12)] == orders
    y, x, weight = pupil.disk_nodes(12)
    terms = np.array([zernike(j, x.ravel(), np.repeat(y, 12)) for j in range(1, 16)])
    np.testing.assert_allclose((terms * weight.ravel()) @ terms.T / np.pi, np.eye(15), atol=1e-12)


@pytest.mark.parametrize(("hole", "aspect"), [(0.0, 1.0), (0.4, 1.0), (0.0, 13.75 / 16)])
def test_table_without_aberrations_is_that_of_the_airy_pattern(hole, aspect):
    """Two ways to the same pixels: a series of the transfer function, and the sampled pattern (2e-4)."""
    pitch = (10.0 * aspect, 10.0)
    pair = [
        build_psf(PsfModel(model=model, wavelength_nm=1200.0), 8.0, pitch, hole, 2.0)
        for model in ("airy", "diffraction")
    ]
    for offset in ((0.0, 0.0), (0.31, -0.17)):
        star = np.array([[20.0 + offset[0], 20.0 + offset[1]]])
        one, other = (render_stars((41, 41), star, np.ones(1), [1e5], psf) for psf in pair)
        assert np.abs(one - other).max() < 2e-4 * one.max()


def test_coma_has_its_geometric_centroid_where_it_says_and_points_outwards():
    """The star's position is the measured centroid (tests/statistical/test_coma_positions.py)."""
    section = PsfModel(model="diffraction", field=FieldAberrations(coma_waves=0.15))
    stars = build_psf_set(section, 8.0, (5.0, 5.0), (200, 200))
    psf = stars.psf(xy=(199.0, 99.5))
    assert psf.geometric_px[0] > 0.3
    image = render_stars((61, 61), 30.0 - np.array([psf.geometric_px]), np.ones(1), [1e7], psf)
    rows, columns = np.mgrid[-30:31, -30:31]
    # 0.85 px without centring; what lies beyond the stamp, whose wings are round, holds the rest as 1/R
    assert abs((image * columns).sum() / image.sum()) < 0.1
    assert abs((image * rows).sum() / image.sum()) < 1e-3
    assert (image * columns**3).sum() / image.sum() > 1.0
    groups = stars.groups(np.zeros(300), np.random.default_rng(1).uniform(0, 199, (300, 2)))
    assert sorted(np.concatenate([members for members, _ in groups])) == list(range(300))


def test_simple_models_are_one_group_and_the_same_psf():
    stars = build_psf_set(PsfModel(sigma_px=1.1), 2.0, (10.0, 10.0), (64, 64))
    ((members, psf),) = stars.groups(np.zeros(5), np.full((5, 2), np.nan))
    plain = build_psf(PsfModel(sigma_px=1.1), 2.0, (10.0, 10.0))
    assert members.tolist() == [0, 1, 2, 3, 4]
    assert (psf.sigma_px, psf.feature_px, stars.sigma_px) == (plain.sigma_px, plain.feature_px, plain.sigma_px)


def test_a_sum_of_wavelengths():
    """Two colours of equal weight: the mean of their images."""
    section, lens = PsfModel(model="diffraction", zernike_waves=Zernike(coma_x=0.02)), Lens(8.0, (5.0, 5.0))
    waves, nm = diffraction.axial_coefficients(section, 8.0), np.array([500.0, 800.0])
    both = aberrated(section, lens, waves, nm, np.array([[0.5, 0.5], [1.0, 0.0], [0.0, 1.0]]))
    star = np.array([[20.2, 19.9]])
    mixed, blue, red = (render_stars((41, 41), star, np.ones(1), [1.0], psf) for psf in both)
    assert np.abs(mixed - (blue + red) / 2).max() < 4e-4 * mixed.max()
    assert blue.max() > 1.5 * red.max()


@pytest.mark.parametrize(
    ("aspect", "azimuths_deg"),
    [
        pytest.param(1.0, [30, 60, 120, 150, 210, 240, 300, 330], marks=pytest.mark.slow),
        (0.8, [30, 120, 240, 330]),
    ],
)
def test_mirrored_zones_are_what_their_wavefronts_make(aspect, azimuths_deg):
    """Zones taken by mirroring another against the image computed for them: the same sums in another order, 1e-6. All
    mirrors: in the axes and, with square pixels, in the diagonals."""
    given = FieldAberrations(coma_waves=0.1, astigmatism_waves=0.07, curvature_waves=0.05, rings=1)
    section, lens = PsfModel(model="diffraction", field=given), Lens(5.6, (5.0 * aspect, 5.0))  # a small image
    stars = build_psf_set(section, lens.f_number, lens.pitch_um, (200, 200))
    row = 1.0 / aspect
    for azimuth in np.radians(azimuths_deg):
        reach = 99.5 / max(abs(np.cos(azimuth)), abs(np.sin(azimuth)) / row)
        xy = (99.5 + reach * np.cos(azimuth), 99.5 + reach * np.sin(azimuth) / row)
        coefficients = diffraction.field_coefficients(section.field, 1.0, azimuth)
        (exact,) = aberrated(section, lens, coefficients, np.array([section.wavelength_nm]), np.ones((1, 1)))
        np.testing.assert_allclose(stars.psf(xy=xy).core, exact.core, rtol=0, atol=1e-6 * exact.core.max())


def test_mirrored_wavefronts():
    rng = np.random.default_rng(4)
    coefficients, (x, y) = rng.normal(size=11), rng.uniform(-0.7, 0.7, (2, 50))
    for swap, sign_x, sign_y in itertools.product((False, True), (1, -1), (1, -1)):
        at = (sign_y * y, sign_x * x) if swap else (sign_x * x, sign_y * y)
        ours = wavefront(diffraction.mirrored(coefficients, swap, sign_x, sign_y), x, y)
        np.testing.assert_allclose(ours, wavefront(coefficients, *at), atol=1e-12)
