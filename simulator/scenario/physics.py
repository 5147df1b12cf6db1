"""Physical plausibility: contradictions between keys, which are always errors, and unphysical values, which
``allow_unphysical: true`` permits and the report repeats.

Each rule is a function of the values by dotted path, and names the key that violates it. Values that the schema rejects
are absent, and rules that need them are skipped, so that physics is reported together with all other errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import timedelta
from typing import Any

from simulator.constants import EARTH_GM_KM3_S2, EARTH_RADIUS_KM
from simulator.mission.secular import sun_synchronous_limit_km
from simulator.scenario import detector_rules, flight_rules, orbit_rules, pointing_rules, sequence_rules
from simulator.scenario.errors import Violation, impossible, unphysical
from simulator.scenario.orbit_rules import MIN_ORBIT_KM
from simulator.scenario.sequence_rules import EPHEMERIS

ALLOW = "; or set allow_unphysical: true"

MIN_F_NUMBER = 0.5
"""Limit of an aplanatic lens in air: N = 1 / (2 sin θ) with θ = 90° (Born & Wolf 1999, sine condition)."""

SILICON_C = (-230.0, 150.0)
"""Below, the dopants freeze out; above, silicon is an intrinsic conductor (Janesick 2001; Sze & Ng 2007, chapter 1)."""

MIN_PIXEL_UM = 0.4
"""About a wavelength of light; the smallest existing pixels are 0.5 µm."""

GAUSSIAN_SIGMA = 0.42
"""Standard deviation of the Gaussian closest to an Airy pattern, in λN (Zhang, Zerubia & Olivo-Marin 2007)."""

MAX_FIELD_DEG = 170.0
"""Maximum diagonal field of a pinhole, r = f tan θ."""


Values = Mapping[str, Any]
Rule = Callable[[Values], Iterator[Violation]]


def violations(values: Values) -> list[Violation]:
    """All violated rules of a scenario with one camera; those of several heads are in `simulator.scenario.heads`.

    Parameters
    ----------
    values : mapping
        Dotted path to value, including defaults; invalid values are omitted, and rules that depend on them skipped.
    """
    return violations_of(RULES, values)


def violations_of(rules: Iterable[Rule], values: Values) -> list[Violation]:
    """Violations of some rules."""
    found: list[Violation] = []
    for rule in rules:
        try:
            found.extend(rule(values))
        except KeyError:  # the rule needs a value that is invalid and has been reported
            continue
    return found


def _node(v: Values) -> Iterator[Violation]:
    if not orbit_rules.sources(v) and v["orbit.raan_deg"] is not None and v["orbit.ltan_h"] is not None:
        message = "the node is already defined by orbit.ltan_h; set one of them to null"
        yield impossible("orbit.raan_deg", message)


def _altitude(v: Values) -> Iterator[Violation]:
    if orbit_rules.sources(v):
        return
    altitude_km = v["orbit.altitude_km"]
    if altitude_km <= -EARTH_RADIUS_KM:
        yield impossible("orbit.altitude_km", f"{altitude_km:g} km is below the Earth's centre; use 150 km or more")
    elif altitude_km < 0:
        message = f"{altitude_km:g} km is inside the Earth; use {MIN_ORBIT_KM:g} km or more"
        if v["orbit.propagator"] == "sgp4":
            yield impossible("orbit.altitude_km", message + " (not supported by sgp4)")
        else:
            yield unphysical("orbit.altitude_km", message)
    elif altitude_km < MIN_ORBIT_KM:
        message = f"{altitude_km:g} km is within the atmosphere, where orbits decay; use {MIN_ORBIT_KM:g} km or more"
        yield unphysical("orbit.altitude_km", message)


def _sun_synchronous(v: Values) -> Iterator[Violation]:
    limit_km = sun_synchronous_limit_km()
    if orbit_rules.sources(v):
        return
    if v["orbit.inclination_deg"] == "auto" and v["orbit.altitude_km"] > limit_km:
        message = (
            f"no orbit at {v['orbit.altitude_km']:g} km is sun-synchronous, only up to {limit_km:.0f} km; "
            "give the inclination in degrees"
        )
        yield impossible("orbit.inclination_deg", message)


def _epoch(v: Values) -> Iterator[Violation]:
    # The mission must end within the ephemeris, with margins for a year of trials or for an orbit.
    epoch, (first, last) = v["epoch"], EPHEMERIS
    span = timedelta(days=366) if v["study.sampling"] == "mission_year" else timedelta(days=2)
    if not first <= epoch <= last - span:
        message = f"{epoch:%Y-%m-%d} is outside the ephemeris DE421; use {first:%Y-%m-%d} to {last - span:%Y-%m-%d}"
        yield impossible("epoch", message)


def _tether(v: Values) -> Iterator[Violation]:
    if v["tether.diameter_mm"] == 0.0:
        return
    near, far = v["tether.near_m"], v["tether.far_m"]
    for key, end in (("near_m", near), ("far_m", far)):
        if end[2] <= 0.0:
            yield impossible(
                f"tether.{key}", f"{end[2]:g} m along the boresight; both ends must be in front of the lens"
            )
            return
    # Distance between the images of the two ends, in focal lengths.
    turn = math.hypot(*(near[i] / near[2] - far[i] / far[2] for i in range(2)))
    if turn < 1e-6:
        yield impossible("tether.far_m", "the tether is collinear with the lens; move one end sideways")


def _f_number(v: Values) -> Iterator[Violation]:
    focal_mm, aperture_mm = v["optics.focal_length_mm"], v["optics.aperture_mm"]
    if focal_mm < MIN_F_NUMBER * aperture_mm:
        message = (
            f"{aperture_mm:g} mm at a focal length of {focal_mm:g} mm is f/{focal_mm / aperture_mm:.3g}, "
            f"but no lens in air is faster than f/{MIN_F_NUMBER:g}; use at most {focal_mm / MIN_F_NUMBER:g} mm"
        )
        yield unphysical("optics.aperture_mm", message)


def _field(v: Values) -> Iterator[Violation]:
    pitch_x, pitch_y = _pitch_um(v)
    diagonal_mm = math.hypot(v["detector.width"] * pitch_x, v["detector.height"] * pitch_y) * 1e-3
    focal_mm = v["optics.focal_length_mm"]
    field_deg = 2.0 * math.degrees(math.atan2(diagonal_mm / 2.0, focal_mm))
    if field_deg > MAX_FIELD_DEG and v["optics.projection"] == "pinhole":
        message = (
            f"{focal_mm:g} mm with a detector of {diagonal_mm:.3g} mm diagonal has a field of {field_deg:.4g}°, "
            f"more than the {MAX_FIELD_DEG:g}° of a pinhole; use a longer focal length"
        )
        yield unphysical("optics.focal_length_mm", message)


def _lens_coefficients(v: Values) -> Iterator[Violation]:
    projection = v["optics.projection"]
    if projection == "pinhole":
        return
    known = ("k1", "k2", "k3", "k4") if projection == "fisheye" else ()
    for name in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"):
        if v[f"optics.distortion.{name}"] and name not in known:
            hint = "use k1 to k4" if known else "use projection: fisheye"
            yield impossible(
                f"optics.distortion.{name}", f"the projection {projection} has no such coefficient; {hint}"
            )


def _vignetting(v: Values) -> Iterator[Violation]:
    start, end = v["optics.vignetting.mechanical_start_deg"], v["optics.vignetting.mechanical_end_deg"]
    if end is not None and end <= start:
        message = f"{end:g}° is not greater than mechanical_start_deg ({start:g}°)"
        yield impossible("optics.vignetting.mechanical_end_deg", message)
    elif end is not None and end >= 90 and v["optics.projection"] == "pinhole":
        yield impossible(
            "optics.vignetting.mechanical_end_deg", f"the half field of a pinhole is below 90°, not {end:g}°"
        )


def _pitch_um(v: Values) -> tuple[float, float]:
    pitch = v["detector.pixel_pitch_um"]
    return (pitch, pitch) if isinstance(pitch, float) else pitch


def _pixel(v: Values) -> Iterator[Violation]:
    smallest = min(_pitch_um(v))
    if smallest < MIN_PIXEL_UM:
        message = f"{smallest:g} µm is less than a wavelength of light; use {MIN_PIXEL_UM:g} µm or more"
        yield unphysical("detector.pixel_pitch_um", message)


def _psf_keys(v: Values) -> Iterator[Violation]:
    sigma, ring = v["optics.psf.sigma_px"], v["optics.psf.first_dark_ring_px"]
    if sigma is not None and v["optics.psf.model"] == "airy":
        message = "model: airy does not use sigma_px; use first_dark_ring_px, or model: gaussian"
        yield impossible("optics.psf.sigma_px", message)
    elif sigma is not None and ring is not None:
        message = "the width is already defined by first_dark_ring_px; set one of them to null"
        yield impossible("optics.psf.sigma_px", message)


def _diffraction(v: Values) -> Iterator[Violation]:
    number = v["optics.focal_length_mm"] / v["optics.aperture_mm"]
    scale_px = v["optics.psf.wavelength_nm"] * 1e-3 * number / _pitch_um(v)[0]  # λN
    for name, factor in (("sigma_px", GAUSSIAN_SIGMA), ("first_dark_ring_px", 1.22)):
        given, least = v[f"optics.psf.{name}"], factor * scale_px
        if given is not None and given < 0.95 * least:  # 5 % for rounded factors
            message = (
                f"{given:g} px is narrower than the diffraction limit at f/{number:.3g} and "
                f"{v['optics.psf.wavelength_nm']:g} nm; use {least:.3g} px or more"
            )
            yield unphysical(f"optics.psf.{name}", message)


def _full_well(v: Values) -> Iterator[Violation]:
    if v["detector.full_well_e"] < v["detector.read_noise_e"]:
        message = f"{v['detector.full_well_e']:g} e⁻ is less than the read noise of {v['detector.read_noise_e']:g} e⁻"
        yield unphysical("detector.full_well_e", message + "; no signal could be detected")


def _temperature(v: Values) -> Iterator[Violation]:
    low, high = SILICON_C
    if not low <= v["detector.temperature_c"] <= high:
        message = f"no silicon detector works at {v['detector.temperature_c']:g} °C; use {low:g} to {high:g} °C"
        yield unphysical("detector.temperature_c", message)


def _dark_signal(v: Values) -> Iterator[Violation]:
    doublings = (v["detector.temperature_c"] - v["detector.dark_reference_c"]) / v["detector.dark_doubling_c"]
    dark_e = v["detector.dark_current_e_s"] * v["detector.exposure_s"] * 2.0 ** min(doublings, 900.0)  # no overflow
    if dark_e > v["detector.full_well_e"]:
        message = (
            f"in {v['detector.exposure_s']:g} s at {v['detector.temperature_c']:g} °C the dark current alone generates "
            f"{dark_e:.3g} e⁻ and fills the well of {v['detector.full_well_e']:g} e⁻; "
            "shorten the exposure or cool the detector"
        )
        yield unphysical("detector.exposure_s", message)


def _exposure(v: Values) -> Iterator[Violation]:
    a_km = EARTH_RADIUS_KM + v["orbit.altitude_km"]
    if 0 < a_km < 1e100 and not orbit_rules.sources(v):  # the cube of larger values overflows
        period_s = 2.0 * math.pi * math.sqrt(a_km**3 / EARTH_GM_KM3_S2)
        if v["detector.exposure_s"] > period_s:
            message = (
                f"{v['detector.exposure_s']:g} s is longer than the orbit of {period_s:.0f} s; use a shorter exposure"
            )
            yield unphysical("detector.exposure_s", message)


def _converter(v: Values) -> Iterator[Violation]:
    # The range of the converter must hold more than the noise, and its steps must be smaller than the full well.
    bits, gain = v["detector.adc_bits"], v["detector.gain_e_per_dn"]
    top_dn = math.inf if bits is None else 2**bits - 1
    if v["detector.offset_dn"] >= top_dn:
        message = f"{v['detector.offset_dn']:g} DN uses the full range of the converter, {top_dn} DN ({bits} bits)"
        yield impossible("detector.offset_dn", message + "; decrease it or increase adc_bits")
    elif gain != "auto":
        span_e = gain * (top_dn - v["detector.offset_dn"])
        if span_e < v["detector.read_noise_e"]:
            message = (
                f"{gain:g} e⁻/DN limits the range of the converter to {span_e:.3g} e⁻, "
                f"below the read noise of {v['detector.read_noise_e']:g} e⁻; increase it or adc_bits"
            )
            yield unphysical("detector.gain_e_per_dn", message)
        if bits is not None and gain > v["detector.full_well_e"]:
            message = f"{gain:g} e⁻/DN gives less than one DN for a full well of {v['detector.full_well_e']:g} e⁻"
            yield unphysical("detector.gain_e_per_dn", message + "; decrease it")


def _guide_stars(v: Values) -> Iterator[Violation]:
    if v["tracker.magnitude_limit"] < -1.5:
        message = f"no star is brighter than V = {v['tracker.magnitude_limit']:g} (Sirius: −1.46); 6.5 is usual"
        yield impossible("tracker.magnitude_limit", message)


def _least_and_most(low: str, high: str) -> Rule:
    """Rule that the value of `high`, if there is one, is not below that of `low`."""

    def rule(v: Values) -> Iterator[Violation]:
        if v[high] is not None and v[high] < v[low]:
            yield impossible(high, f"{v[high]:g} is less than {low} ({v[low]:g})")

    return rule


def _window(v: Values) -> Iterator[Violation]:
    size = v["tracker.centroid.window_px"]
    if size % 2 == 0:
        message = f"must be odd, so that a pixel is at the centre, not {size}; use {size - 1} or {size + 1}"
        yield impossible("tracker.centroid.window_px", message)


RULES: tuple[Rule, ...] = (
    _node,
    orbit_rules.contradictions,
    _altitude,
    _sun_synchronous,
    _epoch,
    pointing_rules.contradictions,
    _tether,
    _f_number,
    _field,
    _lens_coefficients,
    _vignetting,
    _pixel,
    _psf_keys,
    _diffraction,
    _full_well,
    _temperature,
    _dark_signal,
    _exposure,
    _converter,
    detector_rules.contradictions,
    flight_rules.contradictions,
    detector_rules.telegraph_times,
    sequence_rules.contradictions,
    _guide_stars,
    _window,
    _least_and_most("sky.magnitude_limit", "sky.faint_magnitude_limit"),
    _least_and_most("tracker.detection.min_pixels", "tracker.detection.max_pixels"),
    _least_and_most("tracker.identification.min_stars", "tracker.identification.max_stars"),
    _least_and_most("tracker.identification.min_stars", "tracker.detection.max_stars"),
)
