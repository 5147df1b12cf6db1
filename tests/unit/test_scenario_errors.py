"""Every kind of mistake in a scenario, with its message word for word."""

# ruff: noqa: E501, ISC004 - messages stand as they are printed
import os
import pickle
import time

import pytest

from simulator.scenario import Scenario, ScenarioError
from simulator.scenario.document import parse_document

GOOD = """\
name: demo
epoch: 2026-03-21T12:00:00Z
optics:
  focal_length_mm: 50
  aperture_mm: 25
detector:
  width: 512
  height: 512
  pixel_pitch_um: 10
  exposure_s: 0.1
"""
LAUGHS = GOOD.replace("name: demo", "a0: &a0 [1]") + "".join(
    f"a{i + 1}: &a{i + 1} [{', '.join([f'*a{i}'] * 9)}]\n" for i in range(8)
)  # nine to the eighth values, were it believed


def lines(text, overrides=(), name="x.yaml"):
    with pytest.raises(ScenarioError) as caught:
        Scenario.parse(text, overrides, name=name)
    return str(caught.value).splitlines()


def edited(old, new):
    assert old in GOOD
    return GOOD.replace(old, new)


def test_the_example_is_good():
    assert Scenario.parse(GOOD).optics.aperture_mm == 25.0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            edited("focal_length_mm", "focal_lenght_mm"),
            "x.yaml:4:3: optics.focal_lenght_mm: unknown key; did you mean 'focal_length_mm'?",
        ),
        (
            edited("  aperture_mm: 25", "  aperture_mm: 25\n  exposure_s: 1"),
            "x.yaml:6:3: optics.exposure_s: unknown key; it belongs to section 'detector'",
        ),
        (GOOD + "trials: 5\n", "x.yaml:11:1: trials: unknown key; it belongs to section 'study'"),
        (
            GOOD + "catalog: bsc5\n",
            "x.yaml:11:1: catalog: unknown key; it belongs to section 'sky' or section 'tracker'",
        ),
        (GOOD + "study: {seed: 3}\n", "x.yaml:11:9: study.seed: unknown key; it belongs to the top level"),
        (
            GOOD + "study: {base: y.yaml}\n",
            "x.yaml:11:9: study.base: unknown key; base belongs to the top level of the file",
        ),
        (
            GOOD + "study: {zzz: 1}\n",
            "x.yaml:11:9: study.zzz: unknown key; known here: trials, sampling, sky_without_earth",
        ),
        (
            GOOD + "quantum_eficiency: 1\n",
            "x.yaml:11:1: quantum_eficiency: unknown key; did you mean 'detector.quantum_efficiency'?",
        ),
        (edited("25", "abc"), "x.yaml:5:3: optics.aperture_mm: must be a number above 0, not 'abc'"),
        (
            edited("25", '"25"'),
            "x.yaml:5:3: optics.aperture_mm: must be a number above 0, not '25'; remove the quotes",
        ),
        (
            edited("25", "25 mm"),
            "x.yaml:5:3: optics.aperture_mm: must be a number above 0, not '25 mm'; "
            "write the number only, the unit is in the name of the key",
        ),
        (
            edited("25", "2,5"),
            "x.yaml:5:3: optics.aperture_mm: must be a number above 0, not '2,5'; write a decimal point, not a comma",
        ),
        (edited("25", "-25"), "x.yaml:5:3: optics.aperture_mm: must be a number above 0, not -25"),
        (edited("25", "true"), "x.yaml:5:3: optics.aperture_mm: must be a number above 0, not true"),
        (edited("25", ".nan"), "x.yaml:5:3: optics.aperture_mm: must be a number above 0, not nan"),
        (edited("25", ".inf"), "x.yaml:5:3: optics.aperture_mm: must be a number above 0, not inf"),
        (edited("25", ""), "x.yaml:5:3: optics.aperture_mm: must be a number above 0, not nothing"),
        (edited("25", "{a: 1}"), "x.yaml:5:3: optics.aperture_mm: must be a number above 0, not a section"),
        (
            edited("width: 512", "width: 512.0"),
            "x.yaml:7:3: detector.width: must be a whole number from 16 to 16384, not 512.0; write 512",
        ),
        (edited("width: 512", "width: 8"), "x.yaml:7:3: detector.width: must be a whole number from 16 to 16384, not 8"),
        (
            edited("um: 10", "um: [10, true]"),
            "x.yaml:9:3: detector.pixel_pitch_um: must be a number above 0 or a list of 2 numbers above 0, not [10, true]",
        ),
        (
            GOOD + "sky: {planets: yes}\n",
            "x.yaml:11:7: sky.planets: must be true or false, not 'yes'; write true, without quotes",
        ),
        (
            GOOD + "orbit: {propagator: sgp5}\n",
            "x.yaml:11:9: orbit.propagator: must be 'auto', 'j2', 'sgp4', 'kepler' or 'numerical', not 'sgp5'; did you mean 'sgp4'?",
        ),
        (
            GOOD + "orbit: {inclination_deg: 190}\n",
            "x.yaml:11:9: orbit.inclination_deg: must be a number from 0 to 180 or 'auto', not 190",
        ),
        (
            GOOD + "pointing: {offset_deg: [0, 0]}\n",
            "x.yaml:11:12: pointing.offset_deg: must be a list of 3 numbers, not [0, 0]",
        ),
        (
            edited("2026-03-21T12:00:00Z", "yesterday"),
            "x.yaml:2:1: epoch: must be a date and time in UTC such as 2026-03-21T12:00:00Z, not 'yesterday'",
        ),
        (
            edited("demo", "a/b"),
            "x.yaml:1:1: name: must be a name of letters, digits, '.', '_' and '-' that starts with a letter or digit, "
            "not 'a/b'",
        ),
        (edited("  aperture_mm: 25\n", ""), "x.yaml:3:1: optics.aperture_mm: required key is missing"),
        (edited("name: demo\n", ""), "x.yaml: name: required key is missing"),
        (GOOD[: GOOD.index("detector")], "x.yaml: detector: section is missing; it needs width and height and pixel_pitch_um and exposure_s"),
        (GOOD + "name: again\n", "x.yaml:11:1: name: duplicate key; first given on line 1; keep one of them"),
        (
            GOOD + "sky:\n",
            "x.yaml:11:1: sky: must be a section with keys, not nothing; remove the line to use the defaults",
        ),
        (GOOD + "sky: 3\n", "x.yaml:11:1: sky: must be a section with keys, not 3"),
        (
            GOOD + "tracker: {detection: {min_pixels: 0}}\n",
            "x.yaml:11:23: tracker.detection.min_pixels: must be a whole number of at least 1, not 0",
        ),
        (GOOD + "optics2: !!python/object:os.system 1\n", None),
        (edited("25", "!mm 25"), "x.yaml:5:16: tags ('!mm') are not supported in scenarios; write the plain value"),
        (edited("25", "*d"), "x.yaml:5:16: alias '*d' has no anchor '&d' above it"),
        (edited("25", "&d [*d]"), None),
        (GOOD + "<<: {seed: 1}\n", "x.yaml:11:1: merge keys (<<) are not part of YAML 1.2; use base: or repeat the keys"),
        (GOOD + "? [a]\n: 1\n", "x.yaml:11:3: a key must be a plain word"),
        (GOOD + "---\n" + GOOD, None),
        ("%YAML 1.1\n---\n" + GOOD, "x.yaml:2:1: only YAML 1.2 is supported; remove the %YAML line"),
        (GOOD + "sky:\n\tplanets: true\n", "x.yaml:12:1: invalid YAML: a tab; indent with spaces"),
        (
            GOOD + "sky: planets: true\n",
            "x.yaml:11:13: invalid YAML: unexpected ':'; check the indentation, or quote the text",
        ),
        (GOOD + "sky: [1,\n", "x.yaml:12:1: invalid YAML: expected the node content, but found '<stream end>'"),
        (GOOD + "sky: \x07\n", "x.yaml:11:6: invalid YAML: character U+0007 is not allowed"),
        (edited("demo", '"\\ud800"'), None),
        ("", "x.yaml: is empty; a scenario needs name, epoch, optics and detector"),
        ("# nothing\n", "x.yaml: is empty; a scenario needs name, epoch, optics and detector"),
        ("- a\n- b\n", "x.yaml:1:1: must consist of keys and values (key: value), not ['a', 'b']"),
        ("just text\n", "x.yaml:1:1: must consist of keys and values (key: value), not 'just text'"),
        (GOOD + "base: 3\n", "x.yaml:11:1: base: must be the name of a scenario file, not 3"),
        (GOOD + "base: nowhere.yaml\n", "x.yaml:11:1: base: no such file: nowhere.yaml"),
        (edited("25", "9" * 5000), None),
        (edited("25", "1" + "0" * 350), None),
        ("a: " + "[" * 1000 + "]" * 1000, None),
    ],
)  # fmt: skip
def test_one_mistake(text, expected):
    told = lines(text)
    assert all(line.startswith("x.yaml") for line in told)
    if expected is not None:
        assert told == [expected]


