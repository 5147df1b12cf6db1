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
    size: Annotated[str, option("--size", "WxH", "Image size, pixels.")] = "427x319"
    fov: Annotated[str, option("--fov", "WxH", "Field of view, degrees.")] = "9.0130x6.9049"
    declination: Annotated[str, option("--declination", "A:B", "Range of declinations, degrees.")] = "30:90"
    magnitude_limit: Annotated[float, option("--magnitude-limit", "V", "Magnitude of the faintest star.")] = 6.0
    max_separation_deg: Annotated[
        float, option("--max-separation", "DEG", "Maximum separation of a pair of stars.")
    ] = 12.0
    tolerance_deg: Annotated[float, option("--tolerance", "DEG", "Tolerance of separations.")] = 0.15
    rotation_tolerance_deg: Annotated[
        float, option("--rotation-tolerance", "DEG", "Tolerance of rotations and of their groups.")
    ] = 5.0
    enclosed_tolerance_deg: Annotated[
        float, option("--enclosed-tolerance", "DEG", "Tolerance of inner angles; 0: no test.")
    ] = 1.0
    vote_number: Annotated[int, option("--vote-number", "N", "Minimum number of votes for a star.")] = 2
    centroid_error_px: Annotated[
        float, option("--centroid-error", "PX", "Standard error of a centroid on one axis.")
    ] = 0.3
    false_alarm_rate: Annotated[float, option("--false-alarm-rate", "P", "Maximum false-alarm probability.")] = 1e-7
    resolution_px: Annotated[float, option("--resolution", "PX", "Stars closer than this are merged.")] = 3.0
    prefix: Annotated[str, option("--prefix", "NAME", "Prefix of all names in the C source.")] = "tracker"
    edition: Annotated[int, option("--edition", "N", "Edition of the Bright Star Catalogue, 4 or 5.")] = 5
