"""What an attitude leaves unexplained: the kernels against plain sums, and each reason to refuse at its limit."""

import math

import numpy as np
import pytest

from startracker.unexplained import NOTHING, Unexplained, bright_items, contradiction, unexplained_of


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


def test_the_reason_in_words():
    left = Unexplained(7.0, 9, 8, 20, 30, 21, 40, 0)
    assert str(left) == "9 bright stars and 8 bright guide stars in one part of the image are unexplained"
    assert str(left._replace(contrast=0.0)) == "20 bright stars and 21 bright guide stars are unexplained"
    beside = left._replace(contrast=0.0, beside=31)
    assert str(beside) == "31 bright stars are beside their guide stars, and only 30 are on them"
