"""Pair database, triads, groups and votes against plain loops; the rules of votes, checks and groups one by one."""

import math
from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from startracker.errors import InputError
from startracker.identification.arithmetic import FloatArithmetic
from startracker.identification.triad_search import TriadLimits, find_triads, group_rotations, image_pairs
from startracker.identification.triad_tables import TriadTables
from startracker.identification.triad_votes import combine_separation, match_triads

ARITHMETIC = FloatArithmetic()
SCALE = (0.02, 0.02)


def random_sky(stars=60, seed=5, ra=(80.0, 95.0), dec=(0.0, 12.0)):
    rng = np.random.default_rng(seed)
    return rng.uniform(*ra, stars), rng.uniform(*dec, stars), rng.uniform(0, 6, stars)


def build(ra, dec, mag, widest=12.0):
    return TriadTables.build(ARITHMETIC, np.arange(1, len(ra) + 1), ra, dec, mag, widest)


def picture_of(ra, dec, center, turn_deg=20.0):
    """Pixels (x right, y up) of stars as a tangent plane sees them, turned."""
    a, d = np.radians(ra - center[0]), np.radians(dec)
    d0 = math.radians(center[1])
    depth = math.sin(d0) * np.sin(d) + math.cos(d0) * np.cos(d) * np.cos(a)
    xi = np.cos(d) * np.sin(a) / depth
    eta = (math.cos(d0) * np.sin(d) - math.sin(d0) * np.cos(d) * np.cos(a)) / depth
    t = math.radians(turn_deg)
    x, y = -xi * math.cos(t) + eta * math.sin(t), xi * math.sin(t) + eta * math.cos(t)
    return np.degrees(np.column_stack([x, y])) / SCALE


# ---------------------------------------------------------------------- tables
def test_pairs_are_all_pairs_in_order():
    ra, dec, mag = random_sky()
    tables = build(ra, dec, mag, 7.0)
    apart = {
        (i, j): float(ARITHMETIC.catalog_separations(tables.sky, np.array([i]), np.array([j]))[0])
        for i, j in combinations(range(60), 2)
    }
    expected = sorted((value, *pair) for pair, value in apart.items() if value <= 7.0)
    assert [(p, q) for _v, p, q in expected] == list(zip(tables.first.tolist(), tables.second.tolist(), strict=True))
    np.testing.assert_allclose(tables.separation, [value for value, *_ in expected], rtol=1e-12)


def test_windows_hold_both_ends():
    ra, dec, mag = random_sky()
    tables = build(ra, dec, mag, 7.0)
    low, high = tables.windows(
        tables.separation[[3, 40]], np.array([0.0, tables.separation[50] - tables.separation[40]])
    )
    assert (low[0], high[0]) == (3, 4)
    assert high[1] == 51


@pytest.mark.parametrize(
    "bad", [{"max_separation_deg": 0.0}, {"max_separation_deg": 181.0}, {"ra_deg": [1.0, math.nan]}]
)
def test_what_is_no_catalogue_is_refused(bad):
    good = {
        "star_id": [1, 2],
        "ra_deg": [1.0, 2.0],
        "dec_deg": [0.0, 0.0],
        "v_mag": [1.0, 1.0],
        "max_separation_deg": 5.0,
    }
    with pytest.raises(InputError):
        TriadTables.build(ARITHMETIC, **(good | bad))


# ---------------------------------------------------------------------- triads
def brute_force(image, stars, tables, limits):
    """Triads by trying every three catalogue stars for every three image stars."""
    one = ARITHMETIC
    i, j = image_pairs(stars)
    seen = {(a, b): s for a, b, s in zip(i, j, one.image_separations(image, i, j), strict=True)}
    p, q = image_pairs(len(tables))
    real = {(a, b): s for a, b, s in zip(p, q, one.catalog_separations(tables.sky, p, q), strict=True)}
    real |= {(b, a): s for (a, b), s in real.items()}
    for a, b, c in combinations(range(stars), 3):
        inner = [float(x[0]) for x in one.image_enclosed(image, *(np.array([s]) for s in (a, b, c)))]
        for x, y, z in permutations(range(len(tables)), 3):
            sides = ((a, b, x, y), (a, c, x, z), (b, c, y, z))
            if any(abs(seen[s, t] - real[u, v]) > limits.separation_tolerance_deg for s, t, u, v in sides):
                continue
            turns = []
            for s, u in ((b, y), (c, z)):
                picture = one.image_directions(image, np.array([a]), np.array([s]))
                sky = one.catalog_directions(tables.sky, np.array([x]), np.array([u]))
                turns.append(float((sky - picture)[0] % 360.0))
            if abs((turns[0] - turns[1] + 180) % 360 - 180) > limits.rotation_tolerance_deg:
                continue
            theirs = [float(w[0]) for w in one.catalog_enclosed(tables.sky, *(np.array([s]) for s in (x, y, z)))]
            if all(abs(m - n) <= limits.enclosed_tolerance_deg for m, n in zip(inner, theirs, strict=True)):
                yield (a, b, c), (x, y, z), turns


