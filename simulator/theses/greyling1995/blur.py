"""The star image (Greyling 1995, section 4.1): Airy pattern, the Gaussian that represents it, and its pixels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar

from simulator.optics import airy
from simulator.optics.psf import SIGMA_PER_RING
from simulator.theses.figures import section_of
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from startracker.centroid.bias import moment_bias
from startracker.core import FloatArray

FIRST_DARK_RING, SECOND_DARK_RING = airy.FIRST_RING * np.pi, 7.015586669815619
"""First zeros of J₁: 3.8317 and 7.0156."""

X_FIT: FloatArray = np.arange(1.0, 51.0) / 10.0
"""Points at which the thesis compares the two functions: 0.1 to 5 in steps of 0.1, the argument of the Bessel
function."""

OFFSETS: FloatArray = np.arange(11.0) * 0.05
"""Offsets of Table 4.1, detector lengths."""

THESIS_SIGMA, THESIS_FIT_SIGMA = 1.23, 1.3497

_ROWS, _COLUMNS = np.mgrid[-2:3, -2:3].astype(float)
"""Offsets of the pixels of a 5 × 5 window from its centre."""

CRITERIA: dict[str, Callable[[FloatArray], float]] = {
    "range of the error (max − min)": lambda e: float(np.ptp(e)),
    "largest absolute error": lambda e: float(np.abs(e).max()),
    "rms error": lambda e: float(np.sqrt(np.mean(e**2))),
}
"""Possible meanings of "the least error between the Airy and Gaussian representations"."""


def airy_pattern(x: ArrayLike) -> FloatArray:
    """Airy pattern [2J₁(x)/x]², 1 at the centre, at x = ka sin θ (eq. 4.1)."""
    return np.asarray(airy.intensity(np.asarray(x, dtype=float) / np.pi) * 4.0 / np.pi)


def gaussian(x: ArrayLike, sigma: float) -> FloatArray:
    """exp(−x²/2σ²) (eq. 4.3)."""
    return np.asarray(np.exp(-0.5 * (np.asarray(x, dtype=float) / sigma) ** 2))


def best_sigma(criterion: Callable[[FloatArray], float], x: FloatArray = X_FIT) -> float:
    """σ of the Gaussian closest to the Airy pattern at the positions `x`, by a criterion of their difference."""
    truth = airy_pattern(x)
    return _least(lambda sigma: criterion(gaussian(x, sigma) - truth), 1.0, 2.0)


def _least(function: Callable[[float], float], low: float, high: float) -> float:
    """Minimum of a function between two bounds."""
    return float(minimize_scalar(function, bounds=(low, high), method="bounded", options={"xatol": 1e-9}).x)


def airy_bias(offset_px: ArrayLike = OFFSETS) -> FloatArray:
    """Offset minus first moment over 5 × 5 point samples of an Airy pattern with a first dark ring of radius
    `FIRST_DARK_RING` px."""
    out = []
    for offset in np.atleast_1d(np.asarray(offset_px, dtype=float)):
        samples = airy_pattern(np.hypot(_COLUMNS - offset, _ROWS))
        out.append(offset - float((samples * _COLUMNS).sum() / samples.sum()))
    return np.array(out)


def sigma_of_bias() -> float:
    """σ of the point-sampled Gaussian whose centroid bias is closest to that of the Airy pattern, by least squares over
    `OFFSETS`."""
    truth = airy_bias(OFFSETS)
    return _least(
        lambda sigma: float(((moment_bias(OFFSETS, sigma, 5, integrated=False) - truth) ** 2).sum()), 0.7, 1.6
    )


def spread(sigma_px: float) -> FloatArray:
    """Intensity (5, 5) at pixel centres, relative to the maximum, of a star at the centre of a pixel."""
    return gaussian(np.hypot(_COLUMNS, _ROWS), sigma_px)


def section(
    f_number: float = 1.4, wavelength_um: float = 0.555, ring_px: float = 2.0, pitch_um: float = 10.0
) -> Section:
    """Section 4.1: rows and Figs. 4.1 to 4.4.

    `f_number` and `wavelength_um` are those of the focused lens; for Fig. 4.2 (a) the first dark ring is at `ring_px`
    pixels of `pitch_um` because of defocus.
    """
    focused_um = airy.first_ring() * f_number * wavelength_um
    values = _airy_values() | _lens_values(focused_um, ring_px * pitch_um) | _fit_values(ring_px) | _spread()
    return section_of("greyling1995/blur", "Chapter 4.1: the stellar image", values)


def _fit_values(ring_px: float) -> Values:
    found = {name: best_sigma(criterion) for name, criterion in CRITERIA.items()}
    minimax = found["range of the error (max − min)"]
    truth, light = airy_pattern(X_FIT), spread(THESIS_FIT_SIGMA)
    excess = [np.ptp(gaussian(X_FIT, s) - truth) for s in (THESIS_FIT_SIGMA, minimax)]
    x = np.linspace(0.0, 5.0, 501)
    return {
        "minimax": minimax,
        "range_excess": excess[0] / excess[1] - 1,
        "sigmas": found,
        "ring": best_sigma(CRITERIA["range of the error (max − min)"], X_FIT[X_FIT < FIRST_DARK_RING]),
        "bias_sigma": sigma_of_bias(),
        "ring_px": ring_px,
        "ring_sigma_px": SIGMA_PER_RING * ring_px,
        "fitted_ring_px": THESIS_FIT_SIGMA / SIGMA_PER_RING,
        "largest_error": np.abs(gaussian(X_FIT, THESIS_FIT_SIGMA) - truth).max(),
        "share_123": 100.0 * _central_share(THESIS_SIGMA),
        "share_135": 100.0 * _central_share(THESIS_FIT_SIGMA),
        "sigma_of_80": _least(lambda sigma: (_central_share(sigma) - 0.8) ** 2, 0.5, 2.0),
        "above": int((light > 0.3).sum()),
        "light": light,
        "fit_x": x,
        "fits": [{"sigma": s, "off": gaussian(x, s) - airy_pattern(x)} for s in (THESIS_FIT_SIGMA, THESIS_SIGMA)],
        "first_ring": FIRST_DARK_RING,
    }


def _central_share(sigma_px: float) -> float:
    """Fraction of the light in the central 3 × 3 of the 5 × 5 pixels."""
    light = spread(sigma_px)
    return float(light[1:4, 1:4].sum() / light.sum())


def _airy_values() -> Values:
    x = np.linspace(-12.0, 12.0, 961)
    airy_x = airy_pattern(x)
    dark = (FIRST_DARK_RING, SECOND_DARK_RING)
    rings = [
        {"at": sign * ring, "label": "dark rings, 3.83 and 7.02" if sign * ring == FIRST_DARK_RING else None}
        for ring in dark
        for sign in (1.0, -1.0)
    ]
    return {
        "within_percent": [100.0 * float(airy.encircled_energy(ring / np.pi)) for ring in dark],
        "x": x,
        "airy": airy_x,
        "outside": np.where(np.abs(x) >= FIRST_DARK_RING, 20.0 * airy_x, np.nan),
        "rings": rings,
        "picture": np.log10(np.maximum(airy_pattern(np.hypot(*np.meshgrid(x[::4], x[::4]))), 1e-4)),
    }


def _lens_values(focused_um: float, wide_um: float) -> Values:
    r_um, x = np.linspace(-30.0, 30.0, 1201), np.linspace(-5.0, 5.0, 401)
    return {
        "disk_um": 2.0 * focused_um,
        "r_um": r_um,
        "rings_um": (focused_um, wide_um),
        "lenses": [airy_pattern(r_um / ring_um * FIRST_DARK_RING) for ring_um in (focused_um, wide_um)],
        "near_x": x,
        "near_airy": airy_pattern(x),
        "gaussians": [gaussian(x, sigma) for sigma in (THESIS_FIT_SIGMA, THESIS_SIGMA)],
    }


def _spread() -> Values:
    panels = []
    for sigma in (THESIS_FIT_SIGMA, THESIS_SIGMA):
        image = 100.0 * spread(sigma)
        cells = stamp_cells(image[::-1], "{:.0f}")
        panels.append({"sigma": sigma, "image": image, "cells": cells, "share": 100 * _central_share(sigma)})
    return {"panels": panels}


def stamp_cells(stamp: FloatArray, form: str) -> list[Values]:
    """Text and position of every pixel of a 5 × 5 image, row by row from the bottom."""
    return [{"x": x - 2, "y": y - 2, "text": form.format(value)} for (y, x), value in np.ndenumerate(stamp)]
