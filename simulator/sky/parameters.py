"""Parameters of the sky: its contents and effects."""

from __future__ import annotations

from dataclasses import dataclass

from startracker.display import changed_fields


@dataclass(frozen=True)
class Sky:
    """Contents of the sky, and effects on apparent positions and brightness."""

    catalog: str = "hipparcos"
    """``hipparcos`` or ``bsc5``."""
    magnitude_limit: float = 9.0
    """Faintest V of the catalogue that is rendered."""
    faint_magnitude_limit: float | None = None
    """Faintest V of statistical stars beyond the catalogue, rendered as a grainy background in addition to
    `background_s10`; null: none. The noise of stars fainter than 12 to 13 is negligible."""
    spectrum: str = "colour_sequence"
    """Spectra of the stars: ``colour_sequence`` (library spectra with the colours of real stars) or ``blackbody``."""
    proper_motion: bool = True
    """Apply space motion."""
    parallax: bool = True
    """Annual parallax."""
    light_deflection: bool = True
    """Light deflection by the Sun."""
    aberration: bool = True
    """Annual and orbital aberration."""
    planets: bool = True
    """Planets, Moon and Sun from DE421."""
    background: bool = True
    """Diffuse background."""
    background_s10: float = 75.0
    """Its brightness in tenth-magnitude stars per square degree: zodiacal light 60 and scattered starlight 15."""
    background_model: str = "constant"
    """``constant``: `background_s10` everywhere; ``leinert1998``: zodiacal light and unresolved starlight by
    direction."""
    earth: bool = True
    """The Earth: occultation, and the brightness of its lit side and limb in the field."""
    earth_albedo: float = 0.3
    """Lambert albedo of the Earth's surface and clouds."""
    phases: bool = True
    """Render the phases of the Moon and planets; false: uniform full disks."""

    __repr__ = changed_fields
