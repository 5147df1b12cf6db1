"""Reading of files: those that users name, up to a limit of size, with errors of one line; and included tables."""

from __future__ import annotations

import os
import stat
from importlib.resources import files
from pathlib import Path
from typing import Any, BinaryIO

from startracker.errors import InputError

MEGABYTE = 1_000_000
MESSAGE_BYTES = 200 * MEGABYTE
"""Largest message or table over time: a million states of an orbit."""
CURVE_BYTES = 10 * MEGABYTE
"""Largest curve or spectrum: some 100,000 lines."""
SETTINGS_BYTES = MEGABYTE
"""Largest file of settings (camera, pattern, stimulator), as for a scenario."""
LIST_BYTES = 50 * MEGABYTE
"""Largest list of centroids: a million lines."""
RESULT_BYTES = 200 * MEGABYTE
"""Largest summary of a study."""
IMAGE_BYTES = 2_000 * MEGABYTE
"""Largest image file."""
KERNEL_BYTES = 2_000 * MEGABYTE
"""Largest kernel of SPICE."""


def check_file(path: str | Path, most_bytes: int, hint: str) -> os.stat_result:
    """State of a regular file of at most `most_bytes`.

    Parameters
    ----------
    path : str or Path
        The file.
    most_bytes : int
        Largest size.
    hint : str
        End of the message: what to give instead.

    Returns
    -------
    os.stat_result
        The file's state.

    Raises
    ------
    InputError
        If the file is missing, is a device, a pipe or another thing that has no end of its own, or is larger.
    """
    try:
        state = os.stat(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); {hint}") from error
    except ValueError as error:  # a null character in the name
        raise InputError(f"{str(path)!r}: is not a file name; {hint}") from error
    if stat.S_ISDIR(state.st_mode):
        raise InputError(f"{path}: cannot be read (is a folder); {hint}")
    if not stat.S_ISREG(state.st_mode):
        raise InputError(f"{path}: is not a regular file (a device or a pipe); {hint}")
    if state.st_size > most_bytes:
        raise InputError(_too_large(path, f"has {state.st_size / MEGABYTE:,.1f} MB", most_bytes, hint))
    return state


def read_bytes(path: str | Path, most_bytes: int, hint: str) -> bytes:
    """Content of a regular file of at most `most_bytes`; parameters and errors as for `check_file`."""
    check_file(path, most_bytes, hint)
    try:
        with open(path, "rb") as stream:
            return read_stream(stream, most_bytes, str(path), hint)  # a file may grow, and those of /proc state no size
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); {hint}") from error


def included_lines(package: str, name: str) -> list[str]:
    """Lines of a text file in the folder ``data`` of a package, without empty lines and comments (``#``)."""
    text = (files(package) / "data" / name).read_text(encoding="utf-8")
    return [line for line in text.splitlines() if line and not line.startswith("#")]


def read_stream(stream: BinaryIO, most_bytes: int, name: str, hint: str) -> bytes:
    """Content of a stream of at most `most_bytes`; for more, `InputError` with a message that begins with `name`."""
    # One byte more than allowed shows that there is more.
    data = stream.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise InputError(_too_large(name, "is larger", most_bytes, hint))
    return data


def read_text(path: str | Path, most_bytes: int, hint: str) -> str:
    """Text of a UTF-8 file, with or without a byte-order mark.

    Parameters and errors as for `check_file`; also `InputError` if the file is not text.
    """
    return as_text(read_bytes(path, most_bytes, hint), path, hint)


def as_text(data: bytes, path: str | Path, hint: str) -> str:
    """Decode the content of a UTF-8 file, with or without a byte-order mark; `InputError` if it is not text."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text; {hint}") from error


def read_yaml(path: str | Path, hint: str) -> Any:
    """Plain values of a YAML file of settings.

    Errors as for `check_file`; also `InputError` for content that is not YAML or is nested too deeply.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    data = read_bytes(path, SETTINGS_BYTES, hint)
    try:
        return YAML(typ="safe").load(data.decode("utf-8-sig"))
    except (YAMLError, ValueError) as error:  # ValueError: not text, or a date such as 2026-02-30
        raise InputError(f"{path}: is not YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise InputError(f"{path}: is nested too deeply; {hint}") from error


def _too_large(path: str | Path, what: str, most_bytes: int, hint: str) -> str:
    return f"{path}: {what}, more than the {most_bytes / MEGABYTE:,.0f} MB that are read; {hint}"
