"""``boresight study environment``: its figures agree with each other, its files are complete, mistakes are one line."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from simulator import Scenario
from simulator.cli.environment_command import environment_study
from simulator.environment.coefficients import COEFFICIENTS
from simulator.study.environment.survey import ANOMALY_CM2_S, survey
from startracker.errors import InputError

pytest.importorskip("aep8")
AGED = ["environment.age_years=4", "environment.solar_proton_events=2"]


@pytest.fixture(scope="module")
def result():
    return survey(Scenario.load("aged", AGED))


def test_month_and_day_see_the_same_orbit(result):
    """Means over a day and over a month: the anomaly's ten passes a day differ; a factor of 1.5."""
    for name in ("trapped_protons", "trapped_electrons"):
        day, month = (np.sum(getattr(track.flux, name)) / len(track.t_s) for track in (result.day, result.month))
        assert day == pytest.approx(month, rel=0.5)
    assert np.abs(result.month.latitude_deg).max() == pytest.approx(81.4, abs=0.5)  # 180° − 98.6°


def test_passes_are_counted(result):
    protons = result.day.flux.trapped_protons.sum(axis=1)
    passes = result.anomaly()
    inside = protons > ANOMALY_CM2_S
    assert passes["share_of_time"] == np.mean(inside)
    assert 6 <= passes["passes"] <= 20  # 14 orbits a day, some crossing it twice, some not


def test_ageing_begins_with_a_new_camera_and_grows(result):
    for rows in result.ageing.values():
        assert rows[0].mean_dark_e_s == 0.0
        assert rows[0].transmission == 1.0
        dark = [row.mean_dark_e_s for row in rows]
        assert dark == sorted(dark)
    assert result.at_age("low").mean_dark_e_s < result.at_age().mean_dark_e_s < result.at_age("high").mean_dark_e_s
    assert result.shields[3.0].ionising_krad == pytest.approx(result.at_age().detector_dose.ionising_krad, rel=1e-12)


def test_thicker_shields_give_less(result):
    for part in ("protons_krad", "electrons_krad", "solar_krad", "displacement_mev_g"):
        values = [getattr(dose, part) for dose in result.shields.values()]
        assert values == sorted(values, reverse=True)


def test_files_of_the_command(tmp_path, capsys):
    assert environment_study("aged", AGED, tmp_path / "out") == 0
    printed = capsys.readouterr().out
    for words in ("South Atlantic Anomaly", "dose in silicon", "random telegraph pixels"):
        assert words in printed
    values = json.loads((tmp_path / "out" / "environment.json").read_text())
    assert values["environment"]["age_years"] == 4
    assert [row["name"] for row in values["coefficients"]] == list(COEFFICIENTS)
    assert values["identity"]["kind"] == "environment"
    table = pq.read_table(tmp_path / "out" / "environment.parquet")
    assert table.num_rows == 2880
    for name in ("particles.png", "ageing.png"):
        assert (tmp_path / "out" / name).stat().st_size > 20_000


def test_a_scenario_without_radiation_is_refused():
    with pytest.raises(InputError, match=r"add --set environment\.trapped=ap8"):
        survey(Scenario.load("cubesat_ideal"))


def test_the_document_lists_the_coefficients():
    from pathlib import Path

    page = (Path(__file__).parents[2] / "docs" / "environment.md").read_text(encoding="utf-8")
    for c in COEFFICIENTS.values():
        assert f"| `{c.name}` | {c.unit} | {c.value:g} |" in page
        assert c.source in page
