"""``boresight stimulate``: a display before a real star tracker, calibrated by photographs of its patterns."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simulator.cli.centroid_list import parse_size
from simulator.cli.checks import at_least, writable
from simulator.cli.options import ScenarioFile, SetValues, option
from simulator.cli.suggesting import SuggestingGroup
from simulator.cli.terminal import open_console, print_table
from startracker.errors import InputError
from startracker.files import read_yaml

if TYPE_CHECKING:
    from simulator.live.stimulator import DisplayPicture, Pattern, Photograph, Stimulator
    from simulator.renderer import Renderer
    from startracker.geometry.camera import Camera

_SETTINGS = "pattern.yaml"
_PHOTOGRAPH = re.compile(r"(dots(-\w+)?|uniform|ramp-(red|green|blue)|black|off)\.(png|tiff?|fits?|fts)", re.IGNORECASE)
CameraFile = Annotated[Path, option("--camera", "CAMERA.yaml", "Calibrated camera that took the photographs.")]
PatternFile = Annotated[
    Path | None,
    option("--pattern", "PATTERN.yaml", "What the display showed; default: pattern.yaml beside the images."),
]
Flat = Annotated[
    Path | None,
    option("--flat", "IMAGE", "Flat field of the camera, by which the photographs are divided; default: uniform."),
]
StimulatorFile = Annotated[
    Path,
    typer.Argument(metavar="STIMULATOR.yaml", help="File of boresight stimulate calibrate.", show_default=False),
]


def pattern_command(
    out: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the pictures.", show_default=False)],
    size: Annotated[str, option("--size", "WxH", "Columns and rows of the display.")] = "1920x1080",
    colours: Annotated[str, option("--colours", "A,B,...", "Channels to drive.")] = "red,green,blue",
    spacing_px: Annotated[int, option("--spacing", "N", "Distance between the dots, display pixels, even.")] = 64,
    dot_px: Annotated[
        int, option("--dot", "N", "Width of a dot, odd; one to three pixels of the camera are measured best.")
    ] = 3,
) -> int:
    """Draw the patterns to be shown on the display, full screen and without scaling, and photographed."""
    from PIL import Image
    from ruamel.yaml import YAML

    from simulator.live.stimulator import Pattern
    from simulator.paths import make_folder, open_atomically

    names = tuple(name.strip() for name in colours.split(","))
    pattern = Pattern(*parse_size(size), names, spacing_px, dot_px)
    folder = make_folder(out)
    for name in pattern.names:
        with open_atomically(folder / f"{name}.png") as stream:
            Image.fromarray(pattern.image(name)).save(stream, "png")
    data = {"width": pattern.width, "height": pattern.height, "colours": list(names)}
    with open_atomically(folder / _SETTINGS) as stream:
        YAML().dump({**data, "spacing_px": spacing_px, "dot_px": dot_px}, stream)
    print(f"{folder}: {', '.join(f'{name}.png' for name in pattern.names)}, {_SETTINGS}")
    print(f"{len(pattern.lattice)} dots, {len(pattern.squares)} squares at {len(pattern.levels)} levels")
    return 0


def calibrate_command(
    photographs: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Folder of the photographs, named as the patterns: dots.fits, dots-2.fits, uniform.fits ...; "
            "off.fits shows the display switched off.",
            show_default=False,
        ),
    ],
    camera: CameraFile,
    focal_mm: Annotated[float, option("--focal-mm", "F", "Nominal focal length of the collimator, to 5 %.")],
    pitch_um: Annotated[float, option("--pitch-um", "P", "Pixel pitch of the display.")],
    exposure_s: Annotated[
        float, option("--exposure-s", "S", "Exposure time of all photographs but those of the dots.")
    ],
    zero_point: Annotated[
        float | None,
        option("--zero-point", "MAG", "Magnitude of a star that gives 1 DN per second; default: that of --scenario."),
    ] = None,
    gain_e_per_dn: Annotated[
        float | None, option("--gain", "G", "Electrons per DN of the camera; default: that of --scenario.")
    ] = None,
    scenario: Annotated[
        Path | None, option("--scenario", "SCENARIO", "Scenario of the camera, for its zero point and gain.")
    ] = None,
    flat: Flat = None,
    pattern: PatternFile = None,
    out: Annotated[Path, option("--out", "STIMULATOR.yaml", "File to write.")] = Path("stimulator.yaml"),
) -> int:
    """Calibrate display and collimator from photographs: geometry, distortion, brightness and curve of each colour."""
    from simulator.live.stimulator import Exposures, calibrate_display, nominal_geometry, stimulator_yaml
    from simulator.paths import write_atomically
    from startracker.geometry.camera import Camera

    writable(out)
    if not photographs.is_dir():
        raise InputError(f"{photographs}: is not a folder; give the folder of the photographs")
    files = {path.stem.lower(): path for path in sorted(photographs.iterdir()) if _PHOTOGRAPH.fullmatch(path.name)}
    if not files:
        raise InputError(f"{photographs}: has no photographs named as the patterns, such as dots.fits")
    shown = _pattern(pattern or photographs / _SETTINGS)
    nominal = nominal_geometry((shown.width, shown.height), pitch_um, focal_mm)
    known = Camera.from_yaml(camera)
    taken = Exposures(exposure_s, *_response(scenario, gain_e_per_dn, zero_point))
    loaded = {name: _photograph(path, known, flat) for name, path in files.items()}
    result = calibrate_display(shown, nominal, loaded, taken)
    write_atomically(out, stimulator_yaml(result.stimulator, result.summary()))
    print("\n".join(result.summary()))
    print(f"written: {out}")
    return 0


def align_command(
    stimulator: StimulatorFile,
    photograph: Annotated[
        Path, typer.Argument(metavar="PHOTOGRAPH", help="Of the pattern dots, by the tracker.", show_default=False)
    ],
    camera: CameraFile,
    pattern: Annotated[Path, option("--pattern", "PATTERN.yaml", "What the display showed.")] = Path(_SETTINGS),
    flat: Flat = None,
    out: Annotated[
        Path | None, option("--out", "FILE.yaml", "File to write; default: STIMULATOR.yaml is replaced.")
    ] = None,
) -> int:
    """Align a calibrated display with another camera, or one that was moved, from one photograph of the dots."""
    from simulator.live.stimulator import align_display, read_stimulator, stimulator_yaml
    from simulator.paths import write_atomically
    from startracker.geometry.camera import Camera

    target = out or stimulator
    writable(target)
    known = Camera.from_yaml(camera)
    aligned, report = align_display(
        read_stimulator(stimulator), _pattern(pattern), _photograph(photograph, known, flat)
    )
    write_atomically(target, stimulator_yaml(aligned, report))
    print("\n".join([*report, f"written: {target}"]))
    return 0


def preview_command(
    scenario: ScenarioFile,
    stimulator: Annotated[Path, option("--stimulator", "STIMULATOR.yaml", "Calibrated display.")],
    out: Annotated[Path, option("--out", "PICTURE.png", "Picture for the display, pixel by pixel.")] = Path("sky.png"),
    index: Annotated[int, option("--index", "I", "Trial of the scenario whose time and attitude are shown.")] = 0,
    pointing: Annotated[
        str | None, option("--pointing", "RA,DEC,ROLL", "Attitude in degrees instead of the trial's.")
    ] = None,
    set_values: SetValues = None,
) -> int:
    """Draw what the display shows of a scenario's sky, and list which magnitudes it can show and how exactly."""
    import numpy as np
    from PIL import Image

    from simulator.checks import load_scenario
    from simulator.cli.render_command import parse_pointing
    from simulator.live.stimulator import point_sources, read_stimulator
    from simulator.paths import open_atomically
    from simulator.renderer import Renderer

    at_least(0, index=index)
    writable(out)
    display = read_stimulator(stimulator)
    renderer = Renderer(load_scenario(scenario, set_values))
    scene = renderer.scene(index, attitude=parse_pointing(pointing) if pointing else None)
    picture = display.picture(scene.pointing.camera, *point_sources(scene, renderer.focal_plane))
    columns, rows = display.geometry.size
    image = np.zeros((rows, columns, 3), np.uint8)
    image[picture.pixels[:, 1], picture.pixels[:, 0]] = picture.rgb
    with open_atomically(out) as stream:
        Image.fromarray(image).save(stream, "png")
    print(f"{out}: {_count_text(picture)}")
    _print_limits(display, renderer)
    return 0


