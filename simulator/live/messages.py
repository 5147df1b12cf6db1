"""A frame of a live mission as messages: header, solution, truth; and the camera of ``welcome``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from simulator.constants import EARTH_RADIUS_KM
from simulator.live.answers import (
    CameraInfo,
    Exclusions,
    FrameHeader,
    MatchedStar,
    SolutionMessage,
    TruthMessage,
    Welcome,
)
from simulator.live.images import Encoded
from simulator.live.mission import LiveFrame, LiveMission
from simulator.live.protocol import COMMANDS, PROTOCOL
from simulator.renderer import Renderer
from simulator.study.axes import CAMERA_AXES
from simulator.study.trackers import Session
from simulator.study.trials.bounds import attitude_bound_deg, matched_sources
from startracker._version import __version__
from startracker.catalog.names import designation, proper_name
from startracker.core import FloatArray
from startracker.solution import Solution

__all__ = ["frame_header", "solution_message", "truth_message", "welcome"]

_DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def welcome(mission: LiveMission, channels: list[str]) -> Welcome:
    """Answer to ``hello``."""
    return Welcome(
        protocol=PROTOCOL,
        version=__version__,
        scenario=mission.scenario.name,
        camera=_camera_info(mission.renderer),
        start=mission.isot(0.0),
        step_s=mission.step_s,
        parameters=mission.parameters(),
        commands=list(COMMANDS),
        channels=channels,
    )


def _camera_info(renderer: Renderer) -> CameraInfo:
    """The calibrated camera of a mission."""
    camera, detector = renderer.camera, renderer.scenario.detector
    largest = 2.0**detector.adc_bits - 1.0 if detector.adc_bits is not None else 65535.0
    numbers = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy", "projection")}
    return CameraInfo(
        **numbers,
        distortion=tuple(float(getattr(camera.distortion, name)) for name in _DISTORTION),
        fov_deg=camera.fov_deg,
        fov_y_deg=camera.fov_y_deg,
        saturation_dn=largest,
    )


def frame_header(live: LiveFrame, form: Any, encoded: Encoded) -> FrameHeader:
    """Header of the bytes of a frame that was taken."""
    frame = live.tracked.frame
    assert frame is not None
    height, width = frame.image.shape
    return FrameHeader(
        index=live.index,
        t_s=live.moment.state.t_s,
        time=frame.utc,
        width=width,
        height=height,
        format=form,
        bytes=len(encoded.data),
        bits=encoded.bits,
        exposure_s=frame.exposure_s,
    )


def solution_message(live: LiveFrame, session: Session, latency_ms: float) -> SolutionMessage:
    """What the tracker found; to be called before the next frame."""
    row, solution = live.tracked.row, live.tracked.solution
    attitude, covariance, rate = session.filter_attitude, session.covariance, session.rate_rad_s
    frame = live.tracked.frame
    gain = frame.gain_e_per_dn if frame is not None else math.nan
    return SolutionMessage(
        index=live.index,
        t_s=live.moment.state.t_s,
        time=frame.utc if frame is not None else row["utc"],
        status=row["status"],
        reason=row["reason"],
        mode=row["mode"],
        quaternion=_tuple(attitude.quat) if attitude else None,
        covariance_rad2=tuple(map(_tuple, covariance[:3, :3])) if covariance is not None else None,
        ra_deg=attitude.ra_deg if attitude else None,
        dec_deg=attitude.dec_deg if attitude else None,
        roll_deg=attitude.roll_deg if attitude else None,
        rate_deg_s=_tuple(np.degrees(rate)) if rate is not None else None,
        detections=_detections(solution, gain),
        stars=_stars(solution),
        times_ms={**solution.times_ms, "render": row["render_ms"], "track": row["track_ms"]},
        latency_ms=latency_ms,
    )


def _tuple(values: FloatArray) -> Any:
    return tuple(np.asarray(values, dtype=float).tolist())


def _detections(solution: Solution, gain_e_per_dn: float) -> list[Any]:
    """Centroids with the signal of those that are identified, electrons."""
    stars = solution.stars
    signal = dict(zip(map(tuple, stars.xy.tolist()), (stars.flux * gain_e_per_dn).tolist(), strict=True))
    return [(x, y, signal.get((x, y), math.nan)) for x, y in solution.centroids.tolist()]


def _stars(solution: Solution) -> list[MatchedStar]:
    stars = solution.stars
    residuals = np.hypot(*stars.residual_px.T).tolist() if len(stars) else []
    columns = (stars.xy.tolist(), stars.catalog_id.tolist(), stars.name.tolist(), residuals, stars.v_mag.tolist())
    return [
        MatchedStar(x=x, y=y, id=number, name=proper_name(name) or designation(name), residual_px=off, magnitude=v_mag)
        for (x, y), number, name, off, v_mag in zip(*columns, strict=True)
    ]


def truth_message(live: LiveFrame) -> TruthMessage:
    """The truth of a frame."""
    renderer, row, t_s = live.renderer, live.tracked.row, live.moment.state.t_s
    true, exposure_s = live.tracked.truth, renderer.exposure_s
    instant = renderer.scenes.instant_at(t_s)
    directions = dict(zip(instant.bodies.name.tolist(), instant.bodies.direction, strict=True))
    distance_km = float(np.linalg.norm(instant.r_km))
    baffle = renderer.scenario.optics.baffle
    attitude = true.attitude if true is not None else live.moment.camera(exposure_s)
    error_deg = [row[f"error_{axis}_deg"] for axis in CAMERA_AXES]
    return TruthMessage(
        index=live.index,
        t_s=t_s,
        time=row["utc"],
        quaternion=_tuple(attitude.quat),
        rate_deg_s=_tuple(np.degrees(live.moment.rate_rad_s(exposure_s))),
        error_arcsec=_tuple(3600.0 * np.array(error_deg)) if np.isfinite(error_deg).all() else None,
        bound_arcsec=_bound_arcsec(live),
        misidentified=bool(row["misidentified"]),
        inconsistent=bool(row["inconsistent"]),
        wrong=bool(row["wrong"]),
        position_km=_tuple(instant.r_km),
        sun=_direction(directions, "Sun"),
        moon=_direction(directions, "Moon"),
        earth=_tuple(-instant.r_km / distance_km),
        earth_radius_deg=math.degrees(math.asin(min(EARTH_RADIUS_KM / distance_km, 1.0))),
        blinded=live.blinded,
        excluded=list(true.excluded) if true is not None else [],
        exclusions=Exclusions(
            sun_deg=baffle.sun_exclusion_deg, moon_deg=baffle.moon_exclusion_deg, earth_deg=baffle.earth_exclusion_deg
        ),
    )


def _direction(directions: dict[str, FloatArray], name: str) -> Any:
    return _tuple(directions[name]) if name in directions else None


def _bound_arcsec(live: LiveFrame) -> Any:
    """Cramér–Rao bound of the stars that the tracker used; None without a solution, or under rules of operation, whose
    exposures vary."""
    truth, solution = live.tracked.truth, live.tracked.solution
    if truth is None or not solution.solved or live.renderer.scenario.sequence.operation.use:
        return None
    stars = matched_sources(truth, solution.stars.fitted.xy)
    bound_deg = attitude_bound_deg(live.renderer, truth, stars)
    return _tuple(3600.0 * bound_deg) if np.isfinite(bound_deg).all() else None
