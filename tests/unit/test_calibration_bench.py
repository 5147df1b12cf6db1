"""A calibration from photographs between its fits: which stars match, which images agree, and the notes."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from startracker import Camera, Observer
from startracker.calibration import StarField, procedure
from startracker.calibration.consensus import FocalLengths, _is_copy
from startracker.calibration.field import SkyPart
from startracker.calibration.known import KnownField
from startracker.calibration.plot import _round_down, residual_figure
from startracker.calibration.procedure import _Bench, _largest_agreeing, _notes, _unfitted
from startracker.calibration.residual_field import FrameInformation, ResidualField, field_columns
from startracker.catalog import load_catalog
from startracker.errors import InputError
from startracker.geometry.distortion import Distortion
from startracker.geometry.lens_fit import JointFit, noise_floor, rescaled_equations, stretch

CAMERA = Camera.from_fov(20.0, 1000, 800, Distortion(k1=-0.1))


def known(seed=1, count=40, noise=0.1, name="image", observer=None, sigma=None):
    """An image with as many stars as centroids, all of them known, of which the second half is faint."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform([50.0, 50.0], [950.0, 750.0], (count, 2))
    catalog = load_catalog("hipparcos").select(np.arange(count))
    measured = xy + rng.normal(0.0, noise, xy.shape)
    flux = 10.0 ** (-0.4 * (catalog.v_mag + 3.0))
    variance = np.full(count, 0.1**2) if sigma is None else np.asarray(sigma, float) ** 2
    field = StarField(name, measured, 1000, 800, flux, variance, observer)
    pairs = np.column_stack([np.arange(count)] * 2)
    return KnownField(field, CAMERA, np.eye(3), SkyPart(catalog, CAMERA.unproject(xy)), pairs)


def bench(*images, floor_px=0.0, refraction=False, fixed=None):
    images = list(images)
    made = _Bench(
        images,
        "pinhole",
        refraction,
        fixed,
        [one.pairs for one in images],
        floor_px,
        [0] * len(images),
        _unfitted(CAMERA, images),
    )
    made.fit = replace(made.fit, residuals=made._residuals(), covariance=np.zeros((5, 5)), names=("f", "k1"))
    return made


# ---------------------------------------------------------------------- which stars match
def test_where_the_stars_are_in_the_current_fit():
    """By attitude, stretch and lens; none farther than 1.05 half diagonals from the axis."""
    one = known()
    made = bench(one)
    angles = np.array([0.0, 0.5, 1.049, 1.051]) * CAMERA.half_diagonal_rad
    directions = np.column_stack([np.sin(angles), np.zeros(4), np.cos(angles)])
    made.known[0] = replace(one, sky=SkyPart(one.sky.catalog, directions))
    made.fit = replace(made.fit, stretches=np.array([[2e-3, -1e-3]]))
    found = made._predicted(0)
    expected = CAMERA.project(stretch(directions, np.array([2e-3, -1e-3])))
    np.testing.assert_allclose(found[:3], expected[:3])
    assert np.isnan(found[3]).all()
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    made.fit = replace(made.fit, matrices=[turned])
    np.testing.assert_allclose(
        made._predicted(0)[1], CAMERA.project(stretch(directions @ turned.T, np.array([2e-3, -1e-3])))[1]
    )


@pytest.mark.parametrize("wide", [True, False])
def test_stars_match_within_robust_errors(wide):
    """3.7 errors scaled to the median residual; in the first round within four of the median error and a pixel. A
    centroid of more than four times the usual error is none, nor one of another brightness."""
    sigma = np.full(40, 0.1)
    sigma[[3, 4]] = 0.39, 0.41
    one = known(sigma=sigma, noise=0.2)  # twice as much as stated
    made = bench(one)
    normal = np.hypot(*(made.fit.residuals[0] / one.sigma()[:, None]).T)
    scale = np.median(normal) / math.sqrt(2.0 * math.log(2.0))
    assert scale > 1.5
    gate, usual = 3.7 * scale * one.sigma(), 4.0 * scale * np.median(one.sigma()) + 1.0
    predicted = CAMERA.project(one.sky.directions)
    xy = predicted + 0.05
    xy[7] = predicted[7] + [0.99 * gate[7], 0.0]
    xy[8] = predicted[8] + [1.01 * gate[8], 0.0]
    xy[9] = predicted[9] + [0.99 * usual, 0.0]
    xy[10] = predicted[10] + [1.01 * usual, 0.0]
    flux = one.field.flux.copy()
    flux[11] *= 10.0 ** (0.4 * 3.3)
    made.known[0] = replace(one, field=replace(one.field, xy=xy, flux=flux))
    made.match(wide=wide)
    left = {4, 10, 11} if wide else {4, 8, 9, 10, 11}
    assert set(made.pairs[0][:, 0]) == set(range(40)) - left
    assert (made.pairs[0][:, 0] == made.pairs[0][:, 1]).all()
    assert made.rejected == [len(left) - 1]  # the one beyond the widest gate is no pair at all


