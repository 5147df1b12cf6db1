"""Protons and electrons trapped in the Earth's magnetic field: AP-8 and AE-8 (Sawyer & Vette 1976; Vette 1991).

The maps give the omnidirectional flux as a function of McIlwain's L and B/B₀, which must be computed with the field
model for which the maps were made: Jensen & Cain (1962) for epoch 1960, and for AP-8 at solar maximum GSFC 12/66 for
epoch 1970. With today's weaker field the flux at low altitude would be several times too large. Because the South
Atlantic Anomaly has since drifted to the west by 0.3° per year, positions are rotated to the east by the drift since
that epoch, as in UNILIB.

Maps and field models are taken from IRBEM, through the package aep8.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from simulator.environment.coefficients import Estimate, coefficient
from simulator.environment.spectrum import Spectrum
from startracker.core import FloatArray
from startracker.errors import InputError

DRIFT_DEG_YEAR = 0.3
"""Westward drift of the anomaly."""
_EPOCHS = {"min": 1960.0, "max": 1970.0}
"""Epoch of the proton map's field by solar activity."""

PROTON_MEV = np.array(
    [
        0.1,
        0.2,
        0.4,
        0.6,
        1,
        2,
        4,
        6,
        8,
        10,
        15,
        20,
        25,
        30,
        35,
        40,
        50,
        60,
        80,
        100,
        125,
        150,
        200,
        250,
        300,
        350,
        400.0,
    ]
)
ELECTRON_MEV = np.concatenate([[0.05, 0.07], np.arange(1, 10) / 10.0, np.arange(4, 29) / 4.0])
"""Energies of spectra; the maps end at 400 MeV and 7 MeV. Below 0.05 MeV IRBEM returns no electrons, where there are
more, so the spectrum starts there."""

_BLOCK = 4096
"""Positions that are computed at once, which limits memory."""


class TrappedBelts:
    """Trapped particles at positions.

    Parameters
    ----------
    solar : str
        ``min`` or ``max``.
    estimate : str
        Multiplies the fluxes by the low or high end of the models' accuracy.

    Raises
    ------
    InputError
        If the package aep8 is not installed.
    """

    def __init__(self, solar: str, estimate: Estimate = "nominal") -> None:
        self.solar = solar
        self._protons, self._electrons = _models(solar)
        self._factors = coefficient("trapped_protons", estimate), coefficient("trapped_electrons", estimate)

    def fluxes(
        self,
        itrs_km: FloatArray,
        year: float,
        proton_mev: FloatArray = PROTON_MEV,
        electron_mev: FloatArray = ELECTRON_MEV,
    ) -> tuple[FloatArray, FloatArray]:
        """Omnidirectional fluxes above energies at N positions, particles/cm²/s: protons (N, P), electrons (N, E).

        Parameters
        ----------
        itrs_km : (N, 3) array
            Positions in the rotating frame of the Earth.
        year : float
            Date, for the drift of the anomaly.
        proton_mev : (P,) array
            0.1 to 400 MeV.
        electron_mev : (E,) array
            0.05 to 7 MeV; may be empty.
        """
        parts = []
        for start in range(0, len(itrs_km), _BLOCK):
            block = itrs_km[start : start + _BLOCK]
            shells = _shells(self._protons, block, year - _EPOCHS[self.solar])
            protons = _above(self._protons, shells, proton_mev)
            if self.solar == "max" and len(electron_mev):  # at solar maximum the electrons have another field
                shells = _shells(self._electrons, block, year - _EPOCHS["min"])
            parts.append((protons, _above(self._electrons, shells, electron_mev)))
        protons, electrons = (np.concatenate(kind) for kind in zip(*parts, strict=True))
        return self._factors[0] * protons, self._factors[1] * electrons

    def mean_spectra(self, itrs_km: FloatArray, year: float) -> tuple[Spectrum, Spectrum]:
        """Mean flux over N positions of protons and of electrons."""
        protons, electrons = self.fluxes(itrs_km, year)
        return Spectrum(PROTON_MEV, protons.mean(axis=0)), Spectrum(ELECTRON_MEV, electrons.mean(axis=0))


def _shells(model: Any, itrs_km: FloatArray, years: float) -> tuple[FloatArray, FloatArray]:
    """McIlwain's L and B/B₀ at N positions, in the model's field rotated by the drift of some years; NaN on open field
    lines."""
    from astropy import units
    from astropy.coordinates import EarthLocation
    from astropy.time import Time

    # The rotation to the east, against the drift, gives a position the longitude relative to the anomaly that it would
    # have had at the epoch of the field.
    angle = np.radians(DRIFT_DEG_YEAR * years)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    location = EarthLocation.from_geocentric(*(turn @ itrs_km.T), unit=units.km)
    dates = Time(np.zeros(location.shape), format="unix")  # the fields have fixed epochs
    with np.errstate(invalid="ignore"):
        shell, field = model.geomagnetic_coordinates(location, dates)
    return shell, field


def _above(model: Any, shells: tuple[FloatArray, FloatArray], energy_mev: FloatArray) -> FloatArray:
    """Flux above energies (E,) at field lines (N,): (N, E), particles/cm²/s."""
    from astropy import units

    shell, field = (part[:, None] for part in shells)
    with np.errstate(invalid="ignore"):
        flux = model.integral_flux_for_geomagnetic_coordinates(shell, field, np.asarray(energy_mev) * units.MeV)
    return np.asarray(np.nan_to_num(flux.value, nan=0.0))  # open field lines trap no particles


def _models(solar: str) -> tuple[Any, Any]:
    try:
        import aep8
    except ImportError:
        raise InputError(
            "environment.trapped: ap8 needs the package aep8; install it with: pip install 'boresight[environment]'"
        ) from None
    return aep8.model(particle="p", solar=solar), aep8.model(particle="e", solar=solar)
