"""Options of ``boresight export-c``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer


@dataclass(frozen=True)
class ExportRequest:
    """Write the integer tracker as C99 source with its tables, and print its memory and time."""

    out: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the source.", show_default=False)]
    size: Annotated[str, typer.Option("--size", metavar="WxH", help="Image, pixels.")] = "427x319"
    fov: Annotated[str, typer.Option("--fov", metavar="WxH", help="Field, degrees.")] = "9.0130x6.9049"
    declination: Annotated[
        str, typer.Option("--declination", metavar="A:B", help="Stars between these declinations, degrees.")
    ] = "30:90"
    magnitude_limit: Annotated[float, typer.Option("--magnitude-limit", metavar="V", help="Faintest star.")] = 6.0
    max_separation_deg: Annotated[
        float, typer.Option("--max-separation", metavar="DEG", help="Longest pair of stars.")
    ] = 12.0
    tolerance_deg: Annotated[float, typer.Option("--tolerance", metavar="DEG", help="Of separations.")] = 0.15
    rotation_tolerance_deg: Annotated[
        float, typer.Option("--rotation-tolerance", metavar="DEG", help="Of rotations, and of the groups of them.")
    ] = 5.0
    enclosed_tolerance_deg: Annotated[
        float, typer.Option("--enclosed-tolerance", metavar="DEG", help="Of inner angles; 0: not looked at.")
    ] = 1.0
    vote_number: Annotated[int, typer.Option("--vote-number", metavar="N", help="Fewest votes for a star.")] = 2
    centroid_error_px: Annotated[
        float, typer.Option("--centroid-error", metavar="PX", help="Standard error of a centroid on one axis.")
    ] = 0.3
    false_alarm_rate: Annotated[
        float, typer.Option("--false-alarm-rate", metavar="P", help="Chance that no sky is taken for one.")
    ] = 1e-7
    resolution_px: Annotated[
        float, typer.Option("--resolution", metavar="PX", help="Stars closer than this are one in the image.")
    ] = 3.0
    prefix: Annotated[str, typer.Option("--prefix", metavar="NAME", help="That all names in the C begin with.")] = (
        "tracker"
    )
    edition: Annotated[int, typer.Option("--edition", metavar="N", help="Of the Bright Star Catalogue, 4 or 5.")] = 5