def test_aliases_cannot_explode():
    told = lines(LAUGHS)
    assert sum(line.endswith("the aliases expand to more than 20000 values; reduce them") for line in told) == 1


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["optics.apperture_mm=25"], "--set optics.apperture_mm: unknown key; did you mean 'optics.aperture_mm'?"),
        (["sed=3"], "--set sed: unknown key; did you mean 'seed'?"),
        (["optiks.aperture_mm=3"], "--set optiks.aperture_mm: optiks: unknown key; did you mean 'optics'?"),
        (["optics.aperture_mm=wide"], "--set optics.aperture_mm: must be a number above 0, not 'wide'"),
        (["optics.aperture_mm=[1"], None),
        (["optics.aperture_mm"], "--set optics.aperture_mm: must look like section.key=value"),
        (["=5"], "--set =5: must look like section.key=value"),
        (["optics..aperture_mm=5"], "--set optics..aperture_mm=5: must look like section.key=value"),
        (["seed.deep=5"], "--set seed.deep: seed: must be a whole number from 0 to 9223372036854775807, not a section"),
        (["base=x.yaml"], "--set base: can only be set in a file; load another scenario instead"),
        (
            ["optics.aperture_mm=120"],
            "--set optics.aperture_mm: 120 mm at a focal length of 50 mm is f/0.417, but no lens in air is faster than "
            "f/0.5; use at most 100 mm; or set allow_unphysical: true",
        ),
    ],
)
def test_wrong_option(overrides, expected):
    told = lines(GOOD, overrides)
    assert all(line.startswith("--set ") for line in told)
    if expected:
        assert told == [expected]


