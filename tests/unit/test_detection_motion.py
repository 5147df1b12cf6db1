"""The motion of a trailed frame, and whether its stars are points or trails."""

import itertools
import math

import numpy as np
import pytest

from startracker.detection import Background, Spots
from startracker.detection.components import _round_stars, decide, line_up, looks_trailed, select_trailed, trails_win
from startracker.detection.forms import (
    MOTION_TOLERANCE_PX,
    MOTION_TOLERANCE_SHARE,
    _search,
    centres,
    common_motion,
    frame_motion,
    motion_at,
)
from startracker.settings import DetectionSettings
from tests.helpers.source_tables import objects


# ---------------------------------------------------------------------- motion of the frame
def streaks(count, motion, seed=5, spread=400.0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-spread, spread, (count, 2))
    return xy, motion_at(xy, np.array(motion)) * rng.choice([-1.0, 1.0], count)[:, None]


def test_a_motion_is_the_least_squares_of_its_streaks():
    xy, lines = streaks(9, (9.0, -4.0, 0.01))
    np.testing.assert_allclose(np.abs(common_motion(xy, lines)), [9.0, 4.0, 0.01], rtol=1e-9)
    rng = np.random.default_rng(6)
    noisy = lines + rng.normal(0.0, 0.3, lines.shape)
    found = common_motion(xy, noisy)
    signs = np.where((motion_at(xy, found) * noisy).sum(axis=1) < 0.0, -1.0, 1.0)
    zero, one = np.zeros(9), np.ones(9)
    rows = np.concatenate([np.column_stack([one, zero, -xy[:, 1]]), np.column_stack([zero, one, xy[:, 0]])])
    expected = np.linalg.lstsq(rows, (noisy * signs[:, None]).T.ravel(), rcond=None)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_the_motion_with_most_streaks_is_found_and_of_ties_the_nearest(seed):
    """Every pair with both signs; pairs that explain equally many streaks differ by the sum of the distances."""
    rng = np.random.default_rng(seed)
    xy, lines = streaks(8, (11.0, -6.0, 0.008), seed)
    lines = lines + rng.normal(0.0, 0.1, lines.shape)
    lines[6:] = rng.normal(0.0, 12.0, (2, 2))
    x, y = xy.T
    tried = []
    for i, k in itertools.combinations(range(8), 2):
        for sign in (1.0, -1.0):
            two = np.array([[1, 0, -y[i]], [0, 1, x[i]], [1, 0, -y[k]], [0, 1, x[k]]])
            motion = np.linalg.lstsq(two, np.concatenate([lines[i], sign * lines[k]]), rcond=None)[0]
            expected = motion_at(xy, motion)
            apart = np.minimum(np.hypot(*(lines - expected).T), np.hypot(*(lines + expected).T))
            near = apart <= MOTION_TOLERANCE_PX + MOTION_TOLERANCE_SHARE * np.hypot(*expected.T)
            tried.append((-near.sum(), apart[near].sum(), motion))
    least = min(tried, key=lambda row: row[:2])
    assert sum(row[0] == least[0] for row in tried) > 1  # several pairs explain as many
    count, motion = _search(xy, lines, 8)
    assert count == -least[0]
    np.testing.assert_allclose(motion, least[2], rtol=1e-7)


@pytest.mark.parametrize(
    ("agreeing", "others", "length", "found"),
    [
        (3, 0, 12.0, False),
        (4, 0, 12.0, True),
        (6, 4, 12.0, True),
        (5, 5, 12.0, False),  # six of ten
        (6, 4, 9.0, False),
        (7, 3, 9.0, True),  # of a short motion seven
        (9, 0, 3.1, True),
        (9, 0, 2.9, False),
    ],
)
def test_how_many_streaks_a_motion_needs(agreeing, others, length, found):
    xy, lines = streaks(agreeing, (length, 0.0, 0.0))
    rng = np.random.default_rng(7)
    more, angle = rng.uniform(-400.0, 400.0, (others, 2)), np.linspace(0.6, 2.5, others)
    odd = 40.0 * np.column_stack([np.cos(angle), np.sin(angle)]) * np.linspace(1.0, 4.0, max(others, 1))[:others, None]
    motion = common_motion(np.concatenate([xy, more]), np.concatenate([lines, odd]))
    assert (motion is not None) is found


