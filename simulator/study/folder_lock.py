"""Lock of a results folder for one run at a time: a file with the process and host of the owner."""

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
    """Process ID."""
    host: str
    """Host name."""
    started: str
    """Start time in the system's clock, which distinguishes it from a later process with the same ID. Empty if not
    available."""

    @classmethod
    def this_process(cls) -> Owner:
        """The current process."""
        return cls(os.getpid(), platform.node(), _start_of(os.getpid()))

    @property
    def is_gone(self) -> bool:
        """Whether it ran on this machine and has ended; False if unknown."""
        if self.host != platform.node() or sys.platform == "win32":
            return False
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return True
        except OSError:  # of another user
            pass
        return bool(self.started) and _start_of(self.pid) != self.started


@contextlib.contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Lock a folder for this process; the lock of an ended process of this machine is taken over.

    Raises
    ------
    InputError
        If another process holds the lock (with its ID, its host and how to remove the lock), or the folder cannot be
        written.
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
        end = "wait until it has finished, or choose another --out"
        return f"{folder}: in use by process {other.pid} on this machine; {end}"
    return (
        f"{folder}: in use by process {other.pid} on host '{other.host}'; wait until it has "
        f"finished or choose another --out; if that process has ended, remove {path}"
    )


def _read(stream: IO[str]) -> Owner | None:
    """Owner in a lock file; None if the file is new or incomplete."""
    stream.seek(0)
    try:
        found = json.load(stream)
        return Owner(int(found["pid"]), str(found["host"]), str(found["started"]))
    except (ValueError, KeyError, TypeError):
        return None


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[IO[str]]:
    """The lock file, opened exclusively by this process during the block."""
    try:
        while True:
            with path.open("a+", encoding="utf-8") as stream:
                _wait_for(stream)
                # its owner may have removed it in the meantime
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
    """Wait until no other process has the file open here; ignored on file systems without locks."""
    if sys.platform != "win32":
        import fcntl

        with contextlib.suppress(OSError):
            fcntl.flock(stream.fileno(), fcntl.LOCK_EX)


def _start_of(pid: int) -> str:
    """Start time of a process in ticks after boot, from ``/proc`` of Linux; empty on other systems."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
        return text.rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""
