"""Files of finished trials that show whether they are still as they were written."""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

from simulator.paths import make_folder, write_atomically

CHECKSUM_DIGITS = 16
"""Hexadecimal digits of the SHA-256 in the name of a file."""
DAMAGED_FOLDER = ".trials-damaged"
"""Where damaged files are set aside, in the folder of the results."""


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's contents, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_checked(folder: Path, stem: str, data: bytes, *, durable: bool = True) -> Path:
    """Write ``STEM-CHECKSUM.parquet``, moved into place whole.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    path = folder / f"{stem}-{hashlib.sha256(data).hexdigest()[:CHECKSUM_DIGITS]}.parquet"
    write_atomically(path, data, durable=durable)
    return path


def fault_of(path: Path, checksum: str | None = None) -> str:
    """What is wrong with a file; empty for one that is as it was written.

    Parameters
    ----------
    path : Path
        The file.
    checksum : str, optional
        First digits of its SHA-256; None: those in its name.
    """
    expected = path.stem.rpartition("-")[2] if checksum is None else checksum
    try:
        found = file_sha256(path)
    except FileNotFoundError:
        return "is gone"
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if len(expected) >= CHECKSUM_DIGITS and found.startswith(expected):
        return ""
    return "is damaged: its contents do not match its checksum"


def set_aside(path: Path, fault: str, results: Path) -> str:
    """Move a damaged file to `DAMAGED_FOLDER` of the folder of the results; a sentence that says so."""
    sentence = f"{path}: {fault}"
    if path.exists():
        with contextlib.suppress(OSError):  # on a failing disk
            aside = make_folder(results / DAMAGED_FOLDER)
            os.replace(path, aside / path.name)
            sentence += f"; set aside in {aside}"
    return f"{sentence}; its trials are computed again"
