"""``boresight study yee1999`` as a user meets it: bare, for a list of centroids, and what it refuses."""

import csv
import json

import numpy as np
import pytest

from simulator.cli import _run
from simulator.theses.yee1999.picture import analyse, vega

pytestmark = pytest.mark.system

CAMERA = ["--size", "427x319", "--fov", "9.0130x6.9049"]


@pytest.fixture
def centroids(tmp_path):
    def write(xy, header="x,y"):
        path = tmp_path / "centroids.csv"
        with path.open("w", newline="") as stream:
            stream.write(header + "\n")
            csv.writer(stream).writerows(np.asarray(xy).tolist())
        return ["--centroids", str(path)]

    return write


def read(tmp_path, *arguments):
    file = tmp_path / "out.json"
    assert _run(["study", "yee1999", *arguments, "--json", str(file)]) == 0
    return json.loads(file.read_text())


def check_vega(found):
    assert found["separations"] == pytest.approx(
        [3.8045, 1.8857, 1.6315, 4.2873, 1.9725, 3.2715, 6.8250, 1.9924, 5.1148, 5.9112], abs=5e-5
    )
    assert len(found["pair_counts"]) == 10
    assert len(found["triads"]) == 26
    assert [group["size"] for group in found["groups"]] == [1, 12, 1, 1, 1, 8, 1, 1]
    assert found["matches"] == [7001, 17139, 17056, 17051, 6872]
    assert np.abs(np.array(found["center_deg"]) - [278.45703, 37.24007]).max() < 0.05 / 3600
    assert np.array(found["residuals_deg"]).shape == (5, 2)
    assert {vote["hr"]: vote["frequency"] for vote in found["votes"][1]} == {7139: 8, 7131: 4, 17139: 12}


def test_the_bare_command(tmp_path, capsys):
    out = tmp_path / "study"
    found = read(tmp_path, "--out", str(out), "--section", "vega", "--point", "0,0")
    check_vega(found)
    point = found["points"][0]
    assert [point["ra_deg"], point["dec_deg"]] == pytest.approx(found["center_deg"], abs=1e-6)
    printed = capsys.readouterr().out
    assert "26 triads in 8 groups" in printed
    assert "RA 278.45703°, Dec +37.24006°" in printed
    table = json.loads((out / "yee1999.json").read_text())
    assert table["verdicts"]["exact"] == 39
    assert sorted(path.name for path in out.iterdir()) == [
        "fig_4_4_vega.png",
        "table_4_2_rotations.png",
        "yee1999.json",
    ]


def test_a_list_of_centroids(tmp_path, centroids):
    check_vega(read(tmp_path, *centroids(vega().xy_px), *CAMERA, "--edition", "4"))


def test_columns_rows_and_flux_in_any_order(tmp_path, centroids):
    corner = vega().xy_px * [1, -1] + [213.0, 159.0]
    shuffled = [2, 0, 4, 1, 3]
    flux = np.array([500.0, 400.0, 300.0, 200.0, 100.0])
    table = np.column_stack([corner, flux])[shuffled]
    check_vega(read(tmp_path, *centroids(table, "x,y,flux"), *CAMERA, "--edition", "4"))


def test_the_default_of_other_pictures_is_the_fifth_edition(tmp_path, centroids):
    found = read(tmp_path, *centroids(vega().xy_px), *CAMERA)
    assert found["edition"] == 5
    assert found["center_deg"] == pytest.approx([278.45703 + 15 * 0.1 / 3600, 37.24007], abs=1e-5)


def test_integers(tmp_path, centroids):
    found = read(tmp_path, *centroids(vega().xy_px), *CAMERA, "--edition", "4", "--integers")
    assert found["matches"] == [7001, 17139, 17056, 17051, 6872]


def test_no_answer_is_exit_status_1(tmp_path, centroids, capsys):
    file = tmp_path / "none.json"
    xy = [[0.0, 0.0], [100.0, -90.0], [-31.0, 17.0]]
    assert _run(["study", "yee1999", *centroids(xy), *CAMERA, "--json", str(file)]) == 1
    found = json.loads(file.read_text())
    assert found["center_deg"] is None
    assert found["matches"] == [None, None, None]
    assert "No centre" in capsys.readouterr().out


def test_three_stars_alone(tmp_path, centroids):
    picture = analyse(vega())
    at = picture.catalog.indices([7001, 6872, 6903])
    xy = picture.plate.image_xy(picture.catalog.sky_deg[at])
    asked = [
        *centroids(xy),
        *CAMERA,
        "--separation-tolerance-deg",
        "0.1",
        "--dec",
        "35:40",
        "--rotation-tolerance-deg",
        "15",
    ]
    assert _run(["study", "yee1999", *asked]) == 1
    assert read(tmp_path, *asked, "--three-stars")["matches"] == [7001, 6872, 6903]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--size", "427x319"], "Vega image"),
        (["--centroids", "no.csv"], "--size WxH and --fov"),
        (["--centroids", "no.csv", *CAMERA], "cannot be read"),
        (["--centroids", "no.csv", "--size", "427x319", "--fov", "9"], "--fov"),
        (["--edition", "3"], "--edition"),
        (["--dec", "30"], "--dec"),
        (["--vote-number", "0"], "--vote-number"),
        (["--rotation-tolerance-deg", "-1"], "--rotation-tolerance-deg"),
        (["--section", "nope"], "unknown section"),
        (["--json", "/nowhere/out.json"], "/nowhere"),
        (["--point", "1"], "1"),
    ],
)
def test_mistakes_are_one_line(arguments, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert _run(["study", "yee1999", *arguments]) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1
    assert says in told[0]
