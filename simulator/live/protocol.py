"""Messages of the clients of a live mission, version 1: their fields, units and limits.

Clients send one JSON object a message; `parse` gives it as one of the classes of `ClientMessage`, or raises `Refused`
with a code and a reason in one line. The server's messages are in `simulator.live.answers`.
Angles are in degrees, times in seconds after the scenario's epoch, quaternions scalar last, ICRS to camera. A value
that is not defined (an attitude that was not solved) is null.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, TypeAdapter, ValidationError

__all__ = [
    "CLIENT_MESSAGES",
    "COMMANDS",
    "LARGEST_MESSAGE_BYTES",
    "PROTOCOL",
    "ClientMessage",
    "Message",
    "Refused",
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


class Message(BaseModel):
    """Base of all messages: frozen, strict, without unknown fields."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True)


class _FromClient(Message):
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
    get_args(kind.model_fields["name"].annotation)[0]: kind
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
