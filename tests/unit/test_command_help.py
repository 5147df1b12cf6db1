"""Help, suggestions, completion, progress: what a new user reads on the terminal."""

import os
import re
import subprocess
import sys

import pytest

from simulator.cli import main
from simulator.cli.application import _COMMANDS
from simulator.cli.options import complete_key, complete_scenario
from simulator.cli.study_command import STUDIES
from simulator.cli.terminal import WorkBar, times_text
from simulator.scenario.files import included_scenarios


@pytest.fixture
def command(capsys, monkeypatch):
    def run(*arguments):
        monkeypatch.setattr("sys.argv", ["boresight", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return ended.value.code, printed.out, printed.err

    return run


def test_the_command_alone_says_what_to_try_first(command):
    status, text, _ = command()
    assert status == 0
    assert "Try first:" in text
    for name in included_scenarios():
        assert name.rpartition("/")[2] in text
    assert max(map(len, text.splitlines())) <= 125


def test_help_lists_run_first_and_export_last(command):
    _, text, _ = command("--help")
    names = [name for name, *_ in _COMMANDS] + ["study"]
    order = sorted(names, key=lambda name: text.index(f" {name} "))
    assert order[0] == "run"
    assert order[-1] == "export-c"
    for group in ("Simulate", "Solve frames and photographs", "Results", "Scenarios", "Flight software"):
        assert f"─ {group} " in text


@pytest.mark.parametrize(
    "words", [(name,) for name, *_ in _COMMANDS] + [("study", name) for name in STUDIES], ids=" ".join
)
def test_every_command_has_an_example_of_itself(command, words):
    status, text, _ = command(*words, "--help")
    assert status == 0
    flat = " ".join(text.split())
    assert f"Example: boresight {' '.join(words)}" in flat
    assert not re.search(r"\{[a-z]", flat.partition("╭")[0])  # an argument without a metavar of its own


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("rnder",), "boresight: 'rnder' is not a command; did you mean 'render'?"),
        (("quux",), "'quux' is not a command; choose from run, render,"),
        (("study", "coverge"), "boresight study: 'coverge' is not a study; did you mean 'coverage'?"),
        (("run", "cubesat", "--trails", "3"), "boresight run: --trails: no such option; did you mean '--trials'?"),
        (("run", "cubesat", "--trials", "x"), "'--trials': must be a whole number (see boresight run --help)"),
        (("run", "cubsat"), "cubsat: no such file; did you mean 'cubesat'?"),
        (("show", "scenarios/cubesatt.yaml"), "did you mean"),
        (("show", "gallery/mon"), "did you mean"),
        (("validate", "nothing_like_it"), "included are cbers2, constellation, cruise, "),
        (("show", "cubesat", "--set", "optics.apertur_mm=3"), "did you mean 'optics.aperture_mm'?"),
        (("show", "cubesat", "--set", "pointing.target=Sirus"), "did you mean 'Sirius'?"),
        (("show", "cubesat", "--set", "tracker.identifier=piramid"), "did you mean 'pyramid'?"),
        (("sweep", "cubesat", "--over", "optics.apertur_mm=1:2:3"), "did you mean 'optics.aperture_mm'?"),
    ],
)
def test_mistakes_are_one_line_that_suggests(command, arguments, says):
    status, _, errors = command(*arguments)
    assert status == 2
    (line,) = errors.splitlines()
    assert says in line


@pytest.mark.parametrize("name", ["moon", "gallery/moon", "cubesat"])
def test_a_base_accepts_what_a_command_accepts(command, tmp_path, name):
    assert command("validate", name)[1] == f"{name}: ok\n"
    (tmp_path / "mine.yaml").write_text(f"base: {name}\nname: mine\n")
    assert command("validate", str(tmp_path / "mine.yaml"))[0] == 0
    (tmp_path / "mine.yaml").write_text("base: cubsat\nname: mine\n")
    assert "mine.yaml:1:1: base: no such file: " in (line := command("validate", str(tmp_path / "mine.yaml"))[2])
    assert "did you mean 'cubesat'?" in line


def test_an_interrupt_is_one_line(command, monkeypatch):
    def interrupt(_):
        raise KeyboardInterrupt

    monkeypatch.setattr("simulator.cli.scenario_commands.validate", interrupt)
    assert command("validate", "cubesat") == (130, "", "boresight: interrupted\n")


def test_shells_complete_scenarios_and_keys():
    assert complete_scenario("cub") == ["cubesat", "cubesat_ideal"]
    assert "gallery/moon" in complete_scenario("gallery/")
    assert complete_key("optics.ap") == ["optics.aperture_mm="]
    environment = os.environ | {
        "_BORESIGHT_COMPLETE": "complete_bash", "COMP_WORDS": "boresight render moo", "COMP_CWORD": "2"
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-m", "simulator.cli"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["moon"]


@pytest.mark.parametrize(
    ("elapsed_s", "left_s", "text"),
    [
        (0.4, None, "elapsed 0:00"),
        (240.0, 118.0, "elapsed 4:00, about 2 min left"),
        (59.9, 3.0, "elapsed 0:59, about 5 s left"),
        (61.0, 44.0, "elapsed 1:01, about 45 s left"),
        (3700.0, 3580.0, "elapsed 1:01:40, about 1 h left"),
        (10.0, 4900.0, "elapsed 0:10, about 1 h 20 min left"),
    ],
)
def test_progress_in_words(elapsed_s, left_s, text):
    assert times_text(elapsed_s, left_s) == text


def test_time_left_does_not_count_what_was_resumed():
    now = [0.0]
    bar = WorkBar("cubesat", "trials", 300, clock=lambda: now[0])
    bar.show(100, 300)
    assert bar.times == "elapsed 0:00"
    now[0] = 60.0
    bar.show(200, 300)
    assert bar.times == "elapsed 1:00, about 1 min left"
