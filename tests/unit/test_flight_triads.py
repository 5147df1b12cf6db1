"""Triads of the flight build beside those of the integer pipeline, loops, and the star tracker with the same method."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.flight_lists import FIELDS, null_list
from simulator.randomness import stream
from startracker import Camera, StarTracker
from startracker.fixed_point.wide import WideArithmetic
from startracker.flight.apparent import FlightObserver
from startracker.flight.design import DetectorNumbers, FlightDesign
from startracker.flight.hypotheses import Pool
from startracker.flight.search_tables import TRIAD_BRIGHT, TRIAD_SHARE
from startracker.flight.solver import FlightTracker
from startracker.flight.triads import TriadWork, between, drop_disagreeing, elected, image_bearing
from startracker.flight.votes import separations, tolerance
from startracker.identification.acceptance import SCALES
from startracker.identification.triad_search import TriadLimits, find_triads, image_pairs
from startracker.identification.triad_tables import TriadTables
from startracker.settings import TriadSettings
from startracker.solution import Status
from tests.helpers.flight_lists import apparent_to, random_fields

pytestmark = pytest.mark.system

ONE = 1 << 30
REST = FlightObserver(np.zeros(3, np.int64))


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
def tracker(design):
    return FlightTracker.build(design)


def fields(star_tracker, kind, count, seed=1):
    return random_fields(star_tracker, "triads", kind, count, seed)


class Found(TriadWork):
    """Keeps the triads instead of verifying their groups."""

    def _try_groups(self, triads, search):
        self.triads = triads


def triads_of(tracker, one, number=0):
    """Work that has the triads of a search."""
    t = tracker.search_tables
    seen = apparent_to(tracker, one.stars)
    work = Found(Pool(len(seen), None, t), seen, separations(seen, t), REST, t)
    work.run(t.searches[number])
    return work


def pipeline_triads(work, share):
    """Triads of `startracker.identification.triad_search`, whose windows, rotations and angles are computed otherwise,
    with the same guide pairs and a part of the tolerances."""
    t, seen = work.tables, work.seen
    n = min(len(seen), t.triads.stars)
    i, j = image_pairs(n)
    chord, error = work.sides.chord[i, j], work.sides.error[i, j]
    allowed = tolerance(chord, error, t.searches[0].sides) / ONE / np.cos(np.arcsin(chord / 2.0 / ONE))
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


def mirrored(work, triad):
    """Whether the sense of a triad's triangles differs."""
    seen, known = work.seen.direction[list(triad[:3])] / ONE, work.tables.guide[list(triad[3:])] / ONE
    return np.linalg.det(seen) * np.linalg.det(known) < 0.0


def test_triads_are_those_of_the_integer_pipeline(star_tracker, tracker):
    """Tolerances 4 % smaller give a part of them, larger ones all: an inner angle of 1 degree has units of 1/64.

    Left out are sides of less than three tolerances, which have no direction, mirrored triangles, which are thin, and
    third sides longer than listed pairs, which the pipeline looks up as well.
    """
    total = 0
    for one in (*fields(star_tracker, "clean", 2), *fields(star_tracker, "noise", 2)):
        work = triads_of(tracker, one)
        chord = work.sides.chord
        short = 3.2 * tolerance(chord, work.sides.error, work.tables.searches[0].sides) > chord
        listed = [
            tuple(row[position] for position in np.argsort(row[:3])) + tuple(row[3 + k] for k in np.argsort(row[:3]))
            for row in work.triads[:, :6].tolist()
        ]
        mine = set(listed)
        assert len(mine) == len(listed)
        few, many = pipeline_triads(work, 0.96), pipeline_triads(work, 1.04)
        few = {t for t in few if not (short[t[0], t[1]] or short[t[0], t[2]] or short[t[1], t[2]] or mirrored(work, t))}
        assert few <= mine
        assert {t for t in mine if chord[list(t[:3]), list(t[1:3] + t[:1])].max() < 0.99 * work.tables.longest} <= many
        assert len(few) > 30
        total += len(mine)
    assert total > 300


def test_true_triads_have_one_rotation(star_tracker, tracker):
    """The roll of the camera against the pole, at the first star: within 5 degrees away from the poles."""
    for one in fields(star_tracker, "clean", 6, seed=3):
        if abs(one.matrix[2, 2]) > 0.8:
            continue
        work = triads_of(tracker, one)
        sky = work.seen.direction[work.triads[:, :3]] / ONE @ one.matrix
        true = (np.linalg.norm(sky - tracker.search_tables.guide[work.triads[:, 3:6]] / ONE, axis=2) < 1e-3).all(axis=1)
        assert true.sum() > 20
        north = one.matrix @ [0.0, 0.0, 1.0]
        # the rotation turns directions of the image (x, up) into those of the sky (west, north)
        roll = round(64.0 * math.degrees(math.atan2(north[0], -north[1])))
        spread = 64.0 * math.degrees(math.tan(math.asin(abs(one.matrix[2, 2]))) * math.radians(9.2)) + 64.0
        assert np.abs(between(work.triads[true, 6], np.array(roll))).max() < spread


