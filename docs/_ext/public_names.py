"""The public Python names, in the order of the API's pages: module, name and the group they stand in."""

from __future__ import annotations

from importlib.util import find_spec

GROUPS = {
    "Simulation": [
        "simulator.Scenario",
        "simulator.render",
        "simulator.Renderer",
        "simulator.Frame",
        "simulator.FrameTruth",
        "simulator.run",
        "simulator.Study",
        "simulator.study.sequence.run.run_sequence",
    ],
    "Solving": [
        "startracker.StarTracker",
        "startracker.Solution",
        "startracker.Status",
        "startracker.MatchedStars",
        "startracker.Step",
        "startracker.solve_unknown_fov",
        "startracker.read_image",
        "startracker.LoadedImage",
        "startracker.sample_photo",
        "startracker.wcs_header",
    ],
    "Camera, attitude, sky": [
        "startracker.Camera",
        "startracker.Distortion",
        "startracker.Attitude",
        "startracker.Observer",
        "startracker.StarCatalog",
        "startracker.load_catalog",
    ],
    "Tracking": [
        "startracker.TrackingSession",
        "startracker.CalibratedSession",
        "startracker.TrackingState",
        "startracker.Mekf",
        "startracker.RateNoise",
        "startracker.GyroNoise",
        "startracker.fusion.FusionFilter",
        "startracker.fusion.Head",
        "startracker.fusion.AlignedMekf",
        "startracker.fusion.Update",
        "startracker.fusion.FusionStatus",
        "startracker.fusion.HeadStatus",
    ],
    "Calibration": [
        "startracker.calibrate",
        "startracker.Calibration",
        "startracker.StarField",
        "startracker.InFlightCalibration",
        "startracker.calibration.IdentifiedStars",
        "startracker.calibration.LensFilter",
        "startracker.calibration.LensUpdate",
        "startracker.calibration.WidthFilter",
        "startracker.detection.defect_map.DefectMap",
        "startracker.detection.find_bad_pixels",
        "startracker.detection.mask_pixels",
        "startracker.centroid.effective_psf.build_effective_psf",
    ],
    "Settings": [
        "startracker.DetectionSettings",
        "startracker.CentroidSettings",
        "startracker.IdentificationSettings",
        "startracker.AdaptiveSettings",
        "startracker.MatchGroupSettings",
        "startracker.PatternHashSettings",
        "startracker.PyramidSettings",
        "startracker.TriadSettings",
        "startracker.TrackingSettings",
        "startracker.InFlightSettings",
    ],
    "Stimulator": [
        "simulator.live.stimulator.Stimulator",
        "simulator.live.stimulator.DisplayPicture",
        "simulator.live.stimulator.point_sources",
        "simulator.live.stimulator.DisplayGeometry",
        "simulator.live.stimulator.nominal_geometry",
        "simulator.live.stimulator.Photometry",
        "simulator.live.stimulator.Curve",
        "simulator.live.stimulator.Pattern",
        "simulator.live.stimulator.Photograph",
        "simulator.live.stimulator.Exposures",
        "simulator.live.stimulator.calibrate_display",
        "simulator.live.stimulator.DisplayCalibration",
        "simulator.live.stimulator.align_display",
        "simulator.live.stimulator.read_stimulator",
        "simulator.live.stimulator.stimulator_yaml",
    ],
    "For plug-ins": [
        "startracker.detection.Spots",
        "startracker.detection.Background",
    ],
    "Errors": [
        "startracker.BoresightError",
        "startracker.InputError",
    ],
}
"""Title of a group to dotted names. A public name that is missing here fails a test."""

OPTIONAL = {"simulator.live.basilisk.CameraStarTracker": "Basilisk"}
"""Names under "Simulation" whose module needs a package of an extra; without it they have no page."""
GROUPS["Simulation"] += [name for name, package in OPTIONAL.items() if find_spec(package)]

NOT_DOCUMENTED = {"startracker.__version__": "a string, the version"}
"""Public names without a page, and why."""


def documented() -> list[str]:
    """Every dotted name that has a page."""
    return [name for names in GROUPS.values() for name in names]
