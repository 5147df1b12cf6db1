"""What is not a sky ends in a status and a reason: never in an exception from inside, never in an attitude.

Pictures are drawn here, so that nothing but this file is needed: an animal's face, a town by night, a page of text,
waves, noise. Every one goes through the command line as a user would give it, without a hint and with one.
"""

import json
import math

import numpy as np
import pytest
from PIL import Image, ImageDraw

from simulator.cli import _run
from startracker import Camera, InputError, StarTracker, Status, solve_unknown_fov

UNSOLVED = (Status.NO_STARS, Status.TOO_FEW_STARS, Status.NO_MATCH, Status.AMBIGUOUS, Status.SEARCH_LIMIT)

SIZE = 320


@pytest.fixture
def solve(capsys):
    """Run ``boresight solve``; returns exit status, JSON objects, and what went to standard error."""

    def run(*arguments):
        capsys.readouterr()
        code = _run(["solve", "--json", *map(str, arguments)])
        told = capsys.readouterr()
        return code, [json.loads(line) for line in told.out.splitlines()], told.err

    return run


# ---------------------------------------------------------------------- pictures
def cat():
    picture = Image.new("RGB", (SIZE, SIZE), (120, 140, 90))
    draw = ImageDraw.Draw(picture)
    draw.ellipse((60, 80, 260, 280), fill=(190, 130, 70))
    for left in (70, 190):
        draw.polygon([(left, 120), (left + 25, 30), (left + 65, 95)], fill=(180, 120, 60))
        draw.ellipse((left + 30, 140, left + 65, 175), fill=(230, 220, 90))
        draw.ellipse((left + 43, 142, left + 52, 173), fill=(10, 10, 10))
    draw.polygon([(150, 205), (170, 205), (160, 218)], fill=(220, 120, 130))
    for dy in (-12, 0, 12):
        draw.line((150, 215, 40, 215 + 2 * dy), fill=(250, 250, 250), width=2)
        draw.line((170, 215, 280, 215 + 2 * dy), fill=(250, 250, 250), width=2)
    fur = np.random.default_rng(3).normal(0.0, 18.0, (SIZE, SIZE, 1))
    return np.clip(np.asarray(picture, float) + fur, 0, 255).astype(np.uint8)


def town():
    """Windows and street lamps: bright points in rows, by the hundred."""
    rng = np.random.default_rng(4)
    image = rng.normal(12.0, 3.0, (SIZE, SIZE))
    rows, columns = np.mgrid[0:SIZE, 0:SIZE]
    for _ in range(12):
        x, top = rng.integers(0, SIZE - 50), rng.integers(60, 250)
        for row in range(top, SIZE, 14):
            for column in range(x, x + 48, 12):
                if rng.random() < 0.5:
                    image[row : row + 4, column : column + 3] = rng.uniform(60, 255)
    for x in range(10, SIZE, 37):
        image += 200 * np.exp(-((columns - x) ** 2 + (rows - 300.0) ** 2) / 8.0)
    return np.clip(image, 0, 255).astype(np.uint8)


def page():
    picture = Image.new("L", (SIZE, SIZE), 250)
    draw = ImageDraw.Draw(picture)
    for y in range(8, SIZE - 12, 14):
        draw.text((8, y), "the quick brown fox jumps over the lazy dog . : ; ' , !", fill=20)
    return np.asarray(picture)


def grid_of_lamps():
    image = np.full((SIZE, SIZE), 10, np.uint8)
    image[20::30, 20::30] = 200
    image[21::30, 20::30] = 160
    image[20::30, 21::30] = 150
    return image


def waves():
    rows, columns = np.mgrid[0:SIZE, 0:SIZE]
    return (127 + 100 * np.sin(rows / 9.0) * np.cos(columns / 7.0)).astype(np.uint8)


def noise():
    return np.random.default_rng(5).integers(0, 256, (SIZE, SIZE)).astype(np.uint8)


def two_stars():
    image = np.random.default_rng(6).normal(20.0, 2.0, (SIZE, SIZE))
    rows, columns = np.mgrid[0:SIZE, 0:SIZE]
    for x, y in ((80.0, 100.0), (210.0, 240.0)):
        image += 150 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 3.0)
    return image.astype(np.uint8)


