"""M.N formats: the examples of Yee 1999, sections 3.2.1 to 3.3, bit by bit, and what is refused."""

import numpy as np
import pytest

from simulator.theses.yee1999.fixed_point.formats import CENTROID, COSINE, FixedPointOverflow, Format, divide, integers

F44 = Format(4, 4)


def bits(text: str) -> int:
    """The integer of a two's complement number as the thesis writes it."""
    digits = text.replace(".", "")
    return int(digits, 2) - (1 << len(digits) if digits[0] == "1" else 0)


def test_range():
    assert (F44.decode(F44.smallest), F44.decode(F44.largest)) == (-8.0, 7.9375)
    assert (CENTROID.bits, COSINE.bits, COSINE.smallest, COSINE.largest) == (32, 16, 0, 65535)
    assert F44.text(bits("1110.1000")) == "1110.1000"


def test_addition():
    assert F44.add(bits("0011.0000"), bits("0001.1000")) == bits("0100.1000")
    with pytest.raises(FixedPointOverflow) as overflow:  # 4.75 + 5.0: her 1001.1100, −6.25
        F44.add(bits("0100.1100"), bits("0101.0000"))
    assert F44.text(overflow.value.value) == "1001.1100"
    assert overflow.value.operation == "addition"


def test_subtraction():
    assert F44.subtract(bits("0011.0000"), bits("0001.1000")) == bits("0001.1000")
    assert F44.text(-bits("0001.1000")) == "1110.1000"
    with pytest.raises(FixedPointOverflow):
        F44.subtract(F44.smallest, 1)


def test_multiplication():
    assert F44.multiply(bits("0011.0000"), bits("0001.1000")) == bits("0100.1000")
    with pytest.raises(FixedPointOverflow) as overflow:  # −3 × 7.5
        F44.multiply(bits("1101.0000"), bits("0111.1000"))
    assert overflow.value.value == bits("11101001.1000")
    # printed as 1110_1010.1000_0000 and 111_1110_1010.1000, which are −21.5; the value beside them, −22.5, is right
    assert overflow.value.value / 16 == -22.5


def test_division():
    assert F44.divide(bits("0101.0010"), bits("0010.0000")) == bits("0010.1001")
    with pytest.raises(FixedPointOverflow) as overflow:
        F44.divide(bits("0101.0010"), bits("0000.1000"))
    assert overflow.value.value == bits("00001010.0100")
    with pytest.raises(FixedPointOverflow, match="division by zero"):
        F44.divide(1, 0)


def test_division_truncates_towards_zero_as_c_does():
    assert divide([7, -7, 7, -7, 0], [2, 2, -2, -2, 5]).tolist() == [3, -3, -3, 3, 0]


def test_conversion():
    assert F44.encode(5.625) == 90
    assert F44.encode([1.98, -1.98]).tolist() == [31, -31]
    assert F44.decode(31) == 1.9375
    assert F44.encode(1.98, rounded=True) == 32
    with pytest.raises(FixedPointOverflow):
        F44.encode(8.0)
    with pytest.raises(ValueError, match="finite"):
        F44.encode(float("nan"))


def test_integers_in_formats():
    assert F44.from_integer(3) == bits("0011.0000")
    with pytest.raises(FixedPointOverflow):
        F44.from_integer(8)


def test_floats_are_refused():
    for operation in (F44.add, F44.subtract, F44.multiply, F44.divide):
        with pytest.raises(TypeError, match="float64"):
            operation(1, 1.0)
    with pytest.raises(TypeError):
        integers(np.array([object()]))


def test_products_beyond_64_bits_are_seen():
    wide = Format(32, 32)
    with pytest.raises(FixedPointOverflow, match="64 bits"):
        wide.multiply(1 << 40, 1 << 40)
    with pytest.raises(FixedPointOverflow):
        wide.divide(1 << 40, 3)


@pytest.mark.parametrize(("whole", "fraction"), [(0, 4), (4, -1), (40, 30)])
def test_no_such_format(whole, fraction):
    with pytest.raises(ValueError, match="not a fixed-point format"):
        Format(whole, fraction)
