"""Macros and constant arrays of the identification in C."""

from __future__ import annotations

import numpy as np

from startracker.flight import apparent, search_plan, search_tables, triad_numbers
from startracker.flight.c_table import CTable
from startracker.flight.integers import ROTATION_STEPS
from startracker.flight.search_tables import SearchTables
from startracker.flight.triad_numbers import TriadNumbers, triad_constants

GATES = (
    ((1016064, 254016), (28224, 28224), (3318, 3318)),
    ((5308416, 1327104), (147456, 147456), (16384, 16384), (3318, 3318)),
)
"""Squares of the gates in units of the stated variances, 8 fraction bits, of the first round and of the others: 4.5
times 14, 7, 7/3 and 0.8 stated errors; 4.5 times 32, 16, 16/3, 16/9 and 0.8."""
SEARCHES = 3
"""Most searches of a frame: within a prior, over the whole sky, and of what an attitude leaves unexplained."""
ROUNDS, VERIFICATION_STEPS = 5, 500
"""Most rounds of a gate; steps of a verification besides those that grow with the numbers of stars."""
KEPT = 8
"""Hypotheses that are kept."""
MOST_CANDIDATES, MOST_OTHERS = 48, 48
"""Candidates about a pole, and stars that may confirm one."""
MOST_VOTES, MOST_COUNT = 1024, 255
"""Votes that there is room for at a time, and that are counted for a guide star."""
CANDIDATE_STEPS, STAR_STEPS = 30, 60
"""Of a candidate, and of each star that may confirm it."""
VOTE_STEPS, TRIAD_STEPS = 3, 300
"""Of two votes that are compared, and of three sides that agree."""
_SHARED = ("integers", "directions", "evidence", "verify", "votes", "pair")
_SOURCES = {"adaptive": ("confirm", "candidates"), "triads": ("cordic", "triads", "triad_votes")}


def search_modules(t: SearchTables) -> tuple[str, ...]:
    """Sources of an identification."""
    return (*_SHARED, *_SOURCES[t.identifier], "search")


def search_constants(t: SearchTables) -> dict[str, int]:
    """Numbers of the header by name, without the prefix."""
    return {
        "EPOCH": t.epoch,
        "MOST_YEARS": apparent.MOST_YEARS,
        **(_adaptive_constants(t) if t.triads is None else _triad_constants(t.triads)),
        "SEARCH_GUIDES": len(t.guide),
        "SEARCH_PAIRS": len(t.first),
        "SEARCH_BINS": len(t.bin_start) - 1,
        "SEARCH_BIN_SHIFT": t.bin_shift,
        "SEARCH_LONGEST": t.longest,
        "SEARCH_COLUMNS": search_tables.COLUMNS,
        "SEARCH_COLUMN_SHIFT": search_tables.COLUMN_SHIFT,
        "SEARCH_QUADRANT": search_tables.QUADRANT,
        "SEARCH_LEAST_COSINE": t.least_cosine,
        "SEARCH_FIELD_CHORD": t.field_chord,
        "SEARCH_PIXEL2": t.pixel2,
        "SEARCH_LOG_AREA": t.log_area,
        "SEARCH_LOG_AREA_UP": t.log_area_up,
        "SEARCH_LOG_RATE": t.log_rate,
        "SEARCH_LEAST_STARS": t.least_stars,
        "SEARCH_MAX_DEPTH": t.seeing.shape[1] - 1,
        "SEARCH_SUMS": len(t.sum_table),
        "SEARCH_CROWD_ENTRIES": len(t.crowd_table),
        "SEARCH_CROWD_FROM": search_tables.CROWD_FROM,
        "SEARCH_CROWD_STEP_BITS": search_tables.CROWD_STEP_BITS,
        "SEARCH_EVEN_SHARE": search_tables.EVEN_SHARE_LOG,
        "SEARCH_SPREAD_SHARE": search_tables.SPREAD_SHARE_LOG,
        "SEARCH_COUNT_BITS": search_tables.COUNT_BITS,
        "SEARCH_DENSITY_ENTRIES": t.density_table.shape[1],
        "SEARCH_DENSITY_FLOOR": int(search_tables.FLOOR * (1 << search_tables.DENSITY_BITS)),
        "SEARCH_WIDTHS": len(t.log_scale2),
        "SEARCH_MAGNITUDE_TOLERANCE": t.magnitude_tolerance,
        "SEARCH_GATES": max(map(len, GATES)),
        "SEARCH_ROWS": len(t.searches),
        "SEARCH_QUICK": t.quick,
        "SEARCH_FIXED_ERROR": 0 if t.triads is None else t.triads.fixed,
        "SEARCH_KEPT": KEPT,
        "SEARCH_MOST_NEIGHBOURS": _most_neighbours(t),
        "SEARCH_MOST_VOTES": MOST_VOTES,
        "SEARCH_MOST_KEPT": t.most_kept,
        "SEARCH_MOST_COUNT": MOST_COUNT,
        "SEARCH_MOST_STEPS": _most_steps(t),
    }


