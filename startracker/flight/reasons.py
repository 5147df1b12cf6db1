"""Why an answer of a flight build has its status."""

from __future__ import annotations

from enum import IntEnum


class Reason(IntEnum):
    """In the order of `enum tracker_reason`."""

    ACCEPTED = 0
    NOTHING_FOUND = 1
    FEW_FOUND = 2
    NO_HYPOTHESIS = 3
    WEAK_EVIDENCE = 4
    ABOVE_RATE = 5
    RIVAL = 6
    POSE_FAILED = 7
    STEPS_USED_UP = 8
    ROWS_MISSING = 9
    FRAME_UNIFORM = 10
    SATURATED_SHARE = 11
    UNEXPLAINED = 12
    FEW_DISAGREE = 13
    ANOTHER_FIELD = 14
