"""Yee's clustering against a plain twin, and bad-pixel maps against planted ones."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.special import erf

from simulator.theses.detectors.clustering import adaptive_radius, cluster_pixels, find_clusters, merge_clusters
from startracker.detection import Background, estimate, find_bad_pixels, mask_pixels
from startracker.detection.sources import SOURCE, find_runs
from startracker.errors import InputError
from startracker.settings import DetectionSettings


def flat(shape):
    return Background(np.zeros(shape, np.float32), np.ones(shape, np.float32))


def twin(image, threshold, tau, growth=0.0):
    """The thesis' words: pixel by pixel, nearest centre within τ or a new cluster; the centre moves along."""
    centres, members = [], []
    for y, x in zip(*np.nonzero(image > threshold), strict=True):
        distance = [
            d if d <= max(tau, growth * np.sqrt(len(own))) else np.inf
            for d, own in zip((np.hypot(x - cx, y - cy) for cx, cy in centres), members, strict=True)
        ]
        if distance and min(distance) < np.inf:
            k = int(np.argmin(distance))
            members[k].append((x, y))
            centres[k] = tuple(np.mean(members[k], axis=0))
        else:
            members.append([(x, y)])
            centres.append((x, y))
    return members


@pytest.mark.parametrize(("tau", "growth"), [(2.0, 0.0), (3.3, 0.0), (8.0, 0.0), (2.0, 1.0), (3.3, 1.7)])
@pytest.mark.parametrize("density", [0.01, 0.06])
def test_one_pass_equals_its_twin(tau, growth, density):
    rng = np.random.default_rng([int(tau * 10), int(density * 100)])
    image = np.where(rng.random((70, 90)) < density, rng.uniform(10, 20, (70, 90)), 0).astype(np.float32)
    background = flat(image.shape)
    runs = find_runs(image, background.level, background.noise, np.float32(5.0))
    table = cluster_pixels(runs, tau, image, np.zeros_like(image), np.inf, growth)
    members = twin(image, 5.0, tau, growth)
    sizes = sorted(len(m) for m in members)
    fluxes = sorted(sum(float(image[y, x]) for x, y in m) for m in members)
    # a pixel equally near to two centres may go to either: at most one in twenty clusters
    if len(table) == len(members):
        assert np.mean(np.sort(table["pixels"]) != sizes) < 0.05
        assert np.mean(~np.isclose(np.sort(table["flux"]), fluxes, rtol=1e-9)) < 0.08
    assert abs(len(table) - len(members)) <= 0.02 * len(members)
    assert table["pixels"].sum() == np.count_nonzero(image > 5.0)


def star_frame(seed, count=25):
    rng = np.random.default_rng(seed)
    image = rng.normal(100, 4, (300, 300))
    places = np.array([(x, y) for x in range(30, 280, 55) for y in range(30, 280, 55)])[:count]
    edges = np.arange(301) - 0.5
    for x, y in places + rng.uniform(-0.5, 0.5, places.shape):
        px, py = (0.5 * np.diff(erf((edges - at) / 1.2 / np.sqrt(2))) for at in (x, y))
        image += 10 ** rng.uniform(3, 4.5) * np.outer(py, px)
    return image.astype(np.float32), places


def test_separated_stars_are_scipys_labels():
    image, places = star_frame(1)
    background = estimate(image)
    spots = find_clusters(image, background, DetectionSettings(min_pixels=3, isolation=0.0), None)
    mask = image > background.level + np.float32(5.0) * background.noise
    label, count = ndimage.label(mask, np.ones((3, 3)))
    sizes = ndimage.sum(mask, label, np.arange(1, count + 1))
    assert len(spots) == len(places)
    assert sorted(spots.pixels) == sorted(sizes[sizes >= 3].astype(int))
    assert np.hypot(*(spots.centre[:, None] - places[None]).transpose(2, 0, 1)).min(axis=1).max() < 1.0


