"""Plain parameters of the sky: what is in it, and which effects move and light it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Sky:
    """What is in the sky and how it is seen.

    Parameters
    ----------
    catalog, magnitude_limit : str, float
        Catalogue and faintest V of the stars that are drawn; fainter ones belong to the background.
    proper_motion, parallax, light_deflection, aberration : bool
        What moves the stars from their catalogue positions.
    planets, phases : bool
        Sun, Moon and planets, and the lit part of their disks; without phases disks are full.
    background, background_s10, background_model : bool, float, str
        Diffuse background: ``constant`` with its brightness, or ``leinert1998``.
    earth, earth_albedo : bool, float
        Whether the Earth hides and shines, and its Lambert albedo.
    """

    catalog: str = "hipparcos"
    magnitude_limit: float = 9.0
    proper_motion: bool = True
    parallax: bool = True
    light_deflection: bool = True
    aberration: bool = True
    planets: bool = True
    background: bool = True
    background_s10: float = 75.0
    background_model: str = "constant"
    earth: bool = True
    earth_albedo: float = 0.3
    phases: bool = True
