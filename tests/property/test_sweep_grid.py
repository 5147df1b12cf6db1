"""Values of sweeps: ranges, lists, grids and Latin hypercubes, for any that a user may write."""

import contextlib
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.checks import NAME_CHECKS
from simulator.scenario import ScenarioError
from simulator.scenario.document import Table
from simulator.scenario.errors import Location
from simulator.scenario.grid import grid, latin_hypercube, overrides, parse_swept_keys
from simulator.scenario.overrides import apply_overrides
from startracker.errors import InputError

positive = st.floats(1e-6, 1e6)


def one(text):
    (axis,) = parse_swept_keys([text], NAME_CHECKS)
    return axis


@given(positive, positive, st.integers(2, 40))
def test_range_has_exact_ends_and_even_steps(a, b, count):
    low, high = sorted((a, b))
    if high < low * (1 + 1e-6):
        return
    values = one(f"optics.aperture_mm={low!r}:{high!r}:{count}").values
    assert (values[0], values[-1], len(values)) == (low, high, count)
    # values between are kept to 12 digits
    assert np.diff(values) == pytest.approx((high - low) / (count - 1), rel=1e-3, abs=3e-12 * high)


@given(positive, positive, st.integers(2, 40))
def test_logarithmic_range_has_even_ratios(a, b, count):
    low, high = sorted((a, b))
    if high < 1.01 * low:
        return
    values = one(f"detector.exposure_s={low!r}:{high!r}:{count},log").values
    assert (values[0], values[-1], len(values)) == (low, high, count)
    assert np.diff(np.log(values)) == pytest.approx(math.log(high / low) / (count - 1), rel=1e-6, abs=1e-10)


@given(st.lists(st.floats(-200, 200), min_size=1, max_size=8, unique=True))
def test_list_is_read_as_it_stands(values):
    assert list(one("detector.temperature_c=" + ",".join(map(repr, values))).values) == values


@settings(deadline=None)  # the first example imports what all share
@given(st.integers(1, 4), st.integers(1, 4), st.integers(1, 3))
def test_grid_is_the_product_with_the_last_key_fastest(n, m, k):
    lists = [
        [10.0 * i + 10 for i in range(n)],
        [float(-i) for i in range(m)],
        ["moment", "least_squares", "maximum_likelihood"][:k],
    ]
    keys = ["optics.aperture_mm", "detector.temperature_c", "tracker.centroider"]
    swept = parse_swept_keys(
        [f"{key}={','.join(map(str, v))}" for key, v in zip(keys, lists, strict=False)], NAME_CHECKS
    )
    assert grid(swept) == list(itertools.product(*lists))


@settings(deadline=None)  # the first example imports what all share
@given(st.integers(1, 60), st.integers(0, 2**32))
def test_latin_hypercube_has_exactly_one_point_in_each_of_its_strata(count, seed):
    swept = parse_swept_keys(
        ["optics.aperture_mm=10:60", "detector.exposure_s=0.01:1,log", "tracker.centroider=moment,maximum_likelihood"]
    )
    points = latin_hypercube(swept, count, np.random.default_rng(seed))
    apertures, exposures, names = zip(*points, strict=True)
    # the definition itself (McKay, Beckman & Conover 1979): sorted, the k-th lies between the edges k and k + 1
    for values, edges in (
        (apertures, np.linspace(10, 60, count + 1)),
        (exposures, np.geomspace(0.01, 1, count + 1)),
    ):
        ordered, slack = np.sort(values), 1e-12 * np.max(edges)
        assert np.all(ordered >= edges[:-1] - slack)
        assert np.all(ordered <= edges[1:] + slack)
    assert abs(2 * names.count("moment") - count) <= 1
    assert points == latin_hypercube(swept, count, np.random.default_rng(seed))


@settings(deadline=None)  # the first example imports what all share
@given(st.integers(1, 50))
def test_latin_hypercube_of_whole_numbers_stays_whole_and_within(count):
    (axis,) = parse_swept_keys(["detector.width=256:1024"])
    values = [v for (v,) in latin_hypercube([axis], count, np.random.default_rng(1))]
    assert all(isinstance(v, int) and 256 <= v <= 1024 for v in values)


@given(
    st.one_of(
        st.tuples(st.just("optics.aperture_mm"), positive),
        st.tuples(st.just("pointing.rate_deg_s"), st.lists(st.floats(-9, 9), min_size=3, max_size=3)),
        st.tuples(st.just("detector.adc_bits"), st.one_of(st.none(), st.integers(1, 16))),
        st.tuples(st.just("sky.planets"), st.booleans()),
    )
)
def test_values_survive_the_way_through_overrides(pair):
    path, value = pair
    from simulator.scenario.output import yaml_value

    axis = one(f"{path}={yaml_value(value)}")
    problems = []
    tree = apply_overrides(Table(Location("")), overrides([axis], [axis.values[0]]), problems)
    section, key = path.split(".")
    assert not problems
    assert tree.plain()[section][key] == value


@given(st.text(max_size=30))
def test_nonsense_is_an_error_of_ours_or_a_value(text):
    for written in (text, f"optics.aperture_mm={text}"):
        with contextlib.suppress(InputError):
            assert parse_swept_keys([written], NAME_CHECKS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("optics.aperture_m=10,20", "did you mean 'optics.aperture_mm'?"),
        ("aperture_mm=10,20", "it belongs to section 'optics'"),
        ("optics=1,2", "is a section"),
        ("tracker.centroider=momant", "did you mean 'moment'?"),
        ("optics.aperture_mm=-5:20:3", "must be a number above 0"),
        ("optics.aperture_mm=20:10:3", "must be greater than its start"),
        ("optics.aperture_mm=10:20:1", "2 values or more"),
        ("optics.aperture_mm=10:20:3,lgo", "not a spacing"),
        ("sky.magnitude_limit=0:6:3,log", "above 0"),
        ("detector.width=16:18:5", "different integers"),
        ("detector.temperature_c=1,1", "given twice"),
        ("study.trials=10,20", "--trials"),
        ("optics.aperture_mm", "must look like"),
    ],
)
def test_mistakes_are_told_in_one_line(text, words):
    with pytest.raises(ScenarioError) as caught:
        parse_swept_keys([text], NAME_CHECKS)
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert str(caught.value).startswith("--over ")


def test_mistakes_are_told_all_at_once():
    with pytest.raises(ScenarioError) as caught:
        parse_swept_keys(
            ["optics.aperture_m=1,2", "tracker.centroider=momant", "optics.aperture_mm=9:1:2"], NAME_CHECKS
        )
    assert len(caught.value.problems) == 3


def test_a_range_without_count_makes_no_grid():
    with pytest.raises(InputError, match="low:high:count"):
        grid(parse_swept_keys(["optics.aperture_mm=10:60"]))
