"""Soak test and latency of `boresight serve`: python -m benchmarks.live --minutes 30

A driver gives attitudes in lockstep at a rate and receives frames (raw, 16 bits) and solutions; a slow client reads one
frame in half a second; a third one connects, reads for a random time, and drops its connection. The server is a process
of its own, whose memory and processor time are those that are stated.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import random
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from socket import SHUT_RDWR
from typing import Any

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from simulator.checks import load_scenario
from simulator.scenario import Scenario
from simulator.study.sequence.frames import SequenceRunner

SMALL = ("detector.width=512", "detector.height=512", "detector.exposure_s=0.01", "tracker.prior=false")
TICKS_S = 100.0
"""Clock ticks of /proc a second."""


def scenario_of(name: str, rate_hz: float) -> Scenario:
    """The scenario, with a detector of 512 × 512 pixels of four times the area and frames at a rate."""
    wide = ("detector.pixel_pitch_um=11", "optics.psf.sigma_px=0.9")
    return load_scenario(name, [*SMALL, *wide, f"sequence.step_s={1.0 / rate_hz!r}", "sequence.frames=2000"])


def serve(scenario: Scenario, port: Any) -> None:
    """The server's process."""
    import asyncio

    from simulator.live.server import LiveServer, ServerOptions

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    server = LiveServer(scenario, ServerOptions(port=0, lockstep=True))
    signal.signal(signal.SIGTERM, lambda *_: server.stop())
    asyncio.run(server.serve(lambda: port.put(server.port)))


class Client(threading.Thread):
    """A client that counts what it receives, and frames out of order."""

    def __init__(self, port: int, ended: threading.Event) -> None:
        super().__init__(daemon=True)
        self.url, self.ended = f"ws://127.0.0.1:{port}/ws", ended
        self.frames = self.missed = self.out_of_order = self.connections = 0
        self.failure = ""

    @contextmanager
    def open(self) -> Iterator[Any]:
        """A connection that has subscribed to frames."""
        with connect(self.url, max_size=None, compression=None, open_timeout=60) as socket:
            self.subscribe(socket)
            yield socket

    def subscribe(self, socket: Any) -> None:
        """Say hello and ask for frames and solutions."""
        socket.send(json.dumps({"type": "hello", "protocol": 1}))
        channels = ["frame", "solution"]
        socket.send(json.dumps({"type": "subscribe", "channels": channels, "frame_format": "raw16"}))
        self.connections, self.last = self.connections + 1, -1

    def count(self, message: dict[str, Any]) -> None:
        """One header of a frame."""
        self.frames, self.missed = self.frames + 1, self.missed + message["missed"]
        self.out_of_order += message["index"] <= self.last
        self.last = message["index"]

    def read_one(self, socket: Any) -> None:
        """The messages up to the next frame's bytes."""
        while not self.ended.is_set():
            received = socket.recv(timeout=30)
            if isinstance(received, bytes):
                return
            message = json.loads(received)
            if message["type"] == "frame":
                self.count(message)

    def run(self) -> None:
        try:
            self.converse()
        except (ConnectionClosed, TimeoutError, OSError) as error:
            if not self.ended.is_set():
                self.failure = repr(error)

    def converse(self) -> None:
        """Until the end."""
        raise NotImplementedError


class Slow(Client):
    """Reads a frame in half a second."""

    def converse(self) -> None:
        with self.open() as socket:
            while not self.ended.wait(0.5):
                self.read_one(socket)


class Vanishing(Client):
    """Reads for a random time, and drops the connection."""

    def converse(self) -> None:
        rng = random.Random(1)
        while not self.ended.is_set():
            with self.open() as socket:
                until_s = time.monotonic() + rng.uniform(0.2, 5.0)
                while time.monotonic() < until_s and not self.ended.is_set():
                    self.read_one(socket)
                socket.socket.shutdown(SHUT_RDWR)  # without saying goodbye
            self.ended.wait(rng.uniform(0.0, 1.0))


