"""Whose results stand in a folder, and what may replace them.

The JSON file of every kind of results says under ``identity`` what it was made from. Results of the same scenario,
seed, version and input files may be replaced by as many or more trials; anything else only on request (``--force``).
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import platform
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
}
"""Kinds of results, and the file of each that says what they are."""

IDENTITY_FILE = "identity.json"
"""In a folder of finished parts: what they belong to."""

_TOGETHER = ("run", "sequence")
"""Kinds that both write ``scenario.resolved.yaml``."""


@dataclass(frozen=True)
class Identity:
    """What results are made from."""

    kind: str
    """A key of `FILES`."""
    scenario: str
    """Its name."""
    seed: int
    """Its seed."""
    sha256: str
    """Of the version, the scenario's values, the contents of the files it names, and the options that change
    results."""
    amounts: Mapping[str, int] = field(default_factory=dict)
    """How much was computed, such as ``{"trials": 400}``: more of the same may replace less."""
    version: str = field(default_factory=lambda: __version__)
    """Of boresight."""

    def __str__(self) -> str:
        amounts = "".join(f", {number} {name}" for name, number in self.amounts.items() if number)
        return f"scenario '{self.scenario}', seed {self.seed}{amounts}, boresight {self.version}"

    def to_dict(self) -> dict[str, Any]:
        """As the results' JSON holds it."""
        return asdict(self)

    @classmethod
    def from_dict(cls, kind: str, found: Any) -> Identity:
        """Identity of results from what their JSON holds; "unknown" for what is not there.

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
    """SHA-256 of what results depend on: version, values, contents of the files that the scenario names, `options`.

    The number of trials is not part of it, as more trials of the same scenario may join those that are there.
    """
    digest = hashlib.sha256(f"{__version__}\n{scenario.with_values(trials=1).fingerprint()}\n".encode())
    for key, file in scenario.files().items():
        with contextlib.suppress(OSError):  # a file that cannot be read is reported by what needs it
            digest.update(f"{key} {hashlib.sha256(file.read_bytes()).hexdigest()}\n".encode())
    for name, value in sorted(options.items()):
        digest.update(f"{name}={value!r}\n".encode())
    return digest.hexdigest()


def refuse_other_files(scenario: Scenario, sha256: str) -> None:
    """Refuse to run trials where the scenario's files are not those that the run began with.

    Raises
    ------
    InputError
        Says which files to look at.
    """
    if scenario_sha256(scenario) != sha256:
        files = ", ".join(map(str, scenario.files().values()))
        raise InputError(
            f"{scenario.name}: files that it names ({files or 'none found'}) were changed during the run, or differ "
            f"on {platform.node()}; make them the same and run again"
        )


@contextlib.contextmanager
def results_folder(path: Path, new: Identity, *, resume: bool = False, force: bool = False) -> Iterator[Path]:
    """The folder of new results, made where it is missing and held while they are computed and written.

    Parameters
    ----------
    path : Path
        The folder.
    new : Identity
        What will be written there.
    resume : bool
        Finished trials are to be taken over.
    force : bool
        Whatever stands there may be replaced.

    Raises
    ------
    InputError
        Where results stand that the new ones may not replace, another process is at work there, or the folder cannot be
        written.
    """
    if resume and force:
        raise InputError("--resume and --force: give one of the two; --force computes everything again")
    folder = make_folder(path)
    with folder_lock(folder):
        if not force:
            _refuse_loss(folder, new)
        yield folder


def standing(folder: Path, kind: str) -> Identity | None:
    """Identity of the results of a kind in a folder; None where there are none.

    Raises
    ------
    InputError
        For results that cannot be identified.
    """
    file = folder / FILES[kind]
    try:
        return Identity.from_dict(kind, json.loads(file.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError):
        raise InputError(
            f"{file}: results that cannot be identified (not written by this version of boresight, or damaged); "
            "choose another --out, or replace them with --force"
        ) from None


def unfinished_identity(folder: Path, kind: str) -> Identity | None:
    """Identity of what an unfinished run left in a folder of parts; None where there are none.

    Raises
    ------
    InputError
        For parts that cannot be identified.
    """
    try:
        return Identity.from_dict(kind, json.loads((folder / IDENTITY_FILE).read_text(encoding="utf-8")))
    except FileNotFoundError:
        if not any(folder.glob("[0-9]*.parquet")):
            return None
    except (OSError, ValueError, TypeError):
        pass
    raise InputError(
        f"{folder}: unfinished trials that cannot be identified (of another version, or damaged); "
        "choose another --out, or discard them with --force"
    )


def _refuse_loss(folder: Path, new: Identity) -> None:
    for kind in _TOGETHER if new.kind in _TOGETHER else (new.kind,):
        if (old := standing(folder, kind)) is not None:
            refuse_other(folder, old, new, "the results")


def refuse_other(folder: Path, old: Identity, new: Identity, what: str) -> None:
    """Refuse to replace results, or unfinished trials (`what`), that the new ones would lose.

    Raises
    ------
    InputError
        Says what is there and what can be done.
    """
    either = "choose another --out, or replace them with --force"
    if old.kind != new.kind:
        raise InputError(f"{folder}: holds {what} of a {old.kind} ({old}); {either}")
    if old.sha256 != new.sha256:
        pairs = [(old.scenario, new.scenario), (old.seed, new.seed), (old.version, new.version)]
        if any(a != b for a, b in pairs):
            raise InputError(f"{folder}: holds {what} of another {new.kind} ({old}); {either}")
        raise InputError(
            f"{folder}: holds {what} of a {new.kind} with other values, options or input files ({old}); {either}"
        )
    less = {name: number for name, number in old.amounts.items() if number > new.amounts.get(name, 0)}
    if less:
        asked = ", ".join(f"{new.amounts.get(name, 0)} {name}" for name in less)
        raise InputError(
            f"{folder}: holds {what} of a longer {new.kind} ({old}), and {asked} were asked for; ask for as many, "
            "choose another --out, or replace them with --force"
        )
