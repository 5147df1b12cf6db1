"""Triads of the flight build beside those of the integer pipeline, loops, and the star tracker with the same method."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.flight_lists import FIELDS, null_list
from simulator.randomness import stream
from simulator.study.exported_c.targets import HOST
from simulator.theses.yee1999.fixed_point.wide import WideArithmetic
from startracker import Camera, StarTracker
from startracker.flight.design import DetectorNumbers, FlightDesign
from startracker.flight.search_tables import TRIAD_BRIGHT, TRIAD_SHARE, search_tables
from startracker.identification.acceptance import SCALES
from startracker.identification.triad_search import TriadLimits, find_triads, image_pairs
from startracker.identification.triad_tables import TriadTables
from startracker.settings import TriadSettings
from tests.helpers.flight_lists import random_fields
from tests.helpers.flight_stages import ONE, CompiledFlight, integers, pointer

pytestmark = [pytest.mark.system, pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine")]


@pytest.fixture(scope="module")
def star_tracker():
    return StarTracker(
        Camera.from_fov(fov_deg=12.86, width=1024, height=1024), magnitude_limit=6.0, identifier="triads"
    )


@pytest.fixture(scope="module")
def design(star_tracker):
    numbers = DetectorNumbers(3.3, 13.0, 4083)
    return FlightDesign(star_tracker.camera, star_tracker.guide, numbers, 0.9, identifier="triads")


@pytest.fixture(scope="module")
def flight(design, tmp_path_factory):
    return CompiledFlight(design, tmp_path_factory.mktemp("c"))


def fields(star_tracker, kind, count, seed=1):
    return random_fields(star_tracker, "triads", kind, count, seed)


def between(one, other):
    """Difference of angles of 10.6 degrees, within half a turn."""
    half = 180 * 64
    return (one - other + half) % (2 * half) - half


def allowed_chord(seen, sides):
    """Tolerance of separations: standard errors of 8 fraction bits, and 1e-4 of a separation for aberration."""
    return ((seen.error * sides) >> 8) + ((seen.chord * 107) >> 20)


def triads_of(flight, one):
    """The stars of a list, and the triads (T, 7) of the first search."""
    seen = flight.begin(one.stars)
    return seen, flight.rows("stage_triads", 7, 0)


def pipeline_triads(flight, seen, share):
    """Triads of `startracker.identification.triad_search`, whose windows, rotations and angles are computed otherwise,
    with the same guide pairs and a part of the tolerances."""
    t = flight.tables.search
    n = min(len(seen.index), t.triads.stars)
    i, j = image_pairs(n)
    chord = seen.chord[i, j]
    allowed = allowed_chord(seen, t.searches[0].sides)[i, j] / ONE / np.cos(np.arcsin(chord / 2.0 / ONE))
    arithmetic = WideArithmetic()
    direction = t.guide / ONE
    sky = arithmetic.sky(
        np.degrees(np.arctan2(direction[:, 1], direction[:, 0])), np.degrees(np.arcsin(direction[:, 2])), 180.0
    )
    first, second = np.minimum(t.first, t.second), np.maximum(t.first, t.second)
    tables = TriadTables.of_pairs(arithmetic, t.number, t.magnitude, sky, first, second)
    vectors = seen.direction[:n] / ONE
    pixel = math.sqrt(t.pixel2) / ONE
    image = arithmetic.image(vectors[:, :2] / vectors[:, 2:] * [1.0, -1.0] / pixel, [math.degrees(pixel)] * 2)
    limits = TriadLimits(
        tuple(np.degrees(share * allowed).tolist()),
        rotation_tolerance_deg=share * 5.0,
        enclosed_tolerance_deg=share * 1.0,
    )
    found, _ = find_triads(image, n, arithmetic.image_separations(image, i, j), tables, limits)
    return {tuple(row) for row in np.hstack([found.stars, found.catalog]).tolist()}


def mirrored(flight, seen, triad):
    """Whether the sense of a triad's triangles differs."""
    observed, known = seen.direction[list(triad[:3])] / ONE, flight.tables.search.guide[list(triad[3:])] / ONE
    return np.linalg.det(observed) * np.linalg.det(known) < 0.0


