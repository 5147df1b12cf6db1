"""Other simulators: attitudes in lockstep over the wire give the answers of the mission in process; the C client."""

import asyncio
import re
import runpy
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from simulator.live.hub import Subscriber
from simulator.live.loop import MissionLoop
from simulator.live.mission import LiveMission
from simulator.live.motion import Given
from simulator.live.protocol import Subscribe
from simulator.live.server import ServerOptions, serving
from simulator.scenario import Scenario
from startracker import Attitude

pytestmark = pytest.mark.system

EXAMPLES = Path(__file__).parents[2] / "examples" / "live"
Camera = runpy.run_path(str(EXAMPLES / "client.py"))["Camera"]
SCENARIO = Scenario.load(EXAMPLES / "hold.yaml")
FRAMES, RATE_DEG_S = 6, (0.02, -0.05, 0.1)


@pytest.fixture(scope="module")
def server():
    with serving(SCENARIO, ServerOptions(port=0, tcp_port=0, lockstep=True)) as running:
        yield running


def attitudes():
    """A camera that turns at a constant rate away from the Earth: times and quaternions."""
    start = Attitude.from_radec_roll(95.0, 10.0, 30.0)
    for k in range(FRAMES):
        turn = Attitude.from_rotation_vector(np.radians(RATE_DEG_S) * 0.7 * k, "camera", "camera")
        yield 0.7 * k, (turn @ start).quat.tolist()


def test_answers_over_the_wire_are_those_in_process_bit_for_bit(server):
    mission, answers = LiveMission(SCENARIO), []
    mission.use_source(external=True)
    for t_s, quaternion in attitudes():
        live = mission.step(Given(t_s, tuple(quaternion), RATE_DEG_S), lockstep=True)
        session = mission.camera.session
        answers.append((live.tracked.row["status"], session.filter_attitude.quat, session.covariance[:3, :3]))

    camera = Camera(server.tcp_port)
    try:
        assert camera.welcome["step_s"] == SCENARIO.sequence.step_s
        for (t_s, quaternion), (status, quat, covariance) in zip(attitudes(), answers, strict=True):
            solution = camera.expose(t_s, quaternion, RATE_DEG_S)
            assert (solution["t_s"], solution["status"]) == (t_s, status) == (t_s, "solved")
            assert solution["quaternion"] == quat.tolist()
            assert solution["covariance_rad2"] == covariance.tolist()
    finally:
        camera.lines.close()
        camera.socket.close()


def test_no_frame_of_the_scenario_follows_a_change_of_the_source(monkeypatch):
    """While the change waits for the worker, a frame of the running mission falls due; it must not be made after the
    change, where it would be at the time of the first attitude."""
    change = MissionLoop._change_source

    def slowly(loop, external):
        time.sleep(3.0 * SCENARIO.sequence.step_s)
        change(loop, external)

    monkeypatch.setattr(MissionLoop, "_change_source", slowly)
    with serving(SCENARIO, ServerOptions(port=0, tcp_port=0)) as running:
        camera = Camera(running.tcp_port)
        try:
            (t_s, quaternion), *_ = attitudes()
            solution = camera.expose(t_s, quaternion, RATE_DEG_S)
        finally:
            camera.lines.close()
            camera.socket.close()
    found = Attitude(np.array(solution["quaternion"]))
    assert np.degrees(found.angle_to(Attitude(np.array(quaternion)))) < 0.01


def test_no_frame_of_the_former_source_is_sent_after_the_reply():
    """Replies are sent before frames; one of the scenario that a client has not received would follow the reply, with
    the time of the client's own first frame."""

    async def outbox():
        loop, subscriber = MissionLoop(LiveMission(SCENARIO), Path()), Subscriber()
        subscriber.wants = Subscribe(type="subscribe", channels=("solution",))
        loop.hub.subscribers.add(subscriber)
        await loop._make(await loop._next_turn())
        await loop.use_source(external=True, lockstep=True)
        await loop.close()
        return subscriber.rest()

    assert asyncio.run(outbox()) == []


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_the_client_in_c(server, tmp_path):
    """Compiled without a warning, from another folder; its errors are those of the camera: 30″ is four σ of the roll of
    one frame, and a wrong sign or order of the quaternion gives degrees."""
    program = tmp_path / "client"
    strict = ["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
    subprocess.run(["cc", *strict, "-o", program, EXAMPLES / "client.c", "-lm"], check=True)
    # a new server: its times begin anew
    with serving(SCENARIO, ServerOptions(port=0, tcp_port=0)) as own:
        known = ["127.0.0.1", str(own.tcp_port), str(FRAMES)]
        done = subprocess.run([program, *known], capture_output=True, text=True, timeout=120, check=True)
    errors = [float(error) for error in re.findall(r"error +([0-9.]+) arcsec", done.stdout)]
    assert len(errors) == len(done.stdout.splitlines()) == FRAMES
    assert max(errors) < 30.0
    assert min(errors) > 0.0
    refused = subprocess.run([program, "127.0.0.1", "1", "3"], capture_output=True, text=True, check=False)
    assert refused.returncode == 1
    assert "cannot connect" in refused.stderr
    assert "usage" in subprocess.run([program], capture_output=True, text=True, check=False).stderr
