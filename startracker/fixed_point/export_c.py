"""The integer tracker as C99 source: tables as constant arrays, and the algorithm (Yee 1999, section 4.2.5).

`export_c` returns the files: the C of ``c/`` as it is, ``tables.h`` and ``tables.c`` with the numbers of one
camera, sub-catalogue and set of thresholds, and a Makefile. Every buffer has a fixed size, the largest that these
tables can ask for; only triads that pass all tests may be too many, which is a status.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.errors import InputError
from startracker.fixed_point.arithmetic import FULL_TURN, SCALE, FixedArithmetic, FixedSky
from startracker.fixed_point.cordic import STEPS_DEG
from startracker.fixed_point.formats import SEPARATION, integers
from startracker.fixed_point.square_root import CROSSOVER
from startracker.fixed_point.tables import arccosine_table, cosine_table, quadrant_table

if TYPE_CHECKING:
    from startracker.identification.triad_search import TriadLimits
    from startracker.identification.triad_tables import TriadTables

__all__ = ["SOURCES", "CExport", "export_c"]

SOURCES = ("tracker.h", "integers.c", "attitude.c", "triads.c", "main.c")
"""Files that are the same for every camera."""
_MAKEFILE = """\
CFLAGS = -std=c99 -O2 -Wall -Wextra -Werror
OBJECTS = tables.o integers.o attitude.o triads.o main.o

solve: $(OBJECTS)
\t$(CC) $(CFLAGS) $(LDFLAGS) -o $@ $(OBJECTS)

%.o: %.c tracker.h tables.h
\t$(CC) $(CFLAGS) -c -o $@ $<