def _adaptive_constants(t: SearchTables) -> dict[str, int]:
    return {
        "SEARCH_SIDE_STARS": t.most_stars,
        "SEARCH_CHANCES": t.needed.shape[0],
        "SEARCH_MOST_NEEDED": t.needed.shape[1],
        "SEARCH_MOST_CANDIDATES": MOST_CANDIDATES,
    }


def _triad_constants(t: TriadNumbers) -> dict[str, int]:
    return {"SEARCH_SIDE_STARS": t.stars, "ROTATIONS": len(ROTATION_STEPS), **triad_constants(t)}


def _most_neighbours(t: SearchTables) -> int:
    return max(one.neighbours for one in t.searches)


def _most_steps(t: SearchTables) -> int:
    """Bound on the steps of an identification: a search ends with the pass, or the verification, that exceeds its own.

    Around a prior, there is a second one over the whole sky, and another one of the stars that are not explained.
    """
    stars, depth = t.most_stars, t.seeing.shape[1] - 1
    windows = 2 * _most_neighbours(t) * len(t.first)
    compared = MOST_VOTES * (MOST_COUNT - 1)
    rounds = ROUNDS * max(map(len, GATES))
    verification = VERIFICATION_STEPS + (rounds + 14 * max(map(len, GATES))) * stars * depth
    if t.triads is None:
        a_pass = windows + 4 * compared
        hypothesis = CANDIDATE_STEPS + STAR_STEPS * MOST_OTHERS + verification
    else:
        a_pass = windows + (VOTE_STEPS + TRIAD_STEPS) * compared // 2
        a_pass += triad_numbers.MOST_GROUPS * _group_steps(t.triads.room, 0, 0)
        hypothesis = _group_steps(0, t.triads.room, triad_numbers.MOST_NAMED)
        hypothesis += triad_numbers.MOST_CHECKED * verification
    beyond = len(t.guide) + windows + a_pass + hypothesis
    return int(SEARCHES * (verification + sum(one.steps + beyond for one in t.searches)))


def _group_steps(triads: int, members: int, named: int) -> int:
    """Steps of the votes of a group."""
    return (2 * triads + 3 * members * named) >> 3


def search_arrays(t: SearchTables) -> list[CTable]:
    """Constant arrays: guide stars, pairs, grid, outline, evidence, searches."""
    gates = np.zeros((len(GATES), max(map(len, GATES)), 2), np.int64)
    for row, steps in enumerate(GATES):
        gates[row, : len(steps)] = steps
    named = [
        ("int32_t", "guide_direction", "guide stars, brightest first: unit vectors of 2.30", t.guide),
        ("int16_t", "guide_motion", "their proper motions a Julian year, unit vectors of 29 fraction bits", t.motion),
        ("int16_t", "guide_magnitude", "their V, 6 fraction bits", t.magnitude),
        ("int32_t", "guide_number", "their catalogue numbers", t.number),
        ("uint16_t", "first", "guide stars of the pairs, by bins of their chords", t.first),
        ("uint16_t", "second", "the same", t.second),
        ("uint32_t", "bin_start", "first pair of each bin", t.bin_start),
        ("uint16_t", "column_start", "first entry of each column of the grid", t.column_start),
        ("uint16_t", "column_star", "guide stars of the columns", t.column_star),
        ("int32_t", "outline_axes", "axes of the outline, 2.30", t.outline_axes),
        ("int32_t", "outline", "least cosine from the image's centre, 2.30", t.outline),
        ("int16_t", "log", "log2(1 + k / 256)", t.log_table),
        ("int16_t", "sum", "log2(1 + 2^-x)", t.sum_table),
        ("int32_t", "crowd", "1 / (1 + x)^2, 30 fraction bits", t.crowd_table),
        ("int32_t", "density", "densities of magnitudes, 20 fraction bits", t.density_table),
        ("int16_t", "distracting", "log2 of the weight of k false stars, 6 fraction bits", t.distracting),
        ("int16_t", "seeing", "log2 of the weight of m stars detected and k not, 6 fraction bits", t.seeing),
        ("int16_t", "total", "log2 of the total weight, n stars, up to k guide stars", t.total),
        ("int32_t", "log_scale2", "log2 of the squared width", t.log_scale2),
        ("int32_t", "quadratic", "log2(e) / 2 over the squared width, 20 fraction bits", t.quadratic),
        ("int32_t", "log_volume", "log2 of prior and volume of each width", t.log_volume),
        ("int32_t", "log_density", "log2 of the density of ln B, by the number of stars", t.log_density),
        (
            "int32_t",
            "row",
            "the searches: columns are those of enum TRACKER_ROW_POLES",
            search_plan.search_rows(t.searches),
        ),
        ("int32_t", "gate", "squares of the gates of the verification, 8 fraction bits", gates),
    ]
    needed = ("int32_t", "needed", "largest mean of matches by chance, 16 fraction bits", t.needed)
    turns = ("int64_t", "rotation_step", "arctangents of 2^-k, degrees, 40 fraction bits", np.array(ROTATION_STEPS))
    named.append(needed if t.triads is None else turns)
    return [
        CTable(type_, name if name.startswith(("guide_", "rotation_")) else f"search_{name}", meaning, values)
        for type_, name, meaning, values in named
    ]
