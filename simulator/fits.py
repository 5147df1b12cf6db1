"""Frames as FITS files: image and camera parameters in the primary unit, truth in a table extension."""

from __future__ import annotations

import io
import math
import re
from pathlib import Path
from typing import Any, Literal

import erfa
import numpy as np
from numpy.typing import NDArray

from simulator.frame import Frame, FrameTruth
from simulator.paths import write_atomically
from startracker._version import __version__
from startracker.catalog.guide import field_of
from startracker.errors import InputError
from startracker.files import IMAGE_BYTES, read_bytes
from startracker.geometry.attitude import Attitude, direction_to_radec
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion
from startracker.images.reading import row_order_of
from startracker.observer import Observer, aberrate
from startracker.wcs import wcs_header

_DISTORTION_KEYS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


WcsForm = Literal["astrometric", "apparent"]

_WCS_COMMENTS = {
    "astrometric": ("catalogue positions: aberration removed", "astrometric: without aberration and refraction"),
    "apparent": ("directions as observed: with aberration", "axes; directions as observed, with aberration"),
}
"""Comments of WCSNAME and RADESYS by form."""


def write_fits(
    path: str | Path,
    frame: Frame,
    truth: FrameTruth | None = None,
    *,
    noiseless_plane: bool = False,
    wcs: WcsForm = "astrometric",
) -> None:
    """Write a frame, atomically.

    The first row is the top of the image, the camera's −y (ROWORDER), and the world coordinates are those of the pixels
    as they are stored. The header of the primary image (BUNIT adu) has the UTC of the exposure's beginning, middle and
    end (DATE-BEG, DATE-AVG and DATE-OBS, DATE-END; MJD-…), EXPTIME, the camera (CAM_FX … and the scenario's optics and
    detector keys under HIERARCH; for programs that estimate the field of view, FOCALLEN, APTDIA, XPIXSZ and YPIXSZ of
    SBFITSEXT), the observer, the prior attitude and, if the truth is given, a TAN(-SIP) world coordinate system at
    mid-exposure (`startracker.wcs`), whose form is in WCSNAME: with `wcs` ``astrometric``, catalogue positions (ICRS,
    without aberration); with ``apparent``, directions as the observer sees them, with aberration (ICRS axes).

    The extension TRUTH is a table of the sources, with attitude and rate in its header. `x` and `y` are the positions
    for the true attitude at mid-exposure (of the middle row of a rolling shutter); `x_image` and `y_image` are the
    midpoint of the rendered path during the exposure of the source's own row; `direction` is apparent, `ra` and `dec`
    are astrometric, in both forms. With `noiseless_plane` the extension MEAN_E has the mean photo-electrons.
    """
    write_atomically(Path(path), fits_bytes(frame, truth, noiseless_plane=noiseless_plane, wcs=wcs))


def fits_bytes(
    frame: Frame,
    truth: FrameTruth | None = None,
    *,
    noiseless_plane: bool = False,
    wcs: WcsForm = "astrometric",
) -> bytes:
    """Content of the file of `write_fits`."""
    from astropy.io import fits

    primary = fits.PrimaryHDU(np.asarray(frame.image))
    header = primary.header
    for key, value, comment in _cards(frame):
        header[key] = (value, comment)
    for name, value in frame.parameters.items():
        header[f"HIERARCH {name}"] = value
    units: list[Any] = [primary]
    if truth is not None:
        # If the scenario omits aberration, the rendered directions are astrometric already.
        velocity = frame.observer.velocity_km_s if frame.parameters.get("sky.aberration", True) else None
        header.update(wcs_header(frame.camera, truth.attitude, velocity, wcs))
        if velocity is not None:
            header.comments["WCSNAME"] = _WCS_COMMENTS[wcs][0]
        header.comments["RADESYS"] = _WCS_COMMENTS[wcs][1]
        units.append(_truth_table(truth, velocity))
        if noiseless_plane and truth.mean_electrons is not None:
            units.append(fits.ImageHDU(truth.mean_electrons.astype(np.float32), name="MEAN_E"))
            units[-1].header["BUNIT"] = ("electron", "mean photo-electrons in the exposure")
    buffer = io.BytesIO()
    fits.HDUList(units).writeto(buffer, checksum=True)
    return buffer.getvalue()


