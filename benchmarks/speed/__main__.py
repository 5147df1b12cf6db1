"""The speed benchmarks and their page: python -m benchmarks.speed [--out FILE.md] [--only WORD]"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.report import show, write_markdown
from benchmarks.speed import processes
from benchmarks.speed.page import NOTES, tables


def main() -> int:
    """Run everything, print it, write the page; the benchmarks' exit status."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.speed", description="The speed benchmarks.")
    options.add_argument("--out", type=Path, help="Markdown file to write")
    options.add_argument("--only", metavar="WORD", default="", help="benchmarks whose name has a word (pytest's -k)")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measured = Path(folder) / "speed.json"
        command = [sys.executable, "-m", "pytest", str(Path(__file__).parent), "-q", "-p", "no:cacheprovider"]
        # the processor's time: other programs do not count, and a second thread would count as it should
        command += ["--benchmark-timer=time.process_time", "--benchmark-columns=median,iqr,rounds"]
        command += [f"--benchmark-json={measured}", *(["-k", chosen.only] if chosen.only else [])]
        status = subprocess.run(command, check=False).returncode
        if not measured.exists() or not measured.stat().st_size:
            return status or 1
        timings = json.loads(measured.read_text())["benchmarks"]
    found = tables(timings, {} if chosen.only else processes.measure())
    show(found)
    if chosen.out is not None:
        write_markdown(chosen.out, "Speed", NOTES, found)
    return status


if __name__ == "__main__":
    sys.exit(main())
