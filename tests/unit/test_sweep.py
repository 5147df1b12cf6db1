"""Sweeps: rows of single runs, resume after a kill, refusals, and the files they leave."""

import csv
import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from undrawn import undrawn

from simulator.checks import load_scenario
from simulator.cli.terminal import time_left_s
from simulator.scenario import ScenarioError
from simulator.study.sweep.files import point_files
from simulator.study.sweep.run import plan_sweep, run_sweep
from simulator.study.trials.engine import run_trials
from startracker.errors import InputError

# the smallest camera that ships; 31 mm at 15.09 mm would be f/0.487
OVER = ["optics.aperture_mm=15,31", "tracker.centroider=moment,maximum_likelihood"]
TRIALS = 4
SEED = 7


@pytest.fixture(autouse=True, scope="module")
def no_drawing():
    """The pictures of sweeps: test_study_pages.py."""
    with undrawn():
        yield


@pytest.fixture(scope="module")
def plan():
    return plan_sweep("tc211", OVER, trials=TRIALS, seed=SEED)


@pytest.fixture(scope="module")
def sweep(plan, tmp_path_factory):
    told = []
    folder = tmp_path_factory.mktemp("sweep")
    result = run_sweep(plan, folder, progress=lambda done, total, point: told.append((done, total, point.index)))
    return result, told


def without_times(path):
    table = pq.read_table(path)
    return table.select([name for name in table.column_names if not name.endswith("_ms")])


def test_points_are_the_grid_and_physics_refuses_with_its_reason(plan):
    assert [p.values for p in plan.points] == [
        (15, "moment"),
        (15, "maximum_likelihood"),
        (31, "moment"),
        (31, "maximum_likelihood"),
    ]
    assert [bool(p.refused) for p in plan.points] == [False, False, True, True]
    assert "f/0.487" in plan.points[2].refused


def test_rows_are_those_of_single_runs_with_the_same_seed(sweep):
    rows = without_times(sweep[0].folder / "sweep.parquet")
    for index, centroider in enumerate(["moment", "maximum_likelihood"]):
        overrides = ["optics.aperture_mm=15", f"tracker.centroider={centroider}"]
        single = run_trials(load_scenario("tc211", overrides, seed=SEED), TRIALS).table
        mine = rows.filter(np.asarray(rows["point"]) == index)
        assert mine["optics.aperture_mm"].to_pylist() == [15.0] * TRIALS
        assert mine["tracker.centroider"].to_pylist() == [centroider] * TRIALS
        same = [name for name in single.column_names if not name.endswith("_ms")]
        # as text, in which a NaN equals itself
        assert str(mine.select(same).to_pylist()) == str(single.select(same).to_pylist())


def test_points_share_times_and_attitudes(sweep):
    rows = sweep[0].trials
    point = np.asarray(rows["point"])
    for name in ("t_s", "true_ra_deg", "true_qx", "stars_in_field"):
        values = np.asarray(rows[name])
        assert np.array_equal(values[point == 0], values[point == 1])
    errors = np.asarray(rows["error_roll_deg"])
    assert not np.array_equal(errors[point == 0], errors[point == 1])


def test_progress_counts_all_trials_of_the_points_that_can_be(sweep):
    told = sweep[1]
    done = [step[0] for step in told]
    assert done == sorted(done)
    assert told[0][0] == 0
    assert told[-1][:2] == (2 * TRIALS, 2 * TRIALS)
    assert {total for _, total, _ in told} == {2 * TRIALS}


def test_a_kill_costs_the_point_under_way_and_resume_ends_with_the_same_dataset(plan, sweep, tmp_path):
    class Killed(BaseException):
        pass

    def kill(done, total, point):
        if point.index == 1 and done > TRIALS:
            raise Killed

    with pytest.raises(Killed):
        run_sweep(plan, tmp_path, progress=kill)
    assert list(point_files(tmp_path / "points")) == [0]
    assert not (tmp_path / "sweep.parquet").exists()
    told = []
    resumed = run_sweep(plan, tmp_path, resume=True, progress=lambda *step: told.append(step))
    assert told[0][0] == TRIALS
    assert resumed.table["trials_run"] == TRIALS
    assert not (tmp_path / "points").exists()
    for name, path in (("undisturbed", sweep[0].folder), ("resumed", tmp_path)):
        pq.write_table(without_times(path / "sweep.parquet"), tmp_path / f"{name}.parquet")
    assert (tmp_path / "undisturbed.parquet").read_bytes() == (tmp_path / "resumed.parquet").read_bytes()
    # once whole, there is nothing to do, and what stands is given back
    again = run_sweep(plan, tmp_path, resume=True, progress=lambda *_: pytest.fail("nothing is left to run"))
    assert again.table["points"] == resumed.table["points"]


