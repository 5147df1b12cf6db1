"""Faults that the mutation run plants: those that mean something, each at its position in the file."""

from pathlib import Path

import pytest

from benchmarks.mutation.faults import faults_of

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
        ("a > 1e-12 * b", [("a > 1e-12 * b", "a >= 1e-12 * b"), ("1e-12 * b", "1e-12 / b")]),
        ("max(a, 1e-9)", [("max(a, 1e-09)", "min(a, 1e-09)")]),
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
