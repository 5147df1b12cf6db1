"""Small mistakes on the command line and in files: each is one clear line that says what to do, before any work."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from PIL import Image

from simulator.checks import load_scenario
from simulator.cli import main
from simulator.scenario.errors import ScenarioError
from startracker import Camera, InputError
from startracker.geometry.distortion import Distortion
from startracker.images.reading import read_image


@pytest.fixture
def command(capsys, monkeypatch):
    """Run a command; its exit status, output and errors."""

    def run(*arguments):
        monkeypatch.setattr("sys.argv", ["boresight", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return ended.value.code, printed.out, printed.err

    return run


@pytest.fixture
def fails(command):
    """Run a command that must exit with status 2; its single line of error."""

    def run(*arguments):
        status, _, errors = command(*arguments)
        assert status == 2
        (line,) = errors.splitlines()
        return line

    return run


def test_misspelt_target_is_refused_when_the_scenario_is_read():
    with pytest.raises(ScenarioError, match=r"^--set pointing\.target: .*did you mean 'Betelgeuse'"):
        load_scenario("cubesat", ["pointing.target=Betelguese"])


@pytest.mark.parametrize("name", ["Betelgeuse", "betel geuse", "Alp Ori", "HIP 27989", "Jupiter"])
def test_stars_go_by_their_proper_names_too(name):
    assert load_scenario("cubesat", [f"pointing.target={name}"]).pointing.target == name


@pytest.mark.parametrize("more", ["sky.planets=false", "sky.magnitude_limit=1.0"])
def test_a_target_must_be_in_the_sky_that_is_rendered(more):
    target = "Jupiter" if "planets" in more else "33 Psc"
    with pytest.raises(ScenarioError, match=r"sky\.(planets|magnitude_limit)"):
        load_scenario("cubesat", [f"pointing.target={target}", more])


def test_a_scenario_is_no_camera_file(fails, tmp_path):
    path = tmp_path / "x.yaml"
    path.write_text("name: x\norbit: {}\noptics: {}\ndetector: {}\ntracker: {}\n")
    picture = tmp_path / "a.png"
    Image.fromarray(np.zeros((64, 64), np.uint8)).save(picture)
    line = fails("solve", str(picture), "--camera", str(path))
    assert "not a camera file" in line
    assert len(line) < 200


def test_base_may_be_the_name_of_a_scenario_that_ships(tmp_path, monkeypatch):
    mine = tmp_path / "mine.yaml"
    mine.write_text("base: cubesat\nname: mine\n")
    assert load_scenario(mine).optics == load_scenario("cubesat").optics
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cubesat").write_text("base: sunsat\nname: cubesat\n")  # a file beside it comes first
    assert load_scenario("mine.yaml").optics == load_scenario("sunsat").optics


@pytest.mark.parametrize("text", ["2026-02-30", "2026-13-01T00:00:00Z", "2026-03-21T25:00:00"])
def test_a_date_that_does_not_exist_is_called_so(fails, text):
    line = fails("render", "cubesat", "--at", text)
    assert "no such date or time" in line
    with pytest.raises(ScenarioError, match="no such date or time"):
        load_scenario("cubesat", [f"epoch='{text}'"])


def test_what_is_no_date_at_all_still_is_none(fails):
    assert "is not an ISO 8601 time" in fails("render", "cubesat", "--at", "tomorrow")


@pytest.mark.parametrize(
    "arguments",
    [("solve", "a.png", "--annotate", "out.gif"), ("render", "cubesat", "--preview", "out.bmp"),
     ("calibrate", "a.png", "--plot", "out")],
)  # fmt: skip
def test_pictures_are_written_in_the_format_of_their_suffix_or_not_at_all(fails, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    Image.fromarray(np.zeros((64, 64), np.uint8)).save("a.png")
    assert "png, jpg, jpeg, svg or pdf" in fails(*arguments)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png"]


@pytest.mark.parametrize(
    ("suffix", "start"),
    [("svg", b"<?xml"), ("pdf", b"%PDF"), ("png", b"\x89PNG"), ("jpg", b"\xff\xd8\xff"), ("JPEG", b"\xff\xd8\xff")],
)
def test_annotated_pictures_in_each_format(command, tmp_path, suffix, start):
    picture = tmp_path / "a.png"
    Image.fromarray(np.zeros((64, 64), np.uint8)).save(picture)
    out = tmp_path / f"out.{suffix}"
    assert command("solve", picture, "--annotate", out)[0] == 1
    assert out.read_bytes().startswith(start)


def test_several_images_get_a_picture_each_in_a_folder(command, fails, tmp_path):
    (tmp_path / "in").mkdir()
    for name in ("a.png", "b.png", "a.bmp"):
        Image.fromarray(np.zeros((64, 64), np.uint8)).save(tmp_path / "in" / name)
    assert command("solve", tmp_path / "in", "--annotate", tmp_path / "out", "--wcs", tmp_path / "wcs")[0] == 1
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a-png.png", "a.png", "b.png"]
    assert not [*(tmp_path / "wcs").iterdir()]  # nothing is solved
    assert "name a folder" in fails("solve", tmp_path / "in", "--annotate", tmp_path / "out.png")
    assert command("solve", tmp_path / "in" / "b.png", "--annotate", tmp_path / "out")[0] == 1


def test_an_image_comes_from_standard_input(command, fails, tmp_path, monkeypatch):
    picture = io.BytesIO()
    Image.fromarray(np.zeros((64, 64), np.uint8)).save(picture, "png")
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(picture.getvalue())))
    status, answer, _ = command("solve", "-", "--annotate", tmp_path / "a.svg")
    assert status == 1
    assert answer.startswith("standard-input: ")
    assert (tmp_path / "a.svg").is_file()
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"")))
    assert fails("solve", "-").startswith("standard-input: is empty")
    assert "only once" in fails("solve", "-", "-")


@pytest.mark.parametrize(
    ("options", "says"),
    [(("--time", "yesterday"), "--time: 'yesterday' is not an ISO 8601 time"), (("--time", "2090-01-01"), "1899-07-29"),
     (("--colour",), "--annotate")],
)  # fmt: skip
def test_options_of_annotated_pictures(fails, tmp_path, options, says):
    picture = tmp_path / "a.png"
    Image.fromarray(np.zeros((64, 64), np.uint8)).save(picture)
    assert says in fails("solve", picture, *options)


def test_a_method_without_a_camera_is_refused(fails, tmp_path):
    picture = tmp_path / "a.png"
    Image.fromarray(np.zeros((64, 64), np.uint8)).save(picture)
    assert "--method needs --camera or --fov" in fails("solve", str(picture), "--method", "pyramid")


@pytest.mark.parametrize("suffix", ["png", "tiff"])  # Pillow turns TIFF by itself, and nothing else
@pytest.mark.parametrize("orientation", range(2, 9))
def test_exif_orientation_is_followed_as_viewers_do(tmp_path, orientation, suffix):
    from PIL import ImageOps

    stored = np.random.default_rng(1).integers(0, 255, (24, 40), np.uint8)
    exif = Image.Exif()
    exif[274] = orientation
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(stored).save(path, exif=exif)
    (tagged := Image.fromarray(stored)).getexif()[274] = orientation
    wanted = np.asarray(ImageOps.exif_transpose(tagged))
    upright, kept = read_image(path), read_image(path, upright=False)
    np.testing.assert_array_equal(upright.image, wanted)
    assert any(f"orientation {orientation} applied" in note for note in upright.notes)
    np.testing.assert_array_equal(kept.image, stored)
    assert any(f"orientation {orientation} not applied" in note for note in kept.notes)


def test_the_orientation_stands_in_the_answer(command, tmp_path):
    exif = Image.Exif()
    exif[274] = 6
    picture = tmp_path / "a.jpg"
    Image.fromarray(np.zeros((64, 96), np.uint8)).save(picture, exif=exif)
    _, answer, _ = command("solve", picture, "--json")
    assert any("orientation 6 applied" in note for note in json.loads(answer)["notes"])


def test_field_of_view_is_the_angle_between_the_edges_that_the_camera_sees():
    camera = Camera.from_fov(20.0, 1000, 600, Distortion(k1=-0.3))
    edges = camera.unproject([[-0.5, camera.cy], [999.5, camera.cy]])
    # arccos of the scalar product, good to 1e-8 at 20°
    assert camera.fov_deg == pytest.approx(np.degrees(np.arccos(edges[0] @ edges[1])), abs=1e-6)
    assert camera.undistorted_fov_deg == pytest.approx(20.0, abs=1e-9)
    assert camera.fov_deg > 20.1  # barrel distortion shows more sky
    with pytest.raises(InputError):
        Camera.from_dict({"width": 3})
