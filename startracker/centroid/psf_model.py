"""Star images as tables of the share of the light in a pixel, by its offset from the star."""

from __future__ import annotations

import math
import zipfile
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from startracker._compiled import kernel
from startracker.core import FloatArray
from startracker.display import fields_repr
from startracker.errors import InputError
from startracker.files import CURVE_BYTES, check_file

_LEAST_OVERSAMPLING = 8
_MOST_OVERSAMPLING = 48
_SAMPLES_A_SIGMA = 7.0
"""Keys' interpolation is then good to 1e-4 of the peak."""
_UNROTATED = 0.02
"""Correlation below which an ellipse counts as aligned with the axes: a frame does not determine a smaller one, and
positions do not depend on it."""
_NEGLIGIBLE = 1e-5
"""Largest share of the peak in the omitted terms of a sum of products."""
_MOST_TERMS = 5
"""Number of terms above which interpolation in the table is as fast."""
_FORMAT = 1
_SQRT_HALF = math.sqrt(0.5)
_DENSITY = 1.0 / math.sqrt(2.0 * math.pi)
_NO_AXES = np.empty((0, 0))


class Samples(NamedTuple):
    """A `PsfModel` in the form that kernels read; the table is used only if there are no axes."""

    table: FloatArray
    axes: FloatArray
    oversampling: int


@dataclass(frozen=True, eq=False)
class PsfModel:
    """Effective point-spread function: share p(dx, dy) of a star's light in the pixel at (dx, dy) from it.

    It includes the integration over the pixel (Anderson & King 2000), so that a star at (x, y) of flux F contributes F
    p(i − x, j − y) to pixel (i, j).

    Parameters
    ----------
    table : array, shape (n, n), n odd
        table[r, c] = p((c − m) / oversampling, (r − m) / oversampling), m = (n − 1) / 2.
    oversampling : int
        Number of points of the table per pixel.
    shape : (float, float, float)
        Variances along x and y and covariance of the Gaussian that fits the core best, px².
    axes : array, shape (2 K, n)
        Factors if the table is a sum of products, axes[2 k + 1, r] axes[2 k, c]; otherwise of shape (0, 0).
    width_error : (float, float)
        Standard errors of the variances along x and y, px², if the image was measured in a frame.
    """

    table: FloatArray
    oversampling: int
    shape: tuple[float, float, float]
    axes: FloatArray = field(default_factory=lambda: _NO_AXES)
    width_error: tuple[float, float] = (0.0, 0.0)

    __repr__ = fields_repr

    @property
    def radius_px(self) -> float:
        """Half width of the table, px; p is zero beyond it."""
        points = self.axes.shape[1] or self.table.shape[0]
        return float((points - 1) / 2 / self.oversampling)

    @property
    def samples(self) -> Samples:
        """The image in the form that kernels interpolate."""
        return Samples(_NO_AXES if len(self.axes) else self.table, self.axes, self.oversampling)

    @property
    def sigma_px(self) -> float:
        """Standard deviation of the image along its longer axis, px."""
        xx, yy, xy = self.shape
        major: float = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
        return math.sqrt(major)

    def shares(self, dx: ArrayLike, dy: ArrayLike) -> FloatArray:
        """p at offsets (dx, dy), px, by cubic splines; zero outside the table."""
        from scipy.ndimage import map_coordinates

        x, y = np.broadcast_arrays(np.asarray(dx, dtype=float), np.asarray(dy, dtype=float))
        middle = (self.table.shape[0] - 1) / 2
        indices = [y * self.oversampling + middle, x * self.oversampling + middle]
        flat = [np.ravel(values) for values in indices]
        return np.asarray(map_coordinates(self.table, flat, order=3, mode="constant")).reshape(x.shape)

    def smeared(self, along_x_px: float, along_y_px: float) -> PsfModel:
        """Image of a star that moves uniformly by this path during the exposure; p refers to the middle of the path.

        The mean along a line is a product with sin(πu)/(πu) in the Fourier plane, where u is frequency · path.
        """
        from scipy import fft

        grow = math.ceil(0.5 * max(abs(along_x_px), abs(along_y_px))) * self.oversampling
        side = self.table.shape[0] + 2 * grow
        # Zeros around the image keep the periodic transform from wrapping it around.
        padded = fft.next_fast_len(side + 2 * grow, real=True)
        spectrum = fft.rfft2(self.table, (padded, padded))
        down, across = np.fft.fftfreq(padded)[:, None], np.fft.rfftfreq(padded)
        path = self.oversampling * (along_x_px * across + along_y_px * down)
        drawn_out = fft.irfft2(spectrum * np.sinc(path), (padded, padded))
        rows = np.arange(-grow, side - grow) % padded
        table = drawn_out[np.ix_(rows, rows)]
        # A uniform line of length L has a variance of L²/12.
        xx, yy, xy = self.shape
        return PsfModel(
            table,
            self.oversampling,
            (xx + along_x_px**2 / 12, yy + along_y_px**2 / 12, xy + along_x_px * along_y_px / 12),
        )

    def save(self, path: str | Path) -> None:
        """Write to a NumPy archive (.npz), which `load_psf` and the setting ``centroid.psf`` read."""
        with Path(path).open("wb") as file:
            np.savez_compressed(
                file, format=_FORMAT, table=self.table, oversampling=self.oversampling, shape=np.array(self.shape)
            )


