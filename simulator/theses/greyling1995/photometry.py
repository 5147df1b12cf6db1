"""Sections 3.4.1, 3.4.3 and 3.4.4, Figs. 3.12 to 3.15: starlight, output voltage, and a lens that cannot be built."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.scenario.physics import violations
from simulator.sky.colours import spectral_coordinates
from simulator.study.style import BLUE, GREEN, INK, ORANGE, VERMILION
from simulator.theses.greyling1995 import spectral
from simulator.theses.greyling1995.noise import BRIGHTEST_V, FAINTEST_V
from simulator.theses.greyling1995.starlight import (
    BANDS_UM,
    IRRADIANCE_W_CM2_UM,
    PROTOTYPE_VOLT_PER_E,
    SATURATION_MV,
    VOLT_PER_E,
    camera_mv,
    irradiance_w_cm2_um,
    second_script_mv,
    thesis_mv,
)
from simulator.theses.printed import Section, new_figure
from simulator.theses.tables import Values, table_rows
from startracker.catalog import load_catalog

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

ZERO_LUX = -13.94188
"""m₀ of (3.6): m_v = −2.5 log F + m₀, F in lux."""

FIELD_DEG = 10.0

STARS = (
    ("Sirius, A1V", 2491, -1.47, "-", BLUE),
    ("α Lyrae, A0V", 7001, 0.03, "--", GREEN),
    ("α Arietis, K2III", 617, 1.99, "-.", ORANGE),
    ("61 Cygni B, K7V", 8086, 6.02, ":", VERMILION),
)
"""Table 3.4: name and type, HR number, printed V; style of its line."""


def section() -> Section:
    """Irradiances, output voltages, and the lens they were computed for."""
    figures: dict[str, Callable[[], Figure]] = {
        **spectral.FIGURES,
        "fig_3_12_irradiances": irradiance_figure,
        "fig_3_13_voltage_V6.5": functools.partial(voltage_figure, FAINTEST_V),
        "fig_3_14_voltage_V-1.47": functools.partial(voltage_figure, BRIGHTEST_V),
        "fig_3_15_voltage_magnitude": magnitude_figure,
    }
    values = _magnitude_values() | _irradiance_values() | _voltage_values() | _lens_values()
    rows = table_rows("greyling1995/spectral", spectral.values()) + table_rows("greyling1995/photometry", values)
    return Section("Chapter 3.4: starlight, output voltage and the lens", rows, figures)


def illuminance_lux(curve: str) -> float:
    """Illuminance of an A0V star of V = 0: K_m ∫ E_λ V_λ dλ, from this product's spectrum.

    Parameters
    ----------
    curve : {"photopic", "scotopic"}
        CIE 1924 with K_m = 683.002 lm/W, or CIE 1951 (night vision) with 1700.06 lm/W (CIE 18.2-1983).
    """
    from colour.colorimetry import SDS_LEFS_PHOTOPIC, SDS_LEFS_SCOTOPIC

    table, most = {
        "photopic": (SDS_LEFS_PHOTOPIC["CIE 1924 Photopic Standard Observer"], 683.002),
        "scotopic": (SDS_LEFS_SCOTOPIC["CIE 1951 Scotopic Standard Observer"], 1700.06),
    }[curve]
    wavelength_nm = np.arange(360.0, 831.0)
    efficiency = np.interp(wavelength_nm, table.wavelengths, table.values, left=0.0, right=0.0)
    watt_m2_nm = irradiance_w_cm2_um(wavelength_nm, 0.0, 0.0, 0.0) * 1e4 * 1e-3
    return float(most * np.trapezoid(efficiency * watt_m2_nm, wavelength_nm))


def _magnitude_values() -> Values:
    return {
        "printed_lux": 10.0 ** (ZERO_LUX / 2.5),
        "day": illuminance_lux("photopic"),
        "night": illuminance_lux("scotopic"),
    }


def _irradiance_values() -> Values:
    bands = []
    for um, printed in zip(BANDS_UM, IRRADIANCE_W_CM2_UM * 1e12, strict=True):
        nearby = np.linspace(um * 1e3 - 25.0, um * 1e3 + 25.0, 201)
        bands.append(
            {"um": um, "irradiance": printed, "found": irradiance_w_cm2_um(nearby, 0.0, 0.0, 0.0).mean() * 1e12}
        )
    return {"bands": bands}


def _voltage_values() -> Values:
    coded, bright = (float(thesis_mv(v_mag, extra_lambda=True)) for v_mag in (FAINTEST_V, BRIGHTEST_V))
    right, bright_right = (float(thesis_mv(v_mag, extra_lambda=False)) for v_mag in (FAINTEST_V, BRIGHTEST_V))
    return {
        "coded": coded,
        "coded_prototype": coded * PROTOTYPE_VOLT_PER_E / VOLT_PER_E,
        "right": right,
        "right_to_coded": right / coded,
        "ours": camera_mv(FAINTEST_V),
        "counts": 2**8 * 5.5 / SATURATION_MV,
        "right_counts": 2**8 * right / SATURATION_MV,
        "bright_v": bright / 1e3,
        "saturated": bright > SATURATION_MV,
        "saturated_ms": 0.5e3 * SATURATION_MV / bright,
        "right_saturated_ms": 0.5e3 * SATURATION_MV / bright_right,
        "microvolt_per_e": VOLT_PER_E * 1e6,
        "second": float(second_script_mv(FAINTEST_V)),
    }


def _lens_values() -> Values:
    lenses = []
    for what, width_mm, aperture_mm in (
        ("512 pixels of 10 µm, 10° across, 12 cm of lens", 5.12, 120.0),
        ("TC211 (2.64 mm), 10° across, 10 cm of lens (Fig. 3.15)", 2.64, 100.0),
    ):
        focal_mm = width_mm / 2.0 / math.tan(math.radians(FIELD_DEG / 2.0))
        broken = violations({"optics.focal_length_mm": round(focal_mm, 2), "optics.aperture_mm": aperture_mm})
        reason = f"cannot be built: {broken[0].message}" if broken else "can be built"
        lenses.append({"what": what, "f_number": focal_mm / aperture_mm, "broken": broken, "reason": reason})
    return {"lenses": lenses}


@functools.cache
def _colours() -> tuple[FloatArray, FloatArray]:
    """B−V and luminosity class of the stars of Table 3.4, from the Bright Star Catalogue."""
    stars = load_catalog("bsc5")
    rows = [int(np.flatnonzero(stars.id == hr)[0]) for _, hr, *_ in STARS]
    return spectral_coordinates(stars.b_v[rows], stars.spectral_type[rows])


def irradiance_figure() -> Figure:
    """Fig. 3.12: spectral irradiances of the stars of Table 3.4, and the thesis' five values for V = 0."""
    figure, ax = new_figure(size=(7.0, 4.4))
    wavelength_nm = np.arange(350.0, 1261.0, 2.0)
    for (name, _, v_mag, style, colour), b_v, giant in zip(STARS, *_colours(), strict=True):
        irradiance = irradiance_w_cm2_um(wavelength_nm, v_mag, float(b_v), float(giant))
        ax.semilogy(wavelength_nm / 1e3, irradiance, style, color=colour, label=f"{name}, V = {_signed(v_mag)}")
    ax.plot(BANDS_UM, IRRADIANCE_W_CM2_UM, "D", color=INK, markersize=5, label="thesis, A0V, V = 0")
    ax.set(xlabel="wavelength [µm]", ylabel="spectral irradiance [W cm⁻² µm⁻¹]", ylim=(5e-16, 1e-9))
    ax.legend(loc="upper right", ncols=2)
    return figure


