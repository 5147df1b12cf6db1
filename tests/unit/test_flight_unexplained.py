"""What an attitude leaves unexplained: the C of the flight build beside `startracker.unexplained`."""

import ctypes
import math
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from flight_c import SANITIZED, library

from startracker import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.flight.c_table import CTable
from startracker.flight.directions import grid_arrays, grid_constants
from startracker.flight.pose import POSE_MODULES, pose_arrays, pose_constants, pose_tables
from startracker.flight.unexplained import CONTRAST_BITS, unexplained_arrays, unexplained_constants
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion
from startracker.unexplained import FEW_STARS_SIGMAS, LARGEST_CONTRAST, Unexplained, unexplained_of

pytestmark = [pytest.mark.system, pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")]

CAMERA = Camera(4870.0, 4865.0, 515.0, 508.0, 1024, 1024, Distortion(k1=-0.15, p1=1e-4))
MAX_STARS, MOST_FIELD, PIXEL = 60, 150, 65536.0
WRAPPER = r"""
#include "tracker_unexplained.c"
void given(const int32_t *star, const uint8_t *seen, int stars, const int32_t *guide, const uint8_t *matched,
           int guides, int64_t out[8]);
int limits(const int64_t in[8]);
int few(const int32_t *away, const uint32_t *variance, int count, int used);
int position(const int32_t *matrix, const int32_t *direction, int32_t *xy);
/* What a list of stars and guide stars leaves unexplained. */
void given(const int32_t *star, const uint8_t *seen, int stars, const int32_t *guide, const uint8_t *matched,
           int guides, int64_t out[8])
{
    static struct tracker_bright bright;
    struct tracker_unexplained left;
    int n;
    bright.stars = stars;
    bright.guides = guides;
    for (n = 0; n < 2 * stars; n++)
        bright.star[n / 2][n % 2] = star[n];
    for (n = 0; n < stars; n++)
        bright.seen[n] = seen[n];
    for (n = 0; n < 2 * guides; n++)
        bright.guide[n / 2][n % 2] = guide[n];
    for (n = 0; n < guides; n++)
        bright.matched[n] = matched[n];
    list_bright(&bright);
    compare_parts(&bright, &left);
    out[0] = left.contrast;
    out[1] = left.stars;
    out[2] = left.guides;
    out[3] = left.lost_stars;
    out[4] = left.matched_stars;
    out[5] = left.lost_guides;
    out[6] = left.matched_guides;
    out[7] = left.beside;
}
/* 1: refused; 2: doubtful. */
int limits(const int64_t in[8])
{
    struct tracker_unexplained left;
    left.contrast = in[0];
    left.stars = (int)in[1];
    left.guides = (int)in[2];
    left.lost_stars = (int)in[3];
    left.matched_stars = (int)in[4];
    left.lost_guides = (int)in[5];
    left.matched_guides = (int)in[6];
    left.beside = (int)in[7];
    return tracker_contradicts(&left) + 2 * tracker_is_doubtful(&left);
}
/* Stars with residuals and variances, of which the first ones are used. */
int few(const int32_t *away, const uint32_t *variance, int count, int used)
{
    static struct tracker_pose pose;
    struct tracker_star star[TRACKER_MAX_STARS];
    int n, k;
    pose.stars = count;
    for (n = 0; n < count; n++) {
        star[n].variance = variance[n];
        pose.used[n] = (int16_t)(n < used ? n : -1);
        for (k = 0; k < 2; k++) {
            pose.inverse[n][k][k] = 65536;
            pose.inverse[n][k][1 - k] = 0;
            pose.predicted[n][k] = 1000 * n;
            pose.plane[n][k] = 1000 * n + away[2 * n + k];
        }
    }
    return tracker_few_disagree(&pose, star);
}
int position(const int32_t *matrix, const int32_t *direction, int32_t *xy)
{
    struct tracker_matrix attitude;
    struct tracker_vector v = {direction[0], direction[1], direction[2]};
    int k;
    for (k = 0; k < 3; k++) {
        attitude.row[k].x = matrix[3 * k];
        attitude.row[k].y = matrix[3 * k + 1];
        attitude.row[k].z = matrix[3 * k + 2];
    }
    return tracker_guide_position(&attitude, &v, xy);
}
"""


@pytest.fixture(scope="module")
def c(tmp_path_factory):
    guide = GuideDatabase.build(load_catalog("hipparcos"), CAMERA, 6.0)
    t = pose_tables(SimpleNamespace(camera=CAMERA, guide=guide))
    constants = {"MAX_STARS": MAX_STARS, "WIDTH": 1024, "HEIGHT": 1024, "SEARCH_KEPT": 4, **grid_constants(t.grid)}
    constants |= pose_constants(t) | unexplained_constants() | {"POSE_MAX_FIELD": MOST_FIELD}
    sky = CTable("int32_t", "guide_direction", "guide stars", t.guide)
    motion = CTable("int16_t", "guide_motion", "their proper motions", t.motion)
    arrays = [sky, motion, *grid_arrays(t.grid), *pose_arrays(t), *unexplained_arrays(MOST_FIELD)]
    return library(tmp_path_factory.mktemp("c"), POSE_MODULES, constants, arrays, SANITIZED, source=WRAPPER)


def array(kind, values):
    flat = np.ravel(values).tolist()
    return (kind * max(len(flat), 1))(*flat)


def fixed(xy):
    return array(ctypes.c_int32, np.rint(np.asarray(xy) * PIXEL).astype(np.int64))


def found_by(c, xy, seen, positions, matched):
    """`Unexplained` of the C."""
    out = (ctypes.c_int64 * 8)()
    flags = array(ctypes.c_uint8, seen), array(ctypes.c_uint8, matched)
    c.given(fixed(xy), flags[0], len(xy), fixed(positions), flags[1], len(positions), out)
    return Unexplained(out[0] / float(1 << CONTRAST_BITS), *out[1:])


@pytest.mark.parametrize("seed", range(40))
def test_the_part_with_most_contradiction_is_that_of_the_reference(c, seed):
    """Fields of which a part is matched less often, all around or on one side, with stars beside their guide stars and
    faint ends that are not matched. Logarithms have 20 fraction bits: six of them are wrong by 3e-6 at most."""
    rng = np.random.default_rng(seed)
    stars, guides = int(rng.integers(3, 61)), int(rng.integers(3, 140))
    near = min(stars, guides)
    positions, xy = rng.uniform(0.0, 1023.0, (guides, 2)), rng.uniform(0.0, 1023.0, (stars, 2))
    xy[:near] = positions[:near] + rng.uniform(-0.5, 0.5, (near, 2))
    away = np.hypot(*(xy[:near] - 500.0).T) - 300.0 if seed % 4 == 0 else (xy[:near] - 500.0) @ rng.normal(size=2)
    lost = rng.random(near) < np.where(away > 0.0, 0.2 + 0.7 * (seed % 3 > 0), 0.1)
    moved = lost & (rng.random(near) < 0.8)
    xy[:near][moved] = rng.uniform(0.0, 1023.0, (np.count_nonzero(moved), 2))
    seen, matched = np.zeros(stars, bool), np.zeros(guides, bool)
    seen[:near], matched[:near] = ~lost, ~lost
    orders = rng.permutation(stars), rng.permutation(guides)
    given = xy[orders[0]], seen[orders[0]], positions[orders[1]], matched[orders[1]]
    found, expected = found_by(c, *given), unexplained_of(*given)
    assert found.contrast == pytest.approx(expected.contrast, abs=5e-6)
    assert found[3:] == expected[3:]
    if expected.contrast > 0.0:
        assert found[1:3] == expected[1:3]
    assert (found.contradicts, found.is_doubtful) == (expected.contradicts, expected.is_doubtful)


def test_the_contrast_of_two_halves_is_that_of_the_likelihood_ratio(c):
    """Twelve matched on the left and twelve not on the right: 2 × 12 ln 2 on either side."""
    rng = np.random.default_rng(1)
    left, right, elsewhere = (rng.uniform((x, 50.0), (x + 400.0, 950.0), (12, 2)) for x in (50.0, 550.0, 550.0))
    matched = np.repeat([True, False], 12)
    found = found_by(c, np.concatenate([left, right]), matched, np.concatenate([left, elsewhere]), matched)
    assert found.contrast == pytest.approx(24.0 * math.log(2.0), abs=5e-6)
    assert found[1:] == (12, 12, 12, 12, 12, 12, 0)
    assert found.contradicts


def test_empty_and_small_lists_contradict_nothing(c):
    xy = np.arange(400.0).reshape(200, 2) * 5.0
    for stars, guides in ((0, 0), (0, 5), (5, 0), (2, 140), (60, 2), (60, 140)):
        for flag in (False, True):
            found = found_by(c, xy[:stars], np.full(stars, flag), xy[60 : 60 + guides], np.full(guides, flag))
            assert found.contrast == 0.0


LEFT = Unexplained(0.0, 0, 0, 0, 40, 0, 40, 0)


@pytest.mark.parametrize("matched", [1, 5, 10, 15, 20, 40, 60])
@pytest.mark.parametrize("contrast", [0.0, 3.9, 4.1, 5.9, LARGEST_CONTRAST, 6.1])
def test_the_limits_are_those_of_the_reference(c, matched, contrast):
    """Just below, at and above each fraction, and each number."""
    left = LEFT._replace(contrast=contrast, matched_stars=matched, matched_guides=matched)
    cases = [left._replace(stars=n, guides=m) for n in range(15) for m in (n - 1, n, n + 1) if m >= 0]
    lost = [0, 2, 3, *(round(1.5 * matched) + step for step in (-1, 0, 1))]
    cases += [left._replace(lost_stars=n, lost_guides=m) for n in lost for m in lost]
    cases += [left._replace(beside=matched + step) for step in (-1, 0, 1)]
    for one in cases:
        numbers = array(ctypes.c_int64, [round(one.contrast * (1 << CONTRAST_BITS)), *one[1:]])
        assert c.limits(numbers) == one.contradicts + 2 * one.is_doubtful, one


def test_three_or_four_stars_are_within_their_stated_errors(c):
    """4.5 of them, with 0.1 px of the camera's; unknown errors are 0.15 px (`stated_errors`)."""
    for sigma_px in (0.0, 0.01, 0.1, 1.0, 3.0):
        limit = FEW_STARS_SIGMAS * (math.hypot(sigma_px, 0.1) if sigma_px > 0.0 else 0.15)
        variance = array(ctypes.c_uint32, np.rint(np.full(6, sigma_px**2) * (1 << 26)).astype(np.int64))
        for angle in (0.0, 1.0, 2.5, 4.0):
            for share, off in ((0.999, 0), (1.001, 1), (30.0, 1), (20_000.0, 1)):
                away = np.zeros((6, 2))
                away[2] = share * limit * np.array([math.cos(angle), math.sin(angle)])
                given = fixed(np.clip(away, -30000.0, 30000.0)), variance
                assert [c.few(*given, 6, used) for used in range(7)] == [0, 0, 0, off, off, 0, 0]


@pytest.mark.parametrize("count", [400])
def test_guide_stars_near_the_border_are_not_on_the_image(c, count):
    """Positions are those of the camera to 0.003 px, and 6 px or more from its border."""
    rng = np.random.default_rng(3)
    xy = rng.uniform(-40.0, 1063.0, (count, 2))
    xy[: count // 2, 0] = rng.choice([5.0, 6.0, 1016.0, 1017.0], count // 2) + rng.uniform(-0.6, 0.6, count // 2)
    directions = np.rint(CAMERA.unproject(xy) * (1 << 30)).astype(np.int64)
    turned = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]) << 30  # v_camera = turned · v
    out, matrix = (ctypes.c_int32 * 2)(), array(ctypes.c_int32, np.minimum(turned, (1 << 31) - 1))
    inside = ((xy >= 5.5) & (xy < 1017.5)).all(axis=1)
    near = (np.abs(xy - 5.5) < 0.003).any(axis=1) | (np.abs(xy - 1017.5) < 0.003).any(axis=1)
    assert 100 < np.count_nonzero(inside) < 350
    for at, one, expected, doubtful in zip(xy, directions, inside, near, strict=True):
        got = c.position(matrix, array(ctypes.c_int32, np.clip((turned >> 30).T @ one, -(1 << 31), (1 << 31) - 1)), out)
        assert doubtful or got == expected
        if got:
            assert np.abs(np.array(out) / PIXEL - at).max() < 0.003
