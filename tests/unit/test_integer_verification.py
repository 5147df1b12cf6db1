"""The integer verification beside floating point: rounding, evidence, spread, density of the points."""

import math

import numpy as np
import pytest

from benchmarks.integer_lists import Camera, scene
from simulator.randomness import stream
from simulator.theses.yee1999.catalogue import sub_catalog
from startracker.errors import InputError
from startracker.fixed_point.evidence import local_areas, log2, log_sum
from startracker.fixed_point.formats import CENTROID
from startracker.fixed_point.verification import FEW_FIT, FIT, NOT_SPREAD, plane, verify
from startracker.identification.bayes_factor import SCALE_LOG_PRIOR, SCALES, count_table, log_assignments
from startracker.identification.integer_acceptance import (
    MAX_POINTS,
    IntegerCamera,
    merged_stars,
    verification_tables,
)

FOV, SIZE = (12.0, 10.0), (600, 500)
CAMERA = IntegerCamera(SIZE, FOV, resolution_px=0.0)


@pytest.fixture(scope="module")
def stars():
    return sub_catalog(5, 6.0, 30.0, 90.0)


@pytest.fixture(scope="module")
def guide(stars):
    return merged_stars(stars.ra_deg, stars.dec_deg, stars.v_mag, 0.0)


@pytest.fixture(scope="module")
def tables(guide):
    return verification_tables(CAMERA, guide)


def fields(stars, guide, count, **options):
    rng = stream(8, "verification")
    v_mag = stars.v_mag[guide.first]
    return [scene(guide.directions, v_mag, Camera(FOV, SIZE), rng, (40.0, 80.0), **options) for _ in range(count)]


def checked(tables, xy, matrix):
    points = plane(CENTROID.encode(xy), tables)
    start = np.rint(matrix * 2.0**30).astype(np.int64)
    return points, verify(start, points, local_areas(points, tables), tables)


def test_logarithms_and_sums_are_rounded_down(tables):
    rng = stream(1, "logs")
    for n in [1, 2, 3, 255, 256, 257, 511, 2**61, *(int(2.0**x) for x in rng.uniform(0.0, 62.0, 500))]:
        assert 0.0 <= 4096.0 * math.log2(n) - log2(n, tables.log_table) <= 24.0
    for a, b in [*rng.integers(-200_000, 200_000, (500, 2)).tolist(), [5, 5], [0, -(1 << 28)]]:
        exact = 4096.0 * np.logaddexp2(a / 4096.0, b / 4096.0)
        assert 0.0 <= exact - log_sum(a, b, tables.sum_table) <= 130.0


def test_the_right_attitude_is_kept_and_refined(stars, guide, tables):
    for truth in fields(stars, guide, 20, noise_px=0.05, max_stars=MAX_POINTS):
        off = np.array([[1.0, 4e-4, -3e-4], [-4e-4, 1.0, 2e-4], [3e-4, -2e-4, 1.0]])
        _, (state, evidence, matched, index, matrix) = checked(tables, truth.xy, off @ truth.matrix)
        assert state == FIT
        assert matched >= len(truth.xy) - 1
        named = index >= 0
        assert (guide.directions[index[named]] == guide.directions[truth.star[named]]).all()
        turned = matrix / 2.0**30 @ truth.matrix.T
        # boresight of 0.05 px and roll of several times that over 300 px, each five times its error
        assert np.abs(turned[2, :2]).max() < 5.0 * 0.05 / min(CAMERA.focal_px)
        assert abs(turned[0, 1]) < 5.0 * 0.05 / 100.0
        assert np.abs(matrix / 2.0**30 @ matrix.T / 2.0**30 - np.eye(3)).max() < 1e-8
        assert evidence / 4096.0 > 2.0 * len(truth.xy)


