"""The flight build without a front end: `boresight export-c --from centroids`."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.flight_lists import FIELDS, field_list
from benchmarks.flight_tracker import lists_text
from simulator.checks import load_scenario
from simulator.cli.application import app
from simulator.randomness import stream
from simulator.study.exported_c.build import FLAGS, compile_export
from simulator.study.exported_c.fuzz import build_fuzzers, missing_fuzzer
from simulator.study.exported_c.targets import EMULATED, HOST
from simulator.study.flight.design import flight_design
from simulator.study.flight.library import FlightLibrary, Known, compiled_library
from simulator.study.flight.program import parse_answer
from startracker import StarTracker
from startracker.errors import InputError, InputWarning
from startracker.flight.design import IDENTIFIERS
from startracker.flight.export import flight_export

pytestmark = pytest.mark.system

needs_gcc = pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine")


@pytest.fixture(scope="module", params=IDENTIFIERS)
def frames_design(request):
    return flight_design(load_scenario(Path("tc211")), identifier=request.param)


@pytest.fixture(scope="module")
def design(frames_design):
    return replace(frames_design, detector=None)


@pytest.fixture(scope="module")
def lists(design):
    return lists_of(design)


def lists_of(design):
    tracker = StarTracker(design.camera, magnitude_limit=float(design.guide.v_mag[-1]))
    rng = stream(1, "from centroids")
    return [field_list(tracker, kind, rng).stars for kind in FIELDS.values() for _ in range(4)]


@pytest.fixture(scope="module")
def triads():
    """A design of triads, and lists."""
    design = replace(flight_design(load_scenario(Path("tc211")), identifier="triads"), detector=None)
    return design, lists_of(design)


def test_what_only_frames_need_is_left_out(design, frames_design):
    lists, frames = flight_export(design), flight_export(frames_design)
    assert lists.files.keys() < frames.files.keys()
    left_out = frames.files.keys() - lists.files.keys()
    assert {"tracker_front.h", "tracker_rows.c", "test_frames.c", "fuzz_pixels.h"} < left_out
    for name, text in (*lists.files.items(), *frames.files.items()):
        assert "TRACKER_CENTROIDS" not in text, name
        assert not re.search(r"<!--|@[A-Z_]+@", text), name
    for name, text in lists.files.items():
        code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
        assert not re.search(r"tracker_(row|finish)\b|TRACKER_FRONT|(test|fuzz)_fr", code), name
    assert "; from centroids; tables " in lists.files["tracker_tables.c"]
    assert sum(lists.table_bytes.values()) < sum(frames.table_bytes.values())


@needs_gcc
def test_lists_have_the_answers_of_the_build_of_frames(design, frames_design, lists, tmp_path):
    """Bit for bit, as both have the same sources from the list to the answer."""
    one, other = (FlightLibrary(compiled_library(made, tmp_path)) for made in (design, frames_design))
    answers = [one.solve_stars(stars, Known())[0] for stars in lists]
    assert answers == [other.solve_stars(stars, Known())[0] for stars in lists]
    assert sum(answer.status == "solved" for answer in answers) > 8


@needs_gcc
def test_command(tmp_path):
    words = ["export-c", str(tmp_path / "c"), "--magnitude-limit", "4.5", "--declination=-90:90", "--prefix", "north"]
    done = CliRunner().invoke(app, [*words, "--false-alarm-rate", "1e-9", "--vote-number", "3"])
    assert done.exit_code == 0, done.output
    for word in ("fixed, triads, from centroids", "tables", "context", "static buffers", "stack", "0 bytes", "ms"):
        assert word in done.output
    made = subprocess.run(["make", "-C", str(tmp_path / "c"), "solve", "test"], capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    assert "5 lists, 0 failed" in made.stdout
    said = subprocess.run([tmp_path / "c" / "solve", "frames"], capture_output=True, text=True)
    assert said.returncode == 2
    assert said.stderr == "solve stars | follow | version, with the lists of stars on standard input\n"


def test_command_for_a_scenario(tmp_path, monkeypatch):
    monkeypatch.setattr("simulator.cli.c_source.compiled_here", lambda export, folder: None)
    words = ["export-c", str(tmp_path / "c"), "--scenario", "tc211", "--from", "centroids", "--identifier", "triads"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "tc211" in done.output
    assert not (tmp_path / "c" / "tracker_front.h").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--from", "pixels"], "--from: must be frames or centroids"),
        (["--from", "frames"], "--from frames: needs --scenario"),
        (["--from", "centroids", "--scenario", "tc211", "--fov", "9x9"], "--fov: has no effect with --scenario"),
        (["--identifier", "adaptive", "--vote-number", "3"], "--vote-number: has no effect with --identifier adaptive"),
        (["--identifier", "pyramid"], "identifier must be adaptive or triads"),
        (["--arithmetic", "double"], "arithmetic must be fixed or float"),
        (["--set", "a=3"], "--set: has no effect without --scenario"),
        (["--fov", "9"], "--fov"),
        (["--fov", "95x9"], "--fov"),
        (["--size", "9"], "--size"),
        (["--declination", "90"], "--declination"),
        (["--magnitude-limit", "-3"], "magnitude limit -3"),
        (["--prefix", "9a"], "--prefix"),
        (["--prefix", "double_"], "--prefix"),
        (["--false-alarm-rate", "0"], "false_alarm_rate"),
        (["--false-alarm-rate", "2"], "false_alarm_rate"),
        (["--fov", "0.1x0.1"], "focal length"),
        (["--size", "40x30"], "pixels of at most 0.12"),
    ],
)
def test_mistakes(tmp_path, arguments, said):
    done = CliRunner().invoke(app, ["export-c", str(tmp_path / "c"), *arguments])
    assert isinstance(done.exception, InputError), done.output
    assert said in str(done.exception)
    assert not (tmp_path / "c").exists()


def test_options_of_the_former_integer_tracker_are_named_and_ignored(tmp_path, monkeypatch):
    monkeypatch.setattr("simulator.cli.c_source.compiled_here", lambda export, folder: None)
    options = ("--max-separation", "--centroid-error", "--resolution", "--edition")
    words = [word for option in options for word in (option, "4")]
    with pytest.warns(InputWarning, match="has no effect any more") as found:
        done = CliRunner().invoke(app, ["export-c", str(tmp_path / "c"), "--magnitude-limit", "3.5", *words])
    assert done.exit_code == 0, done.output
    assert {str(one.message).split(":")[0] for one in found} == set(options)


def run(*command, folder):
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


TWO_CAMERAS = """
#include <stdio.h>
#include <string.h>
#include "one.h"
#include "other_1.h"
static struct one_context a, b;
static struct other_1_context c;
int main(void)
{
    static const struct one_star star[] = {@};
    static struct other_1_star same[sizeof star / sizeof star[0]];
    static const struct one_frame_info nothing = {{0, 0, 0}, {{{{0, 0, 0}, {0, 0, 0}, {0, 0, 0}}}, 0}, 0, 0};
    static const struct other_1_frame_info other = {{0, 0, 0}, {{{{0, 0, 0}, {0, 0, 0}, {0, 0, 0}}}, 0}, 0, 0};
    const int count = (int)(sizeof star / sizeof star[0]);
    struct one_answer first, second;
    struct other_1_answer third;
    memcpy(same, star, sizeof star);
    one_start(&a, &nothing);
    one_solve_stars(&a, star, count, &first);
    other_1_start(&c, &other);
    other_1_solve_stars(&c, same, count, &third);
    one_start(&b, &nothing);
    one_solve_stars(&b, star, count, &second);
    printf("%d %d %d ", first.status == ONE_SOLVED, second.status == ONE_SOLVED, third.status == OTHER_1_SOLVED);
    printf("%d", memcmp(first.quaternion, second.quaternion, sizeof first.quaternion) == 0);
    return 0;
}
"""


@needs_gcc
@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++ on this machine")
def test_two_cameras_in_one_program_of_c_plus_plus(triads, tmp_path):
    """All names begin with the prefix; the other camera has pixels half as large again."""
    design, lists = triads
    camera = replace(design.camera, fx=1.5 * design.camera.fx, fy=1.5 * design.camera.fy)
    objects = []
    for export in (flight_export(design, "one"), flight_export(replace(design, camera=camera), "other_1")):
        for name, text in export.files.items():
            (tmp_path / name).write_text(text)
        sources = [f"{export.prefix}_{module}.c" for module in ("tables", *export.modules)]
        run("gcc", *FLAGS, "-c", *sources, folder=tmp_path)
        objects += [name[:-1] + "o" for name in sources]
    symbols = {
        line.split()[-1]
        for line in run("nm", "-g", "--defined-only", *objects, folder=tmp_path).splitlines()
        if " " in line
    }
    assert all(symbol.startswith(("one_", "other_1_")) for symbol in symbols)
    star = ", ".join("{{{}, {}, {}, {}u, {}}}".format(*row) for row in zip(*lists[0], strict=True))
    (tmp_path / "two.cpp").write_text(TWO_CAMERAS.replace("@", star))
    run("g++", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-o", "two", "two.cpp", *objects, folder=tmp_path)
    assert run(str(tmp_path / "two"), folder=tmp_path).split() == ["1", "1", "0", "1"]


@needs_gcc
def test_integers_need_no_floating_point_unit(triads, tmp_path):
    """gcc refuses this option where a floating-point register would be needed."""
    export = flight_export(triads[0])
    for name, text in export.files.items():
        (tmp_path / name).write_text(text)
    sources = [f"tracker_{module}.c" for module in export.modules]
    run("gcc", *FLAGS, "-mgeneral-regs-only", "-fsyntax-only", *sources, folder=tmp_path)


@pytest.mark.slow
@pytest.mark.skipif(missing_fuzzer() is not None, reason=str(missing_fuzzer()))
def test_fuzzers_compile(design, tmp_path):
    export = flight_export(design)
    names = [name[5:-2] for name in export.files if name.startswith("fuzz_") and name.endswith(".c")]
    assert sorted(names) == ["filter", "pose", "search", "session", "stars"]
    assert all(program.exists() for program in build_fuzzers(export, names, tmp_path).values())


@pytest.mark.slow
@needs_gcc
@pytest.mark.parametrize("target", EMULATED, ids=lambda target: target.name)
def test_every_processor_gives_the_same_bits(target, design, lists, tmp_path):
    if target.missing():
        pytest.skip(f"{target.missing()} is not installed (Debian: {target.debian})")
    build = compile_export(flight_export(design), tmp_path, target)
    here = FlightLibrary(compiled_library(design, tmp_path / "library"))
    some = lists[::4]
    printed = build.run(lists_text(some).encode(), "stars").decode().splitlines()
    assert [parse_answer(line) for line in printed] == [here.solve_stars(stars, Known())[0] for stars in some]
    assert build.heap_calls == ()
    assert build.static_bytes == 0


def test_a_design_without_a_detector_has_no_frames(design):
    with pytest.raises(InputError, match="needs the numbers of its detector"):
        _ = design.front_detector
    assert np.isfinite(design.psf_sigma_px)
