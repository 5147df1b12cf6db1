"""Names and figures: every star named in the data files is in both catalogues, in its place and bright enough."""

import numpy as np
import pytest

from startracker import load_catalog
from startracker.catalog.names import constellation_lines, designation, proper_name, proper_names

CATALOGS = ("bsc5", "hipparcos")


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("Alp1 Cen", "α¹ Cen"),
        ("Ome2 Sco", "ω² Sco"),
        ("Mu  Cep", "μ Cep"),
        ("61 Cyg", "61 Cyg"),
        ("", ""),
    ],
)
def test_bayer_letters_are_greek(given, wanted):
    assert designation(given) == wanted


def test_well_known_names():
    assert proper_name("Alp CMa") == "Sirius"
    assert proper_name("Bet Per") == "Algol"
    assert proper_name("Nu Sgr") == ""
    names = list(proper_names().values())
    assert len(names) == len(set(names)) > 250


# HIP numbers of well-known stars, as SIMBAD gives them
HIP = {"Sirius": 32349, "Vega": 91262, "Polaris": 11767, "Rigel": 24436, "Antares": 80763, "Mizar": 65378,
       "Alcyone": 17702, "Fomalhaut": 113368, "Acrux": 60718, "Algol": 14576, "Thuban": 68756}  # fmt: skip


def test_names_stand_by_the_stars_that_have_them():
    catalog = load_catalog("hipparcos")
    row = {int(number): k for k, number in enumerate(catalog.id)}
    for name, number in HIP.items():
        assert proper_name(str(catalog.star_name[row[number]])) == name


@pytest.mark.parametrize("catalog", CATALOGS)
def test_every_proper_name_has_its_star(catalog):
    stars = load_catalog(catalog)
    # the components of a double share a name: the brighter one comes last, and stays
    order = np.argsort(-stars.v_mag)
    have = {" ".join(str(stars.star_name[k]).split()): float(stars.v_mag[k]) for k in order}
    for star in proper_names():
        assert star in have
        assert have[star] < 6.5


@pytest.mark.parametrize("catalog", CATALOGS)
def test_figures_join_bright_neighbours(catalog):
    stars = load_catalog(catalog)
    pairs, names = constellation_lines(stars)
    assert len(pairs) == len(names) == 615  # as many lines as the file has: no star is missing
    assert len(set(names)) == 83
    assert stars.v_mag[pairs].max() < 5.6
    directions, _ = stars.space_motion()
    length = np.degrees(np.arccos(np.sum(directions[pairs[:, 0]] * directions[pairs[:, 1]], axis=1)))
    assert 0.3 < length.min()
    assert length.max() < 22.0  # a mistaken letter would join stars across the sky
    # Orion's belt: Alnitak, Alnilam and Mintaka are joined
    belt = {26727, 26311, 25930} if catalog == "hipparcos" else {1948, 1903, 1852}
    joined = [set(stars.id[pair].tolist()) for pair in pairs]
    assert sum(pair <= belt for pair in joined) == 2
