"""What ``boresight`` alone prints: what to try first."""

from __future__ import annotations

import textwrap

from simulator.scenario.files import included_scenarios
from startracker._version import __version__

_TRY = (
    ("boresight run cubesat --trials 100", "accuracy of a star tracker in orbit: out/cubesat/report.html"),
    ("boresight render moon --preview moon.png", "one frame of a scenario as a picture"),
    (
        "boresight solve sample --annotate solved.png",
        "direction of a photograph; also of your own JPEG, TIFF, FITS",
    ),
    ("boresight show cubesat > my.yaml", "a scenario to edit: every key with unit and default"),
    ("boresight sweep cubesat --over optics.aperture_mm=6:24:7", "accuracy as a function of any key"),
)


def welcome_text() -> str:
    """First commands with what they do, the included scenarios, and where to read on."""
    names = [name for name in included_scenarios() if "/" not in name]
    gallery = [name.partition("/")[2] for name in included_scenarios() if "/" in name]
    wide = max(len(command) for command, _ in _TRY)
    lines = [
        f"boresight {__version__}: simulator of a star camera in orbit, and the star tracker that solves its frames.",
        "",
        "Try first:",
        *(f"  {command:<{wide}}  {what}" for command, what in _TRY),
        "",
        *_wrapped(f"Scenarios: {', '.join(name for name in names if name not in gallery)}"),
        *_wrapped(f"Gallery, one effect each: {', '.join(gallery)}"),
        "",
        "boresight --help lists the commands, boresight run --help the options of a command.",
        "boresight --install-completion enables Tab completion of commands, options, scenarios and keys.",
    ]
    return "\n".join(lines)


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 100, subsequent_indent="  ", break_on_hyphens=False)