def _count_text(picture: DisplayPicture) -> str:
    return (
        f"{len(picture.star)} stars on the display, {int(picture.clipped.sum())} clipped, "
        f"{int(picture.faint.sum())} too faint for its levels"
    )


def _print_limits(display: Stimulator, renderer: Renderer) -> None:
    """Table of magnitudes with the errors of their display, down to the first that is too faint."""
    import numpy as np

    from startracker.core import ARCSEC_RAD

    first = np.floor(display.photometry.white_magnitude)
    limits = [
        one for one in display.limits(np.arange(first - 3.0, first + 14.0)) if not math.isnan(one.position_arcsec)
    ]
    print_table(
        open_console(),
        "stars by magnitude in the tracker's band",
        ("magnitude", "brightness, rms mag", "position, rms ″ on one axis", "clipped"),
        [
            (
                f"{one.magnitude:.0f}",
                f"{one.brightness_mag:.4f}",
                f"{one.position_arcsec:.3f}",
                "yes" if one.clipped else "",
            )
            for one in limits
        ],
    )
    camera, pixel = display.geometry.collimator, display.geometry.collimator.pixel_rad / ARCSEC_RAD
    print(
        f"display {camera.fov_text}, {pixel:.2f}″ a pixel, spots {2.3548 * display.spot_px * pixel:.1f}″ wide at half "
        f"maximum; the tracker's pixel is {renderer.camera.pixel_rad / ARCSEC_RAD:.2f}″"
    )
    errors = [display.uncertainty.get(f"attitude_{axis}_arcsec", math.nan) for axis in "xyz"]
    if not any(map(math.isnan, errors)):
        x, y, z = errors
        print(f"attitude from the calibration alone: {x:.3f}″, {y:.3f}″ across the boresight, {z:.2f}″ about it (1 σ)")


