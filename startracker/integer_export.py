"""Export of the integer tracker as C99 source: constant tables and the algorithm (Yee 1999, section 4.2.5).

`export_c` returns the files: the C sources of ``fixed_point/c/`` with prefixed names, ``<prefix>_tables.h`` and
``<prefix>_tables.c`` with the tables of one camera, sub-catalogue and set of thresholds, a ``main.c`` and a Makefile.
Every buffer has a fixed size, the maximum that these tables require. Only the number of triads that pass all tests can
exceed its buffer, which gives a status.
"""

from __future__ import annotations

from importlib.resources import files
from typing import NamedTuple

import numpy as np

from startracker.errors import InputError
from startracker.fixed_point.arithmetic import SCALE, FixedArithmetic, FixedSky
from startracker.fixed_point.cordic import STEPS_DEG
from startracker.fixed_point.formats import SEPARATION, integers
from startracker.fixed_point.square_root import CROSSOVER
from startracker.fixed_point.tables import arccosine_table, cosine_table, quadrant_table
from startracker.flight.c_table import CTable
from startracker.flight.c_text import CExport, check_prefix, prefixed, tables_header, tables_source
from startracker.identification.integer_solution import IntegerTracker
from startracker.identification.triad_search import TriadLimits
from startracker.identification.triad_tables import TriadTables

MODULES = ("integers", "cordic", "separations", "attitude", "verification", "triads")
"""Modules of the solver that do not depend on the camera: ``<prefix>_<module>.c``."""
_SOURCES = (
    "tracker.h",
    "tracker_internal.h",
    "tracker_integers.h",
    "tracker_cordic.h",
    *(f"tracker_{module}.c" for module in MODULES),
    "main.c",
)
_MAKEFILE = """\
CFLAGS = -std=c99 -O2 -Wall -Wextra -Wpedantic -Wconversion -Werror
OBJECTS = tracker_tables.o {objects}

solve: main.o $(OBJECTS)
\t$(CC) $(CFLAGS) $(LDFLAGS) -o $@ main.o $(OBJECTS)

%.o: %.c tracker.h tracker_internal.h tracker_integers.h tracker_cordic.h tracker_tables.h
\t$(CC) $(CFLAGS) -c -o $@ $<

clean:
\trm -f solve main.o $(OBJECTS)
"""


def export_c(
    tracker: IntegerTracker,
    limits: TriadLimits,
    max_stars: int,
    max_triads: int,
    max_groups: int,
    prefix: str = "tracker",
) -> CExport:
    """Export the tracker of one camera to C.

    Parameters
    ----------
    tracker : IntegerTracker
        Camera and tables.
    limits : TriadLimits
        Thresholds, with one separation tolerance for all pairs.
    max_stars, max_triads, max_groups : int
        Number of brightest points used for triads; capacity for triads; number of groups that are verified.
    prefix : str
        Prefix of all files and names.

    Raises
    ------
    InputError
        A prefix that is not a C identifier; tables of another arithmetic; several separation tolerances; more stars or
        pairs than 16-bit indices can address.
    """
    check_prefix(prefix)
    arithmetic, sky = tracker.tables.arithmetic, tracker.tables.sky
    if not (isinstance(arithmetic, FixedArithmetic) and isinstance(sky, FixedSky)):
        raise InputError("only integer tables can be exported; build them with FixedArithmetic")
    tolerance, window = _pair_window(tracker.tables, arithmetic, limits)
    # The first side of a triangle may be any pair of a window in either order, for which the partners of one star are
    # compared with those of the other.
    triangles = max_stars * (max_stars - 1) * (max_stars - 2) // 6
    most_steps = triangles * 2 * window * _most_partners(tracker.tables, tolerance) ** 2
    sizes = _Sizes(max_stars, max_triads, max_groups, tolerance, window)
    constants, arrays = _constants(tracker, arithmetic, limits, sizes), _arrays(tracker, sky)
    source = {name: (files("startracker.fixed_point") / "c" / name).read_text("utf-8") for name in _SOURCES}
    objects = " ".join(f"tracker_{module}.o" for module in MODULES)
    source["tracker_tables.h"] = tables_header({"MOST_STEPS": f"{most_steps}LL", **constants}, arrays)
    source["tracker_tables.c"] = tables_source(arrays)
    source["Makefile"] = _MAKEFILE.format(objects=objects)
    named = {prefixed(name, prefix): prefixed(text, prefix) for name, text in source.items()}
    return CExport(prefix, named, {table.name: table.bytes for table in arrays}, MODULES, most_steps)


class _Sizes(NamedTuple):
    max_stars: int
    max_triads: int
    max_groups: int
    tolerance: int
    """Tolerance of separations."""
    window: int
    """Maximum number of pairs within the tolerance."""


def _pair_window(tables: TriadTables, arithmetic: FixedArithmetic, limits: TriadLimits) -> tuple[int, int]:
    """Tolerance of separations, and the maximum number of pairs within it."""
    if isinstance(limits.separation_tolerance_deg, tuple):
        raise InputError("the export uses one separation tolerance for all pairs; give one number")
    if len(tables) == 0 or len(tables.first) == 0:
        raise InputError("the sub-catalogue has no pair of stars; raise the magnitude limit or the maximum separation")
    tolerance = arithmetic.separation_of(limits.separation_tolerance_deg)
    # Points may have any separation that the format can express.
    every = np.arange(SEPARATION.largest + 1)
    low, high = tables.windows(every, np.full_like(every, tolerance))
    window = int((high - low).max())
    if len(tables) >= 1 << 16 or 2 * window >= 1 << 16:
        raise InputError(
            f"{len(tables)} stars with up to {window} pairs within the tolerance: more than 16-bit indices can address "
            "(65535 stars, 32767 pairs); use fewer stars or a smaller tolerance"
        )
    return tolerance, window


