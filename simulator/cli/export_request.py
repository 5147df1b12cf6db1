"""Options of ``boresight export-c``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from simulator.cli.options import option


@dataclass(frozen=True)
class ExportRequest:
    """Write the integer tracker as C99 source with its tables, and print its memory and time."""

    out: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the source.", show_default=False)]
    size: Annotated[str, option("--size", "WxH", "Image, pixels.")] = "427x319"
    fov: Annotated[str, option("--fov", "WxH", "Field, degrees.")] = "9.0130x6.9049"
    declination: Annotated[str, option("--declination", "A:B", "Stars between these declinations, degrees.")] = "30:90"
    magnitude_limit: Annotated[float, option("--magnitude-limit", "V", "Faintest star.")] = 6.0
    max_separation_deg: Annotated[float, option("--max-separation", "DEG", "Longest pair of stars.")] = 12.0
    tolerance_deg: Annotated[float, option("--tolerance", "DEG", "Of separations.")] = 0.15
    rotation_tolerance_deg: Annotated[
        float, option("--rotation-tolerance", "DEG", "Of rotations, and of the groups of them.")
    ] = 5.0
    enclosed_tolerance_deg: Annotated[
        float, option("--enclosed-tolerance", "DEG", "Of inner angles; 0: not looked at.")
    ] = 1.0
    vote_number: Annotated[int, option("--vote-number", "N", "Fewest votes for a star.")] = 2
    centroid_error_px: Annotated[
        float, option("--centroid-error", "PX", "Standard error of a centroid on one axis.")
    ] = 0.3
    false_alarm_rate: Annotated[float, option("--false-alarm-rate", "P", "Chance that no sky is taken for one.")] = 1e-7
    resolution_px: Annotated[float, option("--resolution", "PX", "Stars closer than this are one in the image.")] = 3.0
    prefix: Annotated[str, option("--prefix", "NAME", "That all names in the C begin with.")] = "tracker"
    edition: Annotated[int, option("--edition", "N", "Of the Bright Star Catalogue, 4 or 5.")] = 5
