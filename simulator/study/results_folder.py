"""Identity of the results in a folder, and what may replace them.

The JSON file of every kind of results states its inputs under ``identity``. Results of the same scenario, seed, version
and input files may be replaced by an equal or larger number of trials; others only on request (``--force``).
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import platform
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from simulator.paths import make_folder
from simulator.scenario import Scenario
from simulator.study.folder_lock import folder_lock
from startracker._version import __version__
from startracker.errors import InputError

FILES = {
    "run": "summary.json",
    "sequence": "sequence.json",
    "sweep": "sweep.json",
    "coverage": "coverage.json",
    "design": "design.json",
    "budget": "budget.json",
    "datasheet": "datasheet.json",
    "environment": "environment.json",
}
"""Kinds of results, and the file with their identity."""

IDENTITY_FILE = "identity.json"
"""File with the identity of finished parts."""

_TOGETHER = ("run", "sequence")
"""Kinds that write ``scenario.resolved.yaml``."""


@dataclass(frozen=True)
class Identity:
    """Inputs of results."""

    kind: str
    """Kind of results, a key of `FILES`."""
    scenario: str
    """Name of the scenario."""
    seed: int
    """Seed of the scenario."""
    sha256: str
    """Hash of the version, the scenario's values, the contents of its files, and the options that change results."""
    amounts: Mapping[str, int] = field(default_factory=dict)
    """Amount of results, such as ``{"trials": 400}``: larger amounts may replace smaller ones."""
    version: str = field(default_factory=lambda: __version__)
    """Version of boresight."""

    def __str__(self) -> str:
        amounts = "".join(f", {number} {name}" for name, number in self.amounts.items() if number)
        return f"scenario '{self.scenario}', seed {self.seed}{amounts}, boresight {self.version}"

    def to_dict(self) -> dict[str, Any]:
        """As in the JSON file of the results."""
        return asdict(self)

    @classmethod
    def from_dict(cls, kind: str, found: Any) -> Identity:
        """Identity from the JSON file of results; "unknown" for missing entries.

        Raises
        ------
        ValueError
            For JSON without an identity.
        """
        identity = found.get("identity") if isinstance(found, dict) else None
        if not isinstance(identity, dict) or not isinstance(identity.get("amounts"), dict):
            raise ValueError("no identity")
        amounts = {str(name): int(number) for name, number in identity["amounts"].items()}
        words = {name: identity.get(name, "unknown") for name in ("scenario", "seed", "sha256", "version")}
        return cls(kind=kind, amounts=amounts, **words)


def scenario_sha256(scenario: Scenario, **options: object) -> str:
    """SHA-256 of the inputs of results: version, values, contents of the scenario's files, `options`.

    The number of trials is not included, as trials may be added to existing ones.
    """
    digest = hashlib.sha256(f"{__version__}\n{scenario.with_values(trials=1).fingerprint()}\n".encode())
    for key, file in scenario.files().items():
        with contextlib.suppress(OSError):  # unreadable files are reported by their readers
            digest.update(f"{key} {hashlib.sha256(file.read_bytes()).hexdigest()}\n".encode())
    for name, value in sorted(options.items()):
        digest.update(f"{name}={value!r}\n".encode())
    return digest.hexdigest()


def refuse_other_files(scenario: Scenario, sha256: str) -> None:
    """Refuse to run trials if the scenario's files differ from those at the start of the run.

    Raises
    ------
    InputError
        States the files.
    """
    if scenario_sha256(scenario) != sha256:
        files = ", ".join(map(str, scenario.files().values()))
        raise InputError(
            f"{scenario.name}: its files ({files or 'none found'}) were changed during the run, or differ "
            f"on {platform.node()}; restore identical files and run again"
        )


@contextlib.contextmanager
def results_folder(path: Path, new: Identity, *, resume: bool = False, force: bool = False) -> Iterator[Path]:
    """The folder of new results, created if missing, and locked until they are written.

    Parameters
    ----------
    path : Path
        The folder.
    new : Identity
        Identity of the new results.
    resume : bool
        Reuse finished trials.
    force : bool
        Replace any existing results.

    Raises
    ------
    InputError
        If the new results may not replace the existing ones, another process uses the folder, or it cannot be written.
    """
    if resume and force:
        raise InputError("--resume and --force: use only one of them; --force computes everything again")
    folder = make_folder(path)
    with folder_lock(folder):
        if not force:
            _refuse_loss(folder, new)
        yield folder


