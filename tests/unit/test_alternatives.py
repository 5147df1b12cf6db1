"""Keys that exclude each other: those of a base fall away, those of one file are a contradiction."""

import pytest

from simulator.scenario import Scenario, ScenarioError
from simulator.scenario.fields import all_keys
from simulator.study.runnable import refuse_unrunnable

TLE = """\
ISS (ZARYA)
1 25544U 98067A   24100.51782528  .00016717  00000-0  30000-3 0  9993
2 25544  51.6400 208.9163 0002571  50.0000  79.0000 15.49815320447006
"""
STATE = "state: {position_km: [7000, 0, 0], velocity_km_s: [0, 7.5, 1]}"
DEFAULTS = {key.path: key.default for key in all_keys() if not key.section}


@pytest.fixture
def load(tmp_path):
    """Loads a scenario over a base, both as text."""
    (tmp_path / "iss.tle").write_text(TLE)

    def load(above: str, below: str = "", options: tuple[str, ...] = ()) -> Scenario:
        (tmp_path / "below.yaml").write_text(f"base: cubesat_ideal\n{below}\n")
        (tmp_path / "above.yaml").write_text(f"base: below.yaml\n{above}\n")
        return Scenario.load(tmp_path / "above.yaml", options)

    return load


def value(scenario: Scenario, path: str) -> object:
    for part in path.split("."):
        scenario = getattr(scenario, part)
    return scenario


@pytest.mark.parametrize(
    ("below", "above", "gone"),
    [
        ("", "optics: {psf: {model: diffraction}}", ["optics.psf.sigma_px"]),
        ("", "optics: {psf: {model: airy}}", ["optics.psf.sigma_px"]),
        ("", "optics: {psf: {first_dark_ring_px: 3}}", ["optics.psf.sigma_px"]),
        (
            "optics: {psf: {model: airy, first_dark_ring_px: 3}}",
            "optics: {psf: {polychromatic: true}}",
            ["optics.psf.first_dark_ring_px"],
        ),
        (
            "optics: {psf: {model: diffraction, defocus_um: 20, polychromatic: true, zernike_waves: {coma_x: 0.1}}}",
            "optics: {psf: {model: gaussian, sigma_px: 1}}",
            ["optics.psf.defocus_um", "optics.psf.polychromatic", "optics.psf.zernike_waves.coma_x"],
        ),
        ("", "orbit: {elements: {semi_major_axis_km: 7200}}", ["orbit.ltan_h", "orbit.altitude_km"]),
        ("orbit: {propagator: sgp4}", "orbit: {elements: {semi_major_axis_km: 7200}}", ["orbit.propagator"]),
        ("orbit: {elements: {semi_major_axis_km: 7200}}", f"orbit: {{{STATE}}}", ["orbit.elements.semi_major_axis_km"]),
        (f"orbit: {{{STATE}, centre: Moon}}", "orbit: {altitude_km: 600}", ["orbit.state.position_km", "orbit.centre"]),
        ("orbit: {tle: iss.tle}", "orbit: {altitude_km: 600}", ["orbit.tle"]),
        ("", "orbit: {tle: iss.tle}", ["orbit.altitude_km"]),
        ("orbit: {ltan_h: 10}", "orbit: {raan_deg: 30}", ["orbit.ltan_h"]),
        ("orbit: {ltan_h: null, raan_deg: 30}", "orbit: {ltan_h: 10}", ["orbit.raan_deg"]),
        ("pointing: {target: Moon}", "pointing: {spin: {rate_deg_s: 3}}", ["pointing.target"]),
        ("pointing: {spin: {rate_deg_s: 3}}", "pointing: {target: Moon}", ["pointing.spin.rate_deg_s"]),
        ("pointing: {track: {target: Sun}}", "pointing: {target: [10, 20, 0]}", ["pointing.track.target"]),
        ("detector: {antiblooming: 0.5, cti_parallel: 1e-5}", "detector: {kind: cmos}", ["detector.cti_parallel"]),
        (
            "detector: {kind: ccd_frame_transfer, shutter: frame_transfer}",
            "detector: {kind: cmos}",
            ["detector.shutter"],
        ),
        (
            "detector: {shutter: rolling, line_time_us: 10}",
            "detector: {kind: ccd_full_frame}",
            ["detector.shutter"],
        ),
        ("optics: {distortion: {p1: 1e-4}}", "optics: {projection: fisheye}", ["optics.distortion.p1"]),
    ],
)
def test_what_the_base_defines_otherwise_falls_away(load, below, above, gone):
    scenario = load(above, below)
    assert {path: value(scenario, path) for path in gone} == {path: DEFAULTS[path] for path in gone}


