"""The detector's functions for tests that write it as a scenario's section, exposure included."""

from simulator import detector
from simulator.build import detector_parameters


def build_fixed_pattern(section, seed):
    return detector.build_fixed_pattern(detector_parameters(section), seed)


def detect(mean_photo_e, section, pattern, streams, **options):
    device = detector_parameters(section)
    return detector.detect(mean_photo_e, device, pattern, streams, exposure_s=section.exposure_s, **options)