def exact_evidence(tables, points, matrix, index):
    """ln B in floating point with the same null hypothesis, of the matches at hand."""
    n, focal = len(points), tables.focal / 2.0**12
    xy = points / 2.0**12
    seen = np.flatnonzero(index >= 0)
    body = tables.guide / 2.0**30 @ (matrix / 2.0**30).T
    ahead = body[:, 2] > 0.5
    at = np.full((len(body), 2), np.inf)
    at[ahead] = body[ahead, :2] / body[ahead, 2:] * focal
    half = tables.half / 2.0**12
    in_field = np.flatnonzero((np.abs(at) <= half).all(axis=1))[: 2 * n + 10]
    rank = {int(g): k for k, g in enumerate(in_field)}
    square = ((xy[seen] - at[index[seen]]) ** 2).sum(axis=1)
    apart = ((xy[:, None] - xy) ** 2).sum(axis=2)
    k = np.arange(1, n)
    area = np.minimum(4.0 * half.prod(), (np.sort(apart, axis=1)[:, 1:] * np.pi * (n - 1) / k).min(axis=1))[seen]
    lever = ((xy[seen] - xy[seen].mean(axis=0)) ** 2).sum()
    counts = count_table(n, 58)
    values = []
    for scale, prior in zip(SCALES[:5], SCALE_LOG_PRIOR[:5], strict=True):
        sigma = scale * CAMERA.centroid_error_px
        normal = len(seen) ** 2 * focal**4 * lever / sigma**6
        volume = 1.5 * math.log(2.0 * math.pi) - 0.5 * math.log(normal) - math.log(8.0 * math.pi**2)
        gain = np.log(area / (2.0 * math.pi * sigma**2)) - square / (2.0 * sigma**2)
        order = np.argsort(-gain)
        places = np.array([rank[int(g)] for g in index[seen]])[order]
        values.append(prior + volume + log_assignments(gain[order], places, len(in_field), counts))
    return float(np.logaddexp.reduce(values)) / math.log(2.0)


def test_evidence_is_that_of_floating_point_and_never_more(stars, guide, tables):
    off = []
    for truth in fields(stars, guide, 40, noise_px=0.3, max_stars=16, false_stars=2):
        points, (state, evidence, _, index, matrix) = checked(tables, truth.xy, truth.matrix)
        if state == FIT and all(np.abs(truth.xy[:, k]).max() < SIZE[k] / 2.0 - 3.0 for k in (0, 1)):
            off.append(exact_evidence(tables, points, matrix, index) - evidence / 4096.0)
    assert len(off) > 15
    # the refit moves the residuals by its last step; the sphere's normal matrix costs 0.1
    assert min(off) > -0.01
    assert max(off) < 2.0


def sky_of(tables, xy):
    """Tables whose guide stars stand at the points given, boresight along +z."""
    rays = np.column_stack([np.asarray(xy) / CAMERA.focal_px * [1.0, -1.0], np.ones(len(xy))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return tables._replace(guide=np.rint(rays * 2.0**30).astype(np.int64))


def test_clumps_and_lines_are_not_spread(tables):
    rng = stream(2, "clumps")
    field = rng.uniform([-280.0, -230.0], [280.0, 230.0], (10, 2))
    clump = rng.normal(0.0, 25.0, (10, 2))
    line = np.outer(np.linspace(-250.0, 250.0, 10), [1.0, 0.6]) + rng.normal(0.0, 3.0, (10, 2))
    for xy, expected in ((field, FIT), (clump, NOT_SPREAD), (line, NOT_SPREAD)):
        _, (state, _, matched, _, _) = checked(sky_of(tables, xy), xy, np.eye(3))
        assert state == expected
        assert matched == (10 if state == FIT else 0)


def test_a_point_of_a_clump_has_little_area(tables):
    rng = stream(2, "areas")
    clump = plane(CENTROID.encode(rng.normal(0.0, 5.0, (12, 2))), tables)
    fields = [plane(CENTROID.encode(rng.uniform(-240.0, 240.0, (12, 2))), tables) for _ in range(40)]
    assert (tables.log_area - local_areas(clump, tables)).min() > 5 * 4096
    # chance neighbours of an even list cost about one bit
    assert np.median([tables.log_area - local_areas(field, tables) for field in fields]) < 2 * 4096
    assert local_areas(np.zeros((3, 2), np.int64), tables).max() < -(1 << 27)  # one position: no area at all


def test_an_attitude_of_nowhere(tables):
    rng = stream(3, "nowhere")
    points = rng.uniform([-299.0, -249.0], [299.0, 249.0], (12, 2))
    south = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    state, _, matched, index, _ = checked(tables, points, south)[1]
    assert (state, matched) == (FEW_FIT, 0)
    assert (index == -1).all()


def test_stars_that_are_one():
    guide = merged_stars([10.0, 10.02, 10.04, 50.0], [0.0, 0.0, 0.0, 0.0], [5.0, 4.0, 5.0, 2.0], math.radians(0.03))
    assert guide.several.tolist() == [False, True]
    assert guide.first.tolist() == [3, 1]
    assert guide.of_star.tolist() == [1, 1, 1, 0]
    ra = math.degrees(math.atan2(guide.directions[1, 1], guide.directions[1, 0]))
    assert ra == pytest.approx(10.02, abs=1e-9)


@pytest.mark.parametrize(
    "options",
    [{"centroid_error_px": math.nan}, {"false_alarm_rate": math.nan}, {"resolution_px": math.nan}, {"size_px": (0, 9)}],
)
def test_cameras_that_are_none(options):
    with pytest.raises(InputError):
        IntegerCamera(**{"size_px": SIZE, "fov_deg": FOV, **options})
