"""The speed benchmarks: their skies, and what their page makes of timings."""

import numpy as np
import pytest

from benchmarks.report import OK, SHORT
from benchmarks.speed.page import tables
from benchmarks.speed.workload import even_scenario, even_sky, field_sr, renderer, scene
from startracker.catalog import CATALOGS


@pytest.fixture(autouse=True)
def _no_sky_is_left_behind():
    before = dict(CATALOGS)
    yield
    CATALOGS.clear()
    CATALOGS.update(before)


def timing(name, seconds, group=None, **extra):
    return {"name": f"test_{name}", "stats": {"data": seconds}, "extra_info": extra, "group": group}


def test_an_even_sky_has_the_stars_asked_for_and_none_is_faint():
    sky = even_sky(100)
    assert len(sky) == round(100 * 4 * np.pi / field_sr())
    assert sky.v_mag.min() >= 2.0
    assert sky.v_mag.max() <= 6.0
    # ten times as many between 4 and 6 as between 2 and 4
    bright = np.count_nonzero(sky.v_mag < 4.0) / len(sky)
    assert abs(bright - 1 / 11) < 5 * np.sqrt(1 / 11 / len(sky))


def test_a_field_holds_that_many_whatever_the_size():
    fields = []
    for size in (512, 1024):
        made = renderer(even_scenario(size, 40))
        camera = made.focal_plane.camera
        counts = [np.count_nonzero(camera.contains(made.expose(scene(made, k)).sources.xy)) for k in range(12)]
        fields.append(counts)
    assert fields[0] == fields[1]
    # mean of 12 Poisson counts of 40: 5 sigma is 9
    assert abs(np.mean(fields[0]) - 40) < 9


def test_targets_are_judged_by_the_median_and_the_percentile():
    rounds = [2e-4] * 98 + [4e-3] * 2
    found = tables([timing("identification", rounds), timing("tracking", [2e-4])], {"help_s": 0.2, "two_cores": 1.5})
    assert [title for title, _, _ in found] == ["Targets"]
    verdicts = {row[0]: row[2:] for row in found[0][2]}
    assert verdicts["identification, lost in space, 10°, V ≤ 6: median"] == ["0.2 ms", OK]
    assert verdicts["its 99th percentile"] == ["4 ms", SHORT]
    assert verdicts["tracking update from centroids"] == ["0.2 ms", SHORT]
    assert verdicts["`boresight --help`"] == ["0.2 s", OK]
    assert verdicts["two processes against one, by the clock"] == ["1.5 ×", SHORT]


def test_growth_and_ratios_stand_in_tables_of_their_own():
    found = tables(
        [
            timing("render[10-512]", [1e-3, 1.2e-3, 1.1e-3]),
            timing("scene[1000]", [5e-4]),
            timing("draw_boresight", [4e-3], "draw"),
            timing("draw_galsim", [0.1], "draw"),
        ],
        {},
    )
    targets, growth, peers = found
    assert targets[2] == [["the same against GalSim, same stars and noise", "≥ 25 ×", "25 ×", OK]]
    assert growth[2][0][3] == "0.5"
    assert growth[2][1][1] == "1.1"
    assert peers[2] == [["draw", "boresight", "4", "1"], ["draw", "galsim", "100", "25"]]
