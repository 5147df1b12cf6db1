"""The common Gaussian of a frame's stars against a joint fit in NumPy, and the star image that is made from it."""

import math

import numpy as np
import pytest

from startracker.centroid.frame import prepare
from startracker.centroid.psf_kernel import Starts, fit_stars
from startracker.centroid.psf_model import gaussian_psf
from startracker.centroid.psf_shape import fit_gaussian, frame_psf
from startracker.centroid.window import Pixels
from startracker.detection import Background, Spots
from startracker.detection.tiles import as_plane
from startracker.settings import CentroidSettings

NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)
SIZE = 110


def gaussian(x, y, shape):
    """Light of a unit Gaussian at the origin in pixels, by three nodes along each axis of a pixel."""
    xx, yy, xy = shape
    determinant, total = xx * yy - xy**2, 0.0
    for u, p in zip(NODES / 2.0, WEIGHTS / 2.0, strict=True):
        for v, q in zip(NODES / 2.0, WEIGHTS / 2.0, strict=True):
            a, b = x + u, y + v
            square = (yy * a * a + xx * b * b - 2.0 * xy * a * b) / determinant
            total = total + p * q * np.exp(-0.5 * square) / (2.0 * math.pi * math.sqrt(determinant))
    return total


def add(image, at, flux, shape):
    """Add a star to an image, ten pixels about it."""
    left, top = (max(round(k) - 10, 0) for k in at)
    part = image[top : top + 21, left : left + 21]
    y, x = np.indices(part.shape)
    part += flux * gaussian(x + left - at[0], y + top - at[1], shape)


def field(shapes, flux, seed=1, noise=5.0, gain=0.0):
    """Stars 30 px apart at random phases, each with its own shape: image, positions."""
    rng = np.random.default_rng(seed)
    corner = np.stack(np.divmod(np.arange(len(shapes)), 3), axis=1) * 30.0 + 20.0
    xy = corner + rng.uniform(-0.5, 0.5, (len(shapes), 2))
    image = np.zeros((SIZE, SIZE))
    for at, f, shape in zip(xy, flux, shapes, strict=True):
        add(image, at, f, shape)
    image += rng.normal(size=image.shape) * np.sqrt(noise**2 + gain * image)
    return image.astype(np.float32), xy


def pixels_of(image, noise, gain):
    planes = (as_plane(np.full(image.shape, value, np.float32)) for value in (0.0, noise))
    return Pixels(image, *planes, gain, 0.0)


def starts_of(xy):
    return Starts(xy[:, 0].copy(), xy[:, 1].copy(), np.zeros(len(xy), np.int64), np.full(len(xy), np.inf))


def star_equations(window, star, shape, noise, gain, contrast):
    """Weighted normal matrix and right side (6,) of x, y, ln F, xx, yy, xy, and χ² per degree of freedom."""
    x, y, value = window

    def model(p):
        return math.exp(p[2]) * gaussian(x - p[0], y - p[1], p[3:])

    at = np.array([*star, *shape])
    steps = 1e-4 * np.eye(6)
    slopes = np.array([(model(at + step) - model(at - step)) / 2e-4 for step in steps])
    light, share = model(at), gaussian(x - at[0], y - at[1], shape)
    noisy = contrast * noise**2 * share / share.max() if contrast else gain * light
    weight, rest = 1.0 / (noise**2 + noisy), value - light
    reduced = float(weight @ rest**2) / (len(value) - 6)
    return slopes * weight @ slopes.T, slopes @ (weight * rest), reduced


