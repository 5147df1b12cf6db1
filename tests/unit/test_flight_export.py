"""Files of an exported flight build: what they are made of, and what is refused. What they do: test_flight_build.py."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from simulator.checks import load_scenario
from simulator.cli.application import app
from simulator.study.flight.design import flight_design
from simulator.study.flight.program import list_text, parse_answer, velocity_of
from startracker.errors import InputError
from startracker.flight.c_table import CTable
from startracker.flight.export import Part, assemble, flight_export, flight_parts, flight_tables
from startracker.flight.stars import StarList
from startracker.flight.unit_scenes import SEED, scene_numbers, scene_rows, unit_field, unit_scenes
from startracker.geometry.camera import Camera

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def design():
    return flight_design(load_scenario(Path("tc211")))


@pytest.fixture(scope="module")
def export(design):
    return flight_export(design, "vega_1")


def test_every_file_is_named_filled_in_and_licensed(export):
    assert {"vega_1.h", "vega_1_tables.c", "main.c", "Makefile", "CMakeLists.txt", "README.md", "MISRA.md"} <= set(
        export.files
    )
    for name, text in export.files.items():
        assert not re.search(r"@[A-Z_]+@", text), name
        assert not re.search(r"\btracker_\w|\bTRACKER_", text), name
        if name.endswith((".c", ".h")):
            assert text.startswith(
                "/* Copyright (c) 2026, The boresight developers. SPDX-License-Identifier: BSD-3-Clause"
            )
    assert export.files["LICENSE"] == (ROOT / "LICENSE").read_text()


def test_all_headers_and_sources_are_there(export):
    for name, text in export.files.items():
        for included in re.findall(r'^#include "(\S+)"', text, re.MULTILINE):
            assert included in export.files, f"{name} includes {included}"
    for module in ("tables", *export.modules):
        assert f"vega_1_{module}.c" in export.files
        assert f"vega_1_{module}.o" in export.files["Makefile"]
        assert f"vega_1_{module}.c" in export.files["CMakeLists.txt"]


def test_an_export_has_the_sources_of_its_identifier_alone(design, export):
    """Of the 43 files those of the hypotheses differ; the version, the header and the README say which they are."""
    triads = flight_export(replace(design, identifier="triads"), "vega_1")
    own = {f"vega_1_{name}" for name in ("triads.c", "triad_votes.c", "cordic.c", "cordic.h")}
    others = {"vega_1_candidates.c", "vega_1_confirm.c"}
    assert triads.files.keys() - export.files.keys() == own
    assert export.files.keys() - triads.files.keys() == others
    assert "search_needed" not in triads.files["vega_1_tables.h"]
    assert "rotation_step" not in export.files["vega_1_tables.h"]
    for made, name in ((export, "adaptive"), (triads, "triads")):
        assert f"; {name}; tables" in made.files["vega_1_tables.c"]
        for file in ("README.md", "MISRA.md", "vega_1.h"):
            assert f"identification: {name}" in made.files[file], file


def test_the_scenario_says_its_identifier():
    for scenario, identifier in (("xybion", "triads"), ("tc211", "adaptive"), ("sunsat", "adaptive")):
        assert flight_design(load_scenario(Path(scenario))).identifier == identifier


def test_the_version_is_of_the_tables(design, export):
    version = re.search(r'vega_1_version\[(\d+)\] = "([^"]+)"', export.files["vega_1_tables.c"])
    assert int(version[1]) == len(version[2]) + 1
    assert f"scenario tc211 {design.digest[:16]}; fixed; adaptive; tables " in version[2]
    parts = flight_parts(flight_tables(design))
    assert version[2] in assemble(design, parts, "other", "").files["other_tables.c"]
    parts[0].arrays[0] = CTable(*list(vars(parts[0].arrays[0]).values())[:3], parts[0].arrays[0].values + 1)
    assert version[2] not in assemble(design, parts, "other", "").files["other_tables.c"]


def test_two_stages_cannot_define_the_same(design):
    table = CTable("int16_t", "x", "", np.zeros(2, dtype=int))
    for parts in ([Part((), {"A": 1}, []), Part((), {"A": 1}, [])], [Part((), {}, [table]), Part((), {}, [table])]):
        with pytest.raises(InputError, match=r"(A|x) is defined by two stages"):
            assemble(design, parts, "tracker", "")
    with pytest.raises(InputError, match=r"no source tracker_nothing\.c"):
        assemble(design, [Part(("nothing",), {}, [])], "tracker", "")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--scenario", "cubesatt"), "did you mean"),
        (("--scenario", "tc211", "--size", "9x9"), "--size: has no effect with --scenario"),
        (("--scenario", "tc211", "--arithmetic", "double"), "arithmetic must be fixed or float"),
        (("--scenario", "tc211", "--identifier", "pyramid"), "identifier must be adaptive or triads"),
        (
            ("--scenario", "xybion", "--set", "tracker.identification.max_stars=30"),
            "identifier triads: set tracker.identification.max_stars to 3 to 24",
        ),
        (("--scenario", "tc211", "--prefix", "9a"), "--prefix"),
        (("--scenario", "tc211", "--set", "optics.apertur_mm=3"), "optics.aperture_mm"),
    ],
)
def test_mistakes_are_one_line(tmp_path, arguments, said):
    done = CliRunner().invoke(app, ["export-c", str(tmp_path / "c"), *arguments])
    assert said in str(done.exception)
    assert len(str(done.exception).splitlines()) == 1
    assert not (tmp_path / "c").exists()


def test_coarse_pixels_are_refused(design):
    """A product of the search overflowed: variances to 25 px² of 16 fraction bits, times a square in 2⁻⁶⁰ rad²."""
    with pytest.raises(InputError, match=r"pixels of at most 0\.12°, the camera's are 0\.3"):
        replace(design, camera=Camera.from_fov(20.0, 64, 64))
    assert (25 << 16) * math.radians(0.12) ** 2 * 2**60 < 2**63


def test_an_answer_is_read_to_the_last_bit():
    rng = np.random.default_rng(3)
    numbers = rng.integers(-(1 << 30), (1 << 30) + 1, 500).tolist()
    for at in range(0, 500, 4):
        quaternion = numbers[at : at + 4]
        text = ",".join(f"{n / (1 << 30):.10f}" for n in quaternion)
        answer = parse_answer(f"solved accepted stars=5 matched=4 quaternion={text} covariance=1,2,3 numbers=7,0")
        assert list(answer.quaternion) == quaternion
    assert answer.counts == {"stars": 5, "matched": 4}
    assert answer.numbers == (7, 0)
    assert parse_answer("no_stars nothing_found stars=0").attitude is None


def test_what_the_program_is_given():
    stars = StarList.of([[1.0, 2.5]], [3.0], [0.25], [1])
    assert list_text(stars, (1, -2, 3)) == f"velocity 1 -2 3\n65536 {5 << 15} 48 {1 << 24} 1\n\n"
    assert list_text(stars.take([False]), epoch=132_800_000) == "velocity 0 0 0\nepoch 132800000\n\n"
    assert velocity_of(None) == (0, 0, 0)
    assert velocity_of([29.9792458, 0.0, -2.99792458]) == (round(1e-4 * 2**30), 0, -round(1e-5 * 2**30))


def test_scenes_of_the_unit_tests(design):
    """A background with the stated noise, and stars of the guide catalogue where they are."""
    numbers = scene_numbers(design)
    empty = scene_rows(design, unit_scenes(design)[-1], SEED)
    assert empty.shape == (165, 192)
    # the mean of four even 16-bit values, truncated; the sample's mean has an error of 0.58 noise / sqrt(pixels)
    assert abs(empty.mean() - (numbers.level + 2.0 * numbers.noise - 0.5)) < 5 * 0.58 * numbers.noise / 177.0
    assert abs(empty.std() / (0.577 * numbers.noise) - 1.0) < 0.05
    scene = unit_scenes(design)[0]
    frame = scene_rows(design, scene, SEED)
    brightest = np.unravel_index(np.argmax(frame), frame.shape)
    assert min(np.hypot(scene.x8 / 8 - brightest[1], scene.y8 / 8 - brightest[0])) < 1.0
    field = unit_field(design, 10)
    assert (np.diff(field.v_mag) >= 0).all()
    assert design.camera.contains(field.xy).all()
