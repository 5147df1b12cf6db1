"""``boresight study yee1999`` of one picture: its options checked, its tables printed and written."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.cli.checks import writable
from simulator.cli.solve_command import parse_pixel, parse_size, read_centroids
from simulator.paths import write_atomically
from simulator.theses.yee1999.catalogue import EDITIONS
from simulator.theses.yee1999.picture import Analysis, Options, Picture, analyse, centred, step_tables, vega
from startracker.errors import InputError
from startracker.fixed_point.arithmetic import FixedArithmetic
from startracker.fixed_point.formats import FixedPointOverflow
from startracker.identification.triad_search import TriadLimits

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["PictureRequest", "report", "run_picture"]


@dataclass(frozen=True)
class PictureRequest:
    """What the command line asked for; texts as they were typed."""

    centroids: Path | None
    size: str | None
    fov: str | None
    edition: int | None
    origin: str
    magnitude_limit: float
    dec: str
    max_separation_deg: float | None
    tolerances_deg: tuple[float, float, float, float]
    vote_number: int
    tau_px: float
    three_stars: bool
    integers: bool
    points: tuple[str, ...]
    json_file: Path | None

    def options(self) -> Options:
        """Sub-catalogue, thresholds and arithmetic.

        Raises
        ------
        InputError
            Values that cannot be.
        """
        for name, value in zip(("separation", "rotation", "enclosed", "grouping"), self.tolerances_deg, strict=True):
            if not 0.0 < value < 180.0:
                raise InputError(f"--{name}-tolerance-deg: must be between 0 and 180 degrees, not {value:g}")
        if self.vote_number < 1 or not 0.0 < self.tau_px < math.inf:
            raise InputError(
                f"--vote-number and --tau-px: must be positive, not {self.vote_number} and {self.tau_px:g}"
            )
        if not math.isfinite(self.magnitude_limit):
            raise InputError("--magnitude-limit: must be a number")
        edition = self.edition if self.edition is not None else EDITIONS[self.centroids is not None]
        separation, rotation, enclosed, grouping = self.tolerances_deg
        limits = TriadLimits(
            separation_tolerance_deg=separation,
            rotation_tolerance_deg=rotation,
            enclosed_tolerance_deg=enclosed,
            grouping_tolerance_deg=grouping,
            vote_number=self.vote_number,
            combine_px=self.tau_px,
            three_stars=self.three_stars,
        )
        return Options(
            edition=edition,
            magnitude_limit=self.magnitude_limit,
            dec_range_deg=_two(self.dec, ":", "--dec: must be MIN:MAX in degrees, such as 30:90"),
            max_separation_deg=self.max_separation_deg,
            limits=limits,
            arithmetic=FixedArithmetic() if self.integers else None,
        )

    def picture(self) -> Picture:
        """The centroids asked for, or the Vega image.

        Raises
        ------
        InputError
            A file, a size or a field that cannot be.
        """
        if self.centroids is None:
            if self.size is not None or self.fov is not None:
                raise InputError("--size and --fov: belong to --centroids FILE.csv; the Vega image has its own")
            return vega()
        if self.size is None or self.fov is None:
            raise InputError("--centroids: needs --size WxH and --fov XxY (degrees across and down)")
        size = parse_size(self.size)
        field = _two(self.fov.lower(), "x", "--fov: must be ACROSSxDOWN in degrees, such as 9.0130x6.9049")
        if not (0.0 < field[0] < 120.0 and 0.0 < field[1] < 120.0):
            raise InputError(f"--fov: must be between 0 and 120 degrees, not {self.fov}")
        xy, flux = read_centroids(self.centroids)
        if flux is not None:
            xy = xy[np.argsort(-flux, kind="stable")]
        return Picture(centred(xy, size, self.origin), size, field)

    def point_px(self, picture: Picture) -> NDArray[np.float64]:
        """Points asked for (N, 2), from the image's centre with y up."""
        points = np.array([parse_pixel(text) for text in self.points]).reshape(-1, 2)
        origin = "centre" if self.centroids is None and self.origin == "auto" else self.origin
        return centred(points, picture.size_px, origin)


def run_picture(request: PictureRequest) -> Analysis:
    """The picture through the method; its JSON file, where asked for, is written.

    Raises
    ------
    InputError
        What cannot be asked for.
    """
    writable(request.json_file)
    picture = request.picture()
    points = request.point_px(picture)
    try:
        found = analyse(picture, request.options())
    except FixedPointOverflow as error:
        raise InputError(f"--integers: {error}; floating point has no such limit") from error
    if request.json_file is not None:
        values: dict[str, Any] = found.to_dict()
        if len(points) and found.plate is not None:
            values["points"] = [
                {"x": x, "y": y, "ra_deg": ra, "dec_deg": dec}
                for (x, y), (ra, dec) in zip(points.tolist(), found.sky_deg(points).tolist(), strict=True)
            ]
        write_atomically(request.json_file, json.dumps(values, indent=2, allow_nan=False) + "\n")
    return found


def report(found: Analysis, request: PictureRequest, console: Console) -> None:
    """Print her tables of a picture, its centre, and the points asked for."""
    console.print(
        f"{len(found.catalog):,} stars of the {found.edition}th edition, {len(found.match.tables.separation):,} pairs"
    )
    for title, headings, rows in step_tables(found):
        _print_table(console, title, headings, rows)
    sizes = ", ".join(f"{size}" for size, _mean in found.groups)
    console.print(f"{len(found.triads)} triads in {len(found.groups)} groups of {sizes or 'none'}")
    if found.plate is None:
        console.print(f"No centre: {found.reason}", markup=False)
        return
    ra, dec = found.plate.center_deg
    console.print(f"Centre: RA {ra:.5f}°, Dec {dec:+.5f}°, after {found.plate.iterations} iterations")
    points = request.point_px(found.picture)
    for (x, y), (ra, dec) in zip(points, found.sky_deg(points), strict=True):
        console.print(f"Point {x:+.2f}, {y:+.2f} from the centre: RA {ra:.5f}°, Dec {dec:+.5f}°")


def _two(text: str, between: str, message: str) -> tuple[float, float]:
    first, _, second = text.partition(between)
    try:
        pair = float(first), float(second)
    except ValueError:
        raise InputError(f"{message}, not '{text}'") from None
    if not all(math.isfinite(value) for value in pair):
        raise InputError(f"{message}, not '{text}'")
    return pair


def _print_table(console: Console, title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left")
    for heading in headings:
        table.add_column(Text(heading), justify="right")
    for row in rows:
        table.add_row(*row)
    console.print(table)
