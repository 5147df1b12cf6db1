"""Messages of the server of a live mission, version 1: their fields and units.

`dump` writes them. Units and axes are those of `simulator.live.protocol`; a value that is not defined is null.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict

from simulator.live.protocol import Channel, FrameFormat, Message, Quaternion

__all__ = [
    "SERVER_MESSAGES",
    "CameraInfo",
    "Error",
    "Exclusions",
    "FrameHeader",
    "MatchedStar",
    "Parameter",
    "Picture",
    "Reply",
    "ServerMessage",
    "SolutionMessage",
    "StateMessage",
    "StimulusMessage",
    "TruthMessage",
    "Welcome",
    "dump",
]

Three = tuple[float, float, float]


class ServerMessage(Message):
    """Base of the server's messages. NaN and infinities are written as null."""

    model_config = ConfigDict(ser_json_inf_nan="null", strict=False)
    channel: ClassVar[Channel | None] = None


class Parameter(BaseModel):
    """A value that a client may change."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True)
    path: str
    """Its name in ``set``: a key of the scenario."""
    label: str
    """For display."""
    group: str
    """Heading under which it may be listed: camera, detector, motion, age."""
    unit: str
    """Empty for a pure number."""
    minimum: float
    maximum: float
    """Permitted range."""
    value: float
    """Present value."""
    logarithmic: bool
    """Whether a slider should be logarithmic."""


class CameraInfo(BaseModel):
    """The calibrated camera: x = fx X/Z + cx, y = fy Y/Z + cy for a pinhole without distortion."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True)
    width: int
    height: int
    """Size of the image, pixels."""
    fx: float
    fy: float
    """Focal length, pixels."""
    cx: float
    cy: float
    """Principal point, pixels; the centre of the first pixel is (0, 0)."""
    projection: str
    """``pinhole``, or that of a fisheye lens."""
    distortion: tuple[float, ...]
    """OpenCV's k1, k2, p1, p2, k3, k4, k5, k6."""
    fov_deg: float
    fov_y_deg: float
    """Field of view across the width and the height, °."""
    saturation_dn: float
    """Largest digital number."""


class Welcome(ServerMessage):
    """Answer to ``hello``."""

    type: Literal["welcome"] = "welcome"
    protocol: int
    """Version of the protocol."""
    version: str
    """Version of boresight."""
    scenario: str
    """Name of the scenario."""
    camera: CameraInfo
    """The calibrated camera."""
    start: str
    """UTC of t_s = 0, the scenario's epoch, ISO 8601."""
    step_s: float
    """Time between frames, s."""
    parameters: list[Parameter]
    """What ``set`` may change."""
    commands: list[str]
    """Names of the commands."""
    channels: list[str]
    """Names of the channels."""


class Reply(ServerMessage):
    """A message was accepted and has taken effect."""

    type: Literal["reply"] = "reply"
    id: str | int | None = None
    """That of the client's message."""
    ok: Literal[True] = True
    """Always true."""
    detail: str = ""
    """What was done, where that is not evident: the folder of a recording, the time of a jump."""


class Error(ServerMessage):
    """A message was refused; nothing has changed."""

    type: Literal["error"] = "error"
    id: str | int | None = None
    """That of the client's message, if it could be read."""
    code: str
    """``malformed``: not a JSON object, or too large; ``invalid``: a field is unknown, missing, or out of its range;
    ``hello_first``; ``token``; ``rate``: too many messages; ``busy``: too many clients; ``state``: not
    possible now; ``failed``: a frame could not be made."""
    reason: str
    """One line for display."""


class _OfFrame(ServerMessage):
    index: int
    """Number of the frame since the start of the server, ascending."""
    t_s: float
    """Mid-exposure, s after the scenario's epoch."""
    time: str
    """The same as UTC, ISO 8601."""
    missed: int = 0
    """Frames omitted since the last one sent to this client, because it was slow."""


class FrameHeader(_OfFrame):
    """A frame; its bytes follow as one binary message, or over TCP as base64 in ``data``."""

    channel = "frame"
    type: Literal["frame"] = "frame"
    width: int
    height: int
    """Size, pixels."""
    format: FrameFormat
    """As asked for in ``subscribe``."""
    bytes: int
    """Number of bytes that follow; 0 for ``none``: then there is no binary message."""
    bits: int
    """Bits of a pixel: 16 for ``raw16`` (little-endian, row by row), 8 for ``png``, 16 or -64 for ``fits``."""
    exposure_s: float
    """Exposure time, s."""
    data: str | None = None
    """TCP only: the bytes as base64."""


class MatchedStar(BaseModel):
    """An identified star."""

    model_config = ConfigDict(ser_json_inf_nan="null", use_attribute_docstrings=True)
    x: float
    y: float
    """Measured centroid, pixels."""
    id: int
    """Number in the tracker's catalogue."""
    name: str
    """Proper name or designation, if it has one."""
    residual_px: float
    """Distance between measured and predicted position, pixels."""
    magnitude: float
    """Catalogue V."""


