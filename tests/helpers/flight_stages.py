"""The C of a flight build as a library, with access to its whole answers and to its stages one by one.

Functions that are static in a source are reached by text that is appended to that source.
"""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.study.flight.library import NO_PRIOR, FlightLibrary, Known
from simulator.study.flight.program import ProgramAnswer
from startracker.flight.design import FlightDesign
from startracker.flight.export import FlightTables, assemble, flight_parts, flight_tables
from startracker.flight.stars import StarList

ONE = 1 << 30
OPTIONS = ("-std=c99", "-O1", "-ffp-contract=off", "-fPIC", "-shared")
_SEARCH = r"""
#include "tracker_directions.h"
unsigned long stage_bytes(void);
int stage_begin(struct tracker_search *s, const int64_t *list, int count, const int32_t *observer);
void stage_stars(const struct tracker_search *s, int64_t *out);
unsigned long stage_bytes(void)
{
    return sizeof(struct tracker_search);
}
/* The stars of a list (x, y, flux, variance, flags), their sides and their crowding. */
int stage_begin(struct tracker_search *s, const int64_t *list, int count, const int32_t *observer)
{
    struct tracker_star star[TRACKER_MAX_STARS];
    struct tracker_vector direction[TRACKER_MAX_STARS];
    uint8_t seen[TRACKER_MAX_STARS];
    int k;
    for (k = 0; k < count; k++) {
        star[k].x = (int32_t)list[5 * k];
        star[k].y = (int32_t)list[5 * k + 1];
        star[k].flux = (int32_t)list[5 * k + 2];
        star[k].variance = (uint32_t)list[5 * k + 3];
        seen[k] = (uint8_t)tracker_star_vector(&star[k], &direction[k]);
    }
    take_stars(s, star, direction, seen, count);
    measure_sides(s);
    tracker_crowding(s);
    s->observer.velocity.x = observer[0];
    s->observer.velocity.y = observer[1];
    s->observer.velocity.z = observer[2];
    s->observer.years = observer[3];
    s->prior.radius = 0;
    s->kept = s->cut_short = 0;
    s->rest = TRACKER_SEARCH_NEVER;
    s->gain = s->steps = 0;
    return s->count;
}
/* Index, direction, variance and magnitude of each star; brightness; chord and error of the pairs i > j. */
void stage_stars(const struct tracker_search *s, int64_t *out)
{
    int i, j;
    for (i = 0; i < s->count; i++) {
        *out++ = s->index[i];
        *out++ = s->direction[i].x;
        *out++ = s->direction[i].y;
        *out++ = s->direction[i].z;
        *out++ = s->variance[i];
        *out++ = s->magnitude[i];
    }
    *out++ = s->brightness;
    for (i = 0; i < s->count && i < TRACKER_SEARCH_SIDE_STARS; i++)
        for (j = 0; j < i; j++) {
            *out++ = s->chord[tracker_side_of(i, j)];
            *out++ = s->error[tracker_side_of(i, j)];
        }
}
"""
_VERIFY = r"""
int stage_field(struct tracker_search *s, const struct tracker_matrix *matrix, int most, int64_t *out);
int stage_weigh(struct tracker_search *s, const struct tracker_matrix *matrix, int most, int gate, int64_t *out);
void stage_verify(struct tracker_search *s, const struct tracker_matrix *matrix, int gates, int64_t *out);
/* Number, direction and magnitude of the guide stars of a field; how many. */
int stage_field(struct tracker_search *s, const struct tracker_matrix *matrix, int most, int64_t *out)
{
    int k;
    find_field(s, matrix, most);
    for (k = 0; k < s->field.depth; k++) {
        *out++ = s->field.guide[k];
        *out++ = s->field.direction[k].x;
        *out++ = s->field.direction[k].y;
        *out++ = s->field.direction[k].z;
        *out++ = tracker_guide_magnitude[s->field.guide[k]];
    }
    return s->field.depth;
}
/* Evidence of the match within a gate, and the guide star of the field of each star; how many match. */
int stage_weigh(struct tracker_search *s, const struct tracker_matrix *matrix, int most, int gate, int64_t *out)
{
    struct normal normal;
    int k, width;
    find_field(s, matrix, most);
    predict(&s->field, matrix);
    match(s, gate);
    if (s->field.matched < 3)
        return s->field.matched;
    make_normal(s, &normal);
    *out++ = tracker_weigh(s, log_determinant(&normal), &width);
    for (k = 0; k < s->count; k++)
        *out++ = s->field.rank[k];
    return s->field.matched;
}
void stage_verify(struct tracker_search *s, const struct tracker_matrix *matrix, int gates, int64_t *out)
{
    struct tracker_hypothesis found = {0};
    int k;
    tracker_verify(s, matrix, gates, &found);
    *out++ = found.evidence;
    for (k = 0; k < 3; k++) {
        *out++ = found.attitude.row[k].x;
        *out++ = found.attitude.row[k].y;
        *out++ = found.attitude.row[k].z;
    }
}
"""
_CANDIDATES = r"""
int stage_candidates(struct tracker_search *s, int pole, int row, int64_t *out);
/* Neighbour, guide stars of pole and neighbour, third star, and agreeing votes of the candidates of a pole. */
int stage_candidates(struct tracker_search *s, int pole, int row, int64_t *out)
{
    const struct tracker_source *source = &s->work.source;
    int k;
    vote_about(s, pole, tracker_search_row[row], (int64_t)1 << 40);
    for (k = 0; k < source->candidates; k++) {
        *out++ = source->candidate[k].neighbour;
        *out++ = source->candidate[k].guide[0];
        *out++ = source->candidate[k].guide[1];
        *out++ = source->candidate[k].third;
        *out++ = source->candidate[k].agreeing;
    }
    return source->candidates;
}
"""
_PAIR = r"""
int stage_pair_frame(const int64_t *p, const int64_t *q, int64_t *out);
int stage_pair_frame(const int64_t *p, const int64_t *q, int64_t *out)
{
    return pair_frame(p, q, (int64_t(*)[3])out);
}
"""
_TRIADS = r"""
int stage_triads(struct tracker_search *s, int row, int64_t *out);
int stage_bearing(const int64_t *p, const int64_t *q);
/* Stars, guide stars and rotation of the triads of a search. */
int stage_triads(struct tracker_search *s, int row, int64_t *out)
{
    struct tracker_source *source = &s->work.source;
    const int stars = s->count < TRACKER_TRIAD_STARS ? s->count : TRACKER_TRIAD_STARS;
    int pole, k, n;
    source->triads = source->full = 0;
    for (pole = 0; pole < stars - 2; pole++)
        find_about(s, pole, tracker_search_row[row], (int64_t)1 << 40);
    for (n = 0; n < source->triads; n++) {
        for (k = 0; k < 3; k++)
            *out++ = source->triad[n].star[k];
        for (k = 0; k < 3; k++)
            *out++ = source->triad[n].guide[k];
        *out++ = source->triad[n].rotation;
    }
    return source->triads;
}
int stage_bearing(const int64_t *p, const int64_t *q)
{
    return image_bearing(p, q);
}
"""
_TRIAD_VOTES = r"""
void stage_elect(struct tracker_search *s, const int64_t *triad, int triads, int stars, int needed, int64_t *winner);
int stage_drop(struct tracker_search *s, int stars, const int64_t *winner, const int64_t *agree, int64_t *left);
/* Winners of the votes of triads, all of one group. */
void stage_elect(struct tracker_search *s, const int64_t *triad, int triads, int stars, int needed, int64_t *winner)
{
    struct tracker_source *source = &s->work.source;
    int n, k;
    source->triads = triads;
    source->group[0].count = triads;
    for (n = 0; n < triads; n++) {
        source->triad[n].group = 0;
        for (k = 0; k < 3; k++) {
            source->triad[n].star[k] = (uint8_t)triad[6 * n + k];
            source->triad[n].guide[k] = (uint16_t)triad[6 * n + 3 + k];
        }
    }
    elect_winners(s, 0, stars, needed);
    for (k = 0; k < stars; k++)
        winner[k] = source->winner[k];
}
/* Winners that are left if separations agree as told: as long as those of the guide stars, or zero. */
int stage_drop(struct tracker_search *s, int stars, const int64_t *winner, const int64_t *agree, int64_t *left)
{
    int i, j, k, count;
    for (i = 0; i < stars; i++)
        s->work.source.winner[i] = (int32_t)winner[i];
    for (i = 0; i < stars; i++)
        for (j = 0; j < i; j++) {
            int64_t square = 0;
            for (k = 0; k < 3; k++) {
                const int64_t there = tracker_guide_direction[winner[j]][k];
                const int64_t apart = tracker_guide_direction[winner[i]][k] - there;
                square += apart * apart;
            }
            s->chord[tracker_side_of(i, j)] = agree[stars * i + j] ? (uint32_t)tracker_square_root(square) : 0;
            s->error[tracker_side_of(i, j)] = 1 << 10;
        }
    count = drop_disagreeing(s, stars, tracker_search_row[0][TRACKER_ROW_SIDES]);
    for (i = 0; i < stars; i++)
        left[i] = s->work.source.winner[i];
    return count;
}
"""
WRAPPERS = {
    "adaptive": {"search": _SEARCH, "verify": _VERIFY, "pair": _PAIR, "candidates": _CANDIDATES},
    "triads": {"search": _SEARCH, "triads": _TRIADS, "triad_votes": _TRIAD_VOTES},
}


