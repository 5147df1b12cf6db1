"""Atomic writing of files, and output folders."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from startracker.errors import InputError


@contextlib.contextmanager
def open_atomically(path: Path, *, durable: bool = True) -> Iterator[BinaryIO]:
    """Open a stream that is renamed to `path` if the block succeeds and removed if it fails.

    Parameters
    ----------
    path : Path
        The file; data are written to a temporary file in the same folder, which is renamed at the end.
    durable : bool
        Flush to disk, so that not even a power cut leaves an incomplete file.

    Raises
    ------
    InputError
        If the file cannot be written or the disk is full.
    """
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as stream:
                yield stream
                stream.flush()
                if durable:
                    os.fsync(stream.fileno())
            os.chmod(temporary, 0o644)  # mkstemp creates files that only their owner can read
            os.replace(temporary, path)
        finally:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(temporary)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); choose another path") from error


def write_atomically(path: Path, data: bytes | str, *, durable: bool = True) -> None:
    """Write `data` to `path` atomically, through a temporary file.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with open_atomically(path, durable=durable) as stream:
        stream.write(data.encode("utf-8") if isinstance(data, str) else data)


def make_folder(path: Path) -> Path:
    """Create a folder for results if it is missing, and check that it is writable.

    Raises
    ------
    InputError
        If it cannot be created or is not writable.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        # Permission bits do not show whether a file can be created, so one is created.
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise InputError(f"{path}: cannot be used for results ({error.strerror}); choose another --out") from error
    return path
