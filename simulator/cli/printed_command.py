"""``boresight study greyling1995`` and ``yee1999``: printed works computed again, their values beside ours."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simulator.cli.options import option, switch
from simulator.cli.terminal import open_console
from startracker._version import __version__
from startracker.errors import InputError

if TYPE_CHECKING:
    from simulator.theses.printed import PrintedStudy

WIDTH = 140  # columns of the table where the output is not a terminal

SectionName = Annotated[
    str | None, option("--section", "NAME", "Compute this section only; an unknown name lists the sections.")
]
OutFolder = Annotated[Path | None, option("--out", "DIR", "Folder for the table and the figures; default: out/NAME.")]

Force = Annotated[bool, switch("--force", "Replace results of another version, or of more sections, in DIR.")]


@dataclass(frozen=True)
class PictureRequest:
    """Recompute Yee 1999 (identification by triads), or its tables for any list of centroids."""

    centroids: Annotated[
        Path | None,
        option(
            "--centroids",
            "FILE.csv",
            "Columns x, y, brightest first, or with flux; default: the Vega image of the thesis.",
        ),
    ] = None
    size: Annotated[str | None, option("--size", "WxH", "Image size, pixels.")] = None
    fov: Annotated[str | None, option("--fov", "XxY", "Field of view, degrees, such as 9.0130x6.9049.")] = None
    edition: Annotated[
        int | None,
        option("--edition", "4|5", "Edition of the Bright Star Catalogue; default: 4 for the Vega image, otherwise 5."),
    ] = None
    origin: Annotated[
        str,
        option(
            "--origin",
            "WHERE",
            "Origin of the centroids: centre (y up), corner (columns and rows, y down), or auto (centre if a value "
            "is negative).",
        ),
    ] = "auto"
    magnitude_limit: Annotated[
        float, option("--magnitude-limit", "V", "Magnitude of the faintest star of the sub-catalogue.")
    ] = 6.0
    dec: Annotated[str, option("--dec", "MIN:MAX", "Range of declinations of the sub-catalogue, degrees.")] = "30:90"
    max_separation_deg: Annotated[
        float | None,
        option("--max-separation-deg", "A", "Maximum separation in the pair database; default: diagonal of the field."),
    ] = None
    separation_tolerance_deg: Annotated[
        float, typer.Option(metavar="A", help="Maximum difference of a separation, degrees.")
    ] = 0.15
    rotation_tolerance_deg: Annotated[
        float, typer.Option(metavar="A", help="Maximum difference between the rotations of a triad, degrees.")
    ] = 5.0
    enclosed_tolerance_deg: Annotated[
        float, typer.Option(metavar="A", help="Maximum difference of an inner angle, degrees.")
    ] = 1.0
    grouping_tolerance_deg: Annotated[
        float, typer.Option(metavar="A", help="Maximum difference from the mean rotation of a group, degrees.")
    ] = 5.0
    vote_number: Annotated[int, typer.Option(metavar="N", help="Minimum number of triads that contain a star.")] = 2
    tau_px: Annotated[float, typer.Option(metavar="R", help="Catalogue stars closer than this are merged, pixels.")] = (
        8.0
    )
    three_stars: Annotated[
        bool, switch("--three-stars", "Match three stars alone if one group of triads is found.")
    ] = False
    integers: Annotated[bool, switch("--integers", "Identify in integer arithmetic.")] = False
    points: Annotated[
        list[str] | None,
        option("--point", "X,Y", "Print right ascension and declination of a point (origin as of the centroids)."),
    ] = None
    json_file: Annotated[Path | None, option("--json", "FILE", "Write all tables as JSON.")] = None
    section: SectionName = None
    out: OutFolder = None
    force: Force = False


def greyling1995_study(section: SectionName = None, out: OutFolder = None, force: Force = False) -> int:
    """Recompute Greyling 1995 (star camera of a microsatellite): published values beside computed ones."""
    from simulator.theses import greyling1995

    folder = out or Path("out") / "greyling1995"
    return finish(lambda progress: greyling1995.run(section, progress), "greyling1995", section, folder, force)


def finish(
    run: Callable[[Callable[[str], None]], PrintedStudy], name: str, section: str | None, path: Path, force: bool
) -> int:
    """Run the study of a printed work with its progress shown, print its table, write its JSON and figures.

    Parameters
    ----------
    run : callable
        Computes it; is given what to call with the name of each section.
    name : str
        Of the study.
    section : str, optional
        The only section that is computed.
    path : Path
        Where the files go.
    force : bool
        Replace existing results.

    Returns
    -------
    int
        Exit status 0.

    Raises
    ------
    InputError
        Where results of another version or of more sections stand, or another process is at work there.
    """
    from simulator.paths import make_folder
    from simulator.study.folder_lock import folder_lock

    folder = make_folder(path)
    with folder_lock(folder):
        if not force:
            _refuse_loss(folder / f"{name}.json", section)
        with open_console(error=True).status("computing") as status:
            study = run(lambda part: status.update(f"computing: {part}"))
            status.update("drawing the figures")
            files = study.write(folder)
    study.print(open_console(WIDTH))
    print(f"{folder}: {', '.join(files)}")
    return 0


def _refuse_loss(file: Path, section: str | None) -> None:
    """Refuse to replace results of another version, or of more sections."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        version, sections = found["version"], list(found["sections"])
    except FileNotFoundError:
        return
    except (OSError, ValueError, KeyError, TypeError):
        version, sections = "unknown", []
    either = "choose another --out, or replace them with --force"
    if version != __version__:
        raise InputError(f"{file}: contains results of another version (boresight {version}); {either}")
    if section is not None and set(sections) > {section}:
        raise InputError(
            f"{file}: contains results of {len(sections)} sections (boresight {version}), but only '{section}' is "
            f"requested; {either}"
        )
