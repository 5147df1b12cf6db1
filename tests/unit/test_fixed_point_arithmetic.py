"""Integer arithmetics of the triad pipeline: against floating point, and that no floating point comes in."""

from dataclasses import fields

import numpy as np
import pytest

from simulator.randomness import stream
from simulator.theses.yee1999.catalogue import sub_catalog
from simulator.theses.yee1999.centroid_lists import centroid_list
from simulator.theses.yee1999.fixed_point.arithmetic import FixedArithmetic
from simulator.theses.yee1999.fixed_point.formats import FixedPointOverflow, integers
from simulator.theses.yee1999.fixed_point.wide import WideArithmetic
from simulator.theses.yee1999.picture import vega
from startracker.identification.arithmetic import FloatArithmetic
from startracker.identification.triad_search import TriadLimits, image_pairs
from startracker.identification.triad_tables import TriadTables
from startracker.identification.triad_votes import match_triads

ENTRIES = ("image", "sky", "separation_of", "angle_of")
EXITS = ("separation_degrees", "angle_degrees")


class Watched:
    """An arithmetic whose every array must be of integers, except where real numbers enter and leave."""

    def __init__(self, inner):
        self.inner, self.calls = inner, set()

    def __getattr__(self, name):
        value = getattr(self.inner, name)
        if not callable(value):
            return value

        def call(*arguments):
            self.calls.add(name)
            if name not in ENTRIES:
                for argument in arguments:
                    check_integers(argument)
            result = value(*arguments)
            if name not in EXITS:
                check_integers(result)
            return result

        return call


def check_integers(value):
    if hasattr(value, "__dataclass_fields__"):
        value = tuple(getattr(value, field.name) for field in fields(value))
    for part in value if isinstance(value, tuple) else (value,):
        integers(part)  # raises TypeError


def off_degrees(fixed, floating):
    return np.abs((fixed - floating + 180.0) % 360.0 - 180.0).max()


@pytest.fixture(scope="module")
def sky():
    rng = np.random.default_rng(1)
    ra, dec = rng.uniform(0, 360, 200), np.degrees(np.arcsin(rng.uniform(-0.97, 0.97, 200)))
    i, j = np.triu_indices(200, 1)
    return ra, dec, i, j


@pytest.mark.parametrize(
    ("fixed", "floating", "separation_deg", "angle_deg"),
    [
        # one unit of the format, truncated; two for sums of two angles; 12.20 scales and 10.14 vectors add little
        (FixedArithmetic(), FloatArithmetic(), 3 / 1024, 2 / 64),
        # a rounding of 3 × 2⁻³⁰ against a vector of 0.5° × cos 76°: 8e-5°
        (WideArithmetic(), FloatArithmetic(exact=True), 1e-6, 8e-5),
    ],
)
def test_quantities_agree_with_floating_point(sky, fixed, floating, separation_deg, angle_deg):
    ra, dec, i, j = sky
    ours, theirs = fixed.sky(ra, dec, 20.0), floating.sky(ra, dec, 20.0)
    apart = floating.catalog_separations(theirs, i, j)
    assert np.abs(fixed.separation_degrees(fixed.catalog_separations(ours, i, j)) - apart).max() < separation_deg
    near = (apart < 25.0) & (apart > 0.5)
    i, j = i[near], j[near]
    k = (j + 1) % 200
    directions = fixed.angle_degrees(fixed.catalog_directions(ours, i, j))
    assert off_degrees(directions, floating.catalog_directions(theirs, i, j)) < angle_deg
    for a, b in zip(fixed.catalog_enclosed(ours, i, j, k), floating.catalog_enclosed(theirs, i, j, k), strict=True):
        assert off_degrees(fixed.angle_degrees(a), b) < angle_deg

    xy = np.random.default_rng(2).uniform(-250, 250, (30, 2))
    scale = (0.03, 0.031)
    ours, theirs = fixed.image(xy, scale), floating.image(xy, scale)
    i, j = image_pairs(30)
    apart = floating.image_separations(theirs, i, j)
    small = apart < 11.0  # beyond, her tables err by up to 0.02°
    off = np.abs(fixed.separation_degrees(fixed.image_separations(ours, i, j)) - apart)
    if isinstance(fixed, WideArithmetic):
        assert off.max() < separation_deg
    else:
        plane = np.hypot(*((xy[i] - xy[j]) * scale).T)
        assert np.abs(off - np.abs(plane - apart))[small].max() < separation_deg
        assert off.max() < 0.025
    found = fixed.angle_degrees(fixed.image_directions(ours, i, j))
    assert off_degrees(found, floating.image_directions(theirs, i, j)) < angle_deg
    k = (j + 1) % 30
    distinct = np.min([np.hypot(*(xy[p] - xy[q]).T) for p, q in ((i, j), (i, k), (j, k))], axis=0) > 17.0  # 0.5°
    i, j, k = i[distinct], j[distinct], k[distinct]
    for a, b in zip(fixed.image_enclosed(ours, i, j, k), floating.image_enclosed(theirs, i, j, k), strict=True):
        assert off_degrees(fixed.angle_degrees(a), b) < 2 * angle_deg


