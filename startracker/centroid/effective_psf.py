"""Effective point-spread function of a camera, measured from the stars of its frames."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from startracker.arguments import real_number, whole_number
from startracker.centroid.frame import Prepared, measure_moments, prepare
from startracker.centroid.psf_kernel import FITTED, Starts, fit_stars
from startracker.centroid.psf_model import PsfModel
from startracker.centroid.psf_shape import frame_psf
from startracker.core import FloatArray
from startracker.detection.background import Background
from startracker.detection.spots import Spots
from startracker.errors import InputError
from startracker.settings import CentroidSettings

_KNOTS_A_PIXEL = 2
_OVERSAMPLING = 8
_ROUNDS = 12
_CONVERGED = 1e-3
"""Largest change of the image in a round, as a share of its peak, at which the iteration ends."""
_LEAST_STARS = 8
_MARGIN_PX = 3.0
_ROUGHNESS = 1e-3
"""Weight of the third differences relative to the mean weight of the data; a larger one smooths the image itself."""
_CLIP_SIGMA = 5.0
_CONDITION = 1e3
_DEGREE = 3


class _Basis:
    """Cubic B-splines with half-pixel knots, integrated over pixels, along one axis."""

    def __init__(self, radius_px: float) -> None:
        half = math.ceil(radius_px * _KNOTS_A_PIXEL)
        knots = np.arange(-half - _DEGREE, half + _DEGREE + 1) / _KNOTS_A_PIXEL
        self.count = len(knots) - _DEGREE - 1
        self.radius_px = half / _KNOTS_A_PIXEL
        self._integral = BSpline(knots, np.eye(self.count), _DEGREE, extrapolate=False).antiderivative()
        self._low, self._high = knots[_DEGREE], knots[-_DEGREE - 1]

    def __call__(self, distance: FloatArray) -> FloatArray:
        """Integrals (…, count) over the pixel at each distance from the star; the image is zero beyond the radius."""
        upper = np.clip(distance + 0.5, self._low, self._high)
        lower = np.clip(distance - 0.5, self._low, self._high)
        return np.asarray(self._integral(upper) - self._integral(lower))


def build_effective_psf(
    frames: Sequence[tuple[NDArray[np.float32], Background, Spots]],
    *,
    radius_px: float = 5.0,
    gain_e_per_dn: float | None = None,
    most_stars: int = 400,
) -> PsfModel:
    """Effective point-spread function of a camera, measured from stars of one or more of its frames.

    After Anderson & King (2000), the effective point-spread function and the stars' positions and fluxes are improved
    from the same pixels. Here the image is a spline, and everything is solved for in one weighted least-squares
    adjustment, which needs neither a grid for binned samples nor a smoothing kernel.

    Parameters
    ----------
    frames : sequence of (image, background, spots)
        At least some tens of clean stars in total, at all sub-pixel phases; a hundred or more are better. Saturated
        stars, stars at the border, and stars with a neighbour within twice the radius are excluded.
    radius_px : float
        Radius at which the image ends; light beyond it does not affect the fits, whose windows are smaller.
    gain_e_per_dn : float, optional
        Gain, as for the centroiders.
    most_stars : int
        Number of stars to use, brightest first.

    Returns
    -------
    PsfModel
        Normalised to unit light within the radius; its centre is that of the Gaussian that fits it best.

    Raises
    ------
    InputError
        Fewer than eight usable stars; a radius below 2 or above 20 pixels.

    Notes
    -----
    p(u, v) = Σ c_jk B_j(u) B_k(v), where B is a cubic spline with half-pixel knots, already integrated over the pixel:
    the unknown is the optical image, which the pixels only sample. The stars' x, y and ln F are eliminated from each
    star's equations (their columns are projected out), which makes each round a Gauss–Newton step in image and
    positions together. Alternating between the two hardly converges in one direction, in which the image compensates a
    shift of each star that depends on its phase; this is how the phase errors of the first centroids imprint on the
    image. A small penalty on the third differences of c determines what the data leave open. Scale and centre are fixed
    by two further conditions. Stars whose χ² exceeds that of the others by five standard deviations are dropped.
    """
    radius_px = real_number("the radius of a star image, radius_px,", radius_px, least=2.0, most=20.0)
    most_stars = whole_number("most_stars", most_stars, least=1)
    gain_e_per_dn = None if gain_e_per_dn is None else real_number("gain_e_per_dn", gain_e_per_dn)
    for part in frames if isinstance(frames, Sequence) else (None,):
        if not (isinstance(part, tuple) and len(part) == 3 and isinstance(part[2], Spots)):
            raise InputError("frames must be a list of (image, background, spots)")
    half = math.floor(radius_px - 0.5)
    prepared = [prepare(image, background, CentroidSettings(), gain_e_per_dn) for image, background, _ in frames]
    stars, psf = _clean_stars(prepared, [spots for _, _, spots in frames], radius_px, half, most_stars)
    basis = _Basis(radius_px)
    reach = math.ceil((radius_px + 0.5) * _OVERSAMPLING) + 2
    grid = np.arange(-reach, reach + 1) / _OVERSAMPLING
    on_grid = basis(grid)
    shape = psf.shape
    # The iteration starts with the Gaussian, expressed in the basis.
    inverse = np.linalg.pinv(on_grid)
    coefficients = inverse @ psf.shares(grid, grid[:, None]) @ inverse.T
    for _ in range(_ROUNDS):
        psf = _as_model(on_grid @ coefficients @ on_grid.T, shape)
        fits = np.full((len(stars), FITTED), np.nan)
        for number, frame in enumerate(prepared):
            rows = np.flatnonzero(stars[:, 1] == number)
            x, y = stars[rows, 2:].T.copy()
            starts = Starts(x, y, np.full(len(rows), half), np.full(len(rows), np.inf))
            plain = frame.pixels._replace(flat_error=0.0)
            fits[rows] = fit_stars(plain, psf.samples, starts, np.arange(len(rows)), True)
        misfit = fits[:, 6] / fits[:, 7]
        usual = np.nanmedian(misfit)
        # √(2/ν) is the standard deviation of χ²/ν by noise alone; it keeps the limit open where the stars agree well.
        spread = 1.4826 * np.nanmedian(np.abs(misfit - usual)) + np.sqrt(2.0 / np.nanmedian(fits[:, 7]))
        good = np.flatnonzero(misfit < usual + _CLIP_SIGMA * spread)
        before = coefficients
        coefficients = _adjust(coefficients, basis, prepared, stars[good], fits[good], half, shape)
        if np.abs(on_grid @ (coefficients - before) @ on_grid.T).max() < _CONVERGED * psf.table.max():
            break
    return _as_model(on_grid @ coefficients @ on_grid.T, shape)


def _clean_stars(
    prepared: Sequence[Prepared], spots: Sequence[Spots], radius_px: float, half: int, most: int
) -> tuple[FloatArray, PsfModel]:
    """Flux, frame number, x and y (N, 4) of the brightest clean stars, and the Gaussian of the frame with most of
    them."""
    chosen, models = [], []
    for number, (frame, found) in enumerate(zip(prepared, spots, strict=True)):
        if not len(found):
            continue
        moments, sigmas = measure_moments(frame, found)
        height, width = frame.pixels.image.shape
        at = np.where(np.isfinite(moments[:, :2]), moments[:, :2], np.stack([found.x_peak, found.y_peak], axis=1))
        near = (np.abs(at[:, None] - at[None, :]).max(axis=2) < 2 * radius_px).sum(axis=1) > 1
        inside = (at > half + 1).all(axis=1) & (at < [width - half - 2, height - half - 2]).all(axis=1)
        good = np.flatnonzero(~found.saturated & ~found.edge & ~near & inside & np.isfinite(moments).all(axis=1))
        chosen += [(moments[s, 2], number, at[s, 0], at[s, 1]) for s in good]
        x, y = at.T.copy()
        starts = Starts(x, y, np.zeros(len(x), np.int64), np.full(len(x), np.inf))
        models.append((len(good), number, frame_psf(frame, found, starts, sigmas, radius_px + _MARGIN_PX)))
    if len(chosen) < _LEAST_STARS:
        raise InputError(
            f"{len(chosen)} stars stand alone, unsaturated and off the border; a star image needs {_LEAST_STARS}"
        )
    chosen.sort(reverse=True)
    return np.array(chosen[:most]), max(models, key=lambda entry: entry[0])[2]


def _as_model(table: FloatArray, shape: tuple[float, float, float]) -> PsfModel:
    return PsfModel(np.ascontiguousarray(table / (table.sum() / _OVERSAMPLING**2)), _OVERSAMPLING, shape)


def _adjust(
    coefficients: FloatArray,
    basis: _Basis,
    prepared: Sequence[Prepared],
    stars: FloatArray,
    fits: FloatArray,
    half: int,
    shape: tuple[float, float, float],
) -> FloatArray:
    """Coefficients after one Gauss-Newton step in image, positions and fluxes."""
    count = basis.count
    normal, right = np.zeros((count**2, count**2)), np.zeros(count**2)
    k = np.arange(-half, half + 1)
    h = 1e-3
    for star, fit in zip(stars, fits, strict=True):
        frame = prepared[int(star[1])]
        cx, cy = round(star[2]), round(star[3])
        cut = np.ix_(cy + k, cx + k)
        x, y, flux = fit[0] - cx, fit[1] - cy, fit[2]
        along_x, along_y = basis(k - x), basis(k - y)
        by_x = (basis(k - x - h) - basis(k - x + h)) / (2 * h)
        by_y = (basis(k - y - h) - basis(k - y + h)) / (2 * h)
        p = along_y @ coefficients @ along_x.T
        model = flux * p
        data = frame.pixels.image[cut].astype(float) - frame.pixels.level[cut]
        variance = frame.pixels.noise[cut].astype(float) ** 2 + np.maximum(model, 0) * frame.pixels.inverse_gain
        weight = np.where(np.isfinite(data), 1.0 / np.sqrt(variance), 0.0).ravel()
        data = np.where(np.isfinite(data), data, 0.0)
        # The star's own unknowns x, y and ln F are eliminated by projecting their columns out of the equations.
        nuisance = [along_y @ coefficients @ by_x.T, by_y @ coefficients @ along_x.T, p]
        own, _ = np.linalg.qr(np.stack([column.ravel() for column in nuisance], axis=1) * weight[:, None])
        rows = np.einsum("aj,bk->abjk", along_y, along_x).reshape(len(weight), count**2) * (flux * weight)[:, None]
        residual = (data - model).ravel() * weight
        rows -= own @ (own.T @ rows)
        residual -= own @ (own.T @ residual)
        normal += rows.T @ rows
        right += rows.T @ residual
    scale = np.trace(normal) / count**2
    third = np.diff(np.eye(count), 3, axis=0)
    rough = third.T @ third
    penalty = _ROUGHNESS * scale * (np.kron(rough, np.eye(count)) + np.kron(np.eye(count), rough))
    normal += penalty
    right -= penalty @ coefficients.ravel()
    # Two strongly weighted conditions: the total light is fixed, and the first moment under the Gaussian is zero.
    xx, yy, xy = shape
    at = np.linspace(-basis.radius_px, basis.radius_px, 12 * count + 1)
    values = basis(at)
    dx, dy = at, at[:, None]
    gauss = np.exp(-0.5 * (yy * dx**2 + xx * dy**2 - 2 * xy * dx * dy) / (xx * yy - xy**2))
    for kernel, free in ((np.ones_like(gauss), 0.0), (gauss * dx, 1.0), (gauss * dy, 1.0)):
        row = (values.T @ kernel @ values).ravel()
        row /= np.linalg.norm(row)
        normal += _CONDITION * scale * np.outer(row, row)
        right -= _CONDITION * scale * row * free * (row @ coefficients.ravel())
    return np.asarray(coefficients + np.linalg.solve(normal, right).reshape(count, count))
