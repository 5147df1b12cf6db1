"""Faults that the mutation run plants: those that mean something, each at its position in the file."""

import dataclasses
import json
from pathlib import Path

import pytest

from benchmarks.mutation.__main__ import ROOT, State, known_equivalent, page, read_states
from benchmarks.mutation.areas import AREAS
from benchmarks.mutation.faults import faults_of
from benchmarks.mutation.plan import Plan, Planner
from benchmarks.mutation.references import References

PATH = Path("module.py")


def changes(source):
    return [(fault.before, fault.after) for fault in faults_of(PATH, source.encode())]


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("a < b", [("a < b", "a <= b")]),
        ("a < 2.5", [("a < 2.5", "a >= 2.5"), ("2.5", "2.75")]),
        ("a <= -2.5", [("a <= -2.5", "a > -2.5"), ("-2.5", "2.5"), ("2.5", "2.75")]),
        ("a > 0.0", [("a > 0.0", "a >= 0.0")]),
        ("A = 2.5\nb < A", [("2.5", "2.75"), ("b < A", "b >= A")]),
        ("A, B = 2.5, 2\nb < A", [("2.5", "2.75"), ("2", "3"), ("b < A", "b >= A")]),
        ("A, B = 2.5, 2\nb < B", [("2.5", "2.75"), ("2", "3"), ("b < B", "b <= B")]),
        ("a > 1e-12 * b", [("a > 1e-12 * b", "a >= 1e-12 * b"), ("1e-12 * b", "1e-12 / b")]),
        ("max(a, 1e-9)", [("max(a, 1e-09)", "min(a, 1e-09)")]),
        ("zip(a, b, strict=True)", []),
        ("f(a, strict=True)", [("True", "False")]),
        ("x[2]", [("2", "1")]),
        ("x[0]", [("0", "1")]),
        ("x[n, 1]", [("1", "0")]),
        ("for _ in range(20): step()", [("20", "1")]),
        ("for k in range(3): step(k)", [("3", "4")]),
        ("a and b", [("a and b", "a or b"), ("a and b", "a"), ("a and b", "b")]),
        ("a if b else c", [("a if b else c", "a"), ("a if b else c", "c")]),
        ("raise ValueError(1)", []),
        ("x: int = y", []),
    ],
)
def test_each_expression_has_the_faults_that_people_make(source, expected):
    assert changes(source) == expected


def test_a_fault_is_planted_where_it_is_and_the_rest_stays():
    source = "def f(x):\n    # größer\n    return x * 2.0 + 1\n"
    faults = faults_of(PATH, source.encode())
    assert [str(fault) for fault in faults] == [
        "module.py:3: x * 2.0 + 1 → x * 2.0 - 1",
        "module.py:3: x * 2.0 → x / 2.0",
        "module.py:3: 2.0 → 2.2",
        "module.py:3: 1 → 2",
    ]
    assert faults[1].planted(source.encode()).decode() == source.replace("x * 2.0", "(x / 2.0)")
    for fault in faults:
        compile(fault.planted(source.encode()), "module.py", "exec")


ONE = """LIMIT = 3.0


@kernel
def inner(x):
    return x + LIMIT


def plain(x):
    return inner(2 * x)
"""
TWO = """from simulator import one
from simulator.one import inner


@kernel
def outer(x):
    return inner(x)


class Sum:
    def of(self, x):
        return outer(x) + one.LIMIT

    def none(self):
        return 1.5
"""


def test_tests_of_a_fault_are_those_that_call_what_contains_it(tmp_path):
    """A function of Python is seen by a profile; a compiled function and a constant by their users."""
    package = tmp_path / "simulator"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "one.py").write_text(ONE)
    (package / "two.py").write_text(TWO)
    for name in ("a", "b", "c"):
        (tmp_path / f"test_{name}.py").write_text("from simulator.one import plain\n" if name == "c" else "")
    record = tmp_path / "calls.json"
    record.write_text(
        json.dumps(
            {
                "test_a.py": {"shared": [], "tests": {"test_a.py::x": [1.0, ["simulator/two.py:11"]]}},
                "test_b.py": {"shared": ["simulator/one.py:9"], "tests": {"test_b.py::y": [0.5, []]}},
                "test_c.py": {"shared": [], "tests": {"test_c.py::z": [9.0, ["simulator/one.py:9"]]}},
            }
        )
    )
    files = [Path("simulator/one.py"), Path("simulator/two.py")]
    planner = Planner(tmp_path, References(tmp_path, files), record)
    plans = {
        (path.name, fault.line): planner.plan(fault)
        for path in files
        for fault in faults_of(path, (tmp_path / path).read_bytes())
    }
    every, stale = ["test_c.py", "test_b.py", "test_a.py"], files
    assert plans["one.py", 1] == Plan(["test_c.py::z", "test_b.py::y", "test_a.py::x"], every, 10.5, stale)
    assert plans["one.py", 6] == plans["one.py", 1]
    assert plans["one.py", 10] == Plan(["test_c.py::z", "test_b.py::y"], [], 10.5, files[:1])
    assert plans["two.py", 12] == Plan(["test_a.py::x"], [], 10.5, files[1:])
    # no test calls it: those of files that import the module, as it may run in another process
    assert plans["two.py", 15] == Plan([], [], 10.5, files[1:])


def test_the_page_counts_what_can_be_noticed(tmp_path):
    """Faults that change nothing leave the share; areas that were not measured are named."""
    same = next(iter(known_equivalent()))
    state = State("fusion", "7", [("one", True), ("two", False), (same, False), ("four", True), ("five", True)])
    (tmp_path / "fusion.json").write_text(json.dumps(dataclasses.asdict(state)), encoding="utf-8")
    before = State("fusion", "6", [("one", True), ("two", False), (same, False)])
    assert "| fusion | 50 % | 7 | 5 | 1 | 3 | 75 % | 30 to 95 % |" in page([state], [before])
    assert "| fusion |  | 7 | 5 | 1 | 3 | 75 % | 30 to 95 % |" in page([state], [state])
    text = page(read_states(tmp_path), [])
    assert "| fusion | 7 | 5 | 1 | 3 | 75 % | 30 to 95 % |" in text
    assert "Not measured in these runs: mission, sky, optics, detector," in text
    assert "- `two`" in text
    assert f"- `{same}`: " in text
    assert "- `one`" not in text


def test_every_area_has_its_files_and_tests():
    """Every file of physics and of the tracker's stages belongs to one area, and a known equivalent fault to a file of
    one."""
    files = [path for area in AREAS.values() for path in area.files(ROOT)]
    assert len(files) == len(set(files))
    rooms = ["simulator/mission", "simulator/sky", "simulator/optics", "simulator/detector", "simulator/environment"]
    rooms += [
        f"startracker/{name}" for name in ("geometry", "catalog", "detection", "centroid", "trails", "identification")
    ]
    rooms += [f"startracker/{name}" for name in ("estimation", "tracking", "fusion", "calibration", "images")]
    there = {path.relative_to(ROOT) for room in rooms for path in (ROOT / room).rglob("*.py")}
    assert {path for path in there if path.name != "__init__.py"} <= set(files)
    assert all(area.test_files(ROOT) for area in AREAS.values())
    for fault, reason in known_equivalent().items():
        assert Path(fault.partition(":")[0]) in files
        assert reason