@contextlib.contextmanager
def study_folder(
    kind: str,
    scenario: Scenario,
    out: Path | None,
    force: bool,
    amounts: Mapping[str, int] | None = None,
    **options: Any,
) -> Iterator[tuple[Path, Identity]]:
    """`results_folder` of a study of a scenario, ``out/NAME-KIND`` by default, with the identity of its results.

    Parameters
    ----------
    kind : str
        Kind of results, a key of `FILES`.
    scenario : Scenario
        The scenario.
    out : Path, optional
        The folder.
    force : bool
        Replace any existing results.
    amounts : mapping, optional
        As in `Identity`.
    **options
        What changes the results besides the scenario.
    """
    sha256 = scenario_sha256(scenario, **options)
    identity = Identity(kind, scenario.name, scenario.seed, sha256, amounts or {})
    with results_folder(out or Path("out") / f"{scenario.name}-{kind}", identity, force=force) as folder:
        yield folder, identity


def standing(folder: Path, kind: str) -> Identity | None:
    """Identity of the results of a kind in a folder; None if there are none.

    Raises
    ------
    InputError
        For unidentifiable results.
    """
    file = folder / FILES[kind]
    try:
        return Identity.from_dict(kind, json.loads(file.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError):
        raise InputError(
            f"{file}: unidentifiable results (of another version of boresight, or damaged); "
            "choose another --out, or replace them with --force"
        ) from None


def unfinished_identity(folder: Path, kind: str) -> Identity | None:
    """Identity of an unfinished run in a folder of parts; None if there is none, or if it finished nothing.

    Raises
    ------
    InputError
        For unidentifiable parts.
    """
    # A run that failed before its first part, for a value that is now corrected, left only its identity.
    if not any(path.is_file() and path.name != IDENTITY_FILE for path in folder.rglob("[!.]*")):
        return None
    with contextlib.suppress(OSError, ValueError, TypeError):
        return Identity.from_dict(kind, json.loads((folder / IDENTITY_FILE).read_text(encoding="utf-8")))
    raise InputError(
        f"{folder}: unidentifiable unfinished trials (of another version, or damaged); "
        "choose another --out, or discard them with --force"
    )


def remove_unfinished(folder: Path) -> None:
    """Remove a folder of parts whose results are written; the identity last, so that what is left after a kill is
    still identified by the next run."""
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != IDENTITY_FILE:
                path.unlink()
    shutil.rmtree(folder, ignore_errors=True)


def _refuse_loss(folder: Path, new: Identity) -> None:
    for kind in _TOGETHER if new.kind in _TOGETHER else (new.kind,):
        if (old := standing(folder, kind)) is not None:
            refuse_other(folder, old, new, "the results")


def refuse_other(folder: Path, old: Identity, new: Identity, what: str) -> None:
    """Refuse to replace results or unfinished trials (`what`) that would be lost.

    Raises
    ------
    InputError
        States the existing results and the options.
    """
    either = "choose another --out, or replace them with --force"
    if old.kind != new.kind:
        raise InputError(f"{folder}: contains {what} of a {old.kind} ({old}); {either}")
    if old.sha256 != new.sha256:
        pairs = [(old.scenario, new.scenario), (old.seed, new.seed), (old.version, new.version)]
        if any(a != b for a, b in pairs):
            raise InputError(f"{folder}: contains {what} of another {new.kind} ({old}); {either}")
        raise InputError(
            f"{folder}: contains {what} of a {new.kind} with other values, options or input files ({old}); {either}"
        )
    less = {name: number for name, number in old.amounts.items() if number > new.amounts.get(name, 0)}
    if less:
        asked = ", ".join(f"{new.amounts.get(name, 0)} {name}" for name in less)
        raise InputError(
            f"{folder}: contains {what} of a longer {new.kind} ({old}) than the requested {asked}; request as many, "
            "choose another --out, or replace them with --force"
        )
