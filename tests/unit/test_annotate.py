"""The annotated picture: what is drawn, that labels keep clear of each other, and the grid's values."""

import io

import numpy as np
import pytest
from matplotlib import rc_context
from PIL import Image

from startracker import Attitude, Camera, Observer, Solution, Status, load_catalog
from startracker.annotation.annotate import annotate, annotated_picture, star_coloured
from startracker.annotation.sky import compass_arrows, dec_text, grid_lines, nice_step, ra_text
from startracker.catalog.bodies import body_directions
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


def covered(figure):
    """Pairs of texts of a figure whose boxes overlap, and texts outside of the axes."""
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    shown = [text for ax in figure.axes for text in ax.texts if text.get_text()] + figure.texts
    shown += [text for legend in figure.legends for text in legend.get_texts()]
    boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in shown]
    width, height = figure.canvas.get_width_height()
    return [
        (one, other)
        for i, (one, a) in enumerate(boxes)
        for other, b in boxes[:i]
        if a.x0 < b.x1 - 1 and b.x0 < a.x1 - 1 and a.y0 < b.y1 - 1 and b.y0 < a.y1 - 1
    ] + [(text, "outside") for text, a in boxes if a.x0 < -1 or a.y0 < -1 or a.x1 > width + 1 or a.y1 > height + 1]


def test_bright_stars_and_objects_are_named():
    names = texts(annotate(SKY, ORION, grid=True, constellations=True))
    for name in ("Betelgeuse", "Rigel", "Mintaka", "Saiph", "Ori", "M42 Orion Nebula", "M78"):
        assert name in names
    assert not any("M42" in name for name in texts(annotate(SKY, ORION, deep_sky=False)))


@pytest.mark.parametrize("shape", [(640, 480), (300, 900)])
@pytest.mark.parametrize(
    ("ra", "dec", "fov"), [(84.0, 0.0, 25.0), (187.0, 12.0, 12.0), (270.0, -25.0, 20.0), (10.0, 89.0, 20.0)]
)
def test_no_label_covers_another_or_leaves_the_picture(shape, ra, dec, fov):
    camera = Camera.from_fov(fov, *shape)
    solution = field(camera, Attitude.from_radec_roll(ra, dec, 30.0))
    observer = Observer(2026.5)
    figure = annotate(
        np.zeros(shape[::-1], np.uint8), solution, names=200, grid=True, constellations=True, observer=observer
    )
    assert len(texts(figure)) > 10
    assert not covered(figure)


def test_a_planet_in_the_field_is_marked():
    observer = Observer(2026.5)
    jupiter = body_directions(observer)["Jupiter"]
    ra, dec = np.degrees([np.arctan2(jupiter[1], jupiter[0]), np.arcsin(jupiter[2])])
    solution = field(Camera.from_fov(10.0, 640, 480), Attitude.from_radec_roll(ra, dec + 2.0, 0.0))
    assert "Jupiter" in texts(annotate(SKY, solution, observer=observer))
    assert "Jupiter" not in texts(annotate(SKY, solution))


def test_a_colour_image_keeps_its_colours():
    red = np.zeros((480, 640, 3))
    red[...] = SKY[..., None]
    red[100:104, 200:204] += (3000.0, 300.0, 300.0)
    shown = annotate(red, ORION).axes[0].images[0].get_array()
    assert shown[102, 202, 0] > 2.0 * shown[102, 202, 1]
    assert shown[300, 300].std() < 0.1  # noise of the sky only
    tinted = star_coloured(SKY, ORION)
    assert tinted.shape == (480, 640, 3)


@pytest.mark.parametrize("size", [(512, 512), (4000, 400), (200, 60), (60, 200), (1, 1)])
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
    picture = annotated_picture(SKY, ORION, grid=True)
    with rc_context({"figure.autolayout": True}):  # as Basilisk sets it for the whole program
        assert annotated_picture(SKY, ORION, grid=True) == picture


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