def _cards(frame: Frame) -> list[tuple[str, Any, str]]:
    camera, observer = frame.camera, frame.observer
    cards: list[tuple[str, Any, str]] = [
        ("BUNIT", "adu", "digital numbers"),
        ("ROWORDER", "TOP-DOWN", "the first row is the top of the image"),
        ("TIMESYS", "UTC", ""),
        *_dates(frame.utc, frame.exposure_s),
        ("EXPTIME", frame.exposure_s, "[s] exposure"),
        ("ORIGIN", f"boresight {__version__}", ""),
        ("SCENARIO", frame.scenario, "name of the scenario"),
        ("SEED", frame.seed, "seed of the scenario"),
        ("TRIAL", frame.index, "index of the trial"),
        ("GAIN", frame.gain_e_per_dn, "[e-/DN]"),
        ("RDNOISE", frame.read_noise_e, "[e-] read noise, standard deviation"),
        ("PEDESTAL", frame.offset_dn, "[DN] offset"),
        ("SATURATE", frame.saturation_dn, "[DN] saturation"),
        ("CAM_FX", camera.fx, "[px] focal length along columns"),
        ("CAM_FY", camera.fy, "[px] focal length along rows"),
        ("CAM_CX", camera.cx, "[px] principal point, first pixel = 0"),
        ("CAM_CY", camera.cy, "[px] principal point, first pixel = 0"),
        ("CAM_PROJ", camera.projection, "pinhole, fisheye, equidistant or equisolid"),
        ("CAM_PAR", camera.parity, "1 as the sky is seen, -1 mirrored"),
        ("CAM_ROW", camera.row_time_s, "[s] from row to row of a rolling shutter"),
        ("JEPOCH", observer.epoch_jyear, "Julian epoch of mid-exposure, TT"),
    ]
    cards += [(f"CAM_{k.upper()}", getattr(camera.distortion, k), "Brown-Conrady, OpenCV") for k in _DISTORTION_KEYS]
    # The camera has focal lengths in pixels. The pitch, with which they follow in millimetres, is known for a rendered
    # frame, but not for one that was read from a file.
    if "detector.pixel_pitch_um" in frame.parameters:
        width_um = float(str(frame.parameters["detector.pixel_pitch_um"]).split()[0])
        cards += [
            ("FOCALLEN", camera.fx * width_um / 1000.0, "[mm] focal length"),
            ("APTDIA", float(frame.parameters["optics.aperture_mm"]), "[mm] diameter of the aperture"),
            ("XPIXSZ", width_um, "[um] pixel width"),
            ("YPIXSZ", camera.fx * width_um / camera.fy, "[um] pixel height"),
        ]
    if observer.velocity_km_s is not None:
        cards += [
            (f"OBS_V{a}", float(v), "[km/s] barycentric") for a, v in zip("XYZ", observer.velocity_km_s, strict=True)
        ]
    if observer.position_au is not None:
        cards += [(f"OBS_P{a}", float(v), "[au] barycentric") for a, v in zip("XYZ", observer.position_au, strict=True)]
    if frame.prior is not None:
        cards += [
            (f"PRI_Q{a}", float(v), "prior attitude, ICRS to camera")
            for a, v in zip("XYZW", frame.prior.quat, strict=True)
        ]
        cards.append(("PRI_DEG", frame.prior_deg, "[deg] half width of its error"))
    return cards


def _dates(utc: str, exposure_s: float) -> list[tuple[str, Any, str]]:
    """Beginning, middle and end of an exposure from its middle, as ISO 8601 and modified Julian dates, UTC."""
    date, _, clock = utc.partition("T")
    year, month, day = (int(part) for part in date.split("-"))
    hour, minute, second = clock.split(":")
    # The ufuncs are called directly because ERFA's wrappers warn of dates after the table of leap seconds. The offsets
    # are added in TAI, so that an exposure across a leap second has the right length.
    utc1, utc2, _ = erfa.ufunc.dtf2d("UTC", year, month, day, int(hour), int(minute), float(second))
    tai1, tai2, _ = erfa.ufunc.utctai(utc1, utc2)
    cards: list[tuple[str, Any, str]] = []
    for name, offset_s, text in (
        ("BEG", -0.5 * exposure_s, "beginning of the exposure"),
        ("OBS", 0.0, "middle of the exposure"),
        ("AVG", 0.0, "middle of the exposure"),
        ("END", 0.5 * exposure_s, "end of the exposure"),
    ):
        at1, at2, _ = erfa.ufunc.taiutc(tai1, tai2 + offset_s / 86_400.0)
        y, m, d, fields, _ = erfa.ufunc.d2dtf("UTC", 6, at1, at2)
        h, minutes, s, fraction = (int(fields[part]) for part in ("h", "m", "s", "f"))
        label = f"{y:04d}-{m:02d}-{d:02d}T{h:02d}:{minutes:02d}:{s:02d}.{fraction:06d}"
        cards.append((f"DATE-{name}", utc if offset_s == 0.0 else label, f"UTC of the {text}"))
        cards.append((f"MJD-{name}", float((at1 - 2_400_000.5) + at2), "[d] the same, modified Julian date"))
    return cards


