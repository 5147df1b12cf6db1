"""Options of ``boresight solve`` and ``boresight calibrate``: photographs, frames and their camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from simulator.cli.options import Catalog, option, switch

PARITIES = {"seen": 1, "mirrored": -1, "both": None}


_CAMERA, _PICTURE, _LIST, _ANSWER = "Camera and sky", "Annotated picture", "Lists of centroids", "Output"


@dataclass(frozen=True)
class SolveRequest:
    """Solve images of the sky, or lists of centroids: direction and roll of the camera."""

    images: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[IMAGE]...",
            help="PNG, TIFF, JPEG or FITS files, or folders; - reads standard input, sample is an included photograph.",
            show_default=False,
        ),
    ] = None
    fov_deg: Annotated[
        float | None,
        option("--fov", "DEG", "Field of view across the width, to a few per cent; default: determined.", _CAMERA),
    ] = None
    camera: Annotated[Path | None, option("--camera", "CAMERA.yaml", "Calibrated camera.", _CAMERA)] = None
    method: Annotated[
        str | None, option("--method", "NAME", "Identifier for a known camera; default: adaptive.", _CAMERA)
    ] = None
    catalog: Catalog = "hipparcos"
    magnitude_limit: Annotated[
        float, option("--magnitude-limit", "V", "Magnitude of the faintest guide star.", _CAMERA)
    ] = 6.5
    parity: Annotated[
        str | None,
        option("--parity", "SIDE", "seen, mirrored or both; default: the camera's, or both without one.", _CAMERA),
    ] = None
    lost_in_space: Annotated[
        bool, switch("--lost-in-space", "Ignore the prior attitude in a frame's header.", _CAMERA)
    ] = False
    time: Annotated[
        str | None, option("--time", "TIME", "Time of the image (UTC), for aberration and planets.", _CAMERA)
    ] = None
    bayer: Annotated[
        str | None, option("--bayer", "PATTERN", "The file is a raw mosaic: RGGB, BGGR, GRBG or GBRG.", _CAMERA)
    ] = None
    bad_pixels: Annotated[
        Path | None,
        option("--bad-pixels", "MAP", "Image of the same size; pixels that are not zero are ignored.", _CAMERA),
    ] = None
    annotate: Annotated[
        Path | None,
        option(
            "--annotate",
            "OUT.png",
            "Write an annotated picture (png, jpg, svg, pdf); for several images, a folder.",
            _PICTURE,
        ),
    ] = None
    grid: Annotated[bool, switch("--grid", "Draw lines of right ascension and declination.", _PICTURE)] = False
    constellations: Annotated[bool, switch("--constellations", "Draw constellation lines.", _PICTURE)] = False
    deep_sky: Annotated[
        bool, switch("--deep-sky/--no-deep-sky", "Mark Messier objects and bright NGC and IC objects.", _PICTURE)
    ] = True
    colour: Annotated[bool, switch("--colour", "Show identified stars of a grey image in their colours.", _PICTURE)] = (
        False
    )
    as_json: Annotated[bool, switch("--json", "Print one JSON object per image.", _ANSWER)] = False
    explain: Annotated[bool, switch("--explain", "Print what each stage found, tried and rejected.", _ANSWER)] = False
    pixels: Annotated[
        list[str] | None,
        option("--pixel", "X,Y", "Print right ascension and declination of a pixel; may be repeated.", _ANSWER),
    ] = None
    wcs: Annotated[
        Path | None,
        option("--wcs", "OUT.fits", "Write the image with world coordinates; for several images, a folder.", _ANSWER),
    ] = None
    centroids: Annotated[
        Path | None,
        option(
            "--centroids", "FILE.csv", "Solve a list (columns x, y and optionally flux) instead of an image.", _LIST
        ),
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
            help="Photographs or frames of one camera with fixed focus and zoom, or folders of them.",
            show_default=False,
        ),
    ]
    out: Annotated[Path, option("--out", "CAMERA.yaml", "Camera file to write.")] = Path("camera.yaml")
    plot: Annotated[Path | None, option("--plot", "OUT.png", "Write a plot of the residuals.")] = None
    camera: Annotated[Path | None, option("--camera", "ROUGH.yaml", "Approximate camera, accurate to 5 %.")] = None
    fov_deg: Annotated[
        float | None, option("--fov", "DEG", "Field of view across the width, to 5 %; default: determined.")
    ] = None
    projection: Annotated[str, option("--projection", "NAME", "pinhole, fisheye, or auto (the better fit).")] = "auto"
    refraction: Annotated[
        bool, switch("--refraction", "Also fit differential atmospheric refraction (from the ground).")
    ] = False
    epoch_jyear: Annotated[
        float | None, option("--epoch", "YEAR", "Date of the images, such as 2026.2; default: the catalogue's epoch.")
    ] = None
    catalog: Catalog = "hipparcos"
    centroider: Annotated[str, option("--centroider", "NAME", "Centroiding method.")] = "least_squares"
    parameters: Annotated[
        str | None,
        option(
            "--parameters",
            "A,B,...",
            "Parameters to fit (f, aspect, cx, cy, k1 ...); default: as the images determine.",
        ),
    ] = None
