"""Frames as FITS files: image and every camera parameter first, truth in a table extension of its own."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from simulator.frame import Frame, FrameTruth
from simulator.paths import write_atomically
from startracker._version import __version__
from startracker.attitude import Attitude, matrix_to_quat
from startracker.camera import Camera
from startracker.distortion import Distortion
from startracker.errors import InputError
from startracker.observer import Observer, aberrate
from startracker.wcs import wcs_header

_DISTORTION_KEYS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def catalog_attitude(attitude: Attitude, observer: Observer) -> Attitude:
    """Attitude under which *catalogue* positions, free of aberration, fall on their pixels.

    A world coordinate system relates pixels to catalogue positions. Aberration moves the whole field by up to 26″;
    its value at the boresight is folded into the rotation (the rest within a field of 10° is below 2.3″).
    """
    if observer.velocity_km_s is None:
        return attitude
    seen = attitude.boresight
    catalogued = seen
    for _ in range(4):  # contraction by v/c = 1e-4 a step
        catalogued = catalogued + seen - aberrate(catalogued[None, :], observer.velocity_km_s)[0]
        catalogued /= np.linalg.norm(catalogued)
    axis = np.cross(catalogued, seen)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + cross + cross @ cross / (1.0 + float(catalogued @ seen))  # turns catalogued into seen
    return Attitude(matrix_to_quat(attitude.as_matrix() @ turn))


def write_fits(
    path: str | Path, frame: Frame, truth: FrameTruth | None = None, *, noiseless_plane: bool = False
) -> None:
    """Write a frame, beside its place first and then moved there.

    The primary image carries DATE-OBS, EXPTIME, the camera (CAM_FX … and the scenario's optics and detector keys under
    HIERARCH), the observer, the prior attitude, and, where the truth is given, a TAN(-SIP) world coordinate system.
    The truth itself is the extension TRUTH: a table of the sources, with attitude and rate in its header; with
    `noiseless_plane` the light before the detector follows as MEAN_E, in electrons.
    """
    from astropy.io import fits

    primary = fits.PrimaryHDU(np.asarray(frame.image))
    header = primary.header
    for key, value, comment in _cards(frame):
        header[key] = (value, comment)
    for name, value in frame.parameters.items():
        header[f"HIERARCH {name}"] = value
    units: list[Any] = [primary]
    if truth is not None:
        header.update(wcs_header(frame.camera, catalog_attitude(truth.attitude, frame.observer)))
        units.append(_truth_table(truth))
        if noiseless_plane and truth.mean_electrons is not None:
            units.append(fits.ImageHDU(truth.mean_electrons.astype(np.float32), name="MEAN_E"))
    buffer = io.BytesIO()
    fits.HDUList(units).writeto(buffer, checksum=True)
    write_atomically(Path(path), buffer.getvalue())


def _cards(frame: Frame) -> list[tuple[str, Any, str]]:
    camera, observer = frame.camera, frame.observer
    cards: list[tuple[str, Any, str]] = [
        ("DATE-OBS", frame.utc, "UTC of mid-exposure"),
        ("TIMESYS", "UTC", ""),
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


def _truth_table(truth: FrameTruth) -> Any:
    from astropy.io import fits
    from astropy.table import Table

    s = truth.sources
    table = Table(
        {
            "id": s.id,
            "name": s.name.astype("U24"),
            "kind": s.kind.astype("U8"),
            "x": s.xy[:, 0],
            "y": s.xy[:, 1],
            "direction": s.direction,
            "v_mag": s.v_mag,
            "b_v": s.b_v,
            "electrons": s.electrons,
            "variable": s.variable,
        },
        units={"x": "pix", "y": "pix", "v_mag": "mag", "b_v": "mag"},
    )
    unit = fits.table_to_hdu(table)
    unit.name = "TRUTH"
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
    return unit


def read_fits(path: str | Path) -> Frame:
    """Read a frame that `write_fits` wrote; the truth stays in the file.

    Raises
    ------
    InputError
        When the file is no FITS file or not one of ours.
    """
    from astropy.io import fits

    try:
        with fits.open(path, memmap=False) as units:
            header, image = units[0].header, units[0].data
    except OSError as error:
        raise InputError(f"{path}: cannot be read as FITS ({error})") from error
    if image is None or "CAM_FX" not in header:
        raise InputError(f"{path}: is not a frame of boresight render (no CAM_FX in its header)")
    vectors = {
        name: np.array([header[f"{key}{axis}"] for axis in axes]) if f"{key}X" in header else None
        for name, key, axes in (("velocity", "OBS_V", "XYZ"), ("position", "OBS_P", "XYZ"), ("prior", "PRI_Q", "XYZW"))
    }
    height, width = image.shape
    camera = Camera(
        header["CAM_FX"],
        header["CAM_FY"],
        header["CAM_CX"],
        header["CAM_CY"],
        width,
        height,
        Distortion(**{k: header[f"CAM_{k.upper()}"] for k in _DISTORTION_KEYS}),
        header["CAM_PAR"],
        header["CAM_PROJ"],
        header.get("CAM_ROW", 0.0),
    )
    return Frame(
        image=np.asarray(image).astype(image.dtype.newbyteorder("=")),
        camera=camera,
        observer=Observer(header["JEPOCH"], vectors["velocity"], vectors["position"]),
        utc=header["DATE-OBS"],
        exposure_s=header["EXPTIME"],
        saturation_dn=header["SATURATE"],
        gain_e_per_dn=header["GAIN"],
        offset_dn=header["PEDESTAL"],
        read_noise_e=header["RDNOISE"],
        prior=Attitude(vectors["prior"]) if vectors["prior"] is not None else None,
        prior_deg=header.get("PRI_DEG", 0.0),
        scenario=header["SCENARIO"],
        seed=header["SEED"],
        index=header["TRIAL"],
    )
