"""The annotated picture: what is drawn, that labels keep clear of each other, and the grid's values."""

import io

import numpy as np
import pytest
from PIL import Image

from startracker import Attitude, Camera, Solution, Status, load_catalog
from startracker.annotate import annotate, annotated_picture, stretch
from startracker.annotate_sky import compass_arrows, dec_text, grid_lines, nice_step, ra_text
from startracker.solution import MatchedStars


def field(camera, attitude, limit=6.0):
    """A solution with every catalogue star of a field."""
    stars = load_catalog("hipparcos").brighter_than(limit)
    directions, _ = stars.space_motion()
    vectors = attitude.apply(directions)
    near = np.flatnonzero(vectors[:, 2] > np.cos(camera.half_diagonal_rad))
    xy = camera.project(vectors[near])
    near, xy = near[camera.contains(xy)], xy[camera.contains(xy)]
    matched = MatchedStars(
        xy, stars.id[near], stars.star_name[near], stars.v_mag[near], np.ones(len(near)), np.zeros((len(near), 2))
    )
    return Solution(
        Status.SOLVED, "", attitude, np.eye(3) * 1e-12, matched, xy, camera.fov_deg, camera.parity, camera=camera
    )


ORION = field(Camera.from_fov(25.0, 640, 480), Attitude.from_radec_roll(84.0, 0.0, 10.0))
SKY = np.random.default_rng(1).normal(50.0, 3.0, (480, 640))


def texts(figure):
    return [text.get_text() for text in figure.axes[0].texts if text.get_text()]


def test_bright_stars_are_named_and_no_label_covers_another():
    figure = annotate(SKY, ORION, grid=True, constellations=True)
    names = texts(figure)
    for name in ("Betelgeuse", "Rigel", "Mintaka", "Saiph", "Ori", "N", "E"):
        assert name in names
    renderer = figure.canvas.get_renderer()
    boxes = [t.get_window_extent(renderer) for t in figure.axes[0].texts if t.get_text() not in ("", "N", "E", "5°")]
    covered = [
        (i, j)
        for i, one in enumerate(boxes)
        for j, other in enumerate(boxes[:i])
        if one.x0 < other.x1 - 1 and other.x0 < one.x1 - 1 and one.y0 < other.y1 - 1 and other.y0 < one.y1 - 1
    ]
    assert not covered
    inside = figure.axes[0].get_window_extent()
    assert all(box.x0 >= inside.x0 - 1 and box.x1 <= inside.x1 + 1 for box in boxes)


@pytest.mark.parametrize("size", [(512, 512), (4000, 3000), (200, 60), (60, 200), (1, 1)])
def test_any_size_gives_a_readable_picture(size):
    camera = Camera.from_fov(25.0, *size)
    solution = field(camera, Attitude.from_radec_roll(84.0, 0.0, 10.0), 4.0)
    image = (
        np.full(size[::-1], 7.0)
        if max(size) < 300
        else np.random.default_rng(1).integers(40, 60, size[::-1], dtype=np.uint8)
    )
    unsolved = Solution(Status.NO_MATCH, "nothing")
    for one in (solution, unsolved) if solution.matched else (unsolved,):
        with Image.open(io.BytesIO(annotated_picture(image, one, grid=True, constellations=True))) as picture:
            assert 1000 < max(picture.size) < 3000


def test_what_is_not_matched_is_marked_differently():
    kept = 8
    stars = ORION.stars
    fewer = MatchedStars(
        *(getattr(stars, n)[2 : 2 + kept] for n in ("xy", "catalog_id", "name", "v_mag", "flux", "residual_px"))
    )
    seen = np.concatenate([fewer.xy, [[20.0, 30.0], [600.0, 30.0]]])
    solution = Solution(Status.SOLVED, "", ORION.attitude, np.eye(3), fewer, seen, 25.0, 1, camera=ORION.camera)
    legend = [text.get_text() for text in annotate(SKY, solution).legends[0].get_texts()]
    assert f"identified ({kept})" in legend
    assert "detected only (2)" in legend
    assert any(text.startswith("expected, not found") for text in legend)


def test_the_same_picture_is_the_same_file():
    assert annotated_picture(SKY, ORION, grid=True) == annotated_picture(SKY, ORION, grid=True)


def test_the_grid_lies_where_its_values_say():
    camera, attitude = Camera.from_fov(25.0, 640, 480), Attitude.from_radec_roll(84.0, 20.0, 70.0)
    solution = Solution(Status.SOLVED, "", attitude, np.eye(3), camera=camera)
    seen = 0
    for places, text in grid_lines(solution):
        good = places[np.isfinite(places).all(axis=1)]
        if not len(good):
            continue
        seen += 1
        ra, dec = solution.radec_of(good).T
        if "h" in text:
            hours, minutes = (float(word[:-1]) for word in (text + " 0m").split()[:2])
            assert ra == pytest.approx(15.0 * (hours + minutes / 60.0), abs=1e-6)
        else:
            assert dec == pytest.approx(float(text.replace("−", "-").rstrip("°")), abs=1e-6)
    assert 6 <= seen <= 30


@pytest.mark.parametrize("dec", [89.0, -89.5, 90.0])
def test_a_pole_in_the_field_has_its_hours_all_around(dec):
    solution = Solution(
        Status.SOLVED, "", Attitude.from_radec_roll(40.0, dec, 0.0), np.eye(3), camera=Camera.from_fov(20.0, 500, 500)
    )
    hours = {text for _, text in grid_lines(solution) if "h" in text}
    assert hours == {f"{h}h" for h in range(0, 24, 2)}


@pytest.mark.parametrize("parity", [1, -1])
def test_the_compass(parity):
    from dataclasses import replace

    camera = replace(Camera.from_fov(10.0, 400, 300), parity=parity)
    arrows = compass_arrows(
        Solution(Status.SOLVED, "", Attitude.from_radec_roll(30.0, 40.0, 0.0), np.eye(3), camera=camera)
    )
    # a step of a pixel is drawn; over it the parallel bends by half its angle times tan δ, 2e-4
    assert arrows["N"] == pytest.approx([0.0, -1.0], abs=3e-4)  # up, as rows grow downwards
    assert arrows["E"] == pytest.approx([-parity, 0.0], abs=3e-4)


def test_words():
    assert ra_text(84.0104) == "5h 36m 02s"
    assert ra_text(75.0, 15.0) == "5h"
    assert ra_text(359.9999) == "0h 00m 00s"
    assert dec_text(-0.7721) == "−0° 46′ 20″"
    assert dec_text(0.0, 1.0) == "0°"
    assert dec_text(-30.0, 10.0) == "−30°"
    assert nice_step(2.3) == 2
    assert nice_step(0.4) == pytest.approx(20 / 60)


def test_the_stretch_spans_sky_to_star():
    shown = stretch(SKY + 500.0 * (SKY > SKY.max() - 1e-9))
    assert shown.min() == 0.0
    assert shown.max() == 1.0
    assert np.median(shown) < 0.1
    assert not stretch(np.full((4, 4), np.nan)).any()
    assert np.isfinite(stretch(np.where(SKY > 55.0, np.nan, SKY))).all()
