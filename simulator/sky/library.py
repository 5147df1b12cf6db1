"""Library spectra of stars, adjusted to the published colours of their types.

A library spectrum (Pickles 1998) has the jumps, lines and bands of its type, but its broad-band colours differ from the
published sequences by up to 0.1 mag (V−I by 0.07 in the median, at most 0.15). Each is therefore multiplied by a smooth
curve c(λ), with ln c a monotone cubic in ln λ through the effective wavelengths of U, B, V, R and I and constant beyond
the outer two, c(V) = 1. The four free values are determined by Newton's method such that the synthetic U−B, B−V, V−R
and V−I are the published ones. For giants V−R is not prescribed: c is smooth from V to I, and V−R is a prediction.
"""

from __future__ import annotations

import csv
import functools
import math
from dataclasses import dataclass

import numpy as np

from simulator.constants import PLANCK_J_S
from simulator.optics.curves import load_curve
from simulator.sky.monotone import MonotoneCubic
from startracker.core import SPEED_OF_LIGHT_KM_S, FloatArray
from startracker.files import included_lines

HC_J_NM = PLANCK_J_S * SPEED_OF_LIGHT_KM_S * 1e3 * 1e9
"""Energy of a photon times its wavelength."""

ZERO_FLUX = {"u": 417.5, "b": 632.0, "v": 363.1, "r": 217.7, "i": 112.6}
"""Mean F_λ over each of Bessell's passbands of a star of magnitude 0, 10⁻¹¹ erg cm⁻² s⁻¹ Å⁻¹; Bessell, Castelli & Plez
1998 (A&A 333, 231), table A2."""

EFFECTIVE_NM = {"u": 366.0, "b": 438.0, "v": 545.0, "r": 641.0, "i": 798.0}
"""Effective wavelengths; the same table."""

COLOURS = ("u_b", "b_v", "v_r", "v_i")

ANCHORS_DWARF = (
    *("B0V", "B1V", "B3V", "B6V", "B8V", "B9V", "A0V", "A2V", "A3V", "A5V", "A7V", "F0V", "F2V", "F5V", "F6V", "F8V"),
    *("G0V", "G2V", "G5V", "G8V", "K0V", "K2V", "K3V", "K4V", "K5V", "K7V", "M0V", "M1V", "M2V", "M3V", "M4V", "M4.5V"),
    *("M5V", "M6V"),
)
ANCHORS_GIANT = ("G0III", "G5III", "K0III", "K2III", "K4III", "K5III")
ANCHORS_LATE = ("M0III", "M2III", "M4III", "M5III", "M6III")
"""Types whose published colours are imposed; the others in `published_colours` are for tests."""

_BETWEEN = {"M4.5V": ("M4V", "M5V")}
"""Types missing in the library where the published colours bend: geometric mean of the neighbours."""

HOT_GIANT_B_V = 0.45
"""Bluer giants have the spectra of dwarfs, as their broad-band colours differ by less than 0.03 mag."""

_STEP_NM = 0.5


@dataclass(frozen=True, eq=False)
class Sequence:
    """Spectra of T types ordered by one coordinate."""

    key: FloatArray
    """(T,): The coordinate, B−V or a subtype, ascending."""
    wavelength_nm: FloatArray
    """(W,): Wavelengths."""
    photons: FloatArray
    """(T, W): Photon flux densities, up to a factor."""
    types: tuple[str, ...]
    """Spectral types."""


@functools.cache
def published_colours(kind: str) -> dict[str, dict[str, float]]:
    """Published colours by type; `kind` is ``dwarfs`` or ``giants``; NaN if a colour is not given."""
    rows = csv.DictReader(included_lines("simulator.sky", f"colours_{kind}.csv"))
    return {row["type"]: {name: float(row[name] or math.nan) for name in COLOURS} for row in rows}


@functools.cache
def library() -> tuple[FloatArray, dict[str, FloatArray]]:
    """Wavelengths (nm) and F_λ of every type as published, 1 at 555 nm."""
    lines = included_lines("simulator.sky", "pickles1998.csv")
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    spectra = dict(zip(lines[0].split(",")[1:], table[:, 1:].T, strict=True))
    # The geometric mean is the mean in magnitudes, in which spectra are interpolated between types as well.
    for between, (one, other) in _BETWEEN.items():
        spectra[between] = np.sqrt(spectra[one] * spectra[other])
    return table[:, 0], spectra


