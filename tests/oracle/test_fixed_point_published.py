"""Yee 1999, chapter 3 and section 4.2.4: tables and figures of the integer build.

Printed to the last bit: Table 3.2 truncated (29 of 30; the thirtieth, 784, is 785.0005 in exact arithmetic from the
coordinates as printed), Table 4.17 eight of ten, the rest one unit (the format of the scale factors is not printed),
the crossover of Fig. 3.1 at 11.65° and its greatest error of 0.02°.
"""

import itertools
import math

import numpy as np
import pytest

from simulator.theses.yee1999.fixed_point.arithmetic import FixedArithmetic
from simulator.theses.yee1999.fixed_point.cordic import fine_angles
from simulator.theses.yee1999.fixed_point.formats import CENTROID, COSINE, SEPARATION, FixedPointOverflow
from simulator.theses.yee1999.fixed_point.square_root import (
    CROSSOVER,
    by_pythagoras,
    by_tables,
    separation,
    square_root,
)
from simulator.theses.yee1999.fixed_point.tables import arccosine_table, cosine_table, enclosed_table, quadrant_table
from startracker.identification.arithmetic import FloatArithmetic

HR = [21, 168, 264, 403, 542]
RA_H = np.array([0.152944, 0.675111, 0.945111, 1.430250, 1.906556])
DEC_DEG = np.array([59.14972, 56.53750, 60.71667, 60.23528, 63.67028])
TABLE_3_2 = """
3107 5101 3323, 2774 6911 1852, 3823 6342 1385, 333 10622 566, 716 10212 600,
1049 8275 2215, 1810 7299 2419, 1241 9503 784, 568 10127 830, 2204 7708 1615"""
TABLE_4_14 = [
    [16.13144, 74.39691],
    [-162.81865, 95.40933],
    [-73.08759, 69.96350],
    [-15.73050, 143.07092],
    [79.27619, -113.87619],
]
FIXED_4_14 = [
    [16.13140, 74.39689],
    [-162.81863, 95.40930],
    [-73.08756, 69.96348],
    [-15.73047, 143.07091],
    [79.27616, -113.87616],
]
TABLE_4_17 = [3.8027, 1.8848, 1.6309, 4.2861, 1.9717, 3.2715, 6.8281, 1.9912, 5.1152, 5.9102]
SCALE = (9.0130 / 427, 6.9049 / 319)


def test_enclosed_angles_of_cassiopeia():
    triples = np.array(list(itertools.combinations(range(5), 3))).T
    printed = np.array([row.split() for row in TABLE_3_2.split(",")], dtype=int)
    floating, fixed = FloatArithmetic(), FixedArithmetic()
    sky = floating.sky(RA_H * 15, DEC_DEG, 20.0)
    table = enclosed_table(sky.vectors, *np.triu_indices(5, 1))
    assert (table.stars.T == triples).all()
    assert table.bytes == 10 * 12
    computed = np.array(fixed.catalog_enclosed(fixed.sky(RA_H * 15, DEC_DEG, 20.0), *triples)).T
    assert (table.angles == computed).all()  # the table, and the same without one
    assert np.count_nonzero(computed != printed) == 1
    assert (computed[7, 2], printed[7, 2]) == (785, 784)


def test_separations_of_vega():
    fixed = FixedArithmetic()
    i, j = np.triu_indices(5, 1)
    computed = fixed.image_separations(fixed.image(TABLE_4_14, SCALE), i, j)
    off = computed - SEPARATION.encode(TABLE_4_17, rounded=True)
    assert off.tolist() == [0, 0, 0, 0, 0, -1, -1, 0, 0, 0]


def test_centroids_of_vega():
    # hers were summed in fixed point pixel by pixel, and lost up to 5e-5; a conversion keeps 2⁻²²
    fixed = CENTROID.decode(CENTROID.encode(TABLE_4_14))
    assert np.abs(fixed - TABLE_4_14).max() < 2.0**-22
    assert np.abs(fixed - FIXED_4_14).max() < 5e-5


def test_sizes_of_the_tables():
    assert len(cosine_table()) == 2 ** (6 + 10 - 1)
    table, discarded = arccosine_table()
    assert len(table) + discarded == COSINE.one + 1
    assert table[0] <= SEPARATION.largest < math.degrees(math.acos((discarded - 1) / COSINE.one)) * 1024 + 0.5
    assert len(quadrant_table()) == COSINE.one + 1
    assert (quadrant_table()[[0, -1]] == [90 * 64, 0]).all()


def test_crossover_of_figure_3_1():
    chi = np.arange(1, 91) * 256  # 0.25° to 22.5°
    true = np.degrees(np.arccos(np.cos(np.radians(chi / 1024)) ** 2))
    plane, table = by_pythagoras(chi, chi) / 1024 - true, by_tables(chi, chi) / 1024 - true
    last = np.flatnonzero(np.abs(plane) <= np.abs(table))[-1]
    assert true[last] == pytest.approx(11.65, abs=0.005)
    assert CROSSOVER == int(11.65 * 1024)
    assert np.abs(separation(chi, chi) / 1024 - true).max() == pytest.approx(0.02, abs=5e-4)
    assert true[-1] == pytest.approx(31.40, abs=0.005)  # printed: "approximately 30°"


def test_separations_beyond_32_degrees_overflow():
    with pytest.raises(FixedPointOverflow, match="separation"):
        by_tables(23 * 1024, 23 * 1024)
    with pytest.raises(FixedPointOverflow, match="separation"):
        by_pythagoras(31 * 1024, 31 * 1024)
    with pytest.raises(FixedPointOverflow):
        FixedArithmetic().sky([1.0], [1.0], 40.0)


def test_square_roots_against_exact_ones():
    rng = np.random.default_rng(3)
    numbers = np.concatenate([np.arange(2000), rng.integers(0, 1 << 62, 5000), [(1 << 62) - 1]])
    squares = rng.integers(1, 1 << 31, 2000) ** 2
    numbers = np.concatenate([numbers, squares, squares - 1])
    assert square_root(numbers).tolist() == [math.isqrt(int(n)) for n in numbers]
    with pytest.raises(ValueError, match="62"):
        square_root(-1)


def test_arctangents_against_floating_point():
    rng = np.random.default_rng(4)
    y, x = rng.integers(-(1 << 36), 1 << 36, (2, 5000))
    y[:1000] >>= 30
    x[500:1500] >>= 30
    fine = fine_angles(y, x) / 2.0**40
    expected = np.degrees(np.arctan2(y.astype(float), x.astype(float)))
    off = (fine - expected + 180.0) % 360.0 - 180.0
    off[(x == 0) & (y == 0)] = 0.0
    # the last of 40 rotations is by 57.3° × 2⁻³⁹, and each of them is rounded by 2⁻⁴¹ at most
    assert np.abs(off).max() < 57.3 * 2.0**-39 + 40 * 2.0**-41
    axes = [(0, 1), (1, 0), (0, -1), (-1, 0), (0, 0)]
    rounded = np.rint(fine_angles(*np.transpose(axes)) / 2.0**18) % (360 << 22)  # to 10.22
    assert (rounded / 2.0**22).tolist() == [0.0, 90.0, 180.0, 270.0, 0.0]
