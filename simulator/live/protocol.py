"""Messages of a live mission, version 1: their fields, units and limits.

Clients send one JSON object a message; `parse` gives it as one of the classes of `ClientMessage`, or raises `Refused`
with a code and a reason in one line. The server's messages are the classes of `ServerMessage`; `dump` writes them.
Angles are in degrees, times in seconds after the scenario's epoch, quaternions scalar last, ICRS to camera. A value
that is not defined (an attitude that was not solved) is null.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, TypeAdapter, ValidationError

__all__ = [
    "CLIENT_MESSAGES",
    "COMMANDS",
    "LARGEST_MESSAGE_BYTES",
    "PROTOCOL",
    "SERVER_MESSAGES",
    "ClientMessage",
    "Refused",
    "ServerMessage",
    "dump",
    "parse",
]

PROTOCOL = 1
"""Version of these messages."""
LARGEST_MESSAGE_BYTES = 16_384
"""Largest message of a client."""
LARGEST_RATE_DEG_S = 360.0
"""Largest rate of an attitude or a kick about one axis."""
_NORM_TOLERANCE = 1e-3

Channel = Literal["frame", "solution", "truth", "state", "stimulus"]
FrameFormat = Literal["png", "raw16", "fits", "none"]
Rate = Annotated[FiniteFloat, Field(ge=-LARGEST_RATE_DEG_S, le=LARGEST_RATE_DEG_S)]
Rates = tuple[Rate, Rate, Rate]
Seconds = Annotated[FiniteFloat, Field(ge=-1e10, le=1e10)]
Three = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Name = Annotated[str, Field(max_length=200)]


class Refused(Exception):
    """A message that is refused; nothing has changed.

    Parameters
    ----------
    code : str
        For programs: ``malformed``, ``invalid``, ``hello_first``, ``token``, ``rate``, ``busy``, ``state``.
    reason : str
        For display, one line.
    message_id : str or int, optional
        The message's ``id``, if it could be read.
    """

    def __init__(self, code: str, reason: str, message_id: str | int | None = None) -> None:
        super().__init__(reason)
        self.code, self.reason, self.message_id = code, " ".join(reason.split())[:500], message_id


def _unit(quaternion: Quaternion) -> Quaternion:
    norm = math.hypot(*quaternion)
    if not abs(norm - 1.0) < _NORM_TOLERANCE:
        raise ValueError(f"the quaternion has a length of {norm:.6g}; attitudes are unit quaternions")
    return quaternion


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True)


class _FromClient(_Message):
    id: Annotated[str, Field(max_length=100)] | int | None = None
    """Name of the message, at most 100 characters; the reply has the same."""


class Hello(_FromClient):
    """First message of a client; the answer is ``welcome``."""

    type: Literal["hello"] = "hello"
    protocol: Literal[1]
    """Version of the protocol."""
    token: Name = ""
    """Token of the server, if it has one; over WebSocket it may be in the address instead (``/ws?token=…``)."""


class Subscribe(_FromClient):
    """What the client wants to receive, in place of what it had asked for before."""

    type: Literal["subscribe"] = "subscribe"
    channels: tuple[Channel, ...]
    """``frame``, ``solution``, ``truth``, ``state``; ``stimulus``: pictures for a display before a real tracker."""
    frame_format: FrameFormat = "png"
    """``png``: 8 bits, stretched for display; ``raw16``: the digital numbers, 16 bits; ``fits``: the digital numbers
    with what the camera knows; ``none``: headers of the frames without pixels."""
    every: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    """Only frames, solutions and truths whose index is a multiple of this."""


class GivenAttitude(_FromClient):
    """True attitude of the camera at an instant, for a mission whose source is ``external``. Give `t_s` or `time`."""

    type: Literal["attitude"] = "attitude"
    t_s: Seconds | None = None
    """Time, s after the scenario's epoch; later than that of the attitude before."""
    time: Name | None = None
    """The same as UTC, ISO 8601."""
    quaternion: Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat], AfterValidator(_unit)]
    """ICRS to camera, scalar last, of length 1 within 0.1 %."""
    rate_deg_s: Rates = (0.0, 0.0, 0.0)
    """Inertial angular velocity in camera axes, °/s, at most 360 about each axis; it smears the stars."""


class Shown(_FromClient):
    """What a display before a tracker has shown since it connected; no reply without an ``id``."""

    type: Literal["shown"] = "shown"
    shown: Annotated[int, Field(ge=0)]
    """Pictures shown."""
    late: Annotated[int, Field(ge=0)]
    """Pictures shown more than one and a half refreshes late, or too late to be shown at all."""


class Set(_FromClient):
    """Change a parameter from the next frame on; refused with the reason if the value is not valid."""

    type: Literal["set"] = "set"
    path: Name
    """One of the paths in ``welcome.parameters``."""
    value: FiniteFloat
    """New value, in the parameter's unit."""


class _Command(_FromClient):
    type: Literal["command"] = "command"


