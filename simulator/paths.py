"""Files that are either whole or not there."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from startracker.errors import InputError


def write_atomically(path: Path, data: bytes | str) -> None:
    """Write `data` beside `path` and move it into place, so that nobody ever meets half a file.

    Raises
    ------
    InputError
        When the folder cannot be written; says why.
    """
    payload = data.encode("utf-8") if isinstance(data, str) else data
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another place") from error
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(payload)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another place") from error
    finally:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)


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
