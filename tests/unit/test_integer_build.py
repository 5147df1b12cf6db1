"""The flight build in integers in the study of the thesis; compilers that are missing."""

from importlib import import_module

import numpy as np
import pytest

from simulator.study.exported_c.build import compile_export
from simulator.study.exported_c.targets import HOST, M68K, Target
from simulator.theses.yee1999 import SECTIONS
from simulator.theses.yee1999.integer_build import attitude_differences
from startracker import Camera
from startracker.errors import InputError
from startracker.flight.c_text import CExport

pytestmark = pytest.mark.system

CAMERA = Camera.from_fov(12.0, 512, 512)
needs_gcc = pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine")


@needs_gcc
def test_attitudes_are_those_of_double_precision():
    """A hundredth of the standard error where both use the same stars, and below one where one uses a star more."""
    off = np.abs(attitude_differences())
    assert len(off) > 60
    boresight, _, error = off.T
    assert np.median(boresight / error) < 0.01
    assert (boresight < error).all()


@needs_gcc
def test_section(monkeypatch):
    module = import_module("simulator.theses.yee1999.integer_build")  # the package has a function of that name
    monkeypatch.setattr(module, "M68K", Target("none", "no-such-gcc"))  # its instructions are counted below
    section = SECTIONS["build"]()
    rows = {row.quantity: row for row in section.rows}
    assert rows["centre of the Vega image"].verdict == "close"
    assert rows["attitude in integers"].computed.startswith("boresight within 0.")
    assert "kB of tables" in rows["databases in memory"].computed
    low, high = (
        rows["difference of fixed-point and floating-point centroids"].computed.removesuffix(" px").split(" to ")
    )
    assert 0.0 <= float(low) <= float(high) < 1e-4
    assert rows["database of enclosed angles"].computed == "4.7 MB"
    assert "by 1 in the last bit" in rows["databases in memory"].why
    assert rows["fixed point"].computed.endswith("ms")
    assert "heap 0" in rows["memory, this machine"].computed
    assert not any("68k" in name for name in rows)
    axes = section.figure("integer_attitude").axes[0]
    assert "″" in axes.get_xlabel()


def test_section_without_a_compiler(monkeypatch):
    module = import_module("simulator.theses.yee1999.integer_build")
    monkeypatch.setattr(module, "M68K", Target("none", "no-such-gcc"))
    monkeypatch.setattr(module, "native_compiler", lambda: None)
    monkeypatch.setattr(module, "attitude_differences", lambda: np.empty((0, 3)))
    rows = {row.quantity for row in SECTIONS["build"]().rows}
    assert "databases in memory" in rows
    assert not rows & {"attitude in integers", "centre of the Vega image", "fixed point in C"}


@pytest.mark.slow
@pytest.mark.skipif(M68K.missing() is not None, reason=f"{M68K.missing()} is not installed")
def test_section_with_the_68k():
    rows = {row.quantity: row for row in SECTIONS["build"]().rows}
    assert rows["fixed point in C on the 68k"].computed.endswith(" instructions")
    assert "heap 0" in rows[f"memory, {M68K.name}"].computed


def test_compilers_that_are_not_there_or_refuse(tmp_path):
    export = CExport("bad", {"bad_tables.c": "int x = ;\n"}, {})
    with pytest.raises(InputError, match="no-such-gcc is not installed"):
        compile_export(export, tmp_path, Target("none", "no-such-gcc"))
    if HOST.missing() is None:
        with pytest.raises(InputError, match="gcc"):
            compile_export(export, tmp_path)