def joint_fit(image, xy, flux, half, shape, noise, gain, contrast=0.0):
    """Shape, and the sandwich variances of its parts, of Gauss–Newton's iteration with each star's χ² as its weight."""
    stars, shape, windows = np.column_stack([xy, np.log(flux)]), np.array(shape, float), []
    for at in np.rint(xy).astype(int):
        x, y = np.meshgrid(*(np.arange(max(k - half, 0), min(k + half + 1, SIZE)) for k in at))
        value = image[y, x].astype(float)
        good = np.isfinite(value)
        windows.append((x[good], y[good], value[good]))
    for _ in range(40):
        equations, total, scores = [], np.zeros((3, 3)), []
        for window, star in zip(windows, stars, strict=True):
            normal, right, reduced = star_equations(window, star, shape, noise, gain, contrast)
            weight, left = 1.0 / max(reduced, 1.0), np.linalg.solve(normal[:3, :3], normal[:3, 3:])
            total += weight * (normal[3:, 3:] - normal[3:, :3] @ left)
            scores.append(weight * (right[3:] - left.T @ right[:3]))
            equations.append((normal, right))
        step = np.linalg.solve(total, np.sum(scores, axis=0))
        shape += step
        for star, (normal, right) in zip(stars, equations, strict=True):
            star += np.linalg.solve(normal[:3, :3], right[:3] - normal[:3, 3:] @ step)
        if np.abs(step).max() < 1e-7:
            break
    own = np.linalg.solve(total, np.transpose(scores))
    return shape, (own**2).sum(axis=1) * len(xy) / (len(xy) - 1.0)


@pytest.mark.parametrize(("gain", "contrast"), [(0.0, 0.0), (1.0, 0.0), (1.0, 30.0)])
def test_the_ellipse_is_the_joint_fit(gain, contrast):
    """In noise, with one star of another image, whose χ² reduces its weight, a missing pixel, and a star at the border.
    Its last step is below 1e-3 px², and the next one smaller by far."""
    shapes = [(0.9, 0.7, 0.25)] * 9
    shapes[4] = (1.8, 1.4, -0.4)
    flux = np.array([4500.0, 4000.0, 3500.0, 3000.0, 4500.0, 2500.0, 2000.0, 1800.0, 1600.0])
    image, xy = field(shapes, flux, gain=gain)
    image[int(xy[1, 1]) + 1, int(xy[1, 0])] = np.nan
    cut = int(xy[0, 1]) - 3  # three rows above the first stars
    image, xy = np.pad(image[cut:], ((0, cut), (0, 0))), xy - [0.0, cut]
    expected, variance = joint_fit(image, xy, flux, 5, (0.9, 0.7, 0.2), 5.0, gain, contrast)
    found, errors = fit_gaussian(pixels_of(image, 5.0, gain), starts_of(xy), np.arange(9), 5, (1.0, 1.0, 0.0), contrast)
    np.testing.assert_allclose(found[:2], expected[:2], atol=2e-4)
    np.testing.assert_allclose(errors, np.sqrt(variance[:2]), rtol=0.02)
    kept = 1.0 - (9.0 * variance[2] / expected[2] ** 2) ** 2
    assert found[2] == pytest.approx(kept * expected[2], abs=2e-3)
    assert np.abs(np.array(found) - [0.9, 0.7, 0.25]).max() > 2e-3  # noise, and the other image


def test_an_orientation_is_kept_by_its_significance():
    """1 − (9 s²/xy²)², with s² from the scatter of the stars; zero below three s."""
    factors = []
    for seed in range(6):
        image, xy = field([(0.9, 0.7, 0.03)] * 6, np.full(6, 1200.0), seed=seed)
        raw, variance = joint_fit(image, xy, np.full(6, 1200.0), 4, (0.9, 0.7, 0.03), 5.0, 0.0)
        factors.append(max(1.0 - (9.0 * variance[2] / raw[2] ** 2) ** 2, 0.0))
        found, _ = fit_gaussian(pixels_of(image, 5.0, 0.0), starts_of(xy), np.arange(6), 4, (1.0, 1.0, 0.0))
        assert found[2] == pytest.approx(factors[-1] * raw[2], abs=2e-3)
    assert min(factors) == 0.0
    assert max(factors) > 0.5


