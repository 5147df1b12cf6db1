"""Which objects are examined, in what order they are classified, and the background that they are seen against."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from startracker.detection import Background, classify
from startracker.detection.background import _bin_means, _lattice_step, follow_structure, has_structure, noise_floor
from startracker.detection.classify import (
    _CLUTTER,
    _DARK,
    _HALO,
    _LARGE,
    _LONG,
    _SMALL,
    _UNSEEN,
    FAINTER,
    STAR,
    Criteria,
    _Examined,
    classify_sources,
    select_spots,
)
from startracker.detection.scan import UNFILTERED
from startracker.detection.sources import Searched
from startracker.settings import DetectionSettings
from tests.helpers import source_tables
from tests.helpers.source_tables import plane


def objects(count, **columns):
    return source_tables.objects(count, **({"flux": np.arange(count, 0.0, -1.0), "pixels": 5} | columns))


CRITERIA = Criteria(3, 100, 4.0, True, 0.0, 0.0, 2)


# ---------------------------------------------------------------------- how many are examined
@pytest.mark.parametrize(
    ("objects_there", "stars", "limit", "reject_hits", "examined"),
    [
        (12, 2, 0.1, True, [12]),  # six for each star wanted
        (13, 2, 0.1, True, [12]),
        (100, 2, 0.1, True, [12]),
        (100, 1, 0.1, True, [12, 72]),  # too few stars: thirty-six for each
        (100, 2, 0.0, True, [12, 72]),  # all as sharp as hot pixels
        (100, 2, 0.0, False, [12]),  # which does not matter if these are not looked for
        (20, 1, 0.1, True, [12, 20]),
        (11, 1, 0.1, True, [11]),
    ],
)
def test_how_many_objects_are_examined(monkeypatch, objects_there, stars, limit, reject_hits, examined):
    seen = []

    class Fake:
        def __init__(self, table, saturated, searched, criteria):
            seen.append(len(table))
            self.sharpness = SimpleNamespace(limit_px2=limit)

        def classify(self):
            return np.where(np.arange(seen[-1]) < stars, STAR, _LONG)

    monkeypatch.setattr(classify, "_Examined", Fake)
    kind = classify_sources(
        objects(objects_there), np.zeros(objects_there, bool), None, CRITERIA._replace(reject_hits=reject_hits)
    )
    assert seen == examined
    assert (kind[: seen[-1]] == np.where(np.arange(seen[-1]) < stars, STAR, _LONG)).all()
    assert (kind[seen[-1] :] == _UNSEEN).all()


def test_sizes_and_signals_that_no_star_has(monkeypatch):
    """Too small before too large before without signal."""
    chosen = []

    class Fake:
        sharpness = SimpleNamespace(limit_px2=0.1)

        def __init__(self, table, *_):
            chosen.extend(table["pixels"].tolist())

        def classify(self):
            return np.full(len(chosen), STAR)

    monkeypatch.setattr(classify, "_Examined", Fake)
    table = objects(7, pixels=[2, 3, 100, 101, 50, 1, 200], flux=[9.0, 8.0, 7.0, 6.0, 0.0, -1.0, -2.0])
    kind = classify_sources(table, np.zeros(7, bool), None, CRITERIA)
    assert kind.tolist() == [_SMALL, STAR, STAR, _LARGE, _DARK, _SMALL, _LARGE]
    assert chosen == [3, 100]


def examined(table, most, kinds, long=(), reject_hits=False):
    """Objects whose classes are given; the batches in which they are asked for."""
    image = np.zeros((400, 400), np.float32)
    searched = Searched(image, plane(image.shape, 0.0), plane(image.shape, 1.0), UNFILTERED)
    one = _Examined(table, np.zeros(len(table), bool), searched, CRITERIA._replace(most=most, reject_hits=reject_hits))
    flags = np.zeros(len(table), bool)
    flags[list(long)] = True
    one.marks = one.marks._replace(long=flags)
    asked = []

    def kinds_of(which):
        asked.append(which.tolist())
        return np.array(kinds)[which]

    one._kinds_of = kinds_of
    return one, asked


def apart(count, **columns):
    """Objects too far from one another for halos."""
    at = np.stack(np.divmod(np.arange(count), 8), axis=1) * 45 + 20
    return objects(count, x_peak=at[:, 1], y_peak=at[:, 0], peak_residual=1.0, **columns)


def test_objects_are_classified_until_there_are_enough_stars():
    """In batches of eight more than would do if four of five were stars; of what follows the last star only the long
    ones, whose number shows smear."""
    kinds = [STAR, _CLUTTER, STAR, _LONG] * 8
    one, asked = examined(apart(32), 3, kinds, long=[9, 27, 30])
    found = one.classify()
    # 8 + 3 · 5/4 = 11 at first; the third star is the fifth object
    assert asked == [list(range(11)), [9, 27, 30]]
    assert found[:5].tolist() == kinds[:5]
    assert found[[9, 27, 30]].tolist() == [kinds[k] for k in (9, 27, 30)]
    assert (np.delete(found, [0, 1, 2, 3, 4, 9, 27, 30]) == _UNSEEN).all()
    one, asked = examined(apart(32), 8, kinds)
    found = one.classify()
    assert asked == [list(range(18))]  # of nine stars the eighth ends it
    assert found.tolist() == [*kinds[:15], *[_UNSEEN] * 17]
    one, asked = examined(apart(32), 14, kinds)
    assert one.classify()[:27].tolist() == kinds[:27]
    assert asked == [list(range(25)), list(range(25, 32))]
    few = [_CLUTTER] * 30 + [STAR, STAR]
    one, asked = examined(apart(32), 1, few)
    assert one.classify().tolist() == [*few[:31], _UNSEEN]
    assert asked == [list(range(9)), list(range(9, 18)), list(range(18, 27)), list(range(27, 32))]
    one, asked = examined(apart(3), 0, [STAR] * 3)
    assert one.classify().tolist() == [_UNSEEN] * 3
    assert asked == []


def test_pieces_of_a_halo_are_known_before():
    table = apart(6)
    table["peak_residual"][0] = 100.0
    table["x_peak"][1], table["y_peak"][1] = table["x_peak"][0] + 3, table["y_peak"][0]
    one, asked = examined(table, 9, [STAR] * 6)
    assert one.classify().tolist() == [STAR, _HALO, STAR, STAR, STAR, STAR]
    assert asked == [[0, 2, 3, 4, 5]]


def test_which_objects_can_be_sharp():
    """Not at the border, and if saturated then in one pixel only; none where stars are as sharp."""
    image = np.zeros((400, 400), np.float32)
    y, x = np.mgrid[:400, :400]
    table = apart(12)
    for k in range(12):
        image += (500.0 * np.exp(-0.5 * ((x - table["x_peak"][k]) ** 2 + (y - table["y_peak"][k]) ** 2) / 0.8)).astype(
            np.float32
        )
    table["edge"][1] = True
    table["saturated"][2], table["saturated"][3] = 1, 2
    saturated = table["saturated"] > 0
    searched = Searched(image, plane(image.shape, 0.0), plane(image.shape, 1.0), UNFILTERED)
    one = _Examined(table, saturated, searched, CRITERIA)
    assert one.marks.may_be_sharp.tolist() == [True, False, True, False] + [True] * 8
    assert one.sharpness.limit_px2 > 0.0
    none = _Examined(table, saturated, searched, CRITERIA._replace(reject_hits=False))
    assert not none.marks.may_be_sharp.any()


def scene():
    """A star, a hot pixel, a track, a long object and a saturated star, on noise of 1; their table."""
    image = np.random.default_rng(1).normal(0.0, 1.0, (200, 200)).astype(np.float32)
    y, x = np.mgrid[:200, :200]
    stars = [(20 + 25 * k, 150) for k in range(7)] + [(20 + 25 * k, 180) for k in range(7)]
    for a, b in [(40, 40), (160, 40), *stars]:
        image += (900.0 * np.exp(-0.5 * ((x - a - 0.3) ** 2 + (y - b) ** 2) / 0.9)).astype(np.float32)
    image[40, 80] += 900.0
    image[80, 40:46] += 800.0
    image += (500.0 * np.exp(-0.5 * ((x - 125) ** 2 / 20.0 + (y - 80) ** 2 / 0.9))).astype(np.float32)
    places = [(40, 40), (80, 40), (42, 80), (125, 80), (160, 40), *stars]
    table = objects(len(places), x_peak=[p[0] for p in places], y_peak=[p[1] for p in places], pixels=12)
    table["flux"] = 5000.0 - np.arange(len(places))
    table["peak"] = table["peak_residual"] = image[table["y_peak"], table["x_peak"]]
    f = table["flux"]
    table["sum_x"], table["sum_y"] = f * table["x_peak"], f * table["y_peak"]
    table["sum_xx"], table["sum_yy"] = f * (table["x_peak"] ** 2 + 1.0), f * (table["y_peak"] ** 2 + 1.0)
    table["sum_xy"] = f * table["x_peak"] * table["y_peak"]
    table["sum_xx"][3] += f[3] * 20.0
    return image, table


def test_reasons_by_which_objects_are_rejected():
    """A hot pixel is one above 0.6 of its light in a pixel, a track any other that is sharper than the stars."""
    image, table = scene()
    flat = Background(np.zeros_like(image), np.ones_like(image))
    settings = DetectionSettings(max_axis_ratio=4.0, isolation=0.0, max_stars=20, matched_filter=False)
    found = select_spots(table, settings, True, image, flat)
    assert found.rejected == {"hot pixel": 1, "cosmic ray": 1, "streak": 1}
    assert len(found) == len(table) - 3
    np.testing.assert_array_equal(found.x_peak, np.delete(table["x_peak"], [1, 2, 3]))
    np.testing.assert_allclose(found.centre, np.column_stack([found.x_peak, found.y_peak]))
    assert not found.streak.any()
    kept = select_spots(
        table, DetectionSettings(max_axis_ratio=4.0, isolation=0.0, reject_hits=False), True, image, flat
    )
    assert kept.rejected == {"streak": 1}
    few = select_spots(table, DetectionSettings(max_axis_ratio=4.0, isolation=0.0, max_stars=1), True, image, flat)
    assert (len(few), few.rejected[FAINTER]) == (1, len(table) - 2)
    assert few.rejected["streak"] == 1
    clear = table.copy()
    clear["peak"] = 5e4
    clear["at_peak"] = 9
    flagged = select_spots(clear, settings, False, image, flat)
    assert flagged.saturated.all()
    assert len(select_spots(table[:0], settings, True, image, flat)) == 0


# ---------------------------------------------------------------------- background
def test_means_of_bins_without_their_extremes():
    image = np.random.default_rng(2).normal(10.0, 3.0, (23, 30)).astype(np.float32)
    image[3:5, 4:9], image[20, 20:], image[8:13, 12:16] = np.nan, np.inf, np.nan
    image[9, 13] = 4.0
    image[10, 13:15] = 5.0, 7.0
    found = _bin_means(image, 5, 7)
    for row in range(5):
        for column in range(7):
            part = image[row * 23 // 5 : (row + 1) * 23 // 5, column * 30 // 7 : (column + 1) * 30 // 7].ravel()
            part = np.sort(part[np.isfinite(part)]).astype(float)
            kept = part[1:-1] if len(part) > 2 else part
            expected = kept.mean() if len(kept) else np.nan
            np.testing.assert_allclose(found[row, column], expected, rtol=1e-6)
    assert _bin_means(np.array([[3.0, 5.0]], np.float32), 1, 1)[0, 0] == 4.0
    assert np.isnan(_bin_means(np.array([[np.nan]], np.float32), 1, 1)[0, 0])


@pytest.mark.parametrize("along", ["x", "y"])
def test_structure_is_where_the_tiles_are_noisier_than_the_pixels(along):
    """By 1.5 along both axes, in the median of differences from the mean of two pixels 5 px away: 0.67449 √1.5 of the
    noise. A plane is none, nor a frame without differences along both axes."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:400, :500]
    image = rng.normal(100.0, 2.0, (400, 500)) + 0.5 * x - 0.3 * y
    image += 3.0 * np.sin((x if along == "x" else y) * math.pi / 5.0 + 0.3) * rng.random((400, 500))
    image = image.astype(np.float32)
    rows, columns = np.arange(5, 395, 25)[:, None], np.arange(5, 495, 7)
    medians = [
        np.median(
            np.abs(image[rows, columns] - 0.5 * (image[rows - dy, columns - dx] + image[rows + dy, columns + dx]))
        )
        for dy, dx in ((0, 5), (5, 0))
    ]
    assert (medians[0] > medians[1]) == (along == "x")
    noise = 1.5 * max(medians) / (0.67449 * math.sqrt(1.5))
    for ratio, structure in ((0.98, False), (1.02, True)):
        flat = Background(np.zeros_like(image), np.full_like(image, ratio * noise))
        assert has_structure(image, flat) is structure
    assert not has_structure(np.full_like(image, 7.0), flat)
    assert has_structure(
        np.repeat(image[:, :1], 500, axis=1), Background(np.zeros_like(image), np.full_like(image, 200.0))
    )
    assert not has_structure(image[:10], flat)
    assert not has_structure(image[:, :10], flat)


