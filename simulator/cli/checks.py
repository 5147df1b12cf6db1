"""What several commands check before they begin: the scenario, and the places to write to."""

from __future__ import annotations

import os
from pathlib import Path

from startracker.errors import InputError


def writable(path: Path | None) -> None:
    """Raise `InputError` where a file cannot be written, before any work is done for it."""
    if path is None:
        return
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: its folder {path.parent} does not exist; make it, or name another")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: its folder {path.parent} cannot be written to; name another")
