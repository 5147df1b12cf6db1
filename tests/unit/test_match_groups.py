"""Match groups: kernels against plain Python twins, the mirror test, mutual validation, statuses."""

import math

import numpy as np
import pytest

from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.catalog.stars import StarCatalog
from startracker.estimation.association import nearest_unique
from startracker.estimation.wahba import fit_rotation
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification import METHODS, Observed, Prior, match_groups
from startracker.identification.match_kernels import (
    Groups,
    Shapes,
    Windows,
    collect,
    group_sizes,
    mark,
    validate,
)
from startracker.identification.pairs import observed_pairs, pair_tolerance, separation, windows
from startracker.settings import MatchGroupSettings
from startracker.solution import Status

CAMERA = Camera.from_fov(10.0, 512, 512)


@pytest.fixture(scope="module")
def guide():
    return GuideDatabase.build(load_catalog("hipparcos"), CAMERA, 6.0)


def field(guide, ra_deg, dec_deg, roll_deg=30.0):
    attitude = Attitude.from_radec_roll(ra_deg, dec_deg, roll_deg)
    index, vectors, xy = guide.in_field(attitude.as_matrix())
    return attitude, index, vectors, xy


def observed(guide, index, vectors, sigma_px=0.15, flux=True):
    signal = 10.0 ** (-0.4 * guide.v_mag[index]) if flux else None
    return Observed(vectors, signal, np.full(len(vectors), sigma_px * CAMERA.pixel_rad))


def twin_sky():
    """Twelve stars on the equator around RA 100°, and the same twelve around RA 250°."""
    rng = np.random.default_rng(8)
    ra, dec, v = rng.uniform(-4, 4, 12), rng.uniform(-4, 4, 12), rng.uniform(2, 5, 12)
    zero = np.zeros(24)
    return StarCatalog(
        "twins",
        2000.0,
        id=np.arange(24),
        ra_rad=np.radians(np.concatenate([ra + 100.0, ra + 250.0])),
        dec_rad=np.radians(np.tile(dec, 2)),
        pm_ra_rad_yr=zero,
        pm_dec_rad_yr=zero,
        parallax_rad=zero,
        radial_velocity_km_s=zero,
        v_mag=np.tile(v, 2),
        b_v=zero,
        spectral_type=np.full(24, ""),
        star_name=np.full(24, ""),
    )


def random_pairs(seed, restricted):
    rng = np.random.default_rng(seed)
    n, g, p, pairs = 5, 12, 10, 40
    i, j = np.triu_indices(n, 1)
    first, second = rng.integers(0, g, (2, pairs))
    low = rng.integers(0, pairs, p)
    high = np.minimum(low + rng.integers(0, 12, p), pairs)
    allowed = rng.random((n, g)) < 0.6 if restricted else np.zeros((0, 0), bool)
    return n, g, (i, j, low, high, first, second), rng.uniform(0, 4, n), rng.uniform(0, 4, g), 1.0, allowed


