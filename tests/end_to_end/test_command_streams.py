"""Standard streams of the command that are full, closed or limited to ASCII, and a home folder that is read-only."""

import os
import subprocess
import sys

import pytest

from simulator.cli import streams

LIGHT = ["--help", "show cubesat"]
OTHERS = ["--version", "", "schema", "run --help", "study --help", "validate cubesat"]
FULL = "/dev/full"
HERE = {"PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
pytestmark = pytest.mark.skipif(not os.path.exists(FULL), reason="needs /dev/full")


def command(words, redirection="", **environment):
    """Status, standard output and standard error of a command under a shell's redirection."""
    line = f'exec "$0" -m simulator.cli {words} {redirection}'
    return subprocess.run(
        ["sh", "-c", line, sys.executable],
        capture_output=True,
        env=os.environ | HERE | environment,
        check=False,
        timeout=300,
    )


@pytest.mark.parametrize("words", [*LIGHT, *(pytest.param(words, marks=pytest.mark.system) for words in OTHERS)])
def test_lost_output_is_one_line_and_status_2(words):
    done = command(words, f">{FULL}")
    assert done.returncode == 2
    assert done.stderr == b"standard output cannot be written (No space left on device); part of the text is lost\n"


@pytest.mark.parametrize(
    ("redirection", "says"),
    [
        (">&-", "standard output is closed; send it to a file, or to /dev/null\n"),
        pytest.param(f">{FULL} 2>{FULL}", "", marks=pytest.mark.system),
        pytest.param(f">{FULL} 2>&-", "", marks=pytest.mark.system),
    ],
)
def test_closed_streams(redirection, says):
    done = command("validate cubesat", redirection)
    assert (done.returncode, done.stderr.decode()) == (2, says)


@pytest.mark.system
def test_output_without_a_buffer():
    done = command("show cubesat", f">{FULL}", PYTHONUNBUFFERED="1")
    assert done.returncode == 2
    assert done.stderr.count(b"\n") == 1


def test_a_mistake_keeps_its_status_when_it_cannot_be_said():
    assert command("validate nosuch", f"2>{FULL}").returncode == 2


@pytest.mark.system
def test_a_closed_error_stream():
    assert command("validate nosuch", "2>&-").returncode == 2
    assert command("validate cubesat", "2>&-").stdout == b"cubesat: ok\n"


@pytest.mark.parametrize("words", [pytest.param("show cubesat", marks=pytest.mark.system), "--help"])
def test_a_reader_that_has_gone_ends_the_command_silently(words):
    line = f'{{ "$0" -m simulator.cli {words}; echo $? >&2; }} | true'
    shell = ["sh", "-c", line, sys.executable]
    done = subprocess.run(shell, capture_output=True, env=os.environ | HERE, check=False)
    assert done.stderr == b"141\n"


def test_a_closed_input():
    done = command("solve -", "<&-")
    assert done.returncode == 2
    assert done.stderr.startswith(b"-: standard input is closed; send an image to it")
    assert done.stderr.count(b"\n") == 1


@pytest.mark.parametrize(
    ("words", "environment"),
    [
        ("show cubesat", {"LC_ALL": "POSIX", "PYTHONUTF8": "0"}),
        pytest.param("schema", {"PYTHONIOENCODING": "ascii"}, marks=pytest.mark.system),
        ("--help", {"PYTHONIOENCODING": "ascii"}),
    ],
)
def test_output_in_ascii(words, environment):
    done = command(words, **environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.isascii()
    assert done.stdout


def test_characters_are_spelled_out():
    for text, plain in {
        "residual 19.4″ rms": "residual 19.4 arcsec rms",
        "42.5° × 28.9°": "42.5 deg x 28.9 deg",
        "1°/s, 3°12′": "1 deg/s, 3 deg 12 arcmin",
        "5 µm, 3 σ, 1 − 2, λ²": "5 um, 3 sigma, 1 - 2, lambda^2",
        "Ünïcöde 猫": "Unicode ?",
    }.items():
        assert streams.as_written(text, "ascii") == plain
        assert streams.as_written(text, "utf-8") == text
    assert streams.as_written("19.4″ at 3°", "latin-1") == "19.4 arcsec at 3°"
    assert "caf\udce9 °".encode("utf-8", "boresight.plain") == b"caf\xe9 \xc2\xb0"


def test_a_file_name_that_is_not_text_is_printed(tmp_path):
    name = os.fsencode(tmp_path) + b"/\xff.yaml"
    with open(name, "w") as file:
        file.write("base: cubesat\n")
    arguments = [sys.executable, "-m", "simulator.cli", "validate", name]
    done = subprocess.run(arguments, capture_output=True, env=os.environ | HERE, check=False)
    assert (done.returncode, done.stdout) == (0, name + b": ok\n")


@pytest.mark.system
@pytest.mark.parametrize(
    "words", ["solve sample", "solve sample --json", "run cubesat --trials 2 --workers 1 --out", "render cubesat --out"]
)
def test_lost_output_of_work(words, tmp_path):
    target = {"run": tmp_path / "run", "render": tmp_path / "frame.fits"}.get(words.split()[0])
    done = command(f"{words} {target or ''}", f">{FULL}")
    assert (done.returncode, done.stderr.count(b"\n")) == (2, 1), done.stderr
    assert target is None or target.exists()


@pytest.mark.system
def test_work_in_ascii_and_with_a_read_only_home(tmp_path):
    """Nothing can be created below the null device, not even by root."""
    plain = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "HOME": "/dev/null/home"}
    solved = command(f"solve sample --explain --annotate {tmp_path}/solved.png", **plain)
    assert (solved.returncode, solved.stderr) == (0, b"")
    assert solved.stdout.isascii()
    assert b" arcsec rms" in solved.stdout
    study = command(f"run cubesat --trials 2 --workers 1 --out {tmp_path}/run", **plain)
    assert (study.returncode, study.stderr) == (0, b"")
    assert study.stdout.isascii()
    lines = [line for line in study.stdout.decode().splitlines() if line.startswith(("|", "+"))]
    assert len(lines) > 10
