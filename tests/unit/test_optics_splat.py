"""The kernels against plain NumPy twins, and what the wrapper takes."""

import numpy as np
import pytest
from scipy.special import erf

from simulator.optics.disk import add_disk
from simulator.optics.psf import build_psf
from simulator.optics.psf_model import PsfModel
from simulator.optics.psf_table import TAPER_PX, TAPS
from simulator.optics.splat import add_stars, render_stars
from startracker.errors import InputError

SHAPE = (40, 50)
RNG = np.random.default_rng(3)
XY = RNG.uniform(-4, 54, (30, 3, 2))
WEIGHTS = np.array([0.2, 0.5, 0.3])
ELECTRONS = 10 ** RNG.uniform(0, 5, 30)


def gaussian_twin(psf):
    image = np.zeros(SHAPE)
    columns, rows = np.arange(SHAPE[1]), np.arange(SHAPE[0])
    for star, electrons, radius in zip(XY, ELECTRONS, psf.radius_px(ELECTRONS), strict=True):
        for (x, y), weight in zip(star, WEIGHTS, strict=True):
            shares = []
            for pixels, at, sigma in ((columns, x, psf.sigma_px), (rows, y, psf.sigma_y_px)):
                share = erf((pixels + 0.5 - at) / (sigma * 2**0.5)) - erf((pixels - 0.5 - at) / (sigma * 2**0.5))
                shares.append(0.5 * share * (np.abs(pixels - at) <= radius * sigma / psf.sigma_px + 0.5))
            image += electrons * weight * shares[1][:, None] * shares[0][None, :]
    return image


def tabulated_twin(psf):
    image = np.zeros(SHAPE)
    half, middle = psf.core_half_px, psf.core.shape[0] // 2
    for star, electrons, radius in zip(XY, ELECTRONS, psf.radius_px(ELECTRONS), strict=True):
        for (x, y), weight in zip(star, WEIGHTS, strict=True):
            cx, cy = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
            stamp = np.zeros((2 * half + 1, 2 * half + 1))
            lag = []
            for at, centre in ((x, cx), (y, cy)):
                position = (at - centre) * psf.phases
                points = int(np.floor(position)) + np.arange(TAPS) - TAPS // 2 + 1
                terms = [[(position - b) / (a - b) for b in points if b != a] for a in points]
                lag.append((points + middle, np.prod(terms, axis=1)))
            for b, wb in zip(*lag[1], strict=True):
                for a, wa in zip(*lag[0], strict=True):
                    stamp += wa * wb * psf.core[b, a]
            # beyond the image too: the stamp gets what the whole of the wings leaves of the light to be drawn
            pad = int(radius) + 2 * half + 60
            rows, columns = np.mgrid[-pad : SHAPE[0] + pad, -pad : SHAPE[1] + pad]
            distance = np.hypot(columns - x, (rows - y) / psf.aspect)
            t = np.clip((radius + TAPER_PX - distance) / TAPER_PX, 0, 1)
            wing = np.interp(distance, np.arange(len(psf.wing)) * psf.wing_step_px, psf.wing) * t * t * (3 - 2 * t)
            near = (np.abs(columns - cx) <= half) & (np.abs(rows - cy) <= half)
            wing[near] = 0
            if radius <= half:
                wing[:] = 0
            else:
                light = np.interp(radius, np.arange(len(psf.drawn)) * psf.wing_step_px, psf.drawn)
                stamp *= (light - wing.sum()) / stamp.sum()
            wing[near] = stamp[rows[near] - cy + half, columns[near] - cx + half]
            image += electrons * weight * wing[pad:-pad, pad:-pad]
    return image


@pytest.mark.parametrize("aspect", [1.0, 13.75 / 16])
def test_gaussian_kernel_equals_its_twin(aspect):
    psf = build_psf(PsfModel(sigma_px=1.1), 2.0, (10 * aspect, 10.0))
    np.testing.assert_allclose(
        render_stars(SHAPE, XY, WEIGHTS, ELECTRONS, psf), gaussian_twin(psf), rtol=1e-11, atol=1e-9
    )