class Stars(NamedTuple):
    """The stars that a search uses, in its units."""

    index: NDArray[np.int64]
    direction: NDArray[np.int64]
    variance: NDArray[np.int64]
    magnitude: NDArray[np.int64]
    brightness: bool
    chord: NDArray[np.int64]
    error: NDArray[np.int64]
    """Of all pairs, (N, N)."""


class CompiledFlight(FlightLibrary):
    """The C of a design.

    Parameters
    ----------
    design : FlightDesign
    folder : Path
    tables : FlightTables, optional
        In place of those of the design.
    """

    def __init__(
        self,
        design: FlightDesign,
        folder: Path,
        tables: FlightTables | None = None,
        compiler: str = "gcc",
        extra: Sequence[str] = (),
        replaced: Sequence[tuple[str, str, str]] = (),
    ) -> None:
        self.design, self.tables = design, tables or flight_tables(design)
        sources = assemble(design, flight_parts(self.tables), "tracker", "").files
        wrappers = WRAPPERS[design.identifier]
        texts = {name: text for name, text in sources.items() if name.startswith("tracker")}
        texts["library.c"] = (files("simulator.study.flight") / "library.c").read_text("utf-8")
        for module, text in wrappers.items():
            texts[f"tracker_{module}.c"] += text
        for name, old, new in replaced:
            assert old in texts[name], (name, old)
            texts[name] = texts[name].replace(old, new)
        folder.mkdir(exist_ok=True)
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        units = [str(folder / name) for name in texts if name.endswith(".c")]
        out = folder / "flight.so"
        command = [compiler, *OPTIONS, *extra, "-o", str(out), *units, "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        super().__init__(out)
        self.c = self._c
        self.c.stage_bytes.restype = ctypes.c_ulong
        self._search = (ctypes.c_int64 * (-(-self.c.stage_bytes() // 8)))()

    # ------------------------------------------------------------------ whole answers
    def solve_list(
        self,
        stars: StarList,
        *,
        velocity: ArrayLike | None = None,
        epoch: int | None = None,
        prior: tuple[NDArray[np.int64], int] | None = None,
    ) -> ProgramAnswer:
        """Answer of a list; the prior is a matrix of 2.30 and a radius of 28 fraction bits."""
        beta = (0, 0, 0) if velocity is None else np.asarray(velocity).tolist()
        given = NO_PRIOR if prior is None else (*prior[0].ravel().tolist(), prior[1])
        return self.solve_stars(stars, Known(beta, epoch or 0, 0, given))[0]

    # ------------------------------------------------------------------ stages of the search
    def begin(self, stars: StarList) -> Stars:
        """The stars of a list that the search uses; the state of the search is then that of this list."""
        rows = np.ascontiguousarray(np.column_stack(stars), np.int64)
        count = self.c.stage_begin(self._search, pointer(rows), len(rows), (ctypes.c_int32 * 4)())
        pairs = count * (count - 1) // 2
        out = np.zeros(6 * count + 1 + 2 * pairs, np.int64)
        self.c.stage_stars(self._search, pointer(out))
        each, sides = out[: 6 * count].reshape(count, 6), out[6 * count + 1 :].reshape(pairs, 2)
        chord, error = np.zeros((2, count, count), np.int64)
        lower = np.tril_indices(count, -1)
        for square, column in ((chord, 0), (error, 1)):
            square[lower] = sides[:, column]
            square += square.T
        return Stars(each[:, 0], each[:, 1:4], each[:, 4], each[:, 5], bool(out[6 * count]), chord, error)

    def rows(self, name: str, columns: int, *arguments: Any, most: int = 20_000) -> NDArray[np.int64]:
        """Rows that a function of the search writes, whose result is their number."""
        out = np.zeros((most, columns), np.int64)
        count = getattr(self.c, name)(self._search, *arguments, pointer(out))
        return out[:count]

    def call(self, name: str, out: NDArray[np.int64], *arguments: Any) -> int:
        """Result of a function of the search that writes an array."""
        return int(getattr(self.c, name)(self._search, *arguments, pointer(out)))


def pointer(values: NDArray[Any]) -> ctypes.c_void_p:
    """Address of an array, with a reference to it."""
    return values.ctypes.data_as(ctypes.c_void_p)


def matrix_of(values: ArrayLike) -> Any:
    """``struct tracker_matrix`` of a matrix of 2.30."""
    return (ctypes.c_int32 * 9)(*np.asarray(values).ravel().tolist())


def integers(matrix: ArrayLike) -> NDArray[np.int64]:
    """A matrix or vector as integers of 2.30."""
    return np.rint(np.asarray(matrix) * ONE).astype(np.int64)
