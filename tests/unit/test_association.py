"""Association of centroids and guide stars at a known attitude, against plain sorting of all distances."""

import math

import numpy as np
import pytest

from startracker import Attitude, Camera, StarTracker
from startracker.catalog.guide import field_cosine
from startracker.estimation.association import MARGIN_PX, Field, matched_again, paired

CAMERA = Camera.from_fov(12.0, 512, 512)
ATTITUDE = Attitude.from_radec_roll(83.0, -1.0, 20.0)


def unique_pairs(distance, gate):
    """Nearest star of each centroid within its gate; of several with one star the nearest in units of its gate."""
    owner, found = {}, np.full(len(distance), -1)
    for n in range(len(distance)):
        near = [k for k in range(distance.shape[1]) if distance[n, k] <= gate[n]]
        if near:
            k = min(near, key=lambda k: distance[n, k])
            if k not in owner or distance[n, k] / gate[n] < distance[owner[k], k] / gate[owner[k]]:
                if k in owner:
                    found[owner[k]] = -1
                owner[k], found[n] = n, k
    return found


def plain_names(xy, stated, positions, factor, systematic, near_px):
    """The rule of `paired`, written out."""
    away = xy[:, None] - positions[None]
    distance = np.hypot(*away.transpose(2, 0, 1))
    covariance = factor * stated + systematic * np.eye(2)
    mahalanobis = np.einsum("nki,nij,nkj->nk", away, np.linalg.inv(covariance), away)
    widest = np.linalg.eigvalsh(stated)[:, 1]
    gate = 3.7 * np.sqrt(factor * widest + systematic)
    near = unique_pairs(distance, gate)
    for n, k in enumerate(near):
        if k >= 0 and mahalanobis[n, k] > 3.7**2:
            near[n] = -1
    owner = {k: n for n, k in enumerate(near) if k >= 0}
    groups = {n: [xy[n]] for n in range(len(xy))}
    for n in range(len(xy)):
        if near[n] < 0:
            inside = [k for k in owner if distance[n, k] <= gate[n] and mahalanobis[n, k] <= 3.7**2]
            if inside:
                groups[owner[min(inside, key=lambda k: distance[n, k])]].append(xy[n])
    merged = np.array([np.mean(groups[n], axis=0) for n in range(len(xy))])
    left = distance.copy()
    left[:, list(owner)] = np.inf
    late = unique_pairs(left, np.where(near < 0, near_px, -1.0))
    star = np.where(near >= 0, near, late)
    rows = np.flatnonzero(star >= 0)
    return np.column_stack([rows, star[rows]]), near[rows] >= 0, merged


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("trailed", [False, True])
def test_names_duplicates_and_stars_that_do_not_fit(seed, trailed):
    """Centroids about 25 guide stars, some of them twice, with errors of one size or far larger along a trail."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(0.0, 60.0, (25, 2))
    sigma = rng.uniform(0.1, 0.4, 40)
    shape = np.array([[9.0, 3.0], [3.0, 1.6]]) if trailed else np.eye(2)
    stated = sigma[:, None, None] ** 2 * shape
    xy = positions[rng.integers(0, 25, 40)] + 2.0 * np.einsum(
        "nij,nj->ni", np.linalg.cholesky(stated), rng.normal(size=(40, 2))
    )
    index = rng.permutation(100)[:25]
    for factor, systematic, near_px in ((1.0, 0.0, 2.5), (2.0, 0.04, 1.0)):
        pairs, fits, merged = paired(xy, stated, index, positions, factor, systematic, near_px)
        expected = plain_names(xy, stated, positions, factor, systematic, near_px)
        assert pairs[:, 0].tolist() == expected[0][:, 0].tolist()
        assert pairs[:, 1].tolist() == index[expected[0][:, 1]].tolist()
        assert fits.tolist() == expected[1].tolist()
        np.testing.assert_allclose(merged, expected[2], rtol=1e-12)
    assert fits.any()
    assert (merged != xy).any()


@pytest.fixture(scope="module")
def sky():
    guide = StarTracker(CAMERA, magnitude_limit=6.5).guide
    index, _, positions = guide.in_field(ATTITUDE.as_matrix(), 3.0)
    field = Field(guide.directions, guide.grid, field_cosine(CAMERA), CAMERA.image_map)
    return guide, index, positions, field


@pytest.mark.parametrize("count", [4, 9, 10, 20])
@pytest.mark.parametrize(("known", "size"), [(True, 0.01), (True, 0.7), (True, 3.0), (False, 3.0), (False, 1e-6)])
def test_the_gate_of_a_new_match_follows_the_residuals(sky, count, known, size):
    """3.7 robust standard errors: at least the stated ones of few stars, 0.4 times these of ten and more, and a floor
    of 0.003 px for unknown ones."""
    guide, index, positions, field = sky
    rng = np.random.default_rng(count)
    sigma = np.full(count + 1, 0.2 if known else 1.0)
    xy = positions[: count + 1] + size * (0.2 if known else 1.0) * rng.normal(size=(count + 1, 2))
    used = np.column_stack([np.arange(count), index[:count]])
    length = np.hypot(*(xy - positions[: count + 1]).T)[:count] / sigma[:count]
    scale = np.median(length) / math.sqrt(2.0 * math.log(2.0)) / math.sqrt(max(1.0 - 1.5 / count, 0.2))
    if known:
        scale = max(scale, 0.4 if count >= 10 else 1.0)
    scale = max(scale, 3e-3) if not known else scale
    gate = 3.7 * scale * sigma[0]
    for share, inside in ((0.99, True), (1.01, False)):
        xy[count] = positions[count] + [share * gate * 0.6, share * gate * 0.8]
        near = unique_pairs(np.hypot(*(xy[:, None] - positions[None]).transpose(2, 0, 1)), np.full(count + 1, gate))
        pairs, same = matched_again(used, ATTITUDE.as_matrix(), guide.directions[used[:, 1]], xy, sigma, known, field)
        rows = np.flatnonzero(near >= 0)
        assert pairs.tolist() == np.column_stack([rows, index[near[rows]]]).tolist()
        assert inside or near[count] != count
        assert same is (pairs.tolist() == used.tolist())
    assert MARGIN_PX == 3.0
