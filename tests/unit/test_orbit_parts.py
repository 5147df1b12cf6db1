"""Parts of orbits and attitudes at their edges: circular and equatorial orbits, times of trials, slews that just reach
their rate, tables with optional columns."""

import math
from datetime import UTC, datetime

import numpy as np
import pytest

from simulator.mission.clock import Clock
from simulator.mission.interpolation import StateTable
from simulator.mission.kepler import Elements, eccentric_anomaly, elements_of, periapsis_km, perifocal, plane_axes
from simulator.mission.parameters import Waypoint, Waypoints
from simulator.mission.sampling import TROPICAL_YEAR_S, trial_time_s
from simulator.mission.slews import build_slews, trapezoid
from simulator.mission.spk import ChebyshevTable
from simulator.mission.tables import read_rows
from simulator.mission.trajectory import GM_KM3_S2, UNLIMITED
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude

GM = 398_600.4418
CLOCK = Clock(datetime(2026, 3, 21, tzinfo=UTC))
NO_TURN = np.array([0.0, 0.0, 0.0, 1.0])


def state_of(elements):
    """Position and velocity from Vallado's formulas."""
    flat, moving = perifocal(elements, elements.mean_anomaly_rad, GM)
    p, q, _ = plane_axes(elements.inclination_rad, elements.node_rad, elements.periapsis_rad)
    return flat[0] * p + flat[1] * q, moving[0] * p + moving[1] * q


# ---------------------------------------------------------------- elements
def test_a_circular_orbit_has_its_periapsis_at_the_node():
    """From the node a quarter of a turn on: the anomaly is the argument of latitude."""
    speed = math.sqrt(GM / 7000.0)
    tilt = np.array([0.0, math.cos(0.9), math.sin(0.9)])
    found = elements_of(7000.0 * tilt, np.array([-speed, 0.0, 0.0]), GM)
    assert found.semi_major_axis_km == pytest.approx(7000.0, rel=1e-12)
    assert found.eccentricity < 1e-14
    assert found.periapsis_rad == 0.0
    assert (found.inclination_rad, found.mean_anomaly_rad) == pytest.approx((0.9, math.pi / 2.0), abs=1e-12)


