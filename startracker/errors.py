"""Errors that are the user's to mend; each is one clear line.

What is part of the tracker's job (no stars, ambiguous field) is no error but a `Solution` with a status and a reason.
"""


class BoresightError(Exception):
    """Base of every error raised on purpose by this project; its text is fit to be shown to the user as it is."""


class InputError(BoresightError, ValueError):
    """A value, file or image that cannot be used; says which, and what to do."""


class InputWarning(UserWarning):
    """Something given that has no effect; says where, and why."""


class FrameMismatchError(BoresightError, ValueError):
    """Two attitudes were joined whose frames do not meet."""
