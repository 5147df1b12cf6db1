"""Every argument of every public callable, given values of wrong types: accepted, or one line of `InputError`.

Each callable is called with arguments that are right but for one. The message of a refusal is one line.
"""

import functools

import numpy as np
import pytest
from public_names import documented
from wrong_types import faults_of

import simulator
import startracker
from simulator.study.sequence.run import run_sequence
from startracker import Attitude, Camera, GyroNoise, Mekf, Observer, StarTracker, TrackingSession
from startracker.calibration import IdentifiedStars, LensFilter, WidthFilter
from startracker.centroid.effective_psf import build_effective_psf
from startracker.detection import find_bad_pixels, mask_pixels
from startracker.detection.defect_map import DefectMap

ATTITUDE = Attitude.from_radec_roll(85.0, -2.0, 123.0)
CAMERA = Camera.from_fov(15.0, 256, 256)
IMAGE = np.zeros((256, 256))
QUAT = [0.1, 0.2, 0.3, 0.9]


@functools.cache
def tracker():
    return StarTracker(CAMERA, magnitude_limit=5.0)


@functools.cache
def field():
    index, _, xy = tracker().guide.in_field(ATTITUDE.as_matrix())
    return xy, 10.0 ** (-0.4 * tracker().guide.v_mag[index])


@functools.cache
def solution():
    return tracker().solve_centroids(*field())


@functools.cache
def scenario():
    return simulator.Scenario.load("cubesat_ideal", ["detector.width=64", "detector.height=64", "study.trials=1"])


@functools.cache
def renderer():
    return simulator.Renderer(scenario())


def session():
    one = TrackingSession(tracker(), GyroNoise())
    one.reset(ATTITUDE, 0.1)
    return one


def mekf():
    return Mekf(ATTITUDE, np.eye(3) * 1e-8, GyroNoise())


def star_field():
    xy, flux = field()
    return startracker.StarField("one", xy, 256, 256, flux)


def calibrated():
    return startracker.CalibratedSession(tracker(), startracker.InFlightCalibration(CAMERA))


def lens():
    return LensFilter(CAMERA, startracker.InFlightSettings())


def stars():
    return IdentifiedStars.of(solution(), tracker())


