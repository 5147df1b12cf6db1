"""``boresight catalog``: star catalogues that a user adds from files."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from simulator.cli.options import option, switch
from simulator.cli.suggesting import SuggestingGroup
from startracker.errors import InputError

CatalogFiles = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE...",
        help="Tables of stars: CSV, Parquet or FITS, or index files of astrometry.net; several are joined.",
        show_default=False,
    ),
]
CatalogName = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of a catalogue that was added.", show_default=False)
]


def add_command(
    files: CatalogFiles,
    name: Annotated[
        str | None, option("--name", "NAME", "Name of the catalogue; default: the name of the first file.")
    ] = None,
    columns: Annotated[
        str | None,
        option(
            "--columns",
            "QUANTITY=COLUMN,...",
            "Columns with names of their own: ra, dec (degrees), v or vt, bt or g, bp, rp, b_v, pm_ra, pm_dec (mas per "
            "year, RA times cos Dec), parallax (mas), id.",
        ),
    ] = None,
    epoch: Annotated[
        float | None, option("--epoch", "YEAR", "Julian epoch of the positions, e.g. 2016 for Gaia DR3.")
    ] = None,
    sigma_mas: Annotated[float, option("--sigma-mas", "MAS", "Standard error of the positions at that epoch.")] = 100.0,
    magnitude_limit: Annotated[
        float | None, option("--magnitude-limit", "V", "Faintest star that is kept; default: all.")
    ] = None,
    hipparcos: Annotated[
        bool,
        switch("--hipparcos/--no-hipparcos", "Merge with Hipparcos: bright stars, their motions, parallaxes, names."),
    ] = True,
) -> int:
    """Add a catalogue from files, for --catalog NAME and the keys sky.catalog and tracker.catalog."""
    from startracker.catalog import CATALOGS
    from startracker.catalog.user import TableOptions, add_catalog

    options = TableOptions(
        epoch_jyear=epoch,
        columns=_mapping(columns or ""),
        sigma_mas=sigma_mas,
        magnitude_limit=float("inf") if magnitude_limit is None else magnitude_limit,
        hipparcos=hipparcos,
    )
    own_name = re.sub(r"[^a-z0-9_-]+", "-", files[0].name.partition(".")[0].lower()) if name is None else name
    print(add_catalog(own_name, files, options, tuple(CATALOGS)).provenance)
    return 0


def list_command() -> int:
    """List the catalogues: built in, and added with their files, stars, epoch and depth."""
    from startracker.catalog import CATALOGS
    from startracker.catalog.user import added_catalogs, catalogs_folder

    print(f"built in: {', '.join(sorted(CATALOGS))}")
    added = added_catalogs()
    print(f"added, in {catalogs_folder()}:" if added else "added: none (boresight catalog add)")
    for name, load in added.items():
        try:
            print(f"  {load().provenance}")
        except InputError as error:
            print(f"  {name}: {error}")
    return 0


def remove_command(name: CatalogName) -> int:
    """Remove a catalogue that was added."""
    from startracker.catalog.user import remove_catalog

    remove_catalog(name)
    print(f"removed {name}")
    return 0


def _mapping(given: str) -> dict[str, str]:
    """Quantities and columns of ``ra=RA_ICRS,dec=DE_ICRS``."""
    found: dict[str, str] = {}
    for part in filter(None, (part.strip() for part in given.split(","))):
        quantity, equals, column = part.partition("=")
        if not (equals and quantity.strip() and column.strip()):
            raise InputError(f"--columns: write QUANTITY=COLUMN,... such as ra=RA_ICRS,dec=DE_ICRS; got '{part}'")
        found[quantity.strip().lower()] = column.strip()
    return found


catalog_app = typer.Typer(
    cls=SuggestingGroup,
    help="Star catalogues: add your own from files, list them, remove them.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
_COMMANDS: dict[str, tuple[Callable[..., int], str]] = {
    "add": (add_command, "boresight catalog add gaia13.parquet --epoch 2016 --sigma-mas 1"),
    "list": (list_command, "boresight catalog list"),
    "remove": (remove_command, "boresight catalog remove gaia13"),
}
for _name, (_function, _example) in _COMMANDS.items():
    catalog_app.command(_name, epilog=f"Example: {_example}")(_function)
