"""Guide-star database against brute force on small synthetic skies."""

import math

import numpy as np
import pytest

from startracker.catalog import guide as guide_stars
from startracker.catalog import load_catalog
from startracker.catalog.guide import (
    GuideDatabase,
    PairList,
    brightest_everywhere,
    close_pairs,
    expected_pairs,
    field_of,
)
from startracker.catalog.stars import StarCatalog
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, radec_to_direction
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion
from startracker.observer import Observer, aberrate


def sky(n=400, seed=3, span_deg=20.0, **columns):
    rng = np.random.default_rng(seed)
    zero = np.zeros(n)
    table = {
        "id": np.arange(1, n + 1),
        "ra_rad": np.radians(rng.uniform(0, span_deg, n)),
        "dec_rad": np.radians(rng.uniform(-span_deg / 2, span_deg / 2, n)),
        "pm_ra_rad_yr": zero,
        "pm_dec_rad_yr": zero,
        "parallax_rad": zero,
        "radial_velocity_km_s": zero,
        "v_mag": rng.uniform(1, 6, n),
        "b_v": zero,
        "spectral_type": np.full(n, ""),
        "star_name": np.full(n, ""),
    }
    return StarCatalog("synthetic", 2000.0, **{**table, **columns})


def test_pair_list_is_that_of_brute_force_small_and_large():
    directions = sky(700).directions(2000.0)
    for count in (60, 700):  # the two ways of making it
        index = np.arange(count) * (700 // count)
        low, high = math.radians(0.5), math.radians(4.0)
        pairs = PairList.of(directions, index, high, low)
        angle = np.arccos(np.clip(directions[index] @ directions[index].T, -1, 1))
        i, j = np.nonzero(np.triu((angle >= low) & (angle <= high), 1))
        expected = {(int(index[a]), int(index[b])) for a, b in zip(i, j, strict=True)}
        found = {(min(a, b), max(a, b)) for a, b in zip(pairs.first.tolist(), pairs.second.tolist(), strict=True)}
        assert found == expected
        assert len(pairs) == len(expected)
        assert np.all(np.diff(pairs.separation_rad) >= 0)
        # arccos of a cosine near one loses half the digits: 1e-8 rad at 0.5°
        np.testing.assert_allclose(pairs.separation_rad, np.sort(angle[i, j]), rtol=1.2e-7)  # float32


def test_pairs_of_zones_are_those_of_one_list(monkeypatch):
    rng = np.random.default_rng(8)
    directions = rng.normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    index = rng.permutation(3000)[:2500]
    index.sort()
    for high_deg, low_deg in ((3.0, 0.3), (70.0, 0.0)):  # zones wider and narrower than a pair
        high, low = math.radians(high_deg), math.radians(low_deg)
        whole = PairList.of(directions, index, high, low)
        monkeypatch.setattr(guide_stars, "_ZONE_STARS", 400)
        zoned = PairList.of(directions, index, high, low)
        monkeypatch.undo()
        np.testing.assert_array_equal(zoned.separation_rad, whole.separation_rad)
        pairs = [set(zip(one.first.tolist(), one.second.tolist(), strict=True)) for one in (zoned, whole)]
        assert pairs[0] == pairs[1]
        assert len(pairs[0]) == len(whole)


def test_deep_catalogues_have_fewer_pattern_stars(monkeypatch):
    rng = np.random.default_rng(9)
    places = {"ra_rad": rng.uniform(0, 2 * np.pi, 6000), "dec_rad": np.arcsin(rng.uniform(-1, 1, 6000))}
    catalog, camera = sky(6000, **places), Camera.from_fov(fov_deg=12.0, width=256, height=256)
    whole = GuideDatabase.build(catalog, camera, 6.0)
    count = len(whole.pairs)
    assert count == pytest.approx(expected_pairs(int(whole.pattern.sum()), whole.half_diagonal_rad), rel=0.05)
    monkeypatch.setattr(guide_stars, "MOST_PAIRS", count / 3.0)
    guide_stars._build.cache_clear()
    fewer = GuideDatabase.build(catalog, camera, 6.0)
    guide_stars._build.cache_clear()
    # the same guide stars, of which the brightest everywhere are in patterns
    np.testing.assert_array_equal(fewer.catalog.id, whole.catalog.id)
    # a batch of `brightest_everywhere` has an eighth of the stars before it, and so many may be too many
    assert 0.8 < len(fewer.pairs) / (count / 3.0) < 1.125**2
    assert fewer.v_mag[fewer.pattern].mean() < whole.v_mag[whole.pattern].mean()
    for _ in range(50):
        near = fewer.in_cone(directions_of(rng), whole.half_diagonal_rad)
        assert fewer.pattern[near].sum() >= min(6, whole.pattern[near].sum())


def directions_of(rng):
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def test_close_pairs_marks_whom_a_neighbour_pulls():
    directions = radec_to_direction(np.radians([10.0, 10.05, 50.0, 50.05, 90.0]), np.zeros(5))
    magnitude = np.array([3.0, 3.5, 3.0, 5.0, 1.0])
    marked = close_pairs(directions, magnitude, math.radians(0.08), 0.77)
    # the first two pull each other; of the next two only the faint one is pulled; the last is alone
    assert marked.tolist() == [True, True, False, True, False]
    assert not close_pairs(directions, magnitude, math.radians(0.04), 0.77).any()


def test_brightest_everywhere_thins_the_rich_part_and_keeps_the_poor():
    rng = np.random.default_rng(1)
    rich = radec_to_direction(np.radians(rng.uniform(0, 5, 300)), np.radians(rng.uniform(0, 5, 300)))
    poor = radec_to_direction(np.radians(rng.uniform(100, 110, 8)), np.radians(rng.uniform(0, 10, 8)))
    directions = np.concatenate([rich, poor])[rng.permutation(308)]
    chosen = brightest_everywhere(directions, math.radians(3.0), 10)
    is_poor = directions[:, 0] < 0
    assert chosen[is_poor].all()
    inside = directions @ directions.T > math.cos(math.radians(3.0))
    assert (inside[:, chosen].sum(axis=1) <= 60).all()
    assert chosen[~is_poor].sum() < 100
    assert chosen[0]


def test_unresolved_doubles_are_one_guide_star():
    camera = Camera.from_fov(10.0, 512, 512)  # 2 pixels are 0.039°
    plain = sky(50)
    ra = plain.ra_rad.copy()
    dec = plain.dec_rad.copy()
    ra[1], dec[1] = ra[0] + math.radians(0.02), dec[0]
    v = plain.v_mag.copy()
    v[0], v[1] = 4.0, 4.0
    guide = GuideDatabase.build(sky(50, ra_rad=ra, dec_rad=dec, v_mag=v), camera, 6.0)
    assert not {1, 2} <= set(guide.catalog.id.tolist())
    merged = np.flatnonzero(np.isin(guide.catalog.id, [1, 2]))[0]
    assert guide.v_mag[merged] == pytest.approx(4.0 - 2.5 * math.log10(2.0))


def test_two_faint_stars_that_are_bright_together_enter():
    camera = Camera.from_fov(10.0, 512, 512)
    plain = sky(50)
    ra, dec, v = plain.ra_rad.copy(), plain.dec_rad.copy(), plain.v_mag.copy()
    ra[1], dec[1] = ra[0] + math.radians(0.01), dec[0]
    v[0] = v[1] = 6.5
    guide = GuideDatabase.build(sky(50, ra_rad=ra, dec_rad=dec, v_mag=v), camera, 6.0)
    assert np.isin(guide.catalog.id, [1, 2]).sum() == 1


def test_in_field_is_that_of_projecting_every_star():
    camera = Camera(900.0, 900.0, 255.5, 200.0, 512, 420, Distortion(k1=-0.2))
    guide = GuideDatabase.build(load_catalog("hipparcos"), camera, 6.0)
    rng = np.random.default_rng(5)
    for _ in range(5):
        matrix = Attitude(rng.normal(size=4)).as_matrix()
        index, vectors, xy = guide.in_field(matrix)
        everyone = guide.directions @ matrix.T
        ahead = everyone[:, 2] > math.cos(guide.half_diagonal_rad)
        places = camera.project(everyone)
        expected = np.flatnonzero(ahead & camera.contains(places))
        assert index.tolist() == expected.tolist()
        np.testing.assert_allclose(xy, places[expected], atol=1e-9)
        np.testing.assert_allclose(vectors, everyone[expected], atol=1e-12)


def test_solid_angle_of_a_pinhole_is_the_closed_form():
    camera = Camera.from_fov(40.0, 600, 300)
    a, b = 300 / camera.fx, 150 / camera.fy
    # solid angle of a rectangle seen from the axis through its centre (Khadjavi 1968)
    exact = 4.0 * math.atan(a * b / math.sqrt(1 + a * a + b * b))
    half_diagonal, solid_angle = field_of(camera)
    assert solid_angle == pytest.approx(exact, rel=1e-3)
    assert half_diagonal == pytest.approx(math.atan(math.hypot(a, b)), rel=1e-12)


def test_seen_by_moves_and_aberrates_the_stars():
    guide = GuideDatabase.build(load_catalog("hipparcos"), Camera.from_fov(10.0, 512, 512), 6.0)
    velocity = np.array([20.0, -15.0, 5.0])
    seen = guide.apparent_to(Observer(2026.2, velocity))
    np.testing.assert_allclose(seen.directions, aberrate(guide.catalog.directions(2026.2), velocity), atol=1e-15)
    assert guide.apparent_to(None) is guide
    assert seen.pairs is seen.apparent_to(Observer(2026.3)).pairs  # half a decade shares one list
    assert seen.pairs is not guide.pairs


def test_a_repeated_request_costs_nothing_and_too_few_stars_are_refused():
    camera = Camera.from_fov(10.0, 512, 512)
    catalog = load_catalog("hipparcos")
    assert GuideDatabase.build(catalog, camera, 6.0) is GuideDatabase.build(catalog, camera, 6.0)
    with pytest.raises(InputError, match=r"magnitude limit -3.*fainter"):
        GuideDatabase.build(catalog, camera, -3.0)


def test_brightest_keeps_the_first_and_their_numbers():
    guide = GuideDatabase.build(load_catalog("hipparcos"), Camera.from_fov(20.0, 512, 512), 5.0)
    part = guide.brightest(200)
    assert len(part) == 200
    matrix = Attitude.from_radec_roll(80.0, 0.0, 10.0).as_matrix()
    whole, _, _ = guide.in_field(matrix)
    index, _, _ = part.in_field(matrix)
    assert index.tolist() == whole[whole < 200].tolist()
    assert part.brightest(10_000) is part
