"""Methods of numba replaced for a while."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any

Shortcut = tuple[Any, str, Callable[..., Any]]
"""Class or module, name of a method or function, and the one in its stead."""


def available(*found_by: Callable[[], Shortcut | Iterator[Shortcut]]) -> Iterator[Shortcut]:
    """Shortcuts whose methods the installed version of numba has."""
    for find in found_by:
        with contextlib.suppress(ImportError, AttributeError):  # another version of numba
            found = find()
            if isinstance(found, tuple):
                yield found
            else:
                yield from found


@contextlib.contextmanager
def replaced(found: Iterable[Shortcut]) -> Iterator[None]:
    """Within this context the methods are replaced; contexts may be nested."""
    with contextlib.ExitStack() as after:
        for owner, name, shortcut in found:
            method = vars(owner).get(name)
            if method is shortcut:  # of an outer context
                continue
            if method is None:
                after.callback(delattr, owner, name)
            else:
                after.callback(setattr, owner, name, method)
            setattr(owner, name, shortcut)
        yield
