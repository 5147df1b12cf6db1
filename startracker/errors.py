"""Errors that the user can correct; each message is one line.

Expected outcomes (no stars, an ambiguous field) are not errors but a `Solution` with a status and a reason.
"""


class BoresightError(Exception):
    """Base class of all errors raised deliberately; the message can be shown to the user as it is."""


class InputError(BoresightError, ValueError):
    """A value, file or image that cannot be used; the message says which one and what to do."""


class InputWarning(UserWarning):
    """An input that has no effect, or is used in part; the message says where and why."""


class FrameMismatchError(BoresightError, ValueError):
    """Two attitudes were composed or compared whose frames do not match."""