def test_seed_and_trials_name_their_options(tmp_path):
    file = tmp_path / "a.yaml"
    file.write_text(GOOD)
    with pytest.raises(ScenarioError) as caught:
        Scenario.load(file, seed=-1, trials=0)
    assert str(caught.value).splitlines() == [
        "--seed: must be a whole number from 0 to 9223372036854775807, not -1",
        "--trials: must be a whole number of at least 1, not 0",
    ]


def test_all_mistakes_at_once_in_the_order_of_the_file():
    text = edited("name: demo", "name: demo\nseeed: 3").replace("25", "'25'").replace("width: 512", "width: 5")
    told = lines(text + "orbit: {altitude_km: 10}\nseed: 1\nseed: 2\n", ["study.trials=-1"])
    assert [line.split(": ")[0] for line in told] == [
        "x.yaml:2:1", "x.yaml:6:3", "x.yaml:8:3", "x.yaml:12:9", "x.yaml:14:1", "--set study.trials",
    ]  # fmt: skip


def test_names_are_checked_by_the_functions_given():
    with pytest.raises(ScenarioError) as caught:
        Scenario.parse(GOOD, name="x.yaml", names={"tracker.detector": lambda v, _: f"{v}?", "name": lambda v, _: "no"})
    assert str(caught.value).splitlines() == ["x.yaml: tracker.detector: components?", "x.yaml:1:1: name: no"]


def test_files_that_cannot_be_read(tmp_path):
    def told(path):
        with pytest.raises(ScenarioError) as caught:
            Scenario.load(path)
        return str(caught.value)

    assert told(tmp_path / "no.yaml") == f"{tmp_path}/no.yaml: no such file"
    assert told(tmp_path) == f"{tmp_path}: is a folder, not a scenario file"
    assert told("nothing_of_this_name").startswith("nothing_of_this_name: no such file; included are cbers2, ")
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(b"name: demo\ndescription: caf\xe9\n")
    assert told(latin) == f"{latin}:2:17: is not UTF-8 text: byte 0xe9; save the file as UTF-8"
    big = tmp_path / "big.yaml"
    big.write_bytes(b"#" * 1_000_001)
    assert told(big) == f"{big}: is larger than 1000 kB, too large for a scenario"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read everything")
def test_file_without_permission(tmp_path):
    file = tmp_path / "closed.yaml"
    file.write_text(GOOD)
    file.chmod(0)
    with pytest.raises(ScenarioError, match="cannot be read"):
        Scenario.load(file)


def test_base_mistakes_carry_the_file_they_are_in(tmp_path):
    (tmp_path / "low.yaml").write_text(GOOD.replace("25", "wide"))
    (tmp_path / "high.yaml").write_text("base: low.yaml\nsed: 3\n")
    with pytest.raises(ScenarioError) as caught:
        Scenario.load(tmp_path / "high.yaml")
    assert set(str(caught.value).splitlines()) == {
        f"{tmp_path}/low.yaml:5:3: optics.aperture_mm: must be a number above 0, not 'wide'",
        f"{tmp_path}/high.yaml:2:1: sed: unknown key; did you mean 'seed'?",
    }


def test_bases_in_a_circle(tmp_path):
    (tmp_path / "a.yaml").write_text("base: b.yaml\n")
    (tmp_path / "b.yaml").write_text("base: a.yaml\n")
    with pytest.raises(ScenarioError) as caught:
        Scenario.load(tmp_path / "a.yaml")
    a, b = tmp_path / "a.yaml", tmp_path / "b.yaml"
    expected = f"{b}:1:1: base: the files form a circular chain of bases: {a} → {b} → {a}"
    assert str(caught.value) == expected


def test_an_error_crosses_processes():
    with pytest.raises(ScenarioError) as caught:
        Scenario.parse("a: 1\n")
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)
    assert again.problems == caught.value.problems


@pytest.mark.parametrize("opening", ["[", "{", "[a, ", "{a: ", "{? ", "[\n"])
def test_ten_thousand_levels_are_refused_at_once(opening):
    """The parser alone takes a minute for 10,000 opening brackets: the rest is not read."""
    problems = []
    begin = time.process_time()
    assert parse_document("name: " + opening * 10_000, "deep.yaml", problems) is None
    assert time.process_time() - begin < 5.0  # 0.2 s on the machine it was written on
    assert [problem.message for problem in problems] == ["nested more than 20 levels deep; reduce the nesting"]
