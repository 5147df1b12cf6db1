"""Checks of the arguments that studies share: the folder of the results, the function for the progress, switches."""

from __future__ import annotations

from typing import Any

from startracker.arguments import file_path, switch
from startracker.errors import InputError


def check_run_options(out: Any, progress: Any, **switches: Any) -> None:
    """Check a folder for results (or None), a function for the progress (or None), and switches.

    Raises
    ------
    InputError
        For an argument of another type.
    """
    if out is not None:
        file_path("out", out)
    if progress is not None and not callable(progress):
        raise InputError(f"progress must be a function of (finished, total); got {progress!r}")
    for name, value in switches.items():
        switch(name, value)
