"""Parameters of the radiation environment; the scenario's section ``environment`` is this class."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from startracker.display import changed_fields


@dataclass(frozen=True)
class Environment:
    """Radiation along the orbit, and ageing by it; off by default."""

    trapped: Literal["none", "ap8"] = "none"
    """Trapped protons and electrons: ``ap8``, the models AP-8 and AE-8 of NASA (needs the package aep8)."""
    galactic: bool = False
    """Galactic cosmic rays: protons and helium, with the geomagnetic cut-off of each position."""
    solar: Literal["min", "max"] = "min"
    """Solar activity. Minimum: more trapped protons and cosmic rays; maximum: more trapped electrons."""
    transients: bool = True
    """The particles at the position of each frame cross the detector, in place of `detector.cosmic_rays.rate_cm2_s`;
    false: the environment only ages the camera."""
    shield_mm: float = 3.0
    """Thickness of aluminium around the detector on all sides."""
    age_years: float = 0.0
    """Time in orbit, whose dose has aged detector and glass; 0: as new."""
    solar_proton_events: float = 0.0
    """Number of anomalously large solar proton events within the age (King 1974); about one in a solar cycle."""
    depletion_um: float = 2.0
    """Mean depth over the pixel of the depleted silicon, in which displacement damage generates dark current: one or
    two micrometres for a pinned photodiode, three to five for a CCD."""
    dark_per_krad_e_s: float = 0.0
    """Additional dark current of every pixel per krad of ionising dose, at `detector.dark_reference_c`; it depends on
    the detector's technology: use a measured value. 0: none."""
    glass: Literal["none", "cerium", "standard"] = "none"
    """Glass that darkens with the ionising dose: ``cerium``, radiation-resistant; ``standard``; ``none``: no
    darkening."""
    glass_path_mm: float = 20.0
    """Path of the light in glass."""
    glass_shield_mm: float = 1.0
    """Thickness of aluminium that gives the glass the same mean protection."""
    estimate: Literal["low", "nominal", "high"] = "nominal"
    """Coefficients: nominal values, or all at the end of their range with the least or the most radiation and damage
    (bounds, not confidence limits)."""

    __repr__ = changed_fields

    @property
    def sources(self) -> Environment:
        """Only what the radiation outside the spacecraft depends on; the rest has its defaults."""
        return Environment(trapped=self.trapped, solar=self.solar)

    @property
    def has_particles(self) -> bool:
        """Whether particles cross the detector according to the position."""
        return self.transients and (self.trapped != "none" or self.galactic)

    @property
    def has_damage(self) -> bool:
        """Whether the camera has aged by radiation."""
        return self.age_years > 0 and (self.trapped != "none" or self.solar_proton_events > 0)
