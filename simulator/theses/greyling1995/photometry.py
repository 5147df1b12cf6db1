"""Sections 3.4.1, 3.4.3 and 3.4.4, Figs. 3.12 to 3.15: starlight, output voltage, and a lens that cannot be built."""

from __future__ import annotations

import math
from functools import cache, partial

import numpy as np

from simulator.scenario.physics import violations
from simulator.sky.colours import spectral_coordinates
from simulator.theses.figures import section_of
from simulator.theses.greyling1995.noise import BRIGHTEST_V, FAINTEST_V
from simulator.theses.greyling1995.starlight import (
    BANDS_UM,
    IRRADIANCE_W_CM2_UM,
    PROTOTYPE_VOLT_PER_E,
    SATURATION_MV,
    VOLT_PER_E,
    camera_mv,
    eye_response,
    irradiance_w_cm2_um,
    second_script_mv,
    spectral_values,
    thesis_mv,
)
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from startracker.catalog import load_catalog
from startracker.core import FloatArray

ZERO_LUX = -13.94188
"""m₀ of (3.6): m_v = −2.5 log F + m₀, F in lux."""

FIELD_DEG = 10.0

STARS = (
    ("Sirius, A1V", 2491, -1.47),
    ("α Lyrae, A0V", 7001, 0.03),
    ("α Arietis, K2III", 617, 1.99),
    ("61 Cygni B, K7V", 8086, 6.02),
)
"""Table 3.4: name and type, HR number, printed V."""

LUMEN_PER_WATT = {False: 683.002, True: 1700.06}
"""Photopic and scotopic K_m (CIE 18.2-1983)."""


def section() -> Section:
    """Irradiances, output voltages, and the corresponding lens."""
    values = _light_values() | _voltage_values() | _lens_values() | _voltage_by_magnitude()
    values |= {"faint": partial(_voltages, FAINTEST_V), "brightest": partial(_voltages, BRIGHTEST_V)}
    title = "Chapter 3.4: starlight, output voltage and the lens"
    tables = "greyling1995/spectral", "greyling1995/photometry"
    return section_of("greyling1995/photometry", title, spectral_values() | values, tables)


def illuminance_lux(*, night: bool = False) -> float:
    """Illuminance of an A0V star of V = 0: K_m ∫ E_λ V_λ dλ, from the product's spectrum, photopic or scotopic."""
    wavelength_nm = np.arange(360.0, 831.0)
    watt_m2_nm = irradiance_w_cm2_um(wavelength_nm, 0.0, 0.0, 0.0) * 1e4 * 1e-3
    efficiency = eye_response(wavelength_nm, night=night)
    return float(LUMEN_PER_WATT[night] * np.trapezoid(efficiency * watt_m2_nm, wavelength_nm))


def _light_values() -> Values:
    """Illuminance of V = 0, the thesis' five irradiances, and spectra of the stars of Table 3.4."""
    bands = []
    for um, printed in zip(BANDS_UM, IRRADIANCE_W_CM2_UM * 1e12, strict=True):
        nearby = np.linspace(um * 1e3 - 25.0, um * 1e3 + 25.0, 201)
        found = irradiance_w_cm2_um(nearby, 0.0, 0.0, 0.0).mean() * 1e12
        bands.append({"um": um, "irradiance": printed, "found": found})
    wavelength_nm = np.arange(350.0, 1261.0, 2.0)
    stars = [
        {"name": name, "v": _signed(v), "curve": irradiance_w_cm2_um(wavelength_nm, v, float(b_v), float(giant))}
        for (name, _, v), b_v, giant in zip(STARS, *_colours(), strict=True)
    ]
    lux = {"printed_lux": 10.0 ** (ZERO_LUX / 2.5), "day": illuminance_lux(), "night": illuminance_lux(night=True)}
    return lux | {"bands": bands, "star_um": wavelength_nm / 1e3, "stars": stars, "printed": IRRADIANCE_W_CM2_UM}


def _voltage_values() -> Values:
    coded, bright = (float(thesis_mv(v_mag, extra_lambda=True)) for v_mag in (FAINTEST_V, BRIGHTEST_V))
    right, bright_right = (float(thesis_mv(v_mag, extra_lambda=False)) for v_mag in (FAINTEST_V, BRIGHTEST_V))
    return {
        "coded_mv": coded,
        "coded_prototype": coded * PROTOTYPE_VOLT_PER_E / VOLT_PER_E,
        "right_mv": right,
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


@cache
def _colours() -> tuple[FloatArray, FloatArray]:
    """B−V and luminosity class of the stars of Table 3.4, from the Bright Star Catalogue."""
    stars = load_catalog("bsc5")
    rows = [int(np.flatnonzero(stars.id == hr)[0]) for _, hr, _ in STARS]
    return spectral_coordinates(stars.b_v[rows], stars.spectral_type[rows])


def _signed(value: float) -> str:
    """A number with a minus sign as printed."""
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")


def _voltages(v_mag: float) -> Values:
    """Output voltage by lens diameter and integration time, up to saturation."""
    aperture_m, exposure_s = np.meshgrid(np.linspace(0.0, 0.12, 25), np.linspace(0.0, 0.5, 26))
    panels: list[Values] = []
    for title, extra in (("as in the script (one factor λ too many)", True), ("with correct physics", False)):
        shown = np.minimum(thesis_mv(v_mag, aperture_m, exposure_s, extra_lambda=extra), SATURATION_MV)
        most = float(shown.max())
        reached = "saturated" if most == SATURATION_MV else f"{most:.3g} mV"
        panels.append({"title": title, "volts": shown, "reached": reached})
    top = max(float(np.max(panel["volts"])) for panel in panels)
    return {"cm": aperture_m * 100.0, "s": exposure_s, "v": _signed(v_mag), "panels": panels, "top": top}


def _voltage_by_magnitude() -> Values:
    """Output voltage by magnitude: as in the script, with correct physics, and for two stars by the product."""
    v_mag, gain = np.linspace(-1.5, 8.0, 96), PROTOTYPE_VOLT_PER_E
    aperture_m, exposure_s = 0.1, 0.5
    star = (v_mag, aperture_m, exposure_s)
    cool_b_v, cool_class = (float(column[2]) for column in _colours())
    return {
        "v": v_mag,
        "coded": thesis_mv(*star, extra_lambda=True, volt_per_e=gain),
        "right": thesis_mv(*star, extra_lambda=False, volt_per_e=gain),
        "a0v": camera_mv(*star, volt_per_e=gain),
        "k2iii": camera_mv(*star, b_v=cool_b_v, giant=cool_class, volt_per_e=gain),
        "saturation_mv": SATURATION_MV,
        "aperture_cm": aperture_m * 100,
        "exposure_ms": exposure_s * 1e3,
    }
