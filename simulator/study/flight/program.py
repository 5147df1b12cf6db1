"""The compiled flight build of a camera, as a program that solves frames and lists of stars."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.study.exported_c.build import Build, compile_export
from simulator.study.exported_c.targets import HOST, Target
from startracker.core import SPEED_OF_LIGHT_KM_S, FloatArray, IntArray
from startracker.flight.design import FlightDesign
from startracker.flight.export import flight_export
from startracker.flight.pose import COVARIANCE_BITS
from startracker.flight.stars import StarList
from startracker.geometry.attitude import Attitude

_ONE = 1 << 30


class ProgramAnswer(NamedTuple):
    """A line that the program prints."""

    status: str
    reason: str
    counts: dict[str, int]
    """``stars``, ``matched``, ``used``, ``evidence``, ``chance``, ``steps``, ``contradicted``; of a sequence
    ``filter``."""
    quaternion: tuple[int, ...] = ()
    """x, y, z, w with 30 fraction bits; empty unless solved, as are the fields below."""
    covariance: tuple[int, ...] = ()
    """Rows of the matrix, square radians, 60 fraction bits."""
    numbers: tuple[int, ...] = ()
    """Catalogue number of each star."""

    @property
    def attitude(self) -> Attitude | None:
        """Attitude of the camera in ICRS; None unless solved."""
        return Attitude(np.array(self.quaternion) / _ONE, "icrs", "camera") if self.quaternion else None

    @property
    def covariance_rad2(self) -> FloatArray:
        """Covariance (3, 3), rad²; NaN unless solved."""
        if not self.covariance:
            return np.full((3, 3), np.nan)
        return np.array(self.covariance, dtype=float).reshape(3, 3) / float(1 << COVARIANCE_BITS)


def parse_answer(line: str) -> ProgramAnswer:
    """An answer from its line."""
    status, reason, *fields = line.split()
    values = dict(field.split("=") for field in fields)
    quaternion = tuple(round(float(x) * _ONE) for x in values.pop("quaternion", "").split(",") if x)
    covariance, numbers = (
        tuple(int(n) for n in values.pop(name, "").split(",") if n) for name in ("covariance", "numbers")
    )
    return ProgramAnswer(status, reason, {name: int(n) for name, n in values.items()}, quaternion, covariance, numbers)


def velocity_of(velocity_km_s: ArrayLike | None) -> tuple[int, ...]:
    """Velocity of the observer divided by the speed of light, with 30 fraction bits; zeros for None."""
    if velocity_km_s is None:
        return (0, 0, 0)
    return tuple(np.rint(np.asarray(velocity_km_s, dtype=float) / SPEED_OF_LIGHT_KM_S * _ONE).astype(int).tolist())


def list_text(
    stars: StarList,
    velocity: Sequence[int] = (0, 0, 0),
    prior: Sequence[int] = (),
    time_us: int | None = None,
    epoch: int | None = None,
) -> str:
    """A list as the program reads it.

    Parameters
    ----------
    stars : StarList
    velocity : three ints
        Velocity of the observer divided by the speed of light, with 30 fraction bits.
    prior : ten ints, optional
        Matrix by rows, with 30 fraction bits, and the radius with 28.
    time_us : int, optional
        Time of the frame in a sequence.
    epoch : int, optional
        Julian epoch, years with 16 fraction bits; None: the epoch of the tables.
    """
    lines = [f"velocity {' '.join(map(str, velocity))}"]
    if epoch is not None:
        lines.append(f"epoch {epoch}")
    if time_us is not None:
        lines.append(f"time {time_us}")
    if len(prior):
        lines.append(f"prior {' '.join(map(str, prior))}")
    lines += [" ".join(map(str, row)) for row in zip(*(column.tolist() for column in stars), strict=True)]
    return "\n".join(lines) + "\n\n"


def frame_bytes(image: NDArray[np.generic] | IntArray) -> bytes:
    """Pixels as the program reads them."""
    return np.clip(np.rint(image), 0, 65535).astype("<u2").tobytes()


class FlightProgram:
    """The program of one design.

    Parameters
    ----------
    design : FlightDesign
    folder : Path
        Existing folder for sources, objects and program.
    target : Target
        Processor.
    """

    def __init__(self, design: FlightDesign, folder: Path, target: Target = HOST) -> None:
        self.design = design
        self.export = flight_export(design)
        self.build: Build = compile_export(self.export, folder, target)

    def frames(
        self, images: Sequence[NDArray[np.generic]], velocity: Sequence[int] = (0, 0, 0), epoch: int = 0
    ) -> list[ProgramAnswer]:
        """Answers for frames with the same velocity of the observer and Julian epoch, years of 16 fraction bits (0: the
        tables')."""
        words = ["frames", *map(str, velocity), str(epoch)]
        printed = self.build.run(b"".join(map(frame_bytes, images)), *words)
        return [parse_answer(line) for line in printed.decode().splitlines()]

    def lists(self, texts: Sequence[str]) -> list[ProgramAnswer]:
        """Answers for lists from `list_text`."""
        printed = self.build.run("".join(texts).encode(), "stars")
        return [parse_answer(line) for line in printed.decode().splitlines()]

    def sequence(self, texts: Sequence[str]) -> list[ProgramAnswer]:
        """Answers of the filter for lists from `list_text` with times; ``bad_time`` for times that cannot be used."""
        printed = self.build.run("".join(texts).encode(), "follow")
        return [parse_answer(line) for line in printed.decode().splitlines()]