def test_options_and_changes_replace_as_files_do(load):
    scenario = load("", options=("optics.psf.model=diffraction",))
    assert scenario.optics.psf == Scenario.load("cubesat_ideal").changed({"optics.psf.model": "diffraction"}).optics.psf
    assert scenario.optics.psf.sigma_px is None


def test_a_head_with_another_model_does_not_inherit_the_width(load):
    head = "{name: a, mounting: zenith, optics: {psf: {model: diffraction}}}"
    scenario = load(f"heads: [{head}, {{name: b, mounting: [0, 0, 0, 1]}}]")
    assert [each.name for each in scenario.heads] == ["a", "b"]


@pytest.mark.parametrize(
    ("below", "above"),
    [
        ("optics: {psf: {wavelength_nm: 700}}", "optics: {psf: {sigma_px: 1.1}}"),
        ("pointing: {target: Moon}", "pointing: {error_deg: 0.1}"),
        ("pointing: {target: Moon}", "pointing: {spin: {rate_deg_s: 0}}"),
        ("orbit: {propagator: sgp4}", "orbit: {altitude_km: 700}"),
        ("detector: {shutter: rolling, line_time_us: 10}", "detector: {kind: cmos}"),
    ],
)
def test_what_does_not_exclude_stays(load, below, above):
    kept = load("", below)
    scenario = load(above, below)
    key, _, rest = below.partition(": {")
    path = f"{key}.{rest.partition(':')[0]}" if "psf" not in rest else "optics.psf.wavelength_nm"
    assert value(scenario, path) == value(kept, path)


def test_both_in_one_file_are_a_contradiction(load):
    with pytest.raises(ScenarioError, match=r"above.yaml:2:\d+: optics.psf.sigma_px: model: airy does not use"):
        load("optics: {psf: {model: airy, sigma_px: 1}}")
    with pytest.raises(ScenarioError, match=r"already defined by orbit.elements"):
        load(f"orbit: {{elements: {{semi_major_axis_km: 7200}}, {STATE}}}")


def test_trials_of_an_orbit_from_a_file_are_in_its_span(load):
    given = "epoch: 2024-04-09T12:00:00Z\norbit: {tle: iss.tle}"
    assert load("", given).study.sampling == "span"
    assert load(given, "study: {sampling: mission_year}").study.sampling == "span"
    assert load(f"{given}\nstudy: {{sampling: orbit}}").study.sampling == "orbit"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "orbit: {tle: iss.tle}",
            r"above.yaml:2:9: study.sampling: span: the trajectory ends before the epoch; change the epoch",
        ),
        (
            "epoch: 2024-04-09T12:00:00Z\norbit: {tle: iss.tle}\nstudy: {sampling: mission_year}",
            r"above.yaml:4:9: study.sampling: .*iss.tle:2: the set of elements",
        ),
        (
            "optics: {psf: {model: diffraction, zernike_waves: {coma_x: 90}}}",
            r"above.yaml:2:10: optics.psf: the aberrations spread a star over",
        ),
        (
            "optics: {psf: {polychromatic: true}}",
            r"above.yaml:2:10: optics.psf: a PSF of model gaussian does not depend",
        ),
    ],
)
def test_what_a_run_refuses_is_located(load, text, message):
    with pytest.raises(ScenarioError, match=message):
        refuse_unrunnable(load(text))


def test_a_section_of_another_type_is_reported_as_before(load):
    for text in ("orbit: 5", "optics: {psf: [1]}", "pointing: {spin: 3}", "study: 5\norbit: {tle: iss.tle}"):
        with pytest.raises(ScenarioError, match="must be a section with keys"):
            load(text)