class SolutionMessage(_OfFrame):
    """What the tracker found in a frame."""

    channel = "solution"
    type: Literal["solution"] = "solution"
    status: str
    """``solved``, why not (`startracker.solution.Status`), or ``no_frame``; with ``sequence.operation`` also
    ``discarded`` and ``suspended``."""
    reason: str
    """In words."""
    mode: str
    """``tracking``, ``prior``, ``lost_in_space``; ``coasting``: prediction only; ``none``: no attitude."""
    quaternion: Quaternion | None
    """Attitude of the filter, ICRS to camera, scalar last, also while coasting."""
    covariance_rad2: tuple[Three, Three, Three] | None
    """Covariance of its error (rotation vector in camera axes), rad²."""
    ra_deg: float | None
    dec_deg: float | None
    roll_deg: float | None
    """Boresight, ICRS, and roll: position angle of the camera's up axis (−y), east of north, °."""
    rate_deg_s: Three | None
    """Estimated rate, camera axes, °/s."""
    detections: list[Three]
    """Centroids, brightest first: x, y in pixels and the signal in electrons, or null for a centroid that was not
    identified."""
    stars: list[MatchedStar]
    """The identified stars."""
    times_ms: dict[str, float]
    """Time of each stage of the tracker, and of ``render`` and ``track``, ms."""
    latency_ms: float
    """From the arrival of the attitude (external) or from the moment at which the frame was due (scenario) until this
    solution was ready, ms."""


class Exclusions(BaseModel):
    """Angles from the boresight within which a body is in the way; 0: none."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True)
    sun_deg: float
    moon_deg: float
    earth_deg: float
    """From the centre of Sun and Moon, and from the Earth's limb, °."""


class TruthMessage(_OfFrame):
    """The truth of a frame, on its own channel: the tracker never has it."""

    channel = "truth"
    type: Literal["truth"] = "truth"
    quaternion: Quaternion
    """True attitude, ICRS to camera, scalar last."""
    rate_deg_s: Three
    """True inertial rate, camera axes, °/s."""
    error_arcsec: Three | None
    """Attitude of the solution against the truth: rotation vector in camera axes, ″."""
    bound_arcsec: Three | None
    """Cramér–Rao bound of this frame's identified stars about the camera's axes, ″."""
    misidentified: bool
    """Whether a star of the solution is not the one that it names."""
    inconsistent: bool
    """Whether the error is beyond 5 σ of the stated covariance."""
    wrong: bool
    """Whether the solution is wrong: misidentified, or inconsistent and beyond the specification as well."""
    position_km: Three
    """Spacecraft from the Earth's centre, GCRS, km."""
    sun: Three | None
    moon: Three | None
    earth: Three | None
    """Apparent directions from the spacecraft, unit vectors, ICRS axes."""
    earth_radius_deg: float
    """Angular radius of the Earth, °."""
    blinded: bool
    """Whether the camera is covered."""
    excluded: list[str]
    """Bodies within the exclusion angles."""
    exclusions: Exclusions
    """The baffle's exclusion angles."""


class Picture(BaseModel):
    """One picture of a display."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True)
    t_s: float
    """When it is to be shown, s after the scenario's epoch."""
    pixels: int
    """Number of lit pixels; all others are black."""


class StimulusMessage(_OfFrame):
    """Pictures from one frame to the next, for the true attitude at the frame, turned on with the true rate.

    The lit pixels of all pictures in turn follow as one binary message, or over TCP as base64 in ``data``: eight bytes
    each, column and row as little-endian 16-bit integers, levels of red, green and blue from 0 to 255, and a zero.
    """

    channel = "stimulus"
    type: Literal["stimulus"] = "stimulus"
    width: int
    """Columns of the display."""
    height: int
    """Rows of the display."""
    speed: float
    """Factor on real time."""
    paced: bool
    """Whether the pictures follow the clock; otherwise (paused, or in lockstep) there is one, to be shown at once."""
    pictures: list[Picture]
    """In the order of their times."""
    bytes: int
    """Number of bytes that follow."""
    stars: int
    """Stars in the first picture."""
    clipped: int
    """Those with a pixel beyond the display's brightest level."""
    faint: int
    """Those whose brightness is wrong by more than 0.1 mag, as the levels are too coarse for them."""
    data: str | None = None
    """TCP only: the bytes as base64."""


class StateMessage(ServerMessage):
    """State of the mission; sent on change, at most four times a second."""

    channel = "state"
    type: Literal["state"] = "state"
    running: bool
    """Whether frames are being made; false while paused, or while waiting for an attitude."""
    paused: bool
    """Whether it is paused."""
    speed: float
    """Factor on real time."""
    source: Literal["scenario", "external"]
    """Where the attitudes come from."""
    lockstep: bool
    """Whether each external attitude makes one frame."""
    t_s: float
    """Time of the last frame, s after the scenario's epoch."""
    index: int
    """Number of the last frame, −1 before the first."""
    blinded: bool
    """Whether the camera is covered."""
    recording: str | None
    """Folder of the recording; null without one."""
    clients: int
    """Number of clients."""
    late_frames: int
    """Frames made later than they were due by more than a step of the mission."""
    late_pictures: int
    """Pictures that connected displays showed too late, or not at all."""
    frame_rate_hz: float
    """Frames per second of real time, over the last two seconds."""
    notice: str
    """What happened last without being asked for, such as the end of a recording; empty if nothing."""
    parameters: dict[str, float]
    """Present values by path."""


SERVER_MESSAGES: dict[str, type[ServerMessage]] = {
    kind.model_fields["type"].default: kind
    for kind in (Welcome, FrameHeader, SolutionMessage, TruthMessage, StimulusMessage, StateMessage, Reply, Error)
}
"""Messages of the server by type."""


def dump(message: ServerMessage) -> str:
    """A message as one line of JSON."""
    excluded: Any = {"data"} if isinstance(message, FrameHeader | StimulusMessage) and message.data is None else None
    return message.model_dump_json(exclude=excluded)
