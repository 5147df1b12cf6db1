"""Options of ``boresight solve`` and ``boresight calibrate``: photographs, frames and their camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from simulator.cli.options import Catalog, option, switch

PARITIES = {"seen": 1, "mirrored": -1, "both": None}


_CAMERA, _PICTURE, _LIST, _ANSWER = "Camera and sky", "Annotated picture", "Lists of centroids", "Answer"


@dataclass(frozen=True)
class SolveRequest:
    """Solve images of the sky, or lists of centroids: where did the camera look?"""

    images: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[IMAGE]...",
            help="PNG, TIFF, JPEG or FITS files, or folders; - is standard input, sample a photograph to try.",
            show_default=False,
        ),
    ] = None
    fov_deg: Annotated[
        float | None,
        option("--fov", "DEG", "Field of view across the width, to a few per cent; default: found out.", _CAMERA),
    ] = None
    camera: Annotated[Path | None, option("--camera", "CAMERA.yaml", "Calibrated camera.", _CAMERA)] = None
    method: Annotated[
        str | None, option("--method", "NAME", "Identifier, for a known camera; default: adaptive.", _CAMERA)
    ] = None
    catalog: Catalog = "hipparcos"
    magnitude_limit: Annotated[float, option("--magnitude-limit", "V", "Faintest guide star.", _CAMERA)] = 6.5
    parity: Annotated[
        str | None,
        option("--parity", "SIDE", "seen, mirrored or both; default: the camera's, or both without one.", _CAMERA),
    ] = None
    lost_in_space: Annotated[
        bool, switch("--lost-in-space", "Ignore the prior attitude in a frame's header.", _CAMERA)
    ] = False
    time: Annotated[
        str | None, option("--time", "TIME", "When the image was taken (UTC): aberration, and planets.", _CAMERA)
    ] = None
    bayer: Annotated[
        str | None, option("--bayer", "PATTERN", "The file is a raw mosaic: RGGB, BGGR, GRBG or GBRG.", _CAMERA)
    ] = None
    bad_pixels: Annotated[
        Path | None,
        option("--bad-pixels", "MAP", "Image of the same size, not zero where a pixel is not to be used.", _CAMERA),
    ] = None
    annotate: Annotated[
        Path | None,
        option(
            "--annotate",
            "OUT.png",
            "Write the picture with names (png, jpg, svg, pdf); several: a folder.",
            _PICTURE,
        ),
    ] = None
    grid: Annotated[bool, switch("--grid", "Lines of right ascension and declination.", _PICTURE)] = False
    constellations: Annotated[bool, switch("--constellations", "Constellation lines.", _PICTURE)] = False
    deep_sky: Annotated[
        bool, switch("--deep-sky/--no-deep-sky", "Messier objects and bright NGC and IC objects.", _PICTURE)
    ] = True
    colour: Annotated[bool, switch("--colour", "Colours of the stars identified in a grey image.", _PICTURE)] = False
    as_json: Annotated[bool, switch("--json", "Print one JSON object per image.", _ANSWER)] = False
    explain: Annotated[
        bool, switch("--explain", "Print stage by stage what was found, tried and rejected.", _ANSWER)
    ] = False
    pixels: Annotated[
        list[str] | None, option("--pixel", "X,Y", "Print where this pixel looks; may be repeated.", _ANSWER)
    ] = None
    wcs: Annotated[
        Path | None,
        option("--wcs", "OUT.fits", "Write the image with its world coordinates; a folder for several.", _ANSWER),
    ] = None
    centroids: Annotated[
        Path | None,
        option("--centroids", "FILE.csv", "Solve a list (columns x, y and optionally flux), not an image.", _LIST),
    ] = None
    size: Annotated[str | None, option("--size", "WxH", "Image size in pixels, for --centroids with --fov.", _LIST)] = (
        None
    )

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
    out: Annotated[Path, option("--out", "CAMERA.yaml", "Camera file to write.")] = Path("camera.yaml")
    plot: Annotated[Path | None, option("--plot", "OUT.png", "Write a figure of residuals.")] = None
    camera: Annotated[Path | None, option("--camera", "ROUGH.yaml", "What is known of the camera, to 5 %.")] = None
    fov_deg: Annotated[
        float | None, option("--fov", "DEG", "Field of view across the width, to 5 %; default: found out.")
    ] = None
    projection: Annotated[str, option("--projection", "NAME", "pinhole, fisheye, or auto: what fits better.")] = "auto"
    refraction: Annotated[
        bool, switch("--refraction", "Taken from the ground: fit the air's differential refraction along.")
    ] = False
    epoch_jyear: Annotated[
        float | None, option("--epoch", "YEAR", "When taken, such as 2026.2; default: the catalogue's epoch.")
    ] = None
    catalog: Catalog = "hipparcos"
    centroider: Annotated[str, option("--centroider", "NAME", "How stars are measured.")] = "least_squares"
    parameters: Annotated[
        str | None,
        option("--parameters", "A,B,...", "Fit these (f, aspect, cx, cy, k1 ...), not what the images determine."),
    ] = None
