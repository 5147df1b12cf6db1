"""The server of a live mission: frames and solutions on both transports, slow clients, hostile input, its end."""

import asyncio
import signal
import socket
import subprocess
import sys
import threading
import time
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from live_client import lines, running, small, websocket

from simulator.checks import load_scenario
from simulator.cli.application import run_application
from simulator.live.server import LiveServer, ServerOptions, _bound
from simulator.study.sequence.frames import SequenceRunner
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude

pytestmark = pytest.mark.system

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


def test_small_messages_are_sent_at_once():
    """A solution after a frame waited 40 ms, for the acknowledgement of the frame's last packet (Nagle's algorithm)."""

    async def accepted() -> int:
        answer: asyncio.Future[int] = asyncio.get_running_loop().create_future()

        async def answer_one(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            answer.set_result(writer.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        listening = _bound("127.0.0.1", 0)
        async with await asyncio.start_server(answer_one, sock=listening):
            _, writer = await asyncio.open_connection(*listening.getsockname())
            no_delay = await answer
            writer.close()
            await writer.wait_closed()
        return no_delay

    assert asyncio.run(accepted()) != 0


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


# ---------------------------------------------------------------------- beginning and end
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
    with running(small(), lockstep=True) as server:  # from the first frame on, so that the noise is always the same
        camera = example.Camera(server.tcp_port)
        for k in range(3):
            given, _ = example.attitude_at(0.5 * k)
            found = camera.expose(0.5 * k, *example.attitude_at(0.5 * k))
        camera.lines.close()
        camera.socket.close()
    assert found["status"] == "solved"
    assert Attitude(given).ra_deg == pytest.approx(90.0)
    assert Attitude(given).dec_deg == pytest.approx(0.0, abs=1e-9)
    error_rad = Attitude(given).rotation_vector_to(Attitude(found["quaternion"]))
    covariance = np.array(found["covariance_rad2"])
    # a normalised error squared beyond 31.8 is as rare as a Gaussian deviate beyond 5 σ
    assert error_rad @ np.linalg.solve(covariance, error_rad) < 31.8
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