def load_psf(path: str | Path) -> PsfModel:
    """Read a star image saved by `PsfModel.save`; it is cached until the file changes.

    Raises
    ------
    InputError
        If the file is not such an archive.
    """
    changed = check_file(path, CURVE_BYTES, "centroid.psf is a star image made by PsfModel.save").st_mtime_ns
    return _read_psf(str(path), changed)


_MOST_EXPANDED_BYTES = 10 * CURVE_BYTES
"""Largest size of the tables of an archive, which may be compressed a thousandfold."""


@lru_cache(maxsize=8)
def _read_psf(path: str, changed: int) -> PsfModel:
    try:
        with zipfile.ZipFile(path) as archive:
            expanded = sum(entry.file_size for entry in archive.infolist())
        if expanded > _MOST_EXPANDED_BYTES:
            raise InputError(f"its tables have {expanded:,} bytes")
        with np.load(path, allow_pickle=False) as data:
            table = np.ascontiguousarray(data["table"], dtype=float)
            oversampling, shape = int(data["oversampling"]), tuple(float(v) for v in data["shape"])
            version = int(data["format"])
    except Exception as error:  # whatever a damaged archive makes NumPy raise
        raise InputError(f"centroid.psf: '{path}' is not a star image made by PsfModel.save ({error})") from error
    square = table.ndim == 2 and table.shape[0] == table.shape[1] and table.shape[0] % 2 == 1
    if version != _FORMAT or not square or oversampling < 1 or len(shape) != 3 or not np.isfinite(table).all():
        raise InputError(f"centroid.psf: '{path}' is damaged: the table must be square, of odd size and finite")
    return PsfModel(table, oversampling, (shape[0], shape[1], shape[2]))


