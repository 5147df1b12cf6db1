"""Parameters of the sky: what is in it, and which effects move and light it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Sky:
    """What is in the sky and how it is seen."""

    catalog: str = "hipparcos"
    """``hipparcos`` or ``bsc5``."""
    magnitude_limit: float = 9.0
    """Faintest V that is drawn."""
    spectrum: str = "colour_sequence"
    """Spectra of the stars: ``colour_sequence`` (library spectra with the colours of real stars) or ``blackbody``."""
    proper_motion: bool = True
    """Move the stars to the date."""
    parallax: bool = True
    """Annual parallax."""
    light_deflection: bool = True
    """Bending of light by the Sun."""
    aberration: bool = True
    """Annual and orbital aberration."""
    planets: bool = True
    """Planets, Moon and Sun from DE421."""
    background: bool = True
    """Diffuse background."""
    background_s10: float = 75.0
    """Its brightness in tenth-magnitude stars a square degree: zodiacal light 60 and scattered starlight 15."""
    background_model: str = "constant"
    """``constant``: `background_s10` everywhere; ``leinert1998``: zodiacal light and undrawn starlight by direction."""
    earth: bool = True
    """The Earth: it hides what is behind it, and its lit side and limb shine where they are in the field."""
    earth_albedo: float = 0.3
    """Albedo of the Earth's surface and clouds, which scatter alike in all directions (Lambert)."""
    phases: bool = True
    """Draw the lit part of the Moon's and the planets' disks; false: uniform full disks."""
