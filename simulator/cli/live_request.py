"""Options of ``boresight serve``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from simulator.cli.options import ScenarioFile, Seed, SetValues, option, switch

_ACCESS, _PACE, _DISPLAY = "Access", "Pace", "Stimulator"


@dataclass(frozen=True)
class ServeRequest:
    """Serve a live mission: a page in the browser, and frames, attitudes and truth by WebSocket and TCP."""

    scenario: ScenarioFile
    seed: Seed = None
    set_values: SetValues = None
    port: Annotated[int, option("--port", "N", "Port of the page and of the WebSocket; 0: any free one.", _ACCESS)] = (
        8042
    )
    tcp: Annotated[int | None, option("--tcp", "N", "Port of lines of JSON over TCP; default: no TCP.", _ACCESS)] = None
    host: Annotated[
        str, option("--host", "ADDRESS", "Address to bind to; other than a loopback one only with a token.", _ACCESS)
    ] = "127.0.0.1"
    token: Annotated[
        str | None,
        option("--token", "TEXT", "Token that clients must have; default: the variable BORESIGHT_TOKEN.", _ACCESS),
    ] = None
    origins: Annotated[
        list[str] | None,
        typer.Option(
            "--origin",
            metavar="URL",
            help="Origin of another page that may connect, e.g. https://example.org; may be repeated.",
            rich_help_panel=_ACCESS,
        ),
    ] = None
    recordings: Annotated[Path, option("--recordings", "DIR", "Folder for recordings.")] = Path("recordings")
    speed: Annotated[float, option("--speed", "FACTOR", "Factor on real time.", _PACE)] = 1.0
    paused: Annotated[bool, switch("--paused", "Begin paused.", _PACE)] = False
    lockstep: Annotated[
        bool, switch("--lockstep", "Take attitudes from a client, each of which makes one frame.", _PACE)
    ] = False
    stimulator: Annotated[
        Path | None,
        option(
            "--stimulator", "FILE.yaml", "Calibrated display before a real tracker; its page is /stimulator.", _DISPLAY
        ),
    ] = None
    refresh_hz: Annotated[
        float, option("--refresh-hz", "HZ", "Pictures a second for the display: its refresh rate.", _DISPLAY)
    ] = 60.0