@pytest.mark.parametrize("restricted", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_mark_and_collect_are_their_plain_twins(seed, restricted):
    n, g, args, magnitude, v, tolerance, allowed = random_pairs(seed, restricted)
    i, j, low, high, first, second = args
    support = {}
    for p in range(len(i)):
        for k in range(low[p], high[p]):
            for a, b in ((first[k], second[k]), (second[k], first[k])):
                if abs((magnitude[i[p]] - magnitude[j[p]]) - (v[a] - v[b])) > tolerance:
                    continue
                if restricted and not (allowed[i[p], a] and allowed[j[p], b]):
                    continue
                support.setdefault((i[p], a), []).append((j[p], b))
                support.setdefault((j[p], b), []).append((i[p], a))
    partners = np.zeros((n, g), np.uint64)
    marked = Windows(*args, magnitude, v, tolerance, allowed)
    mark(marked, partners)
    sizes = group_sizes(partners)
    for o in range(n):
        for s in range(g):
            stars = {m[0] for m in support.get((o, s), [])}
            assert sizes[o, s] == (len(stars) + 1 if stars else 0)
    kept = [(o, s) for o in range(n) for s in range(g) if sizes[o, s] >= 3]
    group = np.full((n, g), -1)
    for number, (o, s) in enumerate(kept):
        group[o, s] = number
    start, members = collect(marked, group, len(kept))
    for number, couple in enumerate(kept):
        found = sorted(divmod(int(code), g) for code in members[start[number] : start[number + 1]])
        assert found == sorted((int(o), int(s)) for o, s in support[couple] if (o, s) in kept)


def test_nearest_unique_gives_a_star_to_one_only():
    points = np.array([[0.0, 0.0], [0.3, 0.0], [5.0, 5.0], [9.0, 9.0]])
    places = np.array([[0.2, 0.0], [5.0, 5.4]])
    index, distance = nearest_unique(points, places, np.full(4, 1.0))
    assert index.tolist() == [-1, 0, 1, -1]
    np.testing.assert_allclose(distance, [np.inf, 0.1, 0.4, np.inf])


def test_separation_is_exact_for_tiny_and_large_angles():
    for angle in (1e-9, 1e-4, 1.0, math.pi):
        a, b = np.array([1.0, 0.0, 0.0]), np.array([math.cos(angle), math.sin(angle), 0.0])
        assert separation(a, b) == pytest.approx(angle, rel=1e-7)


def run_validate(vectors, directions, couples, tolerance=1e-5):
    """One group with the first couple as the kernel and the others as its members."""
    n = len(vectors)
    i, j, s = observed_pairs(vectors)
    low, high, mirror = np.ones((n, n)), np.ones((n, n)), np.zeros((n, n))
    low[i, j] = low[j, i] = np.cos(s + tolerance)
    high[i, j] = high[j, i] = np.cos(s - tolerance)
    mirror[i, j] = mirror[j, i] = np.sin(s) * tolerance
    members = np.array([o * len(directions) + g for o, g in couples[1:]])
    kernel_obs, kernel_guide = (np.array([x]) for x in couples[0])
    start = np.array([0, len(members)])
    groups = Groups(kernel_obs, kernel_guide, start, members)
    return validate(groups, Shapes(vectors, directions, low, high, mirror), 3)


def test_validation_keeps_the_members_that_support_each_other(guide):
    attitude, index, vectors, _ = field(guide, 85.0, 0.0)
    directions = guide.directions[index]
    vectors = vectors[:6]
    couples = [(k, k) for k in range(6)] + [(2, 9), (3, 11), (4, 12)]
    size, rss, found = run_validate(vectors, directions, couples)
    assert size[0] == 6
    assert found[0].tolist() == list(range(6))
    assert rss[0] < 1e-12
    assert attitude.as_matrix() @ directions[0] == pytest.approx(vectors[0])


def test_the_mirror_image_is_no_match(guide):
    _, index, vectors, _ = field(guide, 85.0, 0.0)
    mirrored = vectors[:6] * np.array([-1.0, 1.0, 1.0])
    size, _, _ = run_validate(mirrored, guide.directions[index], [(k, k) for k in range(6)])
    assert size[0] < 3


def test_fit_rotation_is_proper_and_exact():
    rng = np.random.default_rng(2)
    matrix = Attitude(rng.normal(size=4)).as_matrix()
    reference = rng.normal(size=(5, 3))
    reference /= np.linalg.norm(reference, axis=1, keepdims=True)
    np.testing.assert_allclose(fit_rotation(reference @ matrix.T, reference, np.ones(5)), matrix, atol=1e-14)
    two = fit_rotation(reference[:2] @ matrix.T, reference[:2], np.ones(2))
    np.testing.assert_allclose(two, matrix, atol=1e-12)


def test_windows_hold_exactly_the_pairs_within_tolerance(guide):
    pairs = guide.pairs
    i, j, s = observed_pairs(guide.directions[[3, 60, 400, 900]])
    tolerance = pair_tolerance(np.full(4, 1e-4), i, j, s, None)
    assert np.all(tolerance >= 4.0 * math.sqrt(2.0) * 1e-4)
    low, high = windows(pairs, s, tolerance)
    for p in range(len(i)):
        inside = np.abs(pairs.separation_rad - s[p]) <= tolerance[p]
        assert np.flatnonzero(inside).tolist() == list(range(low[p], high[p]))
    assert np.all(pair_tolerance(np.full(4, 1e-4), i, j, s, 0.003) == 0.003)


@pytest.mark.parametrize("flux", [True, False])
@pytest.mark.parametrize(
    ("ra_deg", "dec_deg"), [(85.0, 0.0), (0.0, 60.0), (359.99, -1.0), (10.0, 90.0), (200.0, -90.0)]
)
def test_perfect_fields_are_identified_star_by_star(guide, ra_deg, dec_deg, flux):
    _, index, vectors, _ = field(guide, ra_deg, dec_deg)
    found = match_groups(observed(guide, index, vectors, flux=flux), guide)
    assert found.status is Status.SOLVED, found.reason
    assert len(found.pairs) == len(index)
    assert index[found.pairs[:, 0]].tolist() == found.pairs[:, 1].tolist()


def test_the_thesis_settings_work_around_a_prior(guide):
    attitude, index, vectors, _ = field(guide, 85.0, 8.6)
    settings = MatchGroupSettings(separation_tolerance_deg=0.2)
    off = Attitude.from_rotation_vector(np.radians([1.0, -1.0, 1.0]), "camera", "camera") @ attitude
    prior = Prior(off, math.radians(1.8))
    found = METHODS["match_groups"](observed(guide, index, vectors), guide, settings, prior)
    assert found.status is Status.SOLVED, found.reason
    assert index[found.pairs[:, 0]].tolist() == found.pairs[:, 1].tolist()


def test_a_prior_elsewhere_gives_no_match(guide):
    _, index, vectors, _ = field(guide, 85.0, 0.0)
    prior = Prior(Attitude.from_radec_roll(200.0, 40.0, 0.0), math.radians(2.0))
    found = match_groups(observed(guide, index, vectors), guide, None, prior)
    assert found.status is Status.NO_MATCH
    assert len(found.pairs) == 0


def test_a_roll_outside_the_prior_is_no_match_though_no_star_moves_far(guide):
    attitude, index, vectors, _ = field(guide, 85.0, 0.0)
    rolled = Attitude.from_rotation_vector([0.0, 0.0, math.radians(10.0)], "camera", "camera") @ attitude
    stars = observed(guide, index, vectors)
    # ten degrees about the boresight move a corner of the field by 1.2°
    assert match_groups(stars, guide, None, Prior(rolled, math.radians(1.7))).status is Status.NO_MATCH
    assert match_groups(stars, guide, None, Prior(rolled, math.radians(10.5))).status is Status.SOLVED


def test_a_prior_makes_few_stars_enough(guide):
    attitude, index, vectors, _ = field(guide, 40.0, 15.0)
    few = observed(guide, index[:3], vectors[:3], flux=False)
    near = match_groups(few, guide, None, Prior(attitude, math.radians(1.0)))
    assert near.status is Status.SOLVED
    lost = match_groups(few, guide)
    assert lost.status is Status.AMBIGUOUS
    assert "by chance with probability" in lost.reason
    # √3° about all axes at most leave (ρ − sin ρ)/π of all rotations
    radius = math.radians(1.0)
    assert near.log_false_alarm < lost.log_false_alarm + math.log((radius - math.sin(radius)) / math.pi) + 1e-9


@pytest.mark.parametrize(
    ("count", "status"), [(0, Status.NO_STARS), (1, Status.TOO_FEW_STARS), (2, Status.TOO_FEW_STARS)]
)
def test_too_few_stars_have_a_status_of_their_own(guide, count, status):
    _, index, vectors, _ = field(guide, 85.0, 0.0)
    found = match_groups(observed(guide, index[:count], vectors[:count]), guide)
    assert found.status is status
    assert f"{count} stars seen" in found.reason


def test_an_attitude_that_fits_twice_is_ambiguous():
    """Two patches of one sky alike to the last digit: whichever is taken is wrong half the time."""
    guide = GuideDatabase.build(twin_sky(), CAMERA, 6.0)
    matrix = Attitude.from_radec_roll(100.0, 0.0, 0.0).as_matrix()
    index, vectors, _ = guide.in_field(matrix)
    found = match_groups(observed(guide, index, vectors), guide)
    assert found.status is Status.AMBIGUOUS
    assert "another part of the sky" in found.reason