def test_triads_are_those_of_plain_loops():
    ra, dec, mag = random_sky(26, 8)
    tables = build(ra, dec, mag)
    rng = np.random.default_rng(2)
    shown = [3, 7, 11, 20]
    xy = picture_of(ra[shown], dec[shown], (87.0, 6.0)) + rng.normal(0, 1.0, (4, 2))
    limits = TriadLimits(separation_tolerance_deg=0.4, rotation_tolerance_deg=12.0, enclosed_tolerance_deg=6.0)
    image = ARITHMETIC.image(xy, SCALE)
    separations = ARITHMETIC.image_separations(image, *image_pairs(4))
    triads, counts = find_triads(image, 4, separations, tables, limits)
    expected = list(brute_force(image, 4, tables, limits))
    assert len(expected) > 4 + 3  # the true ones and chance ones
    assert [tuple(row) for row in triads.stars.tolist()] == [row[0] for row in expected]
    assert [tuple(row) for row in triads.catalog.tolist()] == [row[1] for row in expected]
    np.testing.assert_allclose(triads.rotations, [row[2] for row in expected], atol=1e-9)
    every = ARITHMETIC.catalog_separations(tables.sky, *image_pairs(26))
    assert counts.tolist() == [int((np.abs(every - s) <= 0.4).sum()) for s in separations]
    without, _ = find_triads(
        image, 4, separations, tables,
        TriadLimits(separation_tolerance_deg=0.4, rotation_tolerance_deg=12.0, enclosed_tolerance_deg=None),
    )  # fmt: skip
    assert len(without) >= len(triads)


def test_no_triads_and_few_stars():
    ra, dec, mag = random_sky(10)
    tables = build(ra, dec, mag)
    for xy in (np.empty((0, 2)), [[0.0, 0.0]], [[0, 0], [1, 1]], [[0, 0], [0.1, 0], [0, 0.1]]):
        match = match_triads(tables, xy, SCALE)
        assert len(match.triads) == 0
        assert match.best() is None


# ---------------------------------------------------------------------- groups
def plain_groups(angles, tolerance):
    groups = []
    labels = []
    for angle in angles:
        for number, members in enumerate(groups):
            unwrapped = [members[0] + (m - members[0] + 180) % 360 - 180 for m in members]
            mean = sum(unwrapped) / len(unwrapped)
            if abs((angle - mean + 180) % 360 - 180) <= tolerance:
                members.append(angle)
                labels.append(number)
                break
        else:
            labels.append(len(groups))
            groups.append([angle])
    return labels


@settings(deadline=None)  # the first call compiles
@given(st.lists(st.integers(0, 359 * 64), min_size=0, max_size=60), st.integers(1, 40))
def test_groups_are_those_of_plain_running_means(whole, tolerance_deg):
    angles = np.array(whole, dtype=np.int64)
    tolerance = 64 * tolerance_deg
    coded = group_rotations(angles, tolerance, 360 * 64)
    real = group_rotations(angles / 64.0, float(tolerance_deg), 360.0)
    assert coded[0].tolist() == real[0].tolist() == plain_groups([w / 64.0 for w in whole], tolerance_deg)
    assert coded[1].dtype == np.int64
    for group in range(len(real[1])):
        members = angles[real[0] == group] / 64.0
        mean = ARITHMETIC.group_mean(real[1][group], real[2][group], int(real[3][group]))
        assert abs(np.angle(np.exp(1j * np.radians(members - mean)).sum(), deg=True)) < tolerance_deg + 1e-6


def test_a_group_may_lie_about_zero():
    group, origin, total, count = group_rotations(np.array([358.0, 1.0, 3.0, 180.0, 0.0]), 5.0, 360.0)
    assert group.tolist() == [0, 0, 0, 1, 0]
    assert ARITHMETIC.group_mean(origin[0], total[0], int(count[0])) == pytest.approx(0.5)


# ---------------------------------------------------------------------- votes
CENTER = (87.0, 6.0)


def seen(ra, dec, shown):
    return picture_of(ra[shown], dec[shown], CENTER)


