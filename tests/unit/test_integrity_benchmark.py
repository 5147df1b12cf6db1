"""Parts of the integrity benchmark: each list counts once, and only lists of one commit are added up."""

from __future__ import annotations

import pytest

from benchmarks.integrity import MODES, Part, merged, mode_of, summed, tables_of


def part(first: int, lists: int, commit: str = "a", group: str = "clusters") -> Part:
    return {
        "group": group,
        "seed": 1,
        "first": first,
        "lists": lists,
        "commit": commit,
        "cpu_s": 1.5,
        "wrong": [],
        "counts": {"kind: torn": [lists, 2, 0]},
    }


def test_parts_that_follow_each_other_are_one() -> None:
    (one,) = merged([part(10, 5), part(0, 10), part(0, 10)])
    assert (one["first"], one["lists"], one["cpu_s"]) == (0, 15, 3.0)
    assert one["counts"] == {"kind: torn": [15, 4, 0]}


def test_parts_of_other_commits_and_groups_stay_apart() -> None:
    parts = merged([part(0, 10), part(10, 10, "b"), part(20, 10, "b", "others"), part(30, 10, "b")])
    assert [(p["group"], p["first"], p["lists"], p["commit"]) for p in parts] == [
        ("clusters", 0, 10, "a"),
        ("clusters", 10, 10, "b"),
        ("clusters", 30, 10, "b"),
        ("others", 20, 10, "b"),
    ]
    assert summed(parts)["kind: torn"] == [40, 8, 0]


def test_a_list_in_two_parts_is_refused() -> None:
    with pytest.raises(SystemExit, match="lists 5 to 9 are in two"):
        merged([part(0, 10), part(5, 10)])


def test_shares_of_modes() -> None:
    assert sum(share for _, share in MODES) == pytest.approx(1.0)
    assert mode_of(0.0) == MODES[0][0]
    assert mode_of(0.9995) == MODES[-1][0]


def test_tables_are_text_with_the_limit_that_the_lists_allow():
    tables, lists, wrong = tables_of([part(0, 10), part(0, 30, "b", "others")])
    assert (lists, wrong) == (40, 0)
    assert [title for title, _, _ in tables] == [
        "clusters: 10 lists, 0 wrong (95 %: at most 0.3), 150.0 ms of CPU each",
        "clusters: where the lists ran",
        "others: 30 lists, 0 wrong (95 %: at most 0.1), 50.0 ms of CPU each",
        "others: where the lists ran",
    ]
    assert all(isinstance(cell, str) for _, _, rows in tables for row in rows for cell in row)
    assert tables[3][2] == [["0", "29", "b", "1"]]
