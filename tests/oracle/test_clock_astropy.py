"""Clock against astropy.time (8.0, on ERFA's routines but with its own bookkeeping) and the published leap seconds.

Tolerance of TT: 20 ns. The second part of the Julian date reaches 800 days here, rounded to 1e-13 days = 10 ns.
"""

import pickle
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
from astropy.time import Time, TimeDelta

from simulator.mission.clock import Clock
from startracker.errors import InputError

EPOCHS = [
    datetime(2026, 3, 21, 12, tzinfo=UTC),
    datetime(2016, 12, 31, 23, 59, 50, 250_000, tzinfo=UTC),
    datetime(1992, 6, 30, 23, 59, 59, 999_000, tzinfo=UTC),
    datetime(1972, 1, 1, tzinfo=UTC),
]
ELAPSED_S = [0.0, 0.4567, 9.75, 10.25, 11.0, 86_400.0, -3_600.5, 31_556_925.5, 7e7, -7e7]


# before 1972 the seconds of UTC were no SI seconds
CASES = [(epoch, t_s) for epoch in EPOCHS for t_s in ELAPSED_S if epoch.year > 1972 or t_s >= 0]


@pytest.mark.parametrize(("epoch", "t_s"), CASES)
def test_agrees_with_astropy(epoch, t_s):
    expected = Time(epoch.replace(tzinfo=None), scale="utc") + TimeDelta(t_s, format="sec", scale="tai")
    clock = Clock(epoch)
    jd1, jd2 = clock.tt_jd(t_s)
    assert abs(((jd1 - expected.tt.jd1) + (jd2 - expected.tt.jd2)) * 86_400.0) < 20e-9
    assert clock.isot(t_s) == expected.utc.isot
    assert clock.jyear(t_s) == pytest.approx(expected.tt.jyear, abs=1e-12)


@pytest.mark.parametrize("scale", ["utc", "tai", "tdb"])
@pytest.mark.parametrize("epoch", EPOCHS[:2])
def test_seconds_of_an_astropy_time(epoch, scale):
    """A time has two parts of its Julian date, divided in any way."""
    clock, start = Clock(epoch), Time(epoch.replace(tzinfo=None), scale="utc")
    for t_s in (0.0, 0.25, 40_000.0, -40_000.0, 3e6):
        time = getattr(start + TimeDelta(t_s, format="sec", scale="tai"), scale)
        assert clock.elapsed_s(time) == pytest.approx(t_s, abs=1e-6)
    uneven = Time(2_461_120.0, 5.3125, format="jd", scale="tt")
    jd1, jd2 = clock.tt_jd(0.0)
    expected = ((2_461_120.0 - jd1) + (5.3125 - jd2)) * 86_400.0
    assert clock.elapsed_s(uneven) == pytest.approx(expected, abs=1e-5)
    assert clock.elapsed_s(12.5) == 12.5


@pytest.mark.filterwarnings("ignore:.*dubious year")  # after the table of leap seconds, as both take it
@pytest.mark.parametrize("epoch", EPOCHS[:3])
def test_labels_are_those_of_astropy_at_any_time(epoch):
    """Over decades, at every ten milliseconds about leap seconds, and where rounding carries to another day."""
    clock, rng = Clock(epoch), np.random.default_rng(1)
    year_s, step_s = 31_557_600.0, 0.01
    times = np.concatenate(
        [
            rng.uniform(-20.0, 27.0, 3000) * year_s,
            np.arange(-600, 600) * step_s,
            (datetime(1999, 1, 1, tzinfo=UTC) - epoch).total_seconds() + np.arange(-600, 600) * step_s,
            (datetime(2030, 3, 1, tzinfo=UTC) - epoch).total_seconds() + np.arange(-40_000, -20_000) * 1e-3 + 1e-4,
        ]
    )
    days = np.array([clock.tt_jd(t) for t in times])
    assert [clock.isot(t) for t in times] == Time(*days.T, format="jd", scale="tt").utc.isot.tolist()


def test_leap_second_of_2016_is_lived_through():
    # IERS Bulletin C 52: 2016-12-31T23:59:60 UTC; TAI − UTC went from 36 s to 37 s
    clock = Clock(datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC))
    assert [clock.isot(t) for t in (0.0, 1.0, 1.9994, 2.0)] == [
        "2016-12-31T23:59:59.000",
        "2016-12-31T23:59:60.000",
        "2016-12-31T23:59:60.999",
        "2017-01-01T00:00:00.000",
    ]


def test_j2000_is_where_it_is_defined():
    # J2000.0 = 2000-01-01T12:00:00 TT = 11:58:55.816 UTC (TT − TAI = 32.184 s, TAI − UTC = 32 s)
    clock = Clock(datetime(2000, 1, 1, 11, 58, 55, 816_000, tzinfo=UTC))
    assert clock.jyear(0.0) == pytest.approx(2000.0, abs=1e-15 * 2000)
    assert clock.jyear(365.25 * 86_400) == pytest.approx(2001.0, abs=1e-12)


def test_arrays_give_what_single_instants_give():
    clock, times = Clock(EPOCHS[0]), np.array([[0.0, 1.5], [1e6, -1e6]])
    jd1, jd2 = clock.tt_jd(times)
    assert jd2.shape == times.shape
    for index in np.ndindex(2, 2):
        assert (jd1, jd2[index]) == clock.tt_jd(float(times[index]))
        assert clock.jyear(times)[index] == clock.jyear(float(times[index]))


def test_any_zone_is_the_same_instant_and_pickles():
    local = datetime(2026, 3, 21, 14, tzinfo=timezone(timedelta(hours=2)))
    assert Clock(local) == Clock(EPOCHS[0])
    assert Clock(local).isot(0.0) == "2026-03-21T12:00:00.000"
    copy = pickle.loads(pickle.dumps(Clock(local)))
    assert copy == Clock(local)
    assert copy.tt_jd(3.0) == Clock(local).tt_jd(3.0)


def test_far_future_keeps_the_last_leap_second_and_does_not_warn():
    clock = Clock(datetime(2099, 1, 1, tzinfo=UTC))  # warnings are errors here
    assert clock.isot(0.0) == "2099-01-01T00:00:00.000"


@pytest.mark.parametrize(
    ("epoch", "message"),
    [(datetime(2026, 3, 21), "time zone"), (datetime(1959, 12, 31, tzinfo=UTC), "1960")],
)
def test_epochs_that_cannot_be_used(epoch, message):
    with pytest.raises(InputError, match=message):
        Clock(epoch)
