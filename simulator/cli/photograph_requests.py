"""Options of ``boresight solve`` and ``boresight calibrate``: photographs, frames and their camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from simulator.cli.options import Catalog

PARITIES = {"seen": 1, "mirrored": -1, "both": None}


@dataclass(frozen=True)
class SolveRequest:
    """Solve images of the sky, or lists of centroids: where did the camera look?"""

    images: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[IMAGE]...", help="PNG, TIFF, JPEG or FITS files, or folders of them.", show_default=False
        ),
    ] = None
    fov_deg: Annotated[
        float | None,
        typer.Option(
            "--fov", metavar="DEG", help="Field of view across the width, to a few per cent; default: found out."
        ),
    ] = None
    camera: Annotated[Path | None, typer.Option("--camera", metavar="CAMERA.yaml", help="Calibrated camera.")] = None
    method: Annotated[
        str | None,
        typer.Option("--method", metavar="NAME", help="Identifier, for a known camera; default: adaptive."),
    ] = None
    catalog: Catalog = "hipparcos"
    magnitude_limit: Annotated[float, typer.Option("--magnitude-limit", metavar="V", help="Faintest guide star.")] = 6.5
    centroids: Annotated[
        Path | None,
        typer.Option(
            "--centroids",
            metavar="FILE.csv",
            help="Solve a list of centroids (columns x, y and optionally flux) instead of an image.",
        ),
    ] = None
    size: Annotated[
        str | None, typer.Option("--size", metavar="WxH", help="Image size in pixels, for --centroids with --fov.")
    ] = None
    lost_in_space: Annotated[
        bool, typer.Option("--lost-in-space", help="Ignore the prior attitude in a frame's header.")
    ] = False
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object an image.")] = False
    wcs: Annotated[
        Path | None, typer.Option("--wcs", metavar="OUT.fits", help="Write the image with its world coordinates.")
    ] = None
    annotate: Annotated[
        Path | None, typer.Option("--annotate", metavar="OUT.png", help="Write the picture with its identified stars.")
    ] = None
    grid: Annotated[bool, typer.Option("--grid", help="Lines of right ascension and declination on it.")] = False
    constellations: Annotated[bool, typer.Option("--constellations", help="Lines of the constellations on it.")] = False
    pixels: Annotated[
        list[str] | None,
        typer.Option("--pixel", metavar="X,Y", help="Tell where this pixel looks; may be repeated."),
    ] = None
    parity: Annotated[
        str | None,
        typer.Option(
            "--parity", metavar="SIDE", help="seen, mirrored or both; default: the camera's, or both without one."
        ),
    ] = None
    bayer: Annotated[
        str | None,
        typer.Option("--bayer", metavar="PATTERN", help="The file is a raw mosaic: RGGB, BGGR, GRBG or GBRG."),
    ] = None
    bad_pixels: Annotated[
        Path | None,
        typer.Option(
            "--bad-pixels", metavar="MAP", help="Image of the same size, not zero where a pixel is not to be used."
        ),
    ] = None
    explain: Annotated[
        bool, typer.Option("--explain", help="Tell stage by stage what was found, tried and rejected.")
    ] = False

    @property
    def sides(self) -> int | None:
        """Parity asked for: 1 as seen, -1 mirrored, None both."""
        return None if self.parity is None else PARITIES[self.parity]


@dataclass(frozen=True)
class CalibrateRequest:
    """Calibrate a camera from photographs of the sky: focal length, principal point, distortion, with uncertainties."""

    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...",
            help="Photographs or frames by one camera at one focus and zoom, or folders of them.",
            show_default=False,
        ),
    ]
    out: Annotated[Path, typer.Option("--out", metavar="CAMERA.yaml", help="Camera file to write.")] = Path(
        "camera.yaml"
    )
    plot: Annotated[Path | None, typer.Option("--plot", metavar="OUT.png", help="Write a figure of residuals.")] = None
    camera: Annotated[
        Path | None, typer.Option("--camera", metavar="ROUGH.yaml", help="What is known of the camera, to 5 %.")
    ] = None
    fov_deg: Annotated[
        float | None,
        typer.Option("--fov", metavar="DEG", help="Field of view across the width, to 5 %; default: found out."),
    ] = None
    projection: Annotated[
        str, typer.Option("--projection", metavar="NAME", help="pinhole, fisheye, or auto: what fits better.")
    ] = "auto"
    refraction: Annotated[
        bool, typer.Option("--refraction", help="Taken from the ground: fit the air's differential refraction along.")
    ] = False
    epoch_jyear: Annotated[
        float | None,
        typer.Option("--epoch", metavar="YEAR", help="When taken, such as 2026.2; default: the catalogue's epoch."),
    ] = None
    catalog: Catalog = "hipparcos"
    centroider: Annotated[str, typer.Option("--centroider", metavar="NAME", help="How stars are measured.")] = (
        "least_squares"
    )
    parameters: Annotated[
        str | None,
        typer.Option("--parameters", metavar="A,B,...", help="Fit these (f, aspect, cx, cy, k1 ...), not what tells."),
    ] = None
