"""Curves over wavelength: loading, arithmetic, and every fault of a file told in one line."""

import math
import pickle

import numpy as np
import pytest

from simulator.optics.curves import FLAT_RANGE_NM, Curve, load_curve, shipped_curves
from startracker.errors import InputError


def test_number_is_flat_and_zero_outside():
    curve = load_curve(0.4, "transmission")
    np.testing.assert_array_equal(curve([299.9, 300.0, 700.0, 1100.0, 1100.1]), [0, 0.4, 0.4, 0.4, 0])
    assert (curve.wavelength_nm[0], curve.wavelength_nm[-1]) == FLAT_RANGE_NM


def test_interpolates_between_points_and_cannot_be_changed():
    source = np.array([400.0, 500.0])
    curve = Curve(source, np.array([0.0, 1.0]))
    source[0] = 450.0
    assert curve(425.0) == 0.25
    with pytest.raises(ValueError, match="read-only"):
        curve.value[0] = 1.0
    again = pickle.loads(pickle.dumps(curve))
    np.testing.assert_array_equal(again.value, curve.value)


def test_product_is_sampled_finely_enough_for_the_parabola_between_points():
    rise, fall = Curve([400.0, 600.0], [0.0, 1.0]), Curve([500.0, 700.0], [1.0, 0.0])
    product = rise * fall
    assert product.wavelength_nm[[0, -1]].tolist() == [500.0, 600.0]
    w = np.linspace(500, 600, 777)
    # curvature of the product 2/(200 × 200), step 1 nm: h²/8 × that = 6.3e-6
    np.testing.assert_allclose(product(w), (w - 400) / 200 * (700 - w) / 200, atol=6.3e-6)


def test_product_without_common_wavelengths_is_refused():
    with pytest.raises(InputError, match=r"no wavelength in common: 400 to 500 nm and 600 to 700 nm"):
        Curve([400.0, 500.0], [1.0, 1.0]) * Curve([600.0, 700.0], [1.0, 1.0])


@pytest.mark.parametrize("kind", ["transmission", "quantum_efficiency", "passband"])
def test_every_shipped_curve_loads(kind):
    names = shipped_curves(kind)
    assert names
    for name in names:
        curve = load_curve(name, kind)
        assert 0.1 < curve.value.max() <= 1.0
        assert curve.wavelength_nm[0] > 250
        assert curve.wavelength_nm[-1] < 1300


def test_shipped_values():
    assert shipped_curves("quantum_efficiency") == ["ccd44_82", "cmv4000", "gaas", "imx571", "multialkali", "tc211"]
    np.testing.assert_array_equal(
        load_curve("tc211", "quantum_efficiency")([440, 550, 640, 790, 1250]), [0.2, 0.4, 0.5, 0.38, 0.05]
    )
    np.testing.assert_array_equal(load_curve("cmv4000", "quantum_efficiency")([550, 900]), [0.6, 0.08])


def test_glass_lens_is_the_model_its_file_states():
    lens = load_curve("glass_lens", "transmission")
    w = lens.wavelength_nm
    reflectance = 0.004 + 0.03 * np.minimum(1, ((w - 550) / 450) ** 2)
    np.testing.assert_allclose(lens.value, (1 - reflectance) ** 12 / (1 + np.exp(-(w - 372) / 9)), atol=5.1e-5)


def test_file_relative_to_a_folder_with_comments_and_byte_order_mark(tmp_path):
    (tmp_path / "lens.csv").write_text(
        "\ufeff# mine\nwavelength_nm,transmission\n\n400,0.5\n 500 , 0.7\n", encoding="utf-8"
    )
    curve = load_curve("lens.csv", "transmission", tmp_path)
    assert curve(450.0) == pytest.approx(0.6, abs=1e-15)
    assert load_curve(str(tmp_path / "lens.csv"), "transmission", "/nowhere")(400.0) == 0.5


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"lens\.csv: needs a header 'wavelength_nm,value' and two or more lines; found 0"),
        ("wavelength_nm,value\n400,0.5\n", r"lens\.csv: needs .* found 1"),
        ("400,0.5\n500,0.5\n", r"lens\.csv:1: the header must be 'wavelength_nm,value'; found '400,0\.5'"),
        ("wavelength_um,value\n0.4,0.5\n", r"lens\.csv:1: the header must be"),
        ("wavelength_nm,value\n400,0.5\n500;0.5\n", r"lens\.csv:3: a line holds a wavelength and a value"),
        ("wavelength_nm,value\n400,0.5\n500,half\n", r"lens\.csv:3: '500,half' is not two numbers"),
        ("wavelength_nm,value\n400,0.5\n500,nan\n", r"lens\.csv:3: a value must lie between 0 and 1; found nan"),
        ("wavelength_nm,value\n400,0.5\n500,1.01\n", r"lens\.csv:3: a value must lie between 0 and 1; found 1\.01"),
        ("wavelength_nm,value\n# x\n400,-0.1\n", r"lens\.csv:3: a value must lie between 0 and 1; found -0\.1"),
        (
            "wavelength_nm,value\n500,0.5\n400,0.5\n",
            r"lens\.csv:3: wavelengths must be ascending; 400 nm follows 500 nm",
        ),
        ("wavelength_nm,value\n500,0.5\n500,0.5\n", r"lens\.csv:3: wavelengths must be ascending"),
        ("wavelength_nm,value\n-5,0.5\n500,0.5\n", r"lens\.csv:2: a wavelength must be a positive number"),
        ("wavelength_nm,value\ninf,0.5\n", r"lens\.csv:2: a wavelength must be a positive number"),
    ],
)
def test_faults_of_a_file(tmp_path, text, said):
    (tmp_path / "lens.csv").write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        load_curve("lens.csv", "transmission", tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        (1.1, "a transmission lies between 0 and 1; got 1.1"),
        (math.nan, "a transmission lies between 0 and 1; got nan"),
        (True, "a transmission is a number, a name or a CSV file; got True"),
        ("glas_lens", r"'glas_lens' is not an included transmission .*\(glass_lens\).*; did you mean 'glass_lens'\?"),
        ("cmv4000", r"'cmv4000' is not an included transmission"),
        (
            "missing.csv",
            r"missing\.csv: cannot be read \(No such file or directory\); give a CSV file of the transmission",
        ),
    ],
)
def test_faults_of_a_specification(tmp_path, spec, said):
    with pytest.raises(InputError, match=said):
        load_curve(spec, "transmission", tmp_path)


def test_binary_file_and_folder(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00\x01")
    (tmp_path / "b.csv").mkdir()
    with pytest.raises(InputError, match=r"a\.csv: is not text"):
        load_curve("a.csv", "transmission", tmp_path)
    with pytest.raises(InputError, match=r"b\.csv: cannot be read"):
        load_curve("b.csv", "transmission", tmp_path)


@pytest.mark.parametrize(
    ("wavelength_nm", "value", "said"),
    [
        ([400.0], [1.0], "two or more points"),
        ([400.0, 500.0], [1.0], "two or more points"),
        ([400.0, math.nan], [1.0, 1.0], "finite"),
        ([400.0, 400.0], [1.0, 1.0], "must be ascending"),
    ],
)
def test_faults_of_arrays(wavelength_nm, value, said):
    with pytest.raises(InputError, match=said):
        Curve(np.array(wavelength_nm), np.array(value))
