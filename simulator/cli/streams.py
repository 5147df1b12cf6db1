"""Standard streams of a command: closed ones, full devices, and terminals without the characters of the text."""

from __future__ import annotations

import codecs
import errno
import io
import logging
import os
import sys
import unicodedata
from typing import TextIO

from startracker.errors import InputError

_PLAIN = "boresight.plain"
"""Name of the error handler that writes characters which an encoding lacks in those that it has."""
_SPELLED = {
    "°": "deg", "″": "arcsec", "′": "arcmin", "×": "x", "·": "*", "÷": "/", "−": "-", "–": "-", "—": "-", "‑": "-",
    "±": "+/-", "≤": "<=", "≥": ">=", "≠": "!=", "≈": "~", "∝": "~", "→": "->", "←": "<-", "↔": "<->", "√": "sqrt ",
    "∞": "inf", "…": "...", "µ": "u", "μ": "u", "α": "alpha", "β": "beta", "γ": "gamma", "δ": "delta", "Δ": "Delta",
    "ε": "epsilon", "η": "eta", "θ": "theta", "κ": "kappa", "λ": "lambda", "Λ": "Lambda", "ν": "nu", "ξ": "xi",
    "π": "pi", "ρ": "rho", "σ": "sigma", "Σ": "Sigma", "τ": "tau", "φ": "phi", "Φ": "Phi", "χ": "chi", "ψ": "psi",
    "ω": "omega", "Ω": "Omega", "ø": "o", "“": '"', "”": '"', "‘": "'", "’": "'", "■": "#", "●": "*", "\u00a0": " ",
    "²": "^2", "³": "^3", "¹": "^1", "⁰": "^0", "⁴": "^4", "⁵": "^5", "⁶": "^6", "⁷": "^7", "⁸": "^8", "⁹": "^9",
    "⁻": "^-", "½": "1/2", "¼": "1/4", "¾": "3/4",
}  # fmt: skip
_UNITS = ("deg", "arcsec", "arcmin")
_LOST = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)
"""Errors of a device to which a stream is written."""
OUTPUT_LOST, PIPE_CLOSED = 2, 141  # exit status; 141 is that of a program that ends by SIGPIPE


class OutputError(Exception):
    """An `OSError` of a command, in a form that typer does not end the process for."""

    def __init__(self, cause: OSError) -> None:
        super().__init__(str(cause))
        self.cause = cause


def prepare_streams() -> None:
    """Make the standard streams usable by a command of this process.

    A closed input or error stream is replaced by the null device, so that none of our files gets its descriptor.
    Characters that an encoding lacks are spelled out: ``°`` as ``deg``.

    Raises
    ------
    InputError
        If standard output is closed.
    """
    if sys.stdin is None:
        os.open(os.devnull, os.O_RDONLY)  # open until the end of the process
    if sys.stderr is None:
        sys.stderr = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")
    if sys.stdout is None:
        raise InputError("standard output is closed; send it to a file, or to /dev/null")
    # Matplotlib announces on standard error that it cannot write to the home folder, or that it lists the fonts
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_PLAIN)


def say(message: object) -> None:
    """Print one line on standard error, which may be full or closed: the exit status then remains the only answer."""
    try:
        print(message, file=sys.stderr, flush=True)
    except (OSError, ValueError):
        _discard(sys.stderr)


def flush_output() -> None:
    """Write what is left in standard output; `OSError` if that is not possible."""
    if sys.stdout is not None:
        sys.stdout.flush()


def output_failed(error: OSError) -> int:
    """Exit status for an error of the system, with one line on standard error unless the reader of a pipe has gone."""
    if isinstance(error, BrokenPipeError):  # as `head` does
        _discard(sys.stdout)
        return PIPE_CLOSED
    reason = error.strerror or error
    if error.filename is None and error.errno in _LOST:
        _discard(sys.stdout)
        say(f"standard output cannot be written ({reason}); part of the text is lost")
    else:
        say(f"{error.filename or 'boresight'}: {reason}")
    return OUTPUT_LOST


def is_terminal(stream: TextIO | None) -> bool:
    """Whether a standard stream is a terminal; one that is closed (None from the start of the process) is not."""
    return stream is not None and not stream.closed and stream.isatty()


def as_written(text: str, encoding: str) -> str:
    """Text as a stream with this encoding shows it, for layouts that count its characters."""
    return text.encode(encoding, _PLAIN).decode(encoding)


def _discard(stream: TextIO) -> None:
    """Send the rest of a stream to the null device, so that the end of the process does not fail to write it."""
    try:
        number = stream.fileno()
    except (OSError, ValueError):  # a stream without a descriptor, as in tests
        return
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, number)
    os.close(null)


def _spelled(error: UnicodeError) -> tuple[str | bytes, int]:
    """Replacement of what cannot be encoded, and where to continue: an error handler of `codecs`."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    character = error.object[error.start]
    if "\udc80" <= character <= "\udcff":  # a byte of a file name that is not text in the encoding of file names
        return bytes([ord(character) - 0xDC00]), error.start + 1
    text = _SPELLED.get(character)
    if text is None:
        letters = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
        text = letters or "?"
    before = error.object[error.start - 1] if error.start else ""
    after = error.object[error.start + 1 : error.start + 2]
    if text in _UNITS:
        text = f"{' ' if before.isdigit() else ''}{text}{' ' if after.isdigit() else ''}"
    return text, error.start + 1


codecs.register_error(_PLAIN, _spelled)