def test_of_all_pairs_the_one_that_explains_most_and_best():
    xy, lines = streaks(6, (9.0, -4.0, 0.01))
    most, motion = _search(xy, lines, 6)
    assert most == 6
    np.testing.assert_allclose(np.abs(motion), [9.0, 4.0, 0.01], rtol=1e-9)
    assert _search(xy, lines, 4)[0] == 4
    # a line off by more than a pixel and an eighth of its length is not explained
    for off, count in ((1.0 + 0.11 * np.hypot(9.0, 4.0), 6), (1.0 + 0.13 * np.hypot(9.0, 4.0), 5)):
        still, straight = streaks(6, (9.0, -4.0, 0.0))
        straight[5] += off * np.array([4.0, 9.0]) / np.hypot(9.0, 4.0) * np.sign(straight[5, 0])
        assert _search(still, straight, 5)[0] == 5
        expected = motion_at(still, np.array([9.0, -4.0, 0.0]))
        apart = min(np.hypot(*(straight[5] - s * expected[5])) for s in (1, -1))
        assert apart == pytest.approx(off)
        fits = np.hypot(*(straight * np.sign(straight[:, :1]) - expected).T) <= 1.0 + 0.12 * np.hypot(9.0, 4.0)
        assert fits.sum() == count


@pytest.mark.parametrize("train", [6, 10, 14])
def test_a_train_of_satellites_is_not_the_motion_of_the_frame(train):
    """They are the brightest, and draw parallel lines; the stars are more."""
    stars, lines = streaks(24, (9.0, -4.0, 0.01))
    satellites, tracks = streaks(train, (-20.0, 30.0, 0.0), seed=8)
    xy, all_lines = np.concatenate([satellites, stars]), np.concatenate([tracks, lines])
    found = frame_motion(xy, all_lines)
    np.testing.assert_allclose(np.abs(found), [9.0, 4.0, 0.01], rtol=1e-6)
    alone = frame_motion(satellites, tracks)
    np.testing.assert_allclose(np.abs(alone), [20.0, 30.0, 0.0], atol=1e-9)


def test_streaks_that_share_nothing():
    rng = np.random.default_rng(10)
    xy, angle = rng.uniform(-400.0, 400.0, (9, 2)), np.linspace(0.0, 2.8, 9)
    lines = np.geomspace(10.0, 200.0, 9)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    assert common_motion(xy, lines) is None
    assert frame_motion(xy, lines) is None


# ---------------------------------------------------------------------- points or trails
def pairs(angle, count, other=0, seed=11):
    """Pairs of objects 20 px apart along a direction, and pairs in all directions."""
    rng = np.random.default_rng(seed)
    place = np.stack(np.divmod(np.arange(count + other), 12), axis=1) * 120.0 + 60.0
    turn = np.concatenate([np.full(count, angle), np.arange(other) * math.pi / max(other, 1) + 0.001])
    off = 20.0 * np.column_stack([np.cos(turn), np.sin(turn)])
    xy = np.rint(np.concatenate([place, place + off * rng.choice([-1, 1], count + other)[:, None]])).astype(int)
    return objects(len(xy), x_peak=xy[:, 0], y_peak=xy[:, 1], flux=np.arange(len(xy), 0.0, -1.0))


@pytest.mark.parametrize("degrees", [4.0, 45.0, 95.0, 176.0])
def test_objects_that_line_up(degrees):
    """To a third of a bin of 10°, as objects lie on whole pixels."""
    found = math.degrees(line_up(pairs(math.radians(degrees), 30)))
    assert abs((found - degrees + 90.0) % 180.0 - 90.0) < 5.0


@pytest.mark.parametrize(("count", "other", "found"), [(8, 0, True), (7, 0, False), (30, 36, True), (12, 54, False)])
def test_how_many_must_line_up(count, other, found):
    """Eight, and five Poisson errors above the mean of three bins of eighteen."""
    table = pairs(math.radians(45.0), count, other)
    assert (line_up(table) is not None) is found
    mean = 3.0 * (count + other) / 18.0
    expected = count + other / 6.0
    assert (expected >= max(8.0, mean + 5.0 * math.sqrt(mean))) is found


