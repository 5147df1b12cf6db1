"""A small live mission, and clients of its server, for tests."""

from __future__ import annotations

import contextlib
import json
import socket

from simulator.checks import load_scenario
from simulator.live.server import ServerOptions, serving

SMALL = (
    *("detector.width=256", "detector.height=256", "optics.focal_length_mm=8", "optics.aperture_mm=8"),
    *("optics.distortion.k1=0", "sky.magnitude_limit=7", "detector.exposure_s=0.1", "sequence.frames=8"),
    "tracker.prior=false",
)


def small(*overrides, name="cubesat_ideal"):
    """Scenario of a small camera with a wide field."""
    return load_scenario(name, [*SMALL, *overrides])


def row_of(row):
    """A row without its timings, as text that is the same only for the same bits."""
    return repr({name: value for name, value in row.items() if not name.endswith("_ms")})


class Talk:
    """Messages over one connection, by `send` and `receive` of text or bytes."""

    def __init__(self, send, receive):
        self.send_raw, self.receive_raw = send, receive

    def send(self, **message):
        self.send_raw(json.dumps(message))

    def receive(self):
        """The next message; the bytes of a frame are its ``data``."""
        message = json.loads(self.receive_raw())
        if message["type"] == "frame" and message.get("data") is None and message["bytes"]:
            message["data"] = self.receive_raw()
        return message

    def until(self, kind, **values):
        """The next message of a type with these values; others are passed over."""
        while True:
            message = self.receive()
            if message["type"] == kind and all(message[name] == value for name, value in values.items()):
                return message

    def ask(self, **message):
        """The answer to a message: ``reply``, ``error`` or ``welcome``."""
        self.send(**message)
        while True:
            answer = self.receive()
            if answer["type"] in ("reply", "error", "welcome"):
                return answer

    def command(self, name, **values):
        return self.ask(type="command", name=name, **values)

    def hello(self, *channels, **values):
        """Greet, and subscribe to channels; gives the welcome."""
        welcome = self.ask(type="hello", protocol=1)
        assert welcome["type"] == "welcome"
        if channels:
            assert self.ask(type="subscribe", channels=channels, **values)["type"] == "reply"
        return welcome


@contextlib.contextmanager
def websocket(server, path="ws", **options):
    """A WebSocket to a server."""
    from websockets.sync.client import connect

    url = f"ws://127.0.0.1:{server.port}/{path}"
    with connect(url, max_size=None, compression=None, open_timeout=60, close_timeout=1, **options) as connection:
        yield Talk(connection.send, lambda: connection.recv(timeout=60))


@contextlib.contextmanager
def lines(server):
    """A TCP connection to a server."""
    with (
        socket.create_connection(("127.0.0.1", server.tcp_port), timeout=60) as connection,
        connection.makefile("rb") as file,
    ):

        def send(text):
            connection.sendall((text if isinstance(text, bytes) else text.encode()) + b"\n")

        talk = Talk(send, file.readline)
        talk.socket = connection
        yield talk


def running(scenario, **options):
    """A server on free ports."""
    return serving(scenario, ServerOptions(**({"port": 0, "tcp_port": 0} | options)))