def test_triads_are_those_of_the_integer_pipeline(star_tracker, flight):
    """Tolerances 4 % smaller give a part of them, larger ones all: an inner angle of 1 degree has units of 1/64.

    Left out are sides of less than three tolerances, which have no direction, mirrored triangles, which are thin, and
    third sides longer than listed pairs, which the pipeline looks up as well.
    """
    total, t = 0, flight.tables.search
    for one in (*fields(star_tracker, "clean", 2), *fields(star_tracker, "noise", 2)):
        seen, triads = triads_of(flight, one)
        short = 3.2 * allowed_chord(seen, t.searches[0].sides) > seen.chord
        listed = [
            tuple(row[position] for position in np.argsort(row[:3])) + tuple(row[3 + k] for k in np.argsort(row[:3]))
            for row in triads[:, :6].tolist()
        ]
        mine = set(listed)
        assert len(mine) == len(listed)
        few, many = pipeline_triads(flight, seen, 0.96), pipeline_triads(flight, seen, 1.04)
        few = {
            one
            for one in few
            if not (
                short[one[0], one[1]] or short[one[0], one[2]] or short[one[1], one[2]] or mirrored(flight, seen, one)
            )
        }
        assert few <= mine
        longest = 0.99 * t.longest
        assert {one for one in mine if seen.chord[list(one[:3]), list(one[1:3] + one[:1])].max() < longest} <= many
        assert len(few) > 30
        total += len(mine)
    assert total > 300


def test_true_triads_have_one_rotation(star_tracker, flight):
    """The roll of the camera against the pole, at the first star: within 5 degrees away from the poles."""
    for one in fields(star_tracker, "clean", 6, seed=3):
        if abs(one.matrix[2, 2]) > 0.8:
            continue
        seen, triads = triads_of(flight, one)
        sky = seen.direction[triads[:, :3]] / ONE @ one.matrix
        true = (np.linalg.norm(sky - flight.tables.search.guide[triads[:, 3:6]] / ONE, axis=2) < 1e-3).all(axis=1)
        assert true.sum() > 20
        north = one.matrix @ [0.0, 0.0, 1.0]
        # the rotation turns directions of the image (x, up) into those of the sky (west, north)
        roll = round(64.0 * math.degrees(math.atan2(north[0], -north[1])))
        spread = 64.0 * math.degrees(math.tan(math.asin(abs(one.matrix[2, 2]))) * math.radians(9.2)) + 64.0
        assert np.abs(between(triads[true, 6], roll)).max() < spread


def test_bearings_in_the_image(flight):
    """Of 10.6 degrees, from x over the upper edge, by arctangents."""
    rng = np.random.default_rng(4)
    plane = rng.uniform(-0.3, 0.3, (200, 2, 2))
    vectors = np.dstack([plane, np.ones((200, 2))])
    ends = integers(vectors / np.linalg.norm(vectors, axis=2, keepdims=True))
    for (p, q), ((px, py), (qx, qy)) in zip(ends, plane, strict=True):
        found = flight.c.stage_bearing(pointer(p.copy()), pointer(q.copy()))
        assert abs(between(found, round(64.0 * math.degrees(math.atan2(py - qy, qx - px))))) <= 1


def test_votes_of_a_group_are_those_of_loops(flight):
    rng = np.random.default_rng(5)
    ties = 0
    for _ in range(60):
        stars = np.sort(np.array([rng.permutation(6)[:3] for _ in range(12)]), axis=1)
        members, winner = np.column_stack([stars, rng.integers(0, 4, (12, 3))]), np.zeros(8, np.int64)
        votes = Counter((int(row[k]), int(row[3 + k])) for row in members for k in range(3))
        flight.call("stage_elect", winner, pointer(members), len(members), 8, 2)
        for star in range(8):
            ranked = sorted((n for (s, _), n in votes.items() if s == star), reverse=True)
            if len(ranked) > 1 and ranked[0] == ranked[1]:
                ties += 1
                assert winner[star] == -1
            elif ranked and ranked[0] >= 2:
                assert votes[star, int(winner[star])] == ranked[0]
            else:
                assert winner[star] == -1
    assert ties > 20