def test_the_gate_is_a_twentieth_of_a_pixel_at_least():
    one = known(noise=0.0)
    made = bench(one)
    xy = CAMERA.project(one.sky.directions)
    xy[5, 0] += 0.049
    xy[6, 0] += 0.051
    made.known[0] = replace(one, field=replace(one.field, xy=xy))
    made.match(wide=False)
    assert set(range(40)) - set(made.pairs[0][:, 0]) == {6}
    assert made.rejected == [1]


def test_the_noise_beyond_the_stated_errors():
    """From the residuals of the pairs with the stated errors; that of before does not count."""
    one = known(noise=0.4)
    made = bench(one, floor_px=7.0)
    expected = noise_floor(one.field.xy - CAMERA.project(one.sky.directions), one.sigma() ** 2, 5)
    assert made._floor() == expected > 0.2
    assert made.sigma(0)[0] == pytest.approx(math.hypot(one.sigma()[0], made.floor_px))


# ---------------------------------------------------------------------- fits
def test_a_bench_fits_and_matches_until_nothing_changes():
    images = [known(1), known(2, name="second")]
    found = _Bench.begin(images, "pinhole", False, None)
    assert found.fit.camera.fx == pytest.approx(CAMERA.fx, rel=1e-3)
    assert "f" in found.fit.names
    assert [len(pairs) for pairs in found.pairs] == [40, 40]
    told = _Bench.begin(images, "pinhole", False, ["cx", "k2"])
    assert told.fit.names == ("f", "cx", "k2")
    few = [replace(known(1), pairs=known(1).pairs[:7])]
    assert _Bench.begin(few, "pinhole", False, None) is None
    assert _Bench.begin([known(1, 8, noise=0.0)], "pinhole", False, None) is not None


def test_few_stars_determine_the_focal_length_and_one_term():
    """With eight degrees of freedom or more, the significant ones; those that are asked for are fitted as they are."""
    parameters = len(procedure.PARAMETERS["pinhole"])
    for count, plain in ((math.ceil((parameters + 3 + 7) / 2), True), (math.ceil((parameters + 3 + 9) / 2), False)):
        made = bench(known(3, count, noise=0.02))
        seen = []
        made._fit = lambda names, seen=seen, fit=type(made)._fit, made=made: (seen.append(names), fit(made, names))[1]
        assert made.refit()
        assert (seen[1] == ("f", "k1")) is plain or not plain
        assert seen[0] == procedure.PARAMETERS["pinhole"]
        assert len(seen) == 2
    fixed = bench(known(3, 40), fixed=("f", "k2"))
    assert fixed.refit()
    assert fixed.fit.names == ("f", "k2")


def test_a_projection_is_scored_by_its_residuals_and_parameters():
    made = bench(known(1), known(2, 30))
    count = 140
    squares = sum(np.sum(r**2) for r in made.fit.residuals)
    expected = math.log(squares / count) + 5.0 * math.log(count) / count
    assert made.score() == pytest.approx(expected)


def test_the_answer_has_the_covariance_with_what_the_lens_does_not_describe():
    """Of the lens and of each attitude, the epoch is the mean of those that are known."""
    images = [known(1, observer=Observer(2020.0)), known(2, name="b", observer=Observer(2024.0)), known(3, name="c")]
    found = _Bench.begin(images, "pinhole", False, ["k1"])
    found.rejected = [1, 2, 3]
    result = found.answer({"d": "why"})
    assert result.epoch_jyear == 2022.0
    assert result.unsolved == {"d": "why"}
    matches = found.matches()
    columns = [field_columns(found.fit.camera, m.xy) for m in matches]
    normal, right = rescaled_equations(found.fit, matches, columns, with_refraction=False)
    size = len(found.fit.covariance)
    plain = np.linalg.inv(normal[:size, :size])
    field = ResidualField(size, 4.0)
    field.update(FrameInformation(normal, right), plain)
    whole = plain + field.by_field @ field.moment @ field.by_field.T
    np.testing.assert_allclose(result.covariance, whole[:2, :2])
    assert result.field_px == field.rms_px
    for k, one in enumerate(result.fields):
        np.testing.assert_allclose(one.covariance, whole[2 + 3 * k : 5 + 3 * k, 2 + 3 * k : 5 + 3 * k])
        assert (one.name, one.rejected, one.centroids) == (images[k].field.name, k + 1, 40)
        np.testing.assert_allclose(one.sigma_px, images[k].sigma(found.floor_px))
        np.testing.assert_array_equal(one.catalog_id, images[k].sky.catalog.id[found.pairs[k][:, 1]])
    assert [len(r) for r in result.plain_residual_px] == [40, 40, 40]
    none = _Bench.begin([known(1)], "pinhole", False, ["k1"]).answer({})
    assert none.epoch_jyear == images[0].sky.catalog.epoch_jyear


