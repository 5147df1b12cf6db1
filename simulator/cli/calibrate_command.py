"""``boresight calibrate``: photographs of the sky to a camera file."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

from simulator.cli.checks import picture_format, writable
from simulator.cli.image_files import FITS_SUFFIXES, image_files, is_our_frame
from simulator.cli.requests import CalibrateRequest
from simulator.fits import read_fits
from simulator.paths import write_atomically
from startracker import centroid as centroiding
from startracker import detection as detecting
from startracker.calibration import StarField, calibrate
from startracker.calibration.plot import residual_picture
from startracker.calibration.result import camera_yaml, summary
from startracker.errors import BoresightError, InputError
from startracker.front_end import Clock, find_stars
from startracker.geometry.camera import Camera
from startracker.images.reading import read_image
from startracker.inputs import given_image
from startracker.observer import Observer
from startracker.settings import CentroidSettings, DetectionSettings
from startracker.settings.registry import lookup

_MOST_STARS = 400
_YEARS = (1800.0, 2200.0)


def main(request: CalibrateRequest) -> int:
    """Calibrate and write; exit status 0, or 1 when some images had to be left out."""
    _check(request)
    camera = Camera.from_yaml(request.camera) if request.camera else None
    fields, faults = [], 0
    for path in list(image_files(request.images)):
        try:
            fields.append(_field(path, request))
        except BoresightError as error:
            print(error, file=sys.stderr)
            faults += 1
    if not fields:
        raise InputError("calibrate: no image was solved")
    result = calibrate(
        fields,
        camera=camera,
        fov_deg=request.fov_deg,
        catalog=request.catalog,
        projection=request.projection,
        refraction=request.refraction,
        parameters=None if request.parameters is None else [p.strip() for p in request.parameters.split(",")],
    )
    # both are whole in memory before either is written
    text, picture = (
        camera_yaml(result),
        None if request.plot is None else residual_picture(result, picture_format(request.plot)),
    )
    write_atomically(request.out, text)
    if request.plot is not None and picture is not None:
        write_atomically(request.plot, picture)
    print("\n".join(summary(result)))
    print(f"written: {request.out}" + (f", {request.plot}" if request.plot else ""))
    return 1 if faults or result.unsolved else 0


def _check(request: CalibrateRequest) -> None:
    if request.fov_deg is not None and request.camera is not None:
        raise InputError("--fov and --camera: give one of the two; a camera file holds its field of view")
    if request.fov_deg is not None and not 0.5 <= request.fov_deg <= 120:
        raise InputError(f"--fov: must be between 0.5 and 120 degrees, not {request.fov_deg:g}")
    lookup("centroiders", centroiding.METHODS, request.centroider)  # a wrong name once, not for every image
    epoch = request.epoch_jyear
    if epoch is not None and not (math.isfinite(epoch) and _YEARS[0] <= epoch <= _YEARS[1]):
        raise InputError(f"--epoch: must be a year such as 2026.2, from {_YEARS[0]:g} to {_YEARS[1]:g}; got {epoch:g}")
    writable(request.out)
    picture_format(request.plot)
    if request.plot is not None and request.plot.resolve() == request.out.resolve():
        raise InputError(f"{request.out}: --out and --plot name the same file")


def _field(path: Path, request: CalibrateRequest) -> StarField:
    """Centroids of one image file."""
    observer = None if request.epoch_jyear is None else Observer(request.epoch_jyear)
    if path.suffix.lower() in FITS_SUFFIXES and is_our_frame(path):
        frame = read_fits(path)
        given, observer = given_image(frame), frame.observer
    else:
        given = given_image(read_image(path, upright=False))  # one orientation for all: the sensor's own
    found = find_stars(
        given,
        detecting.METHODS["components"],
        lookup("centroiders", centroiding.METHODS, request.centroider),
        DetectionSettings(max_stars=_MOST_STARS),
        CentroidSettings(),
        Clock(),
    )
    if found.status is not None:
        raise InputError(f"{path}: {found.reason}")
    height, width = np.shape(given.image)
    return StarField(path.name, found.stars.xy, width, height, found.stars.flux, found.stars.variance_px2, observer)
