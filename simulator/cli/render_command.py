"""``boresight render``: one frame to FITS and PNG."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from simulator.checks import load_scenario
from simulator.cli.checks import writable
from simulator.fits import write_fits
from simulator.paths import write_atomically
from simulator.renderer import Renderer
from startracker.attitude import Attitude
from startracker.errors import InputError


def render_frame(
    path: Path,
    index: int | None,
    at: str | None,
    pointing: str | None,
    seed: int | None,
    set_values: list[str],
    out: Path | None,
    preview: Path | None,
    noiseless: bool,
) -> int:
    """Render, write what is asked for, and say where the camera looked."""
    if index is not None and at is not None:
        raise InputError("--index and --at: give one of the two")
    if index is not None and index < 0:
        raise InputError(f"--index: must be 0 or more, not {index}")
    scenario = load_scenario(path, set_values, seed=seed)
    for target in (out, preview):
        writable(target)
    if noiseless:
        scenario = scenario.noiseless()
    at_s = (_parse_time(at) - scenario.epoch).total_seconds() if at else None
    attitude = _parse_pointing(pointing) if pointing else None
    frame, truth = Renderer(scenario).frame(index or 0, at_s=at_s, attitude=attitude)
    if out is None and preview is None:
        out = Path(f"{scenario.name}-{index or 0:05d}.fits")
        writable(out)
    if out is not None:
        write_fits(out, frame, truth)
        print(f"{out}: {frame.image.shape[1]}×{frame.image.shape[0]} pixels, with the truth in its table TRUTH")
    if preview is not None:
        from simulator.study.plots import frame_preview, save_bytes

        write_atomically(preview, save_bytes(frame_preview(frame, truth)))
        print(f"{preview}: preview")
    attitude, stars = (
        truth.attitude,
        int(np.sum((truth.sources.kind == "star") & frame.camera.contains(truth.sources.xy))),
    )
    print(
        f"{frame.utc} UTC  RA {attitude.ra_deg:.5f}°  Dec {attitude.dec_deg:+.5f}°  roll {attitude.roll_deg:.4f}°  "
        f"{stars} stars to V {scenario.sky.magnitude_limit:g} in the field"
    )
    return 0


def _parse_pointing(text: str) -> Attitude:
    try:
        ra, dec, roll = (float(part) for part in text.split(","))
        if not (math.isfinite(ra + roll) and -90 <= dec <= 90):
            raise ValueError
    except ValueError:
        raise InputError(
            f"--pointing: must be RA,DEC,ROLL in degrees with DEC from -90 to 90, such as 83.6,-5.4,0, not '{text}'"
        ) from None
    return Attitude.from_radec_roll(ra, dec, roll)


def _parse_time(text: str) -> datetime:
    try:
        value = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(f"--at: '{text}' is not an ISO 8601 time such as 2026-03-21T12:00:00Z") from None
    return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)