COLUMNS = ("name", "epoch_jyear", *startracker.StarCatalog.columns(), "position_sigma_rad")
SETTINGS = [name for name in startracker.__all__ if name.endswith("Settings")]
"""Their parameters are those of the class, each with its default."""
CALLS = {
    # the function or class, or a function that makes the object whose method is called; and right arguments
    "startracker.Attitude": (Attitude, {"quat": QUAT, "source": "icrs", "target": "camera"}),
    "startracker.Attitude.from_matrix": (
        Attitude.from_matrix,
        {"matrix": np.eye(3), "source": "icrs", "target": "camera"},
    ),
    "startracker.Attitude.from_radec_roll": (
        Attitude.from_radec_roll,
        {"ra_deg": 1.0, "dec_deg": 2.0, "roll_deg": 3.0},
    ),
    "startracker.Attitude.from_rotation_vector": (
        Attitude.from_rotation_vector,
        {"vector_rad": [0.1, 0.2, 0.3], "source": "icrs", "target": "camera"},
    ),
    "startracker.Attitude.from_rotation": (
        Attitude.from_rotation,
        {"rotation": ATTITUDE.rotation, "source": "icrs", "target": "camera"},
    ),
    "startracker.Attitude.from_skycoord": (
        Attitude.from_skycoord,
        {"coordinate": ATTITUDE.skycoord, "roll_deg": 1.0},
    ),
    "startracker.Attitude.apply": (ATTITUDE.apply, {"vectors": np.eye(3)}),
    "startracker.Attitude.rotation_vector_to": (ATTITUDE.rotation_vector_to, {"other": ATTITUDE}),
    "startracker.Attitude.angle_to": (ATTITUDE.angle_to, {"other": ATTITUDE}),
    "startracker.Attitude.__matmul__": (ATTITUDE.__matmul__, {"other": ATTITUDE.inverse}),
    "startracker.Camera": (
        Camera,
        {"fx": 500.0, "fy": 500.0, "cx": 127.5, "cy": 127.5, "width": 256, "height": 256, "distortion": None,
         "parity": 1, "projection": "pinhole", "row_time_s": 0.0},
    ),
    "startracker.Camera.from_fov": (
        Camera.from_fov,
        {"fov_deg": 10.0, "width": 256, "height": 256, "distortion": None, "projection": "pinhole"},
    ),
    "startracker.Camera.from_yaml": (Camera.from_yaml, {"path": "camera.yaml"}),
    "startracker.Camera.from_dict": (Camera.from_dict, {"data": CAMERA.to_dict(), "where": "camera"}),
    "startracker.Camera.to_yaml": (CAMERA.to_yaml, {"path": "/nonexistent/camera.yaml"}),
    "startracker.Camera.contains": (CAMERA.contains, {"xy": [[1.0, 2.0]], "margin_px": 0.0}),
    "startracker.Camera.project": (CAMERA.project, {"vectors": [[0.0, 0.0, 1.0]]}),
    "startracker.Camera.unproject": (CAMERA.unproject, {"xy": [[1.0, 2.0]]}),
    "startracker.Distortion": (
        startracker.Distortion,
        dict.fromkeys(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), 0.0),
    ),
    "startracker.Observer": (
        Observer,
        {"epoch_jyear": 2026.0, "velocity_km_s": [30.0, 0.0, 0.0], "position_au": [1.0, 0.0, 0.0]},
    ),
    "startracker.Observer.on_earth": (Observer.on_earth, {"time": Observer(2026.0).time, "location": None}),
    "startracker.StarTracker": (
        StarTracker,
        {"camera": CAMERA, "catalog": "bsc5", "magnitude_limit": 4.0, "detector": "components", "centroider": "moment",
         "identifier": "adaptive", "estimator": "svd", "detection": None, "centroid": None, "identification": None,
         "focal_error": 0.0},
    ),
    "startracker.StarTracker.solve": (
        lambda **given: tracker().solve(**given),
        {"image": IMAGE, "prior": ATTITUDE, "prior_deg": 1.0, "lost_in_space": False, "observer": None, "time": None,
         "saturation_dn": 4095.0, "gain_e_per_dn": 1.0},
    ),
    "startracker.StarTracker.solve_centroids": (
        lambda **given: tracker().solve_centroids(**{"xy": field()[0], "flux": field()[1]} | given),
        {"xy": ..., "flux": ..., "sigma_px": 0.1, "prior": ATTITUDE, "prior_deg": 1.0, "observer": None, "time": None},
    ),
    "startracker.Solution.radec_of": (
        lambda **given: solution().radec_of(**given),
        {"xy": [[1.0, 2.0]], "observer": Observer(2026.0, [30.0, 0.0, 0.0])},
    ),
    "startracker.Solution.pixel_of": (
        lambda **given: solution().pixel_of(**given),
        {"ra_deg": 85.0, "dec_deg": -2.0, "observer": Observer(2026.0, [30.0, 0.0, 0.0])},
    ),
    "startracker.solve_unknown_fov": (
        lambda **given: startracker.solve_unknown_fov(**{"source": field()[0], "flux": field()[1]} | given),
        {"source": ..., "width": 256, "height": 256, "flux": ..., "fov_deg": 15.0, "fov_error": 0.02, "parity": 1,
         "camera": None, "variance_px2": None, "catalog": "hipparcos", "detector": "components",
         "centroider": "moment", "detection": None, "centroid": None, "identification": None, "observer": None,
         "saturation_dn": None, "gain_e_per_dn": None},
    ),
    "startracker.calibrate": (
        lambda **given: startracker.calibrate(**{"fields": [star_field()]} | given),
        {"fields": ..., "camera": CAMERA, "catalog": "hipparcos", "projection": "auto", "refraction": False,
         "parameters": None},
    ),
    "startracker.calibrate, field": (
        lambda **given: startracker.calibrate(**{"fields": [star_field()], "fov_deg": 15.0} | given), {"fov_deg": ...}
    ),
    "startracker.StarField": (
        startracker.StarField,
        {"name": "one", "xy": [[1.0, 2.0]], "width": 256, "height": 256, "flux": [1.0], "variance_px2": [0.1],
         "observer": None},
    ),
    "startracker.load_catalog": (startracker.load_catalog, {"name": "bsc5"}),
    "startracker.read_image": (
        startracker.read_image,
        {"path": startracker.sample_photo(), "bayer": None, "upright": True, "colours": False},
    ),
    "startracker.wcs_header": (
        startracker.wcs_header,
        {"camera": CAMERA, "attitude": ATTITUDE, "velocity_km_s": [30.0, 0.0, 0.0], "form": "astrometric"},
    ),
    "startracker.StarCatalog.at_epoch": (
        lambda **given: startracker.load_catalog("bsc5").at_epoch(**given), {"epoch_jyear": 2026.0}
    ),
    "startracker.StarCatalog.directions": (
        lambda **given: startracker.load_catalog("bsc5").directions(**given),
        {"epoch_jyear": 2026.0, "observer_au": [1.0, 0.0, 0.0]},
    ),
    "startracker.StarCatalog.brighter_than": (
        lambda **given: startracker.load_catalog("bsc5").brighter_than(**given), {"magnitude": 3.0}
    ),
    "startracker.StarCatalog.select": (
        lambda **given: startracker.load_catalog("bsc5").select(**given), {"index": np.arange(3)}
    ),
    "startracker.StarCatalog": (
        lambda **given: startracker.StarCatalog(
            **{name: getattr(startracker.load_catalog("bsc5"), name) for name in COLUMNS} | given
        ),
        dict.fromkeys(COLUMNS, ...),
    ),
    "startracker.TrackingSession": (
        lambda **given: TrackingSession(**{"tracker": tracker()} | given),
        {"tracker": ..., "noise": GyroNoise(), "settings": None, "exposure_s": 0.1},
    ),
    "startracker.TrackingSession.reset": (
        lambda **given: session().reset(**given),
        {"attitude": ATTITUDE, "sigma_deg": 1.0, "rate_rad_s": [0.0, 0.0, 0.1]}
    ),
    "startracker.TrackingSession.update": (
        lambda **given: session().update(**given),
        {"image": IMAGE, "t_s": 1.0, "gyro_rad_s": [0.0, 0.0, 0.0], "observer": None, "saturation_dn": 4095.0,
         "gain_e_per_dn": 1.0},
    ),
    "startracker.TrackingSession.update_centroids": (
        lambda **given: session().update_centroids(**{"xy": field()[0], "flux": field()[1]} | given),
        {"xy": ..., "flux": ..., "t_s": 1.0, "gyro_rad_s": [0.0, 0.0, 0.0], "observer": None},
    ),
    "startracker.CalibratedSession": (
        lambda **given: startracker.CalibratedSession(
            **{"tracker": tracker(), "calibration": startracker.InFlightCalibration(CAMERA)} | given
        ),
        {"tracker": ..., "calibration": ..., "noise": None, "settings": None, "exposure_s": 0.1},
    ),
    "startracker.CalibratedSession.update": (
        lambda **given: calibrated().update(**given),
        {"image": IMAGE, "t_s": 1.0, "gyro_rad_s": None, "observer": None, "saturation_dn": None,
         "gain_e_per_dn": None},
    ),
    "startracker.CalibratedSession.update_centroids": (
        lambda **given: calibrated().update_centroids(**{"xy": field()[0], "flux": field()[1]} | given),
        {"xy": ..., "flux": ..., "t_s": 1.0, "gyro_rad_s": None, "observer": Observer(2026.0, [0.0, 0.0, 0.0])},
    ),
    "startracker.Mekf": (
        Mekf, {"attitude": ATTITUDE, "covariance": np.eye(3) * 1e-8, "noise": None, "rate_rad_s": [0.0, 0.0, 0.0]}
    ),
    "startracker.Mekf.reset": (
        lambda **given: mekf().reset(**given),
        {"attitude": ATTITUDE, "covariance": np.eye(3) * 1e-8, "rate_rad_s": None, "second_sigma_rad_s": None},
    ),
    "startracker.Mekf.distrust": (lambda **given: mekf().distrust(**given), {"factor": 2.0}),
    "startracker.Mekf.predict": (lambda **given: mekf().predict(**given), {"dt": 1.0, "gyro_rad_s": [0.0, 0.0, 0.1]}),
    "startracker.Mekf.update_attitude": (
        lambda **given: mekf().update_attitude(**given),
        {"attitude": ATTITUDE, "covariance": np.eye(3) * 1e-8, "false_rejection": 1e-6},
    ),
    "startracker.Mekf.update_vectors": (
        lambda **given: mekf().update_vectors(**given),
        {"observed": [[0.0, 0.0, 1.0]], "reference": ATTITUDE.boresight[None], "sigma_rad": [1e-5],
         "false_rejection": 1e-6},
    ),
    "startracker.RateNoise": (startracker.RateNoise, {"acceleration": 1e-4, "rate_sigma_rad_s": 0.1}),
    "startracker.GyroNoise": (
        GyroNoise,
        {"angle_random_walk": 1e-5, "rate_random_walk": 1e-7, "bias_sigma_rad_s": 1e-3, "acceleration": 1e-3,
         "scale_sigma": 0.01},
    ),
    "startracker.InFlightCalibration": (
        startracker.InFlightCalibration,
        {"camera": CAMERA, "settings": None, "psf_width_px": 1.0, "background_tile_px": 64},
    ),
    "startracker.InFlightCalibration.masked": (startracker.InFlightCalibration(CAMERA).masked, {"image": IMAGE}),
    "startracker.InFlightCalibration.centroiding": (
        startracker.InFlightCalibration(CAMERA).centroiding, {"settings": startracker.CentroidSettings()}
    ),
    "startracker.InFlightCalibration.update": (
        lambda **given: startracker.InFlightCalibration(CAMERA).update(**{"stars": stars()} | given),
        {"t_s": 1.0, "attitude": ATTITUDE, "stars": ..., "given": None},
    ),
    "startracker.calibration.IdentifiedStars.of": (
        lambda **given: IdentifiedStars.of(**{"solution": solution(), "tracker": tracker()} | given),
        {"solution": ..., "tracker": ...},
    ),
    "startracker.calibration.LensFilter": (
        LensFilter, {"camera": CAMERA, "settings": startracker.InFlightSettings()}
    ),
    "startracker.calibration.LensFilter.predict": (lambda **given: lens().predict(**given), {"dt_s": 1.0}),
    "startracker.calibration.LensFilter.update": (
        lambda **given: lens().update(**{"stars": stars()} | given), {"matrix": ATTITUDE.as_matrix(), "stars": ...}
    ),
    "startracker.calibration.WidthFilter": (
        WidthFilter, {"sigma_px": 0.1, "drift_px_sqrt_s": 0.01, "width_px": 1.0}
    ),
    "startracker.calibration.WidthFilter.predict": (
        lambda **given: WidthFilter(0.1, 0.01).predict(**given), {"dt_s": 1.0}
    ),
    "startracker.calibration.WidthFilter.update": (
        lambda **given: WidthFilter(0.1, 0.01).update(**given), {"widths_px": np.ones(9)}
    ),
    "startracker.detection.defect_map.DefectMap": (
        DefectMap, {"camera": CAMERA, "frames": 5, "share": 0.75, "sigma": 5.0, "shift_px": 1.0, "tile_px": 64}
    ),
    "startracker.detection.defect_map.DefectMap.add": (
        lambda **given: DefectMap(CAMERA, frames=5, share=0.75, sigma=5.0, shift_px=1.0).add(**given),
        {"image": IMAGE, "attitude": ATTITUDE, "stars_xy": np.ones((1, 2)), "ignore": None},
    ),
    "startracker.detection.find_bad_pixels": (
        find_bad_pixels, {"frames": [IMAGE, IMAGE, IMAGE], "sigma": 5.0, "share": 0.6, "tile_px": 64}
    ),
    "startracker.detection.mask_pixels": (
        mask_pixels, {"image": IMAGE, "bad_pixels": IMAGE > 0}
    ),
    "startracker.centroid.effective_psf.build_effective_psf": (
        build_effective_psf, {"frames": [], "radius_px": 5.0, "gain_e_per_dn": 1.0, "most_stars": 400}
    ),
    "simulator.Scenario.load": (
        simulator.Scenario.load, {"path": "cubesat", "overrides": (), "seed": 1, "trials": 5}
    ),
    "simulator.Scenario.parse": (
        simulator.Scenario.parse, {"text": "base: cubesat", "overrides": (), "name": "text"}
    ),
    "simulator.Scenario.changed": (lambda **given: scenario().changed(**given), {"values": {"seed": 2}}),
    "simulator.Scenario.with_values": (
        lambda **given: scenario().with_values(**given), {"trials": 3, "seed": 3}
    ),
    "simulator.Scenario.to_yaml": (lambda **given: scenario().to_yaml(**given), {"comments": True}),
    "simulator.Renderer": (
        lambda **given: simulator.Renderer(**{"scenario": scenario()} | given),
        {"scenario": ..., "camera_seed": 1, "trajectory": None},
    ),
    "simulator.Renderer.changed": (lambda **given: renderer().changed(**given), {"values": {"detector.offset_dn": 9}}),
    "simulator.Renderer.frame": (
        lambda **given: renderer().frame(**given),
        {"index": 0, "at_s": 1.0, "attitude": ATTITUDE, "rate_camera_rad_s": [0.0, 0.0, 0.0], "jitter": None,
         "exposure_s": 0.1},
    ),
    "simulator.Renderer.scene": (
        lambda **given: renderer().scene(**given),
        {"index": 0, "at_s": 1.0, "attitude": ATTITUDE, "rate_camera_rad_s": [0.0, 0.0, 0.0], "jitter": None,
         "exposure_s": 0.1},
    ),
    "simulator.Renderer.expose": (
        lambda **given: renderer().expose(**{"scene": renderer().scene()} | given), {"scene": ..., "exposure_s": 0.1}
    ),
    "simulator.render": (
        lambda **given: simulator.render(**{"scenario": scenario()} | given),
        {"scenario": ..., "index": 0, "at_s": 1.0, "attitude": ATTITUDE},
    ),
    "simulator.run": (
        lambda **given: simulator.run(**{"scenario": scenario()} | given),
        {"scenario": ..., "trials": 1, "seed": 1, "workers": 1, "dask": None, "out": None, "resume": False,
         "force": False, "progress": None},
    ),
    "simulator.study.sequence.run.run_sequence": (
        lambda **given: run_sequence(**{"scenario": scenario().changed({"sequence.frames": 1})} | given),
        {"scenario": ..., "out": None, "single": False, "animate": False, "ccsds": False, "spice": False,
         "force": False, "progress": None},
    ),
}  # fmt: skip
for _name in SETTINGS:
    _class = getattr(startracker, _name)
    CALLS[f"startracker.{_name}"] = (
        _class, {name: value for name, value in vars(_class()).items() if not name.startswith("_")}
    )  # fmt: skip


