"""The areas of the code, and the tests that shall notice a fault in each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Area:
    """Files of one topic and their tests, both as patterns relative to the root of the checkout."""

    sources: tuple[str, ...]
    tests: tuple[str, ...]

    def files(self, root: Path) -> list[Path]:
        """Its Python files, relative to `root`."""
        found = {path.relative_to(root) for pattern in self.sources for path in root.glob(pattern)}
        return sorted(path for path in found if path.name != "__init__.py")

    def test_files(self, root: Path) -> list[str]:
        """Its files of tests, relative to `root`."""
        found = {str(path.relative_to(root)) for pattern in self.tests for path in root.glob(f"tests/{pattern}.py")}
        return sorted(found)


AREAS = {
    "mission": Area(
        ("simulator/mission/*.py",),
        (
            "*/test_orbit*",
            "*/test_pointing*",
            "*/test_spin*",
            "*/test_instants",
            "*/test_motion*",
            "*/test_mrp*",
            "*/test_ephemeris_files",
            "*/test_attitude_files",
            "*/test_clock*",
            "*/test_tether",
            "*/test_thermo*",
            "*/test_jitter*",
            "*/test_walker",
            "*/test_tracking_gyro",
            "*/test_gyro*",
            "*/test_ccsds*",
            "*/test_spice*",
            "*/test_element_files",
            "*/test_orbits*",
        ),
    ),
    "sky": Area(
        ("simulator/sky/*.py",),
        (
            "*/test_sky*",
            "*/test_bodies*",
            "*/test_earth*",
            "*/test_background*",
            "*/test_faint*",
            "*/test_star*",
            "*/test_satellites",
            "*/test_planet*",
            "*/test_catalogue_and_time*",
            "*/test_photometry*",
            "*/test_monotone*",
        ),
    ),
    "optics": Area(
        ("simulator/optics/*.py",),
        (
            "*/test_optics*",
            "*/test_psf*",
            "*/test_smear*",
            "*/test_shutter*",
            "*/test_illumination*",
            "*/test_stray*",
            "*/test_bodies_phase",
        ),
    ),
    "detector": Area(("simulator/detector/*.py",), ("unit/test_detector*", "*/test_detector*", "*/test_philox*")),
    "environment": Area(("simulator/environment/*.py",), ("*/test_environment*",)),
    "study": Area(
        ("simulator/study/*.py", "simulator/study/trials/*.py", "simulator/study/specification/*.py"),
        (
            "unit/test_study*",
            "oracle/test_study*",
            "unit/test_specification",
            "unit/test_report*",
            "unit/test_compare",
            "unit/test_run_times",
            "unit/test_truth*",
            "unit/test_sequence_statistics",
            "unit/test_folder_locks",
            "unit/test_study_card",
            "unit/test_bound_kernels",
            "unit/test_outcome",
        ),
    ),
    "datasheet": Area(("simulator/study/datasheet/*.py",), ("*/test_datasheet*",)),
    "camera": Area(
        ("startracker/geometry/*.py", "startracker/wcs.py", "startracker/observer.py", "startracker/ephemeris.py"),
        (
            "*/test_camera*",
            "*/test_attitude",
            "*/test_distortion*",
            "*/test_fisheye*",
            "*/test_wcs*",
            "*/test_observer*",
            "*/test_apparent*",
            "*/test_kernels",
        ),
    ),
    "catalog": Area(
        ("startracker/catalog/*.py",), ("*/test_catalog*", "*/test_guide*", "*/test_star_names", "*/test_deep_sky*")
    ),
    "detection": Area(
        ("startracker/detection/*.py",), ("unit/test_detection*", "property/test_detection*", "oracle/test_detection*")
    ),
    "trails": Area(
        ("startracker/trails/*.py", "startracker/detection/trailed.py"), ("*/test_detection_streaks", "*/test_trail*")
    ),
    "centroid": Area(("startracker/centroid/*.py",), ("unit/test_centroid*", "oracle/test_centroid*")),
    "identification": Area(
        ("startracker/identification/*.py",),
        (
            "unit/test_adaptive",
            "unit/test_pyramid",
            "unit/test_match_groups",
            "unit/test_pattern*",
            "unit/test_triads*",
            "unit/test_kvector",
            "unit/test_pole*",
            "unit/test_bayes*",
            "unit/test_best_evidence",
            "unit/test_clustering*",
            "unit/test_other_stars",
            "unit/test_search_limits",
            "unit/test_bound*",
            "property/test_identification*",
            "unit/test_identification*",
            "unit/test_free_scale",
            "unit/test_tracker_answers",
        ),
    ),
    "attitude": Area(
        (
            "startracker/refine*.py",
            "startracker/seen_stars.py",
            "startracker/whole_field.py",
            "startracker/estimation/*.py",
        ),
        ("*/test_estimation*", "*/test_pose*", "*/test_plate*", "unit/test_tracker_answers", "unit/test_solution*"),
    ),
    "tracking": Area(("startracker/tracking/*.py",), ("*/test_tracking*", "unit/test_sensor_operation")),
    "fusion": Area(("startracker/fusion/*.py",), ("*/test_fusion*",)),
    "calibration": Area(
        ("startracker/calibration/*.py", "startracker/lens*.py"),
        ("unit/test_calibration", "unit/test_in_flight*", "oracle/test_in_flight*", "oracle/test_calibration*"),
    ),
}
