"""Unknown focal length over random cameras: solved or not, never wrong.

Real stars through cameras drawn at random: 3° to 65°, mirrored or not, barrel to pincushion as far as it is one to one,
0.5 px noise, 20 % of the stars missing, 10 to 30 % false ones, 8 to 60 stars.
"""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from startracker import Attitude, Camera, solve_unknown_fov
from startracker.catalog import load_catalog
from startracker.geometry.distortion import Distortion

WIDTH, HEIGHT = 1280, 960


@functools.cache
def sky():
    table = load_catalog("hipparcos").brighter_than(9.5)
    return table, table.directions(table.epoch_jyear)


def scene(rng, fov_deg, stars):
    table, directions = sky()
    base = replace(Camera.from_fov(fov_deg, WIDTH, HEIGHT), parity=int(rng.choice([1, -1])))
    corner2 = (base.cx / base.fx) ** 2 + (base.cy / base.fy) ** 2
    camera = replace(base, distortion=Distortion(k1=float(rng.uniform(max(-0.3, -0.1 / corner2), 0.1))))
    while True:
        attitude = Attitude(rng.normal(size=4))
        matrix = attitude.as_matrix()
        near = np.flatnonzero(directions @ matrix[2] > math.cos(1.15 * base.half_diagonal_rad))
        xy = camera.project(directions[near] @ matrix.T)
        inside = np.flatnonzero(camera.contains(xy))
        if len(inside) >= stars / 0.8:
            break
    v = table.v_mag[near[inside]] + rng.normal(0, 0.15, len(inside))
    brightest = np.argsort(v)[: round(stars / 0.8)]
    keep = brightest[np.sort(rng.permutation(len(brightest))[:stars])]
    xy, v = xy[inside][keep] + rng.normal(0, 0.5, (stars, 2)), v[keep]
    false = round(rng.uniform(0.1, 0.3) * stars)
    xy = np.concatenate([xy, rng.uniform(0, [WIDTH - 1, HEIGHT - 1], (false, 2))])
    v = np.concatenate([v, rng.choice(v, false) + rng.normal(0, 0.3, false)])
    return xy, 10.0 ** (-0.4 * v), attitude, camera


@pytest.mark.parametrize(
    ("fov_deg", "stars", "share"),
    # measured over 200: 99 to 100 %, and 91.5 % with 8 to 12 stars; less 4 √(p (1 − p) / 40) with p = 1 % and 8.5 %
    [
        ((3.0, 15.0), (20, 60), 0.93),
        pytest.param((15.0, 65.0), (20, 60), 0.92, marks=pytest.mark.slow),
        ((5.0, 60.0), (8, 12), 0.74),
    ],
)
def test_random_cameras(fov_deg, stars, share):
    solved = 0
    for seed in range(40):
        rng = np.random.default_rng([seed, stars[0], int(fov_deg[0])])
        fov = math.exp(rng.uniform(*np.log(fov_deg)))
        xy, flux, attitude, camera = scene(rng, fov, int(rng.integers(stars[0], stars[1] + 1)))
        solution = solve_unknown_fov(xy, WIDTH, HEIGHT, flux=flux)
        if solution.solved:
            solved += 1
            assert math.degrees(attitude.angle_to(solution.attitude)) < 0.01 * fov
            assert solution.parity == camera.parity
    assert solved >= share * 40


@pytest.mark.slow
def test_random_points_are_no_sky():
    for seed in range(40):
        rng = np.random.default_rng([seed, 1])
        count = int(rng.integers(8, 60))
        flux = 10.0 ** rng.uniform(0, 2, count)
        assert not solve_unknown_fov(rng.uniform(0, 959, (count, 2)), WIDTH, HEIGHT, flux=flux).solved
