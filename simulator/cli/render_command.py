"""``boresight render``: frames to FITS and PNG."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from simulator.checks import load_scenario
from simulator.cli.checks import at_least, picture_format, utc_time, writable
from simulator.cli.requests import RenderRequest
from simulator.fits import write_fits
from simulator.frame import Frame, FrameTruth
from simulator.paths import make_folder, write_atomically
from simulator.renderer import Renderer
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude


def main(request: RenderRequest) -> int:
    """Render one frame of each scenario, write what is asked for, and say where the cameras looked."""
    if request.index is not None and request.at is not None:
        raise InputError("--index and --at: give one of the two")
    at_least(0, index=request.index)
    index = request.index or 0
    attitude = parse_pointing(request.pointing) if request.pointing else None
    when = utc_time("--at", request.at) if request.at else None
    scenarios = [load_scenario(path, request.set_values or (), seed=request.seed) for path in request.scenarios]
    for scenario in scenarios:
        name = f"{scenario.name}-{index:05d}" if len(scenarios) == 1 else scenario.name
        image = _target(request.out, f"{name}.fits", len(scenarios) > 1)
        picture = _target(request.preview, f"{name}.png", len(scenarios) > 1)
        if image is None and picture is None:
            image = Path(f"{name}.fits")
        writable(image)
        picture_format(picture)
        at_s = (when - scenario.epoch).total_seconds() if when else None
        renderer = Renderer(scenario.noiseless() if request.noiseless else scenario)
        frame, truth = renderer.frame(index, at_s=at_s, attitude=attitude)
        _write(frame, truth, image, picture, request)
        print(
            f"{frame.utc} UTC  RA {truth.attitude.ra_deg:.5f}°  Dec {truth.attitude.dec_deg:+.5f}°  "
            f"roll {truth.attitude.roll_deg:.4f}°  in the field: {_in_field(frame, truth)}"
        )
    return 0


def _target(given: Path | None, name: str, several: bool) -> Path | None:
    """File to write: as given, or in the folder given where there are several scenarios."""
    if given is None or not (several or given.is_dir()):
        return given
    return make_folder(given) / name


def _write(frame: Frame, truth: FrameTruth, image: Path | None, picture: Path | None, request: RenderRequest) -> None:
    if image is not None:
        write_fits(image, frame, truth, noiseless_plane=request.noiseless_plane, wcs=request.wcs)
        print(f"{image}: {frame.image.shape[1]}×{frame.image.shape[0]} pixels, with the truth in its table TRUTH")
    if picture is not None:
        write_atomically(picture, _preview(frame, truth, picture_format(picture), request))
        print(f"{picture}: preview")


def _preview(frame: Frame, truth: FrameTruth, form: str, request: RenderRequest) -> bytes:
    from simulator.study.pictures import frame_picture, frame_preview
    from startracker.images.picture import figure_bytes, pixel_bytes

    if request.axes:
        return figure_bytes(frame_preview(frame, truth), form, dpi=130)
    return pixel_bytes(frame_picture(frame, truth if request.colour else None), form)


def _in_field(frame: Frame, truth: FrameTruth) -> str:
    inside = frame.camera.contains(truth.sources.xy)
    kind = truth.sources.kind[inside]
    satellites = int(np.sum(kind == "satellite"))
    bodies = [str(name) for name in truth.sources.name[inside][~np.isin(kind, ("star", "satellite"))]]
    bodies += [f"{satellites} satellite{'s' if satellites > 1 else ''}"] if satellites else []
    return " and ".join([f"{int(np.sum(kind == 'star'))} stars", *bodies])


def parse_pointing(text: str) -> Attitude:
    """Attitude of ``RA,DEC,ROLL`` in degrees; `InputError` for anything else."""
    try:
        ra, dec, roll = (float(part) for part in text.split(","))
        if not (math.isfinite(ra + roll) and -90 <= dec <= 90):
            raise ValueError
    except ValueError:
        raise InputError(
            f"--pointing: must be RA,DEC,ROLL in degrees with DEC from -90 to 90, such as 83.6,-5.4,0, not '{text}'"
        ) from None
    return Attitude.from_radec_roll(ra, dec, roll)