def test_only_neighbours_among_the_brightest_line_up():
    table = pairs(math.radians(45.0), 30)
    far = table.copy()
    far["x_peak"] *= 3
    far["y_peak"] *= 3
    assert line_up(far) is None
    brighter = objects(150, x_peak=np.arange(150) * 100, y_peak=5000, flux=1e6)
    assert line_up(np.concatenate([brighter, table])) is None
    assert line_up(np.concatenate([brighter[:90], table])) is not None
    same = table.copy()
    same["x_peak"], same["y_peak"] = 50, 60  # on one pixel they have no direction
    assert line_up(same) is None


def test_reasons_to_look_for_trails():
    """A quarter of the whole objects were split, three at least; or three of the brightest are long."""
    settings = DetectionSettings(max_axis_ratio=4.0, min_pixels=3)
    table = objects(12, pixels=12, flux=np.arange(12, 0.0, -1.0), peak=1.0)
    table["sum_xx"] = table["sum_yy"] = table["flux"] * 2.0
    assert not looks_trailed(table, 2, settings)
    assert looks_trailed(table, 3, settings)
    small = table.copy()
    small["pixels"] = 11
    many = np.concatenate([table, table])
    assert not looks_trailed(many, 4, settings)  # 0.25 of 24 less those of the parts, 20
    assert looks_trailed(many, 5, settings)
    assert looks_trailed(small, 3, settings)
    for ratio, found in ((2.5, True), (2.2, False)):  # 0.6 of the limit, with the pixel
        long = table.copy()
        long["sum_xx"][:3] = table["flux"][:3] * ((2.0 + 1 / 12) * ratio - 1 / 12)
        assert looks_trailed(long, 0, settings) is found
        long["sum_xx"][2] = table["sum_xx"][2]
        assert not looks_trailed(long, 0, settings)


def trail_table(lines, flux=9e3, across=0.8):
    """Objects with the moments of lines of these lengths (N, 2), on a grid of 60 px."""
    count = len(lines)
    at = np.stack(np.divmod(np.arange(count), 6)[::-1], axis=1) * 60.0 + 50.0
    table = objects(count, pixels=30, flux=flux, peak=50.0, x_peak=at[:, 0], y_peak=at[:, 1])
    table["flux"] = flux * np.linspace(1.0, 0.8, count)
    xx, yy, xy = across + lines[:, 0] ** 2 / 12, across + lines[:, 1] ** 2 / 12, lines[:, 0] * lines[:, 1] / 12
    f = table["flux"]
    table["sum_x"], table["sum_y"] = f * at[:, 0], f * at[:, 1]
    table["sum_xx"], table["sum_yy"] = f * (xx + at[:, 0] ** 2), f * (yy + at[:, 1] ** 2)
    table["sum_xy"] = f * (xy + at[:, 0] * at[:, 1])
    return table


def test_stars_of_a_trailed_frame():
    """Long objects of 12 pixels and twice the threshold that fit the motion, off the border; what else there is, by
    reason."""
    background = Background(np.zeros((400, 420), np.float32), np.full((400, 420), 10.0, np.float32))
    settings = DetectionSettings(threshold_sigma=5.0, max_stars=15)
    lines = np.tile([12.0, 5.0], (24, 1))
    lines[3] = 12.0, -9.0  # a satellite
    lines[5] = 0.0, 0.0  # a point
    table = trail_table(lines)
    table["edge"][8] = True
    table["pixels"][9] = 11
    limit = 2.0 * 5.0 * 1.2 * 10.0 * math.sqrt(30.0)
    table["flux"][10], table["flux"][11] = 0.99 * limit, 1.01 * limit
    for name in ("sum_x", "sum_y", "sum_xx", "sum_yy", "sum_xy"):
        for k in (10, 11):
            table[name][k] *= table["flux"][k] / (9e3 * np.linspace(1.0, 0.8, 24)[k])
    found = select_trailed(table, settings, True, background, 1.2)
    fitting = [k for k in range(24) if k not in (3, 5, 8, 9, 10, 11)] + [11]
    np.testing.assert_allclose(found.centre, centres(table)[fitting[:15]], rtol=1e-9)
    np.testing.assert_allclose(found.streak, np.tile([12.0, 5.0], (15, 1)) * np.sign(found.streak[:, :1]), rtol=1e-6)
    assert found.rejected == {"streak": 2, "not smeared as the frame": 1, "fainter than the brightest": 4}
    assert found.flux[0] == 9e3
    np.testing.assert_array_equal(found.x_peak, np.rint(found.centre[:, 0]))
    assert not found.edge.any()
    assert select_trailed(table[:3], settings, True, background, 1.2) is None