def _truth_table(truth: FrameTruth, velocity_km_s: NDArray[np.float64] | None) -> Any:
    from astropy.io import fits
    from astropy.table import Table

    s = truth.sources
    # Aberration is a Lorentz transformation, whose exact inverse is that with the opposite velocity.
    astrometric = s.direction if velocity_km_s is None else aberrate(s.direction, -velocity_km_s)
    ra, dec = direction_to_radec(astrometric)
    table = Table(
        {
            "id": s.id,
            "name": s.name.astype("U24"),
            "kind": s.kind.astype(np.promote_types("U8", s.kind.dtype)),
            "x": s.xy[:, 0],
            "y": s.xy[:, 1],
            "x_image": s.image_xy[:, 0],
            "y_image": s.image_xy[:, 1],
            "direction": s.direction,
            "ra": np.degrees(ra),
            "dec": np.degrees(dec),
            "v_mag": s.v_mag,
            "b_v": s.b_v,
            "electrons": s.electrons,
            "variable": s.variable,
        },
        units={"v_mag": "mag", "b_v": "mag", "electrons": "ct", "ra": "deg", "dec": "deg"}
        | dict.fromkeys(("x", "y", "x_image", "y_image"), "pix"),
    )
    unit = fits.table_to_hdu(table)
    unit.name = "TRUTH"
    # the FITS standard has no unit for electrons, and readers warn of unknown units
    unit.header.comments[f"TUNIT{table.colnames.index('electrons') + 1}"] = "photo-electrons in the exposure"
    for axis, value in zip("XYZW", truth.attitude.quat, strict=True):
        unit.header[f"ATT_Q{axis}"] = (float(value), "true attitude, ICRS to camera")
    unit.header["ATT_RA"] = (truth.attitude.ra_deg, "[deg] boresight")
    unit.header["ATT_DEC"] = (truth.attitude.dec_deg, "[deg] boresight")
    unit.header["ATT_ROLL"] = (truth.attitude.roll_deg, "[deg] of the up axis, east of north")
    for axis, value in zip("XYZW", truth.mounting.quat, strict=True):
        unit.header[f"MNT_Q{axis}"] = (float(value), "mounting, body to camera")
    for axis, value in zip("XYZ", truth.rate_camera_rad_s, strict=True):
        unit.header[f"RATE_{axis}"] = (float(value), "[rad/s] inertial rate, camera axes")
    unit.header["T_S"] = (truth.t_s, "[s] after the scenario's epoch")
    if truth.time_tag_error_s:
        unit.header["TAG_ERR"] = (truth.time_tag_error_s, "[s] stated minus true time of mid-exposure")
    return unit