def _pattern(path: Path) -> Pattern:
    """Pattern of a file that ``stimulate pattern`` wrote."""
    from simulator.live.stimulator import Pattern

    data = read_yaml(path, "copy it from the patterns, or give --pattern")
    try:
        return Pattern(**data)
    except TypeError as error:
        raise InputError(f"{path}: is not a pattern file: {' '.join(str(error).split())}") from error


def _response(scenario: Path | None, gain: float | None, zero_point: float | None) -> tuple[float, float]:
    """Gain and zero point: as given, or those of a scenario's camera."""
    if scenario is None:
        if zero_point is None:
            raise InputError(
                "--zero-point: give it, or the camera's scenario by --scenario; stars on the display need it"
            )
        return gain or 1.0, zero_point
    from simulator.checks import load_scenario
    from simulator.renderer import Renderer

    renderer = Renderer(load_scenario(scenario, None))
    own = float(renderer.frame()[0].gain_e_per_dn) if gain is None else gain
    standard = float(renderer.focal_plane.photometer.electrons_per_s(0.0, 0.0, 0.0))
    return own, 2.5 * math.log10(standard / own) if zero_point is None else zero_point


def _photograph(path: Path, camera: Camera, flat: Path | None) -> Photograph:
    import numpy as np

    from simulator.live.stimulator import Photograph
    from startracker.images.reading import read_image

    loaded = read_image(path, upright=False)
    photograph = Photograph(str(path), loaded.image, camera, loaded.saturation_dn)
    if flat is None:
        return photograph
    photograph.refuse_saturated()
    divisor = Photograph(str(flat), read_image(flat, upright=False).image, camera).image
    middle = float(np.nanmedian(divisor))
    if not (middle > 0 and float(np.nanmin(divisor)) > 0.05 * middle):
        raise InputError(f"{flat}: a flat field must be positive in every pixel; subtract the dark level, mask nothing")
    return Photograph(str(path), loaded.image / (divisor / np.float32(middle)), camera)


stimulate_app = typer.Typer(
    cls=SuggestingGroup,
    help="A display behind a collimator that shows the sky to a real star tracker: calibrate it, and look at it.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
_COMMANDS: dict[str, tuple[Callable[..., int], str]] = {
    "pattern": (pattern_command, "boresight stimulate pattern patterns/ --size 1280x1024"),
    "calibrate": (
        calibrate_command,
        (
            "boresight stimulate calibrate photos/ --camera camera.yaml --focal-mm 60 --pitch-um 12 --exposure-s 0.02 "
            "--scenario cubesat"
        ),
    ),
    "align": (align_command, "boresight stimulate align stimulator.yaml dots.fits --camera tracker.yaml"),
    "preview": (preview_command, "boresight stimulate preview cubesat --stimulator stimulator.yaml --out sky.png"),
}
"""Function and example of each command."""
for _name, (_function, _example) in _COMMANDS.items():
    stimulate_app.command(_name, epilog=f"Example: {_example}")(_function)
