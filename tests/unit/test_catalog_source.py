"""Results say from which files, of how many stars and to which depth their catalogue is."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

from simulator.cli.solve_output import as_dict, as_text
from simulator.study.pages.parts import provenance
from startracker import Attitude, Camera, StarTracker, TrackingSession, load_catalog
from startracker.catalog.source import CatalogSource, SourceFile, depth_of

NO_PIXELS = np.empty((0, 2))
SOURCE = CatalogSource("mine", 3, 2016.0, 9.75, (SourceFile.of(b"stars", "stars.csv"),), "no motions")


@pytest.fixture(scope="module")
def tracker():
    return StarTracker(Camera.from_fov(fov_deg=10.0, width=512, height=512))


@pytest.fixture(scope="module")
def field(tracker):
    index, _, xy = tracker.guide.in_field(Attitude.from_radec_roll(83.0, 0.0).as_matrix())
    return xy, 10.0 ** (-0.4 * tracker.guide.v_mag[index])


def test_a_source_is_plain_values_and_back():
    assert SOURCE.files[0].sha256 == hashlib.sha256(b"stars").hexdigest()
    assert CatalogSource.from_dict(json.loads(SOURCE.as_json())) == SOURCE
    empty = CatalogSource("none", 0, 2000.0, float("nan"))
    assert json.loads(empty.as_json())["depth_v"] is None
    assert np.isnan(CatalogSource.from_dict(json.loads(empty.as_json())).depth_v)
    assert str(empty) == "catalogue none: 0 stars, epoch J2000"
    digest = SOURCE.files[0].sha256[:12]
    assert str(SOURCE) == (
        f"catalogue mine: 3 stars, epoch J2016, most at V = 9.75, stars.csv (SHA-256 {digest}…); no motions"
    )


@pytest.mark.parametrize(
    ("v_mag", "depth"),
    [([], np.nan), ([np.nan], np.nan), ([8.9], 8.75), ([1.0, 9.1, 9.2, 9.6], 9.25), ([-0.1, -0.2, 3.0], -0.25)],
)
def test_the_depth_is_where_most_stars_are(v_mag, depth):
    assert depth_of(np.array(v_mag)) == pytest.approx(depth, nan_ok=True)


def test_every_answer_names_its_catalogue(tracker, field):
    source = load_catalog("hipparcos").provenance
    assert source.stars == len(load_catalog("hipparcos"))
    assert [file.name.rpartition(" ")[2] for file in source.files] == ["hip2.dat", "bsc5.dat"]
    solved, unsolved = tracker.solve_centroids(*field), tracker.solve_centroids(field[0][:1])
    assert solved.solved
    assert not unsolved.solved
    for solution in (solved, unsolved, tracker.solve(np.zeros((512, 512)))):
        assert solution.catalog == source
        assert as_dict(solution, NO_PIXELS, None)["catalog"] == source.as_dict()
    assert str(source) in as_text(solved, NO_PIXELS, None, explain=True)


def test_tracked_frames_name_it_too(tracker, field):
    session = TrackingSession(tracker)
    xy, flux = field
    noise = np.random.default_rng(3).normal(0.0, 0.02, (3, *xy.shape))
    tracked = [session.update_centroids(xy + noise[second], flux, float(second)) for second in range(3)]
    assert tracked[-1].reason.startswith("tracked")
    stale = session.update_centroids(xy, flux, 1.0)
    assert not stale.solved
    assert {solution.catalog for solution in (*tracked, stale)} == {load_catalog("hipparcos").provenance}


def test_a_selection_keeps_the_source_and_a_table_in_memory_has_one():
    catalog = load_catalog("hipparcos")
    assert catalog.brighter_than(5.0).provenance == catalog.provenance
    own = replace(catalog.brighter_than(5.0), name="own", source=None)
    assert own.provenance == CatalogSource("own", len(own), 1991.25, 4.75)
    tracker = StarTracker(Camera.from_fov(fov_deg=20.0, width=512, height=512), own, 5.0)
    assert tracker.solve_centroids(np.array([[1.0, 2.0]])).catalog == own.provenance


def test_pages_name_the_stars_of_sky_and_tracker():
    results = {"name": "a", "seed": 1, "version": "2", "catalogs": {"sky": SOURCE.as_dict()}}
    digest = SOURCE.files[0].sha256[:12]
    assert f"stars of the sky: mine (3 stars, digests {digest}" in provenance(results, "0" * 64)