PICTURES = {
    "cat": cat,
    "town": town,
    "page": page,
    "grid of lamps": grid_of_lamps,
    "waves": waves,
    "noise": noise,
    "two stars": two_stars,
    "black": lambda: np.zeros((SIZE, SIZE), np.uint8),
    "white": lambda: np.full((SIZE, SIZE), 255, np.uint8),
    "grey": lambda: np.full((SIZE, SIZE), 99, np.uint8),
    "one pixel": lambda: np.full((1, 1), 7, np.uint8),
    "one row": lambda: np.arange(200, dtype=np.uint8)[None, :],
    "half white": lambda: np.repeat(np.array([[0, 255]], np.uint8), 80, axis=1).repeat(100, axis=0),
    "one hot pixel": lambda: np.pad(np.array([[255]], np.uint8), 60),
}


@pytest.mark.parametrize("hint", [(), ("--fov", "20")], ids=["no hint", "fov given"])
@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_that_is_no_sky(tmp_path, solve, name, hint):
    file = tmp_path / "picture.png"
    Image.fromarray(PICTURES[name]()).save(file)
    code, (answer,), err = solve(file, *hint)
    assert code == 1
    assert not err
    assert answer["status"] in set(Status) - {"solved"}
    assert len(answer["reason"]) > 10
    assert answer["quaternion"] is None
    assert answer["ra_deg"] is None
    assert answer["steps"]


def test_an_unsolved_picture_is_drawn_with_its_reason_and_pixels_have_no_place(tmp_path, solve):
    file, picture, wcs = tmp_path / "cat.png", tmp_path / "seen.png", tmp_path / "seen.fits"
    Image.fromarray(cat()).save(file)
    code, (answer,), _ = solve(
        file, "--annotate", picture, "--grid", "--constellations", "--wcs", wcs, "--pixel", "5,6"
    )
    assert code == 1
    assert answer["pixels"] == [{"x": 5.0, "y": 6.0, "ra_deg": None, "dec_deg": None}]
    with Image.open(picture) as drawn:
        assert drawn.size[0] > 1000
    assert not wcs.exists()


# ---------------------------------------------------------------------- files
def test_files_that_cannot_be_read_are_one_line_each(tmp_path, solve):
    whole = tmp_path / "whole.png"
    Image.fromarray(cat()).save(whole)
    bad = {
        "empty.png": b"",
        "text.png": b"no picture at all, only words",
        "cut.png": whole.read_bytes()[:9000],
        "cut.fits": b"SIMPLE  =                    T" + b" " * 50,
        "zeros.tiff": bytes(500),
    }
    for name, content in bad.items():
        (tmp_path / name).write_bytes(content)
    for name in (*bad, "missing.png"):
        code, answers, err = solve(tmp_path / name)
        assert code == 2, name
        assert not answers
        assert err.count("\n") == 1
        assert name in err
        assert "Traceback" not in err


def test_an_empty_folder_and_a_folder_of_bad_and_good_files(tmp_path, solve):
    folder = tmp_path / "pictures"
    folder.mkdir()
    code, answers, err = solve(folder)
    assert (code, answers) == (2, [])
    assert "contains no image" in err
    (folder / "a.png").write_bytes(b"nothing")
    Image.fromarray(cat()).save(folder / "b.png")
    code, answers, err = solve(folder)
    assert code == 2  # the worst of them
    assert answers[0]["status"] != "solved"
    assert "a.png" in err


def test_a_fits_image_without_a_number_in_it(tmp_path, solve):
    from astropy.io import fits

    file = tmp_path / "nan.fits"
    fits.PrimaryHDU(np.full((40, 50), np.nan, np.float32)).writeto(file)
    code, answers, err = solve(file)
    assert (code, answers) == (2, [])
    assert "finite" in err


# ---------------------------------------------------------------------- arrays, as Python gives them
ARRAYS = {
    "nan": np.full((64, 64), np.nan),
    "infinite": np.full((64, 64), np.inf),
    "half nan": np.where(np.arange(64) < 32, np.nan, 5.0) * np.ones((64, 1)),
    "huge numbers": np.random.default_rng(1).normal(0, 1e300, (64, 64)),
    "negative": np.random.default_rng(1).normal(-1e4, 3.0, (64, 64)),
    "empty": np.zeros((0, 0)),
    "no rows": np.zeros((0, 64)),
    "one number": np.float64(3.0),
    "a line": np.arange(64.0),
    "colour": np.zeros((64, 64, 3)),
    "complex": np.zeros((64, 64), complex),
    "words": np.full((64, 64), "star"),
    "objects": np.full((64, 64), None),
    "truth": np.zeros((64, 64), bool),
    "int64": np.random.default_rng(1).integers(-(2**62), 2**62, (64, 64)),
}