def _signed(value: float) -> str:
    """A number with a minus sign as printed."""
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")


def voltage_figure(v_mag: float) -> Figure:
    """Figs. 3.13 and 3.14: output voltage against the diameter of the lens and the integration time, up to saturation.

    Parameters
    ----------
    v_mag : float
        Magnitude of the A0V star.
    """
    aperture_m, exposure_s = np.meshgrid(np.linspace(0.0, 0.12, 25), np.linspace(0.0, 0.5, 26))
    figure, axes = new_figure(1, 2, (10.0, 4.6), subplot_kw={"projection": "3d"})
    panels = (("as the script codes it (one λ too many)", True), ("with correct physics", False))
    top = 0.0
    for ax, (title, extra_lambda) in zip(axes, panels, strict=True):
        volts = thesis_mv(v_mag, aperture_m, exposure_s, extra_lambda=extra_lambda)
        shown = np.minimum(volts, SATURATION_MV)
        top = max(top, float(shown.max()))
        style: dict[str, Any] = {"cmap": "cividis", "rstride": 1, "cstride": 1, "linewidth": 0.2, "edgecolor": INK}
        ax.plot_surface(aperture_m * 100.0, exposure_s, shown, **style)
        reached = "saturated" if shown.max() == SATURATION_MV else f"{float(shown.max()):.3g} mV"
        ax.set_title(f"V = {_signed(v_mag)}, {title}\n{reached} at 12 cm, 0.5 s", y=0.93)
        ax.view_init(elev=24, azim=-128)
        ax.set(xlabel="lens diameter [cm]", ylabel="integration time [s]")
        ax.set_zlabel("output voltage [mV]", labelpad=4)
        ax.set_box_aspect(None, zoom=0.86)
    for ax in axes:
        ax.set_zlim(0.0, top)
    return figure


def magnitude_figure(aperture_m: float = 0.1, exposure_s: float = 0.5) -> Figure:
    """Fig. 3.15: output voltage against magnitude, as coded, with correct physics, and of two stars by this product.

    Parameters
    ----------
    aperture_m, exposure_s : float
        Lens and integration time.
    """
    v_mag = np.linspace(-1.5, 8.0, 96)
    gain = PROTOTYPE_VOLT_PER_E
    cool_b_v, cool_class = (float(column[2]) for column in _colours())
    coded, right = (
        thesis_mv(v_mag, aperture_m, exposure_s, extra_lambda=extra, volt_per_e=gain) for extra in (True, False)
    )
    curves = (
        ("thesis, as coded (one λ too many)", coded, "-", BLUE),
        ("thesis, correct physics", right, "--", ORANGE),
        ("this product, A0V", camera_mv(v_mag, aperture_m, exposure_s, volt_per_e=gain), "-.", GREEN),
        (
            "this product, K2III (α Arietis)",
            camera_mv(v_mag, aperture_m, exposure_s, b_v=cool_b_v, giant=cool_class, volt_per_e=gain),
            ":",
            VERMILION,
        ),
    )
    figure, ax = new_figure(size=(6.6, 4.4))
    for label, volts, style, colour in curves:
        ax.semilogy(v_mag, volts, style, color=colour, label=label)
    ax.axhline(SATURATION_MV, color=INK, linewidth=1.0, label="saturation, 450 mV")
    ax.set(
        xlabel="visual magnitude",
        ylabel="output voltage [mV]",
        title=f"lens {aperture_m * 100:g} cm, {exposure_s * 1e3:g} ms, 1.4 µV/e⁻, 25 pixels",
    )
    ax.legend(loc="lower left")
    return figure