def test_stars_are_matched_and_false_ones_left():
    ra, dec, mag = random_sky(60)
    shown = [3, 7, 11, 20, 31]
    xy = np.vstack([seen(ra, dec, shown), [[37.0, -55.0]]])
    found = match_triads(build(ra, dec, mag), xy, SCALE).best()
    assert found.pairs.tolist() == [[k, star] for k, star in enumerate(shown)]
    assert found.matches[5] is None


def test_close_stars_are_one_with_the_brightest_place():
    ra, dec, mag = random_sky(60)
    ra, dec = np.append(ra, ra[7] + 0.05), np.append(dec, dec[7])
    mag = np.append(mag, mag[7] - 1.0)
    found = match_triads(build(ra, dec, mag), seen(ra, dec, [3, 7, 11, 20]), SCALE).best()
    vote = found.matches[1]
    assert vote.members == (60, 7)
    assert vote.catalog == 60
    single = {v.catalog: v.frequency for v in found.votes[1] if len(v.members) == 1}
    assert vote.frequency == single[60] + single[7]
    tables = build(ra, dec, mag)
    assert vote.number(tables) == 10_000 + 61
    apart = match_triads(tables, seen(ra, dec, [3, 7, 11, 20]), SCALE, TriadLimits(combine_px=1.0)).vote(found.group)
    assert all(len(v.members) == 1 for v in apart.votes[1])


def test_equal_votes_are_no_match():
    ra, dec, mag = random_sky(60)
    ra, dec, mag = np.append(ra, ra[7] + 0.05), np.append(dec, dec[7]), np.append(mag, mag[7])
    limits = TriadLimits(combine_px=1.0)
    match = match_triads(build(ra, dec, mag), seen(ra, dec, [3, 7, 11, 20]), SCALE, limits)
    found = match.vote(int(match.groups()[0]))
    top = [vote for vote in found.votes[1] if vote.frequency == max(v.frequency for v in found.votes[1])]
    assert len(top) == 2
    assert found.winners[1] is None


def test_what_disagrees_in_separation_is_dropped():
    ra, dec, mag = random_sky(60)
    shown = [3, 7, 11, 20, 31]
    match = match_triads(build(ra, dec, mag), seen(ra, dec, shown), SCALE)
    found = match.best()
    wrong = list(found.winners)
    wrong[4] = type(wrong[4])(40, (40,), 9)
    checked = match._checked(tuple(wrong))
    assert checked[4] is None
    assert [vote.catalog for vote in checked[:4]] == shown[:4]


def test_smaller_groups_are_asked_when_the_largest_fails():
    # two patterns of the sky; the image shows one of them, while the other is there many times over
    ra, dec, mag = random_sky(60)
    shown = [3, 7, 11, 20]
    match = match_triads(build(ra, dec, mag), seen(ra, dec, shown), SCALE, TriadLimits(vote_number=2))
    sizes = match.triads.group_sizes
    order = match.groups()
    assert sizes[order].tolist() == sorted(sizes.tolist(), reverse=True)
    groups = match.triads.group.copy()
    false = (match.triads.stars[:1].repeat(9, axis=0), np.array([[40, 41, 42], [43, 44, 45], [46, 47, 48]] * 3))
    forged = type(match.triads)(
        np.vstack([match.triads.stars, false[0]]),
        np.vstack([match.triads.catalog, false[1]]),
        np.vstack([match.triads.rotations, np.zeros((9, 2))]),
        np.append(groups, [len(sizes)] * 9),
        np.append(match.triads.group_rotations, 0.0),
    )
    other = type(match)(
        match.tables, match.scale_deg, match.limits, match.stars, match.separations, match.pair_counts, forged
    )
    assert other.groups()[0] == len(sizes)  # the false ones are the most
    assert other.vote(len(sizes)).matched == 0  # three names for each star, equally often
    assert other.best().pairs.tolist() == [[k, star] for k, star in enumerate(shown)]


def test_three_stars_alone():
    ra, dec, mag = random_sky(12)
    xy = seen(ra, dec, [3, 7, 11])
    tables = build(ra, dec, mag)
    assert match_triads(tables, xy, SCALE).best() is None  # one vote each
    found = match_triads(tables, xy, SCALE, TriadLimits(three_stars=True)).best()
    assert found.pairs.tolist() == [[0, 3], [1, 7], [2, 11]]


def test_combining_separation_is_the_larger_scale():
    assert combine_separation(ARITHMETIC, (9.0130 / 427, 6.9049 / 319), 8.0) == pytest.approx(
        8 * 6.9049 / 319, abs=1e-9
    )
