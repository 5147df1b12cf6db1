"""Messages of the live protocol: what is refused, with which reason, and what the documents say of them."""

import json
import math
from pathlib import Path

import pytest

from simulator.live import answers
from simulator.live.answers import SERVER_MESSAGES, dump
from simulator.live.protocol import CLIENT_MESSAGES, COMMANDS, Refused, parse

PAGE = Path(__file__).parents[2] / "docs/reference/live-protocol.md"


@pytest.mark.parametrize(
    ("text", "code", "reason"),
    [
        ("", "malformed", "not a JSON object"),
        (b"\x00\xff\xfe binary", "malformed", "not a JSON object"),
        ('{"type":"hello","protocol":1', "malformed", "not a JSON object"),
        ("[" * 10_000, "malformed", "recursion"),
        ('{"type":"hello","token":"' + "x" * 20_000 + '"}', "malformed", "16384 bytes"),
        ("3", "invalid", "object"),
        ("{}", "invalid", "type"),
        ('{"type":"attitude","t_s":NaN,"quaternion":[0,0,0,1]}', "invalid", "t_s: Input should be a finite number"),
        ('{"type":"attitude","t_s":1,"quaternion":[0,0,NaN,1]}', "invalid", "quaternion"),
        ('{"type":"attitude","t_s":1e400,"quaternion":[0,0,0,1]}', "invalid", "t_s"),
        ('{"type":"attitude","t_s":1,"quaternion":[0,0,0,2]}', "invalid", "length of 2"),
        ('{"type":"attitude","t_s":1,"quaternion":[0,0,0]}', "invalid", "quaternion"),
        ('{"type":"attitude","t_s":1,"quaternion":[0,0,0,1],"rate_deg_s":[0,0,1e9]}', "invalid", "rate_deg_s"),
        ('{"type":"attitude","t_s":"1","quaternion":[0,0,0,1]}', "invalid", "t_s"),
        ('{"type":"subscribe","channels":["frames"]}', "invalid", "channels"),
        ('{"type":"subscribe","channels":[],"every":0}', "invalid", "every"),
        ('{"type":"command","name":"explode"}', "invalid", "explode"),
        ('{"type":"command","name":"speed","factor":0}', "invalid", "factor"),
        ('{"type":"command","name":"record","folder":"../x"}', "invalid", "folder"),
        ('{"type":"command","name":"record","folder":"a/b"}', "invalid", "folder"),
        ('{"type":"set","path":"detector.exposure_s","value":true}', "invalid", "value"),
        ('{"type":"set","path":"a","value":1,"more":2}', "invalid", "more: unknown field"),
        ('{"type":"hello","protocol":2}', "invalid", "protocol"),
    ],
)
def test_a_message_that_is_not_valid_is_refused_with_a_reason_in_one_line(text, code, reason):
    with pytest.raises(Refused) as refused:
        parse(text)
    assert refused.value.code == code
    assert reason in refused.value.reason
    assert "\n" not in refused.value.reason
    assert len(refused.value.reason) <= 500


def test_a_refusal_has_the_messages_id():
    with pytest.raises(Refused) as refused:
        parse('{"type":"set","id":"mine","path":"a","value":"b"}')
    assert refused.value.message_id == "mine"


@pytest.mark.parametrize(
    "message",
    [
        {"type": "hello", "protocol": 1, "token": "secret", "id": 3},
        {"type": "subscribe", "channels": ["frame", "state"], "frame_format": "raw16", "every": 5},
        {"type": "attitude", "t_s": 12.4, "quaternion": [0.0, 0.6, 0.0, 0.8], "rate_deg_s": [0.1, 0.0, -0.1]},
        {"type": "attitude", "time": "2026-03-21T12:00:00Z", "quaternion": [0, 0, 0, 1]},
        {"type": "set", "path": "detector.exposure_s", "value": 0.1},
        {"type": "command", "name": "kick", "rate_deg_s": [1, 2, 3]},
        {"type": "command", "name": "source", "attitude": "external", "lockstep": True},
    ],
)
def test_messages_are_read_as_they_are_written(message):
    read = parse(json.dumps(message)).model_dump(mode="json")
    assert {name: read[name] for name in message} == message


def test_numbers_keep_their_bits_and_nan_is_null():
    value = math.nextafter(0.1, 1.0)
    solution = answers.SolutionMessage(
        index=0, t_s=value, time="", status="", reason="", mode="", quaternion=None, covariance_rad2=None, ra_deg=None,
        dec_deg=None, roll_deg=None, rate_deg_s=None, detections=[(1.0, value, math.nan)], stars=[],
        times_ms={"render": math.nan}, latency_ms=0.0,
    )  # fmt: skip
    read = json.loads(dump(solution))
    assert read["t_s"] == value
    assert read["detections"] == [[1.0, value, None]]
    assert read["times_ms"] == {"render": None}
    assert "NaN" not in dump(solution)


def messages():
    yield from ((name, kind) for name, kind in {**CLIENT_MESSAGES, **COMMANDS, **SERVER_MESSAGES}.items())
    yield from ((kind.__name__, kind) for kind in (answers.Parameter, answers.CameraInfo, answers.MatchedStar))
    yield "Exclusions", answers.Exclusions


@pytest.mark.parametrize(("name", "kind"), list(messages()))
def test_the_reference_lists_every_message_with_every_field(name, kind):
    headings = {"Parameter": "parameters", "CameraInfo": "camera", "MatchedStar": "stars", "Exclusions": "exclusions"}
    heading = headings.get(name, name)
    section = PAGE.read_text().partition(f"\n### `{heading}`")[2].partition("\n### ")[0].partition("\n## ")[0]
    assert section, f"{PAGE.name} has no section `{heading}`"
    for field in kind.model_fields:
        if field not in (
            "type",
            "name" if name in COMMANDS else "type",
            "id" if name not in SERVER_MESSAGES else "type",
        ):
            assert f"| `{field}` |" in section, f"{heading} does not list {field}"


def test_every_field_has_a_description():
    nameless = [
        f"{name}.{field}"
        for name, kind in messages()
        for field, info in kind.model_fields.items()
        if not info.description and field not in ("type", "name")
    ]
    # two or more names that share the description below them
    assert set(nameless) <= {"Parameter.minimum", "CameraInfo.width", "CameraInfo.fx", "CameraInfo.cx",
                             "CameraInfo.fov_deg", "frame.width", "MatchedStar.x", "solution.ra_deg",
                             "solution.dec_deg", "truth.sun", "truth.moon", "Exclusions.sun_deg",
                             "Exclusions.moon_deg"}  # fmt: skip