def test_the_step_of_values_that_are_no_whole_numbers():
    """Their smallest gap if they lie on a lattice; otherwise the median gap, at most a 255th of the range."""
    lattice = np.array([0.0, 0.25, 1.0, 2.5, 7.75])
    assert _lattice_step(lattice) == 0.25
    off = lattice + np.array([0.0, 0.0, 0.002, 0.0, 0.0])
    assert _lattice_step(off) == 0.25  # by less than a hundredth of the gap
    far = lattice + np.array([0.0, 0.0, 0.003, 0.0, 0.0])
    assert _lattice_step(far) == pytest.approx(min(np.median(np.diff(far)), 7.75 / 255.0))
    many = np.cumsum(np.tile([0.01, 0.0137], 300))
    assert _lattice_step(many) == pytest.approx(np.median(np.diff(many)))
    assert _lattice_step(np.array([1.0, 2.0])) == 0.0
    assert _lattice_step(np.array([1.0, 2.0, 3.0])) == 1.0


def test_the_least_noise_of_an_image():
    rng = np.random.default_rng(4)
    whole = (16.0 * rng.integers(0, 40, (50, 50))).astype(np.float32)
    assert noise_floor(whole) == (16.0, pytest.approx(16.0 / math.sqrt(12.0)))
    thirds = (rng.integers(0, 40, (50, 50)) / 3.0).astype(np.float32)
    step, floor = noise_floor(thirds)
    assert (step, floor) == (pytest.approx(1.0 / 3.0, rel=1e-5), pytest.approx(1.0 / 3.0 / math.sqrt(12.0), rel=1e-5))
    smooth = rng.normal(100.0, 1.0, (50, 50)).astype(np.float32)
    smooth[3, 3] = 2100.0
    step, floor = noise_floor(smooth)
    span = 2100.0 - np.median(np.unique(smooth))
    assert (step, floor) == (0.0, pytest.approx(1e-5 * span, rel=1e-6))
    smooth[4, 4] = np.nan
    assert noise_floor(smooth)[1] == pytest.approx(floor, rel=1e-3)
    high = (1e7 + 0.5 * (rng.random((50, 50)) > 0.5)).astype(np.float32) + np.float32(0.0)
    high[0, 0] += 0.0
    assert noise_floor(np.full((4, 4), np.nan, np.float32)) == (0.0, 1.0)
    resolution = np.finfo(np.float32).eps * 1e9
    large = np.float32(1e9) * (1.0 + 1e-7 * rng.random((50, 50))).astype(np.float32) + np.float32(0.5)
    assert noise_floor(large)[1] >= 0.99 * min(resolution, noise_floor(large)[1])


def test_a_background_that_follows_has_the_level_and_the_noise_of_the_rest():
    """Bins of 4 px through a median of 5 × 5, twice; the noise of what remains, and of a frame with gaps."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:120, :160]
    level = 200.0 + 40.0 * np.sin(x / 25.0) * np.cos(y / 20.0)
    image = (level + rng.normal(0.0, 2.0, level.shape)).astype(np.float32)
    image[50, 60] += 5000.0
    found = follow_structure(image, 64)
    assert np.abs(found.level - level)[5:-5, 5:-5].max() < 4.0
    assert np.median(found.noise) == pytest.approx(2.0, rel=0.12)
    gaps = image.copy()
    gaps[30:60, 30:70] = np.nan
    assert np.isfinite(follow_structure(gaps, 64).level).all()
    nothing = follow_structure(np.full((40, 40), np.nan, np.float32), 64)
    assert (nothing.level == 0.0).all()
    assert (nothing.noise == 1.0).all()