# ---------------------------------------------------------------------- images that agree
@pytest.mark.parametrize(
    ("rounds", "kept", "asked"),
    [
        (["110", "110"], [0, 1], [[0, 1]]),
        (["111", "110", "110"], [0, 1], [[0, 1, 2], [0, 1]]),
        (["111", "110", "101", "110", "101"], [0, 2], [[0, 1, 2], [0, 1], [0, 2], [0, 1]]),  # four rounds at most
        (["111", "110", "100"], None, [[0, 1, 2], [0, 1]]),
        (["100"], None, []),
    ],
)
def test_images_are_compared_until_the_same_agree(monkeypatch, rounds, kept, asked):
    """With the lens that the agreeing ones have; more than half must agree."""
    images = [known(k, name=f"{k}") for k in range(3)]
    masks, begun, told = iter(rounds), [], []
    lengths = FocalLengths(np.log([1.0, 1.01, 0.98]), np.full(3, 1e-4))

    def begin(cls, chosen, *given):
        begun.append([int(one.field.name) for one in chosen])
        return SimpleNamespace(fit=SimpleNamespace(camera=CAMERA), names=begun[-1])

    def agreeing(found, among, *, lens_known):
        told.append(lens_known)
        return np.array([c == "1" for c in next(masks)])

    monkeypatch.setattr(_Bench, "begin", classmethod(begin))
    monkeypatch.setattr(procedure, "agreeing", agreeing)
    monkeypatch.setattr(procedure, "focal_lengths", lambda *_: lengths)
    if kept is None:
        with pytest.raises(InputError, match=r"not taken at one focal length \(relative to their median: 0 1\.0"):
            _largest_agreeing(images, "pinhole", False, None)
    else:
        found, reasons = _largest_agreeing(images, "pinhole", False, None)
        assert found.names == asked[-1]
        assert set(reasons) == {f"{k}" for k in range(3) if k not in kept}
        usual = np.exp(np.median(lengths.log_factor[kept]))
        for name, reason in reasons.items():
            assert reason.startswith(f"its focal length is {np.exp(lengths.log_factor[int(name)]) / usual:.4f} times")
    assert begun == asked
    assert told == [False] + [True] * (len(told) - 1)


def test_images_of_which_no_lens_fits(monkeypatch):
    monkeypatch.setattr(_Bench, "begin", classmethod(lambda *_: None))
    assert _largest_agreeing([known(1), known(2)], "pinhole", False, None) == (None, {})


@pytest.mark.parametrize(("longer", "copy"), [(0, True), (3, True), (5, False)])
def test_copies_may_differ_by_a_tenth(longer, copy):
    xy = np.random.default_rng(4).uniform(0.0, 800.0, (40, 2))
    other = np.concatenate([xy, np.random.default_rng(5).uniform(0.0, 800.0, (longer, 2))])
    assert _is_copy(xy, other) is copy
    assert _is_copy(other, xy) is copy
    assert _is_copy(xy, xy + 0.69e-3)  # along both axes
    assert not _is_copy(xy, xy + 0.75e-3)


# ---------------------------------------------------------------------- notes
def noted(**changes):
    values = {
        "names": ("f", "cx", "cy"),
        "held_by_prior": list,
        "field_px": 0.0,
        "weighted_rms_px": 1.0,
        "fields": [SimpleNamespace(refraction=np.zeros(2))],
    } | changes
    return _notes(SimpleNamespace(**values))


def test_what_is_told_of_a_result():
    assert noted() == ()
    assert noted(names=("f",))[0].startswith("principal point held at the image centre")
    assert noted(held_by_prior=lambda: ["f", "cy"])[0].startswith("cy: determined mainly by the prior")
    assert noted(field_px=0.249) == ()
    assert noted(field_px=0.251)[0].startswith("a smooth distortion of 0.25 px rms on each axis remains")
    kappa = 58.3 / 206264.8
    stretched = SimpleNamespace(refraction=0.5 * kappa * math.tan(math.radians(60.0)) ** 2 * np.array([0.6, 0.8]))
    (note,) = noted(fields=[SimpleNamespace(refraction=np.zeros(2)), stretched])
    assert note.endswith("altitudes of about 90°, 30°")


def test_the_fit_to_begin_with_has_no_parameters():
    fit = _unfitted(CAMERA, [known(1), known(2)])
    assert isinstance(fit, JointFit)
    assert (fit.names, fit.stretches.shape, fit.covariance.shape) == ((), (2, 2), (0, 0))
    assert not fit.stretches.any()