class Pause(_Command):
    """Stop making frames."""

    name: Literal["pause"]


class Resume(_Command):
    """Go on after a pause."""

    name: Literal["resume"]


class Step(_Command):
    """Make one frame while paused."""

    name: Literal["step"]


class Speed(_Command):
    """Speed of the mission against real time."""

    name: Literal["speed"]
    factor: Annotated[FiniteFloat, Field(ge=0.001, le=1000)]
    """1: real time; 10: ten times as fast, if the machine can."""


class Source(_Command):
    """Where the attitudes come from."""

    name: Literal["source"]
    attitude: Literal["scenario", "external"]
    """``scenario``: from the scenario; ``external``: from messages ``attitude``."""
    lockstep: bool = False
    """With ``external``: each attitude makes one frame, exposed about its time, as soon as it arrives. False: frames
    are made at the mission's own times from the newest attitude, turned on by its rate."""


class Kick(_Command):
    """Add a rate to the body's."""

    name: Literal["kick"]
    rate_deg_s: Rates
    """Roll, pitch and yaw, body axes, °/s."""


class Blind(_Command):
    """Cover the camera: it delivers no frames until ``unblind``, as in ``sequence.dropouts``."""

    name: Literal["blind"]
    head: Name | None = None
    """Name of the camera's head; without it, the one that is served."""


class Unblind(_Command):
    """Uncover the camera."""

    name: Literal["unblind"]
    head: Name | None = None
    """As for ``blind``."""


class Saa(_Command):
    """Jump to the next pass through the South Atlantic Anomaly, and switch the trapped particles on."""

    name: Literal["saa"]


class Seek(_Command):
    """Jump to a time; the tracker starts again."""

    name: Literal["seek"]
    t_s: Seconds
    """Time of the next frame, s after the scenario's epoch."""


class Record(_Command):
    """Begin a recording that ``boresight run --sequence`` reads; the tracker starts again."""

    name: Literal["record"]
    folder: Annotated[str, Field(max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")] | None = None
    """Name of a new folder within the server's folder of recordings; by default the date and time."""


class StopRecording(_Command):
    """End the recording and write its files."""

    name: Literal["stop_recording"]


_Commands = Pause | Resume | Step | Speed | Source | Kick | Blind | Unblind | Saa | Seek | Record | StopRecording
ClientMessage = Hello | Subscribe | GivenAttitude | Shown | Set | _Commands
_ANY: TypeAdapter[ClientMessage] = TypeAdapter(
    Annotated[
        Hello | Subscribe | GivenAttitude | Shown | Set | Annotated[_Commands, Field(discriminator="name")],
        Field(discriminator="type"),
    ]
)
CLIENT_MESSAGES: dict[str, type[_FromClient]] = {
    kind.model_fields["type"].default: kind for kind in (Hello, Subscribe, GivenAttitude, Shown, Set)
}
"""Messages of clients by type, except the commands."""
COMMANDS: dict[str, type[_FromClient]] = {
    kind.model_fields["name"].annotation.__args__[0]: kind  # type: ignore[union-attr]
    for kind in (Pause, Resume, Step, Speed, Source, Kick, Blind, Unblind, Saa, Seek, Record, StopRecording)
}
"""Commands by name."""


def parse(text: str | bytes) -> ClientMessage:
    """A client's message; `Refused` with the reason if it is too large, not JSON, or not valid."""
    if len(text) > LARGEST_MESSAGE_BYTES:
        raise Refused("malformed", f"the message has more than {LARGEST_MESSAGE_BYTES} bytes")
    try:
        return _ANY.validate_json(text)
    except ValidationError as error:
        raise _refusal(error, text) from None


def _refusal(error: ValidationError, text: str | bytes) -> Refused:
    """The first fault of a message as one line, with the message's id if it has one."""
    first = error.errors(include_url=False, include_context=False)[0]
    if first["type"] == "json_invalid":
        return Refused("malformed", f"not a JSON object: {first['msg'].removeprefix('Invalid JSON: ')}")
    known = {*CLIENT_MESSAGES, *COMMANDS, "command"}
    at = ".".join(str(part) for part in first["loc"] if part not in known)
    message = first["msg"].removeprefix("Value error, ")
    message = "unknown field" if first["type"] == "extra_forbidden" else message
    return Refused("invalid", f"{at}: {message}" if at else message, _id_of(text))


def _id_of(text: str | bytes) -> str | int | None:
    """The ``id`` of a message that is JSON but not valid."""
    try:
        return _OnlyId.model_validate_json(text).id
    except ValidationError:
        return None


class _OnlyId(BaseModel):
    model_config = ConfigDict(extra="ignore", strict=True)
    id: Annotated[str, Field(max_length=100)] | int | None = None


# ---------------------------------------------------------------------- from the server
class ServerMessage(_Message):
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
    wrong: bool
    """Whether the solution is wrong: misidentified stars, or an error that noise does not explain."""
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
