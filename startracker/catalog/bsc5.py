"""The Yale Bright Star Catalogue, 5th revised edition (preliminary version), parsed from the published file.

Credit: D. Hoffleit, W. H. Warren Jr., *The Bright Star Catalogue, 5th Revised Ed. (Preliminary Version)*,
Astronomical Data Center, NSSDC/ADC, 1991 (CDS V/50). The file ships unmodified, as its terms require.
"""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.fixed_width import FixedWidth
from startracker.catalog.source import SourceFile
from startracker.catalog.stars import StarCatalog
from startracker.core import ARCSEC_RAD

EPOCH_JYEAR = 2000.0
"""Epoch and equinox of the positions; FK5, which agrees with ICRS to 0.1″, below the rounding of the file."""

POSITION_SIGMA_RAD = 0.55 * ARCSEC_RAD
"""On one axis: positions are rounded to 0.1 s and 1″; the median distance from Hipparcos-2 is 0.65″ (0.65″/1.177)."""


def load_bsc5() -> StarCatalog:
    """The 9,096 stars of the catalogue, without the 14 rows of novae, clusters and galaxies that only have a number.

    Positions are rounded to 0.1 s and 1″ in the file; the median error relative to Hipparcos is 0.65″. Proper motions
    are in the FK5 system, with RA multiplied by cos Dec. Parallaxes are trigonometric or dynamical.
    """
    data = (files("startracker.catalog") / "data" / "bsc5.dat").read_bytes()
    catalog = parse_bsc5(data)
    return replace(catalog, source=replace(catalog.provenance, files=(SourceFile.of(data, "bsc5.dat"),)))


def parse_bsc5(data: bytes) -> StarCatalog:
    """Catalogue from the contents of a file in the layout of CDS V/50.

    Raises
    ------
    InputError
        If a row is not in that layout.
    """
    table = FixedWidth.from_bytes(data, width=197, where="bsc5")
    table = table.rows(table.text(76, 77) != "")  # non-stellar rows have no position
    ra_h = table.number(76, 77) + table.number(78, 79) / 60 + table.number(80, 83) / 3600
    dec_deg = table.number(85, 86) + table.number(87, 88) / 60 + table.number(89, 90) / 3600
    dec_deg = np.where(table.text(84, 84) == "-", -dec_deg, dec_deg)
    return StarCatalog(
        name="bsc5",
        epoch_jyear=EPOCH_JYEAR,
        id=table.number(1, 4).astype(np.int64),
        ra_rad=np.radians(15.0 * ra_h),
        dec_rad=np.radians(dec_deg),
        pm_ra_rad_yr=table.number(149, 154, missing=0.0) * ARCSEC_RAD,
        pm_dec_rad_yr=table.number(155, 160, missing=0.0) * ARCSEC_RAD,
        # A few trigonometric parallaxes are negative; the distance is then unknown.
        parallax_rad=np.maximum(table.number(162, 166, missing=0.0), 0.0) * ARCSEC_RAD,
        radial_velocity_km_s=table.number(167, 170, missing=0.0),
        v_mag=table.number(103, 107),
        b_v=table.number(110, 114),
        spectral_type=table.text(128, 147),
        star_name=_names(table),
        position_sigma_rad=POSITION_SIGMA_RAD,
        variable=_variable(table),
    )


def _variable(table: FixedWidth) -> NDArray[np.bool_]:
    """Known variables: VarID is a name of the General Catalogue of Variable Stars ("R And", "Gam Cas"), or "Var".

    Suspected variables are excluded: "Var?", and a bare number, which is from the New Catalogue of Suspected Variable
    Stars (Kukarkin et al. 1982).
    """
    name = table.text(52, 60)
    numbered = np.char.isdigit(name.astype("U1"))  # "7134/5" too; no designation begins with a digit
    return np.asarray((name != "") & ~numbered & (name != "Var?"), dtype=np.bool_)


def _names(table: FixedWidth) -> NDArray[np.str_]:
    """Bayer letter and constellation ("Alp1 Cen"), else Flamsteed number ("33 Psc"), else an empty string."""
    flamsteed, bayer, constellation = table.text(5, 7), table.text(8, 11), table.text(12, 14)
    # The superscript is in its own column.
    designation = np.where(bayer != "", np.char.replace(bayer, " ", ""), flamsteed)
    names = np.char.add(np.char.add(designation, " "), constellation)
    return np.where(designation != "", names, "")