class Driver(Client):
    """Gives attitudes at a rate and measures the time until frame and solution."""

    def __init__(self, port: int, ended: threading.Event, states: list[Any], rate_hz: float) -> None:
        super().__init__(port, ended)
        self.states, self.rate_hz = states, rate_hz
        self.frame_ms: list[float] = []
        self.solution_ms: list[float] = []
        self.solved = 0

    def converse(self) -> None:
        with self.open() as socket:
            due_s, k = time.perf_counter(), 0
            while not self.ended.is_set():
                if (wait_s := due_s - time.perf_counter()) > 0.0:
                    time.sleep(wait_s)
                due_s = max(due_s + 1.0 / self.rate_hz, time.perf_counter() - 1.0 / self.rate_hz)
                self.one(socket, k)
                k += 1

    def one(self, socket: Any, k: int) -> None:
        """One attitude; the states repeat to and fro, at ascending times."""
        there_and_back = [*range(len(self.states)), *range(len(self.states) - 2, 0, -1)]
        state = self.states[there_and_back[k % len(there_and_back)]]
        back = k % len(there_and_back) >= len(self.states)
        rate = np.degrees(state.rate_camera_rad_s) * (-1.0 if back else 1.0)
        asked = {"type": "attitude", "t_s": k / self.rate_hz, "quaternion": state.camera.quat.tolist()}
        sent_s = time.perf_counter()
        socket.send(json.dumps(asked | {"rate_deg_s": rate.tolist()}))
        while True:
            received = socket.recv(timeout=60)
            if isinstance(received, bytes):
                self.frame_ms.append((time.perf_counter() - sent_s) * 1e3)
                continue
            message = json.loads(received)
            if message["type"] == "error":
                raise OSError(message["reason"])
            if message["type"] == "frame":
                self.count(message)
            elif message["type"] == "solution":
                self.solution_ms.append((time.perf_counter() - sent_s) * 1e3)
                self.solved += message["status"] == "solved"
                return


def memory_mb(pid: int) -> float:
    """Resident memory of a process."""
    line = next(row for row in Path(f"/proc/{pid}/status").read_text().splitlines() if row.startswith("VmRSS"))
    return int(line.split()[1]) / 1024.0


def processor_s(pid: int) -> float:
    """Processor time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_S


def percentiles(values: list[float]) -> dict[str, float]:
    """Median, 99th percentile and maximum, ms."""
    return {"p50": float(np.median(values)), "p99": float(np.percentile(values, 99)), "max": max(values)}


def soak(scenario: Scenario, minutes: float, rate_hz: float) -> dict[str, Any]:
    """Run all clients for a time, and say what was measured."""
    states = SequenceRunner(scenario).states
    context = multiprocessing.get_context("spawn")
    queue: Any = context.Queue()
    process = context.Process(target=serve, args=(scenario, queue))
    process.start()
    port, ended = queue.get(timeout=300), threading.Event()
    driver, slow, vanishing = Driver(port, ended, states, rate_hz), Slow(port, ended), Vanishing(port, ended)
    clients = {"driver": driver, "slow": slow, "vanishing": vanishing}
    for client in clients.values():
        client.start()
    pid = int(process.pid or 0)
    memory, began_s = [], time.monotonic()
    warm_s = min(60.0, 6.0 * minutes)
    time.sleep(warm_s)
    begun = len(driver.solution_ms), processor_s(pid), time.monotonic()
    while time.monotonic() - began_s < 60.0 * minutes and driver.is_alive():
        memory.append(memory_mb(pid))
        time.sleep(min(10.0, 6.0 * minutes))
    made, used_s, lasted_s = (
        len(driver.solution_ms) - begun[0],
        processor_s(pid) - begun[1],
        time.monotonic() - begun[2],
    )
    ended.set()
    for client in clients.values():
        client.join(40)
    process.terminate()
    process.join(30)
    tenth = max(1, len(memory) // 10)
    return {
        "minutes": (time.monotonic() - began_s) / 60.0,
        "rate_hz": made / lasted_s,
        "processor_ms_per_frame": 1e3 * used_s / made,
        "frame_latency_ms": percentiles(driver.frame_ms[begun[0] :]),
        "attitude_latency_ms": percentiles(driver.solution_ms[begun[0] :]),
        "solved": driver.solved / max(len(driver.solution_ms), 1),
        "memory_mb": {
            "after_warm_up": float(np.mean(memory[:tenth])),
            "end": float(np.mean(memory[-tenth:])),
            "max": max(memory),
        },
        "clients": {
            name: {n: getattr(c, n) for n in ("frames", "missed", "out_of_order", "connections", "failure")}
            for name, c in clients.items()
        },
        "exit_code": process.exitcode,
    }


def main() -> int:
    """Print the result as JSON; exit status 1 for frames out of order or a client that failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="cubesat_ideal")
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--rate", type=float, default=50.0, help="frames per second")
    given = parser.parse_args()
    result = soak(scenario_of(given.scenario, given.rate), given.minutes, given.rate)
    print(json.dumps(result, indent=1))
    bad = any(c["out_of_order"] or c["failure"] for c in result["clients"].values())
    return int(bad or result["exit_code"] != 0)


if __name__ == "__main__":
    sys.exit(main())