def read_fits(path: str | Path) -> Frame:
    """Read a frame written by `write_fits`, without its truth.

    Raises
    ------
    InputError
        If the file cannot be read, is not a FITS file of boresight, is damaged (its checksum does not match), or has
        missing or impossible values.
    """
    header, image = _primary(Path(path))
    if "CAM_FX" not in header:
        raise InputError(f"{path}: is not a frame of boresight render (no CAM_FX in its header)")
    if not isinstance(image, np.ndarray) or image.ndim != 2 or image.size == 0 or image.dtype.kind not in "uif":
        shape = "none" if image is None else f"an array of shape {np.shape(image)}"
        raise InputError(f"{path}: its image is {shape}, not rows and columns of pixels; use an intact copy")
    cards = _Cards(path, header)
    velocity, position = (cards.vector(key, "XYZ") if f"{key}X" in header else None for key in ("OBS_V", "OBS_P"))
    prior = cards.vector("PRI_Q", "XYZW") if "PRI_QX" in header else None
    height, width = image.shape
    top_down = row_order_of(header) == "TOP-DOWN"
    try:
        camera = Camera(
            cards.number("CAM_FX"),
            cards.number("CAM_FY"),
            cards.number("CAM_CX"),
            cards.number("CAM_CY"),
            width,
            height,
            Distortion(**{k: cards.number(f"CAM_{k.upper()}") for k in _DISTORTION_KEYS}),
            int(cards.number("CAM_PAR")),
            cards.text("CAM_PROJ"),
            cards.number("CAM_ROW", 0.0) if "CAM_ROW" in header else 0.0,
        )
        field_of(camera)  # rejects a distortion that cannot be inverted
        return Frame(
            # FITS stores big-endian numbers; the kernels need those of the machine.
            image=np.asarray(image).astype(image.dtype.newbyteorder("="))[:: 1 if top_down else -1],
            camera=camera,
            observer=Observer(cards.number("JEPOCH", *_EPOCHS), velocity, position),
            utc=cards.text("DATE-OBS"),
            exposure_s=cards.number("EXPTIME", 0.0),
            saturation_dn=cards.number("SATURATE"),
            gain_e_per_dn=cards.number("GAIN", 1e-12),
            offset_dn=cards.number("PEDESTAL"),
            read_noise_e=cards.number("RDNOISE", 0.0),
            prior=Attitude(prior) if prior is not None else None,
            prior_deg=cards.number("PRI_DEG", 1e-9, 180.0) if prior is not None else 0.0,
            scenario=cards.text("SCENARIO"),
            seed=int(cards.number("SEED")),
            index=int(cards.number("TRIAL")),
        )
    except InputError as error:
        text = str(error)
        # The errors of `_Cards` name the file already, those of `Camera` and `Attitude` do not.
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from error


_CHECKSUM_FAILED = re.compile(r"verification failed for HDU \(.*, 1\)")
"""Warning of astropy for the first unit."""

_EPOCHS = (1000.0, 3000.0)
"""Valid Julian years of an observer's epoch."""


def _primary(path: Path) -> tuple[dict[str, Any], Any]:
    """Cards and image of the first unit of a FITS file; a checksum is verified if there is one.

    The file is parsed in memory, so that astropy does not leave a damaged file open.
    """
    import warnings

    from astropy.io import fits

    data = read_bytes(path, IMAGE_BYTES, "give a FITS file")
    try:
        # astropy reports a wrong checksum as a warning, which is recorded here and becomes an error below.
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            with fits.open(io.BytesIO(data), memmap=False, checksum=True) as units:
                header = {key: value for key, value in units[0].header.items() if key not in ("COMMENT", "HISTORY", "")}
                image = units[0].data
    except Exception as error:  # astropy may raise anything while parsing
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: is damaged, truncated, or not a FITS file ({text}); use an intact copy") from error
    if failed := [str(w.message) for w in caught if _CHECKSUM_FAILED.search(str(w.message))]:
        what = "image" if any("Datasum" in text for text in failed) else "header"
        raise InputError(
            f"{path}: its {what} does not match its checksum, so it was damaged or edited; use an intact copy, or "
            "remove the cards CHECKSUM and DATASUM to read it as it is"
        )
    return header, image


class _Cards:
    """Values of a header by keyword; `InputError` with the keyword if one is missing or impossible."""

    def __init__(self, path: str | Path, header: dict[str, Any]) -> None:
        self.path, self.header = path, header

    def _value(self, key: str) -> Any:
        if key not in self.header:
            raise InputError(f"{self.path}: {key} is missing from its header; use an intact copy")
        return self.header[key]

    def number(self, key: str, least: float = -math.inf, most: float = math.inf) -> float:
        """A finite number from `least` to `most`."""
        value = self._value(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"{self.path}: {key} in its header must be a number, not {value!r}")
        if not least <= value <= most:
            raise InputError(f"{self.path}: {key} in its header cannot be {value:g}")
        return float(value)

    def text(self, key: str) -> str:
        """A text."""
        value = self._value(key)
        if not isinstance(value, str):
            raise InputError(f"{self.path}: {key} in its header must be a text, not {value!r}")
        return value

    def vector(self, key: str, axes: str) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Numbers of several cards whose keywords differ in the last letter."""
        return np.array([self.number(f"{key}{axis}") for axis in axes])