def drawn(centres_xy, path, sigma2=0.8, flux=2e4, shape=(300, 300), parts=40):
    y, x = np.mgrid[: shape[0], : shape[1]]
    image = np.zeros(shape)
    for t in (np.arange(parts) + 0.5) / parts - 0.5:
        for a, b in centres_xy:
            cut = (slice(int(b) - 25, int(b) + 26), slice(int(a) - 25, int(a) + 26))
            square = (x[cut] - a - t * path[0]) ** 2 + (y[cut] - b - t * path[1]) ** 2
            image[cut] += flux / parts * np.exp(-0.5 * square / sigma2) / (2.0 * math.pi * sigma2)
    return image


def candidates(xy, **changes):
    xy = np.asarray(xy, float)
    x, y = np.rint(xy).astype(np.int64).T
    none = np.zeros(len(xy), bool)
    given = {"saturated": none, "edge": none.copy()} | changes
    return Spots(
        x, y, np.ones(len(xy)), np.full(len(xy), 9), given["saturated"], given["edge"], xy, np.zeros((len(xy), 2))
    )


def test_round_stars_are_no_pieces_of_trails():
    """Points of the width of the trails, off them by 4 px along and across; hot pixels, wide blobs, saturated ones and
    those at the border do not count."""
    trails = np.array([[60.0 + 60.0 * (k % 4), 60.0 + 120.0 * (k // 4)] for k in range(8)])
    path = np.array([16.0, 6.0])
    points = np.array([[40.0 + 50.0 * k, 120.0] for k in range(5)])
    image = drawn(trails, path) + drawn(points, (0.0, 0.0))
    unit = path / np.hypot(*path)
    across = np.array([-unit[1], unit[0]])
    off = 0.5 * np.hypot(*path)
    extra = [
        (trails[0] + unit * (off + 3.9), True),
        (trails[1] + unit * (off + 4.1), False),
        (trails[2] + across * 3.9, True),
        (trails[3] + across * 4.1, False),
    ]
    flat = Background(np.zeros(image.shape, np.float32), np.full(image.shape, 2.0, np.float32))
    image[200, 200] += 3e3  # a hot pixel
    image = image + drawn([[250.0, 215.0]], (0.0, 0.0), 4.0)
    xy = np.concatenate([points, [place for place, _ in extra], [[200.0, 200.0], [250.0, 215.0]]])
    star, on_trail, major = _round_stars(trails, np.tile(path, (8, 1)), candidates(xy), image.astype(np.float32), flat)
    assert star[:5].all()
    assert on_trail.tolist() == [False] * 5 + [on for _, on in extra] + [False] * 2
    assert not star[-2:].any()
    assert major[0] == pytest.approx(0.8 + 1.0 / 12.0, abs=0.15)
    flags = np.arange(len(xy)) == 1
    for name in ("saturated", "edge"):
        left = _round_stars(
            trails, np.tile(path, (8, 1)), candidates(xy, **{name: flags}), image.astype(np.float32), flat
        )[0]
        assert left[:5].tolist() == [True, False, True, True, True]
    short = np.tile(path, (8, 1)), image.astype(np.float32), flat
    assert not trails_win(trails, short[0], candidates(points), *short[1:])  # five
    assert trails_win(trails, short[0], candidates(points[:4]), *short[1:])
    spots_of_trails = candidates(trails)
    spots_of_trails = Spots(
        *(getattr(spots_of_trails, n) for n in ("x_peak", "y_peak", "flux", "pixels", "saturated", "edge", "centre")),
        short[0],
    )
    chosen = decide(spots_of_trails, candidates(points[:4]), *short[1:], 3)
    assert chosen.are_streaks
    assert len(chosen.other) == 3
    beside = decide(spots_of_trails, candidates(np.concatenate([points, trails[:2]])), *short[1:], 6)
    assert beside.other is spots_of_trails
    assert beside.x_peak.tolist() == points[:, 0].tolist()
