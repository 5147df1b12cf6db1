"""``boresight study yee1999`` of one picture: its options checked, its tables printed and written."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from simulator.cli.centroid_list import parse_pixel, parse_size, read_centroids
from simulator.cli.checks import writable
from simulator.cli.printed_command import WIDTH, PictureRequest, finish
from simulator.cli.terminal import open_console, print_table
from simulator.paths import write_atomically
from simulator.theses.yee1999.catalogue import EDITIONS
from simulator.theses.yee1999.fixed_point.arithmetic import FixedArithmetic
from simulator.theses.yee1999.fixed_point.formats import FixedPointOverflow
from simulator.theses.yee1999.picture import Analysis, Options, Picture, analyse, centred, step_tables, vega
from startracker.errors import InputError
from startracker.identification.triad_search import TriadLimits

if TYPE_CHECKING:
    from rich.console import Console


def main(request: PictureRequest) -> int:
    """The picture analysed and its tables printed; without centroids the tables of the thesis too.

    Returns
    -------
    int
        Exit status 0, or 1 where the picture has no centre.
    """
    from simulator.theses import yee1999

    analysis = run_picture(request)
    report(analysis, request, open_console(WIDTH))
    if request.centroids is None:
        folder = request.out or Path("out") / "yee1999"
        section = request.section
        finish(lambda progress: yee1999.run(section, progress, analysis), "yee1999", section, folder, request.force)
    return 0 if analysis.plate is not None else 1


def _options(request: PictureRequest) -> Options:
    """Sub-catalogue, thresholds and arithmetic; `InputError` for values that cannot be."""
    for name in ("separation", "rotation", "enclosed", "grouping"):
        value = getattr(request, f"{name}_tolerance_deg")
        if not 0.0 < value < 180.0:
            raise InputError(f"--{name}-tolerance-deg: must be between 0 and 180 degrees, not {value:g}")
    if request.vote_number < 1 or not 0.0 < request.tau_px < math.inf:
        raise InputError(
            f"--vote-number and --tau-px: must be positive, not {request.vote_number} and {request.tau_px:g}"
        )
    if not math.isfinite(request.magnitude_limit):
        raise InputError("--magnitude-limit: must be a number")
    return Options(
        edition=request.edition if request.edition is not None else EDITIONS[request.centroids is not None],
        magnitude_limit=request.magnitude_limit,
        dec_range_deg=_two(request.dec, ":", "--dec: must be MIN:MAX in degrees, such as 30:90"),
        max_separation_deg=request.max_separation_deg,
        limits=TriadLimits(
            separation_tolerance_deg=request.separation_tolerance_deg,
            rotation_tolerance_deg=request.rotation_tolerance_deg,
            enclosed_tolerance_deg=request.enclosed_tolerance_deg,
            grouping_tolerance_deg=request.grouping_tolerance_deg,
            vote_number=request.vote_number,
            combine_px=request.tau_px,
            three_stars=request.three_stars,
        ),
        arithmetic=FixedArithmetic() if request.integers else None,
    )


def _picture(request: PictureRequest) -> Picture:
    """The centroids asked for, or the Vega image; `InputError` for a file, a size or a field that cannot be."""
    if request.centroids is None:
        if request.size is not None or request.fov is not None:
            raise InputError("--size and --fov: belong to --centroids FILE.csv; the Vega image has its own")
        return vega()
    if request.size is None or request.fov is None:
        raise InputError("--centroids: needs --size WxH and --fov XxY (degrees across and down)")
    size = parse_size(request.size)
    field = _two(request.fov.lower(), "x", "--fov: must be ACROSSxDOWN in degrees, such as 9.0130x6.9049")
    if not (0.0 < field[0] < 120.0 and 0.0 < field[1] < 120.0):
        raise InputError(f"--fov: must be between 0 and 120 degrees, not {request.fov}")
    xy, flux = read_centroids(request.centroids)
    if flux is not None:
        xy = xy[np.argsort(-flux, kind="stable")]
    return Picture(centred(xy, size, request.origin), size, field)


def _point_px(request: PictureRequest, picture: Picture) -> NDArray[np.float64]:
    """Points asked for (N, 2), from the image's centre with y up."""
    points = np.array([parse_pixel(text) for text in request.points or ()]).reshape(-1, 2)
    origin = "centre" if request.centroids is None and request.origin == "auto" else request.origin
    return centred(points, picture.size_px, origin)


def run_picture(request: PictureRequest) -> Analysis:
    """The picture through the method; its JSON file, where asked for, is written.

    Raises
    ------
    InputError
        What cannot be asked for.
    """
    writable(request.json_file)
    picture = _picture(request)
    points = _point_px(request, picture)
    try:
        found = analyse(picture, _options(request))
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
        print_table(console, Text(title), [Text(heading) for heading in headings], rows, words=0)
    sizes = ", ".join(f"{size}" for size, _mean in found.groups)
    console.print(f"{len(found.triads)} triads in {len(found.groups)} groups of {sizes or 'none'}")
    if found.plate is None:
        console.print(f"No centre: {found.reason}", markup=False)
        return
    ra, dec = found.plate.center_deg
    console.print(f"Centre: RA {ra:.5f}°, Dec {dec:+.5f}°, after {found.plate.iterations} iterations")
    points = _point_px(request, found.picture)
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
