"""Cache of parsed catalogues, and of tables computed from them, in the user's cache folder.

The cache only saves time: any error is treated as a cache miss.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.source import CatalogSource
from startracker.catalog.stars import StarCatalog, read_only

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
    stored = load_arrays(key)
    try:
        if stored is None:
            return None
        columns: dict[str, Any] = {column: read_only(stored[column]) for column in StarCatalog.columns()}
        columns["position_sigma_rad"] = float(stored["position_sigma_rad"])
        columns["source"] = CatalogSource.from_dict(json.loads(str(stored["source"])))
        return StarCatalog(str(stored["name"]), float(stored["epoch_jyear"]), **columns)
    except (ValueError, KeyError, TypeError):
        return None


def store(key: str, catalog: StarCatalog) -> None:
    """Store a catalogue under `key`."""
    names = (*StarCatalog.columns(), "name", "epoch_jyear", "position_sigma_rad")
    arrays = {name: np.asarray(getattr(catalog, name)) for name in names}
    store_arrays(key, arrays | {"source": np.asarray(catalog.provenance.as_json())})


def load_arrays(key: str) -> dict[str, NDArray[Any]] | None:
    """The arrays stored under `key`; None if there are none or they cannot be read."""
    try:
        # The file is opened here because NumPy leaves a damaged file open.
        with (folder() / f"{key}.npz").open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return dict(stored)
    except _UNUSABLE:
        return None


def store_arrays(key: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Store arrays under `key`, atomically: a temporary file is renamed. Failures are ignored."""
    temporary = ""
    try:
        folder().mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder(), prefix=f"{key}.", suffix=".tmp", delete=False) as file:
            temporary = file.name
            np.savez(file, **arrays)  # type: ignore[arg-type]  # none is called allow_pickle
        os.replace(temporary, folder() / f"{key}.npz")
    except OSError:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
