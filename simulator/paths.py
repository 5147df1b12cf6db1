"""Files that are either whole or not there."""

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
    """Stream that becomes the file `path` when the block ends well, and leaves nothing behind when it does not.

    Parameters
    ----------
    path : Path
        The file; what is written goes to another beside it that is moved into place at the end.
    durable : bool
        Wait until the disk has it, so that not even a power cut leaves half a file in place.

    Raises
    ------
    InputError
        When the file cannot be written, or the disk is full; says why.
    """
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as stream:
                yield stream
                stream.flush()
                if durable:
                    os.fsync(stream.fileno())
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        finally:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(temporary)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error


def write_atomically(path: Path, data: bytes | str, *, durable: bool = True) -> None:
    """Write `data` beside `path` and move it into place, so that nobody ever meets half a file.

    Raises
    ------
    InputError
        When the folder cannot be written; says why.
    """
    with open_atomically(path, durable=durable) as stream:
        stream.write(data.encode("utf-8") if isinstance(data, str) else data)


def make_folder(path: Path) -> Path:
    """Folder for results, made where it is missing, known to be writable.

    Raises
    ------
    InputError
        When it cannot be made or written into; says why.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise InputError(f"{path}: cannot be used for results ({error.strerror}); choose another --out") from error
    return path