@pytest.mark.parametrize(("ratio", "place", "used"), [(0.97, 3, False), (1.03, 3, True), (0.97, 2, True)])
def test_faint_stars_of_an_ellipse(ratio, place, used):
    """From the fourth on only those of a signal-to-noise ratio of 12: √Σp² F/σ in background noise."""
    noise, half, shape, other = 2.0, 4, (0.8, 0.8, 0.0), (1.3, 0.6, 0.0)
    y, x = np.mgrid[-6:7, -6:7]
    share, wide = gaussian(x, y, shape), gaussian(x, y, other)
    inner = (slice(2, 11),) * 2
    flux = np.full(4, 400.0)
    # the signal-to-noise ratio of the start's Gaussian in the light of the other: Σ p d/(σ √Σ p²)
    flux[place] = ratio * 12.0 * noise * math.sqrt((share[inner] ** 2).sum()) / (share[inner] * wide[inner]).sum()
    shapes = [shape] * 4
    shapes[place] = other
    xy, image = np.rint(field(shapes, flux)[1]), np.zeros((SIZE, SIZE))
    for f, at, s in zip(flux, xy, shapes, strict=True):
        add(image, at, f, s)
    image = image.astype(np.float32)
    found, errors = fit_gaussian(pixels_of(image, noise, 0.0), starts_of(xy), np.arange(4), half, shape)
    assert (max(errors) > 1e-6) is used
    assert (abs(found[0] - shape[0]) > 1e-6) is used


def test_a_star_that_leaves_its_window_is_not_part_of_the_ellipse():
    """Its start is 4 px off, and its own light is of another image."""
    shapes = [(0.8, 1.0, 0.2)] * 4 + [(2.5, 2.5, 0.0)]
    image, xy = field(shapes, np.full(5, 5e4), noise=0.0)
    start = xy.copy()
    start[4] += [3.6, 0.0]
    found, errors = fit_gaussian(pixels_of(image, 2.0, 0.0), starts_of(start), np.arange(5), 3, (1.0, 1.0, 0.0))
    np.testing.assert_allclose(found, shapes[0], atol=1e-3)
    assert max(errors) < 1e-3


def frame_of(image, noise=2.0, **settings):
    flat = Background(np.zeros_like(image), np.full_like(image, noise))
    return prepare(image, flat, CentroidSettings(**settings), 1.0)


def spots_at(xy, flux):
    x, y = np.rint(xy).astype(np.int64).T
    nothing = np.zeros(len(xy), bool)
    return Spots(x.copy(), y.copy(), np.array(flux, float), np.full(len(x), 12), nothing, nothing.copy())


@pytest.mark.parametrize(
    ("sigmas", "window", "half"), [((0.9, 1.3), 5, 4), ((1.5, 0.9), 5, 4), ((0.9, 0.9), 11, 5), ((3.3, 1.0), 5, 8)]
)
def test_the_image_of_a_frame_is_the_ellipse_of_its_stars(sigmas, window, half):
    """In windows of 2½ widths, of the setting if that is larger, and of 17 px at most; with its error; as large as is
    asked for, or 2½ widths and 2 px."""
    flux = np.linspace(9e3, 5e3, 9)
    image, xy = field([(0.9, 1.1, 0.1)] * 9, flux, gain=1.0)
    frame = frame_of(image, 5.0, window_px=window)
    psf = frame_psf(frame, spots_at(xy, flux), starts_of(xy), sigmas, 3.0)
    shape, errors = fit_gaussian(frame.pixels, starts_of(xy), np.arange(9), half, (sigmas[0] ** 2, sigmas[1] ** 2, 0.0))
    assert psf.shape == pytest.approx(shape, rel=1e-12)
    assert psf.width_error == pytest.approx(errors, rel=1e-12)
    assert min(errors) > 0.0
    least = 2.5 * psf.sigma_px + 2.0
    assert least <= psf.radius_px < least + 3.0 / psf.oversampling + 1e-9
    wider = frame_psf(frame, spots_at(xy, flux), starts_of(xy), sigmas, 8.0)
    assert 8.0 <= wider.radius_px < 8.0 + 3.0 / psf.oversampling + 1e-9


