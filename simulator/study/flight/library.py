"""The flight build compiled as a shared library, once, and called in this process.

The sources are those of `startracker.flight.export`, and ``library.c`` beside them, which passes frames and answers as
arrays of integers. A library is kept in a folder named by the digest of its sources, the compiler and its options, and
its name has the digest of its own bytes, so that a damaged one is compiled again.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.paths import write_atomically
from simulator.study.exported_c.build import command
from simulator.study.exported_c.targets import host_compiler
from simulator.study.flight.program import ProgramAnswer
from startracker.catalog.cache import folder
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError
from startracker.flight.c_text import for_input
from startracker.flight.design import FlightDesign
from startracker.flight.export import assemble, flight_parts, flight_tables
from startracker.flight.reasons import Reason
from startracker.flight.stars import StarList
from startracker.solution import Status

OPTIONS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared")
"""Options of the compiler: the options of the exported Makefile that determine the code, and those of a library."""
_LIBRARIES = () if sys.platform == "win32" else ("-lm",)
_COUNTS = ("stars", "matched", "used", "evidence", "chance", "steps", "contradicted")
_KNOWN, _ANSWER, _PRIOR, _STATE = 15, 22, 10, 47
"""Numbers of the arrays of ``library.c``."""
_DIGITS = 16
_STATUSES, _REASONS = [str(status) for status in Status], [reason.name.lower() for reason in Reason]
NO_PRIOR = (0,) * _PRIOR


class Known(NamedTuple):
    """What is known of a frame, as integers: the fields of ``struct tracker_frame_info``."""

    velocity: Sequence[int] = (0, 0, 0)
    epoch: int = 0
    time_us: int = 0
    prior: Sequence[int] = NO_PRIOR
    """Rows of the matrix, 2.30, and the radius, rad of 28 fraction bits; 0: there is no prior."""


class FilterState(NamedTuple):
    """The filter of a flight build as real numbers."""

    quaternion: FloatArray
    """(4,): Scalar last, ICRS to camera."""
    rate_rad_s: FloatArray
    bias_rad_s: FloatArray
    """(3,) each, camera axes."""
    covariance: FloatArray
    """(6, 6): covariance of the attitude and of the rate, or the bias; rad² and seconds."""
    distance2: float
    """Squared distance of the last innovation; negative if there is none."""


def cache_folder() -> Path:
    """Folder of the compiled libraries, within the cache of the catalogues (`startracker.catalog.cache.folder`)."""
    return folder() / "flight"


def library_sources(design: FlightDesign) -> dict[str, str]:
    """Sources of the library of a design, by file name: those of the export without its tests, and ``library.c``."""
    export = assemble(design, flight_parts(flight_tables(design)), "tracker", "")
    kept = {name: text for name, text in export.files.items() if name.startswith("tracker")}
    source = (files("simulator.study.flight") / "library.c").read_text("utf-8")
    return kept | {"library.c": for_input(source, design.takes_frames)}


def compiled_library(design: FlightDesign, cache: Path | None = None) -> Path:
    """Shared library of a design, compiled if there is none in the cache.

    Parameters
    ----------
    design : FlightDesign
    cache : Path, optional
        Folder; by default `cache_folder`.

    Raises
    ------
    InputError
        If there is no compiler, it fails, or the folder cannot be written.
    """
    sources, compiler = library_sources(design), host_compiler()
    given = [*compiler, *OPTIONS, _version_of(tuple(compiler)), *(f"{n}\n{sources[n]}" for n in sorted(sources))]
    key = hashlib.sha256("\n".join(given).encode()).hexdigest()[:_DIGITS]
    target = (cache_folder() if cache is None else cache) / key
    try:
        for found in target.glob("tracker-*.so"):
            if _is_whole(found):
                return found
            found.unlink(missing_ok=True)
        target.mkdir(parents=True, exist_ok=True)
        return _compile(sources, compiler, target)
    except OSError as error:
        advice = "choose another folder for caches by the variable BORESIGHT_CACHE or XDG_CACHE_HOME"
        raise InputError(f"{target}: the flight build cannot be compiled there ({error.strerror}); {advice}") from error


def _compile(sources: Mapping[str, str], compiler: Sequence[str], target: Path) -> Path:
    """Compile the sources in their target; the library gets its name at the end, so that processes that do this at the
    same time do not disturb each other."""
    for name, text in sources.items():
        write_atomically(target / name, text, durable=False)
    with tempfile.TemporaryDirectory(dir=target) as work:
        built = Path(work) / "tracker.so"
        units = [str(target / name) for name in sources if name.endswith(".c")]
        command([*compiler, *OPTIONS, "-o", str(built), *units, *_LIBRARIES])
        final = target / f"tracker-{_digest(built)}.so"
        os.replace(built, final)
    return final


@cache
def _version_of(compiler: tuple[str, ...]) -> str:
    """Path and version of a compiler."""
    said = subprocess.run([*compiler, "--version"], capture_output=True, text=True, check=False).stdout
    return f"{shutil.which(compiler[0])} {said}"


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()[:_DIGITS]


def _is_whole(library: Path) -> bool:
    """Whether a library has the bytes that its name states: a truncated one would end the process that loads it."""
    return library.stem == f"tracker-{_digest(library)}"


class FlightLibrary:
    """A loaded library with the memory of one camera.

    Parameters
    ----------
    file : Path
        From `compiled_library`.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        try:
            self._c = ctypes.CDLL(str(file))
        except OSError as error:
            raise InputError(f"{file}: cannot be loaded ({error}); remove it, and it is compiled again") from None
        self._c.library_bytes.restype = ctypes.c_size_t
        self._c.library_version.restype = ctypes.c_char_p
        words = -(-self._c.library_bytes() // 8)
        self._memory = (ctypes.c_int64 * words)()
        self.most_stars: int = self._c.library_most_stars()
        self.forget()

    def __reduce__(self) -> tuple[type[FlightLibrary], tuple[Path]]:
        return FlightLibrary, (self.file,)  # loaded again, without the memory of a filter

    @property
    def version(self) -> str:
        """Text by which the compiled C states what it was made from."""
        return str(self._c.library_version().decode())

    # ------------------------------------------------------------------ frames
    def read(self, image: NDArray[np.uint16], known: Known) -> None:
        """Give all rows of a frame, contiguous."""
        self._c.library_read(self._memory, _pointer(_numbers(known)), _pointer(image))

    def finish(self) -> tuple[ProgramAnswer, StarList]:
        """Answer and stars of the frame that was read."""
        self._c.library_finish(self._memory)
        return self.answer()

    def solve_stars(self, stars: StarList, known: Known) -> tuple[ProgramAnswer, StarList]:
        """Answer of a list of stars, and those that were used."""
        rows = np.ascontiguousarray(np.column_stack(stars), dtype=np.int64)
        self._c.library_solve_list(self._memory, _pointer(_numbers(known)), _pointer(rows), len(rows))
        return self.answer()

    def answer(self) -> tuple[ProgramAnswer, StarList]:
        """The last answer and its stars."""
        given, stars = np.zeros(_ANSWER, np.int64), np.zeros((self.most_stars, 6), np.int64)
        self._c.library_answer(self._memory, _pointer(given), _pointer(stars))
        status, reason, *counts = given[:9].tolist()
        stars = stars[: counts[0]]
        solved = status == 0
        answer = ProgramAnswer(
            _STATUSES[status],
            _REASONS[reason],
            dict(zip(_COUNTS, counts, strict=True)),
            tuple(given[9:13].tolist()) * solved,
            tuple(given[13:].tolist()) * solved,
            tuple(stars[:, 5].tolist()) * solved,
        )
        return answer, StarList(*stars[:, :5].T)

    # ------------------------------------------------------------------ filter
    def forget(self) -> None:
        """Begin the filter without an attitude."""
        self._c.library_forget(self._memory)

    def predict(self, time_us: int, gyro: Sequence[int] | None = None) -> tuple[int, tuple[int, ...]]:
        """Whether the time can be used, and the prior of its frame: the rate
        of a gyro is in rad/s of 2.30; the first result is `startracker.flight.following.TIME_GOOD` or another."""
        prior = np.zeros(_PRIOR, np.int64)
        rate = None if gyro is None else (ctypes.c_int32 * 3)(*gyro)
        time = self._c.library_predict(self._memory, ctypes.c_int64(time_us), rate, _pointer(prior))
        return int(time), tuple(prior.tolist())

    def take(self) -> int:
        """Give the last answer to the filter: `startracker.flight.following.USED` or another. The answer is the
        filter's unless it was rejected."""
        return int(self._c.library_take(self._memory))

    def filter(self) -> FilterState | None:
        """State of the filter; None without an attitude."""
        state = np.zeros(_STATE)
        if not self._c.library_filter(self._memory, _pointer(state)):
            return None
        return FilterState(state[:4], state[4:7], state[7:10], state[10:46].reshape(6, 6), float(state[46]))


def _numbers(known: Known) -> IntArray:
    return np.array([*known.velocity, known.epoch, known.time_us, *known.prior], dtype=np.int64)


def _pointer(numbers: NDArray[Any]) -> ctypes.c_void_p:
    """Address of an array, with a reference to it."""
    return numbers.ctypes.data_as(ctypes.c_void_p)
