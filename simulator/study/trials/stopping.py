"""Ctrl-C as a request to stop, so that finished results are kept."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from multiprocessing import resource_tracker
from types import FrameType


@contextlib.contextmanager
def stop_on_signal() -> Iterator[threading.Event]:
    """Event that is set by Ctrl-C or SIGTERM; a second one interrupts at once.

    An exception raised at an arbitrary point could be converted to another one by compiled code.
    """
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def ask(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def no_interrupt_for_children() -> Iterator[None]:
    """Processes started in this context do not receive Ctrl-C; one pressed meanwhile reaches this process afterwards.

    The signal is blocked, which children inherit. Ignoring it here would lose one that is pressed in these moments.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows, whose children inherit no signals
        yield
        return
    resource_tracker.ensure_running()  # of multiprocessing; started within, it would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