# ---------------------------------------------------------------------- figure
def test_the_figure_shows_residuals_by_place_radius_and_size():
    """Arrows enlarged by a round number; radial parts with weighted means over bins of equal numbers of stars, before
    and after; a histogram of unit area."""
    images = [known(1), known(2, name="second")]
    result = _Bench.begin(images, "pinhole", False, ["k1"]).answer({})
    arrows, radius, histogram = residual_figure(result).axes
    xy, residual = np.concatenate([one.xy for one in result.fields]), result.residual_px
    drawn = [part for part in arrows.collections if hasattr(part, "U")]
    np.testing.assert_allclose(np.concatenate([np.column_stack([q.X, q.Y]) for q in drawn]), xy)
    np.testing.assert_allclose(np.concatenate([np.column_stack([q.U, q.V]) for q in drawn]), residual)
    scale = _round_down(0.04 * 1000 / result.weighted_rms_px)
    assert [q.scale for q in drawn] == [1.0 / scale] * 2
    assert arrows.get_title() == f"residuals × {scale:g}"
    assert (arrows.get_xlim(), arrows.get_ylim()) == ((-0.5, 999.5), (799.5, -0.5))
    camera, weight = result.camera, result.sigma_px**-2.0
    away = xy - [camera.cx, camera.cy]
    distance = np.hypot(*away.T)
    edges = np.quantile(distance, np.linspace(0.0, 1.0, 9))
    arcsec = math.degrees(camera.pixel_rad) * 3600.0
    points, means = radius.lines[0], [box.lines[0] for box in radius.containers]
    assert len(means) == 2
    for line, values in zip(means, (np.concatenate(result.plain_residual_px), residual), strict=True):
        radial = np.sum(values * away, axis=1) / distance * arcsec
        bins = np.clip(np.searchsorted(edges, distance, side="right") - 1, 0, 7)
        expected = [np.average(radial[bins == k], weights=weight[bins == k]) for k in range(8)]
        np.testing.assert_allclose(line.get_ydata(), expected, rtol=1e-6, atol=1e-9)
        middle = [np.average(distance[bins == k], weights=weight[bins == k]) for k in range(8)]
        np.testing.assert_allclose(line.get_xdata(), middle, rtol=1e-9)
    np.testing.assert_allclose(points.get_xdata(), distance)
    bars = [part.get_segments() for box in radius.containers for part in box.lines[2]]
    total = np.bincount(bins, weight, 8)
    lengths = np.array([segment[1][1] - segment[0][1] for segment in bars[1]])
    np.testing.assert_allclose(lengths, 2.0 * arcsec / np.sqrt(total), rtol=1e-6)
    reach = 1.3 * np.quantile(np.abs(residual) * arcsec, 0.97)
    plain = np.abs(np.sum(np.concatenate(result.plain_residual_px) * away, axis=1) / distance) * arcsec
    np.testing.assert_allclose(radius.get_ylim()[1], max(reach, 1.1 * np.quantile(plain, 0.95)), rtol=1e-6)
    heights, widths = ([getattr(bar, f"get_{name}")() for bar in histogram.patches] for name in ("height", "width"))
    inside = np.abs(residual / result.sigma_px[:, None]) <= 5.0
    assert len(heights) == 40
    assert inside.any()
    assert np.dot(heights, widths) == pytest.approx(1.0)
    curve = histogram.lines[0]
    assert curve.get_xdata()[[0, -1]].tolist() == [-5.0, 5.0]  # as the bins
    assert (histogram.patches[0].get_x(), histogram.patches[-1].get_x()) == pytest.approx((-5.0, 4.75))
    np.testing.assert_allclose(curve.get_ydata(), np.exp(-0.5 * curve.get_xdata() ** 2) / math.sqrt(2.0 * math.pi))


def test_residuals_beyond_the_histogram_are_counted():
    result = _Bench.begin([known(1)], "pinhole", False, ["k1"]).answer({})
    field = result.fields[0]
    residual = field.residual_px.copy()
    residual[0, 0], residual[1, 1] = 5.1 * field.sigma_px[0], -5.1 * field.sigma_px[1]
    residual[2] = 4.9 * field.sigma_px[2]
    far = replace(result, fields=(replace(field, residual_px=residual),))
    assert residual_figure(far).axes[2].get_title() == f"{far.stars} stars, {far.rejected} rejected; 2 beyond ±5"
    assert residual_figure(result).axes[2].get_title() == f"{result.stars} stars, {result.rejected} rejected"


@pytest.mark.parametrize(
    ("value", "rounded"),
    [(1.0, 1.0), (1.99, 1.0), (2.0, 2.0), (4.9, 2.0), (5.0, 5.0), (9.9, 5.0), (0.03, 0.02), (740.0, 500.0)],
)
def test_round_numbers(value, rounded):
    assert _round_down(value) == pytest.approx(rounded)
