"""Tasks of a datasheet and how they are kept, its fixed times and its amounts; no frame is rendered."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from simulator import Scenario
from simulator.study.datasheet import tasks, timing
from simulator.study.datasheet.dependence import DEFAULT_HOT_E_S, residuals, robustness
from simulator.study.datasheet.frames import DatasheetFrames
from simulator.study.datasheet.scan import LARGEST_SHARE, LENGTH_PX, STEP_PX, ScanGeometry, scan_geometry
from simulator.study.datasheet.sheet import FULL, QUICK, Amounts, Estimate, cross_square_deg2, proportion
from simulator.study.datasheet.tables import number_text
from simulator.study.datasheet.tasks import MOST_SCENARIOS, Task, TaskRunner, joined, trial_tasks
from simulator.study.specification.verdicts import frames_needed
from simulator.study.statistics import CAMERA_AXES

SCENARIO = Scenario.load("scenarios/sunsat.yaml")
OTHER = SCENARIO.changed({"detector.temperature_c": 41.0})


# ---------------------------------------------------------------- tasks
def test_trials_are_divided_into_tasks_without_gaps():
    found = trial_tasks(SCENARIO, 120, "at_rate", 1.5)
    assert [task.arguments for task in found] == [(0, 50, 1.5), (50, 50, 1.5), (100, 20, 1.5)]
    assert {task.method for task in found} == {"at_rate"}
    assert [task.arguments for task in trial_tasks(SCENARIO, 5, per_task=2)] == [(0, 2), (2, 2), (4, 1)]
    assert trial_tasks(SCENARIO, 5)[0].method == "trials"
    assert trial_tasks(SCENARIO, 0) == []


def test_the_key_of_a_task_is_that_of_scenario_method_and_arguments():
    task = Task(SCENARIO, "trials", (0, 10))
    assert task.key == Task(SCENARIO, "trials", (0, 10)).key
    others = [Task(OTHER, "trials", (0, 10)), Task(SCENARIO, "scan", (0, 10)), Task(SCENARIO, "trials", (0, 11))]
    assert len({task.key, *(other.key for other in others)}) == 4
    assert len(task.key) == 32


def test_columns_of_tasks_are_joined_in_order():
    parts = [{"a": np.array([1.0, 2.0]), "b": np.array(["x", "y"])}, {"a": np.array([3.0]), "b": np.array(["z"])}]
    found = joined(parts)
    assert found["a"].tolist() == [1.0, 2.0, 3.0]
    assert found["b"].tolist() == ["x", "y", "z"]


@pytest.fixture
def ran(monkeypatch):
    """Tasks that were run, in their order; each gives its first argument."""
    done = []

    def fake(task):
        done.append(task.arguments[0])
        return {"value": np.full(3, float(task.arguments[0]))}

    monkeypatch.setattr(tasks, "run_task", fake)
    return done


def some_tasks(*numbers):
    return [Task(SCENARIO, "trials", (number,)) for number in numbers]


def test_results_are_in_the_order_of_the_tasks_and_each_is_run_once(ran):
    told = []
    with TaskRunner(progress=lambda *counts: told.append(counts)) as runner:
        found = runner.run(some_tasks(4, 2, 4, 7))
        assert [columns["value"][0] for columns in found] == [4.0, 2.0, 4.0, 7.0]
        assert ran == [4, 2, 7]
        again = runner.run(some_tasks(7, 9))
        assert [columns["value"][0] for columns in again] == [7.0, 9.0]
    assert ran == [4, 2, 7, 9]
    # one of four is another's result, one of the last two is known
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4), (5, 6), (6, 6)]


def test_finished_tasks_are_read_from_the_folder(ran, tmp_path):
    folder = tmp_path / "a" / "parts"
    with TaskRunner(folder=folder) as runner:
        runner.run(some_tasks(1, 2))
    assert len(list(folder.glob("*.npz"))) == 2
    with TaskRunner(folder=folder) as runner:
        found = runner.run(some_tasks(1, 2, 3))
    assert ran == [1, 2, 3]
    assert [columns["value"].tolist() for columns in found] == [[k] * 3 for k in (1.0, 2.0, 3.0)]


@pytest.mark.parametrize("damage", ["short", "half", "empty", "other", "changed", "missing"])
def test_a_damaged_file_of_a_task_is_computed_again(ran, tmp_path, damage):
    with TaskRunner(folder=tmp_path) as runner:
        runner.run(some_tasks(1))
    (path,) = tmp_path.glob("*.npz")
    whole = path.read_bytes()
    middle = whole.index(b"\x93NUMPY") + 140
    damaged = {
        "short": whole[:40],
        "half": whole[: len(whole) // 2],
        "empty": b"",
        "other": b"not an archive",
        "changed": whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :],
    }
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes(damaged[damage])
    with TaskRunner(folder=tmp_path) as runner:
        assert runner.run(some_tasks(1))[0]["value"].tolist() == [1.0] * 3
    assert ran == [1, 1]
    with TaskRunner(folder=tmp_path) as runner:
        runner.run(some_tasks(1))
    assert ran == [1, 1]


def test_trials_of_a_runner_are_those_of_all_tasks(ran):
    with TaskRunner() as runner:
        found = runner.trials(SCENARIO, 120)
    assert ran == [0, 50, 100]
    assert found["value"].tolist() == [0.0] * 3 + [50.0] * 3 + [100.0] * 3


def test_common_data_of_a_few_scenarios_is_kept(monkeypatch):
    built = []
    monkeypatch.setattr(
        tasks, "DatasheetFrames", lambda scenario: built.append(scenario.detector.temperature_c) or scenario
    )
    monkeypatch.setattr(tasks, "_local", type("Local", (), {})())
    cases = [SCENARIO.changed({"detector.temperature_c": float(c)}) for c in range(MOST_SCENARIOS + 1)]
    for case in (*cases[:-1], cases[0]):
        assert tasks._frames_of(case) is not None
    assert built == [0.0, 1.0, 2.0]
    tasks._frames_of(cases[-1])  # in place of the one not used for longest, the second
    tasks._frames_of(cases[0])
    assert built == [0.0, 1.0, 2.0, 3.0]
    tasks._frames_of(cases[1])
    assert built == [0.0, 1.0, 2.0, 3.0, 1.0]


# ---------------------------------------------------------------- timing
@pytest.mark.parametrize(("shutter", "readout_s"), [("global", 0.0), ("rolling", 480 * 20e-6)])
def test_times_that_the_scenario_fixes(shutter, readout_s):
    keys = ["detector.width=640", "detector.height=480", "detector.line_time_us=20", "detector.exposure_s=0.1"]
    keys += [f"detector.shutter={shutter}", "sequence.step_s=0.25"]
    found = {each.name: each for each in timing.timing(Scenario.load("cubesat_ideal", keys))}
    assert found["update_rate"].estimate == (4.0, 4.0, 4.0)
    assert found["integration_time"].estimate == (0.1, 0.1, 0.1)
    latency = 0.05 + readout_s
    assert found["latency_to_readout"].estimate == pytest.approx((latency,) * 3, rel=1e-12)
    assert [each.unit for each in found.values()] == ["Hz", "s", "s"]
    assert ("480 lines of 20 µs" in found["latency_to_readout"].method) is (shutter == "rolling")


def test_computing_times_are_median_and_largest(monkeypatch):
    """Of twenty trials after the first one, which warms up."""
    asked = []

    class Runner:
        def __init__(self, scenario):
            pass

        def run(self, index):
            asked.append(index)
            return {"solve_ms": 500.0 if index == 0 else float(index)}

    monkeypatch.setattr(timing, "TrialRunner", Runner)
    found = timing.computing_time(SCENARIO)
    assert asked == list(range(21))
    assert found["solve_ms"] == {"median": 10.5, "largest": 20.0}
    latency_s = timing.timing(SCENARIO)[-1].estimate.value
    assert found["latency_s"] == pytest.approx({"median": latency_s + 0.0105, "largest": latency_s + 0.02})
    assert found["trials"] == 20


# ---------------------------------------------------------------- amounts and small parts
def test_the_full_sheet_can_show_a_percentile_of_99_7_and_a_quick_one_is_smaller_in_all():
    from simulator.study.specification.requirements import Requirement

    assert FULL.trials >= frames_needed(Requirement("yaw", 1.0, 99.7, "yaw"))
    for part in dataclasses.fields(Amounts):
        assert 0 < getattr(QUICK, part.name) < getattr(FULL, part.name), part.name
    assert FULL.fields == 96  # docs/datasheet.md, section on the error classes
    frames = {
        name: sheet.fields * 4 * 45 + sheet.trials + 1.5 * sheet.acquisition
        for name, sheet in (("q", QUICK), ("f", FULL))
    }
    assert 12.0 < frames["f"] / frames["q"] < 20.0  # "about a fifteenth", the scans above all
    assert FULL.to_dict() == dataclasses.asdict(FULL)


@pytest.mark.parametrize(
    ("width", "height", "length_px"),
    [(1024, 1024, LENGTH_PX), (1024, 100, LARGEST_SHARE * 100), (100, 1024, LARGEST_SHARE * 100), (20, 20, 0.0)],
)
def test_a_scan_is_54_pixels_long_or_two_fifths_of_the_shorter_side(width, height, length_px):
    found, step = scan_geometry(width, height), math.hypot(*STEP_PX)
    assert step == pytest.approx(1.22, abs=5e-4)
    assert found.frames == max(math.ceil(length_px / step), 16)
    assert found.length_px == pytest.approx(found.frames * step)
    assert (LENGTH_PX, LARGEST_SHARE) == (54.0, 0.4)
    assert ScanGeometry(10).step_px == step


def test_errors_across_are_the_mean_of_both_axes_and_open_estimates_stay_open():
    columns = {"error_cross_x_deg": np.array([3.0, 0.0]), "error_cross_y_deg": np.array([4.0, 2.0])}
    assert cross_square_deg2(columns).tolist() == [12.5, 2.0]
    assert proportion([]).value is None
    assert Estimate(None).times(3.0) == (None, None, None)


class Camera:
    """A runner that notes its tasks; every frame is right and has an error of 1″."""

    def __init__(self):
        self.tasks = []

    def run(self, asked):
        self.tasks += asked
        return [self._columns(task.arguments[1]) for task in asked]

    def trials(self, scenario, count, method="trials", *more):
        return self.run([Task(scenario, method, (0, count, *more))])[0]

    def _columns(self, count):
        error = np.full(count, 1.0 / 3600.0)
        columns = {f"error_{axis}_deg": error for axis in CAMERA_AXES}
        yes = np.ones(count, bool)
        none = np.zeros(count, int)
        return columns | {
            "error_deg": np.tile(error[:, None], 3),
            "right": yes,
            "solved": yes,
            "stars_misidentified": none,
        }


@pytest.mark.parametrize(("own", "used"), [(0.0, DEFAULT_HOT_E_S), (123.0, 123.0)])
def test_added_hot_pixels_are_as_hot_as_those_of_the_scenario(own, used):
    camera = Camera()
    robustness(SCENARIO.changed({"detector.hot_pixel_dark_e_s": own}), camera, Amounts(*[10] * 9))
    assert {task.scenario.detector.hot_pixel_dark_e_s for task in camera.tasks[-4:]} == {used}
    assert DEFAULT_HOT_E_S == 5000.0


@pytest.mark.parametrize(
    ("per_point", "trials", "pairs"), [(8, 3000, 50), (150, 3000, 150), (150, 100, 100), (8, 20, 20)]
)
def test_pairs_of_a_warmer_lens_are_a_whole_task_at_least_and_the_trials_at_most(per_point, trials, pairs):
    camera = Camera()
    amounts = dataclasses.replace(Amounts(*[10] * 9), per_point=per_point, trials=trials)
    residuals(SCENARIO.changed({"optics.thermal.expansion_ppm_k": 20.0}), camera, amounts)
    assert [task.arguments for task in camera.tasks if task.method == "trials"] == [(0, pairs)] * 2
    (sky,) = (task for task in camera.tasks if task.method == "model_residuals")
    assert sky.arguments == (0, per_point)
    assert not sky.scenario.sky.light_deflection


@pytest.mark.parametrize(
    ("value", "largest", "text"),
    [
        (1.23456, None, "1.23"), (123.456, None, "123"), (-0.0123456, None, "−0.0123"), (1.23456e-4, None, "0.000123"),
        (1.23456e-5, None, "1.2e-05"), (0.0, None, "0"), (math.inf, None, "–"), (math.nan, 1.0, "–"),
        (1.23456, 987.0, "1"), (1.23456, 0.0123, "1.2346"), (0.0, 5.0, "0.00"), (1.0, 0.0, "–"),
    ],
)  # fmt: skip
def test_numbers_have_three_digits_of_the_largest(value, largest, text):
    assert number_text(value, largest) == text.replace("e-", "e−")


# ---------------------------------------------------------------- frames
def test_a_task_is_a_sequence_or_a_method_of_the_frames_of_its_scenario(monkeypatch):
    frames = SimpleNamespace(at_rate=lambda *arguments: {"asked": arguments})
    monkeypatch.setattr(tasks, "sequence_columns", lambda scenario: {"sequence": scenario})
    monkeypatch.setattr(tasks, "_frames_of", lambda scenario: frames)
    assert tasks.run_task(Task(SCENARIO, "sequence")) == {"sequence": SCENARIO}
    assert tasks.run_task(Task(SCENARIO, "at_rate", (3, 4, 1.5))) == {"asked": (3, 4, 1.5)}


@pytest.fixture(scope="module")
def small():
    keys = ["detector.width=256", "detector.height=192", "sky.magnitude_limit=3", "sky.planets=true"]
    return DatasheetFrames(Scenario.load("cubesat_ideal", keys))


class Frames:
    """A renderer that records what it is asked for."""

    def __init__(self, renderer):
        self.camera, self.scene, self.asked = renderer.camera, renderer.scene, []

    def frame(self, index, **keys):
        self.asked.append((index, keys))
        nothing = {
            "saturation_dn": 4000.0,
            "gain_e_per_dn": 2.0,
            "prior": "prior",
            "prior_deg": 1.5,
            "observer": "here",
        }
        return SimpleNamespace(image=np.zeros((192, 256)), **nothing), SimpleNamespace()


@pytest.mark.parametrize(("body", "angle_deg"), [("sun", 20.0), ("moon", 35.0), ("earth", 8.0)])
def test_frames_near_a_body_have_its_angle_at_the_time_of_the_trial(small, monkeypatch, body, angle_deg):
    """From the centre of Sun and Moon, from the limb of the Earth; every frame at another azimuth and roll."""
    frames, judged = Frames(small.renderer), iter([1.0, np.nan, 1.0])
    monkeypatch.setattr(small, "renderer", frames)
    monkeypatch.setattr(small, "_measured", lambda *_: (np.array([1.0, 1.0, next(judged)]), np.array([0]), True))
    found = small.near_body(5, 3, body, angle_deg)
    assert found["right"].tolist() == [True, False, True]
    assert [index for index, _ in frames.asked] == [30_000_005, 30_000_006, 30_000_007]
    rolls = []
    for k, (_, keys) in enumerate(frames.asked):
        scene = frames.scene(5 + k)
        assert keys["at_s"] == scene.t_s
        radius_km = np.linalg.norm(scene.r_km)
        centre = {
            "sun": scene.sun_direction,
            "moon": scene.bodies.direction[list(scene.bodies.name).index("Moon")],
            "earth": -scene.r_km / radius_km,
        }[body]
        limb_deg = math.degrees(math.asin(6378.137 / radius_km)) if body == "earth" else 0.0
        away_deg = math.degrees(math.acos(keys["attitude"].boresight @ centre))
        assert away_deg == pytest.approx(angle_deg + limb_deg, abs=1e-9)
        rolls.append(keys["attitude"].roll_deg)
    assert len(set(np.round(rolls, 3))) == 3


@pytest.mark.parametrize("number", [0, 4])
def test_false_stars_have_fluxes_and_errors_of_true_ones_at_random_places(small, monkeypatch, number):
    frames = Frames(small.renderer)
    stars = SimpleNamespace(xy=np.array([[10.0, 20.0], [200.0, 100.0]]), flux=np.array([1000.0, 50.0]))
    solutions = iter(["yes", "unsolved", "nothing matched", "yes"])
    asked = []

    class Tracker:
        def solve(self, image, **keys):
            assert keys == {"saturation_dn": 4000.0, "gain_e_per_dn": 2.0}
            self.state = next(solutions)
            seen = type("Seen", (), {"xy": stars.xy, "flux": stars.flux, "__len__": lambda _: 2})()
            return SimpleNamespace(attitude=None if self.state == "unsolved" else "attitude", stars=seen)

        def solve_centroids(self, xy, flux, **keys):
            asked.append((xy, flux, keys))
            return "solution"

    tracker = Tracker()
    monkeypatch.setattr(small, "renderer", frames)
    monkeypatch.setattr(small.runner, "tracker", tracker)
    matched = "simulator.study.datasheet.frames.matched_sources"
    monkeypatch.setattr(matched, lambda *_: np.arange(0 if tracker.state == "nothing matched" else 2))
    monkeypatch.setattr(small, "_bounds_px", lambda *_: np.array([0.02, 0.3]))
    monkeypatch.setattr(small, "_judged", lambda solution, truth: (np.array([1.0, 2.0, 3.0]), None, True))
    found = small.with_false_stars(7, 4, number)
    assert found["right"].tolist() == [True, False, False, True]
    assert found["error_cross_y_deg"][[0, 3]].tolist() == [2.0, 2.0]
    assert [index for index, _ in frames.asked] == [7, 8, 9, 10]
    assert len(asked) == 2
    for xy, flux, keys in asked:
        assert xy.shape == (2 + number, 2)
        assert np.array_equal(xy[:2], stars.xy)
        assert flux[:2].tolist() == [1000.0, 50.0]
        error_of = {1000.0: 0.02, 50.0: 0.3}
        assert keys["sigma_px"].tolist() == [error_of[one] for one in flux]
        assert (keys["prior"], keys["prior_deg"], keys["observer"]) == ("prior", 1.5, "here")
        assert ((xy[2:] >= -0.5) & (xy[2:] <= np.array([255.5, 191.5]))).all()
    if number:
        assert not np.array_equal(asked[0][0][2:], asked[1][0][2:])


def test_false_stars_fill_the_whole_image(small, monkeypatch):
    """Positions of 4,000: the mean is the middle to 5/√(12 · 4,000) of a side, and the outermost pixels have some."""
    frames, asked = Frames(small.renderer), []
    one = type("Seen", (), {"xy": np.array([[10.0, 20.0]]), "flux": np.ones(1), "__len__": lambda _: 1})()
    solved = SimpleNamespace(attitude="attitude", stars=one)
    tracker = SimpleNamespace(solve=lambda *_, **__: solved, solve_centroids=lambda xy, *_, **__: asked.append(xy))
    monkeypatch.setattr(small, "renderer", frames)
    monkeypatch.setattr(small.runner, "tracker", tracker)
    monkeypatch.setattr("simulator.study.datasheet.frames.matched_sources", lambda *_: np.array([0]))
    monkeypatch.setattr(small, "_bounds_px", lambda *_: np.array([0.02]))
    monkeypatch.setattr(small, "_judged", lambda *_: (np.zeros(3), None, True))
    small.with_false_stars(0, 1, 4000)
    size, places = np.array([256.0, 192.0]), asked[0][1:]
    assert places.mean(axis=0) == pytest.approx((size - 1.0) / 2.0, abs=5.0 * 256.0 / math.sqrt(12.0 * 4000))
    assert (places.min(axis=0) < 0.5).all()
    assert (places.max(axis=0) > size - 1.5).all()
