"""The stars of the page's sky map, against positions and colours known elsewhere."""

import json

import pytest

from simulator.live.bright_sky import bright_sky


@pytest.fixture(scope="module")
def sky():
    return json.loads(bright_sky())


@pytest.mark.parametrize(
    ("name", "ra_deg", "dec_deg", "magnitude"),
    [  # ICRS, J2000.0, and V: SIMBAD
        ("Sirius", 101.28716, -16.71612, -1.46),
        ("Vega", 279.23473, 38.78369, 0.03),
        ("Polaris", 37.95456, 89.26411, 2.02),
    ],
)
def test_known_stars_are_where_they_are(sky, name, ra_deg, dec_deg, magnitude):
    star = next(star for star in sky["stars"] if star["name"] == name)
    assert star["ra_deg"] == pytest.approx(ra_deg, abs=2e-3)  # rounded to 0.001°; the catalogue to 0.1 s of time
    assert star["dec_deg"] == pytest.approx(dec_deg, abs=1e-3)
    assert star["magnitude"] == pytest.approx(magnitude, abs=0.05)


def test_red_giants_are_red_and_hot_stars_blue(sky):
    colours = {star["name"]: [int(star["colour"][k : k + 2], 16) for k in (1, 3, 5)] for star in sky["stars"]}
    for name in ("Betelgeuse", "Antares", "Aldebaran"):
        assert colours[name][0] == 255 > colours[name][2] + 60
    for name in ("Rigel", "Spica", "Bellatrix"):
        assert colours[name][2] == 255 > colours[name][0] + 40


def test_stars_are_sorted_and_lines_join_stars_of_the_belt(sky):
    magnitudes = [star["magnitude"] for star in sky["stars"]]
    assert magnitudes == sorted(magnitudes)
    assert 300 < len(magnitudes) < 1000
    belt = {(85.19, -1.94), (84.05, -1.2)}  # ζ and ε Orionis
    assert any({tuple(end) for end in line} == belt for line in sky["lines"])