@pytest.fixture(scope="module")
def tracker():
    return StarTracker(Camera.from_fov(12.0, 64, 64), magnitude_limit=5.0)


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_that_are_no_sky(tracker, name):
    for solution in (tracker.solve(ARRAYS[name]), solve_unknown_fov(ARRAYS[name])):
        assert solution.status is not Status.SOLVED
        assert solution.reason
        assert solution.attitude is None
        assert solution.covariance is None
        with pytest.raises(InputError, match="not solved"):
            solution.radec_of([1.0, 2.0])


# ---------------------------------------------------------------------- lists of centroids
ROWS = np.random.default_rng(8).uniform(0, 512, (12, 2))
LINE = np.stack([np.linspace(10, 500, 12), np.linspace(20, 400, 12)], axis=1)
CIRCLE = 256 + 200 * np.stack([np.cos(np.arange(12) * math.pi / 6), np.sin(np.arange(12) * math.pi / 6)], axis=1)
LISTS = {
    "one": ROWS[:1],
    "two": ROWS[:2],
    "nan": np.full((6, 2), np.nan),
    "nan among them": np.concatenate([ROWS[:2], [[np.nan, 5.0], [np.inf, np.inf]]]),
    "outside": ROWS + 5000,
    "far outside": ROWS * 1e200,
    "one star repeated": np.repeat(ROWS[:1], 30, axis=0),
    "three stars repeated": np.repeat(ROWS[:3], 10, axis=0),
    "a line": LINE,
    "a level line": LINE * [1, 0] + [0, 100],
    "a circle": CIRCLE,
    "a lattice": np.stack(np.meshgrid(np.arange(40, 500, 60), np.arange(40, 500, 60)), axis=-1).reshape(-1, 2) * 1.0,
    "a heap": 250 + 0.01 * ROWS,
    "random": ROWS,
}


@pytest.fixture(scope="module")
def list_tracker():
    return StarTracker(Camera.from_fov(12.0, 512, 512), magnitude_limit=5.5)


@pytest.mark.parametrize("name", LISTS)
def test_lists_that_are_no_sky(list_tracker, name):
    xy = np.asarray(LISTS[name], dtype=float)
    for flux in (None, np.arange(1.0, len(xy) + 1), np.zeros(len(xy)), np.full(len(xy), np.nan)):
        solution = list_tracker.solve_centroids(xy, flux)
        assert solution.status in UNSOLVED
        assert solution.reason
        assert solution.attitude is None
    solution = solve_unknown_fov(xy, 512, 512)
    assert solution.status in UNSOLVED
    assert solution.attitude is None
    assert [step.stage for step in solution.steps[:1]] == ["centroids"]


@pytest.mark.parametrize("name", ["nan among them", "one star repeated", "a line"])
def test_lists_as_files(tmp_path, solve, name):
    file = tmp_path / "stars.csv"
    np.savetxt(file, LISTS[name], delimiter=",", header="x,y", comments="")
    for arguments in ((), ("--fov", "12")):
        code, (answer,), err = solve("--centroids", file, "--size", "512x512", *arguments)
        assert (code, err) == (1, "")
        assert answer["status"] in ("no_stars", "too_few_stars", "no_match", "ambiguous")
        assert answer["reason"]
        assert answer["quaternion"] is None


@pytest.mark.parametrize("text", ["", "x,y\n", "# nothing\n\n"])
def test_an_empty_list(tmp_path, solve, text):
    file = tmp_path / "stars.csv"
    file.write_text(text)
    code, (answer,), _ = solve("--centroids", file, "--size", "512x512")
    assert (code, answer["status"]) == (1, "no_stars")


def test_a_very_large_image_of_nothing_is_answered(solve, tmp_path):
    file = tmp_path / "large.png"
    Image.fromarray(np.random.default_rng(2).integers(0, 9, (3000, 4000), dtype=np.uint8)).save(file)
    code, (answer,), _ = solve(file)
    assert code == 1
    assert answer["quaternion"] is None
