"""What an attitude leaves unexplained: the kernels against plain sums, and each reason to refuse at its limit."""

import math

import numpy as np
import pytest

from startracker import Attitude, StarTracker
from startracker.detection import Background
from startracker.detection.background import Light
from startracker.geometry.camera import Camera
from startracker.unexplained import (
    NO_ROWS,
    NOTHING,
    Fitted,
    Unexplained,
    bright_items,
    contradiction,
    guide_stars_there,
    of_guide_stars,
    reason_to_refuse,
    unexplained_of,
)


def log_likelihood(matched, unmatched):
    n = matched + unmatched
    return sum(k * math.log(k / n) for k in (matched, unmatched)) if min(matched, unmatched) > 0 else 0.0


def twin_of_contradiction(kind, position):
    """The largest contrast over all lines in 16 directions and all circles about the middle of the matched guide stars:
    of each line the stars on one side are compared with the whole."""
    total = np.bincount(kind, minlength=5)
    best = (0.0, 0, 0)
    if min(total[0], total[2]) >= 3 and min(total[1], total[3]) > 0:
        middle = position[kind == 3].mean(axis=0)
        keys = [position @ (math.cos(a), math.sin(a)) for a in np.arange(16) * math.pi / 8.0]
        for key in [*keys, -np.hypot(*(position - middle).T)]:
            order = np.argsort(key, kind="stable")
            for end in range(1, len(kind) + 1):
                out = np.bincount(kind[order[:end]], minlength=5)
                if min(out[0], out[2]) < 3:
                    continue
                contrast = []
                for lost in (0, 2):
                    fewer = out[lost + 1] * total[lost] < out[lost] * total[lost + 1]
                    split = log_likelihood(out[lost + 1], out[lost])
                    split += log_likelihood(total[lost + 1] - out[lost + 1], total[lost] - out[lost])
                    contrast.append(split - log_likelihood(total[lost + 1], total[lost]) if fewer else 0.0)
                if min(contrast) > best[0] + 1e-12:
                    best = (min(contrast), out[0], out[2])
    return (*best, *total)


@pytest.mark.parametrize("seed", range(12))
def test_the_part_with_most_contradiction_is_that_of_all_lines_and_circles(seed):
    """Random fields, in which a half, or all outside a circle, is matched less often."""
    rng = np.random.default_rng(seed)
    count = 20 + 3 * seed
    position = rng.uniform(-1.0, 1.0, (count, 2)) * (1.0 if seed % 2 else 500.0) + 40.0 * (seed % 3)
    centred = (position - position.mean(axis=0)) / position.std()
    away = np.hypot(*centred.T) - 1.2 if seed % 4 == 0 else centred @ (math.cos(seed), math.sin(seed))
    side = rng.integers(0, 2, count)
    kind = 2 * side + (rng.random(count) < np.where(away > 0.0, 0.15, 0.9))
    kind[rng.random(count) < 0.05] = 4
    found, expected = contradiction(kind, position), twin_of_contradiction(kind, position)
    assert found[0] == pytest.approx(expected[0], rel=1e-9, abs=1e-12)
    assert tuple(found[3:]) == expected[3:]
    if expected[0] > 0.0:
        assert tuple(found[1:3]) == expected[1:3]


def test_a_contradiction_needs_three_of_each_and_one_that_is_matched():
    """Six kinds on the left against as many on the right."""
    kind = np.array([0, 0, 0, 2, 2, 2, 1, 1, 1, 3, 3, 3])
    position = np.stack([np.repeat([0.0, 10.0], 6), np.zeros(12)], axis=1)
    found = contradiction(kind, position)
    assert found == (pytest.approx(6.0 * math.log(2.0)), 3, 3, 3, 3, 3, 3, 0)
    for left_out in (0, 3):  # two unmatched ones of either side are chance
        assert contradiction(np.delete(kind, left_out), np.delete(position, left_out, axis=0))[0] == 0.0
    for matched in (1, 3):
        kept = kind != matched
        assert contradiction(kind[kept], position[kept])[0] == 0.0
        few = kept.copy()
        few[np.flatnonzero(kind == matched)[0]] = True
        assert contradiction(kind[few], position[few])[0] > 0.0


def twin_of_bright_items(xy, seen, positions, matched):
    def bright(flags):
        counted = np.cumsum(flags)
        reached = np.flatnonzero(counted >= 0.9 * counted[-1])
        return int(reached[0]) + 1

    fewer = min(len(xy), len(positions))
    stars, guides = max(bright(seen), fewer), max(bright(matched), fewer)
    if min(np.sum(~seen[:stars]), np.sum(~matched[:guides])) < 3:
        return [], []
    items = []
    for n in range(stars):
        beside = not seen[n] and np.hypot(*(positions - xy[n]).T).min() < 3.0
        items.append((4 if beside else int(seen[n]), *xy[n]))
    for k in range(guides):
        if matched[k] or np.hypot(*(xy - positions[k]).T).min() >= 3.0:
            items.append((2 + int(matched[k]), *positions[k]))
    return [item[0] for item in items], [item[1:] for item in items]


