"""Spectral responses of the eye and of the CCD (Greyling 1995, Figs. 2.2, 3.10 and 3.11)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.optics.curves import load_curve
from simulator.sky.library import HC_J_NM
from simulator.study.style import BLUE, GREEN, INK, ORANGE, VERMILION
from simulator.theses.greyling1995.starlight import BANDS_UM, EFFICIENCY, SECOND_EFFICIENCY
from simulator.theses.printed import new_figure
from simulator.theses.tables import Values

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FIGURES", "ccd_efficiency", "ccd_response_a_w", "eye_response", "values"]

FloatArray = NDArray[np.float64]

WAVELENGTH_NM: FloatArray = np.arange(360.0, 1251.0)
CHARGE_C = 1.602176634e-19


def eye_response(wavelength_nm: FloatArray = WAVELENGTH_NM) -> FloatArray:
    """Luminous efficiency (W,) of the eye by day, 1 at its peak: CIE 1924; 0 where the table ends."""
    from colour.colorimetry import SDS_LEFS_PHOTOPIC

    table = SDS_LEFS_PHOTOPIC["CIE 1924 Photopic Standard Observer"]
    return np.asarray(np.interp(wavelength_nm, table.wavelengths, table.values, left=0.0, right=0.0))


def ccd_efficiency(wavelength_nm: FloatArray = WAVELENGTH_NM, name: str = "tc211") -> FloatArray:
    """Quantum efficiency (W,) of a detector of the product's library, electrons a photon."""
    return np.asarray(load_curve(name, "quantum_efficiency")(wavelength_nm), dtype=float)


def ccd_response_a_w(wavelength_nm: FloatArray = WAVELENGTH_NM, name: str = "tc211") -> FloatArray:
    """Response (W,), amperes a watt: R = η q λ / (h c)."""
    return np.asarray(ccd_efficiency(wavelength_nm, name) * CHARGE_C * wavelength_nm / HC_J_NM)


def _peak_nm(values: FloatArray) -> float:
    return float(WAVELENGTH_NM[int(np.argmax(values))])


def values() -> Values:
    """Where the curves have their peaks."""
    return {
        "eye_peak_nm": _peak_nm(eye_response()),
        "response_peak_nm": _peak_nm(ccd_response_a_w()),
        "ccd44_peak_nm": _peak_nm(ccd_response_a_w(name="ccd44_82")),
        "half_nm": _half_nm(),
        "efficiency_peak_um": 1e-3 * _peak_nm(ccd_efficiency()),
    }


def _half_nm() -> float:
    """Longest wavelength at which the TC211's response is half of its peak."""
    response = ccd_response_a_w()
    return float(WAVELENGTH_NM[np.flatnonzero(response >= 0.5 * response.max())[-1]])


def _both_figure() -> Figure:
    figure, axes = new_figure(1, 1, (6.4, 3.9))
    axes.plot(WAVELENGTH_NM / 1e3, eye_response(), color=GREEN, label="eye by day, CIE 1924")
    for name, colour, line, label in (
        ("tc211", BLUE, "--", "TC211"),
        ("ccd44_82", VERMILION, "-.", "back-illuminated CCD"),
    ):
        response = ccd_response_a_w(name=name)
        axes.plot(WAVELENGTH_NM / 1e3, response / response.max(), color=colour, linestyle=line, label=label)
    axes.set(
        xlabel="wavelength [µm]",
        ylabel="response to a watt, relative to the peak",
        ylim=(0.0, 1.3),
        title="Fig. 2.2  Spectral responses of a CCD and the human eye",
    )
    axes.legend(loc="upper right", ncols=3)
    return figure


def _efficiency_figure() -> Figure:
    figure, axes = new_figure(1, 1, (6.4, 3.9))
    axes.plot(WAVELENGTH_NM / 1e3, 100.0 * ccd_efficiency(), color=BLUE, label="product's curve of the TC211")
    axes.plot(BANDS_UM, 100.0 * EFFICIENCY, "D", color=INK, label="ccdmag.m, first script")
    axes.plot(
        BANDS_UM, 100.0 * SECOND_EFFICIENCY, "s", color=ORANGE, markerfacecolor="none", markersize=8,
        label="ccdmag.m, second script",
    )  # fmt: skip
    axes.axvline(0.75, color=VERMILION, linestyle=":", label="peak as printed, 0.75 µm")
    axes.set(
        xlabel="wavelength [µm]",
        ylabel="quantum efficiency [%]",
        ylim=(0.0, 60.0),
        title="Fig. 3.10  Quantum efficiency of a CCD",
    )
    axes.legend(loc="upper right")
    return figure


def _response_figure() -> Figure:
    figure, axes = new_figure(1, 1, (6.4, 3.9))
    axes.plot(WAVELENGTH_NM / 1e3, ccd_response_a_w(), color=BLUE, label="TC211, η q λ / (h c)")
    ideal = CHARGE_C * WAVELENGTH_NM / HC_J_NM
    axes.plot(WAVELENGTH_NM / 1e3, 0.5 * ideal, color=ORANGE, linestyle="--", label="every second photon")
    axes.axvline(0.70, color=VERMILION, linestyle=":", label="peak as printed, 700 nm")
    axes.set(
        xlabel="wavelength [µm]",
        ylabel="response [A/W]",
        ylim=(0.0, 0.62),
        title="Fig. 3.11  Frequency response of the TC211",
    )
    axes.legend(loc="upper left")
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "fig_2_2_eye_and_ccd": _both_figure,
    "fig_3_10_quantum_efficiency": _efficiency_figure,
    "fig_3_11_response": _response_figure,
}
"""File name to the function that draws it, in the order of the thesis."""