@pytest.mark.parametrize(
    ("arithmetic", "floating"),
    [(FixedArithmetic(), FloatArithmetic()), (WideArithmetic(), FloatArithmetic(exact=True))],
)
def test_no_floating_point_inside(arithmetic, floating):
    watched = Watched(arithmetic)
    stars, picture = sub_catalog(4, 6.0), vega()
    tables = TriadTables.build(watched, stars.hr, stars.ra_deg, stars.dec_deg, stars.v_mag, 12.0)
    match = match_triads(tables, picture.xy_px, picture.scale_deg, TriadLimits())
    best = match.best()
    assert [vote.number(tables) for vote in best.matches] == [7001, 17139, 17056, 17051, 6872]
    real = match_triads(stars.tables(12.0, floating), picture.xy_px, picture.scale_deg, TriadLimits())
    assert len(match.triads) == len(real.triads)
    assert match.triads.group_sizes.tolist() == real.triads.group_sizes.tolist()
    for array in (match.separations, match.triads.rotations, match.triads.group_rotations, tables.separation):
        integers(array)
    expected = {name for name in dir(FloatArithmetic) if not name.startswith("_")}
    assert watched.calls >= expected - {"full_turn", "exact", *EXITS}


def test_floating_point_is_refused(sky):
    ra, dec, i, j = sky
    fixed = FixedArithmetic()
    stars = fixed.sky(ra, dec, 20.0)
    image = fixed.image([[1.0, 2.0], [3.0, 4.0]], (0.01, 0.01))
    with pytest.raises(TypeError, match="float64"):
        fixed.rotations(np.array([1.0]), np.array([2]))
    with pytest.raises(TypeError):
        fixed.angles_agree([1.0], [2], 3)
    with pytest.raises(TypeError):
        fixed.separations_agree([1], [2], 0.5)
    with pytest.raises(TypeError):
        fixed.group_mean(1.0, 2, 3)
    with pytest.raises(TypeError):
        fixed.catalog_separations(stars, i.astype(float), j)
    with pytest.raises(TypeError):
        fixed.image_separations(image, [0.0], [1.0])


def test_overflow_is_reported():
    fixed = FixedArithmetic()
    scale = (40.0 / 1022, 40.0 / 1022)
    far = fixed.image([[-500.0, 0.0], [500.0, 400.0]], scale)
    with pytest.raises(FixedPointOverflow, match=r"6\.10"):
        fixed.image_separations(far, [0], [1])
    with pytest.raises(FixedPointOverflow, match=r"10\.22"):
        fixed.image([[512.0, 0.0], [1.0, 1.0]], scale)
    with pytest.raises(FixedPointOverflow, match="tangent"):
        WideArithmetic().image([[1e6, 0.0]], (0.001, 0.001))


def test_integers_in_give_the_same():
    fixed, picture = FixedArithmetic(), vega()
    real = fixed.image(picture.xy_px, picture.scale_deg)
    again = fixed.image(real.xy, real.scale_deg)
    assert (again.xy == real.xy).all()
    assert (again.scale_deg == real.scale_deg).all()


def test_edges_of_the_circle():
    fixed = FixedArithmetic()
    turn = fixed.full_turn
    assert fixed.rotations([0], [1]) == turn - 1
    assert fixed.mean_rotations([turn - 2], [4]).tolist() == [1]
    assert fixed.mean_rotations([4], [turn - 2]).tolist() == [1]
    assert fixed.angles_agree([turn - 1], [1], 2).all()
    assert not fixed.angles_agree([turn - 1], [2], 2).any()
    assert fixed.group_mean(turn - 1, 7, 2) == 2
    assert fixed.group_mean(1, -7, 2) == turn - 3  # downwards
    nothing = fixed.image([[1.0, 1.0], [1.0, 1.0]], (0.01, 0.01))
    assert fixed.image_directions(nothing, [0], [1]).tolist() == [0]


def test_matches_are_those_of_floating_point():
    """Section 4.2.4.3: "the matches are the same"; a star on the edge of a tolerance may differ."""
    stars = sub_catalog(5, 6.0, 30.0, 90.0)
    ra, dec = np.radians(stars.sky_deg).T
    directions = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    tables = [stars.tables(12.0, arithmetic) for arithmetic in (FloatArithmetic(), FixedArithmetic())]
    scale = (9.0130 / 427, 6.9049 / 319)
    same, found = 0, 0
    for k in range(60):
        xy = centroid_list(directions, stars.v_mag, (9.0130, 6.9049), (427, 319), stream(9, "fixed", k), 7)
        best = [match_triads(t, xy, scale).best() for t in tables]
        pairs = [{} if b is None else dict(b.pairs.tolist()) for b in best]
        found += bool(pairs[0])
        same += pairs[0] == pairs[1]
        assert all(pairs[1][star] == place for star, place in pairs[0].items() if star in pairs[1])
    assert found > 35
    assert same >= 57