def test_bearings_in_the_image():
    """Of 10.6 degrees, from x over the upper edge, by arctangents."""
    rng = np.random.default_rng(4)
    plane = rng.uniform(-0.3, 0.3, (200, 2, 2))
    vectors = np.dstack([plane, np.ones((200, 2))])
    p, q = np.rint(ONE * vectors / np.linalg.norm(vectors, axis=2, keepdims=True)).astype(np.int64).transpose(1, 0, 2)
    x, y = (plane[:, 1] - plane[:, 0]).T
    expected = np.rint(64.0 * np.degrees(np.arctan2(-y, x))).astype(np.int64)
    assert np.abs(between(image_bearing(p, q), expected)).max() <= 1


def test_votes_of_a_group_are_those_of_loops():
    rng = np.random.default_rng(5)
    ties = 0
    for _ in range(60):
        stars = np.sort(np.array([rng.permutation(6)[:3] for _ in range(12)]), axis=1)
        members = np.column_stack([stars, rng.integers(0, 4, (12, 3)), np.zeros(12, int)])
        votes = Counter((int(row[k]), int(row[3 + k])) for row in members for k in range(3))
        winner, named = elected(members, 2, 8)
        assert named == len(votes)
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


def test_disagreeing_winners_are_dropped():
    """That with the most disagreements, of equal ones the last (Yee 1999, section 2.3.4.3)."""
    winner, agree = np.array([10, 11, 12, 13]), np.ones((4, 4), np.bool_)
    agree[1] = agree[:, 1] = False
    drop_disagreeing(winner, agree | np.eye(4, dtype=np.bool_))
    assert winner.tolist() == [10, -1, 12, 13]
    winner, agree = np.array([10, 11, 12, 13]), np.ones((4, 4), np.bool_)
    agree[0, 2] = agree[2, 0] = False
    drop_disagreeing(winner, agree)
    assert winner.tolist() == [10, 11, -1, 13]


@pytest.mark.parametrize("kind", list(FIELDS))
def test_fields_as_star_tracker(star_tracker, tracker, kind):
    """As many fields as `StarTracker` solves by triads but for one in a hundred, rounded up; none wrong."""
    mine = theirs = 0
    for one in fields(star_tracker, kind, 8):
        theirs += star_tracker.solve_centroids(one.xy, one.flux, sigma_px=one.sigma_px).solved
        answer = tracker.solve_stars(one.stars)
        mine += answer.solved
        if answer.solved:
            turn = answer.attitude_matrix @ one.matrix.T
            assert math.degrees(2.0 * math.asin(min(np.linalg.norm(turn - np.eye(3)) / math.sqrt(8.0), 1.0))) < 0.1
    assert mine >= theirs - 1
    assert theirs >= 3


def test_room_and_steps_that_are_used_up_are_said(star_tracker, tracker, monkeypatch):
    whole = tracker.search_tables
    null = null_list(star_tracker, "uniform", stream(5, "triads limit"))
    small = whole._replace(triads=whole.triads._replace(room=5))
    short = whole._replace(searches=tuple(one._replace(steps=1000) for one in whole.searches))
    for tables in (small, short):
        monkeypatch.setattr(tracker, "search_tables", tables)
        assert tracker.solve_stars(null).status is Status.SEARCH_LIMIT


def test_tolerances_and_pairs_of_the_design(star_tracker, design, tracker):
    """Pairs between bright stars up to a share of the diagonal; scales as `StarTracker`'s; a fixed tolerance."""
    t = tracker.search_tables
    apart = np.linalg.norm(t.guide[t.first] - t.guide[t.second], axis=1) / ONE
    assert apart.max() <= 2.0 * math.sin(TRIAD_SHARE * star_tracker.guide.half_diagonal_rad)
    assert apart.max() > 0.999 * 2.0 * math.sin(TRIAD_SHARE * star_tracker.guide.half_diagonal_rad)
    star = t.guide[np.unique(t.first)] / ONE
    near = (star @ star.T > math.cos(star_tracker.guide.half_diagonal_rad)).sum(axis=1)
    assert np.median(near) < 1.5 * TRIAD_BRIGHT * t.triads.stars
    assert [one.sides for one in t.searches] == [round(1024 * scale) for scale in SCALES]
    fixed = FlightTracker.build(replace(design, identification=TriadSettings(separation_tolerance_deg=0.05)))
    sides = separations(apparent_to(tracker, fields(star_tracker, "clean", 1)[0].stars), fixed.search_tables)
    (search,) = fixed.search_tables.searches
    allowed = tolerance(sides.chord, sides.error, search.sides) - tolerance(sides.chord, 0 * sides.error, search.sides)
    np.testing.assert_allclose(allowed / ONE, math.radians(0.05), rtol=1e-6)
    solved = [fixed.solve_stars(one.stars).solved for one in fields(star_tracker, "clean", 5)]
    assert sum(solved) >= 4
