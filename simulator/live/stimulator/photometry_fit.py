"""Brightness of a display from photographs of its squares: flux of each colour at each level, and uniformity.

One weighted least-squares fit of all squares: F = U(u, v) · f, with f the flux of a colour at a level, or of all
colours at the highest one, and ln U a polynomial (`uniformity_terms`). A power law replaces the table of a colour if
it agrees with it (χ², at a level of 0.1 %).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.live.stimulator.patterns import TOP_LEVEL, Pattern
from simulator.live.stimulator.photographs import SquareFluxes
from simulator.live.stimulator.photometry import Curve, Photometry, uniformity_terms
from startracker.core import FloatArray
from startracker.errors import InputError

_SIGNIFICANT = 1e-3
_LEAST_SNR = 20.0
_MAG = 2.5 / math.log(10.0)


class Exposures(NamedTuple):
    """How the photographs of the squares were taken: exposure time, gain in electrons per DN, and the magnitude of a
    star that gives 1 DN per second."""

    exposure_s: float
    gain_e_per_dn: float = 1.0
    zero_point: float = 0.0


@dataclass(frozen=True, eq=False)
class PhotometryFit:
    """Result of `fit_photometry`.

    Parameters
    ----------
    photometry : Photometry
    magnitude_sigma, gamma, gamma_sigma : dict of str to float
        Standard error of the magnitude, best power law of each colour and its standard error (also where the table is
        used).
    white_factor_sigma : float
    uniformity_sigma : float
        Rms standard error of U over the display.
    scatter : float
        Relative scatter of the squares beyond the noise: what a smooth uniformity does not describe.
    """

    photometry: Photometry
    magnitude_sigma: dict[str, float]
    gamma: dict[str, float]
    gamma_sigma: dict[str, float]
    white_factor_sigma: float
    uniformity_sigma: float
    scatter: float


class _Squares(NamedTuple):
    flux: FloatArray
    variance: FloatArray
    terms: FloatArray
    column: NDArray[np.int64]


def fit_photometry(pattern: Pattern, measured: Mapping[str, SquareFluxes], taken: Exposures) -> PhotometryFit:
    """Fit the brightness.

    Parameters
    ----------
    pattern : Pattern
    measured : mapping
        Fluxes of the squares of ``uniform`` and of each ``ramp-COLOUR``.
    taken : Exposures

    Raises
    ------
    InputError
        If the exposure data are not positive, or the squares too faint.
    """
    if not (taken.exposure_s > 0 and taken.gain_e_per_dn > 0):
        raise InputError(f"exposure and gain must be positive; got {taken.exposure_s:g} s, {taken.gain_e_per_dn:g}")
    levels, count = np.array(pattern.levels), len(pattern.levels)
    squares = _gathered(pattern, measured, taken)
    lights, shape, covariance, scatter = _fitted(squares, count * len(pattern.colours) + 1)
    n2 = pattern.square_px**2 * taken.exposure_s
    magnitude, sigma, gamma, gamma_sigma, curve, tops = {}, {}, {}, {}, {}, []
    for k, colour in enumerate(pattern.colours):
        part = slice(k * count, (k + 1) * count)
        fit = _power_law(levels, lights[part], covariance[part, part], colour)
        top, top_sigma, curve[colour] = fit.top, fit.top_sigma, fit.curve
        gamma[colour], gamma_sigma[colour] = fit.gamma, fit.gamma_sigma
        magnitude[colour] = taken.zero_point - 2.5 * math.log10(top / n2)
        sigma[colour] = _MAG * top_sigma / top
        tops.append(top)
    white = lights[-1] / sum(tops)
    variance = sum((sigma[c] / _MAG * top / sum(tops)) ** 2 for c, top in zip(pattern.colours, tops, strict=True))
    white_sigma = white * math.sqrt(covariance[len(lights) - 1, len(lights) - 1] / lights[-1] ** 2 + variance)
    everywhere = uniformity_terms(pattern.squares + (pattern.square_px - 1) / 2, (pattern.width, pattern.height))
    spread = np.einsum("ni,ij,nj->n", everywhere, covariance[len(lights) :, len(lights) :], everywhere)
    photometry = Photometry((pattern.width, pattern.height), magnitude, curve, white, shape)
    return PhotometryFit(photometry, sigma, gamma, gamma_sigma, white_sigma, float(np.sqrt(spread.mean())), scatter)


def _gathered(pattern: Pattern, measured: Mapping[str, SquareFluxes], taken: Exposures) -> _Squares:
    """All squares, with the column of their colour and level; the last column is ``uniform``."""
    parts = []
    size, count = (pattern.width, pattern.height), len(pattern.levels)
    for name, found in measured.items():
        terms = uniformity_terms(pattern.squares[found.row] + (pattern.square_px - 1) / 2, size)
        if name == "uniform":
            column = np.full(len(found.row), count * len(pattern.colours))
        else:
            first = count * pattern.colours.index(name.removeprefix("ramp-"))
            column = first + np.searchsorted(pattern.levels, pattern.square_levels[found.row])
        variance = found.variance + np.maximum(found.flux, 0.0) / taken.gain_e_per_dn
        if float(np.median(found.flux[column % count == (0 if name == "uniform" else count - 1)])) < _LEAST_SNR * float(
            np.sqrt(np.median(variance))
        ):
            raise InputError(f"{name}: the brightest squares are too faint; take photographs with a longer exposure")
        parts.append(_Squares(found.flux, variance, terms, column))
    return _Squares(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _fitted(squares: _Squares, columns: int) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Flux of each column, coefficients of ln U, covariance of both, and the relative scatter."""
    from scipy.optimize import brentq, least_squares

    start = np.array([np.mean(squares.flux[squares.column == k]) for k in range(columns)])
    if not np.isfinite(start).all():
        raise InputError("no square of some level is in the field; photograph the whole display")
    scale = np.concatenate([np.full(columns, max(start.max(), 1e-300)), np.ones(squares.terms.shape[1])])
    member = np.arange(columns) == squares.column[:, None]

    def model(unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        light = (unknowns * scale)[squares.column]
        uniform = np.exp(squares.terms @ unknowns[columns:])
        jacobian = np.hstack([uniform[:, None] * member * scale[0], (light * uniform)[:, None] * squares.terms])
        return light * uniform, jacobian

    unknowns = np.concatenate([start / scale[0], np.zeros(squares.terms.shape[1])])
    scatter, freedom = 0.0, len(squares.flux) - len(scale)
    variance = squares.variance
    for _ in range(3):
        sigma = np.sqrt(variance)
        unknowns = least_squares(
            lambda x, s: (model(x)[0] - squares.flux) / s,
            unknowns,
            jac=lambda x, s: model(x)[1] / s[:, None],
            args=(sigma,),
            method="lm",
        ).x
        predicted, jacobian = model(unknowns)
        miss2 = (predicted - squares.flux) ** 2

        def excess(relative: float, miss2: FloatArray = miss2, predicted: FloatArray = predicted) -> float:
            return float(np.sum(miss2 / (squares.variance + (relative * predicted) ** 2)) - freedom)

        scatter = brentq(excess, 0.0, 1.0) if excess(0.0) > 0.0 > excess(1.0) else 0.0
        variance = squares.variance + (scatter * predicted) ** 2
    jacobian = jacobian / np.sqrt(variance)[:, None]
    covariance = np.linalg.inv(jacobian.T @ jacobian) * np.outer(scale, scale)
    lights = np.asarray(unknowns[:columns] * scale[:columns])
    return lights, np.asarray(unknowns[columns:]), np.asarray(covariance, dtype=float), scatter


class _ColourFit(NamedTuple):
    curve: Curve
    top: float
    top_sigma: float
    gamma: float
    gamma_sigma: float


def _power_law(levels: NDArray[np.int64], light: FloatArray, covariance: FloatArray, colour: str) -> _ColourFit:
    """Power law through the flux of one colour at each level, or its table if that differs significantly."""
    from scipy.optimize import least_squares
    from scipy.stats import chi2

    root = np.linalg.cholesky(covariance)
    x = np.log(levels / TOP_LEVEL)

    def residual(unknowns: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.solve(root, light[-1] * unknowns[0] * np.exp(unknowns[1] * x) - light))

    fit = least_squares(residual, [1.0, 2.2], method="lm")
    sigma = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    gamma = float(fit.x[1])
    if 0.2 <= gamma <= 6.0 and chi2.sf(np.sum(fit.fun**2), len(light) - 2) > _SIGNIFICANT:
        top = float(light[-1] * fit.x[0])
        return _ColourFit(Curve(gamma), top, float(light[-1] * sigma[0]), gamma, float(sigma[1]))
    relative = np.maximum.accumulate(np.maximum(light / light[-1], 0.0))
    if relative[len(relative) // 2] >= 1.0:
        raise InputError(f"ramp-{colour}: the squares do not become brighter with their level; was this ramp shown?")
    table = Curve(None, tuple(levels.tolist()), (*np.minimum(relative[:-1], 1.0).tolist(), 1.0))
    return _ColourFit(table, float(light[-1]), float(np.sqrt(covariance[-1, -1])), gamma, float(sigma[1]))
