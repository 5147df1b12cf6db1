"""Slices of slow tests, and the names of those that have not run since their code changed (`slow_tests.py`)."""

import random
import subprocess
import sys
from types import SimpleNamespace

import pytest
import slow_tests

NAMES = [f"tests/end_to_end/test_{k % 7}.py::test_{k}" for k in range(277)]


def seconds(records, chosen):
    return sum(records[name]["seconds"] for name in chosen)


def test_slices_are_even_and_complete():
    """The longest first, each into the shortest slice: slices differ by no more than the shortest test moved last."""
    numbers = random.Random(1)
    records = {name: {"seconds": numbers.expovariate(1 / 120.0)} for name in NAMES}
    slices = [slow_tests.slice_of(NAMES, records, k, 5) for k in range(1, 6)]
    assert sorted(name for one in slices for name in one) == sorted(NAMES)
    lasts = [seconds(records, one) for one in slices]
    assert max(lasts) - min(lasts) <= 0.01 * max(lasts)
    assert [slow_tests.slice_of(reversed(NAMES), records, k, 5) for k in range(1, 6)] == slices


def test_a_test_without_a_duration_lasts_as_long_as_the_mean():
    records = {name: {"seconds": 100.0} for name in NAMES[:200]} | {NAMES[200]: {"passed": "abc"}}
    counts = [len(slow_tests.slice_of(NAMES, records, k, 5)) for k in range(1, 6)]
    assert max(counts) - min(counts) <= 1
    assert len(slow_tests.slice_of(NAMES, {}, 1, 5)) in (55, 56)


@pytest.mark.parametrize("text", ["", "3", "0/5", "6/5", "a/b", "1/0", "-1/5"])
def test_slices_are_written_as_two_numbers(text):
    with pytest.raises(ValueError, match="NUMBER/COUNT"):
        slow_tests.parse_slice(text)
    assert slow_tests.parse_slice("5/5") == (5, 5)


def test_records_are_read_as_written(tmp_path):
    records = {NAMES[3]: {"seconds": 1.5, "passed": "abc"}, NAMES[1]: {"seconds": 2.0}}
    slow_tests.write_records(records, tmp_path / "records.json")
    assert slow_tests.read_records(tmp_path / "records.json") == records
    assert len((tmp_path / "records.json").read_text().splitlines()) == 4
    assert slow_tests.read_records(tmp_path / "none.json") == {}


def test_only_tests_whose_call_passed_are_recorded_as_passed(tmp_path, monkeypatch):
    """A skipped test has a set-up that is skipped and a tear-down that passes; an interrupted one a set-up alone."""
    monkeypatch.setattr(slow_tests, "clean_commit", lambda: "abc")
    recorder = slow_tests.Recorder(tmp_path / "records.json")
    outcomes = {
        "passes": {"setup": "passed", "call": "passed", "teardown": "passed"},
        "fails": {"setup": "passed", "call": "failed", "teardown": "passed"},
        "fails last": {"setup": "passed", "call": "passed", "teardown": "failed"},
        "skipped": {"setup": "skipped", "teardown": "passed"},
        "skips itself": {"setup": "passed", "call": "skipped", "teardown": "passed"},
        "interrupted": {"setup": "passed"},
    }
    for name, phases in outcomes.items():
        for when, outcome in phases.items():
            is_it = {word: outcome == word for word in ("passed", "failed", "skipped")}
            report = SimpleNamespace(nodeid=name, keywords={"slow": 1}, when=when, duration=1.5, **is_it)
            recorder.pytest_runtest_logreport(report)
            recorder.pytest_runtest_logreport(SimpleNamespace(**{**vars(report), "nodeid": "fast", "keywords": {}}))
    recorder.pytest_sessionfinish()
    expected = {"passes": {"seconds": 4.5, "passed": "abc"}, "fails": {"seconds": 4.5}, "fails last": {"seconds": 4.5}}
    assert slow_tests.read_records(tmp_path / "records.json") == expected


def test_the_records_are_of_tests_that_exist():
    for name in slow_tests.read_records():
        file, _, function = name.partition("::")
        assert f"def {function.partition('[')[0]}(" in (slow_tests.ROOT / file).read_text(encoding="utf-8"), name


def test_a_test_covers_what_it_imports_directly_and_indirectly():
    """A test of one leaf of the package: not of what nothing in it imports."""
    leaf = slow_tests.ROOT / "tests/property/test_camera_projection.py"
    covered = slow_tests.covers(leaf, [
        "startracker/geometry/camera.py", "startracker/geometry/fisheye.py", "simulator/study/run.py", "docs/index.md",
        "tests/property/test_camera_projection.py", "tests/unit/test_camera.py", "pyproject.toml",
    ])  # fmt: skip
    assert covered == [
        "startracker/geometry/camera.py",
        "startracker/geometry/fisheye.py",
        "tests/property/test_camera_projection.py",
        "pyproject.toml",
    ]


@pytest.mark.system
def test_a_test_of_studies_covers_all_of_it():
    study = slow_tests.ROOT / "tests/end_to_end/test_scenarios.py"
    for path in ("simulator/detector/pixels.py", "startracker/tracker.py", "scenarios/sunsat.yaml"):
        assert slow_tests.covers(study, [path]) == [path]


def test_changed_code_makes_a_test_stale(tmp_path, monkeypatch):
    def git(*arguments):
        identity = ("-c", "user.name=a", "-c", "user.email=a@b")
        return subprocess.run(
            ["git", *identity, *arguments], cwd=tmp_path, check=True, capture_output=True, text=True
        ).stdout.strip()

    monkeypatch.setattr(slow_tests, "ROOT", tmp_path)
    monkeypatch.setattr(slow_tests, "git", git)
    slow_tests.changed_since.cache_clear()
    slow_tests._imported_files.cache_clear()
    for path, text in {
        "startracker/__init__.py": "",
        "startracker/used.py": "from startracker import deep\n",
        "startracker/deep.py": "X = 1\n",
        "startracker/other.py": "Y = 1\n",
        "tests/test_a.py": "def test_a():\n    from startracker.used import deep\n",
    }.items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(text)
    git("init", "-q")
    git("add", "-A")
    git("commit", "-qm", "one")
    name, commit = "tests/test_a.py::test_a", git("rev-parse", "HEAD")
    records = {name: {"seconds": 1.0, "passed": commit}}
    (tmp_path / "startracker/other.py").write_text("Y = 2\n")
    assert slow_tests.stale_tests([name], records) == {}
    (tmp_path / "startracker/deep.py").write_text("X = 2\n")
    slow_tests.changed_since.cache_clear()
    assert "startracker/deep.py" in slow_tests.stale_tests([name], records)[name]
    assert slow_tests.stale_tests([name], {})[name] == "has never passed on record"
    slow_tests._imported_files.cache_clear()


def test_slow_tests_that_begin_too_late_are_skipped():
    """With no time at all every slow test is skipped, and says why."""
    command = [sys.executable, "-m", "pytest", "-q", "-rs", "-p", "no:xdist", "-m", "slow", "--slow-minutes", "0"]
    file = "tests/statistical/test_few_stars.py"
    done = subprocess.run([*command, file], cwd=slow_tests.ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the 0 minutes for slow tests are over" in done.stdout
    assert "passed" not in done.stdout
