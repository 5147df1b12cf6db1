"""Errors that the user can correct; each message is one line.

Expected outcomes (no stars, an ambiguous field) are not errors but a `Solution` with a status and a reason.
"""


class BoresightError(Exception):
    """Base class of all errors that are raised deliberately; the message can be displayed to the user as it is."""


class InputError(BoresightError, ValueError):
    """A value, file or image that cannot be used; the message states which one and what to do."""


class InputWarning(UserWarning):
    """An input that has no effect, or is used only in part; the message states where and why."""


class FrameMismatchError(BoresightError, ValueError):
    """Two attitudes with frames that do not match were composed or compared."""