@pytest.mark.parametrize("retrograde", [False, True])
@pytest.mark.parametrize("eccentricity", [0.0, 0.2])
def test_an_equatorial_orbit_has_its_node_on_the_x_axis(retrograde, eccentricity):
    """A state at periapsis on the y axis; the angle from x is counted in the direction of motion."""
    way = -1.0 if retrograde else 1.0
    speed = math.sqrt(GM / 7000.0 * (1.0 + eccentricity))
    r, v = np.array([0.0, 7000.0, 0.0]), way * np.array([-speed, 0.0, 0.0])
    found = elements_of(r, v, GM)
    assert found.node_rad == 0.0
    assert found.inclination_rad == pytest.approx(math.pi if retrograde else 0.0, abs=1e-14)
    along = (found.periapsis_rad + found.mean_anomaly_rad) % (2.0 * math.pi)
    assert along == pytest.approx(1.5 * math.pi if retrograde else 0.5 * math.pi, abs=1e-12)
    if eccentricity:
        assert found.mean_anomaly_rad % (2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
    back = state_of(found)
    assert back[0] == pytest.approx(r, abs=1e-8)
    assert back[1] == pytest.approx(v, abs=1e-11)


@pytest.mark.parametrize("node", [0.4, 2.0, 3.5, 6.0])
@pytest.mark.parametrize("inclination", [1e-3, 1.2, 3.0])
def test_elements_return_in_every_quadrant(node, inclination):
    given = Elements(9000.0, 0.1, inclination, node, 5.1, 4.0)
    found = elements_of(*state_of(given), GM)
    assert tuple(found) == pytest.approx(tuple(given), rel=1e-10, abs=1e-9)


def test_states_that_are_no_ellipse_and_orbits_that_fall():
    escape = math.sqrt(2.0 * GM / 7000.0)
    for speed in (escape * (1.0 + 1e-12), 20.0):
        with pytest.raises(InputError, match="speed is that of escape or higher"):
            elements_of([7000.0, 0.0, 0.0], [0.0, speed, 0.0], GM)
    assert elements_of([7000.0, 0.0, 0.0], [0.0, 0.99 * escape, 0.0], GM).eccentricity < 1.0
    assert periapsis_km([7000.0, 0.0, 0.0], [-1.0, 0.0, 0.0], GM) == 0.0
    assert periapsis_km([7000.0, 0.0, 0.0], [0.0, escape, 0.0], GM) == pytest.approx(7000.0, rel=1e-12)


@pytest.mark.parametrize("eccentricity", [0.0, 0.5, 0.99, 0.999999])
def test_keplers_equation_holds_over_several_turns(eccentricity):
    mean = np.linspace(-15.0, 15.0, 301)
    found = eccentric_anomaly(mean, eccentricity)
    assert found - eccentricity * np.sin(found) == pytest.approx(mean, abs=4e-15 * 15.0)
    assert (np.diff(found) > 0.0).all()


@pytest.mark.parametrize("eccentricity", [1.0, -1e-9, math.nan])
def test_eccentricities_that_no_ellipse_has(eccentricity):
    with pytest.raises(InputError, match="an ellipse has an eccentricity from 0 to below 1"):
        eccentric_anomaly(0.1, eccentricity)


def test_gravitational_parameters_have_the_published_ratios_of_masses():
    """Sun over planet with its satellites, IAU 2009 (Luzum et al. 2011); 2e-4, as some are of the planet alone."""
    ratios = {
        "Mercury": 6_023_600.0, "Venus": 408_523.719, "Earth-Moon barycentre": 328_900.5596, "Mars": 3_098_703.59,
        "Jupiter": 1_047.348644, "Saturn": 3_497.9018, "Uranus": 22_902.98, "Neptune": 19_412.26,
    }  # fmt: skip
    for body, ratio in ratios.items():
        assert GM_KM3_S2["Sun"] / GM_KM3_S2[body] == pytest.approx(ratio, rel=2e-4), body
    assert GM_KM3_S2["Earth"] / GM_KM3_S2["Moon"] == pytest.approx(81.300_568, rel=1e-6)
    assert GM_KM3_S2["Earth-Moon barycentre"] == pytest.approx(GM_KM3_S2["Earth"] + GM_KM3_S2["Moon"], rel=1e-12)
    assert GM_KM3_S2["Sun"] / GM_KM3_S2["Pluto barycentre"] == pytest.approx(1.36566e8, rel=6e-3)


# ---------------------------------------------------------------- interpolation
@pytest.mark.parametrize("nodes", [2, 3, 4, 5])
def test_nodes_of_a_polynomial_are_the_nearest(nodes):
    """A bump at one node changes the values of just those instants whose polynomial passes through it: an even number
    is half before and half after the instant, an odd number about the nearest node; at the ends the first and last."""
    t_s, at = np.arange(10.0), np.linspace(0.0, 9.0, 1801)[1:-1:2]  # halves of a step are not among them
    for node in (0, 4, 9):
        states = np.zeros((10, 1))
        states[node] = 1.0
        found = StateTable(t_s, states, "lagrange", nodes).state(at)[:, 0] != 0.0
        first = np.floor(at) - nodes // 2 + 1 if nodes % 2 == 0 else np.rint(at) - nodes // 2
        first = np.clip(first, 0, 10 - nodes)
        apart = np.abs(at - np.rint(at)) > 1e-9  # at another node the bump has no weight
        expected = (first <= node) & (node < first + nodes)
        assert np.array_equal(found[apart], expected[apart])


@pytest.mark.parametrize("states", [False, True])
def test_chebyshev_tables_hold_at_the_ends_of_their_intervals(states):
    """A cubic in each of three intervals of 10 s from 5 s on, and its derivative; the last instant is of the last."""
    curve = np.polynomial.Polynomial([1.0, -2.0, 0.03, 0.002])
    coefficients = []
    for k in range(3):
        within = curve(np.polynomial.Polynomial([5.0 + 10.0 * k + 5.0, 5.0]))  # of a variable from −1 to 1
        along = np.polynomial.chebyshev.poly2cheb(within.coef)
        slope = np.polynomial.chebyshev.chebder(along) / 5.0
        parts = [along, 2.0 * along, 3.0 * along]
        if states:
            parts += [np.append(factor * slope, 0.0) for factor in (1.0, 2.0, 3.0)]
        coefficients.append(np.stack(parts, axis=1))
    table = ChebyshevTable(5.0, 10.0, np.stack(coefficients, axis=1))
    at = np.array([5.0, 7.3, 15.0, 24.999, 25.0, 34.0, 35.0])
    found = table.state(at)
    expected = np.concatenate([np.outer(part(at), [1.0, 2.0, 3.0]) for part in (curve, curve.deriv())], axis=1)
    assert found == pytest.approx(expected, rel=1e-12)


# ---------------------------------------------------------------- times
@pytest.mark.parametrize(
    ("sampling", "span_s", "first", "length"),
    [
        ("mission_year", (0.0, math.inf), 0.0, 365.2422 * 86_400.0),
        ("orbit", (0.0, math.inf), 0.0, 6000.0),
        ("span", (-500.0, 900.0), 0.0, 900.0),
        ("span", (100.0, 900.0), 100.0, 800.0),
        ("orbit", (100.0, 900.0), 0.0, 6000.0),
    ],
)
def test_trials_divide_their_time_evenly(sampling, span_s, first, length):
    """By the golden ratio: consecutive trials are 0.618 of the length apart, and the gaps between the first n have at
    most three sizes (Steinhaus), the largest below 2/n."""
    t_s = trial_time_s(sampling, 5, np.arange(55), 6000.0, span_s)
    assert t_s.min() >= first
    assert t_s.max() < first + length
    steps = np.diff(t_s) / length % 1.0
    assert steps == pytest.approx(np.full(54, (math.sqrt(5.0) - 1.0) / 2.0), abs=1e-12)
    gaps = np.diff(np.sort(t_s), append=t_s.min() + length) / length
    assert gaps.max() < 2.0 / 55.0
    assert float(trial_time_s(sampling, 5, np.array(7), 6000.0, span_s)) == t_s[7]
    assert not np.allclose(trial_time_s(sampling, 6, np.arange(55), 6000.0, span_s), t_s)


def test_random_attitudes_are_at_the_epoch():
    assert trial_time_s("sky", 5, np.arange(4), math.inf).tolist() == [0.0] * 4
    assert TROPICAL_YEAR_S == 365.2422 * 86_400.0


@pytest.mark.parametrize(
    ("sampling", "period_s", "span_s", "words"),
    [
        ("orbit", math.inf, UNLIMITED, "orbit: the trajectory is not a closed orbit"),
        ("orbit", 0.0, UNLIMITED, "orbit: the trajectory is not a closed orbit"),
        ("span", 6000.0, UNLIMITED, "span: the trajectory has no end"),
        ("span", 6000.0, (-100.0, 0.0), "span: the trajectory ends before the epoch"),
        ("span", 6000.0, (-100.0, -50.0), "span: the trajectory ends before the epoch"),
    ],
)
def test_times_that_cannot_be_divided(sampling, period_s, span_s, words):
    with pytest.raises(InputError, match=words):
        trial_time_s(sampling, 1, np.arange(3), period_s, span_s)


# ---------------------------------------------------------------- slews
def test_a_short_slew_is_a_triangle_and_a_long_one_a_trapezoid():
    """0.5°/s² up to 2°/s: 8° are reached without a steady part, 20° with 6 s of it."""
    corners, speeds = trapezoid(math.radians(2.0), 2.0, 0.5)
    assert corners == pytest.approx([0.0, 2.0, 4.0])
    assert np.degrees(speeds) == pytest.approx([0.0, 1.0, 0.0])
    corners, speeds = trapezoid(math.radians(8.0), 2.0, 0.5)
    assert corners == pytest.approx([0.0, 4.0, 8.0])
    corners, speeds = trapezoid(math.radians(20.0), 2.0, 0.5)
    assert corners == pytest.approx([0.0, 4.0, 10.0, 14.0])
    assert np.degrees(speeds) == pytest.approx([0.0, 2.0, 2.0, 0.0])
    assert [len(part) for part in trapezoid(0.0, 2.0, 0.5)] == [0, 0]


def law(*points, **keys):
    limits = {"max_rate_deg_s": 2.0, "acceleration_deg_s2": 0.5} | keys
    return build_slews(Waypoints(points=tuple(points), **limits), CLOCK, NO_TURN)


def test_the_angle_of_a_slew_is_the_area_below_its_speed():
    found = law(Waypoint(0.0, 10.0, 0.0, 0.0), Waypoint(50.0, 30.0, 0.0, 0.0))
    (leg,) = found.legs
    assert leg.start_s == pytest.approx(36.0)
    t_s = np.array([0.0, 36.0, 38.0, 40.0, 43.0, 46.0, 48.0, 50.0, 90.0])
    assert np.degrees(leg.angle_rad(t_s)) == pytest.approx([0.0, 0.0, 1.0, 4.0, 10.0, 16.0, 19.0, 20.0, 20.0], abs=1e-9)
    boresights = [Attitude(q, "icrs", "camera").ra_deg for q in found.quaternions(t_s)]
    assert boresights == pytest.approx([10.0, 10.0, 11.0, 14.0, 20.0, 26.0, 29.0, 30.0, 30.0], abs=1e-9)
    assert found.span_s == UNLIMITED


def test_a_body_rests_between_slews_and_where_nothing_changes():
    same = Waypoint(40.0, 30.0, 0.0, 0.0)
    found = law(Waypoint(20.0, 10.0, 0.0, 0.0), Waypoint(35.0, 30.0, 0.0, 0.0), same, Waypoint(80.0, 10.0, 0.0, 0.0))
    assert len(found.legs) == 2
    at = [
        Attitude(q, "icrs", "camera").ra_deg for q in found.quaternions(np.array([-5.0, 20.0, 35.0, 60.0, 80.0, 99.0]))
    ]
    assert at == pytest.approx([10.0, 10.0, 30.0, 30.0, 10.0, 10.0], abs=1e-9)


def test_a_slew_may_take_all_of_its_time_and_no_more():
    assert len(law(Waypoint(0.0, 10.0, 0.0, 0.0), Waypoint(14.001, 30.0, 0.0, 0.0)).legs) == 1
    with pytest.raises(InputError, match=r"the slew of 20° to the attitude at 13.9 s takes 14 s, and 13.9 s are left"):
        law(Waypoint(0.0, 10.0, 0.0, 0.0), Waypoint(13.9, 30.0, 0.0, 0.0))
    for at_s in (5.0, 4.0):
        with pytest.raises(InputError, match="points must be in order of time"):
            law(Waypoint(5.0, 10.0, 0.0, 0.0), Waypoint(at_s, 30.0, 0.0, 0.0))
    with pytest.raises(InputError, match="a spline needs two points or more"):
        law(Waypoint(5.0, 10.0, 0.0, 0.0), profile="spline")
    assert law(Waypoint(5.0, 10.0, 0.0, 0.0)).legs == ()


# ---------------------------------------------------------------- tables


@pytest.mark.parametrize(
    ("header", "wanted"),
    [("t_s,a,b", 2), ("t_s,a,b,p", 2), ("t_s,a,b,p,q", 4), ("q,b,p,t_s,a", 4), ("t_s,x,a,b,q", 2)],
)
def test_optional_columns_are_read_together_or_not_at_all(header, wanted, tmp_path):
    names = header.split(",")
    rows = [[10.0 * k + (1.0 if name == "t_s" else ord(name[0])) for name in names] for k in range(3)]
    path = tmp_path / "table.csv"
    text = "\n".join(["# a comment", header, "", *(",".join(map(str, row)) for row in rows), "  # another"])
    path.write_text(text + "\n")
    found = read_rows(path, CLOCK, ("a", "b"), ("p", "q"))
    assert found.t_s.tolist() == [1.0, 11.0, 21.0]
    assert found.values.shape == (3, wanted)
    assert found.values[1].tolist() == [10.0 + ord(name) for name in "abpq"[:wanted]]
    assert found.positions == [f"{path}:{number}" for number in (4, 5, 6)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r":1: columns are missing: utc or t_s, a, b"),
        ("t_s,a\n0,1\n1,2\n", r":1: columns are missing: b$"),
        ("a,b\n0,1\n1,2\n", r":1: columns are missing: utc or t_s$"),
        ("t_s,a,b\n0,1,2\n", "has fewer than two rows"),
        ("t_s,a,b\n0,1,2\n1,2\n", r":3: 2 of 3 columns; is the file truncated"),
        ("t_s,a,b\n0,1,2\n0,1,2\n", r":3: the time is not after the one before"),
        ("t_s,a,b\n0,1,2\n1,inf,2\n", r":3: a is 'inf', which is not a finite number"),
        ("t_s,a,b\n0,1,2\nx,1,2\n", r":3: t_s is 'x', which is not a finite number"),
    ],
)
def test_mistakes_of_a_table_are_named(text, words, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_rows(path, CLOCK, ("a", "b"))