def _constants(
    tracker: IntegerTracker, arithmetic: FixedArithmetic, limits: TriadLimits, sizes: _Sizes
) -> dict[str, int]:
    """Numbers of the header by name, without the prefix."""
    tables, check = tracker.tables, tracker.verification
    # The same computation as `combine_separation`, with the scale in the format of the C constants.
    scale = SCALE.encode(tracker.camera.scale_deg)
    probe = arithmetic.image([[0.0, 0.0], [limits.combine_px, 0.0], [0.0, limits.combine_px]], scale)
    combine = int(arithmetic.image_separations(probe, [0, 0], [1, 2]).max())
    enclosed = limits.enclosed_tolerance_deg
    return {
        "CATALOG_STARS": len(tables),
        "PAIRS": len(tables.first),
        "GUIDES": len(check.guide),
        "MAX_STARS": sizes.max_stars,
        "MAX_POINTS": len(check.distracting) - 1,
        "MAX_FIELD": check.seeing.shape[1] - 1,
        "MAX_WINDOW": sizes.window,
        "MAX_TRIADS": sizes.max_triads,
        "MAX_GROUPS": sizes.max_groups,
        "ROTATIONS": len(STEPS_DEG),
        "CROSSOVER": CROSSOVER,
        "ARCCOSINE_DISCARDED": arccosine_table()[1],
        "SEPARATION_TOLERANCE": sizes.tolerance,
        "ROTATION_TOLERANCE": arithmetic.angle_of(limits.rotation_tolerance_deg),
        "ENCLOSED_TOLERANCE": -1 if enclosed is None else arithmetic.angle_of(enclosed),
        "GROUPING_TOLERANCE": arithmetic.angle_of(limits.grouping_tolerance_deg),
        "COMBINE_SEPARATION": combine,
        "VOTE_NUMBER": limits.vote_number,
        "THREE_STARS": int(limits.three_stars),
        "SCALE_X": int(scale[0]),
        "SCALE_Y": int(scale[1]),
        "FOCAL": check.focal,
        "RATIO": check.ratio,
        "HALF_X": int(check.half[0]),
        "HALF_Y": int(check.half[1]),
        "GATES": len(check.gates),
        "WIDTHS": len(check.log_cell),
        "SUMS": len(check.sum_table),
        "SAME": check.same,
        "SAME_ROLL": check.same_roll,
        "SPREAD": check.spread,
        "LOG_AREA": check.log_area,
        "LOG_PI": check.log_pi,
        "THRESHOLD": check.threshold,
    }


def _arrays(tracker: IntegerTracker, sky: FixedSky) -> list[CTable]:
    """Constant arrays: functions, the sub-catalogue and its pairs, guide stars, verification."""
    tables, check = tracker.tables, tracker.verification
    return [
        CTable("uint16_t", "cosine", "cosines of 1.15 by angles of 6.10", cosine_table()),
        CTable("int16_t", "arccosine", "degrees of 6.10 by cosines of 1.15", arccosine_table()[0]),
        CTable("uint16_t", "quadrant", "degrees of 10.6 by cosines of 1.15", quadrant_table()),
        CTable("int64_t", "rotation_step", "arctangents of 2^-k, degrees, 40 fraction bits", np.array(STEPS_DEG)),
        CTable("int32_t", "star_number", "catalogue numbers", tables.id),
        CTable("uint16_t", "star_rank", "order of brightness", integers(tables.v_mag)),
        CTable("int32_t", "star_ra", "degrees of 10.22", sky.ra),
        CTable("int32_t", "star_dec", "degrees of 10.22", sky.dec),
        CTable("int32_t", "star_direction", "unit vectors of 2.30", sky.directions),
        CTable("int16_t", "pair_separation", "degrees of 6.10, ascending", tables.separation),
        CTable("uint16_t", "pair_first", "indices of stars", tables.first),
        CTable("uint16_t", "pair_second", "indices of stars", tables.second),
        CTable("int32_t", "guide_direction", "guide stars, brightest first: unit vectors of 2.30", check.guide),
        CTable("int32_t", "guide_number", "their catalogue numbers", tracker.guide_number),
        CTable("uint16_t", "guide_of_star", "guide star of each star", tracker.guide_of_star),
        CTable("int64_t", "gate", "squared matching radii, units of the plane", check.gates),
        CTable("int32_t", "log_cell", "log2 of 2 pi sigma^2, of each width", check.log_cell),
        CTable("int64_t", "quadratic", "log2(e) / 2 sigma^2, 32 fraction bits", check.quadratic),
        CTable("int64_t", "farthest", "largest squared distance", check.farthest),
        CTable("int32_t", "log_volume", "log2 of prior and volume", check.log_volume),
        CTable("int16_t", "log_table", "log2(1 + k / 256)", check.log_table),
        CTable("int16_t", "sum_table", "log2(1 + 2^-x)", check.sum_table),
        CTable("int32_t", "distracting", "log2 of the weight of k false stars", check.distracting),
        CTable("int32_t", "seeing", "log2 of the weight of m stars detected and k not", check.seeing),
        CTable("int32_t", "total", "log2 of the total weight, n points, up to k guide stars", check.total),
    ]


def _most_partners(tables: TriadTables, tolerance: int) -> int:
    """Maximum number of partners of any star within a window of separations."""
    star = np.concatenate([tables.first, tables.second])
    separation = np.concatenate([tables.separation, tables.separation])
    order = np.lexsort((separation, star))
    # One ascending sequence for all stars: separations have 16 bits, so that no window reaches the next star.
    codes = star[order] * (1 << 20) + separation[order]
    return int((np.searchsorted(codes, codes + 2 * tolerance, side="right") - np.arange(len(codes))).max())
