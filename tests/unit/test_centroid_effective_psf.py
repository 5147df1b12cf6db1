"""The adjustment that measures a star image, against the same least squares with all unknowns written out."""

import math

import numpy as np
import pytest

from startracker.centroid.effective_psf import _adjust, _Basis, build_effective_psf
from startracker.centroid.frame import prepare
from startracker.centroid.psf_model import gaussian_psf
from startracker.detection import Background, Spots
from startracker.settings import CentroidSettings

SHAPE = (0.7, 0.9, 0.1)
HALF, NOISE, GAIN = 2, 3.0, 0.5


def field(count, size, flux, seed=3, shape=SHAPE, step=20):
    """Image with photon noise, and flux, x and y of its stars, brightest first."""
    rng = np.random.default_rng(seed)
    corner = np.stack(np.divmod(np.arange(count), size // step), axis=1) * step + step / 2
    stars = np.column_stack([np.linspace(flux, 0.5 * flux, count), corner + rng.uniform(-0.5, 0.5, (count, 2))])
    psf, light = gaussian_psf(*shape, radius_px=6.0), np.zeros((size, size))
    for f, a, b in stars:
        y, x = np.mgrid[round(b) - 7 : round(b) + 8, round(a) - 7 : round(a) + 8]
        light[y, x] += f * psf.shares(x - a, y - b)
    image = light + rng.normal(size=light.shape) * np.sqrt(NOISE**2 + np.maximum(light, 0.0) / GAIN)
    return image.astype(np.float32), stars


def frame_of(image, level=0.0):
    flat = Background(np.full_like(image, level), np.full_like(image, NOISE))
    return prepare(image + np.float32(level), flat, CentroidSettings(), GAIN)


def conditions(basis):
    """Rows (3, N²): the light, and the first moments under the Gaussian of the shape, each of length one."""
    at = np.linspace(-basis.radius_px, basis.radius_px, 12 * basis.count + 1)
    values, inverse = basis(at), np.linalg.inv([[SHAPE[0], SHAPE[2]], [SHAPE[2], SHAPE[1]]])
    x, y = np.meshgrid(at, at)
    gauss = np.exp(-0.5 * (inverse[0, 0] * x * x + 2.0 * inverse[0, 1] * x * y + inverse[1, 1] * y * y))
    rows = [(values.T @ weight @ values).ravel() for weight in (np.ones_like(gauss), gauss * x, gauss * y)]
    return np.array([row / np.linalg.norm(row) for row in rows])


def test_a_step_is_the_least_squares_of_image_positions_and_fluxes():
    """Weighted pixels of twelve stars in two frames, one pixel missing; a thousandth of the mean weight on third
    differences, and a thousandfold one on the conditions: the light stays, the first moments become zero."""
    basis, frames, stars, fits = _Basis(2.5), [], [], []
    for number in range(2):
        image, truth = field(6, 60, 900.0, seed=number)
        if number:
            x, y = np.rint(truth[2, 1:]).astype(int)
            image[y, x + 1] = np.nan
        frames.append(frame_of(image, level=40.0 * number))
        stars += [(f, number, x, y) for f, x, y in truth]
        fits += [[x + 0.05, y - 0.03, 0.9 * f] for f, x, y in truth]
    stars, fits, count = np.array(stars), np.array(fits), basis.count
    grid = np.arange(-24, 25) / 8
    inverse = np.linalg.pinv(basis(grid))
    start = inverse @ gaussian_psf(0.8, 0.8, 0.0, radius_px=6.0).shares(grid, grid[:, None]) @ inverse.T
    start[-4:] -= 0.03  # the model has light below zero somewhere, whose noise is that of the dark
    rows, right, image_rows = [], [], []
    for n, ((_, number, a, b), (x, y, flux)) in enumerate(zip(stars, fits, strict=True)):
        frame = frames[int(number)]
        py, px = np.mgrid[round(b) - HALF : round(b) + HALF + 1, round(a) - HALF : round(a) + HALF + 1]
        px, py = px.ravel(), py.ravel()

        def model(at_x, at_y, light, coefficients=start, px=px, py=py):
            return light * np.einsum("nj,jk,nk->n", basis(py - at_y), coefficients, basis(px - at_x))

        light = model(x, y, flux)
        value = frame.pixels.image[py, px].astype(float) - frame.pixels.level[py, px]
        good = np.isfinite(value)
        weight = np.where(good, 1.0 / np.sqrt(NOISE**2 + np.maximum(light, 0.0) / GAIN), 0.0)
        assert (light < 0.0).any()
        block = np.zeros((len(px), count**2 + 3 * len(stars)))
        block[:, : count**2] = flux * np.einsum("nj,nk->njk", basis(py - y), basis(px - x)).reshape(len(px), -1)
        step = 1e-4
        own = [
            (model(x + step, y, flux) - model(x - step, y, flux)) / (2.0 * step),
            (model(x, y + step, flux) - model(x, y - step, flux)) / (2.0 * step),
            light,
        ]
        block[:, count**2 + 3 * n : count**2 + 3 * n + 3] = np.transpose(own)
        rows.append(block * weight[:, None])
        right.append(np.where(good, value - light, 0.0) * weight)
        q, _ = np.linalg.qr(rows[-1][:, count**2 + 3 * n : count**2 + 3 * n + 3])
        free = rows[-1][:, : count**2]
        image_rows.append(free - q @ (q.T @ free))
    # the mean weight of the image's coefficients when the stars' unknowns are eliminated
    scale = sum((part**2).sum() for part in image_rows) / count**2
    third = np.array([np.convolve([-1.0, 3.0, -3.0, 1.0], np.eye(count)[k])[3:count] for k in range(count)]).T
    for rough in (np.kron(third, np.eye(count)), np.kron(np.eye(count), third)):
        rough = math.sqrt(1e-3 * scale) * rough
        rows.append(np.pad(rough, ((0, 0), (0, 3 * len(stars)))))
        right.append(-rough @ start.ravel())
    held = math.sqrt(1e3 * scale) * conditions(basis)
    rows.append(np.pad(held, ((0, 0), (0, 3 * len(stars)))))
    right.append(np.array([0.0, -held[1] @ start.ravel(), -held[2] @ start.ravel()]))
    design, data = np.concatenate(rows), np.concatenate(right)
    size = np.linalg.norm(design, axis=0)
    expected = (np.linalg.lstsq(design / size, data, rcond=None)[0] / size)[: count**2].reshape(count, count)
    found = _adjust(start, basis, frames, stars, fits, HALF, SHAPE) - start
    # the derivatives by position are differences of 1e-3 px on one side, of 1e-4 px on the other
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())
    assert np.abs(expected).max() > 1e-3


def spots_at(stars):
    x, y = np.rint(stars[:, 1:]).astype(np.int64).T
    nothing = np.zeros(len(x), bool)
    return Spots(x.copy(), y.copy(), stars[:, 0].copy(), np.full(len(x), 9), nothing, nothing.copy())


def built(image, stars):
    flat = Background(np.zeros_like(image), np.full_like(image, NOISE))
    return build_effective_psf([(image, flat, spots_at(stars))], radius_px=2.5, gain_e_per_dn=GAIN)


def test_a_star_that_is_a_pair_does_not_count():
    """Its χ² exceeds that of the others by more than five standard deviations; the image is the same without it."""
    image, stars = field(16, 80, 2e4)
    pair = 13
    y, x = np.mgrid[:80, :80]
    psf = gaussian_psf(*SHAPE, radius_px=6.0)
    image += (3e3 * psf.shares(x - stars[pair, 1] - 1.5, y - stars[pair, 2])).astype(np.float32)
    whole, without = built(image, stars), built(image, np.delete(stars, pair, axis=0))
    peak = without.table.max()
    # both iterations end below a thousandth of the peak
    assert np.abs(whole.table - without.table).max() < 2e-3 * peak


def test_the_image_that_is_built_is_that_of_the_stars():
    """Of 16 stars with 2e4 DN: noise of 1/√(16 · 2e4) of the light, some per mille of the peak in a point of the
    table; it reaches a pixel and a half beyond the radius, where it is zero."""
    image, stars = field(16, 80, 2e4)
    psf = built(image, stars)
    true = gaussian_psf(*SHAPE, radius_px=6.0)
    at = np.linspace(-1.5, 1.5, 7)
    expected = true.shares(at, at[:, None])
    assert np.abs(psf.shares(at, at[:, None]) - expected).max() < 0.02 * expected.max()
    assert psf.oversampling == 8
    assert psf.radius_px == pytest.approx(3.0 + 2.0 / 8.0)
    middle = len(psf.table) // 2
    assert not psf.table[:, middle + 24 :].any()
    assert psf.table[middle, middle + 18] > 0.0