@pytest.mark.parametrize("resume", [True, False])
def test_another_sweep_is_not_replaced(plan, sweep, tmp_path, resume):
    stands = rf"\(scenario 'tc211', seed {SEED}, {len(plan.points)} points, {TRIALS} trials each, boresight"
    for over, trials, seed, words in [
        (OVER, TRIALS, SEED + 1, "another sweep"),
        (OVER, TRIALS - 1, SEED, "a sweep with other values"),
        (OVER[:-1], TRIALS, SEED, "a sweep with other values"),
    ]:
        other = plan_sweep("tc211", over, trials=trials, seed=seed)
        with pytest.raises(InputError, match=f"contains the results of {words}.*{stands}"):
            run_sweep(other, sweep[0].folder, resume=resume)


def test_a_damaged_point_is_computed_again(plan, sweep, tmp_path):
    class Killed(BaseException):
        pass

    def kill(done, total, point):
        if point.index == 1 and done > TRIALS:
            raise Killed

    def harm(done, total, point):
        """Before the last point is finished, the first one is damaged."""
        if done > total - TRIALS:
            path = point_files(tmp_path / "points").get(0)
            if path and len(harmed) < 2:
                harmed.append(path.name)
                path.write_bytes(path.read_bytes()[:-9])

    with pytest.raises(Killed):
        run_sweep(plan, tmp_path, progress=kill)
    (path,) = point_files(tmp_path / "points").values()
    harmed = [path.name]
    path.write_bytes(path.read_bytes()[9:])
    again = run_sweep(plan, tmp_path, progress=harm)
    assert [note.split(": ")[0] for note in again.notes] == [str(tmp_path / "points" / name) for name in harmed]
    assert len(harmed) == 2
    assert without_times(tmp_path / "sweep.parquet").equals(without_times(sweep[0].folder / "sweep.parquet"))


def test_a_folder_of_somebody_else_is_left_alone(plan, tmp_path):
    (tmp_path / "points").mkdir()
    (tmp_path / "points" / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match="do not belong to a sweep"):
        run_sweep(plan, tmp_path)
    assert (tmp_path / "points" / "mine.txt").read_text() == "keep"


def test_files_agree_with_each_other(sweep):
    folder = sweep[0].folder
    with (folder / "points.csv").open() as stream:
        lines = list(csv.DictReader(stream))
    table = json.loads((folder / "sweep.json").read_text())
    rows = pq.read_table(folder / "sweep.parquet")
    assert [line["status"] for line in lines] == ["done", "done", "refused", "refused"]
    assert "f/0.487" in lines[2]["reason"]
    for line, point in zip(lines[:2], table["points"], strict=False):
        chosen = np.asarray(rows["point"]) == point["point"]
        solved = chosen & (np.asarray(rows["status"]) == "solved")
        rms = np.sqrt(np.mean(np.asarray(rows["error_yaw_deg"])[solved] ** 2))
        assert float(line["yaw_rms_deg"]) == point["statistics"]["yaw_rms_deg"] == pytest.approx(rms, rel=1e-12)
        assert int(line["trials"]) == TRIALS
    page = (folder / "sweep.html").read_text()
    assert "f/0.487" in page
    assert "<script" not in page
    assert page.count("<svg") == 8 * len(list((folder / "plots").glob("*.png"))) == 8 * 3  # panels of the figures
    assert not any(word in page for word in ('src="http', 'href="http'))


def test_a_sweep_in_which_nothing_can_be_is_an_error():
    with pytest.raises(InputError, match=r"none of the 2 points are possible; the first: .* f/0\.48"):
        plan_sweep("tc211", ["optics.aperture_mm=31,40"])


def test_a_mistake_of_the_file_is_told_by_its_line(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("name: mine\nepoch: 2026-03-21\noptics: {focal_length_mm: 25, aperture_m: 1}\ndetector: {}\n")
    with pytest.raises(ScenarioError, match=r"mine\.yaml:3:.*aperture_mm"):
        plan_sweep(file, ["optics.aperture_mm=10,12"])


def test_a_key_that_the_file_leaves_out_can_be_swept(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(
        "name: mine\nepoch: 2026-03-21\noptics: {focal_length_mm: 25}\n"
        "detector: {width: 64, height: 64, pixel_pitch_um: 5, exposure_s: 0.1}\n"
    )
    plan = plan_sweep(file, ["optics.aperture_mm=10:20:2"])
    assert [p.scenario.optics.aperture_mm for p in plan.points] == [10, 20]


def test_latin_hypercube_depends_on_the_seed_alone():
    def values(seed):
        plan = plan_sweep("tc211", ["optics.aperture_mm=5:20", "detector.exposure_s=0.1:1,log"], lhs=6, seed=seed)
        return [point.values for point in plan.points]

    assert values(1) == values(1) != values(2)


def test_time_left_counts_only_what_this_start_has_done():
    # 100 of 300 trials were there before; 20 more took 10 s: 180 are left at half a second each
    assert time_left_s(120, 100, 300, 10.0) == pytest.approx(90.0)
    assert time_left_s(100, 100, 300, 1.0) is None
