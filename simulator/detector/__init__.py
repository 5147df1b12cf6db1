"""The detector: converts mean photo-electrons to digital numbers. The order of effects is defined in `chain.py`."""

from simulator.detector.chain import CHARGE, READOUT, Detector, Readout, detect
from simulator.detector.fixed_pattern import FixedPattern, build_fixed_pattern

__all__ = ["CHARGE", "READOUT", "Detector", "FixedPattern", "Readout", "build_fixed_pattern", "detect"]
