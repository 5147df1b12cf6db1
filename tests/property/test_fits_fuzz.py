"""Damaged FITS frames: each is read as it was written, or is one clear line; nothing else reaches the user."""

import random
import sys
import warnings

import numpy as np
import pytest

from simulator.cli import _run
from simulator.fits import read_fits, write_fits
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from startracker.errors import InputError

CARD = 80
SMALL = ["detector.width=96", "detector.height=80"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A frame with its checksums, and one without: there the values themselves have to be checked."""
    frame, truth = Renderer(Scenario.load("cubesat_ideal", SMALL)).frame(0)
    file = tmp_path_factory.mktemp("frame") / "frame.fits"
    write_fits(file, frame, truth)
    data = file.read_bytes()
    bare = bytearray(data)
    for name in (b"CHECKSUM", b"DATASUM "):
        at = 0
        while (at := bare.find(name, at)) >= 0:
            bare[at : at + CARD] = b"COMMENT".ljust(CARD)
    return data, bytes(bare)


@pytest.fixture
def nothing_ignored(monkeypatch):
    """Exceptions that Python can only print ("Exception ignored in …")."""
    seen = []
    monkeypatch.setattr(sys, "unraisablehook", lambda found: seen.append(found.exc_value))
    yield seen
    assert not seen


def mutated(data, rng):
    data = bytearray(data)
    cards = data.find(b"END".ljust(CARD)) // CARD
    kind = rng.randrange(6)
    if kind == 0:  # bytes anywhere
        for _ in range(rng.choice([1, 2, 16])):
            data[rng.randrange(len(data))] = rng.randrange(256)
    elif kind == 1:  # bytes of the header's first cards, which the reader takes
        for _ in range(rng.choice([1, 2, 8])):
            data[rng.randrange(CARD * min(cards, 60))] = rng.randrange(256)
    elif kind == 2:  # truncated
        del data[rng.randrange(len(data)) :]
    elif kind == 3:  # a card blanked, as an editor removes it
        card = rng.randrange(cards)
        data[CARD * card : CARD * (card + 1)] = b" " * CARD
    elif kind == 4:  # a card over another
        to, of = rng.randrange(cards), rng.randrange(cards)
        data[CARD * to : CARD * (to + 1)] = data[CARD * of : CARD * (of + 1)]
    else:  # a value replaced
        card = rng.randrange(cards)
        value = rng.choice(
            [b"'text'", b"T", b"1E400", b"-1", b"0", b"1E300", b"12345678901234567890", b"'", b"", b"NaN"]
        )
        data[CARD * card + 10 : CARD * (card + 1)] = value.rjust(20).ljust(CARD - 10)
    return bytes(data)


def assert_clear(text, file):
    assert str(file) in text
    assert len(text.strip().splitlines()) == 1
    assert "Traceback" not in text


@pytest.mark.parametrize("count", [200, pytest.param(6000, marks=pytest.mark.slow)])
def test_reader(whole, tmp_path, nothing_ignored, count):
    rng = random.Random(7)
    original = dict(zip(whole, (1, 0), strict=True))
    file = tmp_path / "m.fits"
    file.write_bytes(whole[0])
    image = read_fits(file).image
    for _ in range(count):
        data = rng.choice(whole)
        changed = mutated(data, rng)
        file.write_bytes(changed)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                frame = read_fits(file)
            except InputError as error:
                assert_clear(str(error), file)
                continue
        if original[data]:  # a checksum lets nothing through but what it does not cover, or was not changed
            assert np.array_equal(frame.image, image)


@pytest.mark.parametrize("count", [60, pytest.param(3000, marks=pytest.mark.slow)])
def test_solve(whole, tmp_path, capsys, nothing_ignored, count):
    rng = random.Random(11)
    file = tmp_path / "m.fits"
    for _ in range(count):
        file.write_bytes(mutated(whole[1], rng))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            code = _run(["solve", str(file)])
        told = capsys.readouterr()
        assert code in (0, 1, 2)
        if code == 2:
            assert_clear(told.err, file)
        else:
            assert not told.err


@pytest.mark.parametrize(
    ("card", "value", "words"),
    [
        ("RDNOISE", None, "RDNOISE is missing from its header"),
        ("CAM_K4", None, "CAM_K4 is missing from its header"),
        ("CAM_FX", 0.0, "the focal length must be positive"),
        ("CAM_FX", "wide", "CAM_FX in its header must be a number, not 'wide'"),
        ("CAM_PROJ", "mercator", "projection must be"),
        ("CAM_PROJ", 3, "CAM_PROJ in its header must be a text, not 3"),
        ("CAM_PAR", 7, "parity must be 1 or -1"),
        ("GAIN", -2.0, "GAIN in its header cannot be -2"),
        ("JEPOCH", 1e6, "JEPOCH in its header cannot be 1e+06"),
        ("PRI_QY", None, "PRI_QY is missing from its header"),
        ("EXPTIME", True, "EXPTIME in its header must be a number, not True"),
    ],
)
def test_values_that_are_missing_or_impossible_are_named(whole, tmp_path, card, value, words):
    from astropy.io import fits

    file = tmp_path / "m.fits"
    file.write_bytes(whole[1])
    with fits.open(file, mode="update") as units:
        if value is None:
            del units[0].header[card]
        else:
            units[0].header[card] = value
    with pytest.raises(InputError) as told:
        read_fits(file)
    assert_clear(str(told.value), file)
    assert words in str(told.value)


def test_a_changed_pixel_or_header_does_not_match_the_checksum(whole, tmp_path):
    file = tmp_path / "m.fits"
    end = whole[0].find(b"END".ljust(CARD))
    first_pixel = -(-(end + CARD) // 2880) * 2880
    exposure = whole[0].find(b"EXPTIME =")
    for at, what in ((first_pixel, "image"), (exposure + 29, "header")):
        data = bytearray(whole[0])
        data[at] ^= 1
        file.write_bytes(data)
        with pytest.raises(InputError, match=f"{file}: its {what} does not match its checksum.*remove the cards"):
            read_fits(file)
