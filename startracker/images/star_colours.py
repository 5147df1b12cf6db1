"""Colours of stars as a camera records them, from B−V."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray

_B_V_GRID = np.linspace(-0.4, 2.0, 49)
_C2_NM_K = 1.438776877e7
_CORE_PX = 2.0
_MOST_STARS = 4000
_REACH_PX = (8, 48)
"""Half width, px, of the window that the faintest and the brightest star tint."""
_WHITE_SHARE = 0.02
"""Weight of white as a share of the flux of the faintest star: the sky between the stars stays grey."""


def rgb_of_b_v(b_v: FloatArray) -> FloatArray:
    """Linear sRGB of stars by their colour, the largest of the three components 1.

    The star is a black body of the temperature of Ballesteros (2012, EPL 97, 34008, eq. 14), seen by the CIE 1931
    standard observer (colour-science's table); white is D65.

    Parameters
    ----------
    b_v : float array, shape (N,)
        B−V, clipped to −0.4 … 2.0; NaN (unknown) is white.

    Returns
    -------
    float array, shape (N, 3)
    """
    table = _rgb_table()
    rgb = np.stack([np.interp(b_v, _B_V_GRID, table[:, k]) for k in range(3)], axis=-1)
    return np.asarray(np.where(np.isnan(b_v)[:, None], 1.0, rgb))


@functools.cache
def _rgb_table() -> FloatArray:
    """Colours (49, 3) on the grid of B−V."""
    from colour import MSDS_CMFS, RGB_COLOURSPACES

    observer = MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    wavelength_nm = observer.wavelengths
    kelvin = 4600.0 * (1.0 / (0.92 * _B_V_GRID + 1.7) + 1.0 / (0.92 * _B_V_GRID + 0.62))
    planck = wavelength_nm**-5.0 / np.expm1(_C2_NM_K / (wavelength_nm * kelvin[:, None]))
    linear = planck @ observer.values @ RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB.T
    linear = np.clip(linear, 0.0, None)
    return np.asarray(linear / linear.max(axis=1, keepdims=True))


def star_tint(shape: tuple[int, int], xy: FloatArray, flux: FloatArray, b_v: FloatArray) -> NDArray[np.float32]:
    """Factors that give the star images of a grey image their colours.

    Each star tints its surroundings with the weight of a Moffat profile, β = 1.5; where several overlap, the colours
    are averaged by flux.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the image.
    xy : float array, shape (N, 2)
        Pixels of the stars.
    flux, b_v : float array, shape (N,)
        Fluxes in any unit, and colours; see `rgb_of_b_v`.

    Returns
    -------
    float32 array, shape (H, W, 3)
        1 without a star.
    """
    total = np.zeros((*shape, 4), np.float32)
    order = np.argsort(-flux, kind="stable")[:_MOST_STARS]
    order = order[flux[order] > 0.0]
    if not len(order):
        return np.ones((*shape, 3), np.float32)
    faintest = float(flux[order[-1]])
    rgb = rgb_of_b_v(b_v)
    for i in order:
        # The reach of a Moffat profile grows slowly with the flux; the fourth root keeps the windows of bright stars
        # small.
        reach = int(np.clip(_REACH_PX[0] * (flux[i] / faintest) ** 0.25, *_REACH_PX))
        (column, row), (x, y) = np.round(xy[i]).astype(int), xy[i]
        rows = np.arange(max(row - reach, 0), min(row + reach + 1, shape[0]))
        columns = np.arange(max(column - reach, 0), min(column + reach + 1, shape[1]))
        if not (len(rows) and len(columns)):
            continue
        square = (rows[:, None] - y) ** 2 + (columns[None, :] - x) ** 2
        # The fourth channel sums the weights, by which the sum of the colours is divided at the end.
        weight = flux[i] / faintest * (1.0 + square / _CORE_PX**2) ** -1.5
        total[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += weight[..., None] * np.append(rgb[i], 1.0)
    total += np.float32(_WHITE_SHARE)
    return np.asarray(total[..., :3] / total[..., 3:])


def tinted(image: NDArray[Any], xy: FloatArray, flux: FloatArray, b_v: FloatArray) -> NDArray[np.float32]:
    """Grey image (H, W) as a colour image (H, W, 3): the signal above the sky has the colours of `star_tint`."""
    values = np.asarray(image, dtype=np.float32)
    sky = np.float32(np.nanmedian(values))
    height, width = values.shape
    return np.asarray(sky + (values - sky)[..., None] * star_tint((height, width), xy, flux, b_v))
