"""The C of the flight build answers after each stage as the golden outputs have it, and a fault in any source shows."""

import pytest
from golden_outputs import differences, flight_answers, processor, read

from benchmarks.flight_faults import CAMERA, faults_of, planted
from simulator.study.exported_c.targets import HOST

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine (Debian: gcc)"),
]


@pytest.mark.parametrize(("arithmetic", "identifier"), [("fixed", "adaptive"), ("float", "triads")])
def test_answers_after_each_stage(arithmetic, identifier, tmp_path):
    """If a change is meant: python tests/helpers/golden_outputs.py flight --write, and why in the commit."""
    kept, where = read("flight")
    if where != processor():
        pytest.skip(f"the golden outputs are of another processor, whose tables may differ in a last bit: {where}")
    found = flight_answers(CAMERA, arithmetic, identifier, tmp_path)
    assert len(found) == 3
    assert differences(found, {name: kept[name] for name in found}) == []


@pytest.mark.slow
def test_a_fault_in_any_source_is_found(tmp_path):
    """One of at most twelve in each source: some change nothing, as those that `benchmarks.flight_faults` names."""
    if read("flight")[1] != processor():
        pytest.skip("the golden outputs are of another processor")
    blind = []
    for build, modules in planted(tmp_path):
        for module in modules:
            faults = faults_of(module, build.sources[f"tracker_{module}.c"], 12)
            if not any(build.is_found(fault) for fault in faults):
                blind.append((module, list(map(str, faults))))
    assert blind == []
