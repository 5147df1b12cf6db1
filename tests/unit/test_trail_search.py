"""Search for trails, part by part: against plain loops, SciPy, and lines that are drawn bin by bin."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import correlate1d

from startracker.detection.background import Background
from startracker.detection.tiles import as_plane
from startracker.settings import DetectionSettings
from startracker.trails import find as find_module
from startracker.trails import lines as lines_module
from startracker.trails.find import _ends_covariance, _excess, _halved, _measure
from startracker.trails.fit import Measured
from startracker.trails.lines import (
    _keep_apart,
    _lines_one_way,
    _peaks,
    _response,
    _smooth_bins,
    _transposed,
    candidate_lines,
    lines_along,
)
from startracker.trails.motion import CommonMotion, Signal


# ---------------------------------------------------------------------- maps
def test_a_transposed_map_of_more_rows_than_are_copied_at_once():
    values = np.random.default_rng(1).normal(size=(37, 5)).astype(np.float32)
    out = _transposed(values)
    np.testing.assert_array_equal(out, values.T)
    assert out.flags.c_contiguous


@pytest.mark.parametrize("sigma", [0.3, 0.5, 1.1])
def test_smoothing_is_a_correlation_with_a_star_image(sigma):
    bins = np.random.default_rng(2).normal(size=(20, 23)).astype(np.float32)
    reach = max(1, math.ceil(2.5 * sigma - 0.5))
    edges = (np.arange(-reach, reach + 2) - 0.5) / sigma
    kernel = np.diff([0.5 * math.erf(edge / math.sqrt(2.0)) for edge in edges])
    kernel /= math.sqrt(np.sum(kernel**2))
    expected = bins
    for axis in (0, 1):
        expected = correlate1d(expected, kernel, axis=axis, mode="constant")
    np.testing.assert_allclose(_smooth_bins(bins, sigma), expected, atol=1e-5)


def test_peaks_are_as_high_as_all_neighbours_and_not_at_the_border():
    height = np.random.default_rng(3).integers(0, 6, (30, 41)).astype(np.float32)  # with many plateaus
    height[0, 7] = height[29, 9] = height[11, 0] = height[13, 40] = 9.0
    height[1, 20], height[28, 21], height[15, 1], height[16, 39] = 8.0, 8.0, 8.0, 8.0
    expected = {
        (y, x)
        for y in range(1, 29)
        for x in range(1, 40)
        if height[y, x] > 4.0 and height[y, x] == height[y - 1 : y + 2, x - 1 : x + 2].max()
    }
    assert set(zip(*(values.tolist() for values in _peaks(height, 4.0)), strict=True)) == expected
    assert {(1, 20), (28, 21), (15, 1), (16, 39)} <= expected


def test_four_bins_are_one_of_the_same_noise():
    bins = np.random.default_rng(4).normal(size=(7, 9)).astype(np.float32)
    expected = [[0.5 * bins[2 * j : 2 * j + 2, 2 * i : 2 * i + 2].sum() for i in range(4)] for j in range(3)]
    np.testing.assert_allclose(_halved(bins), expected, atol=1e-6)


@pytest.mark.parametrize("size", [100, 8192, 16385, 40000])
def test_noise_of_the_bins_is_at_least_one(size):
    """The difference of two quantiles of a sample that is not a column of the map."""
    bins = np.random.default_rng(5).normal(3.0, 1.7, size).astype(np.float32)
    step = max(1, size // 8192) | 1
    low, high = np.quantile(bins[::step], [0.5, 0.841345])
    assert _excess(bins) == pytest.approx(high - low, rel=1e-5)
    assert _excess(0.1 * bins) == 1.0


# ---------------------------------------------------------------------- lines apart
def kept(bins, lines, width=2.0, threshold=1.0, most=9):
    return _keep_apart(bins.astype(np.float32), np.array(lines, dtype=float), width, threshold, most).tolist()


def test_lines_take_their_bins():
    """A line of 11 bins of 2 has a sum of 22, √11 times 6.63; what is within two bins of a line taken is no longer
    free, beyond its ends as well."""
    bins = np.zeros((40, 60))
    bins[20, 15:26] = bins[23, 15:26] = bins[22, 40:51] = bins[20, 28:39] = 2.0
    long = [20.0, 20.0, 5.0, 0.0]
    assert kept(bins, [long, long]) == [0]
    assert kept(bins, [long], threshold=22.0 / math.sqrt(11.0) - 1e-4) == [0]
    assert kept(bins, [long], threshold=22.0 / math.sqrt(11.0) + 1e-4) == []
    assert kept(bins, [long, [20.0, 23.0, 5.0, 0.0], [33.0, 20.0, 5.0, 0.0]]) == [0, 1, 2]
    assert kept(bins, [long, [20.0, 23.0, 5.0, 0.0], [33.0, 20.0, 5.0, 0.0]], width=3.0) == [0, 2]
    assert kept(bins, [long, [20.0, 23.0, 5.0, 0.0], [45.0, 22.0, 5.0, 0.0]], most=2) == [0, 1]
    # from 28 on all are taken: two of the sixteen are 26 and 27, which the first line's margin covers
    assert kept(bins, [[21.5, 20.0, 6.0, 0.0], [33.0, 20.0, 5.0, 0.0]], threshold=6.0) == [0]


def test_lines_in_other_directions_and_beyond_the_border():
    bins = np.zeros((40, 60))
    for k in range(-5, 6):
        bins[20 + k, 30 + k] = bins[20 - 2 * k, 10 + k] = 1.0
    bins[0, :5] = bins[39, 55:] = bins[:5, 59] = 1.0
    diagonal, steep = [30.0, 20.0, 5.0, 5.0], [10.0, 20.0, -5.0, 10.0]
    assert kept(bins, [diagonal], threshold=3.3) == [0]  # 11/√11 = 3.317
    assert kept(bins, [[30.0, 20.0, 5.0, -5.0]], threshold=1.0) == []
    assert kept(bins, [steep], threshold=2.39) == [0]  # 21 steps, of which 11 are of light: 11/√21 = 2.4
    for edge in ([2.0, 0.0, 2.0, 0.0], [57.0, 39.0, 2.0, 0.0], [59.0, 2.0, 0.0, 2.0]):
        assert kept(bins, [edge, edge]) == [0]  # the first and the last row and column are taken as well
    # half of each lies outside
    assert kept(bins, [[0.0, 0.0, 4.0, 0.0]], threshold=5.0 / 3.0 - 1e-6) == [0]
    assert kept(bins, [[59.0, 39.0, 4.0, 0.0]], threshold=5.0 / 3.0 - 1e-6) == [0]
    assert kept(bins, [[59.0, 0.0, 0.0, 4.0]], threshold=5.0 / 3.0 - 1e-6) == [0]


# ---------------------------------------------------------------------- along one motion
def test_sums_along_a_shift_of_the_image():
    """All bins of one line about each bin, and nothing where that leaves the image."""
    rng = np.random.default_rng(6)
    wide, tall = rng.normal(size=(34, 45)).astype(np.float32), rng.normal(size=(60, 14)).astype(np.float32)
    motions = (20.0, 6.0, 0.0), (-4.0, 18.0, 0.0), (0.0, 10.0, 0.0), (10.0, 10.0, 0.0)
    for bins, motion in [*((wide, motion) for motion in motions), (tall, (3.0, 40.0, 0.0)), (tall.T, (40.0, 3.0, 0.0))]:
        height, width = bins.shape
        out = _response(bins, 2.0, np.array(motion))
        u, v = motion[0] / 2.0, motion[1] / 2.0
        turned = abs(v) > abs(u)
        span = round(max(abs(u), abs(v)))
        slope = (u / v) if turned else (v / u)
        y, x = np.mgrid[:height, :width]
        room = np.minimum(np.minimum(x, width - 1 - x) - 0.5 * abs(u), np.minimum(y, height - 1 - y) - 0.5 * abs(v))
        assert (out[room < 0.0] == -np.inf).all()
        step = np.arange(span) - span // 2
        assert (room >= 1.0).sum() > 50
        for row, column in np.argwhere(room >= 1.0)[::29]:
            sums = []
            for phase in np.linspace(-0.5, 0.5, 401):  # of the sheared image, whose rows are whole bins
                side = np.floor(slope * step + 0.5 + phase).astype(int)
                line = bins[row + step, column + side] if turned else bins[row + side, column + step]
                sums.append(line.sum() / math.sqrt(span))
            assert np.abs(np.array(sums) - out[row, column]).min() < 1e-4, (motion, row, column)


def test_sums_along_a_turn_follow_its_lines():
    """In an image that is a plane the mean along any line is the value at its middle: sums are √length of it."""
    y, x = np.mgrid[:60, :80]
    bins = (100.0 + 2.0 * x - y).astype(np.float32)
    out = _response(bins, 1.5, np.array([18.0, 6.0, 0.2]))
    dx, dy = 1.5 * (x - 39.5), 1.5 * (y - 29.5)
    u, v = (18.0 - 0.2 * dy) / 1.5, (6.0 + 0.2 * dx) / 1.5
    span = np.maximum(np.abs(u), np.abs(v))
    room = np.minimum(np.minimum(x, 79 - x) - 0.5 * np.abs(u), np.minimum(y, 59 - y) - 0.5 * np.abs(v))
    assert (out[room < 0.0] == -np.inf).all()
    inside = room > 2.0
    assert np.isfinite(out[inside]).mean() > 0.99
    found = out[inside] / bins[inside]
    # the length is that in the middle of its block, to two bins, and the middle of an even one is half a bin aside
    expected = np.sqrt(span[inside])
    finite = np.isfinite(found)
    off = found[finite] - expected[finite]
    assert np.abs(off).max() < 0.5
    assert abs(np.median(off)) < 0.03


def test_trails_of_a_motion_are_found_most_significant_first():
    """Two lines of 15 and 25 px in bins of 2 px, at whole bins; the weaker one below a threshold is not there."""
    rng = np.random.default_rng(7)
    bins = rng.normal(size=(60, 90)).astype(np.float32)
    for y, x, light in ((20, 30, 5.0), (41, 60, 9.0)):
        bins[y, x - 6 : x + 7] += light
    motion = np.array([26.0, 0.0, 0.0])
    xy = lines_along(bins, 2.0, motion, 7.0, 0.6)
    np.testing.assert_allclose(xy[:2], [[120.5, 82.5], [60.5, 40.5]], atol=2.1)
    assert np.abs(xy[:2, 1] - [82.5, 40.5]).max() == 0.0
    assert len(lines_along(bins, 2.0, motion, 30.0, 0.6)) == 0
    assert lines_along(bins, 2.0, np.array([500.0, 0.0, 0.0]), 5.0, 0.6).shape == (0, 2)  # longer than the image


# ---------------------------------------------------------------------- in all directions
def test_pixels_of_lines_that_were_found_in_bins(monkeypatch):
    """A bin of 4 × 2 units: the middle of the first is at 1.5 and 0.5 px, with units of three at 5.5 and 2.5 px."""
    asked = []

    def one_way(rows, lengths, angle):
        asked.append((rows, lengths, angle))
        return np.array([[0.0, 0.0, 2.0, 3.0, 7.0 + len(asked)], [10.0, 5.0, -1.0, 0.5, 6.0]])

    def every(bins, lines, width, threshold, most):
        assert (width, threshold, most) == (2.0, 5.5, 40)
        in_bins.append(lines)
        return np.arange(len(lines))

    in_bins = []
    monkeypatch.setattr(lines_module, "_lines_one_way", one_way)
    monkeypatch.setattr(lines_module, "_keep_apart", every)
    bins = np.arange(41.0 * 60.0, dtype=np.float32).reshape(41, 60)
    for unit in (1, 3):
        asked.clear(), in_bins.clear()
        found = candidate_lines(bins, unit, 0.3)
        first, second = np.array([1.5, 0.5, 8.0, 6.0]), np.array([41.5, 10.5, -4.0, 1.0])
        if unit == 3:
            first, second = np.array([5.5, 2.5, 24.0, 18.0]), np.array([125.5, 32.5, -12.0, 3.0])
        turned = [1, 0, 3, 2]
        np.testing.assert_allclose(found, [first[turned], first, second, second[turned]])
        # in bins of 2 units, whose middles are at 0.5 and at 2.5 px
        corner = np.array([0.5, 0.5, 0.0, 0.0])
        np.testing.assert_allclose(in_bins[0][1], (first + corner) / (2.0 * unit) - corner)
        (rows, lengths, angle), (columns, again, aside) = asked
        assert (angle, aside) == (0.3, pytest.approx(0.5 * math.pi - 0.3))
        np.testing.assert_allclose(rows, (bins[:, ::2] + bins[:, 1::2]) / math.sqrt(2.0), rtol=1e-6)
        np.testing.assert_allclose(columns, (bins.T[:, :40:2] + bins.T[:, 1:40:2]) / math.sqrt(2.0), rtol=1e-6)
        # from 8 px by √2 to 0.3 of the smaller side, 24.6 px
        np.testing.assert_allclose(lengths, 8.0 * math.sqrt(2.0) ** np.arange(4))
        np.testing.assert_allclose(again, lengths)
    asked.clear()
    candidate_lines(bins[:12], 1)  # 0.3 of 24 px: the shortest alone
    assert [one[1].tolist() for one in asked] == [[8.0], [8.0]]
    assert [one[2] for one in asked] == [None, None]


def drawn_rows(y, x0, x1, slope=0.0, light=1.0):
    """Bins of 4 × 2 px with a line that has no noise: `slope` px per px."""
    rows = np.zeros((60, 50), np.float32)
    for x in range(x0, x1):
        rows[round(y + 2.0 * slope * (x - 0.5 * (x0 + x1 - 1))), x] = light
    return rows


@pytest.mark.parametrize(("x0", "x1"), [(10, 26), (11, 26)])
def test_a_line_of_bins(x0, x1):
    """Of lines of 64 and 90.5 px, 16 and 23 bins, the better one; across it the filter (1, 2, 1)/√6 leaves 2/√6."""
    lengths = 64.0 * math.sqrt(2.0) ** np.arange(2)
    found = _lines_one_way(drawn_rows(30, x0, x1, light=4.0), lengths, None)
    best = found[np.argmax(found[:, 4])]
    span = x1 - x0
    # clipped light of 4 × 2/√6 = 3.27 each bin
    assert best[4] == pytest.approx(4.0 * 2.0 / math.sqrt(6.0) * span / math.sqrt(16.0), rel=1e-5)
    assert best[1:4].tolist() == [30.0, 8.0, 0.0]
    assert abs(best[0] - 0.5 * (x0 + x1 - 1)) <= 0.5
    strong = _lines_one_way(drawn_rows(30, x0, x1, light=99.0), lengths, None)
    assert strong[:, 4].max() == pytest.approx(4.0 * span / 4.0, rel=1e-5)  # no bin counts more than 4


@pytest.mark.parametrize("slope", [-1.0, -0.5, 0.25, 1.0])
def test_slanted_lines_and_the_directions_that_are_asked_for(slope):
    """Centre, half lengths along both axes; only within 8° of a direction, or the other way round."""
    rows = drawn_rows(30, 16, 32, slope, 9.0)
    lengths = np.array([64.0 * math.hypot(1.0, slope)])
    found = _lines_one_way(rows, lengths, None)
    best = found[np.argmax(found[:, 4])]
    off = np.abs(best[:4] - [23.5, 30.0, 8.0, 16.0 * slope])
    assert (off <= [0.5, 1.0, 0.0, 1.0]).all()
    angle = math.atan(slope)
    for away, there in ((0.0, True), (6.0, True), (-6.0, True), (180.0, True), (30.0, False)):
        narrow = _lines_one_way(rows, lengths, angle + math.radians(away))
        found_it = bool(len(narrow) > 0 and narrow[:, 4].max() > 0.99 * best[4])
        assert found_it is there, away
    assert len(_lines_one_way(rows, lengths, 0.5 * math.pi)) == 0  # steeper than 45°: of the turned image


# ---------------------------------------------------------------------- what is kept of the fits
NOISE = 3.0


def signal_of(shape=(100, 120)):
    noise = NOISE + np.add.outer(0.01 * np.arange(shape[0]), 0.02 * np.arange(shape[1]))
    return Signal(np.zeros(shape, np.float32), as_plane(noise.astype(np.float32)), 0.5)


def test_what_faint_ends_add_to_the_covariance():
    """26 / rate² along the trail in place of the smooth variance, as the root of the sum of squares; at most h²/3."""
    table = np.array([[50.0, 40.0, 400.0, 0.0, 0.3, 10.0, 1.0], [30.0, 20.0, 1e5, 0.0, -1.0, 6.0, 1.5]])
    fitted = np.array([[[0.04, 0.01], [0.01, 0.02]], [[0.02, 0.0], [0.0, 0.03]]])
    length_variance = np.array([2.4, 0.0])
    found = _ends_covariance(signal_of(), table, fitted, length_variance)
    for k, (_, _, flux, _, angle, half, sigma) in enumerate(table):
        unit = np.array([math.cos(angle), math.sin(angle)])
        noise = NOISE + 0.01 * table[k, 1] + 0.02 * table[k, 0]
        rate = (flux / (2.0 * half) / noise) ** 2 / (math.sqrt(math.pi) * sigma)
        smooth = unit @ fitted[k] @ unit
        along = min(math.hypot(26.0 / rate**2, smooth) - smooth, half**2 / 3.0) + length_variance[k] / 12.0
        np.testing.assert_allclose(found[k], along * np.outer(unit, unit), rtol=1e-6, atol=1e-15)
    faint = table[:1].copy()
    faint[0, 2] = 30.0
    along = np.trace(_ends_covariance(signal_of(), faint, fitted[:1], np.zeros(1))[0])
    assert along == pytest.approx(100.0 / 3.0)


def measured(
    monkeypatch,
    table,
    chi2=None,
    sigma_flux=10.0,
    settings=None,
    alone=None,
    residual=None,
    motion=(20.0, 0.0),
    freedom=200,
):
    """`_measure` of fits that are written down, for a motion known to 0.5 px."""
    table, asked = np.array(table, dtype=float), []
    n = len(table)
    covariance = np.tile(np.diag([0.01, 0.04, sigma_flux**2]), (n, 1, 1))
    chi2 = np.ones(n) if chi2 is None else np.array(chi2)
    alone = np.zeros(n, bool) if alone is None else np.array(alone)

    def fits(residual, noise, starts, inverse_gain, threshold, most):
        asked.append((starts, inverse_gain, threshold, most))
        return Measured(table, covariance, chi2, np.full(n, freedom), alone)

    monkeypatch.setattr(find_module, "measure_trails", fits)
    signal = signal_of()
    if residual is not None:
        signal.residual[:] = residual
    motion = CommonMotion(np.array([*motion, 0.0]), np.diag([0.25, 0.25, 0.0]), signal.middle, 1.2, None)
    settings = settings or DetectionSettings(threshold_sigma=5.0, max_stars=3)
    found = _measure(signal, np.array([[30.0, 40.0], [50.0, 60.0]] * 5), motion, settings)
    return found, asked[0]


def line(x, y, flux, angle=0.0, half=10.0, sigma=1.0):
    return [x, y, flux, 0.0, angle, half, sigma]


def test_starts_of_the_fits(monkeypatch):
    """Twice as many as stars are wanted, with the length and direction of the motion there."""
    _, (starts, inverse_gain, threshold, most) = measured(monkeypatch, [line(50, 50, 1e4)], motion=(16.0, 12.0))
    assert (len(starts), inverse_gain, threshold, most) == (6, 0.5, 5.0, 3)
    np.testing.assert_allclose(starts[1], [50.0, 60.0, 0.0, 0.0, math.atan2(12.0, 16.0), 10.0, 1.2])


def test_what_is_no_whole_trail_of_the_motion_is_left_out(monkeypatch):
    """Below the threshold, of another direction or length, beyond the border, of a bad fit; brightest first."""
    good = [line(40, 30, 400.0), line(60, 50, 900.0), line(60, 70, 600.0), line(50, 80, 500.0)]
    bad = [
        line(40, 40, 49.0),
        line(40, 20, 700.0, angle=0.4),
        line(40, 25, 700.0, half=12.6),
        line(10.5, 60, 700.0),
        line(109.5, 60, 700.0),
        line(60, 0.5, 700.0),
        line(70, 90, 700.0),
    ]
    chi2 = [1.0, 1.0, 1.0, 1.0, *[1.0] * 6, 3.0 * (1.0 + 0.7**2) * 1.01]
    found, _ = measured(monkeypatch, good + bad, chi2)
    np.testing.assert_allclose(found.centroids.flux, [900.0, 600.0, 500.0])  # at most three
    np.testing.assert_allclose(found.lengths, [[20.0, 0.0]] * 3, atol=1e-12)
    assert found.motion.tolist() == [20.0, 0.0, 0.0]
    np.testing.assert_array_equal(found.centroids.xy, [[60.0, 50.0], [60.0, 70.0], [50.0, 80.0]])
    found, _ = measured(monkeypatch, [good[0], line(11.0, 60, 700.0), line(108.0, 60, 800.0), bad[6]])
    assert found.centroids.flux.tolist() == [800.0, 700.0, 700.0]
    assert measured(monkeypatch, bad[:3])[0] is None


def test_covariance_of_a_trail(monkeypatch):
    """Of the fit, wider where χ² of 200 degrees of freedom exceeds 1.4; the ends; 0.001 px; and δ²/12 of a length that
    is not its own, known to 0.5 px."""
    table = [line(60, 50, 9e5), line(60, 70, 6e5), line(60, 30, 5e5)]
    residual = np.zeros((100, 120))
    residual[70, 60] = np.nan
    found, _ = measured(monkeypatch, table, [1.39, 1.41, 1.0], 1.0, alone=[False, False, True], residual=residual)
    along = np.array([0.01, 0.0141, 0.01]) + 1e-6 + np.array([0.25, 0.25, 0.0]) / 12.0
    across = np.array([0.04, 0.0564, 0.04]) + 1e-6
    np.testing.assert_allclose(found.centroids.covariance[:, 0, 0], along, rtol=1e-4)
    np.testing.assert_allclose(found.centroids.covariance[:, 1, 1], across, rtol=1e-6)
    assert found.centroids.saturated.tolist() == [False, True, False]
    assert found.fitted_alone.tolist() == [False, False, True]
    assert found.centroids.misfit is None  # of fewer than five
    found, _ = measured(monkeypatch, table[:1], [1.4], 1.0, freedom=200)
    exact, _ = measured(monkeypatch, table[:1], [5.0], 1.0, freedom=2)  # (5 − 1)/√(2/2): no more than 4
    assert exact.centroids.covariance[0, 1, 1] == found.centroids.covariance[0, 1, 1] == pytest.approx(0.04 + 1e-6)
    six = [line(60, 10 + 12 * k, 1e5 + k) for k in range(7)]
    found, _ = measured(
        monkeypatch, six, np.linspace(0.9, 1.2, 7), 1.0, DetectionSettings(threshold_sigma=5.0, max_stars=9)
    )
    # the median excess of 0.05 in units of √(2/200) = 0.1, and of the error of a median of seven, √(π/2)/√7
    assert found.centroids.misfit == pytest.approx(0.5 / math.sqrt(0.5 * math.pi / 7.0), rel=1e-3)


# ---------------------------------------------------------------------- the whole search
@pytest.mark.parametrize(
    ("known_length", "direction", "asked"),
    [(20.0, 0.3, ["known"]), (26.0, 0.3, ["known"]), (None, 0.3, ["known", "narrow"]), (None, None, ["known", "all"])],
)
def test_order_of_the_search(monkeypatch, known_length, direction, asked):
    """Short trails that are known are measured as they are, long ones searched again; else in a direction, then in all;
    images of more than 1,200 px in larger squares."""
    log, drawn = [], []

    def lines_at(xy):
        assert xy.shape == (40, 2)
        return np.tile([known_length, 0.0], (40, 1)), None

    motion = SimpleNamespace(motion="m", sigma=1.1, lines_at=lines_at)

    def find_motion(signal, lines, *, sigma, measure_sigma, camera):
        name = "known" if not len(lines) or lines[0, 0] == 0.0 else "narrow" if lines[0, 0] == 1.0 else "all"
        log.append((name, sigma, measure_sigma, camera, signal.inverse_gain))
        assert len(lines) <= 20
        return motion if name == asked[-1] else None

    def candidates(bins, unit, direction_rad=None):
        drawn.append((bins.shape, unit, direction_rad))
        return np.full((30, 4), 2.0 if direction_rad is None else 1.0)

    monkeypatch.setattr(find_module, "find_motion", find_motion)
    monkeypatch.setattr(find_module, "candidate_lines", candidates)
    monkeypatch.setattr(find_module, "lines_along", lambda *given: ("searched", given[1:]))
    monkeypatch.setattr(find_module, "_measure", lambda signal, centres, found, settings: centres)
    image = np.random.default_rng(8).normal(size=(80, 1201)).astype(np.float32)
    background = Background(np.zeros_like(image), np.ones_like(image))
    known = np.zeros((40, 4)) if known_length is not None else None
    settings = DetectionSettings(psf_sigma_px=0.9, threshold_sigma=6.0)
    out = find_module.find_trails(image, background, settings, None, 2.0, known, direction)
    assert [entry[0] for entry in log] == asked
    assert log[0][1:] == (pytest.approx(math.hypot(0.9, math.sqrt(1.0 / 12.0))), False, None, 0.5)
    if known_length == 20.0:
        np.testing.assert_array_equal(out, np.zeros((40, 2)))
    else:
        assert out == ("searched", (4.0, "m", 6.0, 1.1))
    assert drawn == {"narrow": [((10, 150), 4, 0.3)], "all": [((20, 300), 2, None)], "known": []}[asked[-1]]


def test_where_no_motion_is_searched_for(monkeypatch):
    """Images of less than 16 bins; and where all searches fail there are no trails."""
    asked = []
    monkeypatch.setattr(find_module, "find_motion", lambda signal, lines, **given: asked.append(given["measure_sigma"]))
    for size, searches in ((31, 1), (32, 2)):
        asked.clear()
        image = np.random.default_rng(9).normal(size=(size, 50)).astype(np.float32)
        assert find_module.find_trails(image, Background(np.zeros_like(image), np.ones_like(image))) is None
        assert asked == [True] * searches
    asked.clear()
    assert (
        find_module.find_trails(image, Background(np.zeros_like(image), np.ones_like(image)), direction_rad=1.0) is None
    )
    assert len(asked) == 3
