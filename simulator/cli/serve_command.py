"""``boresight serve``: a live mission until Ctrl-C."""

from __future__ import annotations

import asyncio
import os
import signal
import threading

from simulator.checks import load_scenario
from simulator.cli.live_request import ServeRequest
from simulator.live.server import LiveServer, ServerOptions
from simulator.live.stimulator import read_stimulator
from startracker.errors import InputError


def main(request: ServeRequest) -> int:
    """Serve until Ctrl-C or SIGTERM; exit status 0."""
    if not 0.001 <= request.speed <= 1000.0:
        raise InputError(f"--speed: must be from 0.001 to 1000, not {request.speed:g}")
    if not 1.0 <= request.refresh_hz <= 500.0:
        raise InputError(f"--refresh-hz: must be from 1 to 500, not {request.refresh_hz:g}")
    for option, port in (("--port", request.port), ("--tcp", request.tcp)):
        if port is not None and not 0 <= port <= 65535:
            raise InputError(f"{option}: must be from 0 to 65535, not {port}")
    scenario = load_scenario(request.scenario, request.set_values or (), seed=request.seed)
    options = ServerOptions(
        host=request.host,
        port=request.port,
        tcp_port=request.tcp,
        token=request.token or os.environ.get("BORESIGHT_TOKEN", ""),
        origins=tuple(request.origins or ()),
        recordings=request.recordings,
        speed=request.speed,
        paused=request.paused,
        lockstep=request.lockstep,
        stimulator=None if request.stimulator is None else read_stimulator(request.stimulator),
        refresh_hz=request.refresh_hz,
    )
    server = LiveServer(scenario, options)
    _stop_on_signals(server)
    asyncio.run(server.serve(lambda: _announce(server)))
    return 0


def _announce(server: LiveServer) -> None:
    lines = [f"{server.mission.scenario.name}: {server.url}  (Ctrl-C ends)"]
    if server.tcp_port is not None:
        lines.append(f"lines of JSON: {server.options.host}:{server.tcp_port}")
    print("\n".join(lines), flush=True)


def _stop_on_signals(server: LiveServer) -> None:
    """Ctrl-C and SIGTERM end the server; a second one interrupts at once."""
    if threading.current_thread() is not threading.main_thread():
        return

    def ask(number: int, _: object) -> None:
        signal.signal(number, signal.default_int_handler)
        server.stop()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, ask)
