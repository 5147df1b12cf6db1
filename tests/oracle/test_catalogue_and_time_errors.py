"""Errors of the tracker's catalogue and of the time stated for a frame, against their definitions and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from simulator import Renderer, Scenario
from simulator.fits import write_fits
from simulator.sky.catalogue_errors import CatalogueErrors, with_errors
from simulator.study.sequence.run import run_sequence
from simulator.study.star_tracker import build_tracker
from simulator.study.trials.trial import TrialRunner, attitude_errors_deg
from startracker.catalog import load_catalog
from startracker.core import ARCSEC_RAD, MAS_RAD
from startracker.geometry.image_map import pixel_slopes

QUIET = ["sky.earth=false", "sky.planets=false", "pointing.error_deg=0", "study.sampling=sky"]
SMALL = ["detector.width=256", "detector.height=256"]


def perturbed(catalog, **errors):
    return with_errors(catalog, CatalogueErrors(**errors), np.random.default_rng(5))


# ---------------------------------------------------------------------- catalogue
def test_positions_and_motions_have_their_errors():
    known = load_catalog("hipparcos")
    stars = perturbed(known, position_mas=250.0, proper_motion_mas_yr=2.0)
    columns = (
        (stars.ra_rad - known.ra_rad) * np.cos(known.dec_rad) / (250.0 * MAS_RAD),
        (stars.dec_rad - known.dec_rad) / (250.0 * MAS_RAD),
        (stars.pm_ra_rad_yr - known.pm_ra_rad_yr) / (2.0 * MAS_RAD),
        (stars.pm_dec_rad_yr - known.pm_dec_rad_yr) / (2.0 * MAS_RAD),
    )
    for column in columns:
        # 118,000 deviates; chance rejects a normal distribution once in a thousand
        assert kstest(column, "norm").pvalue > 1e-3
    # correlations of N deviates have the standard deviation 1/√N; the largest of six below 4 of them
    between = np.corrcoef(columns)[np.triu_indices(4, 1)]
    assert np.abs(between).max() < 4.0 / np.sqrt(len(known))
    assert stars.position_sigma_rad == pytest.approx(np.hypot(known.position_sigma_rad, 250.0 * MAS_RAD))


def test_errors_grow_with_the_years():
    """After 35 years a motion of 2 mas/yr is 70 mas, on either axis: the angle between directions has √2 of it."""
    known = load_catalog("hipparcos").brighter_than(5.0)
    stars = perturbed(known, proper_motion_mas_yr=2.0)
    chord = np.linalg.norm(stars.directions(2026.25) - known.directions(2026.25), axis=1) / MAS_RAD
    # the mean square of N two-dimensional deviates is good to 1/√N
    assert np.mean(chord**2) == pytest.approx(2.0 * 70.0**2, rel=4.0 / np.sqrt(len(known)))
    assert np.array_equal(stars.directions(1991.25), known.directions(1991.25))


def test_the_error_of_a_star_depends_on_its_number_alone():
    known = load_catalog("hipparcos")
    rows = np.array([90_000, 17, 60_000])
    some, all_stars = (perturbed(c, position_mas=100.0) for c in (known.select(rows), known))
    np.testing.assert_array_equal(some.ra_rad, all_stars.ra_rad[rows])
    np.testing.assert_array_equal(some.dec_rad, all_stars.dec_rad[rows])
    huge = replace(known.select(rows), id=np.array([2**62, -(2**62), 5_853_498_713_190_525_696]))
    assert len(set(perturbed(huge, position_mas=100.0).ra_rad - huge.ra_rad)) == 3
    assert perturbed(known) is known


def test_an_attitude_is_turned_by_its_catalogue():
    """Exact positions of stars, equal weights: the turn of the least-squares fit to the wrong directions."""
    scenario = Scenario.load("cubesat_ideal", [*QUIET, "tracker.catalogue_errors.position_mas=3000"])
    renderer = Renderer(scenario)
    tracker = build_tracker(scenario, renderer.camera)
    wrong = {number: k for k, number in enumerate(tracker.guide.catalog.id.tolist())}
    turned, expected = [], []
    for index in range(6):
        scene = renderer.scene(index)
        sources, attitude = renderer.expose(scene).sources, scene.pointing.camera
        rows = np.flatnonzero((sources.v_mag < 5.5) & renderer.camera.contains(sources.xy, -8.0))
        known = {"sigma_px": 0.2, "observer": scene.observer, "prior": attitude, "prior_deg": 0.5}
        solution = tracker.solve_centroids(sources.image_xy[rows], sources.electrons[rows], **known)
        turned.append(attitude.rotation_vector_to(solution.attitude))
        used = solution.stars.fitted
        guide = tracker.guide.apparent_to(scene.observer).directions[[wrong[n] for n in used.catalog_id.tolist()]]
        here = attitude.apply(guide)
        slopes = pixel_slopes(here, renderer.camera.image_map)
        moved = used.xy - renderer.camera.project(here)
        normal, right = np.einsum("nji,njk->ik", slopes, slopes), np.einsum("nji,nj->i", slopes, moved)
        expected.append(np.linalg.solve(normal, right))
        assert np.std(moved) == pytest.approx(3.0 / 45.4, rel=0.5)  # 3″ of 45.4″ in a pixel
    size = np.sqrt(np.mean(np.square(expected), axis=0))
    assert (size > np.array([0.3, 0.3, 3.0]) * ARCSEC_RAD).all()
    assert (np.sqrt(np.mean((np.array(turned) - expected) ** 2, axis=0)) < 0.15 * size).all()


# ---------------------------------------------------------------------- time
def test_an_error_of_the_time_is_the_turn_during_it(tmp_path):
    """From the local level's 360° in an orbit: 0.1 s at 0.0595°/s are 21.4″ about the pitch axis. The image is the same
    to the byte."""
    late = [*SMALL, "detector.time_tag.offset_s=0.1"]
    plain, tagged = (TrialRunner(Scenario.load("cubesat_ideal", keys)) for keys in (SMALL, late))
    (frame, truth), (other, its_truth) = (runner.renderer.frame(3) for runner in (plain, tagged))
    assert frame.image.tobytes() == other.image.tobytes()
    assert truth.attitude_at_tag is truth.attitude
    assert truth.attitude.rotation_vector_to(its_truth.attitude) == pytest.approx(np.zeros(3), abs=1e-15)
    errors = [attitude_errors_deg(t.attitude_at_tag, truth.attitude, t.mounting) for t in (truth, its_truth)]
    rate_deg_s = 360.0 / plain.renderer.scenes.orbit.period_s
    # the level turns by −rate about the pitch axis, Y; the attitude of the frame is behind it
    turn = {axis: errors[1][axis] - errors[0][axis] for axis in ("roll", "pitch", "yaw")}
    assert abs(turn["pitch"]) == pytest.approx(0.1 * rate_deg_s, rel=1e-3)  # of the orbit's node: 1e-4
    assert abs(turn["roll"]) < 1e-3 * rate_deg_s
    assert abs(turn["yaw"]) < 1e-3 * rate_deg_s
    assert other.utc > frame.utc
    write_fits(tmp_path / "late.fits", other, its_truth)
    from astropy.io import fits

    assert fits.getheader(tmp_path / "late.fits", "TRUTH")["TAG_ERR"] == 0.1


def test_the_attitude_at_the_tag_is_that_of_the_motion():
    """Two frames of a spinning body: the attitude at a time stated late is that of a frame taken later."""
    scenario = Scenario.load("cubesat_ideal", [*SMALL, "pointing.spin.rate_deg_s=3", "pointing.error_deg=0"])
    late = scenario.changed({"detector.time_tag.offset_s": 0.25})
    now = Renderer(late).frame(0, at_s=0.0)[1]
    then = Renderer(scenario).frame(0, at_s=0.25)[1]
    turned = now.attitude_at_tag.rotation_vector_to(then.attitude) / ARCSEC_RAD
    assert np.linalg.norm(now.attitude.rotation_vector_to(then.attitude)) / ARCSEC_RAD > 2000.0
    assert np.abs(turned).max() < 1e-6


def test_the_time_of_each_frame_has_its_jitter():
    runner = Renderer(
        Scenario.load("cubesat_ideal", [*SMALL, "detector.time_tag.jitter_s=0.02", "sky.magnitude_limit=2"])
    )
    errors = np.array([runner.frame(k)[1].time_tag_error_s for k in range(60)])
    assert len(set(errors)) == 60
    assert runner.frame(7)[1].time_tag_error_s == errors[7]
    assert errors.std() == pytest.approx(0.02, rel=4.0 / np.sqrt(120.0))
    assert abs(errors.mean()) < 4.0 * 0.02 / np.sqrt(60.0)


def test_a_sequence_is_behind_by_its_time():
    """A constant error of 0.2 s at 0.0595°/s: the filter's attitude is 43″ from the truth at the stated time, also
    where a frame is missing and the filter predicts by its clock."""
    keys = ["sequence.frames=12", "sequence.step_s=0.5", "detector.time_tag.offset_s=0.2"]
    keys += ["sequence.dropouts=[{start_s: 4.5, duration_s: 0.4}]"]
    columns = run_sequence(Scenario.load("cubesat_ideal", keys)).columns
    rate_deg_s = 360.0 / Renderer(Scenario.load("cubesat_ideal")).scenes.orbit.period_s
    missing = columns["status"] == "no_frame"
    assert missing.sum() == 1
    # the noise about the boresight, 1.6″ rms of a frame, is less in the filter
    for rows, noise_arcsec in ((~missing, 1.6 / np.sqrt(11.0)), (missing, 1.6)):
        pitch_deg = np.abs(np.mean(columns["error_pitch_deg"][rows]))
        tolerance_deg = 4.0 * noise_arcsec / 3600.0 + 1e-3 * rate_deg_s
        assert pitch_deg == pytest.approx(0.2 * rate_deg_s, abs=tolerance_deg)
