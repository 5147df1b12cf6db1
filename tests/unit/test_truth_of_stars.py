"""What the truth tells of the catalogue's stars: variables by their flag, unresolved doubles summed."""

from dataclasses import replace

import numpy as np
import pytest

from simulator import Renderer, Scenario
from simulator.fits import write_fits
from startracker.catalog import load_catalog, merge_doubles
from startracker.geometry.attitude import Attitude, radec_to_direction

QUIET = ["sky.earth=false", "pointing.error_deg=0", "detector.width=256", "detector.height=256"]


def test_variables_are_flagged_in_the_truth_and_in_its_file(tmp_path):
    from astropy.io import fits

    renderer = Renderer(Scenario.load("cubesat_ideal", [*QUIET, "pointing.target=Omi Cet"]))  # Mira
    frame, truth = renderer.frame(0)
    sources = truth.sources
    known = load_catalog("hipparcos")
    flag = dict(zip(known.id.tolist(), known.variable.tolist(), strict=True))
    assert sources.variable.dtype == bool
    assert sources.variable.tolist() == [flag[number] for number in sources.id.tolist()]
    assert sources.variable[sources.id == 10826].tolist() == [True]
    assert not np.all(sources.variable)
    write_fits(tmp_path / "frame.fits", frame, truth)
    table = fits.getdata(tmp_path / "frame.fits", "TRUTH")
    assert table["variable"].dtype == bool
    assert table["variable"].tolist() == sources.variable.tolist()


def test_a_body_is_no_variable_star():
    sources = Renderer(Scenario.load("cubesat_ideal", [*QUIET, "pointing.target=Jupiter"])).frame(0)[1].sources
    assert "planet" in sources.kind
    assert not np.any(sources.variable[sources.kind != "star"])


@pytest.fixture(scope="module")
def pair():
    """A focal plane, and the scene of two stars 0.3 px apart that it cannot resolve, of one colour."""
    renderer = Renderer(Scenario.load("cubesat_ideal", [*QUIET, "sky.planets=false", "sky.background=false"]))
    attitude = Attitude.from_radec_roll(40.0, 10.0, 0.0)
    scene = renderer.scene(0, at_s=0.0, attitude=attitude)
    separation = 0.3 * renderer.camera.pixel_rad
    first = scene.stars.select(np.array([0, 0]))
    stars = replace(
        first,
        id=np.array([1, 2]),
        ra_rad=np.radians([40.0, 40.0]),
        dec_rad=np.radians(10.0) + np.array([0.0, separation]),
        v_mag=np.array([4.0, 5.2]),
        b_v=np.full(2, 0.6),
        variable=np.array([False, True]),
    )
    return renderer, scene, stars, separation


def expose(pair, stars):
    renderer, scene, _, _ = pair
    directions = radec_to_direction(stars.ra_rad, stars.dec_rad)
    light = replace(
        scene,
        catalog=stars,
        b_v=stars.b_v,
        giant=np.zeros(len(stars)),
        rows=np.arange(len(stars)),
        star_directions=directions,
    )
    return renderer.expose(light)


def test_unresolved_double_is_drawn_as_the_sum_of_both(pair):
    _, _, stars, _ = pair
    both = expose(pair, stars)
    alone = [expose(pair, stars.select(np.array([k]))) for k in (0, 1)]
    np.testing.assert_allclose(both.mean_e, alone[0].mean_e + alone[1].mean_e, rtol=1e-12, atol=1e-9)
    # Pogson: 1.2 mag are a factor of 3.02 in electrons
    first, second = (one.mean_e.sum() for one in alone)
    assert first / second == pytest.approx(10.0**0.48, rel=1e-3)
    # one spot, not two: its brightest pixel is within a pixel of both stars, its neighbours fall off to all sides
    y, x = np.unravel_index(int(np.argmax(both.mean_e)), both.mean_e.shape)
    assert np.abs(both.sources.xy - (x, y)).max() < 1.0
    rows, columns = both.mean_e[y - 4 : y + 5, x], both.mean_e[y, x - 4 : x + 5]
    for profile in (rows, columns):
        assert np.array_equal(np.sign(np.diff(profile)), [1] * 4 + [-1] * 4)


def test_a_merged_double_gives_the_light_of_both(pair):
    _, _, stars, separation = pair
    merged = merge_doubles(stars, 2 * separation)
    assert len(merged) == 1
    assert merged.v_mag[0] == pytest.approx(-2.5 * np.log10(10**-1.6 + 10**-2.08), abs=1e-12)
    assert merged.variable.tolist() == [True]
    both, one = expose(pair, stars), expose(pair, merged)
    # by Pogson's law; the photometer is linear in 10^(−0.4 V)
    assert one.sources.electrons.sum() == pytest.approx(both.sources.electrons.sum(), rel=1e-9)
    assert one.mean_e.sum() == pytest.approx(both.mean_e.sum(), rel=1e-3)
    # and at the centre of light: the merged star stands where the sum of both has its centroid, to 1 % of the 0.3 px
    grid = np.arange(256.0)
    centre = [np.array([(e.mean_e.sum(0) @ grid), (e.mean_e.sum(1) @ grid)]) / e.mean_e.sum() for e in (both, one)]
    np.testing.assert_allclose(centre[1], centre[0], atol=0.003)