def test_disagreeing_winners_are_dropped(flight):
    """That with the most disagreements, of equal ones the last (Yee 1999, section 2.3.4.3)."""
    winner = flight.tables.search.first[0] + np.array([0, 1, 2, 3])
    for disagreeing, left in (([(1, 0), (1, 2), (1, 3)], [0, 2, 3]), ([(0, 2)], [0, 1, 3]), ([], [0, 1, 2, 3])):
        agree, kept = np.ones((4, 4), np.int64), np.zeros(4, np.int64)
        for i, j in disagreeing:
            agree[i, j] = agree[j, i] = 0
        assert flight.call("stage_drop", kept, 4, pointer(winner), pointer(agree)) == len(left)
        assert kept.tolist() == [winner[k] if k in left else -1 for k in range(4)]


@pytest.mark.parametrize("kind", list(FIELDS))
def test_fields_as_star_tracker(star_tracker, flight, kind):
    """As many fields as `StarTracker` solves by triads but for one in a hundred, rounded up; none wrong."""
    mine = theirs = 0
    for one in fields(star_tracker, kind, 8):
        theirs += star_tracker.solve_centroids(one.xy, one.flux, sigma_px=one.sigma_px).solved
        answer = flight.solve_list(one.stars)
        mine += answer.attitude is not None
        if answer.attitude is not None:
            turn = answer.attitude.as_matrix() @ one.matrix.T
            assert math.degrees(2.0 * math.asin(min(np.linalg.norm(turn - np.eye(3)) / math.sqrt(8.0), 1.0))) < 0.1
    assert mine >= theirs - 1
    assert theirs >= 3


def test_room_and_steps_that_are_used_up_are_said(star_tracker, design, flight, tmp_path):
    whole = flight.tables.search
    null = null_list(star_tracker, "uniform", stream(5, "triads limit"))
    small = whole._replace(triads=whole.triads._replace(room=5))
    short = whole._replace(searches=tuple(one._replace(steps=1000) for one in whole.searches))
    for name, search in (("small", small), ("short", short)):
        limited = CompiledFlight(design, tmp_path / name, flight.tables._replace(search=search))
        assert limited.solve_list(null).status == "search_limit"


def test_tolerances_and_pairs_of_the_design(star_tracker, design, flight, tmp_path):
    """Pairs between bright stars up to a share of the diagonal; scales as `StarTracker`'s; a fixed tolerance."""
    t = flight.tables.search
    apart = np.linalg.norm(t.guide[t.first] - t.guide[t.second], axis=1) / ONE
    assert apart.max() <= 2.0 * math.sin(TRIAD_SHARE * star_tracker.guide.half_diagonal_rad)
    assert apart.max() > 0.999 * 2.0 * math.sin(TRIAD_SHARE * star_tracker.guide.half_diagonal_rad)
    star = t.guide[np.unique(t.first)] / ONE
    near = (star @ star.T > math.cos(star_tracker.guide.half_diagonal_rad)).sum(axis=1)
    assert np.median(near) < 1.5 * TRIAD_BRIGHT * t.triads.stars
    assert [one.sides for one in t.searches] == [round(1024 * scale) for scale in SCALES]
    other = replace(design, identification=TriadSettings(separation_tolerance_deg=0.05))
    (search,) = search_tables(other).searches
    fixed = CompiledFlight(other, tmp_path / "c")
    seen = fixed.begin(fields(star_tracker, "clean", 1)[0].stars)
    pairs = ~np.eye(len(seen.index), dtype=bool)
    np.testing.assert_allclose((seen.error[pairs] * search.sides >> 8) / ONE, math.radians(0.05), rtol=1e-6)
    solved = [fixed.solve_list(one.stars).attitude is not None for one in fields(star_tracker, "clean", 5)]
    assert sum(solved) >= 4
