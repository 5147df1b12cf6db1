"""Coefficients of the radiation environment and of damage: value, range and source of each.

Radiation or damage increases with every coefficient, so that all low ends, and all high ends, are bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Estimate = Literal["low", "nominal", "high"]


@dataclass(frozen=True)
class Coefficient:
    """One coefficient with its range."""

    name: str
    unit: str
    value: float
    """Nominal value."""
    low: float
    """End of the range with the least radiation or damage."""
    high: float
    """End of the range with the most radiation or damage."""
    source: str
    """Reference of the value and of the range, or a statement that they are assumed."""

    def at(self, estimate: Estimate) -> float:
        """Value for an estimate: ``low``, ``nominal`` or ``high``."""
        return {"low": self.low, "nominal": self.value, "high": self.high}[estimate]


_TABLE = (
    Coefficient(
        "trapped_protons",
        "of AP-8",
        1.0,
        0.5,
        2.0,
        "Sawyer & Vette 1976, NSSDC/WDC-A-R&S 76-06: AP-8; its accuracy is a factor of 2",
    ),
    Coefficient(
        "trapped_electrons",
        "of AE-8",
        1.0,
        0.5,
        2.0,
        "Vette 1991, NSSDC/WDC-A-R&S 91-24: AE-8; its accuracy is a factor of 2, less in the outer belt on single days",
    ),
    Coefficient(
        "galactic_flux",
        "of the force-field spectrum",
        1.0,
        0.8,
        1.25,
        "Usoskin et al. 2005, JGR 110, A12108: spectrum; range: assumed, of the dipole cut-off and the solar cycle",
    ),
    Coefficient(
        "galactic_secondaries",
        "particles per primary",
        1.0,
        1.0,
        14.0,
        "none; high: Miles et al. 2021 (arXiv:2006.00909): about 1.3 particles/cm²/s outside the anomaly on the CCDs "
        "of Hubble, 14 times the primaries computed here for its orbit, as its mass makes secondaries",
    ),
    Coefficient(
        "niel_scale",
        "of SR-NIEL",
        0.85,
        0.80,
        1.0,
        "Huhtinen & Aarnio 1993, NIM A 335, 580, relative to SR-NIEL (Boschini et al.) at 30 to 115 MeV; on this scale "
        "the damage factor was measured; high end: SR-NIEL itself",
    ),
    Coefficient(
        "dark_damage_factor",
        "carriers/cm3/s per MeV/g, 300 K, one week",
        1.9e5,
        1.3e5,
        2.5e5,
        "Srour & Lo 2000, IEEE Trans. Nucl. Sci. 47, 2451: universal damage factor (1.9 ± 0.6) × 10⁵",
    ),
    Coefficient(
        "annealing",
        "of the dark current after one week",
        0.72,
        0.45,
        1.0,
        "Srour & Lo 2000, annealing at 300 K, at its last measured time of two months; low: its slope extended to a "
        "year; high: no annealing (cold detectors)",
    ),
    Coefficient(
        "dark_activation",
        "eV",
        0.63,
        0.63,
        0.63,
        "Hopkinson 1992, IEEE Trans. Nucl. Sci. 39, 2018: 0.633 eV; Srour & Lo 2000: 0.63 eV",
    ),
    Coefficient(
        "dose_per_interaction",
        "µm3 TeV/g",
        42_200.0,
        32_000.0,
        50_000.0,
        "Belloir et al. 2016, Opt. Express 24, 4299: dark current of an interaction is exponentially distributed, "
        "4100 e⁻/s where 0.0972 e⁻/s/µm³ per TeV/g is the mean; range: assumed",
    ),
    Coefficient(
        "telegraph_centres",
        "1/cm3 per MeV/g",
        30.0,
        20.0,
        35.0,
        "Virmontois et al. 2011, IEEE Trans. Nucl. Sci. 58, 3085: 30 to 35; low end: assumed",
    ),
    Coefficient(
        "telegraph_amplitude",
        "e/s at 22 °C",
        1200.0,
        1000.0,
        1400.0,
        "Virmontois et al. 2011: exponential with mean 1200 e⁻/s for displacement damage; range: assumed",
    ),
    Coefficient(
        "telegraph_low_time",
        "s",
        194.0,
        194.0,
        194.0,
        "Zhao et al. 2025, Aerospace Shanghai 42(4), 89, table 1: two levels, 194 and 97 s on average; that the longer "
        "one is the lower level is assumed",
    ),
    Coefficient(
        "telegraph_high_time",
        "s",
        97.0,
        97.0,
        97.0,
        "Zhao et al. 2025, as telegraph_low_time",
    ),
    Coefficient(
        "transfer_damage",
        "CTI per TeV/g, packet of 1600 electrons",
        5.4e-6,
        0.7e-6,
        2.9e-5,
        "O'Connor & Khandrika 2025, WFC3 ISR 2025-02: 1 × 10⁻⁴ a year at 160 e⁻ with a slope of −0.72 in signal, "
        "divided by 3.5 TeV/g a year in that orbit (by this package, behind an assumed 10 mm of aluminium); low: 10⁴ "
        "e⁻ and twice the dose; high: 160 e⁻",
    ),
    Coefficient(
        "serial_transfer_share",
        "of the parallel damage",
        0.1,
        0.05,
        0.2,
        "ACS WFC: serial CTI is below a tenth of the parallel one (STScI, WFC serial EPER); range: assumed",
    ),
    Coefficient(
        "glass_cerium",
        "1/cm per krad",
        0.0007,
        0.0004,
        0.0015,
        "catalogue of K5xx glasses (GB/T 903): optical density 0.015 to 0.065 per cm after 10⁵ R, linear in dose",
    ),
    Coefficient(
        "glass_standard",
        "1/cm per krad",
        0.012,
        0.004,
        0.036,
        "assumed: unstabilised crown glass, some fifteen times cerium glass; measure the glass that is flown",
    ),
)

COEFFICIENTS: dict[str, Coefficient] = {coefficient.name: coefficient for coefficient in _TABLE}
"""All coefficients by name."""


def coefficient(name: str, estimate: Estimate = "nominal") -> float:
    """Value of a coefficient for an estimate."""
    return COEFFICIENTS[name].at(estimate)
