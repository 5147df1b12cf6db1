"""Who may connect: addresses, tokens, origins, and rates of messages."""

from __future__ import annotations

import hmac
import ipaddress
import time
from urllib.parse import urlsplit

from startracker.errors import InputError

__all__ = ["Access", "TokenBucket", "is_host", "is_loopback"]

_LOCAL = ("localhost",)
_SPACE = set(" \t\\")


def is_loopback(host: str) -> bool:
    """Whether an address only reaches this machine."""
    if host.lower() in _LOCAL:
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def is_host(host: str) -> bool:
    """Whether the header ``Host`` of a request is a name or an address, with or without a port, or empty."""
    try:
        parts = urlsplit(f"//{host}")
        plain = host.isascii() and not set(host) & _SPACE
        return plain and parts.netloc == host and parts.username is None and (parts.port or 0) >= 0
    except ValueError:  # brackets that do not match, or a port that is not a number
        return False


def _is_origin(origin: str) -> bool:
    try:
        parts = urlsplit(origin)
        return bool(parts.scheme and parts.hostname)
    except ValueError:
        return False


class Access:
    """Rules of access to one server.

    Parameters
    ----------
    host : str
        Address to which it is bound.
    token : str
        Token that clients must have; required unless the address is a loopback one.
    origins : tuple of str
        Origins of pages, besides the server's own, that may connect, as ``https://example.org``.

    Raises
    ------
    InputError
        For another address without a token.
    """

    def __init__(self, host: str, token: str = "", origins: tuple[str, ...] = ()) -> None:
        self.loopback = is_loopback(host)
        if not self.loopback and not token:
            raise InputError(f"--host {host}: other machines may connect; give a --token or BORESIGHT_TOKEN")
        for origin in origins:
            if not _is_origin(origin):
                raise InputError(f"--origin {origin}: must look like https://example.org or http://localhost:8080")
        self._token, self._origins = token, {origin.rstrip("/").lower() for origin in origins}

    def has_token(self, given: str) -> bool:
        """Whether a client may enter with this token; any, if the server has none."""
        return not self._token or hmac.compare_digest(_bytes(given), _bytes(self._token))

    def refuses_host(self, host: str) -> bool:
        """Whether a request is for another name than this server's: a page elsewhere whose name was redirected here."""
        name = urlsplit(f"//{host}").hostname or ""
        return self.loopback and not is_loopback(name) and name not in {urlsplit(o).hostname for o in self._origins}

    def refuses_origin(self, origin: str | None, host: str) -> bool:
        """Whether a page of another origin than the server's own and those permitted wants to connect."""
        if origin is None:  # not a browser
            return False
        given = origin.rstrip("/").lower()
        return given not in self._origins and given not in {f"http://{host.lower()}", f"https://{host.lower()}"}


def _bytes(token: str) -> bytes:
    """A token as bytes; JSON may contain half of a surrogate pair, which UTF-8 does not have."""
    return token.encode("utf-8", "surrogatepass")


class TokenBucket:
    """Limit of a rate, with a reserve for bursts.

    Parameters
    ----------
    per_s : float
        Rate in the long run.
    burst : float
        Reserve.
    """

    def __init__(self, per_s: float, burst: float) -> None:
        self._per_s, self._burst, self._left, self._at_s = per_s, burst, burst, time.monotonic()

    def take(self) -> bool:
        """Whether one more is within the limit."""
        now_s = time.monotonic()
        self._left = min(self._burst, self._left + (now_s - self._at_s) * self._per_s)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
