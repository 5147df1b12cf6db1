"""Photometry: electrons a second from a star's magnitude and colour, and from the diffuse sky."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.optics.curves import Curve
from simulator.sky.spectra import B_V_RANGE, DEFAULT_B_V, SOLAR_B_V, SPECTRA
from startracker.errors import InputError
from startracker.registry import lookup

FloatArray = NDArray[np.float64]

_B_V_STEP = 0.01
_GRID_STEP_NM = 1.0
_SQUARE_DEGREE_SR = math.radians(1.0) ** 2


def integrate(photons: Curve, response: Curve) -> float:
    """Electrons that photons of a spectrum set free, ∫ n_λ η_λ dλ.

    Parameters
    ----------
    photons : Curve
        Photon flux density, photons cm⁻² s⁻¹ nm⁻¹.
    response : Curve
        Electrons a photon: transmission × quantum efficiency.

    Returns
    -------
    float
        Electrons cm⁻² s⁻¹.
    """
    product = photons * response
    return float(np.trapezoid(product.value, product.wavelength_nm))


@dataclass(frozen=True, eq=False)
class Photometer:
    """What an aperture and a response make of starlight.

    N = A ∫ n_λ(B−V) η_λ dλ × 10^(−0.4 V) electrons a second, with n_λ the photon flux density of a V = 0 star of that
    colour (`simulator.sky.spectra`), η transmission × quantum efficiency and A the area of the aperture. The integral
    is done once for colours 0.01 apart; between them the table is interpolated (relative error below 2 × 10⁻⁵).

    Parameters
    ----------
    response : Curve
        Transmission × quantum efficiency.
    aperture_area_cm2 : float
        Area of the entrance pupil, cm².
    spectrum : str
        Name of a family of spectra; also those of the entry-point group ``boresight.spectra``.

    Raises
    ------
    InputError
        For an area that is not positive, or an unknown name.
    """

    response: Curve
    aperture_area_cm2: float
    spectrum: str = "blackbody"
    _b_v: FloatArray = field(init=False, repr=False)
    _rate: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.aperture_area_cm2) and self.aperture_area_cm2 > 0):
            raise InputError(f"the area of an aperture must be positive; got {self.aperture_area_cm2} cm²")
        wavelength_nm, value = _sampled(self.response)
        b_v = np.linspace(*B_V_RANGE, round((B_V_RANGE[1] - B_V_RANGE[0]) / _B_V_STEP) + 1)
        photons = lookup("spectra", SPECTRA, self.spectrum)(wavelength_nm, b_v)
        rate = self.aperture_area_cm2 * np.trapezoid(photons * value, wavelength_nm, axis=1)
        for array in (b_v, rate):
            array.flags.writeable = False
        object.__setattr__(self, "_b_v", b_v)
        object.__setattr__(self, "_rate", rate)

    def electrons_per_s(self, v_mag: ArrayLike, b_v: ArrayLike) -> FloatArray:
        """Photo-electrons a second of stars, over all their pixels.

        Parameters
        ----------
        v_mag : (N,) array
            Magnitudes V.
        b_v : (N,) array
            Colours B−V; NaN (unknown) counts as `DEFAULT_B_V`, others are kept within `B_V_RANGE`.
        """
        colour = np.asarray(b_v, dtype=float)
        colour = np.where(np.isnan(colour), DEFAULT_B_V, colour)
        scale = 10.0 ** (-0.4 * np.asarray(v_mag, dtype=float))
        return np.asarray(np.interp(colour, self._b_v, self._rate) * scale)

    def background_e_s_pixel(self, s10: float, solid_angle_sr: float) -> float:
        """Electrons a second and pixel of diffuse light of the Sun's colour.

        Parameters
        ----------
        s10 : float
            Surface brightness in stars of V = 10 a square degree (1 S10 = 27.78 mag arcsec⁻²; Leinert et al. 1998).
        solid_angle_sr : float
            Solid angle of a pixel.
        """
        stars = s10 * solid_angle_sr / _SQUARE_DEGREE_SR
        return float(stars * self.electrons_per_s(10.0, SOLAR_B_V))


def _sampled(response: Curve) -> tuple[FloatArray, FloatArray]:
    """The response at its own points and at least every nanometre: a spectrum bends where a flat response does not."""
    low, high = response.wavelength_nm[0], response.wavelength_nm[-1]
    fine = np.linspace(low, high, math.ceil((high - low) / _GRID_STEP_NM) + 1)
    wavelength_nm = np.unique(np.concatenate([fine, response.wavelength_nm]))
    return wavelength_nm, response(wavelength_nm)
