"""Modules of the live page, run in Chromium, against SciPy, OpenCV, Matplotlib, astropy and NumPy.

Tolerances are those of float64 with a few operations, unless stated.
"""

import mimetypes
from pathlib import Path

import cv2
import matplotlib.projections.geo
import numpy as np
import pytest
from astropy.coordinates import Angle
from live_page import chromium
from scipy.spatial.transform import Rotation

import simulator.live
from startracker import Attitude
from startracker.images.picture import stretch

pytestmark = pytest.mark.system

PAGE = Path(simulator.live.__file__).parent / "page"
RANDOM = np.random.default_rng(5)
DIRECTIONS = RANDOM.normal(size=(300, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1)[:, None]
LENS = {"width": 640, "height": 480, "fx": 800.0, "fy": 790.0, "cx": 320.5, "cy": 236.0}
K = [-0.25, 0.08, 1.2e-3, -7e-4, 0.01, 0.02, -0.01, 0.003]


@pytest.fixture(scope="module")
def page():
    def answer(route):
        name = route.request.url.rsplit("/", 1)[1] or "empty.html"
        body = (PAGE / name).read_text(encoding="utf-8") if name != "empty.html" else "<title>modules</title>"
        kind = "text/javascript" if name.endswith(".js") else mimetypes.guess_type(name)[0]
        route.fulfill(body=body, content_type=kind)

    with chromium() as browser:
        page = browser.new_page()
        page.route("http://modules.test/**", answer)
        page.goto("http://modules.test/")
        yield page
        page.close()


def call(page, module, body, argument=None):
    """Value of `body` (JavaScript) with the module as `m` and the argument as `a`."""
    return page.evaluate(f"async a => {{ const m = await import('/{module}.js'); {body} }}", argument)


def test_matrix_of_a_quaternion_is_scipys(page):
    """The frame turns, not the vector: the transpose of SciPy's matrix."""
    quaternions = RANDOM.normal(size=(50, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1)[:, None]
    found = np.array(call(page, "vectors", "return a.map(m.matrixOf)", quaternions.tolist()))
    np.testing.assert_allclose(found, [Attitude(q).as_matrix() for q in quaternions], atol=1e-14)
    active = Rotation.from_quat(quaternions).as_matrix()
    np.testing.assert_allclose(found, active.transpose(0, 2, 1), atol=1e-14)


def test_pixels_are_opencvs(page):
    points = RANDOM.uniform([-0.4, -0.3, 1.0], [0.4, 0.3, 1.0], size=(200, 3))
    matrix = np.array([[LENS["fx"], 0, LENS["cx"]], [0, LENS["fy"], LENS["cy"]], [0, 0, 1]])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(K))
    body = "const lens = new m.Lens(a.lens); return a.points.map(p => lens.pixelOf(p))"
    lens = LENS | {"distortion": K}
    found = np.array(call(page, "vectors", body, {"lens": lens, "points": points.tolist()}))
    np.testing.assert_allclose(found, expected[:, 0], atol=1e-9)
    body = "const lens = new m.Lens(a.lens); return a.pixels.map(p => lens.directionOf(...p))"
    back = np.array(call(page, "vectors", body, {"lens": lens, "pixels": found.tolist()}))
    np.testing.assert_allclose(back, points / np.linalg.norm(points, axis=1)[:, None], atol=1e-9)


def test_map_is_matplotlibs_hammer_projection_with_right_ascension_to_the_left(page):
    found = np.array(
        call(page, "vectors", "const h = new m.Hammer(0); return a.map(v => h.of(v))", DIRECTIONS.tolist())
    )
    lon = np.arctan2(DIRECTIONS[:, 1], DIRECTIONS[:, 0])
    lat = np.arcsin(DIRECTIONS[:, 2])
    hammer = matplotlib.projections.geo.HammerAxes.HammerTransform(1)
    expected = hammer.transform_non_affine(np.column_stack([lon, lat])) / np.sqrt(2.0)
    np.testing.assert_allclose(found, expected * [-1, 1], atol=1e-12)
    body = "const h = new m.Hammer(75); return a.map(v => h.back(...h.of(v)))"
    back = np.array(call(page, "vectors", body, DIRECTIONS.tolist()))
    np.testing.assert_allclose(back, DIRECTIONS, atol=1e-11)
    assert call(page, "vectors", "return new m.Hammer(0).back(1.9, 0.9)") is None


def test_circles_keep_their_radius(page):
    points = np.array(call(page, "vectors", "return m.circleAbout(a, 0.4)", DIRECTIONS[0].tolist()))
    np.testing.assert_allclose(np.arccos(points @ DIRECTIONS[0]), 0.4, atol=1e-12)
    np.testing.assert_allclose(points[0], points[-1], atol=1e-12)


def test_stretch_is_that_of_the_reports_pictures(page):
    """Within one grey level: there float32, here float64."""
    image = RANDOM.normal(400.0, 25.0, size=(120, 160))
    image[RANDOM.integers(0, 120, 40), RANDOM.integers(0, 160, 40)] += RANDOM.exponential(3000.0, 40)
    image = np.clip(np.round(image), 0, 65535).astype(np.uint16)
    body = "const p = Uint16Array.from(a), t = m.tableOf(m.levelsOf(p, 65535)); return [...p].map(v => t[v] & 255)"
    found = np.array(call(page, "stretch", body, image.ravel().tolist()))
    expected = np.round(255.0 * stretch(image)).ravel()
    assert np.abs(found - expected).max() <= 1
    white = call(
        page, "stretch", "const p = new Uint16Array(64).fill(4095); return m.tableOf(m.levelsOf(p, 4095))[4095] & 255"
    )
    assert white == 255  # a frame that is filled is white, not the grey of a sky


def test_sexagesimal_angles_are_astropys(page):
    ra = [*RANDOM.uniform(0, 360, 40), 0.0, 359.9999999, 15.0]
    dec = [*RANDOM.uniform(-90, 90, 40), 0.0, -0.0001, 59.99999999]
    found = call(page, "format", "return a.map(v => m.hours(v, 1))", ra)
    for text, value in zip(found, ra, strict=True):
        expected = Angle(value % 360, "deg").to_string("hourangle", sep="hms", precision=1, pad=True)
        assert text.replace(" ", "") == expected.replace("24h00m00.0s", "00h00m00.0s")
    found = call(page, "format", "return a.map(v => m.degrees(v, 0))", dec)
    for text, value in zip(found, dec, strict=True):
        expected = Angle(value, "deg").to_string("deg", sep="dms", precision=0, pad=True, alwayssign=True)
        plain = text.replace(" ", "").replace("°", "d").replace("′", "m").replace("″", "s").replace("−", "-")
        assert plain == expected


def test_histories_are_bounded_and_keep_the_newest(page):
    body = "const r = new m.Ring(100); for (let i = 0; i < 12345; i++) r.push(i); return [r.length, r.at(0), r.last()]"
    assert call(page, "state", body) == [100, 12245, 12344]


def test_jump_of_time_breaks_the_curve_and_unsolved_frames_are_gaps(page):
    body = """
      const source = new EventTarget(), store = new m.Store(source);
      const tell = (type, detail) => source.dispatchEvent(new CustomEvent(type, { detail }));
      tell('welcome', { step_s: 1 });
      [0, 1, 2, 5000, 5001].forEach((t_s, index) => {
        const status = index === 1 ? 'no_match' : 'solved';
        tell('truth', { index, t_s, error_arcsec: [1, 2, 3], bound_arcsec: [1, 1, 1], blinded: false });
        tell('solution', { index, t_s, status, ra_deg: 1, dec_deg: 2,
                           covariance_rad2: [[4e-12, 0, 0], [0, 4e-12, 0], [0, 0, 4e-12]] });
      });
      return Array.from({ length: 5 }, (_, i) => store.history.at(i));
    """
    rows = call(page, "state", body)
    assert [row["jumped"] for row in rows] == [False, False, False, True, False]
    assert [row["x"] for row in rows] == [0, 1, 2, 5, 6]
    assert rows[1]["error"] is None
    assert rows[1]["stated"] == rows[0]["stated"]  # of the filter, which coasts
    assert rows[0]["stated"][0] == pytest.approx(2e-6 * 180 * 3600 / np.pi, rel=1e-9)


@pytest.mark.parametrize(
    "parameter",
    [
        {"minimum": -60, "maximum": 80, "logarithmic": False},
        {"minimum": 0.002, "maximum": 20, "logarithmic": True},
        {"minimum": 0, "maximum": 0.01, "logarithmic": True},
    ],
)
def test_slider_goes_there_and_back(page, parameter):
    body = """const s = m.scaleOf(a), t = [...Array(21).keys()].map(i => i / 20);
              return [t.map(s.value), t.map(v => s.position(s.value(v)))]"""
    values, positions = np.array(call(page, "controls", body, parameter))
    np.testing.assert_allclose(positions, np.linspace(0, 1, 21), atol=1e-12)
    assert values[0] == parameter["minimum"]
    assert values[-1] == pytest.approx(parameter["maximum"], rel=1e-12)
    if parameter["logarithmic"]:
        np.testing.assert_allclose(np.diff(np.log(values[1:])), np.diff(np.log(values[1:]))[0], rtol=1e-9)