@pytest.mark.parametrize("aspect", [1.0, 13.75 / 16])
@pytest.mark.parametrize("ring", [0.3, 1.5])
def test_tabulated_kernel_equals_its_twin(ring, aspect):
    psf = build_psf(PsfModel(model="airy", first_dark_ring_px=ring), 2.0, (10 * aspect, 10.0))
    got = render_stars(SHAPE, XY, WEIGHTS, ELECTRONS, psf)
    np.testing.assert_allclose(got, tabulated_twin(psf), rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("model", ["gaussian", "airy"])
def test_stars_add_up_and_nan_leaves_no_light(model):
    psf = build_psf(PsfModel(model=model, first_dark_ring_px=1.5), 2.0, (10.0, 10.0))
    one = render_stars(SHAPE, XY[:1], WEIGHTS, ELECTRONS[:1], psf)
    both = render_stars(SHAPE, XY[:1], WEIGHTS, ELECTRONS[:1], psf, out=one.copy())
    np.testing.assert_allclose(both, 2 * one)
    gone = render_stars(SHAPE, np.full((1, 3, 2), np.nan), WEIGHTS, [1e5], psf)
    assert not gone.any()
    far = render_stars(SHAPE, np.full((1, 3, 2), 1e18), WEIGHTS, [1e5], psf)
    assert not far.any()
    assert not render_stars(SHAPE, np.empty((0, 3, 2)), WEIGHTS, [], psf).any()
    dark = render_stars(SHAPE, XY[:1], WEIGHTS, [0.0], psf)
    assert not dark.any()


def test_kernel_works_in_place():
    psf = build_psf(PsfModel(sigma_px=1.0), 2.0, (10.0, 10.0))
    image = np.full(SHAPE, 7.0)
    add_stars(image, np.array([[[20.0, 20.0]]]), np.ones(1), np.array([100.0]), psf)
    assert image.sum() == pytest.approx(7.0 * image.size + 100.0, rel=1e-7)


def test_stamp_grows_with_flux():
    for section in (PsfModel(sigma_px=1.0), PsfModel(model="airy", first_dark_ring_px=1.0)):
        radius = build_psf(section, 2.0, (10.0, 10.0)).radius_px([0.0, 1e2, 1e4, 1e6, 1e8])
        assert (np.diff(radius) >= 0).all()
        assert radius[-1] > radius[0]


@pytest.mark.parametrize(
    ("section", "said"),
    [
        (
            PsfModel(model="gausian"),
            "'gausian' is not one of the psfs: airy, diffraction, gaussian; did you mean 'gaussian'",
        ),
        (PsfModel(model="airy", sigma_px=1.0), "first_dark_ring_px, not sigma_px"),
        (PsfModel(sigma_px=1.0, first_dark_ring_px=2.0), "not both"),
    ],
)
def test_faults(section, said):
    with pytest.raises(InputError, match=said):
        build_psf(section, 2.0, (10.0, 10.0))


@pytest.mark.parametrize(
    ("x", "y", "rx", "ry"), [(20.3, 15.8, 7.4, 7.4), (20.0, 15.0, 0.4, 0.4), (49.4, 1.0, 9.0, 7.7)]
)
def test_disk_against_fine_sampling(x, y, rx, ry):
    """Each pixel against 200 × 200 points in it: good to the perimeter through a pixel × 1/200."""
    image = np.zeros(SHAPE)
    add_disk(image, (x, y), (rx, ry), np.pi * rx * ry)
    fine = (np.arange(200) + 0.5) / 200 - 0.5
    for j in range(max(int(y - ry) - 1, 0), min(int(y + ry) + 3, SHAPE[0])):
        for i in range(max(int(x - rx) - 1, 0), min(int(x + rx) + 3, SHAPE[1])):
            inside = ((i + fine[None, :] - x) / rx) ** 2 + ((j + fine[:, None] - y) / ry) ** 2 <= 1
            assert image[j, i] == pytest.approx(inside.mean(), abs=2e-3)


def test_disk_off_the_image_and_nowhere():
    image = np.zeros(SHAPE)
    add_disk(image, (np.nan, 3.0), 5.0, 100.0)
    add_disk(image, (-50.0, 3.0), 5.0, 100.0)
    assert not image.any()
    add_disk(image, (-0.5, 20.0), 5.0, 100.0)
    assert image.sum() == pytest.approx(50.0, rel=1e-12)
