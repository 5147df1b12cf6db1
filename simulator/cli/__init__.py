"""The command ``boresight``.

This module imports nothing at its top: an interrupt during the imports, a few tenths of a second, ends in one line too.
"""

import sys


def main() -> None:
    """Entry point: every failure is one line on standard error and status 2; an interrupt has status 130."""
    status = _run(sys.argv[1:], entry=True)
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)  # the work is done: Ctrl-C ends the process without a traceback
    sys.exit(status)


def _run(arguments: list[str], *, entry: bool = False) -> int:
    """Exit status of a command; `entry` prepares the streams of the process."""
    try:
        if entry:
            import gc

            from simulator.constants import GARBAGE_THRESHOLDS

            gc.set_threshold(*GARBAGE_THRESHOLDS)
            from simulator.cli.streams import prepare_streams, say
            from startracker.errors import InputError

            try:
                prepare_streams()
            except InputError as error:
                say(error)
                return 2
        from simulator.cli.application import run_application

        return run_application(arguments)
    except KeyboardInterrupt:
        print("boresight: interrupted", file=sys.stderr)
        return 130
