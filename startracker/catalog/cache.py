"""Cache of parsed catalogues in the user's cache folder. It only saves time: any error is treated as a cache miss."""

from __future__ import annotations

import contextlib
import os
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from startracker.catalog.stars import StarCatalog, read_only

__all__ = ["folder", "load", "store"]

_UNUSABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile)


def folder() -> Path:
    """The cache folder; the environment variable ``BORESIGHT_CACHE`` overrides it."""
    own = os.environ.get("BORESIGHT_CACHE")
    if own:
        return Path(own)
    import platformdirs

    return platformdirs.user_cache_path("boresight")


def load(key: str) -> StarCatalog | None:
    """The catalogue stored under `key`; None if there is none or it cannot be read."""
    try:
        # opened here because NumPy leaves a damaged file open
        with (folder() / f"{key}.npz").open("rb") as file, np.load(file, allow_pickle=False) as stored:
            columns: dict[str, Any] = {column: read_only(stored[column]) for column in StarCatalog.columns()}
            columns["position_sigma_rad"] = float(stored["position_sigma_rad"])
            return StarCatalog(str(stored["name"]), float(stored["epoch_jyear"]), **columns)
    except _UNUSABLE:
        return None


def store(key: str, catalog: StarCatalog) -> None:
    """Store a catalogue under `key`, atomically: a temporary file is renamed."""
    columns = {column: getattr(catalog, column) for column in StarCatalog.columns()}
    temporary = ""
    try:
        folder().mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder(), prefix=f"{key}.", suffix=".tmp", delete=False) as file:
            temporary = file.name
            np.savez(
                file,
                name=np.array(catalog.name),
                epoch_jyear=np.array(catalog.epoch_jyear),
                position_sigma_rad=np.array(catalog.position_sigma_rad),
                **columns,
            )
        os.replace(temporary, folder() / f"{key}.npz")
    except OSError:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