SLOW = ("simulator.run", "simulator.study.sequence.run.run_sequence", "startracker.solve_unknown_fov")
"""These do seconds of work with each value that they accept."""


@pytest.mark.parametrize(
    "label", [pytest.param(label, marks=[pytest.mark.system] * (label in SLOW)) for label in CALLS]
)
def test_every_argument_of_a_wrong_type(label, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where "x" is not a file
    call, right = CALLS[label]
    if label.startswith("startracker.Camera") and "distortion" in right:
        right = right | {"distortion": startracker.Distortion()}

    def without(name):
        return (*EXCEPT.get((label, name), ()), *(ACCEPTED_SLOWLY if label in SLOW else ()))

    faults = faults_of(call, right, without, many_lines=label in MANY_LINES)
    assert not faults, "\n" + "\n".join(faults)


RESULTS = {
    *("simulator.Frame", "simulator.FrameTruth", "simulator.Study", "startracker.Solution", "startracker.MatchedStars"),
    *("startracker.Status", "startracker.Step", "startracker.LoadedImage", "startracker.TrackingState"),
    *("startracker.Calibration", "startracker.calibration.LensUpdate", "startracker.calibration.IdentifiedStars"),
    *("startracker.detection.Spots", "startracker.detection.Background", "startracker.fusion.Update"),
    *("simulator.live.stimulator.DisplayPicture", "simulator.live.stimulator.DisplayCalibration"),
}
"""Classes of results, which callers are given and do not make."""
NOTHING_GIVEN = {"startracker.BoresightError", "startracker.InputError", "startracker.sample_photo"}
"""Errors, and what has no arguments."""
ELSEWHERE = (
    "startracker.fusion.",  # tests/unit/test_fusion_filter.py
    "simulator.live.stimulator.",  # tests/unit/test_wrong_types_bench.py
    "simulator.live.basilisk.",  # only with the package Basilisk
)
"""Beginnings of names whose arguments other tests check."""


def test_no_public_callable_is_left_out():
    names = set(documented()) - RESULTS - NOTHING_GIVEN
    called = {label.partition(",")[0] for label in CALLS} | {"simulator.Scenario"}
    assert {name for name in names if not name.startswith(ELSEWHERE)} <= called


def test_what_was_ignored_is_refused():
    body = Attitude(QUAT, "body", "camera")
    xy, flux = field()
    for call in (
        lambda: tracker().solve_centroids(xy, flux, prior=body),
        lambda: tracker().solve_centroids(xy, flux, prior=ATTITUDE.inverse),
        lambda: TrackingSession(tracker()).reset(body),
        lambda: renderer().frame(attitude=body),
        lambda: simulator.render(scenario(), attitude=body),
        lambda: mekf().update_attitude(body, np.eye(3)),
        lambda: Mekf(body, np.eye(3)),
        lambda: startracker.wcs_header(CAMERA, body),
        lambda: StarTracker(CAMERA, magnitude_limit=5.0, detection={"a": 1}),
        lambda: StarTracker(CAMERA, magnitude_limit=5.0, detection=startracker.CentroidSettings()),
        lambda: StarTracker(CAMERA, magnitude_limit=5.0, centroid="moment"),
        lambda: TrackingSession(tracker(), noise="x"),
        lambda: TrackingSession(tracker(), settings={}),
        lambda: tracker().solve_centroids(xy + 1j, flux),
        lambda: tracker().solve_centroids(xy, flux + 0j),
        lambda: Observer(2026.0, np.array([1j, 0.0, 0.0])),
        lambda: CAMERA.project(np.array([[0.0, 0.0, 1.0 + 1e-3j]])),
        lambda: Attitude(np.array(QUAT) * (1.0 + 0j)),
        lambda: startracker.DetectionSettings(matched_filter="no"),
        lambda: startracker.DetectionSettings(threshold_sigma=None),
        lambda: startracker.calibrate([star_field()], refraction="no"),
    ):
        with pytest.raises(startracker.InputError):
            call()


def test_a_file_name_stands_for_a_camera_or_a_scenario(tmp_path):
    path = tmp_path / "camera.yaml"
    CAMERA.to_yaml(path)
    for name in (path, str(path)):
        assert StarTracker(name, magnitude_limit=4.0).camera == CAMERA
    with pytest.raises(startracker.InputError, match="cannot be read"):
        StarTracker("cam")
    file = tmp_path / "mine.yaml"
    file.write_text("base: cubesat_ideal\ndetector:\n  width: 64\n  height: 64\nstudy:\n  trials: 1\n")
    for name in (file, str(file)):
        assert simulator.Renderer(name).scenario == scenario()
        np.testing.assert_array_equal(simulator.render(name)[0].image, simulator.render(scenario())[0].image)
    assert simulator.run(file).summary["trials"] == 1
    with pytest.raises(startracker.InputError, match="no such file"):
        simulator.render("nosuch")


EXCEPT = {
    ("simulator.run", "workers"): ("number",),  # starts as many processes
    ("simulator.run", "progress"): ("type",),  # int(1, 1) fails on its own
    ("simulator.study.sequence.run.run_sequence", "progress"): ("type",),
}
ACCEPTED_SLOWLY = ("None", "number", "fraction", "truth")
"""Kinds that most arguments of these accept."""
MANY_LINES = {name for name in CALLS if name.startswith("simulator.")}
"""A scenario with several faults has a line for each."""
