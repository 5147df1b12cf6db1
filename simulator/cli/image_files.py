"""Image files named on a command line, and the files written for each of them."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from simulator.cli.streams import is_terminal
from simulator.paths import make_folder
from startracker.errors import InputError
from startracker.files import IMAGE_BYTES, check_file, read_stream
from startracker.images.reading import sample_photo

FITS_SUFFIXES = (".fits", ".fit", ".fts")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", *FITS_SUFFIXES)


def image_files(paths: Sequence[Path]) -> Iterator[Path]:
    """Files, those of folders in their position; `InputError` for a folder without images, when it is reached."""
    for path in paths:
        found = sorted(p for p in path.iterdir() if p.suffix.lower() in _SUFFIXES) if path.is_dir() else [path]
        if not found:
            raise InputError(f"{path}: contains no image ({', '.join(_SUFFIXES)})")
        yield from found


def spooled(paths: Sequence[Path], folder: Path) -> list[Path]:
    """The paths, with ``-`` replaced by a file in `folder` that holds what standard input gave.

    ``sample``, where there is no such file, is the photograph that ships.

    Raises
    ------
    InputError
        If ``-`` is named twice, or standard input is a terminal, is closed or cannot be read.
    """
    paths = [sample_photo() if path == Path("sample") and not path.exists() else path for path in paths]
    if paths.count(Path("-")) > 1:
        raise InputError("-: standard input can be read only once")
    if Path("-") not in paths:
        return paths
    advice = "send an image to it, for example: boresight solve - < a.jpg"
    if sys.stdin is None or sys.stdin.closed:
        raise InputError(f"-: standard input is closed; {advice}")
    if is_terminal(sys.stdin):
        raise InputError(f"-: standard input is a terminal; {advice}")
    try:
        data = read_stream(sys.stdin.buffer, IMAGE_BYTES, "-: standard input", advice)
    except OSError as error:
        raise InputError(f"-: standard input cannot be read ({error.strerror or error}); {advice}") from error
    file = folder / ("standard-input.fits" if data.startswith(b"SIMPLE  =") else "standard-input")
    file.write_bytes(data)
    return [file if path == Path("-") else path for path in paths]


def shown_name(path: Path) -> str:
    """Name of an image in the answer: as the user wrote it."""
    if path.stem == "standard-input":
        return path.name
    return "sample" if path == sample_photo() else str(path)


class OutputFiles:
    """Where an option such as ``--annotate`` writes: the file named, or for several images a folder with one file each.

    Parameters
    ----------
    given : Path, optional
        The option's value; None writes nothing.
    several : bool
        Whether there is more than one image, so that `given` is a folder, which is made.
    suffix : str
        Of the files in a folder, such as ``.png``.
    """

    def __init__(self, given: Path | None, several: bool, suffix: str) -> None:
        self.given, self.suffix = given, suffix
        self.is_folder = given is not None and (several or given.is_dir())
        self._taken: set[str] = set()
        if given is not None and self.is_folder:
            if given.suffix and not given.is_dir():
                raise InputError(f"{given}: for several images name a folder, in which each image gets a file")
            make_folder(given)

    def path(self, image: Path) -> Path | None:
        """File for an image; two images of one name and different suffixes get different files."""
        if self.given is None or not self.is_folder:
            return self.given
        name = image.stem if image.stem not in self._taken else image.name.replace(".", "-")
        self._taken.add(name)
        return self.given / f"{name}{self.suffix}"


def is_our_frame(path: Path) -> bool:
    """Whether a FITS file has the camera that `simulator.fits.write_fits` writes."""
    check_file(path, IMAGE_BYTES, "give an image")
    try:
        with path.open("rb") as stream:
            return b"CAM_FX  =" in stream.read(80 * 36 * 8)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
