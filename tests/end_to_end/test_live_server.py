"""The server of a live mission: frames and solutions on both transports, slow clients, hostile input, its end."""

import json
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from live_client import lines, running, small, websocket
from websockets.exceptions import ConnectionClosed, InvalidStatus

from simulator.checks import load_scenario
from simulator.cli.application import run_application
from simulator.live import session
from simulator.live.protocol import LARGEST_MESSAGE_BYTES
from simulator.live.security import Access, TokenBucket
from simulator.live.server import LiveServer, ServerOptions
from simulator.study.sequence.frames import SequenceRunner
from startracker.errors import InputError

CLIENT = Path(__file__).parents[2] / "examples/live/client.py"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A paused server, of which each test makes the frames that it needs."""
    with running(small("sequence.step_s=0.2"), paused=True, recordings=tmp_path_factory.mktemp("recordings")) as one:
        yield one


@pytest.fixture
def talk(server):
    with websocket(server) as one:
        one.hello()
        yield one
        one.command("source", attitude="scenario")


def subscribe(talk, *channels, **values):
    assert talk.ask(type="subscribe", channels=channels, **values)["type"] == "reply"


def test_attitudes_are_those_of_a_sequence_bit_for_bit():
    scenario = small("sequence.step_s=0.05")
    expected = list(SequenceRunner(scenario).frames())
    with running(scenario, paused=True) as server, websocket(server) as talk:
        talk.hello("frame", "solution", "truth", frame_format="raw16")
        for tracked in expected:  # stepped, so that a slow machine misses none
            talk.send(type="command", name="step")
            frame, solution, truth = (talk.until(kind) for kind in ("frame", "solution", "truth"))
            assert frame["index"] == tracked.row["index"]
            image = np.frombuffer(frame["data"], "<u2").reshape(frame["height"], frame["width"])
            np.testing.assert_array_equal(image, tracked.frame.image)
            assert solution["quaternion"] == [tracked.row[f"q{axis}"] for axis in "xyzw"]
            assert truth["quaternion"] == [tracked.row[f"true_q{axis}"] for axis in "xyzw"]
            assert "quaternion" not in frame
            assert (solution["status"], solution["reason"]) == (tracked.row["status"], tracked.row["reason"])


def test_welcome_says_what_there_is(talk):
    welcome = talk.ask(type="hello", protocol=1)
    assert welcome["scenario"] == "cubesat_ideal"
    assert welcome["start"].startswith("2026-03-21T12:00:00")
    assert (welcome["camera"]["width"], welcome["camera"]["height"]) == (256, 256)
    assert welcome["camera"]["saturation_dn"] == 4095
    for parameter in welcome["parameters"]:
        assert parameter["minimum"] <= parameter["value"] <= parameter["maximum"]
        assert not parameter["logarithmic"] or parameter["minimum"] > 0
    assert {"detector.exposure_s", "optics.aperture_mm", "pointing.rate_deg_s.roll"} <= {
        p["path"] for p in welcome["parameters"]
    }


def test_a_step_makes_one_frame_in_each_format(talk):
    for form, begin in (("png", b"\x89PNG"), ("fits", b"SIMPLE"), ("raw16", b"")):
        subscribe(talk, "frame", frame_format=form)
        talk.send(type="command", name="step")
        frame = talk.until("frame")
        assert len(frame["data"]) == frame["bytes"]
        assert frame["data"].startswith(begin)
        assert frame["format"] == form
    subscribe(talk, "frame", frame_format="none")
    talk.send(type="command", name="step")
    assert talk.until("frame")["bytes"] == 0


def test_a_fits_frame_does_not_contain_the_truth(talk):
    subscribe(talk, "frame", frame_format="fits")
    talk.send(type="command", name="step")
    data = talk.until("frame")["data"]
    assert b"HIERARCH" in data
    assert b"CRVAL1" not in data  # the world coordinates are those of the true attitude
    assert b"TRUTH" not in data


def test_lines_over_tcp_are_the_same_messages(server):
    with lines(server) as talk:
        talk.hello("frame", "solution", frame_format="raw16")
        talk.send(type="command", name="step")
        frame, solution = talk.until("frame"), talk.until("solution")
        import base64

        assert len(base64.b64decode(frame["data"])) == frame["bytes"] == 256 * 256 * 2
        assert solution["index"] == frame["index"]


def test_a_slider_changes_the_frame_and_the_state(talk):
    subscribe(talk, "frame", "state", frame_format="none")
    for exposure_s in (0.05, 0.1):
        assert talk.ask(type="set", path="detector.exposure_s", value=exposure_s, id=7) == {
            "type": "reply",
            "id": 7,
            "ok": True,
            "detail": "",
        }
        talk.send(type="command", name="step")
        assert talk.until("frame")["exposure_s"] == exposure_s
        while talk.until("state")["parameters"]["detector.exposure_s"] != exposure_s:
            pass
    refused = talk.ask(type="set", path="detector.exposure_s", value=1e9, id="x")
    assert (refused["type"], refused["code"], refused["id"]) == ("error", "invalid", "x")
    assert "is outside" in refused["reason"]


def test_values_that_come_faster_than_the_camera_is_built_replace_each_other(talk, server):
    for k in range(50):
        talk.send(type="set", path="optics.aperture_mm", value=6.0 + 0.02 * k, id=k)
    replies = [talk.until("reply")["id"] for _ in range(50)]
    assert replies == list(range(50))
    assert server.mission.values()["optics.aperture_mm"] == pytest.approx(6.98)


def test_a_blinded_camera_gives_no_frames(talk):
    subscribe(talk, "frame", "solution", "truth", frame_format="none")
    talk.command("blind")
    talk.send(type="command", name="step")
    solution, truth = talk.until("solution"), talk.until("truth")
    assert (solution["status"], truth["blinded"]) == ("no_frame", True)
    talk.command("unblind")
    talk.send(type="command", name="step")
    assert talk.until("frame")["index"] == solution["index"] + 1
    refused = talk.command("blind", head="one")
    assert refused["type"] == "error"


def test_in_lockstep_each_attitude_makes_one_frame(talk, server):
    talk.command("source", attitude="external", lockstep=True)
    talk.command("resume")
    subscribe(talk, "solution")
    quaternion = server.mission.start.camera.quat.tolist()
    for k in range(3):
        talk.send(type="attitude", t_s=100.0 + 0.1 * k, quaternion=quaternion, id=k)
        solution = talk.until("solution")
        assert solution["t_s"] == 100.0 + 0.1 * k
        assert solution["latency_ms"] > 0.0
        assert talk.until("reply")["id"] == k
    for t_s in (100.2, 3.0):  # time goes backwards
        refused = talk.ask(type="attitude", t_s=t_s, quaternion=quaternion, id="back")
        assert (refused["code"], refused["id"]) == ("state", "back")
        assert "is not after 100.2 s" in refused["reason"]
    refused = talk.ask(type="attitude", t_s=1e9, quaternion=quaternion)
    assert refused["code"] == "failed"  # beyond the ephemeris
    assert talk.ask(type="attitude", time="2026-03-21T12:01:41Z", quaternion=quaternion, id=1)["type"] == "reply"
    talk.command("pause")
    assert "paused" in talk.ask(type="attitude", t_s=200.0, quaternion=quaternion)["reason"]


def test_the_newest_attitude_is_used_and_time_does_not_go_back(talk, server):
    subscribe(talk, "truth")
    talk.command("source", attitude="external")
    quaternion = server.mission.start.camera.quat.tolist()
    assert talk.ask(type="attitude", t_s=50.0, quaternion=quaternion, id=1)["type"] == "reply"
    assert "is not after 50 s" in talk.ask(type="attitude", t_s=49.0, quaternion=quaternion)["reason"]
    talk.send(type="command", name="step")
    truth = talk.until("truth")
    assert truth["t_s"] == 50.0
    np.testing.assert_allclose(truth["quaternion"], quaternion, atol=1e-15)


def test_an_attitude_needs_the_external_source_and_one_time(talk):
    unit = [0.0, 0.0, 0.0, 1.0]
    assert "source is the scenario" in talk.ask(type="attitude", t_s=1.0, quaternion=unit)["reason"]
    talk.command("source", attitude="external")
    assert "either t_s or time" in talk.ask(type="attitude", quaternion=unit)["reason"]
    assert "time:" in talk.ask(type="attitude", time="yesterday", quaternion=unit)["reason"]


def test_commands_that_are_not_possible_now_are_refused(talk):
    for name, values in (
        ("stop_recording", {}),
        ("seek", {"t_s": -5.0}),
        ("source", {"attitude": "scenario", "lockstep": True}),
    ):
        refused = talk.command(name, **values)
        assert refused["type"] == "error"
        assert refused["reason"]
    talk.command("resume")
    assert talk.command("step")["code"] == "state"
    talk.command("pause")


def test_a_slow_client_gets_the_newest_frame_and_the_loop_goes_on():
    with running(small("sequence.step_s=0.02")) as server, websocket(server, max_queue=1) as slow:
        with websocket(server) as quick:
            quick.hello("solution")
            slow.hello("frame", frame_format="raw16")
            begun = quick.until("solution")["index"]
            while quick.until("solution")["index"] < begun + 60:  # 60 frames of 128 KiB: more than sockets hold
                pass
        seen, missed = [], 0
        while not missed:
            frame = slow.until("frame")
            seen.append(frame["index"])
            missed = frame["missed"]
        assert seen == sorted(set(seen))
        assert seen[-1] - seen[-2] == missed + 1


def test_every_nth_frame_is_not_a_missed_one(server):
    with websocket(server) as talk:
        talk.hello("solution", every=3)
        for _ in range(7):
            talk.command("step")
        while server.mission.index % 3:
            talk.command("step")
            time.sleep(0.02)
        solution = talk.until("solution")
        assert solution["index"] % 3 == 0


# ---------------------------------------------------------------------- hostile input
def repeat(times, call):
    for _ in range(times):
        call()


def still_serves(server):
    with websocket(server) as talk:
        talk.hello("solution")
        talk.send(type="command", name="step")
        talk.until("solution")


HOSTILE = [
    '{"type":"attitude","t_s":1,"quaternion":[NaN,0,0,1]}',
    '{"type":"attitude","t_s":Infinity,"quaternion":[0,0,0,1]}',
    "[" * 5000,
    "null",
    '"hello"',
    '{"type":"set","path":"__class__","value":1}',
    '{"type":"command","name":"record","folder":"../../etc"}',
    "\u0000\u0001\u0002",
]


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_messages_are_refused_with_a_reason(server, talk, text):
    talk.send_raw(text)
    answer = talk.until("error")
    assert answer["code"] in ("malformed", "invalid")
    assert answer["reason"]
    still_serves(server)


def test_binary_messages_are_refused(server, talk):
    talk.send_raw(bytes(range(256)))
    assert "not binary" in talk.until("error")["reason"]
    still_serves(server)


def test_a_huge_message_ends_its_connection(server, talk):
    with websocket(server) as other:
        other.hello()
        other.send_raw("x" * (LARGEST_MESSAGE_BYTES + 1))
        with pytest.raises(ConnectionClosed) as closed:
            other.until("reply")
        assert closed.value.rcvd.code == 1009  # message too big
    still_serves(server)


def test_a_flood_ends_its_connection(server, monkeypatch):
    monkeypatch.setattr(session, "BURST", 20.0)
    monkeypatch.setattr(session, "MESSAGES_PER_S", 1.0)
    with websocket(server) as talk:
        talk.hello()
        with pytest.raises(ConnectionClosed) as closed:
            repeat(200, lambda: talk.command("unblind"))
        assert closed.value.rcvd.code == 1008
        assert "messages a second" in closed.value.rcvd.reason
    monkeypatch.undo()
    still_serves(server)


def test_a_client_that_only_sends_nonsense_is_disconnected(server):
    with websocket(server) as talk:
        talk.hello()
        with pytest.raises(ConnectionClosed):
            repeat(2 * session.MOST_REFUSED, lambda: (talk.send_raw("nonsense"), talk.until("error")))
    still_serves(server)


@pytest.mark.parametrize("first", ["GET / HTTP/1.1", '{"type":"command","name":"pause"}', "", b"\xff\xfe\x00"])
def test_tcp_needs_a_hello_first(server, first):
    with lines(server) as talk:
        talk.send_raw(first if first else "{}")
        answer = talk.receive()
        assert answer["type"] == "error"
        assert answer["code"] in ("malformed", "invalid", "hello_first")
        assert not talk.receive_raw()  # closed
    still_serves(server)


def test_half_lines_and_long_lines_over_tcp(server):
    with lines(server) as talk:
        talk.hello()
        talk.socket.sendall(b'{"type":"command","na')
        talk.socket.sendall(b'me":"unblind","id":5}\n')
        assert talk.until("reply")["id"] == 5
        talk.socket.sendall(b'{"type":"half')
    with lines(server) as talk:
        talk.hello()
        talk.socket.sendall(b"x" * (LARGEST_MESSAGE_BYTES + 100))
        assert talk.until("error")["code"] == "malformed"
    still_serves(server)


def test_connections_that_are_dropped_are_forgotten(server):
    for _ in range(3):
        with lines(server) as talk:
            talk.hello("frame", frame_format="raw16")
            talk.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")  # reset
    deadline = time.monotonic() + 20.0
    while server.loop.hub.subscribers and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not server.loop.hub.subscribers
    still_serves(server)


def test_there_are_not_too_many_clients(server, monkeypatch):
    monkeypatch.setattr(session, "MOST_CLIENTS", 1)
    with websocket(server) as first:
        first.hello()
        with websocket(server) as second:
            assert second.ask(type="hello", protocol=1)["code"] == "busy"


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1.evil.example", "file://"])
def test_pages_of_other_origins_may_not_connect(server, origin):
    with pytest.raises(InvalidStatus) as refused, websocket(server, origin=origin):
        pass
    assert refused.value.response.status_code == 403
    assert b"--origin" in refused.value.response.body
    still_serves(server)


def test_the_own_page_may_connect(server):
    with websocket(server, origin=server.url.rstrip("/")) as talk:
        talk.hello()


def test_a_name_that_was_redirected_to_this_machine_is_refused(server):
    request = urllib.request.Request(server.url, headers={"Host": "evil.example"})
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(request, timeout=30)
    assert refused.value.code == 403
    refused.value.close()


def test_health_and_headers(server):
    with urllib.request.urlopen(f"{server.url}healthz", timeout=30) as answer:
        assert json.loads(answer.read())["ok"]
        assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]


def test_files_outside_the_page_are_not_served(server):
    for path in ("static/../server.py", "static/%2e%2e/server.py", "static/..%2fserver.py", "server.py"):
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(server.url + path, timeout=30)
        assert refused.value.code == 404
        refused.value.close()


def test_a_token_is_needed_on_both_transports():
    with running(small(), paused=True, token="secret", origins=("https://bench.example",)) as server:
        for connection in (websocket, lines):
            with connection(server) as talk:
                assert talk.ask(type="hello", protocol=1)["code"] == "token"
            with connection(server) as talk:
                assert talk.ask(type="hello", protocol=1, token="wrong")["code"] == "token"
            with connection(server) as talk:
                assert talk.ask(type="hello", protocol=1, token="secret")["type"] == "welcome"
        with websocket(server, "ws?token=secret", origin="https://bench.example") as talk:
            assert talk.ask(type="hello", protocol=1)["type"] == "welcome"


# ---------------------------------------------------------------------- beginning and end
def test_other_addresses_need_a_token():
    with pytest.raises(InputError, match="give a --token or BORESIGHT_TOKEN"):
        LiveServer(small(), ServerOptions(host="0.0.0.0", port=0))
    with pytest.raises(InputError, match=r"must look like https://example\.org"):
        Access("127.0.0.1", origins=("example.org",))
    for host in ("127.0.0.1", "localhost", "::1", "127.8.8.8"):
        assert Access(host).loopback
    assert not Access("192.168.1.4", "x").loopback


def test_a_bucket_refuses_what_is_beyond_its_rate(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    bucket = TokenBucket(10.0, 3.0)
    assert [bucket.take() for _ in range(4)] == [True, True, True, False]
    now[0] = 0.2
    assert [bucket.take() for _ in range(3)] == [True, True, False]


def test_a_port_in_use_is_one_clear_line(capsys):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert run_application(["serve", "cubesat", "--port", str(port)]) == 2
        assert f"127.0.0.1:{port}: Address already in use" in capsys.readouterr().err
        assert run_application(["serve", "cubesat", "--port", "0", "--tcp", str(port)]) == 2
    assert run_application(["serve", "two_heads", "--port", "0"]) == 2
    assert "one camera" in capsys.readouterr().err
    assert run_application(["serve", "cubesat", "--speed", "0"]) == 2
    assert "--speed" in capsys.readouterr().err


def test_the_extra_that_is_not_installed_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(InputError, match=r"needs uvicorn: pip install 'boresight\[live\]'"):
        LiveServer(small(), ServerOptions(port=0))


def test_importing_the_protocol_does_not_import_the_server_s_packages():
    heavy = "('starlette', 'uvicorn', 'websockets')"
    code = f"import simulator.live.server, sys; sys.exit(any(name in sys.modules for name in {heavy}))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_end_of_the_server_writes_the_recording(tmp_path):
    scenario = small("sequence.step_s=0.05")
    with running(scenario, recordings=tmp_path, speed=1000.0) as server, websocket(server) as talk:
        talk.hello("solution")
        assert talk.command("record", folder="mine")["detail"] == str(tmp_path / "mine")
        assert talk.command("record")["code"] == "state"
        for _ in range(4):
            talk.until("solution")
    recorded = load_scenario(tmp_path / "mine/scenario.yaml")
    assert recorded.sequence.frames >= 3
    assert next(SequenceRunner(recorded).frames()).row["status"] == "solved"


def test_ctrl_c_ends_the_command(tmp_path):
    small_camera = [word for text in ("detector.width=128", "detector.height=128") for word in ("--set", text)]
    process = subprocess.Popen(
        [sys.executable, "-m", "simulator.cli", "serve", "cubesat_ideal", "--port", "0", "--tcp", "0", *small_camera],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )
    assert process.stdout is not None
    assert "http://127.0.0.1:" in process.stdout.readline()
    assert "lines of JSON: 127.0.0.1:" in process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")


def test_the_example_client_gets_attitudes():
    spec = spec_from_file_location("live_example", CLIENT)
    example = module_from_spec(spec)
    spec.loader.exec_module(example)
    with running(small(), paused=False) as server:
        camera = example.Camera(server.tcp_port)
        for k in range(3):
            found = camera.expose(0.5 * k, *example.attitude_at(0.5 * k))
        camera.lines.close()
        camera.socket.close()
    assert found["status"] == "solved"
    assert found["ra_deg"] == pytest.approx(90.0, abs=0.02)  # a few arcseconds, 2 pixels at most
    assert found["dec_deg"] == pytest.approx(0.0, abs=0.02)
    assert found["rate_deg_s"][2] == pytest.approx(0.05, abs=0.02)
    assert len(CLIENT.read_text().splitlines()) <= 50


def test_the_event_loop_answers_while_a_frame_is_made(server):
    answered = threading.Event()

    def slow_frame():
        answered.wait(30)

    making = server.loop._worker.submit(slow_frame)
    with websocket(server) as talk:
        talk.hello()
        assert talk.command("unblind")["type"] == "reply"
        assert not making.done()
    answered.set()
    making.result(30)
