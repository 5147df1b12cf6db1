"""The flight build: compiled, the same bits from every compiler and processor, and right answers."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.flight_fuzz import CAMERAS, LONGEST, fuzz, fuzz_export
from simulator.checks import load_scenario
from simulator.cli.application import app
from simulator.renderer import Renderer
from simulator.study.exported_c.analysis import STRICT, analyze, cppcheck, solver_sources
from simulator.study.exported_c.build import command, compile_export
from simulator.study.exported_c.fuzz import build_fuzzers, missing_fuzzer
from simulator.study.exported_c.instructions import count_instructions, marked
from simulator.study.exported_c.targets import CLANG, CORTEX_M4, EMULATED, HOST, M68K
from simulator.study.exported_c.work import WorkProgram, instruction_weights, missing_counter
from simulator.study.flight.design import flight_design
from simulator.study.flight.program import FlightProgram, frame_bytes, list_text, parse_answer, velocity_of
from startracker.flight.design import IDENTIFIERS
from startracker.flight.export import flight_export
from startracker.flight.unit_scenes import SEED, VELOCITY, scene_rows, unit_lists, unit_scenes

pytestmark = pytest.mark.system

FIELDS = 4
COMPILER_CALLS = {"memset", "memcpy", "memmove"}
"""What a compiler may call for an assignment or a loop."""
CONTEXT_LIMIT = 64 * 1024
BUILDS = [("fixed", "adaptive"), ("float", "adaptive"), ("fixed", "triads")]
PACKAGE = Path(__file__).parents[2] / "startracker" / "flight" / "package"

needs_gcc = pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine (Debian: gcc)")
needs_m4 = pytest.mark.skipif(
    CORTEX_M4.missing() is not None, reason=f"{CORTEX_M4.missing()} is not installed (Debian: {CORTEX_M4.debian})"
)


def design_of(name, arithmetic="fixed", identifier="adaptive"):
    return flight_design(load_scenario(Path(name)), arithmetic, identifier)


@pytest.fixture(scope="module")
def design():
    """The camera of 192 × 165 pixels, whose frames are solved soon."""
    return design_of("tc211")


@pytest.fixture(scope="module")
def program(design, tmp_path_factory):
    return FlightProgram(design, tmp_path_factory.mktemp("c"))


@pytest.fixture(scope="module")
def frames(design):
    """Rendered frames with the velocity of the observer, and frames that are none."""
    renderer = Renderer(load_scenario(Path("tc211"), ["study.sampling=sky"]))
    seen = [renderer.frame(index)[0] for index in range(FIELDS)]
    images = [(frame.image, velocity_of(frame.observer.velocity_km_s)) for frame in seen]
    odd = [np.full((165, 192), 300, np.uint16), np.full((165, 192), 65535, np.uint16)]
    odd.append((np.arange(165 * 192).reshape(165, 192) * 7919 % 60000).astype(np.uint16))
    return [*images, *((image, (0, 0, 0)) for image in odd)]


@needs_gcc
def test_frames_are_solved_or_refused(program, frames):
    """Attitudes within five of their standard errors of the truth; frames that are none are bad, or without stars."""
    renderer = Renderer(load_scenario(Path("tc211"), ["study.sampling=sky"]))
    answers = [program.frames([image], velocity)[0] for image, velocity in frames]
    solved = 0
    for index, answer in enumerate(answers[:FIELDS]):
        if answer.attitude is not None:
            solved += 1
            away = renderer.frame(index)[1].attitude.rotation_vector_to(answer.attitude)
            assert (np.abs(away) < 5.0 * np.sqrt(np.diag(answer.covariance_rad2))).all()
    assert solved >= 3
    assert [answer.status for answer in answers[FIELDS : FIELDS + 2]] == ["bad_image"] * 2
    assert answers[-1].status != "solved"


def lists_of(design, count):
    """Lists of the unit tests with stars moved, missing, repeated and outside the image."""
    rng = np.random.default_rng(11)
    made = []
    for k in range(count):
        stars = unit_lists(design)[k % 4].stars
        kept = rng.random(len(stars.x)) < (1.0, 0.7, 0.4)[k % 3]
        stars = type(stars)(*(column[kept] for column in stars))
        x, y = (column + rng.normal(0.0, 20000.0 * (k % 2), len(column)).astype(np.int64) for column in stars[:2])
        made.append(stars._replace(x=x, y=y, variance=stars.variance * (k % 5 > 0)))
    far = unit_lists(design)[0].stars
    made.append(far._replace(x=far.x + (300 << 16)))
    made.append(far._replace(x=far.x * 0, y=far.y * 0))
    made.append(far._replace(flux=far.flux * 0, variance=far.variance * 0 + (1 << 32) - 1))
    return made


@needs_gcc
@pytest.mark.parametrize("identifier", IDENTIFIERS)
def test_memory_and_calls_of_the_cubesat(tmp_path, identifier):
    """1024 × 1024 pixels in 64 kB beside the tables; no static variable, heap or library."""
    program = FlightProgram(design_of("cubesat", identifier=identifier), tmp_path)
    build = program.build
    assert build.context_bytes <= CONTEXT_LIMIT
    assert build.static_bytes == 0
    assert build.heap_calls == ()
    assert 0 < build.stack_bytes < 8192
    objects = [str(tmp_path / f"tracker_{module}.o") for module in ("tables", *program.export.modules)]
    missing = {line.split()[-1] for line in command(["nm", "-u", *objects]).stdout.splitlines() if " U " in line}
    assert {name for name in missing if not name.startswith("tracker_")} <= COMPILER_CALLS
    code = "".join(program.export.files[name] for name in solver_sources(program.export))
    assert not re.search(r"\b(malloc|calloc|realloc|free)\s*\(|\bgoto\b|<(math|string|stdlib)\.h>", code)


@needs_gcc
@pytest.mark.parametrize(("arithmetic", "identifier"), BUILDS)
def test_command_writes_a_package_that_builds_and_passes_its_tests(tmp_path, arithmetic, identifier):
    words = ["export-c", str(tmp_path / "c"), "--scenario", "tc211", "--arithmetic", arithmetic, "--prefix", "tc"]
    words += ["--identifier", identifier]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    for word in ("tables", "context", "stack", "heap", "0 bytes", "time of a frame", "README.md"):
        assert word in done.output
    make = ["make", "-C", str(tmp_path / "c"), "test", "solve"]
    if (arithmetic, identifier) == BUILDS[0]:  # optimised, its answers are compared with the reference above
        make.append("CFLAGS=-std=c99 -O0 -ffp-contract=off -Wall -Wextra -Wpedantic -Wconversion -Werror")
    made = subprocess.run(make, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    assert "4 frames, 0 failed" in made.stdout
    assert "5 lists, 0 failed" in made.stdout
    version = command([str(tmp_path / "c" / "solve"), "version"]).stdout
    assert "scenario tc211 " in version
    assert f"; {arithmetic}; {identifier}; " in version
    assert version.strip().encode() in (tmp_path / "c" / "solve").read_bytes()


def unit_tests(files, folder):
    """What the unit tests of a package print, and their status."""
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text)
    made = subprocess.run(
        ["make", "-C", str(folder), "CFLAGS=-std=c99", "test"], capture_output=True, text=True, check=False
    )
    return made.stdout, made.returncode


@needs_gcc
def test_unit_tests_notice_a_wrong_answer(design, tmp_path):
    """A focal length half as large again, or another star, fails them; a threshold 5 % higher changes their digest."""
    files = flight_export(design).files
    plain, status = unit_tests(files, tmp_path / "plain")
    assert status == 0
    changed = {}
    for number, (name, old, new) in enumerate(
        (
            ("tracker_tables.h", r"(GRID_FOCAL) (\d+)", lambda m: f"{m[1]} {int(m[2]) * 3 // 2}"),
            ("test_data.h", r"(test_number\[\] = \{\n    )\d+", r"\g<1>1"),
            ("tracker_tables.h", r"(FRONT_THRESHOLD) (\d+)", lambda m: f"{m[1]} {int(m[2]) * 21 // 20}"),
        )
    ):
        text, count = re.subn(old, new, files[name], count=1)
        assert count
        changed[number] = unit_tests({**files, name: text}, tmp_path / str(number))
    for number in (0, 1):
        assert changed[number][1] != 0
        assert re.search(r" [1-9]\d* failed", changed[number][0])
    digests = [re.findall(r"frames, 0 failed, digest (\w{8})", said) for said in (plain, changed[2][0])]
    assert len(digests[0]) == len(digests[1]) == 1
    assert digests[0] != digests[1]


@needs_gcc
def test_what_the_program_refuses(program):
    for data, words, said in (
        (b"1 2\n", ["stars"], "no star: 1 2"),
        (b"prior 1 2 3\n", ["stars"], "no star: prior"),
        (b"abc", ["frames"], "fewer than 165 rows"),
        (b"", ["nothing"], "frames"),
    ):
        with pytest.raises(Exception, match=said):
            program.build.run(data, *words)
    assert program.build.run(b"", "frames") == program.build.run(b"", "stars") == b""


def test_the_example_names_every_status_and_reason():
    header = (PACKAGE.parent / "c" / "tracker_types.h").read_text()
    example = (PACKAGE / "main.c").read_text()
    for kind, array in (("status", "statuses"), ("reason", "reasons")):
        listed = re.findall(r"^    TRACKER_(\w+)", header.split(f"enum tracker_{kind} {{")[1].split("};")[0], re.M)
        printed = re.findall(r'"(\w+)"', example.split(f"{array}[] = {{")[1].split("};")[0])
        assert [name.lower().replace("frame_saturated", "saturated") for name in listed] == printed


# ------------------------------------------------------------------ all compilers and processors
@pytest.mark.slow
@pytest.mark.parametrize(("arithmetic", "identifier"), BUILDS)
@pytest.mark.parametrize("target", EMULATED, ids=lambda target: target.name)
def test_every_processor_gives_the_same_bits(target, arithmetic, identifier, frames, tmp_path):
    if target.missing():
        pytest.skip(f"{target.missing()} is not installed (Debian: {target.debian})")
    if target is M68K and arithmetic == "float":
        pytest.skip("the CPU32 has no floating-point unit, and gcc's software for it rounds differently: use fixed")
    made = design_of("tc211", arithmetic, identifier)
    (tmp_path / "host").mkdir()
    (tmp_path / "target").mkdir()
    here, there = (FlightProgram(made, tmp_path / name, one) for name, one in (("host", HOST), ("target", target)))
    texts = "".join(list_text(stars, VELOCITY) for stars in lists_of(made, 12)).encode()
    expected = here.build.run(texts, "stars")
    assert expected.count(b"solved ") >= 2
    assert there.build.run(texts, "stars") == expected
    image, velocity = frames[0]
    words = ("frames", *map(str, velocity))
    expected = here.build.run(frame_bytes(image), *words)
    assert parse_answer(expected.decode()).status == "solved"
    assert there.build.run(frame_bytes(image), *words) == expected
    assert there.build.context_bytes <= CONTEXT_LIMIT
    counts = count_instructions(there.build, frame_bytes(image), *words)
    # plausible: 30 per pixel at least; the triads of this frame are searched at several tolerances, 160 to 200 million
    assert 1e6 < counts.total < (1e8 if identifier == "adaptive" else 4e8)
    assert {"rows", "search", "pose_fit"} <= set(counts.modules)


@pytest.mark.slow
@needs_m4
def test_answers_are_counted_one_by_one(design, tmp_path):
    """The sum over the lists is that of the modules, but for the functions that mark them."""
    program = FlightProgram(design, tmp_path, marked(CORTEX_M4, "tracker"))
    texts = [list_text(one.stars, VELOCITY) for one in unit_lists(design)]
    counts = count_instructions(program.build, "".join(texts).encode(), "stars")
    assert len(counts.answers) == 4
    assert counts.answers[3] < min(counts.answers[:3])  # two stars are refused at once
    assert sum(counts.answers) == pytest.approx(sum(n for name, n in counts.modules.items()), rel=0.05)


@pytest.mark.slow
@needs_gcc
@pytest.mark.parametrize(("arithmetic", "identifier"), BUILDS)
def test_compilers_and_analysis_find_nothing(arithmetic, identifier, tmp_path):
    """gcc and Clang with all warnings as errors, gcc's analyzer, cppcheck; MISRA's rules as MISRA.md lists them."""
    made = design_of("tc211", arithmetic, identifier)
    export = flight_export(made)
    compile_export(export, tmp_path, HOST, [*STRICT, "-O3"])
    if CLANG.missing() is None:
        compile_export(export, tmp_path, CLANG, STRICT)
    analyze(export, tmp_path)
    if shutil.which("cppcheck") is None:
        pytest.skip("cppcheck is not installed (Debian: cppcheck)")
    found = cppcheck(export, tmp_path)
    assert found.others == ()
    listed = set(re.findall(r"\d+\.\d+", "".join(re.findall(r"^\|([^|]+)\|", export.files["MISRA.md"], re.M))))
    assert set(found.rules) <= listed


@pytest.mark.slow
@needs_gcc
@pytest.mark.parametrize(("arithmetic", "identifier"), BUILDS)
def test_sanitizers_find_nothing(arithmetic, identifier, frames, tmp_path):
    made = design_of("tc211", arithmetic, identifier)
    flags = ["-fsanitize=address,undefined,bounds-strict", "-fno-sanitize-recover=all", "-O1", "-g"]
    program = FlightProgram(made, tmp_path)
    plain = [program.frames([image], velocity) for image, velocity in frames]
    texts = [list_text(stars, VELOCITY) for stars in lists_of(made, 16)]
    lists = program.lists(texts)
    program.build = compile_export(program.export, tmp_path, HOST, flags)
    assert [program.frames([image], velocity) for image, velocity in frames] == plain
    assert program.lists(texts) == lists


needs_fuzzer = pytest.mark.skipif(missing_fuzzer() is not None, reason=str(missing_fuzzer()))


@pytest.mark.slow
@needs_m4
@pytest.mark.skipif(missing_counter() is not None, reason=str(missing_counter()))
def test_native_work_estimates_emulated_instructions(design, tmp_path):
    """Weights from eight lists estimate the instructions of eight others within 15 %, and the answers are the same."""
    (tmp_path / "work").mkdir()
    program = FlightProgram(design, tmp_path, CORTEX_M4)
    counter = WorkProgram(program.export, tmp_path / "work")
    texts = [list_text(stars, VELOCITY).encode() for stars in lists_of(design, 16)[:16]]
    lines, work = counter.run(b"".join(texts), "stars")
    assert "\n".join(lines).encode() + b"\n" == program.build.run(b"".join(texts), "stars")
    counted = [count_instructions(program.build, text, "stars") for text in texts]
    weights, correlation = instruction_weights(counter.modules, work[::2], counted[::2])
    assert correlation > 0.99
    total = np.array([one.total for one in counted[1::2]], float)
    assert np.abs(work[1::2] @ weights - total).max() < 0.15 * total.max()


@pytest.mark.slow
@needs_fuzzer
@pytest.mark.parametrize("arithmetic", ["fixed", "float"])
@pytest.mark.parametrize(
    ("what", "identifier"), [*((what, "adaptive") for what in LONGEST), ("frames", "triads"), ("search", "triads")]
)
def test_five_seconds_of_fuzzing_find_nothing(what, identifier, arithmetic, tmp_path):
    program = build_fuzzers(fuzz_export(CAMERAS[what], arithmetic, identifier), [what], tmp_path)[what]
    result = fuzz(program, what, tmp_path / "corpus", 5)
    assert result.finding == ""
    assert result.executions > 100
    assert result.edges > 150


FAULTS = {
    "search triads": ("triad_votes", "names == TRACKER_TRIAD_NAMED", "names == TRACKER_TRIAD_NAMED + 1"),
    "front": ("components", "front->objects < TRACKER_FRONT_OBJECTS", "front->objects <= TRACKER_FRONT_OBJECTS"),
    "frames": ("hot_pixels", "bridge->count == TRACKER_FRONT_HOT", "bridge->count == TRACKER_FRONT_HOT + 1"),
    "search": ("search", "k > 0 && search->best[k - 1].evidence", "search->best[k - 1].evidence"),
    "stars": ("solver", "found->best.guide[k] >= 0", "found->best.guide[k] >= -1"),
    "pose": ("pose_fit", "c = (star[n].variance + added) >> shift", "c = (star[n].variance + added) >> 14"),
    "filter": ("following", "if (f->innovations == WINDOW) {", "if (f->innovations > WINDOW) {"),
    "session": ("following", "k < 4; k++)\n        to[k] = from[k]", "k <= 4; k++)\n        to[k] = from[k]"),
}
"""A fault for each fuzzer and, if it is not the default, identifier: module, text, what replaces it."""


@pytest.mark.slow
@needs_fuzzer
@pytest.mark.parametrize("fuzzer", list(FAULTS))
def test_fuzzers_find_a_fault_in_seconds(fuzzer, tmp_path):
    module, text, fault = FAULTS[fuzzer]
    what, _, identifier = fuzzer.partition(" ")
    export = fuzz_export(CAMERAS[what], "fixed", identifier or "adaptive")
    name = f"tracker_{module}.c"
    assert export.files[name].count(text) == 1
    export = replace(export, files={**export.files, name: export.files[name].replace(text, fault)})
    program = build_fuzzers(export, [what], tmp_path)[what]
    assert fuzz(program, what, tmp_path / "corpus", 20).finding  # within a second on an idle core


@pytest.mark.slow
@needs_gcc
def test_cmake_builds_and_tests_it(design, tmp_path):
    if shutil.which("cmake") is None:
        pytest.skip("cmake is not installed (Debian: cmake)")
    for name, text in flight_export(design, "vega").files.items():
        (tmp_path / name).write_text(text)
    build = str(tmp_path / "build")
    command(["cmake", "-S", str(tmp_path), "-B", build])
    command(["cmake", "--build", build])
    assert "100% tests passed" in command(["ctest", "--test-dir", build]).stdout


@pytest.mark.slow
@needs_gcc
def test_float_is_close_to_fixed(program, frames, tmp_path):
    """Attitudes of the same stars differ by less than a hundredth of their standard error."""
    single = FlightProgram(replace(program.design, arithmetic="float"), tmp_path)
    compared = 0
    for image, velocity in frames:
        expected, answer = (one.frames([image], velocity)[0] for one in (program, single))
        assert (answer.status, answer.numbers) == (expected.status, expected.numbers)
        if expected.attitude is not None:
            turn = 2.0 * (np.array(answer.quaternion) - expected.quaternion) / (1 << 30)
            assert np.linalg.norm(turn) < 0.01 * np.sqrt(np.trace(expected.covariance_rad2)) + 4.0 / (1 << 30)
            compared += 1
    assert compared >= 3


def test_scenes_of_the_unit_tests(design):
    """They hold stars and noise, and one is blank."""
    scenes = unit_scenes(design)
    assert [len(scene.x8) > 3 for scene in scenes] == [True, True, False]
    assert scene_rows(design, scenes[0], SEED).max() <= design.detector.saturation_dn