def gaussian_psf(
    xx: float, yy: float, xy: float = 0.0, *, radius_px: float, width_error: tuple[float, float] = (0.0, 0.0)
) -> PsfModel:
    """An elliptical Gaussian integrated over pixels.

    If its axes are those of the image it is a product of differences of Φ, and if they nearly are, a sum of such
    products (`gaussian_axes`). Otherwise it is integrated along one axis and then the other by the trapezoidal rule
    over the points of the table, with the first correction of Euler and Maclaurin.

    Parameters
    ----------
    xx, yy, xy : float
        Variances and covariance, px².
    radius_px : float
        Half width of the table.
    width_error : (float, float)
        Standard errors of `xx` and `yy`, px².
    """
    determinant = xx * yy - xy * xy
    if not (xx > 0 and yy > 0 and determinant > 0):
        raise InputError(f"no Gaussian has the variances {xx}, {yy} and the covariance {xy} px²")
    narrow = math.sqrt(determinant / max(xx, yy))
    # Even, so that the borders of a pixel are points of the table.
    wanted = 2 * math.ceil(0.5 * _SAMPLES_A_SIGMA / narrow)
    oversampling = min(max(wanted, _LEAST_OVERSAMPLING), _MOST_OVERSAMPLING)
    middle = math.ceil(radius_px * oversampling) + 2
    correlation = abs(xy) / math.sqrt(xx * yy)
    terms = 1 if correlation < _UNROTATED else math.ceil(math.log(_NEGLIGIBLE) / math.log(correlation))
    if terms <= _MOST_TERMS:
        axes = gaussian_axes(xx, yy, xy, oversampling, middle, terms)
        return PsfModel(axes[1::2].T @ axes[::2], oversampling, (xx, yy, xy), axes, width_error)
    # Values of the density on a grid, integrated over pixels by a quadrature whose nodes are the points of the grid.
    fine = np.arange(-middle - oversampling, middle + oversampling + 1) / oversampling
    down = fine[:, None]
    points = np.exp((xy * fine * down - 0.5 * (yy * fine**2 + xx * down**2)) / determinant)
    points /= 2.0 * math.pi * math.sqrt(determinant)
    table = _over_pixel(_over_pixel(points, oversampling).T, oversampling).T
    cut = (table.shape[0] - 2 * middle - 1) // 2
    table = table[cut : cut + 2 * middle + 1, cut : cut + 2 * middle + 1]
    return PsfModel(np.ascontiguousarray(table), oversampling, (xx, yy, xy), width_error=width_error)


@kernel
def gaussian_axes(xx: float, yy: float, xy: float, oversampling: int, middle: int, terms: int) -> FloatArray:
    """Factors (2 K, n) of a pixel-integrated Gaussian of small correlation ρ, as a sum of products.

    Mehler's series: the density is φ(u) φ(v) Σ ρᵏ/k! Heₖ(u) Heₖ(v), with Hermite's polynomials Heₖ, and ∫ Heₖ φ =
    −Heₖ₋₁ φ. The first K terms omit less than ρᴷ of the peak.
    """
    out, half = np.empty((2 * terms, 2 * middle + 1)), oversampling // 2
    rho = xy / math.sqrt(xx * yy)
    for axis in range(2):
        sigma = math.sqrt(yy if axis else xx)
        borders = np.empty((terms, 2 * (middle + half) + 1))
        for n in range(borders.shape[1]):
            u = (n - middle - half) / (oversampling * sigma)
            borders[0, n] = 0.5 * math.erfc(-u * _SQRT_HALF)
            if terms > 1:
                last, here = 0.0, math.exp(-0.5 * u * u) * _DENSITY
                for k in range(1, terms):
                    borders[k, n] = -here
                    last, here = here, u * here - (k - 1) * last
        factor = 1.0
        for k in range(terms):
            if k and not axis:
                factor *= rho / k
            for n in range(out.shape[1]):
                out[2 * k + axis, n] = factor * (borders[k, n + oversampling] - borders[k, n])
    return out


def _over_pixel(values: FloatArray, oversampling: int) -> FloatArray:
    """Integral over one pixel along the last axis: the trapezoidal rule with end corrections."""
    half = oversampling // 2
    n = values.shape[-1]
    total = np.cumsum(values, axis=-1)
    first, last = slice(1, n - 2 * half - 1), slice(2 * half + 1, n - 1)
    inner = total[..., last] - total[..., first]  # points first+1 … last
    inner = inner + 0.5 * (values[..., first] - values[..., last])
    # Euler–Maclaurin: −h/12 (f'(b) − f'(a)), with central differences.
    slope_b = 0.5 * (values[..., 2 * half + 2 :] - values[..., 2 * half : -2])
    slope_a = 0.5 * (values[..., 2 : n - 2 * half] - values[..., : n - 2 * half - 2])
    return np.asarray((inner - (slope_b - slope_a) / 12.0) / oversampling)
