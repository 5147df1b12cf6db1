"""The thesis' run times: her averages, this machine, the emulated 68k."""

from importlib import import_module

import pytest

from simulator.study.exported_c.build import compile_export
from simulator.study.exported_c.targets import M68K, Target
from simulator.theses.yee1999 import SECTIONS
from simulator.theses.yee1999.catalogue import printed_rows
from simulator.theses.yee1999.integer_build import star_text
from simulator.theses.yee1999.integers import fixed_centroids, star_pixels
from simulator.theses.yee1999.picture import deneb
from simulator.theses.yee1999.run_times import version_b
from startracker.flight.export import flight_export

pytestmark = pytest.mark.system


def test_fixed_point_columns_of_her_centroids():
    """Every one of 28 coordinates within her own differences, and towards the centre of the image as hers."""
    for star in printed_rows("table_4_14"):
        x, y, dn = star_pixels(float(star["x"]), float(star["y"]))
        assert (dn > 30).all()
        assert (dn <= 255).all()
        for name, pixels in (("x", x), ("y", y)):
            assert abs((pixels * dn).sum() / dn.sum() - float(star[name])) < 5e-6
    rows = fixed_centroids()
    assert [row.where for row in rows] == ["Table 4.14"] * 2 + ["Table 4.15"] * 2 + ["Table 4.16"] * 2
    assert {row.verdict for row in rows} == {"close"}


def test_without_a_cross_compiler(monkeypatch):
    module = import_module("simulator.theses.yee1999.run_times")
    monkeypatch.setattr(module, "M68K", Target("none", "no-such-gcc"))
    rows = SECTIONS["times"]().rows
    trials = [row for row in rows if row.quantity.endswith("average and run-time")]
    assert len(trials) == 17
    assert all(row.verdict == "exact" for row in trials)
    emulated = [row for row in rows if "68k" in row.quantity]
    assert [row.computed for row in emulated] == ["not measured", "not measured"]
    assert all(row.verdict == "input missing" and "gcc-m68k-linux-gnu" in row.why for row in emulated)
    here = [row for row in rows if row.where == "Table 4.21"]
    assert [row.verdict for row in here] == ["input missing"] * 4


@pytest.mark.skipif(M68K.missing() is not None, reason=f"{M68K.missing()} is not installed")
def test_version_b_on_the_68k(tmp_path):
    """Nine stars of the Deneb image are named as in the thesis, also at its plate scale."""
    design = version_b(deneb())
    build = compile_export(flight_export(design), tmp_path, M68K)
    (answer,) = build.run(star_text(deneb().xy_px, design).encode(), "stars").decode().splitlines()
    assert answer.startswith("solved accepted stars=9 matched=9 ")
    assert answer.endswith("numbers=7924,7735,7751,7977,7844,7851,8001,8003,7798")
    assert build.code_bytes < 80_000
    assert build.stack_bytes < 4096
    assert build.heap_calls == ()


@pytest.mark.slow
@pytest.mark.skipif(M68K.missing() is not None, reason=f"{M68K.missing()} is not installed")
def test_section_with_the_68k():
    rows = {row.quantity: row for row in SECTIONS["times"]().rows}
    vega, deneb_ = (float(rows[f"{name} on the 68k: fixed point, version B"].computed.split()[0]) for name in NAMES)
    # the printed times are 235 and 592 million clocks of a processor that takes several for an instruction
    assert 3.0 < vega < 12.0
    assert vega < deneb_ < 20.0
    assert float(rows["Deneb minus Vega"].computed.split()[0]) == pytest.approx(deneb_ - vega, abs=0.011)


NAMES = ("Vega", "Deneb")
