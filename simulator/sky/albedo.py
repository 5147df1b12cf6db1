"""Spectra of bodies of the solar system: sunlight times albedo, scaled to their V."""

from __future__ import annotations

import csv
import functools

import numpy as np

from simulator.optics.curves import load_curve
from simulator.sky.spectra import SOLAR_B_V, SPECTRA, V_GRID_NM, colour_sequence, mean_v
from startracker.core import FloatArray
from startracker.files import included_lines
from startracker.settings.registry import lookup

_WIDE = {360.0: "u", 436.0: "b", 549.0: "v", 641.0: "r", 798.0: "i"}
"""Bands of the table that correspond to Bessell's passbands (R and I are Cousins'), by effective wavelength, nm."""

_STEPS = 20
"""Iterations of `_through_means`, more than it needs to converge to rounding."""


def body_photons(wavelength_nm: FloatArray, name: str, spectrum: str) -> FloatArray:
    """Photon flux density (W,) of a body of V = 0, photons cm⁻² s⁻¹ nm⁻¹.

    n_λ ∝ n_λ(Sun) p(λ), with p the published albedo (`relative_albedo`); the mean of F_λ over V is the same as for a
    star of V = 0.

    Parameters
    ----------
    wavelength_nm : (W,) array
        Wavelengths, nm.
    name : str
        Planet or ``Moon``; others (``Sun``, ``Earth``) have the spectrum of sunlight.
    spectrum : str
        Family of spectra whose star of B−V = 0.653 is the Sun.
    """
    family = lookup("spectra", SPECTRA, spectrum)

    def reflected(nm: FloatArray, albedo: FloatArray) -> FloatArray:
        return np.asarray(family(nm, np.array([SOLAR_B_V]), np.zeros(1)) * albedo)

    # The family of spectra is normalised to V = 0, and so the albedo is divided by its own mean over V.
    grid, here = relative_albedo(name, V_GRID_NM), relative_albedo(name, wavelength_nm)
    dimmed = mean_v(V_GRID_NM, reflected(V_GRID_NM, grid)) / mean_v(V_GRID_NM, reflected(V_GRID_NM, np.ones(len(grid))))
    return np.asarray(reflected(wavelength_nm, here)[0] / dimmed[0])


def relative_albedo(name: str, wavelength_nm: FloatArray) -> FloatArray:
    """Albedo (W,) of a body up to a factor, interpolated linearly between the published bands and constant beyond; 1
    for bodies without a published albedo.

    The published albedo of a wide band is a mean over it. The values at the effective wavelengths of U, B, V, Rc and Ic
    are scaled until the means of reflected sunlight in Bessell's bands are those published (for steep albedos, such as
    that of Uranus, the error in V − Rc would otherwise be 0.1 mag).
    """
    bands = _table().get(name)
    return np.ones(len(wavelength_nm)) if bands is None else np.asarray(np.interp(wavelength_nm, *bands))


@functools.cache
def _table() -> dict[str, tuple[FloatArray, FloatArray]]:
    """Wavelengths (nm) and albedos by name of body."""
    rows = list(csv.DictReader(included_lines("simulator.sky", "albedo_bodies.csv")))
    table = {}
    for name in dict.fromkeys(row["body"] for row in rows):
        nm, albedo = (
            np.array([float(row[c]) for row in rows if row["body"] == name]) for c in ("wavelength_nm", "albedo")
        )
        wide = [k for k, at in enumerate(nm) if at in _WIDE]
        table[name] = (nm, _through_means(nm, albedo, wide) if len(wide) == len(_WIDE) else albedo)
    return table


def _through_means(nm: FloatArray, means: FloatArray, wide: list[int]) -> FloatArray:
    """Values at the bands for which the means over the wide bands are those given."""
    grid = np.arange(290.0, 930.0)
    sunlight = colour_sequence(grid, np.array([SOLAR_B_V]))[0] / grid
    weights = np.array([sunlight * load_curve(f"bessell_{_WIDE[nm[k]]}", "passband")(grid) for k in wide])
    weights /= weights.sum(axis=1, keepdims=True)
    values = means.copy()
    # Fixed-point iteration: each value is scaled by the ratio of the published mean to the current one.
    for _ in range(_STEPS):
        values[wide] *= means[wide] / (weights @ np.interp(grid, nm, values))
    return values
