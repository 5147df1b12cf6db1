"""Files of finished trials with a checksum in their names."""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

from simulator.paths import make_folder, write_atomically

CHECKSUM_DIGITS = 16
"""Number of hexadecimal digits of the SHA-256 in a file name."""
DAMAGED_FOLDER = ".trials-damaged"
"""Subfolder of the results to which damaged files are moved."""


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's contents, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_checked(folder: Path, stem: str, data: bytes, *, durable: bool = True) -> Path:
    """Write ``STEM-CHECKSUM.parquet`` atomically.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    path = folder / f"{stem}-{hashlib.sha256(data).hexdigest()[:CHECKSUM_DIGITS]}.parquet"
    write_atomically(path, data, durable=durable)
    return path


def fault_of(path: Path, checksum: str | None = None) -> str:
    """Fault of a file; empty if it is intact.

    Parameters
    ----------
    path : Path
        The file.
    checksum : str, optional
        First digits of the expected SHA-256; None: those in its name.
    """
    expected = path.stem.rpartition("-")[2] if checksum is None else checksum
    try:
        found = file_sha256(path)
    except FileNotFoundError:
        return "is missing"
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if len(expected) >= CHECKSUM_DIGITS and found.startswith(expected):
        return ""
    return "is damaged: its contents do not match its checksum"


def set_aside(path: Path, fault: str, results: Path) -> str:
    """Move a damaged file to `DAMAGED_FOLDER` of the results folder; returns a message."""
    sentence = f"{path}: {fault}"
    if path.exists():
        with contextlib.suppress(OSError):  # on a failing disk
            aside = make_folder(results / DAMAGED_FOLDER)
            os.replace(path, aside / path.name)
            sentence += f"; moved to {aside}"
    return f"{sentence}; its trials are computed again"