clean:
\trm -f solve $(OBJECTS)
"""


@dataclass(frozen=True)
class CExport:
    """Source files, and what their tables take.

    Parameters
    ----------
    files : dict of str to str
        Name to text.
    table_bytes : dict of str to int
        Array to its size.
    """

    files: dict[str, str]
    table_bytes: dict[str, int]


def export_c(
    tables: TriadTables, scale_deg: ArrayLike, limits: TriadLimits, max_stars: int, max_triads: int
) -> CExport:
    """Write the tracker of one camera in C.

    Parameters
    ----------
    tables : TriadTables
        Of `startracker.identification.integer_solution.integer_tables`.
    scale_deg : array_like, shape (2,)
        Degrees a pixel, across and down.
    limits : TriadLimits
        Thresholds, one separation tolerance for all pairs.
    max_stars, max_triads : int
        Brightest stars that are matched; triads that there is room for.

    Raises
    ------
    InputError
        Tables of another arithmetic, several separation tolerances, more stars or pairs than 16-bit indices reach.
    """
    arithmetic, sky = tables.arithmetic, tables.sky
    if not (isinstance(arithmetic, FixedArithmetic) and isinstance(sky, FixedSky)):
        raise InputError("only tables of integers can be exported; build them with FixedArithmetic")
    if isinstance(limits.separation_tolerance_deg, tuple):
        raise InputError("the export has one separation tolerance for all pairs; give one number")
    if len(tables) == 0 or len(tables.first) == 0:
        raise InputError("the sub-catalogue has no pair of stars; raise the magnitude limit or the largest separation")
    tolerance = arithmetic.separation_of(limits.separation_tolerance_deg)
    every = np.arange(SEPARATION.largest + 1)
    low, high = tables.windows(every, np.full_like(every, tolerance))
    window = int((high - low).max())
    if len(tables) >= 1 << 16 or 2 * window >= 1 << 16:
        raise InputError(
            f"{len(tables)} stars with up to {window} pairs within the tolerance: more than 16-bit indices reach "
            "(65535 stars, 32767 pairs); take fewer stars or a smaller tolerance"
        )
    # the same words as `combine_separation`, which this package cannot import
    scale = SCALE.encode(scale_deg)
    probe = arithmetic.image([[0.0, 0.0], [limits.combine_px, 0.0], [0.0, limits.combine_px]], scale)
    combine = int(arithmetic.image_separations(probe, [0, 0], [1, 2]).max())
    enclosed = limits.enclosed_tolerance_deg
    arccosine, discarded = arccosine_table()
    constants = {
        "CATALOG_STARS": len(tables),
        "PAIRS": len(tables.first),
        "MAX_STARS": max_stars,
        "MAX_WINDOW": window,
        "MAX_TRIADS": max_triads,
        "ROTATIONS": len(STEPS_DEG),
        "FULL_TURN": FULL_TURN,
        "CROSSOVER": CROSSOVER,
        "ARCCOSINE_DISCARDED": discarded,
        "SEPARATION_TOLERANCE": tolerance,
        "ROTATION_TOLERANCE": arithmetic.angle_of(limits.rotation_tolerance_deg),
        "ENCLOSED_TOLERANCE": -1 if enclosed is None else arithmetic.angle_of(enclosed),
        "GROUPING_TOLERANCE": arithmetic.angle_of(limits.grouping_tolerance_deg),
        "COMBINE_SEPARATION": combine,
        "VOTE_NUMBER": limits.vote_number,
        "THREE_STARS": int(limits.three_stars),
        "SCALE_X": int(scale[0]),
        "SCALE_Y": int(scale[1]),
    }
    arrays = [
        _Table("uint16_t", "cosine", "cosines of 1.15 by angles of 6.10", cosine_table()),
        _Table("int16_t", "arccosine", "degrees of 6.10 by cosines of 1.15", arccosine),
        _Table("uint16_t", "quadrant", "degrees of 10.6 by cosines of 1.15", quadrant_table()),
        _Table("int64_t", "rotation_step", "arctangents of 2^-k, degrees, 40 bits of fraction", np.array(STEPS_DEG)),
        _Table("int32_t", "star_number", "catalogue numbers", tables.id),
        _Table("uint16_t", "star_rank", "order of brightness", integers(tables.v_mag)),
        _Table("int32_t", "star_ra", "degrees of 10.22", sky.ra),
        _Table("int32_t", "star_dec", "degrees of 10.22", sky.dec),
        _Table("int32_t", "star_direction", "unit vectors of 2.30", sky.directions),
        _Table("int16_t", "pair_separation", "degrees of 6.10, ascending", tables.separation),
        _Table("uint16_t", "pair_first", "places of stars", tables.first),
        _Table("uint16_t", "pair_second", "places of stars", tables.second),
    ]
    head = ["/* Numbers of one camera and sub-catalogue; made by boresight export-c. */", "#ifndef TABLES_H"]
    head += ["#define TABLES_H", "", "#include <stdint.h>", ""]
    head += [f"#define {name} {value}" for name, value in constants.items()]
    head += ["", *(f"extern {table.declaration}; /* {table.meaning} */" for table in arrays), "", "#endif", ""]
    body = ['#include "tables.h"', "", *(line for table in arrays for line in table.definition()), ""]
    source = {name: (files("startracker.fixed_point") / "c" / name).read_text("utf-8") for name in SOURCES}
    made = {"tables.h": "\n".join(head), "tables.c": "\n".join(body), "Makefile": _MAKEFILE}
    return CExport(source | made, {table.name: table.bytes for table in arrays})


@dataclass(frozen=True)
class _Table:
    """A constant array of C."""

    type: str
    name: str
    meaning: str
    values: NDArray[np.int64]

    @property
    def bytes(self) -> int:
        return int(np.dtype(self.type[:-2]).itemsize * self.values.size)

    @property
    def declaration(self) -> str:
        return f"const {self.type} {self.name}" + "".join(f"[{n}]" for n in self.values.shape)

    def definition(self) -> Iterable[str]:
        """Its lines; every value is checked against the type's range."""
        limits = np.iinfo(self.type[:-2])
        if self.values.min() < limits.min or self.values.max() > limits.max:
            raise InputError(f"{self.name}: {self.values.min()} to {self.values.max()} does not fit {self.type}")
        yield f"{self.declaration} = {{"
        if self.values.ndim == 2:
            yield from (f"    {{{', '.join(map(str, row))}}}," for row in self.values.tolist())
        else:
            flat = self.values.tolist()
            yield from (f"    {', '.join(map(str, flat[n : n + 12]))}," for n in range(0, len(flat), 12))
        yield "};"