def test_a_frame_with_fewer_than_three_stars_alone():
    """All that are clean then count, nine at most: here pairs 10 px apart, of which none is alone."""
    flux = np.linspace(9e3, 5e3, 12)
    corner = np.stack(np.divmod(np.arange(6), 3), axis=1) * 30.0 + 20.0
    xy = np.concatenate([corner, np.add(corner, [10.0, 3.0])]) + np.random.default_rng(5).uniform(-0.5, 0.5, (12, 2))
    image = np.zeros((SIZE, SIZE))
    for f, at in zip(flux, xy, strict=True):
        add(image, at, f, (0.9, 1.1, 0.1))
    image = (image + np.random.default_rng(6).normal(0.0, 5.0, image.shape)).astype(np.float32)
    frame = frame_of(image, 5.0)
    spots = spots_at(xy, flux)
    spots.saturated[1] = spots.edge[4] = True
    starts = starts_of(xy)
    starts.x[6] = np.nan
    psf = frame_psf(frame, spots, starts, (1.0, 1.0), 6.0)
    left = np.array([0, 2, 3, 5, 7, 8, 9, 10, 11])
    assert psf.shape == pytest.approx(fit_gaussian(frame.pixels, starts, left, 3, (1.0, 1.0, 0.0))[0], rel=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.5, 2.0])
def test_the_length_of_a_line_is_where_its_misfit_is_least(angle):
    """The vertex of the parabola through the median χ² of the stars at 0.9, 1 and 1.1 of the length from the second
    moments, at most a tenth beyond."""
    rng = np.random.default_rng(2)
    xy = np.stack(np.divmod(np.arange(9), 3), axis=1) * 30.0 + 20.0 + rng.uniform(-0.5, 0.5, (9, 2))
    image, path = np.zeros((SIZE, SIZE)), 4.0 * np.array([math.cos(angle), math.sin(angle)])
    for part in (np.arange(16) + 0.5) / 16 - 0.5:
        for at in xy + part * path:
            add(image, at, 2e4 / 16, (0.8, 0.8, 0.0))
    image = (image + rng.normal(size=image.shape) * np.sqrt(25.0 + image)).astype(np.float32)
    frame = frame_of(image, 5.0)
    psf = frame_psf(frame, spots_at(xy, np.full(9, 2e4)), starts_of(xy), (1.2, 1.0), 9.0)
    (xx, yy, tilt), _ = fit_gaussian(frame.pixels, starts_of(xy), np.arange(9), 3, (1.44, 1.0, 0.0))
    (minor, major), axes = np.linalg.eigh([[xx, tilt], [tilt, yy]])
    length = math.sqrt(12.0 * (major - minor))
    starts = starts_of(xy)._replace(half=np.full(9, min(math.ceil(2.5 * math.sqrt(major)), 8)))
    still, misfits = gaussian_psf(minor, minor, radius_px=9.0), []
    for factor in (0.9, 1.0, 1.1):
        line = still.smeared(*(factor * length * axes[:, 1]))
        fits = fit_stars(frame.pixels, line.samples, starts, np.arange(9), True)
        misfits.append(np.median(fits[:, 6] / fits[:, 7]))
    square, slope, _ = np.polyfit([0.9, 1.0, 1.1], misfits, 2)
    best = np.clip(-0.5 * slope / square, 0.8, 1.2) if square > 0.0 else (0.9, 1.0, 1.1)[int(np.argmin(misfits))]
    expected = minor * np.eye(2) + best**2 * (major - minor) * np.outer(axes[:, 1], axes[:, 1])
    np.testing.assert_allclose(psf.shape, [expected[0, 0], expected[1, 1], expected[0, 1]], rtol=1e-6, atol=1e-6)
