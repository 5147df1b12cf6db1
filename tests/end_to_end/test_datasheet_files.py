"""``boresight datasheet`` with few frames: files, intervals, and the same bytes however it was computed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from pages import browser, faults, faults_on_paper, screens

from simulator import Scenario
from simulator.study.datasheet import run
from simulator.study.datasheet.run import RESULT_FILES, datasheet
from simulator.study.datasheet.sheet import Amounts
from simulator.study.datasheet.tasks import PARTS_FOLDER, Interrupted, Task, TaskRunner
from startracker.core import Columns

pytestmark = pytest.mark.system

TINY = Amounts(3, 24, 8, 5, 1, 5, 12, 4, 400)
REPRODUCED = [name for name in RESULT_FILES if name != "datasheet.timing.json"]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    small = {"detector.width": 256, "detector.height": 256, "optics.focal_length_mm": 8.0, "optics.aperture_mm": 8.0}
    return Scenario.load("scenarios/cubesat_ideal.yaml", small)


@pytest.fixture(scope="module")
def computed() -> dict[str, Columns]:
    """Results of the tasks of `written`, by their keys."""
    return {}


@pytest.fixture(scope="module")
def written(scenario: Scenario, computed: dict[str, Columns], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, kept = tmp_path_factory.mktemp("datasheet"), TaskRunner._keep

    def keep(self: TaskRunner, key: str, columns: Columns) -> None:
        kept(self, key, columns)
        computed[key] = columns

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "QUICK", TINY)
        patch.setattr(TaskRunner, "_keep", keep)
        datasheet(scenario, end_of_life=_aged(scenario), quick=True, out=folder)
    return folder


def _aged(scenario: Scenario) -> Scenario:
    return scenario.changed({"detector.temperature_c": 35.0})


def test_all_files_and_no_parts(written: Path) -> None:
    assert sorted(path.name for path in written.iterdir() if path.is_file() and path.name[0] != ".") == sorted(
        RESULT_FILES
    )
    assert not (written / PARTS_FOLDER).exists()
    assert (written / "datasheet.pdf").read_bytes()[:5] == b"%PDF-"
    page = (written / "datasheet.html").read_text()
    for word in ("FOV spatial error", "Pixel spatial error", "Temporal noise", "ECSS-E-ST-60-20C", "EOL"):
        assert word in page


@pytest.fixture(scope="module")
def page() -> Iterator[Any]:
    with browser() as opened:
        yield opened


@screens(1400, 800, 480)
def test_page_is_complete_and_legible(page: Any, written: Path, width: int, scheme: str) -> None:
    assert faults(page, (written / "datasheet.html").as_uri(), width, scheme) == []
    intervals = (
        "[...document.querySelectorAll('td:not(.words)')].filter(c => /\\([^)]*\\d[^)]*\\)/.test(c.textContent))"
    )
    assert page.value(f"{intervals}.length") > 50
    broken = f"""{intervals}.filter(cell => {{ const span = cell.querySelector('.unbroken');
        return !span || new Set([...span.getClientRects()].map(box => box.top)).size > 1; }}).map(c => c.textContent)"""
    assert page.value(broken) == [], "intervals that continue on the next line"
    blank = "[...document.querySelectorAll('td')].filter(c => !c.textContent && c.offsetHeight > 0).length"
    assert width > 640 or page.value(blank) == 0


def test_page_prints_on_a_few_sheets(page: Any, written: Path) -> None:
    assert faults_on_paper(page, (written / "datasheet.html").as_uri(), most_pages=8) == []
    assert 0 < len(re.findall(rb"/Type /Page\b", (written / "datasheet.pdf").read_bytes())) <= 9


def test_every_value_has_an_interval_or_says_that_it_is_open(written: Path) -> None:
    sheet = json.loads((written / "datasheet.json").read_text())
    assert [column["life"] for column in sheet["columns"]] == ["BOL", "EOL"]
    for column in sheet["columns"]:
        values = [value for section in column["sections"].values() for value in section]
        assert len(values) > 80
        for value in values:
            assert value["method"]
            assert value["confidence"] == 0.95
            low, high = value["interval"]
            if value["value"] is not None and low is not None and high is not None:
                assert low - 1e-12 <= value["value"] <= high + 1e-12 or "noise" in value["name"], value
        errors = [value for value in values if value.get("level")]
        assert {value["level"] for value in errors} == {68.0, 95.0, 99.7}
        assert {value["interpretation"] for value in errors} == {"mixed", "temporal"}
        names = {value["name"] for value in values}
        assert names >= {"bias_mean", "thermo_elastic_mean", "fov_spatial", "pixel_spatial", "temporal_noise"}
        assert names >= {"measurement_error", "aberration_residual_rms", "greatest_rate", "greatest_acceleration"}
        assert names >= {"acquisition_probability_lost_in_space", "recovery_time", "update_rate", "coverage_sky_3"}
        assert names >= {"smallest_angle_sun", "smallest_angle_moon", "smallest_angle_earth", "aberration_residual"}


def test_the_same_bytes_after_an_interruption_and_on_two_workers(
    scenario: Scenario, written: Path, computed: dict[str, Columns], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two workers compute the first task of each kind; the others take over what `written` computed in this process."""
    monkeypatch.setattr(run, "QUICK", TINY)
    kept, in_pool = TaskRunner._keep, TaskRunner._run_in_pool
    finished: list[str] = []
    by_workers: dict[str, str] = {}

    def first_of_its_kind(self: TaskRunner, missing: dict[str, Task], stop: Event) -> None:
        for key, task in missing.items():
            if by_workers.setdefault(task.method, key) != key:
                self._keep(key, computed[key])
        if first := {key: task for key, task in missing.items() if key in by_workers.values()}:
            in_pool(self, first, stop)

    def stop_after_ten(self: TaskRunner, key: str, columns: Columns) -> None:
        kept(self, key, columns)
        finished.append(key)
        if len(finished) == 10:
            raise Interrupted("interrupted")

    monkeypatch.setattr(TaskRunner, "_run_in_pool", first_of_its_kind)
    monkeypatch.setattr(TaskRunner, "_keep", stop_after_ten)
    with pytest.raises(Interrupted):
        datasheet(scenario, end_of_life=_aged(scenario), quick=True, workers=2, out=tmp_path)
    assert len(list((tmp_path / PARTS_FOLDER).iterdir())) == 10
    finished.append("more")
    datasheet(scenario, end_of_life=_aged(scenario), quick=True, workers=2, out=tmp_path)
    assert len(set(finished)) == len(finished), "a finished task ran again"
    assert by_workers.keys() >= {"scan", "trials", "at_rate", "sequence"}
    for name in REPRODUCED:
        assert (tmp_path / name).read_bytes() == (written / name).read_bytes(), name


def test_another_scenario_does_not_replace_a_datasheet(scenario: Scenario, written: Path) -> None:
    with pytest.raises(Exception, match="datasheet"):
        datasheet(scenario.with_values(seed=99), quick=True, out=written)
