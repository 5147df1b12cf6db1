"""Draw docs/images/basilisk-hold.png: both flights of examples/live/basilisk_hold.py. Needs the package bsk.

python docs/make_images/basilisk.py
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]
EXAMPLE = DOCS.parent / "examples" / "live" / "basilisk_hold.py"


def main() -> None:
    sys.path.insert(0, str(EXAMPLE.parent))
    sys.argv = [str(EXAMPLE), "--figure", str(DOCS / "images" / "basilisk-hold.png")]
    runpy.run_path(str(EXAMPLE), run_name="__main__")


if __name__ == "__main__":
    main()