@functools.cache
def sequence(name: str) -> Sequence:
    """One of the sequences ``dwarf`` and ``giant`` (by B−V) and ``late_giant`` (by M subtype), with imposed colours."""
    dwarfs, giants = published_colours("dwarfs"), published_colours("giants")
    if name == "dwarf":
        chosen = [(dwarfs[t]["b_v"], t, dwarfs[t]) for t in ANCHORS_DWARF]
    elif name == "giant":
        chosen = [(dwarfs[t]["b_v"], t, dwarfs[t]) for t in ANCHORS_DWARF if dwarfs[t]["b_v"] < HOT_GIANT_B_V]
        chosen += [(giants[t]["b_v"], t, giants[t]) for t in ANCHORS_GIANT]
    else:
        chosen = [(float(t[1]), t, giants[t]) for t in ANCHORS_LATE]
    wavelength_nm, spectra = library()
    # F_λ λ is proportional to the number of photons.
    photons = [with_colours(wavelength_nm, spectra[t], colours) * wavelength_nm for _, t, colours in chosen]
    return Sequence(
        np.array([key for key, *_ in chosen]), wavelength_nm, np.array(photons), tuple(c[1] for c in chosen)
    )


def magnitudes(wavelength_nm: FloatArray, f_lambda: FloatArray) -> dict[str, float]:
    """Synthetic U, B, V, R, I: m = −2.5 log₁₀(∫ F_λ S dλ / ∫ S dλ / `ZERO_FLUX`).

    Parameters
    ----------
    wavelength_nm, f_lambda : (W,) array
        Energy flux density, 10⁻¹¹ erg cm⁻² s⁻¹ Å⁻¹; interpolated linearly.
    """
    mags = {}
    for band, zero in ZERO_FLUX.items():
        nm, passband = _passband(band)
        mean = np.trapezoid(np.interp(nm, wavelength_nm, f_lambda) * passband, nm) / np.trapezoid(passband, nm)
        mags[band] = -2.5 * math.log10(mean / zero)
    return mags


def synthetic_colours(wavelength_nm: FloatArray, f_lambda: FloatArray) -> FloatArray:
    """Synthetic U−B, B−V, V−R, V−I of a spectrum; arguments as in `magnitudes`."""
    m = magnitudes(wavelength_nm, f_lambda)
    return np.array([m["u"] - m["b"], m["b"] - m["v"], m["v"] - m["r"], m["v"] - m["i"]])


def with_colours(wavelength_nm: FloatArray, f_lambda: FloatArray, colours: dict[str, float]) -> FloatArray:
    """F_λ times the smooth curve that gives the colours; a colour of NaN imposes no condition.

    Newton's method with the Jacobian for narrow bands; the colours are reproduced to 1e-6 mag.
    """
    target = np.array([colours[name] for name in COLOURS])
    wanted = np.isfinite(target)
    nodes = np.log([EFFECTIVE_NM[b] for b in "ubvri"])
    used = np.array([True, True, True, wanted[2], True])  # without V−R there is no node in R
    x = np.clip(np.log(wavelength_nm), nodes[0], nodes[-1])
    step = np.zeros(4)  # −2.5 log₁₀ c of U, B, R, I
    for _ in range(60):
        shift = np.array([step[0], step[1], 0.0, step[2], step[3]])
        curve = 10.0 ** (-0.4 * MonotoneCubic.through(nodes[used], shift[used])(x))
        miss = np.where(wanted, target - synthetic_colours(wavelength_nm, f_lambda * curve), 0.0)
        if np.abs(miss).max() < 1e-7:
            break
        # In narrow bands the curve changes each magnitude by its own value, and V is fixed. The misses of the colours
        # u−b, b−v, v−r and v−i then give the changes of u, b, r and i.
        step += [miss[0] + miss[1], miss[1], -miss[2], -miss[3]]
    return np.asarray(f_lambda * curve)


@functools.cache
def _passband(band: str) -> tuple[FloatArray, FloatArray]:
    curve = load_curve(f"bessell_{band}", "passband")
    nm = np.arange(curve.wavelength_nm[0], curve.wavelength_nm[-1] + _STEP_NM / 2, _STEP_NM)
    return nm, curve(nm)
