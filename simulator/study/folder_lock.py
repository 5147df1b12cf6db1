"""One run at a time in a folder of results: a lock file with the owner's process and host."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO

from startracker.errors import InputError

LOCK_FILE = ".boresight.lock"


@dataclass(frozen=True)
class Owner:
    """A process that holds a lock."""

    pid: int
    """Its number."""
    host: str
    """Machine it runs on."""
    started: str
    """When it was started, in the system's own clock; distinguishes it from a later process of the same number. Empty
    where the system does not say."""

    @classmethod
    def this_process(cls) -> Owner:
        """The running process."""
        return cls(os.getpid(), platform.node(), _start_of(os.getpid()))

    @property
    def is_gone(self) -> bool:
        """Whether it ran on this machine and has ended; False where that cannot be known."""
        if self.host != platform.node() or sys.platform == "win32":
            return False
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return True
        except OSError:  # another user's
            pass
        return bool(self.started) and _start_of(self.pid) != self.started


@contextlib.contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold a folder for this process; the lock of a process of this machine that has ended is taken over.

    Raises
    ------
    InputError
        When another process holds it, with its number, its host and how to remove its lock; or where the folder cannot
        be written.
    """
    path, owner = folder / LOCK_FILE, Owner.this_process()
    with _opened(path) as stream:
        other = _read(stream)
        if other is not None and not other.is_gone:
            raise InputError(_held(folder, path, other, owner))
        stream.seek(0)
        stream.truncate()
        json.dump(asdict(owner), stream)
    try:
        yield
    finally:
        with contextlib.suppress(InputError, OSError), _opened(path) as stream:
            if _read(stream) == owner:
                path.unlink(missing_ok=True)


def _held(folder: Path, path: Path, other: Owner, owner: Owner) -> str:
    if other.host == owner.host:
        end = "wait for its end, or choose another --out"
        return f"{folder}: in use by process {other.pid} of this machine, which writes its results there; {end}"
    return (
        f"{folder}: in use by process {other.pid} on host '{other.host}', which writes its results there; wait for its "
        f"end, choose another --out, or, if that process has ended, remove {path}"
    )


def _read(stream: IO[str]) -> Owner | None:
    """Owner that a lock file names; None for one that was just made, or left half written by a kill."""
    stream.seek(0)
    try:
        found = json.load(stream)
        return Owner(int(found["pid"]), str(found["host"]), str(found["started"]))
    except (ValueError, KeyError, TypeError):
        return None


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[IO[str]]:
    """The lock file, for this process alone while the block runs: what it reads there is still so when it writes."""
    try:
        while True:
            with path.open("a+", encoding="utf-8") as stream:
                _wait_for(stream)
                # its owner may have removed it meanwhile
                if _is_same(stream, path):
                    yield stream
                    return
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); choose another --out") from error


def _is_same(stream: IO[str], path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(stream.fileno()), path.stat())
    except FileNotFoundError:
        return False


def _wait_for(stream: IO[str]) -> None:
    """Wait until no other process has the file open here; a file system without locks does without."""
    if sys.platform != "win32":
        import fcntl

        with contextlib.suppress(OSError):
            fcntl.flock(stream.fileno(), fcntl.LOCK_EX)


def _start_of(pid: int) -> str:
    """Start of a process in ticks after boot, from Linux' ``/proc``; empty elsewhere."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
        return text.rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""
