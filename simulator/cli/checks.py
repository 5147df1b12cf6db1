"""What several commands check before they begin: the numbers they were given, and the files to write to."""

from __future__ import annotations

import os
from datetime import datetime
from pathlib import Path

from startracker.errors import InputError


def at_least(least: int, **options: int | None) -> None:
    """Raise `InputError` for the first option, by its name, whose number is below `least`; None was not given."""
    for name, value in options.items():
        if value is not None and value < least:
            limit = "0 or more" if least == 0 else f"at least {least}"
            raise InputError(f"--{name}: must be {limit}, not {value}")


def available_cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def processes(workers: int | None, dask: str | None, trials: int) -> int:
    """Processes to run so many trials: `workers`, or as many of this machine's cores as are worth one of their own.

    Starting a process costs as much as 100 trials.

    Raises
    ------
    InputError
        For fewer than one, or for workers beside a cluster.
    """
    at_least(1, workers=workers)
    if workers is not None and dask is not None:
        raise InputError("--workers and --dask: give one of the two; a cluster has its own workers")
    cores = available_cores()
    return workers or max(1, min(cores, trials // 100))


def utc_time(option: str, text: str) -> datetime:
    """Date and time of an option, UTC.

    Raises
    ------
    InputError
        For text that is not an ISO 8601 time, or a time that does not exist.
    """
    from simulator.scenario.fields import parse_utc

    try:
        return parse_utc(text)
    except ValueError as error:
        why = f": {error}" if str(error) else " is not an ISO 8601 time such as 2026-03-21T12:00:00Z"
        raise InputError(f"{option}: '{text}'{why}") from None


def picture_format(path: Path | None) -> str:
    """Format of a picture to be written, from its suffix, "png" for no picture.

    Raises
    ------
    InputError
        Where it cannot be written, or its suffix is not a format.
    """
    from startracker.images.picture import FORMATS

    writable(path)
    form = "png" if path is None else path.suffix.lower().removeprefix(".")
    if form not in FORMATS:
        known = f"{', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
        raise InputError(f"{path}: the suffix of a picture must be {known}")
    return form


def writable(path: Path | None) -> None:
    """Raise `InputError` where a file cannot be written, before any work is done for it."""
    if path is None:
        return
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: its folder {path.parent} does not exist; create it, or choose another")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: its folder {path.parent} cannot be written to; choose another")
