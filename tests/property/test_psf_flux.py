"""Light is conserved at every sub-pixel phase, and none is drawn where none belongs."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.optics import airy
from simulator.optics.disk import add_disk
from simulator.optics.psf import FLUX_LOSS, LEAST_SHARE, WING_LIMIT_E, build_psf
from simulator.optics.psf_model import PsfModel, Zernike
from simulator.optics.psf_table import TAPER_PX
from simulator.optics.splat import render_stars

phase = st.floats(-0.5, 0.5)


@settings(deadline=None)
@given(phase, phase, st.floats(0.05, 4.0), st.floats(0.5, 2.0), st.floats(0.1, 1e7))
def test_gaussian_keeps_its_flux(dx, dy, sigma, aspect, electrons):
    psf = build_psf(PsfModel(sigma_px=sigma), 2.0, (10.0 * aspect, 10.0))
    image = render_stars((161, 161), np.array([[80 + dx, 80 + dy]]), np.ones(1), [electrons], psf)
    assert 1 - FLUX_LOSS <= image.sum() / electrons <= 1 + 1e-12


@settings(deadline=None)
@given(phase, phase, st.sampled_from([0.2, 0.5, 2.0]), st.sampled_from([1.0, 13.75 / 16]))
def test_airy_leaves_out_what_lies_beyond_its_edge(dx, dy, ring, aspect):
    """What is drawn is the encircled energy of the radius drawn to, within 3e-4: where core meets wings, means over
    rings stand in for pixels."""
    psf = build_psf(PsfModel(model="airy", first_dark_ring_px=ring), 2.0, (10.0 * aspect, 10.0))
    electrons = 1e5
    radius = float(psf.radius_px([electrons])[0]) + TAPER_PX / 2
    image = render_stars((401, 401), np.array([[200 + dx, 200 + dy]]), np.ones(1), [electrons], psf) / electrons
    assert abs(image.sum() - airy.encircled_energy(radius * airy.FIRST_RING / ring)) < 3e-4


TABLES = {
    "airy": ("airy", 600.0, 1.0),
    "diffraction": ("diffraction", 600.0, 1.0),
    "oblong airy": ("airy", 1500.0, 13.75 / 16),
    "wide airy": ("airy", 2500.0, 1.0),
    "wide diffraction": ("diffraction", 2500.0, 1.0),
}
"""Psfs that are tables: model, wavelength in nm, aspect of the pixels."""


@functools.cache
def table(name):
    model, wavelength_nm, aspect = TABLES[name]
    coma = Zernike(coma_x=0.1 * (model != "airy"))
    return build_psf(PsfModel(model=model, wavelength_nm=wavelength_nm, zernike_waves=coma), 4.0, (5.0 * aspect, 5.0))


@settings(deadline=None)
@given(phase, phase, st.sampled_from(sorted(TABLES)), st.floats(0, 7))
def test_flux_of_a_table_does_not_hang_on_the_phase(dx, dy, name, log_electrons):
    """1e-6, as asked, at any brightness; what remains is the single precision of the table, 6e-8 a pixel."""
    psf, electrons = table(name), 10.0**log_electrons
    size = 2 * int(np.ceil(psf.radius_px([electrons])[0] / min(psf.aspect, 1.0)) + psf.core_half_px + TAPER_PX) + 5
    images = [
        render_stars((size, size), np.array([[size // 2 + x, size // 2 + y]]), np.ones(1), [electrons], psf)
        for x, y in ((dx, dy), (0.0, 0.0))
    ]
    assert abs(images[0].sum() - images[1].sum()) < 1e-6 * electrons


@settings(deadline=None)
@given(
    phase, phase, st.sampled_from(["gaussian", *sorted(TABLES)]), st.floats(0, 6), st.floats(0, 6.28), st.floats(0, 25)
)
def test_smear_keeps_the_flux(dx, dy, name, log_electrons, angle, length):
    from simulator.optics.smear import exposure_nodes

    psf = table(name) if name != "gaussian" else build_psf(PsfModel(sigma_px=0.6), 2.0, (10.0, 10.0))
    electrons = 10.0**log_electrons
    size = 2 * int(np.ceil(psf.radius_px([electrons])[0] / min(psf.aspect, 1.0)) + psf.core_half_px + TAPER_PX) + 35
    nodes, weights = exposure_nodes(length, psf.feature_px)
    middle = np.array([size // 2 + dx, size // 2 + dy])
    path = middle + nodes[:, None] * length / 2 * np.array([np.cos(angle), np.sin(angle)])
    smeared = render_stars((size, size), path[None], weights, [electrons], psf).sum()
    still = render_stars((size, size), middle[None], np.ones(1), [electrons], psf).sum()
    assert abs(smeared - still) < 1e-6 * electrons


def _exact(low, high):
    """Multiples of 2⁻²⁰: adding 50 to them rounds nothing off, so that both images draw the very same star."""
    return st.integers(low * 2**20, high * 2**20).map(lambda n: n / 2**20)


@settings(deadline=None)
@given(_exact(-40, 103), _exact(-40, 103), st.sampled_from(["gaussian", "airy"]), st.floats(1, 1e6))
def test_part_off_the_image_is_a_window_of_the_whole(x, y, model, electrons):
    psf = build_psf(PsfModel(model=model, first_dark_ring_px=2.0), 2.0, (10.0, 10.0))
    small = render_stars((64, 48), np.array([[x, y]]), np.ones(1), [electrons], psf)
    large = render_stars((164, 148), np.array([[x + 50, y + 50]]), np.ones(1), [electrons], psf)
    np.testing.assert_allclose(small, large[50:114, 50:98], rtol=1e-9, atol=1e-12 * electrons)


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(["gaussian", "airy"]), st.floats(0, 7.5))
def test_no_edge_shows(model, log_electrons):
    """Where the drawing of a star ends its light is below the limit, or the table has ended."""
    electrons = 10.0**log_electrons
    psf = build_psf(PsfModel(model=model, first_dark_ring_px=1.0), 2.0, (10.0, 10.0))
    radius = float(psf.radius_px([electrons])[0])
    if psf.wing is not None and radius < 511:
        beyond = psf.wing[int(np.ceil(radius / psf.wing_step_px)) :]
        limit = max(WING_LIMIT_E, LEAST_SHARE * psf.peak * electrons)
        # the corner of the table's square, to which faint stars are drawn, lies a pixel inside the limit
        assert (beyond[16:] * electrons <= limit * (1 + 1e-9)).all()
    if psf.wing is None:
        edge = np.exp(-0.5 * (radius / psf.sigma_px) ** 2) / (2 * np.pi * psf.sigma_px**2)
        assert edge * electrons <= WING_LIMIT_E * (1 + 1e-9)


@settings(deadline=None)
@given(st.floats(20, 44), st.floats(20, 44), st.floats(0.2, 15), st.floats(0.5, 1.25))
def test_disk_keeps_its_flux(x, y, radius, aspect):
    image = np.zeros((64, 64))
    add_disk(image, (x, y), (radius, radius * aspect), 1000.0)
    assert abs(image.sum() - 1000.0) < 1e-7
    assert image.min() > -1e-9


@pytest.mark.parametrize("radius", [0.4, 6.0, (9.0, 3.5), 80.0])
@pytest.mark.parametrize("x", [-3.0, -0.5, 20.25, 63.5, 66.0])
@pytest.mark.parametrize("y", [-3.0, -0.5, 30.5, 47.5, 50.0])
def test_a_disk_across_the_border_is_a_window_of_the_whole(x, y, radius):
    small, large = np.zeros((48, 64)), np.zeros((148, 164))
    add_disk(small, (x, y), radius, 1000.0)
    add_disk(large, (x + 50.0, y + 50.0), radius, 1000.0)
    np.testing.assert_allclose(small, large[50:98, 50:114], rtol=0, atol=1e-11)


def test_a_disk_outside_or_without_a_position_is_not_drawn():
    image = np.zeros((48, 64))
    for xy in ((-9.0, 20.0), (20.0, 56.0), (72.0, 20.0), (20.0, -9.0), (np.nan, 20.0), (20.0, np.inf)):
        add_disk(image, xy, 8.4, 1000.0)
    assert not image.any()
