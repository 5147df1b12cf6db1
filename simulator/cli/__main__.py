"""``python -m simulator.cli`` is ``boresight``."""

from simulator.cli import main

main()