def test_radius_follows_the_size_of_the_stars_and_close_clusters_merge():
    image, _ = star_frame(2)
    background = estimate(image)
    small = adaptive_radius(find_runs(image, background.level, background.noise, np.float32(50.0)), 400)
    large = adaptive_radius(find_runs(image, background.level, background.noise, np.float32(5.0)), 400)
    assert 2.0 <= small < large < 20.0
    table = np.zeros(3, SOURCE)
    table["pixels"], table["flux"] = [4, 6, 5], [10.0, 30.0, 20.0]
    table["sum_x"], table["sum_y"] = [10.0 * 5, 30.0 * 7, 20.0 * 40], [10.0 * 5, 30.0 * 5, 20.0 * 40]
    merged = merge_clusters(table, 3.0)
    assert sorted(merged["pixels"]) == [5, 10]
    assert merged["flux"].sum() == 60.0
    assert len(merge_clusters(table, 1.5)) == 3


def test_the_radius_grows_with_the_star():
    # one bright star 31 pixels across among small ones, one of them close to it
    y, x = np.mgrid[0:200, 0:300]
    image = np.zeros((200, 300), np.float32)
    small = [(40 * i + 20, j) for i in range(7) for j in (20, 180)]
    for cx, cy, r in [(150, 100, 15.0), (175, 100, 2.3), *((a, b, 2.3) for a, b in small)]:
        image += 100.0 * (np.hypot(x - cx, y - cy) <= r)
    runs = find_runs(image, np.zeros_like(image), np.ones_like(image), np.float32(5.0))
    tau = adaptive_radius(runs, 1000)
    assert tau < 15.0  # chosen for the small ones
    static = merge_clusters(cluster_pixels(runs, tau, image, np.zeros_like(image), np.inf), tau)
    grown = merge_clusters(cluster_pixels(runs, tau, image, np.zeros_like(image), np.inf, 1.0), tau, 1.0)
    assert len(static) > 16
    assert sorted(grown["pixels"].astype(int).tolist()) == [21] * 15 + [709]
    settings = DetectionSettings(threshold_dn=50.0, min_pixels=10, max_pixels=1000, isolation=0.0, reject_hits=False)
    spots = find_clusters(image, flat(image.shape), settings, None)
    assert spots.pixels.max() == 709


def test_a_radius_that_cannot_be_is_refused():
    image, _ = star_frame(3)
    with pytest.raises(InputError, match="cluster_radius_px"):
        find_clusters(image, estimate(image), DetectionSettings(cluster_radius_px=-1.0), None)


def test_planted_bad_pixels_are_found_and_stars_are_not():
    rng = np.random.default_rng(4)
    hot = np.zeros((200, 260), bool)
    hot.ravel()[rng.choice(hot.size, 40, replace=False)] = True
    dead = np.zeros_like(hot)
    dead.ravel()[rng.choice(hot.size, 20, replace=False)] = True
    lost = np.zeros_like(hot)
    lost[100, 100:105] = True

    def frames():
        for k in range(6):
            image = rng.normal(500, 6, hot.shape)
            image += ndimage.shift(np.pad([[9000.0]], ((80, 119), (60, 199))), (7 * k, 9 * k), order=0)
            image = np.where(hot, image + 300, np.where(dead, 0, image))
            yield np.where(lost, np.nan, image)

    assert np.array_equal(find_bad_pixels(frames()), hot | dead | lost)
    with pytest.raises(InputError, match="at least 3 frames"):
        find_bad_pixels(np.zeros((2, 8, 8)))
    with pytest.raises(InputError, match="must agree"):
        find_bad_pixels([np.zeros((8, 8)), np.zeros((8, 9)), np.zeros((8, 8))])


def test_masked_pixels_are_left_out_and_the_image_stays():
    image, _ = star_frame(5)
    before = image.copy()
    bad = np.zeros(image.shape, bool)
    bad[50, 60] = True
    image[50, 60] = before[50, 60] = 60000.0
    masked = mask_pixels(image, bad)
    assert np.isnan(masked[50, 60])
    assert np.array_equal(image, before)
    spots = find_clusters(masked, estimate(masked), DetectionSettings(min_pixels=1), None)
    assert not ((spots.x_peak == 60) & (spots.y_peak == 50)).any()
    assert mask_pixels(image, None) is image
    with pytest.raises(InputError, match="bad-pixel map"):
        mask_pixels(image, bad[1:])