@pytest.mark.parametrize("seed", range(10))
def test_bright_stars_are_those_down_to_the_faintest_of_most_matched(seed):
    rng = np.random.default_rng(seed)
    stars, guides = rng.integers(12, 50, 2)
    positions = rng.uniform(0.0, 100.0, (guides, 2))
    xy = rng.uniform(0.0, 100.0, (stars, 2))
    near = min(stars, guides) // 2
    xy[:near] = positions[:near] + rng.uniform(-3.0, 3.0, (near, 2))
    order = rng.permutation(stars)
    xy, seen, matched = xy[order], rng.random(stars) < 0.6, rng.random(guides) < 0.6
    if seed % 3 == 0:  # the faint end is not matched at all
        seen[stars // 2 :], matched[guides // 3 :] = False, False
    kind, position = bright_items(xy, seen, positions, matched)
    expected = twin_of_bright_items(xy, seen, positions, matched)
    assert kind.tolist() == expected[0]
    np.testing.assert_array_equal(position, np.array(expected[1]).reshape(-1, 2))


def test_two_unmatched_stars_are_no_contradiction():
    xy = np.arange(40.0).reshape(20, 2) * 10.0
    positions = xy + 500.0
    for lost in ((2, 9), (9, 2), (3, 3)):
        seen, matched = np.arange(20) >= lost[0], np.arange(20) >= lost[1]
        assert (unexplained_of(xy, seen, positions, matched) is not NOTHING) is (lost == (3, 3))


@pytest.mark.parametrize(
    ("changes", "contradicts", "part", "doubtful"),
    [
        ({}, False, False, False),
        # one part of the image: G above 6, of at least a fifth of the matched ones on both sides
        ({"contrast": 6.1, "stars": 8, "guides": 8}, True, True, True),
        ({"contrast": 6.0, "stars": 8, "guides": 8}, False, False, True),
        ({"contrast": 6.1, "stars": 7, "guides": 8}, False, False, True),
        ({"contrast": 6.1, "stars": 8, "guides": 7}, False, False, True),
        # a doubt: G above 4 and six stars
        ({"contrast": 4.1, "stars": 6}, False, False, True),
        ({"contrast": 4.0, "stars": 6}, False, False, False),
        ({"contrast": 4.1, "stars": 5}, False, False, False),
        # everywhere: less than 0.4 of the side that is explained better
        ({"lost_stars": 61, "lost_guides": 61}, True, False, False),
        ({"lost_stars": 59, "lost_guides": 61}, False, False, False),
        ({"lost_stars": 61, "lost_guides": 59}, False, False, False),
        ({"matched_stars": 1, "lost_stars": 3, "matched_guides": 1, "lost_guides": 3}, True, False, False),
        ({"matched_stars": 1, "lost_stars": 2, "matched_guides": 1, "lost_guides": 3}, False, False, False),
        ({"matched_stars": 1, "lost_stars": 3, "matched_guides": 1, "lost_guides": 2}, False, False, False),
        ({"beside": 40}, False, False, False),
        ({"beside": 41}, True, False, False),
    ],
)
def test_each_reason_to_refuse_has_its_limit(changes, contradicts, part, doubtful):
    left = Unexplained(0.0, 0, 0, 0, 40, 0, 40, 0)._replace(**changes)
    assert (left.contradicts, left.leaves_a_part, left.is_doubtful) == (contradicts, part, doubtful)


@pytest.mark.parametrize(
    ("changes", "uneven", "mostly_false"),
    [
        ({}, False, False),
        ({"contrast": 6.1}, True, False),
        ({"contrast": 6.0}, False, False),
        ({"lost_stars": 40}, False, False),
        ({"lost_stars": 41}, False, True),
    ],
)
def test_limits_of_what_is_looked_at_more_closely(changes, uneven, mostly_false):
    left = Unexplained(0.0, 0, 0, 0, 40, 0, 40, 0)._replace(**changes)
    assert (left.is_uneven, left.is_mostly_false) == (uneven, mostly_false)


# ---------------------------------------------------------------------- guide stars of an image
CAMERA = Camera.from_fov(15.0, 1024, 1024)


@pytest.fixture(scope="module")
def guide():
    return StarTracker(CAMERA, magnitude_limit=6.5).guide


def fitted(guide, matched_of):
    """A fit of the guide stars of a field that a function of their positions chooses; their positions and light."""
    attitude = Attitude.from_radec_roll(85.0, 0.0, 30.0).as_matrix()
    index, _, positions = guide.in_field(attitude, -6.0, CAMERA)
    matched = np.flatnonzero(matched_of(positions))
    pairs = np.stack([np.arange(len(matched)), index[matched]], axis=1)
    return Fitted(pairs, np.zeros((len(matched), 2)), attitude, CAMERA), positions, positions[matched]


def light_at(positions):
    image = np.full((1024, 1024), 100.0, np.float32)
    x, y = np.rint(positions).astype(int).T
    image[y, x] = 200.0
    return Light(image, Background(np.full_like(image, 100.0), np.full_like(image, 2.0)), 5.0)


def some_false(xy, count):
    """False stars, sixty px or more from each other and the border, brighter than all others."""
    grid = np.stack(np.meshgrid(np.arange(32.0, 1024.0, 80.0), np.arange(32.0, 1024.0, 80.0)), axis=-1).reshape(-1, 2)
    return np.concatenate([np.random.default_rng(1).permutation(grid)[:count], xy])


def shifted(fit, count):
    return fit._replace(pairs=fit.pairs + np.array([count, 0]))


def refusal(guide, fit, xy, light, **how):
    return reason_to_refuse(xy, np.full(len(xy), 0.1), fit, guide, NO_ROWS, lambda rows: NO_ROWS, light, **how)


def test_a_guide_star_is_there_if_it_is_matched_or_has_light(guide):
    """Three of four are matched, all but those on the right fifth have light; one beside a centroid is not counted."""
    fit, positions, xy = fitted(guide, lambda p: np.arange(len(p)) % 4 > 0)
    dark = positions[:, 0] > 819.0
    beside = np.append(xy, positions[[0]] + 5.0, axis=0)
    known, there = guide_stars_there(beside, fit, guide, light_at(positions[~dark]))
    assert not np.any(np.all(known == positions[0], axis=1))
    matched = np.isin(known[:, 0], xy[:, 0])
    assert np.array_equal(there, matched | (known[:, 0] <= 819.0))
    assert 0 < np.count_nonzero(~there) < np.count_nonzero(there)


def test_guide_stars_without_light_in_one_part_refuse_an_image_of_mostly_false_stars(guide):
    """The list is that of a ridge: as many false stars as matched ones and more, evenly. The right fifth of the guide
    stars is matched or lit like the rest, or neither, which only that image refuses."""
    for border in (1024.0, 819.0):
        _, positions, _ = fitted(guide, lambda p: p[:, 0] > 0.0)
        lit = positions[:, 0] < border
        fit, _, xy = fitted(guide, lambda p, lit=lit: (np.arange(len(p)) % 2 > 0) & lit)
        for false, refused in ((len(xy) + 5, border < 1024.0), (0, False)):
            stars, moved = some_false(xy, false), shifted(fit, false)
            reason = refusal(guide, moved, stars, light_at(positions[lit]))
            assert bool(reason) == refused, reason
            assert not reason or "without a star or any light" in reason
            photograph = refusal(guide, moved, stars, light_at(positions[lit]), follows_v=False)
            assert "any light" not in photograph  # they may be behind trees


def test_few_matched_stars_everywhere_are_refused_without_light_and_if_the_order_is_that_of_v(guide):
    fit, positions, xy = fitted(guide, lambda p: np.arange(len(p)) % 4 == 0)
    false = 3 * len(xy)
    stars, fit = some_false(xy, false), shifted(fit, false)
    assert "are unexplained" in refusal(guide, fit, stars, None)
    assert not refusal(guide, fit, stars, None, follows_v=False)
    assert not refusal(guide, fit, stars, light_at(positions))
    half = light_at(positions[np.arange(len(positions)) % 8 < 3])
    assert "are unexplained" in refusal(guide, fit, stars, half)


def test_the_guide_stars_alone_count_for_both_sides():
    rng = np.random.default_rng(2)
    positions = rng.uniform(0.0, 1000.0, (40, 2))
    there = positions[:, 0] < 800.0
    found = of_guide_stars(positions, there)
    n, lost = 40, np.count_nonzero(~there)
    assert found.contrast == pytest.approx(
        -(lost * math.log(lost / n) + (n - lost) * math.log((n - lost) / n)), rel=1e-12
    )
    assert (found.stars, found.guides, found.lost_guides) == (lost, lost, lost)


def test_the_reason_in_words():
    left = Unexplained(7.0, 9, 8, 20, 30, 21, 40, 0)
    assert str(left) == "9 bright stars and 8 bright guide stars in one part of the image are unexplained"
    assert str(left._replace(contrast=0.0)) == "20 bright stars and 21 bright guide stars are unexplained"
    beside = left._replace(contrast=0.0, beside=31)
    assert str(beside) == "31 bright stars are beside their guide stars, and only 30 are on them"
