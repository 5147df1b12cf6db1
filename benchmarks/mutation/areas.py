"""The areas of the code that has physics or algorithms, and the tests that shall notice a fault in each.

Not among them: commands, servers, and the pages and plots in folders of their own, which other tests start as programs;
the theses, of which every printed value is a test; the flight build and its integers, whose C is compared with recorded
answers bit by bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Area:
    """Files of one topic and their tests, both as patterns relative to the root of the checkout.

    Statistical tests take too long to run for each fault: only those count whose folder is named.
    """

    sources: tuple[str, ...]
    tests: tuple[str, ...]

    def files(self, root: Path) -> list[Path]:
        """Its Python files, relative to `root`."""
        found = {path.relative_to(root) for pattern in self.sources for path in root.glob(pattern)}
        return sorted(path for path in found if path.name != "__init__.py")

    def test_files(self, root: Path) -> list[str]:
        """Its files of tests, relative to `root`."""
        found = {
            path.relative_to(root / "tests")
            for pattern in self.tests
            for path in root.glob(f"tests/{pattern}.py")
            if path.parent.name != "statistical" or pattern.startswith("statistical")
        }
        return [f"tests/{path}" for path in sorted(found)]


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
            "unit/test_named_files",
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
            "*/test_target",
            "*/test_instants",
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
            "*/test_bodies_at_the_limb",
            "*/test_jitter_s*",
            "statistical/test_jitter_s*",
            "*/test_error_function",
            "*/test_tether",
            "oracle/test_camera_errors",
            "unit/test_bound_kernels",
        ),
    ),
    "detector": Area(
        ("simulator/detector/*.py",),
        ("*/test_detector*", "statistical/test_detector*", "*/test_philox*", "*/test_random_streams"),
    ),
    "scene": Area(
        (
            "simulator/build.py",
            "simulator/constants.py",
            "simulator/exposure.py",
            "simulator/fits.py",
            "simulator/focal_plane.py",
            "simulator/frame.py",
            "simulator/light.py",
            "simulator/randomness.py",
            "simulator/renderer.py",
            "simulator/scene.py",
            "simulator/units.py",
        ),
        (
            "*/test_build",
            "*/test_frames_galsim",
            "*/test_fits*",
            "*/test_row_order",
            "*/test_random_streams",
            "*/test_sky_b*",
            "*/test_sky_kernels",
            "*/test_sky_photometry",
            "*/test_photometry*",
            "*/test_shutter*",
            "*/test_smear*",
            "*/test_illumination*",
            "*/test_camera_errors",
            "*/test_scenario_*",
            "unit/test_jitter_series",
            "*/test_satellites",
            "*/test_truth_of_stars",
            "*/test_target",
            "*/test_bodies_at_the_limb",
        ),
    ),
    "environment": Area(
        (
            "simulator/environment/*.py",
            "simulator/study/environment/derived.py",
            "simulator/study/environment/survey.py",
        ),
        ("*/test_environment*",),
    ),
    "study": Area(
        (
            "simulator/study/*.py",
            "simulator/study/trials/*.py",
            "simulator/study/specification/*.py",
            "simulator/study/budget/[eo]*.py",
        ),
        (
            "unit/test_study*",
            "oracle/test_study*",
            "unit/test_specification",
            "unit/test_compare",
            "unit/test_run_times",
            "unit/test_truth*",
            "unit/test_folder_locks",
            "unit/test_arrow",
            "unit/test_sweep",
            "unit/test_study_card",
            "unit/test_bound_kernels",
            "unit/test_outcome",
        ),
    ),
    "sequence": Area(
        tuple(
            f"simulator/study/sequence/{name}.py"
            for name in (
                "calibration",
                "camera",
                "columns",
                "frames",
                "head_camera",
                "heads",
                "messages",
                "operation",
                "result",
                "run",
                "statistics",
                "true_defects",
                "true_motion",
            )
        ),
        (
            "*/test_sequence*",
            "*/test_heads*",
            "*/test_tracking_frames",
            "*/test_tracking_gyro",
            "*/test_jitter_in_sequences",
            "*/test_in_flight_sequence",
            "*/test_sensor_operation",
            "unit/test_scenario_heads",
            "unit/test_element_files",
            "oracle/test_spice_kernels",
            "oracle/test_ephemeris_files",
        ),
    ),
    "planning": Area(
        ("simulator/study/coverage/[bfps]*.py", "simulator/study/design/[sv]*.py"),
        ("*/test_sky_coverage", "*/test_coverage*", "*/test_design*"),
    ),
    "datasheet": Area(("simulator/study/datasheet/*.py",), ("*/test_datasheet*",)),
    "camera": Area(
        ("startracker/geometry/*.py", "startracker/wcs.py", "startracker/observer.py", "startracker/ephemeris.py"),
        (
            "*/test_calibration_lens",
            "*/test_camera*",
            "*/test_attitude",
            "*/test_distortion*",
            "*/test_fisheye*",
            "*/test_wcs*",
            "*/test_observer*",
            "*/test_apparent*",
            "*/test_kernels",
            "*/test_interop",
            "*/test_linalg",
            "*/test_public_objects",
            "*/test_sky_view",
        ),
    ),
    "catalog": Area(
        ("startracker/catalog/*.py",),
        (
            "*/test_catalog*",
            "*/test_guide*",
            "*/test_star_names",
            "*/test_deep_sky*",
            "*/test_sky_view",
            "*/test_apparent*",
            "*/test_named_files",
        ),
    ),
    "detection": Area(
        ("startracker/detection/*.py", "startracker/front_end.py", "startracker/inputs.py"),
        (
            "*/test_detection*",
            "unit/test_points_and_trails",
            "unit/test_centroid_moments",
            "oracle/test_greyling_rec*",
            "unit/test_light",
            "unit/test_in_flight_parts",
            "unit/test_field_attitude_inputs",
            "unit/test_search_limits",
        ),
    ),
    "trails": Area(
        ("startracker/trails/*.py",),
        ("*/test_detection_streaks", "unit/test_points_and_trails", "unit/test_trail_*"),
    ),
    "centroid": Area(
        ("startracker/centroid/*.py",),
        ("*/test_centroid*", "*/test_asymmetric*", "*/test_effective_psf", "oracle/test_greyling_chapter_4"),
    ),
    "identification": Area(
        ("startracker/identification/*.py", "startracker/sorting.py"),
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
            "unit/test_sorting",
            "unit/test_bound*",
            "property/test_identification*",
            "unit/test_identification*",
            "unit/test_free_scale",
            "unit/test_tracker_answers",
            "unit/test_unexplained",
            "unit/test_acceptance",
            "unit/test_around_prior",
            "unit/test_association",
            "unit/test_flight_search",
            "unit/test_flight_triads",
            "*/test_fixed_point_arithmetic",
        ),
    ),
    "attitude": Area(
        (
            "startracker/estimation/*.py",
            "startracker/field_solution.py",
            "startracker/solution.py",
            "startracker/tracker.py",
            "startracker/unexplained.py",
        ),
        (
            "*/test_estimation*",
            "*/test_pose*",
            "*/test_plate*",
            "*/test_few_stars",
            "unit/test_tracker_answers",
            "unit/test_solution*",
            "unit/test_field_attitude*",
            "unit/test_outliers",
            "unit/test_unexplained*",
            "unit/test_other_stars",
            "unit/test_image_errors",
            "unit/test_field_solution",
            "unit/test_best_evidence",
        ),
    ),
    "tracking": Area(
        ("startracker/tracking/*.py",), ("*/test_tracking*", "unit/test_sensor_operation", "*/test_rate*")
    ),
    "fusion": Area(("startracker/fusion/*.py",), ("*/test_fusion*", "statistical/test_fusion*")),
    "calibration": Area(
        ("startracker/calibration/*.py",),
        ("*/test_calibration*", "*/test_in_flight*"),
    ),
    "photographs": Area(
        (
            "startracker/blind.py",
            "startracker/free_search.py",
            "startracker/identification/unknown_scale/*.py",
            "startracker/images/*.py",
        ),
        (
            "*/test_free_scale*",
            "*/test_image_reading",
            "*/test_photographs",
            "*/test_picture*",
            "*/test_planets_recognised",
            "*/test_best_evidence",
            "*/test_search_limits",
            "*/test_explain",
        ),
    ),
}
