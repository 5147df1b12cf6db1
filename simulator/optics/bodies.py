"""Rendering of Moon and planets as disks: lit side, terminator, blur by the optics, smear.

A disk is rendered on a grid finer than the pixels, at every moment of the exposure, and convolved with the PSF, whose
tables include the integration over pixels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from simulator.optics.psf import Psf
from simulator.optics.psf_table import TAPER_PX
from simulator.optics.splat import render_stars
from startracker._compiled import kernel
from startracker.core import FloatArray
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera

CONVOLVED_PX = 256.0
"""Larger disks are rendered without blur: their radius is a hundred times the width of a PSF."""

_CORE_HALF_PX = 16
"""Up to this distance the PSF is evaluated at the sub-pixel position of every cell of the disk, beyond it once per
pixel."""

LOMMEL_SEELIGER, LAMBERT = 0, 1
LAWS = {"lommel_seeliger": LOMMEL_SEELIGER, "lambert": LAMBERT}
"""Scattering laws: Lommel–Seeliger, I ∝ μ₀/(μ₀ + μ), for dark airless surfaces (Moon, Mercury), whose full disk has a
uniform brightness; Lambert, I ∝ μ₀, for clouds. μ₀ and μ are the cosines of the zenith angles of the Sun and of the
observer (Hapke 2012, *Theory of Reflectance and Emittance Spectroscopy*, chapters 8 and 10)."""


LAW_OF_BODY = {"Moon": "lommel_seeliger", "Mercury": "lommel_seeliger", "Sun": "lommel_seeliger"}
"""Scattering law by name of body; all others have clouds or dust: ``lambert``. The Sun is a uniform disk, which is what
the law gives for a full disk."""


Limb = tuple[float, float, float]
"""Limb of a nearer body across a disk, in radii of the disk: (offset, curvature, angle). Points with
t > offset + ½ curvature p² are occulted, with t along the angle (from +x to +y, radians) and p perpendicular to it."""

NO_LIMB: Limb = (2.0, 0.0, 0.0)


class LitDisk(NamedTuple):
    """A sphere in the light of the Sun, as an image.

    The brightness over the disk follows the scattering law at phase angle α, cos α = 2 k − 1 with k the illuminated
    fraction.
    """

    radius_x: float
    """Radius along columns, pixels (cells in `add_lit_disk`)."""
    radius_y: float
    """Radius along rows."""
    illuminated_fraction: float
    """Illuminated fraction k of the disk, 0 to 1."""
    sun_angle_rad: float
    """Direction of the Sun from the centre of the disk (`sun_angle_rad`)."""
    law: int = LOMMEL_SEELIGER
    """Scattering law, a value of `LAWS`."""
    limb: Limb = NO_LIMB
    """Limb of a nearer body beyond which the disk is occulted."""


_SHARE_SAMPLES = 400


def share_before_limb(
    offset: float, curvature: float, between_rad: float, illuminated_fraction: float, law: str
) -> float:
    """Fraction of the light of a body that is not occulted by a limb across its disk (0 to 1, accurate to 1e-3).

    Parameters
    ----------
    offset, curvature : float
        Of the limb, see `Limb`.
    between_rad : float
        Angle, at the centre of the disk, between the directions of the Sun and of the occulting body.
    illuminated_fraction : float
        Illuminated fraction of the disk.
    law : str
        Key of `LAWS`.
    """
    cosine = min(max(2.0 * illuminated_fraction - 1.0, -1.0), 1.0)
    sine = math.sqrt(1.0 - cosine * cosine)
    step = 2.0 / _SHARE_SAMPLES
    # The disk is sampled on a grid of unit radius: t towards the occulting body, p perpendicular to it, and mu, the
    # cosine of the observer's zenith angle, is the height of the sphere above the grid.
    t = (np.arange(_SHARE_SAMPLES) + 0.5) * step - 1.0
    p = t[:, None]
    mu = np.sqrt(np.maximum(1.0 - t * t - p * p, 0.0))
    mu_0 = np.maximum((t * math.cos(between_rad) - p * math.sin(between_rad)) * sine + mu * cosine, 0.0) * (mu > 0.0)
    light = mu_0 if LAWS[law] == LAMBERT else np.divide(mu_0, mu_0 + mu, out=mu_0, where=mu > 0.0)
    # A cell that the limb crosses counts in proportion to its free part, which makes the share continuous.
    before_limb = np.clip((offset + 0.5 * curvature * p * p - t) / step + 0.5, 0.0, 1.0)
    whole = float(light.sum())
    return float((light * before_limb).sum()) / whole if whole > 0.0 else 1.0


def sun_angle_rad(camera: Camera, attitude: Attitude, body: ArrayLike, sun: ArrayLike) -> float:
    """Direction of the Sun on the disk of a body: angle from +x (columns) towards +y (rows), radians.

    Sun, body and observer lie in one plane, so the lit limb faces the Sun along the great circle through both. The
    angle is measured on the sky, also if pixels are not square; 0 for a body outside the field.

    Parameters
    ----------
    camera, attitude : Camera, Attitude
        Projection (for its parity); ICRS → camera.
    body, sun : array_like, shape (3,)
        Apparent directions, ICRS.
    """
    u, s = np.asarray(body, dtype=float), np.asarray(sun, dtype=float)
    towards = s - (s @ u) * u
    length = float(np.linalg.norm(towards))
    if length < 1e-12:
        return 0.0
    step = 1e-4
    # The projection of a short step towards the Sun includes the parity of the camera.
    pair = camera.project(attitude.apply(np.stack([u, u * math.cos(step) + towards / length * math.sin(step)])))
    dx, dy = (pair[1] - pair[0]) / (camera.fx, camera.fy)
    return math.atan2(float(dy), float(dx)) if math.isfinite(dx + dy) else 0.0


def draw_body(
    mean_e: FloatArray, xy_path: ArrayLike, weights: ArrayLike, electrons: float, disk: LitDisk, psf: Psf
) -> None:
    """Add the lit disk of a body to `mean_e` in place.

    Parameters
    ----------
    mean_e : (rows, columns) float64 array
        Mean photo-electrons.
    xy_path : (K, 2) array
        Centre at K moments of the exposure, pixels, on the image or outside; moments with NaN are skipped.
    weights : (K,) array
        Fraction of the exposure of each moment.
    electrons : float
        Electrons of the body over the exposure. The magnitude, and so this number, includes the phase; all electrons
        are rendered, except for those beyond the end of the PSF.
    disk : LitDisk
        Size, phase and limb.
    psf : Psf
        Point-spread function; blurs disks of up to 256 pixels radius.

    Notes
    -----
    The fine grid has 4 to 8 cells per pixel; the image agrees to 1e-3 of its peak with the sum over all points of the
    disk (2e-3 for an Airy pattern narrower than a pixel). Not modelled: the Moon's maria and opposition surge, belts of
    planets, limb darkening other than that of the law, rings and flattening.
    """
    blurred = max(disk.radius_x, disk.radius_y) <= CONVOLVED_PX
    reach = _reach_px(psf, electrons) if blurred else 0
    reach_px = (reach, math.ceil(reach * psf.sigma_y_px / psf.sigma_px))
    path = np.atleast_2d(np.asarray(xy_path, dtype=float))
    near = _may_reach_image(path, mean_e.shape, disk, reach_px)
    if not near.any() or electrons <= 0.0 or disk.illuminated_fraction <= 0.0:
        return
    path, amounts = path[near], np.asarray(weights, dtype=float)[near] * electrons
    (left, top), (columns, rows) = _patch(path, mean_e.shape, disk, reach_px)
    smallest = min(disk.radius_x, disk.radius_y)
    fine = _oversampling(smallest) if blurred else 1
    cells = np.zeros((rows * fine, columns * fine))
    # Centres of pixels and of cells have integer coordinates, so the conversion is from edge to edge.
    centres = np.ascontiguousarray((path - (left, top) + 0.5) * fine - 0.5)
    in_cells = disk._replace(radius_x=disk.radius_x * fine, radius_y=disk.radius_y * fine)
    add_lit_disk(cells, centres, amounts, in_cells, _samples(smallest * fine))
    if blurred:
        _add_convolved(mean_e, cells, fine, (left, top), reach_px, electrons, psf)
    else:
        _add(mean_e, cells, left, top)


def _may_reach_image(
    path: FloatArray, shape: tuple[int, ...], disk: LitDisk, reach_px: tuple[int, int]
) -> NDArray[np.bool_]:
    """Moments (K,) at which light may reach the image."""
    extent = np.array([disk.radius_x + reach_px[0], disk.radius_y + reach_px[1]])
    inside = (path > -1.0 - extent) & (path < np.array([shape[1], shape[0]]) + extent)
    return np.asarray(np.isfinite(path).all(axis=1) & inside.all(axis=1))


def _patch(
    path: FloatArray, shape: tuple[int, ...], disk: LitDisk, reach_px: tuple[int, int]
) -> tuple[tuple[int, int], tuple[int, int]]:
    """First pixel (column, row) and size (columns, rows) of the patch that contains the disk along its path, without
    the part whose light does not reach the image."""
    ends = [
        (
            max(math.floor(low - radius - 1.0), -reach - 1),
            min(math.ceil(high + radius + 1.0), pixels + reach),
        )
        for low, high, radius, reach, pixels in zip(
            path.min(axis=0), path.max(axis=0), disk[:2], reach_px, shape[::-1], strict=True
        )
    ]
    return (ends[0][0], ends[1][0]), (ends[0][1] - ends[0][0] + 1, ends[1][1] - ends[1][0] + 1)


def _reach_px(psf: Psf, electrons: float) -> int:
    """Radius to which the light of a point with this number of electrons extends, pixels along columns."""
    radius = math.ceil(float(psf.radius_px(np.array([electrons]))[0])) + 1
    return radius if psf.core is None else max(radius + math.ceil(TAPER_PX), psf.core_half_px)


def _oversampling(radius_px: float) -> int:
    return 8 if radius_px < 16.0 else 4


def _samples(radius_cells: float) -> int:
    """Samples along the side of a cell."""
    return min(max(math.ceil(256.0 / radius_cells), 2), 32)


@kernel
def add_lit_disk(image: FloatArray, centres: FloatArray, amounts: FloatArray, disk: LitDisk, samples: int) -> None:
    """Kernel: light of a lit sphere with its radii in cells of `image`, sampled at `samples`² points per cell, added
    with `amounts` (K,) at the centres (K, 2)."""
    height, width = image.shape
    radius_x, radius_y, sun_angle = disk.radius_x, disk.radius_y, disk.sun_angle_rad
    box = np.empty((math.ceil(2.0 * radius_y) + 3, math.ceil(2.0 * radius_x) + 3))
    for k in range(len(centres)):
        left, top = math.floor(centres[k, 0] - radius_x), math.floor(centres[k, 1] - radius_y)
        x, y = centres[k, 0] - left, centres[k, 1] - top
        total = 0.0
        for j in range(box.shape[0]):
            for i in range(box.shape[1]):
                # Cells outside the disk are skipped by the distance of their nearest point from its centre.
                nearest_u = max(abs(i - x) - 0.5, 0.0) / radius_x
                nearest_v = max(abs(j - y) - 0.5, 0.0) / radius_y
                inside = nearest_u * nearest_u + nearest_v * nearest_v < 1.0
                box[j, i] = _light_of_cell(i - x, j - y, disk, samples) if inside else 0.0
                total += box[j, i]
        if total <= 0.0:  # a crescent thinner than the sampling distance: all light is in one cell at the limb
            i = min(max(math.floor(x + radius_x * math.cos(sun_angle) + 0.5), 0), box.shape[1] - 1)
            j = min(max(math.floor(y + radius_y * math.sin(sun_angle) + 0.5), 0), box.shape[0] - 1)
            box[j, i] = total = 1.0
        scale = amounts[k] / total
        for j in range(max(-top, 0), min(box.shape[0], height - top)):
            for i in range(max(-left, 0), min(box.shape[1], width - left)):
                image[top + j, left + i] += scale * box[j, i]


@kernel
def _light_of_cell(x: float, y: float, disk: LitDisk, samples: int) -> float:
    """Sum of the scattering law over `samples`² points of the cell at (x, y) from the centre of the disk."""
    offset, bend = disk.limb[0], 0.5 * disk.limb[1]
    along_x, along_y = math.cos(disk.limb[2]), math.sin(disk.limb[2])
    cosine = min(max(2.0 * disk.illuminated_fraction - 1.0, -1.0), 1.0)
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    sun_x, sun_y = sine * math.cos(disk.sun_angle_rad), sine * math.sin(disk.sun_angle_rad)
    step = 1.0 / samples
    light = 0.0
    for b in range(samples):
        v = (y - 0.5 + (b + 0.5) * step) / disk.radius_y
        for a in range(samples):
            u = (x - 0.5 + (a + 0.5) * step) / disk.radius_x
            square = 1.0 - u * u - v * v
            if square <= 0.0:
                continue
            if offset < 1.0 and u * along_x + v * along_y > offset + bend * (v * along_x - u * along_y) ** 2:
                continue
            mu = math.sqrt(square)
            # The Sun's direction is (sun_x, sun_y, cosine), as the illuminated fraction is (1 + cos α)/2.
            mu_0 = u * sun_x + v * sun_y + mu * cosine
            if mu_0 > 0.0:
                light += mu_0 if disk.law == LAMBERT else mu_0 / (mu_0 + mu)
    return light


def _add_convolved(
    mean_e: FloatArray,
    disk: FloatArray,
    fine: int,
    first: tuple[int, int],
    reach_px: tuple[int, int],
    electrons: float,
    psf: Psf,
) -> None:
    """Add a blurred disk, given on a grid of `fine`² cells per pixel that begins at the pixel `first` (column, row).

    Each cell is convolved with the PSF's core at its own sub-pixel position, and the sum of the cells of a pixel with
    the wings. Cells are represented by points at their centres, which adds a variance of 1/12 cell²; the filter
    (−1, 26, −1)/24 along both axes corrects for this.
    """
    disk = np.pad(disk, fine)
    (left, top), (reach_x, reach_y) = (first[0] - 1, first[1] - 1), reach_px
    for axis in (0, 1):
        disk = disk * (13.0 / 12.0) - (np.roll(disk, 1, axis) + np.roll(disk, -1, axis)) / 24.0
    half_x, half_y = min(reach_x, _CORE_HALF_PX), min(reach_y, _CORE_HALF_PX)
    rows, columns = (cells // fine for cells in disk.shape)
    offsets = [((a + 0.5) / fine - 0.5, (b + 0.5) / fine - 0.5) for b in range(fine) for a in range(fine)]
    cores = np.stack([_stamp(psf, electrons, half_x, half_y, offset) for offset in offsets])
    # One image of the pixels for each of the fine² positions of a cell within its pixel.
    parts = disk.reshape(rows, fine, columns, fine).transpose(1, 3, 0, 2).reshape(-1, rows, columns)
    _add(mean_e, np.maximum(_convolved(parts, cores), 0.0), left - half_x, top - half_y)
    if reach_x > half_x or reach_y > half_y:
        wings = _stamp(psf, electrons, reach_x, reach_y, (0.0, 0.0))
        # The core of the stamp has been added with the cells already.
        wings[reach_y - half_y : reach_y + half_y + 1, reach_x - half_x : reach_x + half_x + 1] = 0.0
        whole = disk.reshape(rows, fine, columns, fine).sum(axis=(1, 3))
        _add(mean_e, np.maximum(_convolved(whole[None], wings[None]), 0.0), left - reach_x, top - reach_y)


def _convolved(first: FloatArray, second: FloatArray) -> FloatArray:
    """Sum over pairs of images (N, ., .) of their full convolutions, by Fourier transforms.

    ``scipy.signal.fftconvolve`` does the same, but its import takes a fifth of the time of a cold start.
    """
    rows, columns = (a + b - 1 for a, b in zip(first.shape[1:], second.shape[1:], strict=True))
    size = [fft.next_fast_len(n, real=True) for n in (rows, columns)]
    product = np.einsum("nij,nij->ij", fft.rfft2(first, size), fft.rfft2(second, size))
    return np.asarray(fft.irfft2(product, size)[:rows, :columns])


def _stamp(psf: Psf, electrons: float, half_x: int, half_y: int, offset: tuple[float, float]) -> FloatArray:
    """Fraction of a star's light in each pixel of a stamp, to the radius for this number of electrons."""
    shape = (2 * half_y + 1, 2 * half_x + 1)
    position = np.array([[half_x + offset[0], half_y + offset[1]]])
    return render_stars(shape, position, np.ones(1), np.array([electrons]), psf) / electrons


def _add(image: FloatArray, patch: FloatArray, left: int, top: int) -> None:
    """Add a patch with its first pixel at (left, top) to the image."""
    height, width = image.shape
    x0, x1 = max(left, 0), min(left + patch.shape[1], width)
    y0, y1 = max(top, 0), min(top + patch.shape[0], height)
    if x0 < x1 and y0 < y1:
        image[y0:y1, x0:x1] += patch[y0 - top : y1 - top, x0 - left : x1 - left]
